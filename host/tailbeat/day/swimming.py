"""One swim of a series: the guards around it, and the live view while it goes on."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from tailbeat.day.logs import trial_is_safe
from tailbeat.day.positions import stash_of
from tailbeat.guards import BY_HAND, Seen, together, when
from tailbeat.results import SIMULATED_FISH

if TYPE_CHECKING:
    from tailbeat.camera.base import Camera
    from tailbeat.day.person import Event, Person
    from tailbeat.experiment.folder import Experiment
    from tailbeat.fish import Fish, Guard
    from tailbeat.link import Message
    from tailbeat.results import TrialOutcome

_LIVE_PERIOD_S = 0.1  # of the transport's clock: what an eye follows
_RUNNING = 3  # TAILBEAT_STATE


@dataclass
class Live:
    """What the board tells while it swims, as one event now and then. A guard that stops nothing:
    it is asked all the time, so it also shows how long the link has been silent."""

    fish: Fish
    person: Person
    simulated: bool
    _event: Event = field(default_factory=dict, init=False)
    _told_s: float = field(default=-math.inf, init=False)
    _running: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self._event = {
            "event": "live",
            "beat": None,
            "beats": None,
            "speed_m_s": None,
            "reference_m_s": None,
            "amplitude_rad": None,
            "battery_v": None,
            "silent_s": None,
            "simulated": self.simulated,
        }

    def hear(self, message: Message) -> None:
        """A message of the board's."""
        kind, event = message.get_type(), self._event
        if kind == "TAILBEAT_STATUS":
            event |= {"beats": message.beats, "battery_v": message.battery_mv * 1e-3}
            self._running = message.state == _RUNNING
            if self._running:
                event["beat"] = message.beat
        elif kind == "TAILBEAT_LIVE" and self._running:
            event |= {"beat": message.beat, "amplitude_rad": message.amplitude_rad}
            if math.isfinite(message.speed_m_s):
                event["speed_m_s"] = message.speed_m_s
        elif kind == "TAILBEAT_BEAT":
            event["reference_m_s"] = message.reference_m_s
            if math.isfinite(message.speed_m_s):
                event["speed_m_s"] = message.speed_m_s

    def __call__(self, _: object) -> None:
        """Tells, when it is time to."""
        link = self.fish.link
        now_s = link.transport.now_s()
        if now_s - self._told_s < _LIVE_PERIOD_S:
            return
        self._told_s = now_s
        silent_s = (now_s - link.last_heard_s) * self.fish.clock.rate
        self.person.tell(self._event | {"silent_s": silent_s})


@dataclass(frozen=True)
class Around:
    """What a swim is done with. ``guard``: of the caller."""

    fish: Fish
    person: Person
    camera: Camera | None
    guard: Guard | None
    reconnect_s: float


@dataclass(frozen=True)
class Swim:
    """How it went. ``stopped``: why something here stopped it; empty = nothing did."""

    outcome: TrialOutcome
    stopped: str


def swim(around: Around, experiment: Experiment, room: Guard, heading_rad: float) -> Swim:
    """Swims the next trial and keeps what the camera saw. ``room`` ends it by distance. Raises what
    Fish.run_trial raises."""
    fish, person = around.fish, around.person
    live = Live(fish, person, fish.info().board in SIMULATED_FISH)
    stopped: list[str] = []

    def on_event(event: Event) -> None:
        if event["event"] == "guard":
            stopped.append(event["reason"])
        person.tell(event)

    seen, camera = Seen(), around.camera
    guard = together(around.guard, room, when(person.wants_abort, BY_HAND), seen, live)
    stop_listening = fish.link.subscribe(live.hear)
    try:
        outcome = fish.run_trial(
            camera, on_event, guard, around.reconnect_s, direction_rad=heading_rad
        )
        if camera is not None:
            with trial_is_safe(outcome.number, experiment):
                stash_of(experiment, outcome.number).put(seen.frames, camera, fish.clock)
    finally:
        stop_listening()
    return Swim(outcome, stopped[0] if stopped else "")
