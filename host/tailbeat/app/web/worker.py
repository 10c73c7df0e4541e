"""Owns the fish for the page: one thread that swims, and what the page may know and ask.

No web toolkit in here. Whatever the page wants goes through ``ask``; what there is to see is in
``now``, an unchanging snapshot.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from tailbeat.app.web import state, view
from tailbeat.app.web.inbox import Ask, Asks, Commission
from tailbeat.app.web.operator import PageOperator
from tailbeat.app.web.picture import LastPicture
from tailbeat.app.web.state import PageState, Phase, Point, Screen
from tailbeat.app.web.trials import PageTrials
from tailbeat.board.fish import Fish
from tailbeat.board.provision import connect_notice
from tailbeat.core.errors import ConnectError, LinkLostError, TailbeatError
from tailbeat.core.records import decode_reference
from tailbeat.core.reference import Reference
from tailbeat.core.speed_source import Camera, Frame
from tailbeat.experiment.current import set_and_save
from tailbeat.experiment.library import library_of
from tailbeat.link.mavlink import Message
from tailbeat.link.messages import BeatEvent, BoardStatus, imu_health
from tailbeat.link.stream import StreamAddress, streaming
from tailbeat.session.events import StepEnded
from tailbeat.session.guards import Guard, all_guards
from tailbeat.session.health import check_health
from tailbeat.session.limit import AMP_MAX, require_tried
from tailbeat.session.next_law import LawName
from tailbeat.session.options import Options, Until
from tailbeat.session.outcome import KINDS
from tailbeat.session.preflight_step import PreflightLimits
from tailbeat.session.proposals import Trials
from tailbeat.session.series import SeriesEnd
from tailbeat.session.start import StartOptions, give_back, run_start
from tailbeat.session.travel import travel_next
from tailbeat.session.trial_camera import camera_of

OpenCamera = Callable[["Fish"], AbstractContextManager[tuple["Camera | None", "Guard | None"]]]
"""Opens the camera of a series, and the guard that goes with it."""

_BROKEN_OFF = ("stopped", "interrupted")  # see SeriesEnd
_IDLE_LOOKS = 8  # a request ends the wait: what the board reports is seen a little later, no more
_END_S = 30.0  # the coast, the rest after it and a pull over a slow link
_log = logging.getLogger(__name__)


class Closed(TailbeatError):
    """The worker ends; whatever is under way is left as it is, the tail still."""


@contextmanager
def simulated_camera(fish: Fish) -> Iterator[tuple[Camera | None, Guard | None]]:
    """The camera of a simulated board, if it is one."""
    with camera_of(fish, None) as camera:
        yield camera, None


@dataclass
class Worker:
    """``connect`` makes the Fish, in the worker's thread; a lost link is connected again, with
    what was wrong in ``now.problem`` meanwhile. ``root``: of new experiments. ``open_camera`` opens
    the camera for each series. ``limits``: of the preflight checks. ``look_s``: how long a
    request may lie while the tail beats; ``retry_s``: between two tries to connect. ``stream``:
    where what the board reports is sent. ``picture``: the camera's last one, if it takes any.
    ``walls``: corners of the water in the camera's frame, if they are known."""

    connect: Callable[[], Fish]
    root: Path
    open_camera: OpenCamera = simulated_camera
    limits: PreflightLimits = field(default_factory=PreflightLimits)
    stream: StreamAddress | None = None
    picture: LastPicture | None = None
    walls: tuple[Point, ...] = ()
    wall_s: Callable[[], float] = time.monotonic
    look_s: float = 0.05
    retry_s: float = 1.0

    def __post_init__(self) -> None:
        self._asks = Asks()
        self.screen = Screen()
        self.screen.set(pictures=self.picture is not None, walls=self.walls)
        self.trials = PageTrials(self.root, self.screen)
        self._requests: dict[str, Callable[..., object]] = {
            "swim": self._swim,
            "upload": self._upload,
            "clear": self._clear,
            "params": self._read_params,
            "set": self._set,
            "health": self._health,
            "report": lambda fish: self.trials.report(),
            "note": lambda fish, text, at: self.trials.note(text, at),
        }
        self._thread = threading.Thread(target=self._run, name="worker", daemon=True)
        self._camera: Camera | None = None
        self._heard_s: float | None = None
        self._board_s = 0.0
        self._imu_changed = False
        self._restarted = False

    @property
    def now(self) -> PageState:
        """The latest snapshot."""
        return self.screen.now

    def start(self) -> None:
        """Begins the thread."""
        self._thread.start()

    def ask(self, what: str, **values: Any) -> None:
        """``swim`` {until, preflight, law, commission}, ``abort``, ``decide`` {kind, reason},
        ``answer`` {yes, typed}, ``upload`` {reference}, ``note`` {text}, ``clear``, ``params``,
        ``set`` {name, value}, ``health``, ``report``. Never blocks; what came of it is in
        ``now``. ``abort`` overtakes everything. Raises InputError for what makes no sense now."""
        if what == "abort":
            self._asks.want_abort()
            return
        self._asks.offer(Ask.of(what, values))

    @property
    def wants_abort(self) -> bool:
        """Whether somebody wants the tail to stop."""
        return self._asks.abort

    def silent_s(self) -> float | None:
        """Since when the board has said nothing; None = it has not been heard yet."""
        return None if self._heard_s is None else self.wall_s() - self._heard_s

    def close(self) -> None:
        """Stops the tail if it beats, ends the thread and the connection."""
        self._asks.close()
        if self._thread.is_alive():
            self._thread.join(_END_S)

    def set_phase(self, phase: Phase, *open_: str, **changes: Any) -> None:
        """What is shown first, then what may be asked: nobody is offered what is refused."""
        dropped = self._asks.open(*open_)
        self.screen.set(phase=phase, **changes)
        for ask in dropped:
            self.screen.say(f"'{ask.kind}' was requested but not executed: press again")

    # The thread.

    def _run(self) -> None:
        while not self._asks.closed:
            try:
                self._connected()
            except Closed:
                break
            except (TailbeatError, OSError) as error:
                self.set_phase("connecting", state="", step="", left_s=None)
                self.screen.trouble(error)
            except Exception as error:
                _log.exception("the page's thread has failed")
                self.set_phase("failed", problem=state.unexpected(error))
                return
            self._asks.wait_closed(self.retry_s)

    def _connected(self) -> None:
        with self.connect() as fish, streaming(fish.link, self.stream):
            stop = fish.link.subscribe(self._hear)
            try:
                if self._asks.abort:
                    self._stop_tail(fish)
                self._greet(fish)
                while not self._asks.closed:
                    self._idle(fish)
            finally:
                if self._asks.closed:
                    with contextlib.suppress(TailbeatError):
                        self._stop_tail(fish)
                stop()

    def _greet(self, fish: Fish) -> None:
        info = fish.info()
        self._heard()
        self._restarted = False
        self.screen.show(
            state.by_status(
                replace(
                    self.now,
                    connection=info.connection,
                    simulated=info.simulated,
                    board=info.board,
                    unique_id=info.unique_id,
                    problem="",
                ),
                info.status,
            )
        )
        self._look_at_imu(fish)
        self.look_at_reference(fish)
        self._read_params_again(fish)
        self.trials.find(fish)
        self._look_ahead(fish)
        self.screen.say(f"connected to {info.connection}")
        if line := connect_notice(fish):
            self.screen.say(line)
        self.set_phase("idle", *self._requests)

    def _idle(self, fish: Fish) -> None:
        """One look at the link and at what is asked for."""
        self._asks.wait(_IDLE_LOOKS * self.look_s)
        if fish.sim is not None:
            fish.link.run(_IDLE_LOOKS * self.look_s)  # its time passes in no time
        fish.link.flush()
        if self._asks.abort:
            self._stop_tail(fish)
        if self._restarted:
            self.screen.say("the board restarted")
            fish.clock.sync()
            self._greet(fish)
        if self._imu_changed:
            self._look_at_imu(fish)
        if (ask := self._asks.take()) is None:
            return
        if ask.kind != "note":
            self.screen.set(phase="working", problem="", failed="")
        try:
            self._requests[ask.kind](fish, **ask.values)
        except (LinkLostError, ConnectError, Closed):
            raise
        except (TailbeatError, OSError) as error:
            self.screen.trouble(error)
            self.screen.set(failed=str(ask.values.get("name", ask.kind)))
        if ask.kind != "note":
            self._settled(fish)
        self.screen.set(done=self.now.done + 1)

    def _settled(self, fish: Fish) -> None:
        """How things stand after something was done."""
        with contextlib.suppress(LinkLostError):
            self.screen.show(state.by_status(self.now, fish.status()))
            self.look_at_reference(fish)
            self._read_params_again(fish)
            self._look_ahead(fish)
        self.set_phase(
            "idle",
            *self._requests,
            step="",
            steps=(),
            left_s=None,
            recorded=None,
            question="",
            number=None,
        )

    def _clear(self, fish: Fish) -> None:
        fish.clear()
        self.screen.say("cleared")

    def _upload(self, fish: Fish, reference: Reference) -> None:
        self.trials.upload(fish, reference)
        self.screen.set(law="", guide=(), diagnosis="")  # of the reference before
        self.trials.find(fish)

    def _stop_tail(self, fish: Fish) -> None:
        """Whoever made it beat. An armed board is disarmed, one that rests stays as it is. Raises
        LinkLostError; the request stays then, for the next connection."""
        try:
            fish.abort()
            self.screen.say("stopped")
        except LinkLostError:
            raise
        except TailbeatError as error:
            self.screen.trouble(error)
        if not self._asks.closed:
            self._asks.abort_done()
        with contextlib.suppress(TailbeatError):
            if fish.status().state == "ARMED":
                fish.disarm()

    # What the board says by itself.

    def _heard(self) -> None:
        self._heard_s = self.wall_s()

    def _hear(self, message: Message) -> None:
        self._heard()
        kind = message.get_type()
        if kind == "TAILBEAT_STATUS":
            status = BoardStatus.of(message)
            self._restarted |= status.time_s < self._board_s
            self._board_s = status.time_s
            self.screen.show(state.by_status(self.now, status))
        elif kind == "TAILBEAT_HEALTH":
            self._imu_changed |= bool(message.imu_health) == bool(self.now.imu_well)
        elif kind == "TAILBEAT_BEAT" and self.now.phase != "connecting":
            self.screen.show(state.by_beat(self.now, BeatEvent.of(message)))

    def _look_at_imu(self, fish: Fish) -> None:
        """Its state, and what the board has counted of it."""
        self._imu_changed = False
        info, bits = fish.imu_info(), int(fish.health()["imu_health"])
        faults = [f"{what}. {remedy}".strip() for what, remedy in imu_health(bits)]
        if info.state != "streaming":
            faults = [f"{info.problem.meaning}. {info.problem.remedy}"]
        words = " ".join(faults) or f"{info.model or 'the IMU'} streams as it should"
        self.screen.set(imu=words, imu_well=not faults)

    def look_at_reference(self, fish: Fish) -> None:
        record = fish.reference_record()
        params = fish.params.values("AMP_MAX_RAD", "BATT_LOW_V", "TANK_LEN_M", "FISH_LEN_M")
        found = decode_reference(record) if record is not None else None
        speeds = tuple(map(float, found.speed_m_s)) if found else ()
        if speeds != self.now.reference_m_s:
            none = (None,) * len(speeds)
            self.screen.set(speed_m_s=none, amplitude_rad=none, trial=None, run="")
        self.screen.set(
            reference_m_s=speeds,
            beat_s=found.beat_s if found else 1.0,
            amplitude_max_rad=params["AMP_MAX_RAD"],
            battery_low_v=params["BATT_LOW_V"],
            end_walls_m=state.end_walls_m(params["TANK_LEN_M"], params["FISH_LEN_M"]),
        )

    def _look_ahead(self, fish: Fish) -> None:
        """How far the trial that START begins will come."""
        try:
            travel, room_m = "", None
            if self.now.reference_m_s:
                found = travel_next(fish, library_of(fish), planned=True)
                travel, room_m = view.travel_line(found), found.room_m
        except LinkLostError:
            raise
        except TailbeatError as error:
            travel, room_m = state.on_the_page(str(error)), None
        self.screen.set(travel=travel, room_m=room_m)

    # A series.

    def _swim(
        self, fish: Fish, until: Until, preflight: bool, law: LawName, commission: Commission
    ) -> None:
        """Trials; with ``commission`` the whole guided job."""
        self._asks.open("note")
        self.screen.set(
            steps=(), guide=(), diagnosis="", phase="preflight" if preflight else "working"
        )
        limits = self.limits if preflight else None
        options = Options(until, limits, counts=KINDS, law=law, proposes=True)
        try:
            with self.open_camera(fish) as (self._camera, guard):
                end = self._run_series(fish, options, commission, self._seen_by(guard))
        finally:
            self.trials.refresh()
        if end is None:
            return
        if commission != "never":
            ended = StepEnded("trials", end.why not in _BROKEN_OFF, end.words)
            PageOperator(self, fish).tell(ended)
        else:
            self.screen.say(end.words)
        if end.why in _BROKEN_OFF:
            self.screen.set(problem=state.on_the_page(end.words))
        if commission != "never" and end.rounds:
            self.trials.report()

    def _run_series(
        self, fish: Fish, options: Options, commission: Commission, guard: Guard
    ) -> SeriesEnd | None:
        """None: the guided job ended before its trials, as the page shows."""
        operator, place = PageOperator(self, fish), partial(self.trials.for_series, fish)
        if commission == "never":
            give_back(fish, operator)
            self.look_at_reference(fish)
            return Trials(fish, operator, options, place, self._camera, guard).run()[0]
        asked = StartOptions(series=options, anew=commission == "anew")
        end = run_start(fish, operator, asked, place, self._camera, guard)
        if end.series is None:
            self.screen.set(problem=state.on_the_page(end.steps[-1].words))
        return end.series

    def _seen_by(self, guard: Guard | None) -> Guard:
        """Also shows where the fish is."""

        def see(seen: object) -> None:
            if isinstance(seen, Frame):
                shown = state.by_place(self.now, (seen.x_m, seen.y_m), seen.heading_rad)
                if shown is not self.now:
                    self.screen.show(shown)

        return all_guards(guard, see)

    def _health(self, fish: Fish) -> None:
        with self.open_camera(fish) as (self._camera, _):
            operator, words = PageOperator(self, fish), "Check the fish's health"
            operator.tell(check_health(fish, self._camera, operator, words, False))

    def _read_params(self, fish: Fish) -> None:
        self.screen.set(params=tuple(fish.params.list().values()))

    def _read_params_again(self, fish: Fish) -> None:
        """Where somebody has unfolded them: a job may have set some, a restart all."""
        if self.now.params:
            self._read_params(fish)

    def _set(self, fish: Fish, name: str, value: float) -> None:
        """A larger amplitude limit only as far as a run went without a fault."""
        if name == AMP_MAX:
            require_tried(fish, value)
        set_and_save(fish, {name: value})
        self.screen.say(f"{name} = {value:g}, saved")

    def answered(self, fish: Fish, kind: str, **shown: Any) -> Ask:
        """Waits for an answer; link and camera are kept meanwhile, as far as there are any. ABORT
        says no; a trial has still to be decided on."""
        self.set_phase("deciding" if kind == "decide" else "asking", kind, "note", **shown)
        while not self._asks.closed:
            patience_s = self.look_s if fish.sim is not None else 0.0
            try:
                fish.link.run(self.look_s)
            except LinkLostError:  # whoever talks to the board next finds that out
                patience_s = self.look_s
            self._drain_camera()
            self._asks.wait(patience_s, kind, "note")
            while (note := self._asks.take("note")) is not None:
                self.trials.note(**note.values)
            if kind == "answer" and self._asks.abort:
                return Ask(kind, {"yes": False, "typed": ""})
            if (ask := self._asks.take(kind)) is not None:
                return ask
        raise Closed("the page was closed.", "The trial waits on the board.")

    def _drain_camera(self) -> None:
        """One that nobody reads is cut off when too much waits. That it is gone it says once."""
        try:
            if self._camera is not None:
                self._camera.frames()
        except (TailbeatError, OSError) as error:
            self.screen.trouble(error)
