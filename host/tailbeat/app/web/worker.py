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
from datetime import datetime
from pathlib import Path
from typing import Any

from tailbeat.app.web.inbox import Ask, Asks
from tailbeat.app.web.view import PageState, Phase, after, by_beat, by_status, logged, travel_line
from tailbeat.board.fish import Fish
from tailbeat.board.provision import connect_notice
from tailbeat.core.errors import ConnectError, InputError, LinkLostError, TailbeatError, reason
from tailbeat.core.frames import Camera
from tailbeat.core.records import decode_reference
from tailbeat.core.reference import Reference, ReferenceLimits
from tailbeat.experiment import current as notes
from tailbeat.experiment.analysis import analyse
from tailbeat.experiment.current import begin, current, make, note_board, note_set, require_same
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import library_of, name_reference
from tailbeat.link.mavlink import Message
from tailbeat.link.messages import BeatEvent, BoardStatus, LearnReport, imu_health
from tailbeat.session.events import Event, TrialDecided
from tailbeat.session.guards import Guard
from tailbeat.session.outcome import KINDS, Decision, RecordedTrial
from tailbeat.session.preflight_step import PreflightLimits
from tailbeat.session.series import Options, Until, run_series
from tailbeat.session.travel import travel_next
from tailbeat.session.trial_camera import camera_of

OpenCamera = Callable[["Fish"], AbstractContextManager[tuple["Camera | None", "Guard | None"]]]
"""Opens the camera of a series, and the guard that goes with it."""

IDLE_ASKS = ("swim", "upload", "set", "note", "clear", "fresh")
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
    the camera for each series. ``wanted``: of the preflight checks, None = the usual. ``look_s``:
    how long a wish may lie; ``retry_s``: between two tries to connect."""

    connect: Callable[[], Fish]
    root: Path
    open_camera: OpenCamera = simulated_camera
    wanted: PreflightLimits | None = None
    now: PageState = field(default_factory=PageState)
    wall_s: Callable[[], float] = time.monotonic
    look_s: float = 0.05
    retry_s: float = 1.0

    def __post_init__(self) -> None:
        self._asks = Asks()
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="worker", daemon=True)
        self._heard_s: float | None = None
        self._board_s = 0.0
        self._imu_changed = False
        self._restarted = False
        self._reference: Reference | None = None
        self._experiment: Experiment | None = None

    def start(self) -> None:
        """Begins the thread."""
        self._thread.start()

    def ask(self, what: str, **values: Any) -> None:
        """``trial`` {until, ritual}, ``abort``, ``decide`` {kind, reason}, ``answer`` {yes},
        ``upload`` {reference}, ``set`` {name, value}, ``note`` {text}, ``clear``, ``fresh`` (a new
        experiment). Never blocks; what came of it is in ``now``. ``abort`` overtakes everything.
        Raises InputError for what makes no sense now."""
        if what == "abort":
            self._asks.want_abort()
            return
        self._asks.offer(_sensible(what, values))

    def silent_s(self) -> float | None:
        """Since when the board has said nothing; None = it has not been heard yet."""
        return None if self._heard_s is None else self.wall_s() - self._heard_s

    def raw_file(self, name: str) -> Path | None:
        """A file of the experiment's raw ones; only those listed in ``now.rows``."""
        experiment = self._experiment
        if experiment is None or name not in {Path(row.file).name for row in self.now.rows}:
            return None
        return experiment.raw / name

    def wait(self, until: Callable[[PageState], bool], patience_s: float = 10.0) -> PageState:
        """The first snapshot for which ``until`` holds. Raises TimeoutError."""
        with self._changed:
            if not self._changed.wait_for(lambda: until(self.now), patience_s):
                raise TimeoutError(f"still {self.now}")
            return self.now

    def close(self) -> None:
        """Stops the tail if it beats, ends the thread and the connection."""
        self._asks.close()
        if self._thread.is_alive():
            self._thread.join(_END_S)

    def _show(self, snapshot: PageState) -> None:
        """Only ever called in the worker's thread: snapshots do not overtake each other."""
        with self._changed:
            self.now = replace(snapshot, serial=self.now.serial + 1)
            self._changed.notify_all()

    def _set(self, **changes: Any) -> None:
        self._show(replace(self.now, **changes))

    def _say(self, text: str) -> None:
        self._show(logged(self.now, text, _clock()))

    def _trouble(self, error: Exception) -> None:
        words = _from_the_page(str(error) if isinstance(error, TailbeatError) else reason(error))
        new = words != self.now.problem
        self._set(problem=words)
        if new:
            self._say(words)

    def _phase(self, phase: Phase, *open_: str, **changes: Any) -> None:
        """What is shown first, then what may be asked: nobody is offered what is refused."""
        dropped = self._asks.open(*open_)
        self._set(phase=phase, **changes)
        for ask in dropped:
            self._say(f"'{ask.kind}' was asked for, but not done: ask again")

    # The thread.

    def _run(self) -> None:
        while not self._asks.closed:
            try:
                self._connected()
            except Closed:
                break
            except (TailbeatError, OSError) as error:
                self._phase("connecting", state="", step="", left_s=None)
                self._trouble(error)
            except Exception as error:
                _log.exception("the page's thread has failed")
                self._phase("failed", problem=_unexpected(error))
                return
            self._asks.wait_closed(self.retry_s)

    def _connected(self) -> None:
        with self.connect() as fish:
            stop = fish.link.subscribe(self._hear)
            try:
                if self._asks.abort:
                    self._stop_tail(fish)
                self._greet(fish)
                while not self._asks.closed:
                    self._idle(fish)
            finally:
                if self._asks.closed:
                    self._stop_tail(fish)
                stop()

    def _greet(self, fish: Fish) -> None:
        info = fish.info()
        self._heard()
        self._restarted = False
        self._show(
            by_status(
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
        self._look_at_reference(fish)
        self._find_experiment(fish)
        self._look_ahead(fish)
        self._say(f"connected to {info.connection}")
        if line := connect_notice(fish):
            self._say(line)
        self._phase("idle", *IDLE_ASKS)

    def _idle(self, fish: Fish) -> None:
        """One look at the link and at what is wanted."""
        if fish.sim is not None:
            self._asks.wait(self.look_s)  # its time passes in no time; a page's must not
        fish.link.run(self.look_s)
        if self._asks.abort:
            self._stop_tail(fish)
        if self._restarted:
            self._say("the board has restarted")
            fish.clock.sync()
            self._greet(fish)
        if self._imu_changed:
            self._look_at_imu(fish)
        if (ask := self._asks.take()) is None:
            return
        if ask.kind != "note":
            self._set(phase="working", problem="")
        try:
            self._do(fish, ask)
        except (LinkLostError, ConnectError, Closed):
            raise
        except (TailbeatError, OSError) as error:
            self._trouble(error)
        if ask.kind != "note":
            self._settled(fish)
        self._set(done=self.now.done + 1)

    def _settled(self, fish: Fish) -> None:
        """How things stand after something was done."""
        with contextlib.suppress(LinkLostError):
            self._show(by_status(self.now, fish.status()))
            self._look_ahead(fish)
        self._phase("idle", *IDLE_ASKS, step="", steps=(), left_s=None, recorded=None, question="")

    def _do(self, fish: Fish, ask: Ask) -> None:
        values = ask.values
        if ask.kind == "swim":
            self._swim(fish, values["until"], values["ritual"])
        elif ask.kind == "upload":
            self._upload(fish, values["reference"])
        elif ask.kind == "set":
            self._set_param(fish, values["name"], values["value"])
        elif ask.kind == "clear":
            fish.clear()
            self._say("cleared")
        elif ask.kind == "fresh":
            self._begin(fish)
        elif ask.kind == "note":
            self._note(ask)

    def _set_param(self, fish: Fish, name: str, value: float) -> None:
        """Noted in the experiment the page goes on in; without one in the trial library alone."""
        held = fish.params.set(name, value)
        if self._experiment is not None:
            note_set(fish, {held.name: held.value}, self._experiment)
        else:
            note_board(fish, {held.name: held.value})
        self._say(f"{name} is {value:g} now")

    def _stop_tail(self, fish: Fish) -> None:
        """Whoever made it beat. An armed board is disarmed, one that rests stays as it is."""
        with contextlib.suppress(TailbeatError):
            fish.abort()
            if fish.status().state == "ARMED":
                fish.disarm()
            self._say("stopped")
        if not self._asks.closed:
            self._asks.abort_done()

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
            self._show(by_status(self.now, status))
        elif kind == "TAILBEAT_HEALTH":
            self._imu_changed |= bool(message.imu_health) == bool(self.now.imu_well)
        elif kind == "TAILBEAT_BEAT" and self.now.phase != "connecting":
            self._show(by_beat(self.now, BeatEvent.of(message)))

    def _look_at_imu(self, fish: Fish) -> None:
        """Its state, and what the board has counted of it."""
        self._imu_changed = False
        info, bits = fish.imu_info(), int(fish.health()["imu_health"])
        faults = [f"{what}. {remedy}".strip() for what, remedy in imu_health(bits)]
        if info.state != "streaming":
            faults = [f"{info.problem.meaning}. {info.problem.remedy}"]
        words = " ".join(faults) or f"{info.model or 'the IMU'} streams as it should"
        self._set(imu=words, imu_well=not faults)

    def _look_at_reference(self, fish: Fish) -> None:
        record = fish.reference_record()
        params = fish.params.values("AMP_MAX_RAD", "BATT_LOW_V")
        found = decode_reference(record) if record is not None else None
        speeds = tuple(map(float, found.speed_m_s)) if found else ()
        none = (None,) * len(speeds)
        self._set(
            reference_m_s=speeds,
            beat_s=found.beat_s if found else 1.0,
            speed_m_s=none,
            amplitude_rad=none,
            trial=None,
            amplitude_max_rad=params["AMP_MAX_RAD"],
            battery_low_v=params["BATT_LOW_V"],
        )

    def _look_ahead(self, fish: Fish) -> None:
        """How far the trial that START begins will come."""
        try:
            travel = ""
            if self.now.reference_m_s:
                travel = travel_line(travel_next(fish, library_of(fish)))
        except LinkLostError:
            raise
        except TailbeatError as error:
            travel = str(error)
        limit = fish.params.get("AMP_MAX_RAD").value
        self._set(travel=travel, amplitude_max_rad=limit)

    # The experiment.

    def _find_experiment(self, fish: Fish) -> None:
        """The one this fish is in, if it can go on there."""
        found = current(fish)
        try:
            if found is not None:
                require_same(fish, found)
        except InputError as another:
            if fish.status().reference_crc is None:  # what it has learned is to be given back
                self._trouble(another)
            else:
                self._say(f"not going on in {found.name if found else ''}: {another}")
            found = None
        if found is not None and self._swam_before(fish, found):
            self._say(f"not going on in {found.name}: this board has begun anew since")
            found = None
        self._go_on_in(found)

    @staticmethod
    def _swam_before(fish: Fish, experiment: Experiment) -> bool:
        """Whether the board knows nothing of what the folder holds: a simulated one that was
        started again. One that was given back what it had learned goes on."""
        status = fish.status()
        there = (experiment.raw / f"{status.next_trial:04d}.ulg").exists()
        return there and status.iteration == 0

    def _begin(self, fish: Fish) -> None:
        named = self._reference
        if named is not None and named.crc == fish.status().reference_crc:
            made = make(fish, self.root, named)
        else:
            made = begin(fish, self.root)
        self._say(f"new experiment {made.folder}")
        self._go_on_in(made)

    def _go_on_in(self, experiment: Experiment | None) -> None:
        """From now on; with the notes that waited for it."""
        self._experiment = experiment
        if experiment is not None:
            try:
                if count := notes.bring(self.root, self.now.unique_id, experiment):
                    self._say(f"{count} earlier note(s) written into {experiment.name}")
            except (TailbeatError, OSError) as error:
                self._trouble(error)
        self._look_at_trials()

    def _look_at_trials(self) -> None:
        name = self._experiment.name if self._experiment is not None else ""
        if self._experiment is None or not any(self._experiment.raw.glob("*.ulg")):
            self._set(rows=(), floor_m_s=None, start_error_m_s=None, verdict="", experiment=name)
            return
        try:
            found = analyse(self._experiment)
        except (TailbeatError, OSError) as error:
            self._set(experiment=name)
            self._trouble(error)
            return
        self._set(
            rows=tuple(found.rows),
            floor_m_s=found.floor_m_s,
            start_error_m_s=found.start_error_m_s,
            experiment=name,
        )

    def _upload(self, fish: Fish, reference: Reference) -> None:
        limits = ReferenceLimits.from_params(fish.params.values())
        if problems := reference.check(limits):
            raise InputError(
                " ".join(p.meaning for p in problems), " ".join(p.remedy for p in problems)
            )
        fish.upload_reference(reference)
        name_reference(fish, reference)
        self._reference = reference
        self._say(
            f"reference {reference.name}: {reference.beats} beats, {reference.travel_m:.2f} m"
        )
        self._look_at_reference(fish)
        self._find_experiment(fish)

    def _note(self, ask: Ask) -> None:
        """One that cannot be written stops nothing else."""
        text, at = str(ask.values["text"]), ask.values["at"]
        try:
            if self._experiment is not None:
                self._experiment.note(text, at)
                self._say(f"noted: {text}")
            else:
                notes.put_by(self.root, self.now.unique_id, text, at)
                self._say(f"noted, for the experiment that the first trial begins: {text}")
        except (TailbeatError, OSError) as error:
            self._trouble(error)

    # A series.

    def _swim(self, fish: Fish, until: str, ritual: bool) -> None:
        wanted = (self.wanted or PreflightLimits()) if ritual else None
        options = Options(until=Until.parse(until), wanted=wanted, counts=KINDS)
        if self._experiment is None or self._swam_before(fish, self._experiment):
            self._begin(fish)
        assert self._experiment is not None
        self._asks.open("note")
        self._set(steps=(), phase="ritual" if ritual else "working")
        try:
            with self.open_camera(fish) as (camera, guard):
                end = run_series(
                    fish, self._experiment, PageOperator(self, fish), options, camera, guard
                )
        finally:
            self._look_at_trials()
        self._say(end.words)
        if end.why == "stopped":
            self._set(problem=_from_the_page(end.words))

    def _answered(self, fish: Fish, kind: str, **shown: Any) -> Ask:
        """Waits for an answer; the link is kept meanwhile, as far as there is one. ABORT says no; a
        trial has still to be decided on."""
        self._phase("deciding" if kind == "decide" else "asking", kind, "note", **shown)
        while not self._asks.closed:
            patience_s = self.look_s if fish.sim is not None else 0.0
            try:
                fish.link.run(self.look_s)
            except LinkLostError:  # whoever talks to the board next finds that out
                patience_s = self.look_s
            self._asks.wait_for(patience_s, kind, "note")
            self._write_notes()
            if kind == "answer" and self._asks.abort:
                return Ask(kind, {"yes": False})
            if (ask := self._asks.take(kind)) is not None:
                return ask
        raise Closed("the page was closed.", "The trial waits on the board.")

    def _write_notes(self) -> None:
        while (note := self._asks.take("note")) is not None:
            self._note(note)


@dataclass(frozen=True)
class PageOperator:
    """The operator at a browser."""

    worker: Worker
    fish: Fish

    def tell(self, event: Event) -> None:
        """Shown at once."""
        worker = self.worker
        worker._show(after(worker.now, event, _clock()))
        match event:
            case LearnReport() | TrialDecided(_, Decision("repeat" | "discard")):
                worker._look_at_trials()

    def wants_abort(self) -> bool:
        """The flag itself."""
        return self.worker._asks.abort

    def decide(self, recorded: RecordedTrial) -> Decision:
        """Whoever decides first decides."""
        self.worker._look_at_trials()
        ask = self.worker._answered(self.fish, "decide", recorded=recorded, step="", left_s=None)
        self.worker._phase("working", "note", recorded=None, steps=())
        return Decision(ask.values["kind"], ask.values["reason"])

    def confirm(self, question: str) -> bool:
        """Likewise."""
        ask = self.worker._answered(self.fish, "answer", question=question)
        self.worker._phase("working", "note", question="")
        return bool(ask.values["yes"])


def _from_the_page(words: str) -> str:
    """Commands need the port that the page holds."""
    if "tailbeat session" not in words and "tailbeat params" not in words:
        return words
    return f"{words.rstrip('.')}. End this page first: Ctrl-C where tailbeat session web runs."


def _sensible(what: str, values: dict[str, Any]) -> Ask:
    """Checked where it is asked, so that who asked hears of it."""
    if what == "swim":
        until = str(values.get("until", "1"))
        Until.parse(until)
        return Ask(what, {"until": until, "ritual": bool(values.get("ritual", True))})
    if what == "decide":
        made = Decision(values["kind"], str(values.get("reason", "")).strip())
        return Ask(what, {"kind": made.kind, "reason": made.reason})
    if what == "note":
        text = " ".join(str(values["text"]).split())
        if not text:
            raise InputError("the note is empty.", "Write what you want to remember.")
        return Ask(what, {"text": text, "at": datetime.now()})
    return Ask(what, values)


def _clock() -> str:
    return datetime.now().strftime("%H:%M:%S")


def _unexpected(error: Exception) -> str:
    return (
        f"something went wrong that should not ({type(error).__name__}: {error})."
        " Switch the fish off if its tail beats, start 'tailbeat session web' again and report "
        "this."
    )
