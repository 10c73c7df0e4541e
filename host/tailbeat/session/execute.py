"""The verdict on a series: by the trials of its experiment that count.

One swim of a series: the guards around it, and the live view while it goes on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

from tailbeat.board.fish import Fish
from tailbeat.core.errors import TailbeatError
from tailbeat.core.frames import Camera
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import library_of
from tailbeat.learning.assessment import progress_of
from tailbeat.learning.convergence import Assessment
from tailbeat.learning.identification import Identified
from tailbeat.link.mavlink import Message
from tailbeat.link.messages import SIMULATED_FISH, TrialOutcome
from tailbeat.session.collect import trial_is_safe
from tailbeat.session.events import Assessed, Event, LiveValues, Notice, TrialStopped
from tailbeat.session.guards import Guard, Seen, together, when
from tailbeat.session.log import SessionLog
from tailbeat.session.operator import Operator
from tailbeat.session.outcome import BY_HAND, StopReason
from tailbeat.session.trial import run_trial
from tailbeat.session.trial_camera import stash_of


def judged(account: SessionLog, around: TrialSetup, rolled_back: bool) -> Assessment | None:
    """On the last trial; None, with a notice, when it cannot be given: the board has learned all
    the same."""

    try:
        trials = account.counting()
        return progress_of(trials, None, _identified(around.fish), (), rolled_back).verdict
    except TailbeatError as error:
        around.operator.tell(Notice(f"no verdict: {error}"))
        return None


def report_assessment(operator: Operator, verdict: Assessment | None) -> None:
    """Tells it."""
    if verdict is None:
        return
    saturated = "" if verdict.saturation is None else verdict.saturation.text
    operator.tell(
        Assessed(verdict.words, verdict.stop, verdict.stop_reason, verdict.advice, saturated)
    )


def _identified(fish: Fish) -> Identified | None:
    book = library_of(fish)
    return None if book is None else book.identified()


_LIVE_PERIOD_S = 0.1  # of the transport's clock: what an eye follows
_RUNNING = 3  # TAILBEAT_STATE


@dataclass
class LiveReporter:
    """What the board tells while it swims, as one event now and then. A guard that stops nothing:
    it is asked all the time, so it also shows how long the link has been silent."""

    fish: Fish
    operator: Operator
    simulated: bool
    _values: LiveValues = field(init=False)
    _told_s: float = field(default=-math.inf, init=False)
    _running: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self._values = LiveValues(self.simulated)

    def hear(self, message: Message) -> None:
        """A message of the board's."""
        kind, changes = message.get_type(), dict[str, Any]()
        if kind == "TAILBEAT_STATUS":
            changes |= {"beats": message.beats, "battery_v": message.battery_mv * 1e-3}
            self._running = message.state == _RUNNING
            if self._running:
                changes["beat"] = message.beat
        elif kind == "TAILBEAT_LIVE" and self._running:
            changes |= {"beat": message.beat, "amplitude_rad": message.amplitude_rad}
        elif kind == "TAILBEAT_BEAT":
            changes["reference_m_s"] = message.reference_m_s
        if changes and math.isfinite(speed_m_s := getattr(message, "speed_m_s", math.nan)):
            changes["speed_m_s"] = speed_m_s
        self._values = replace(self._values, **changes)

    def __call__(self, _: object) -> None:
        """Tells, when it is time to."""
        link = self.fish.link
        now_s = link.transport.now_s()
        if now_s - self._told_s < _LIVE_PERIOD_S:
            return
        self._told_s = now_s
        silent_s = (now_s - link.last_heard_s) * self.fish.clock.rate
        self.operator.tell(replace(self._values, silent_s=silent_s))


@dataclass(frozen=True)
class TrialSetup:
    """What a swim is done with. ``guard``: of the caller."""

    fish: Fish
    operator: Operator
    camera: Camera | None
    guard: Guard | None
    reconnect_s: float


@dataclass(frozen=True)
class ExecutedTrial:
    """How it went. ``stopped``: why something here stopped it; None = nothing did."""

    outcome: TrialOutcome
    stopped: StopReason | None


def execute(
    around: TrialSetup, experiment: Experiment, room: Guard, heading_rad: float
) -> ExecutedTrial:
    """Swims the next trial and keeps what the camera saw. ``room`` ends it by distance. Raises what
    run_trial raises."""
    fish, operator = around.fish, around.operator
    live = LiveReporter(fish, operator, fish.info().board in SIMULATED_FISH)
    stopped: list[StopReason] = []

    def on_event(event: Event) -> None:
        if isinstance(event, TrialStopped):
            stopped.append(event.reason)
        operator.tell(event)

    seen, camera = Seen(), around.camera
    guard = together(around.guard, room, when(operator.wants_abort, BY_HAND), seen, live)
    stop_listening = fish.link.subscribe(live.hear)
    try:
        outcome = run_trial(
            fish, camera, on_event, guard, around.reconnect_s, direction_rad=heading_rad
        )
        if camera is not None:
            with trial_is_safe(outcome.number, experiment):
                stash_of(experiment, outcome.number).put(seen.frames, camera, fish.clock)
    finally:
        stop_listening()
    return ExecutedTrial(outcome, stopped[0] if stopped else None)
