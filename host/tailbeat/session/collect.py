"""One trial of a series: executed under guards, its log saved, and what the log says.

Between trials the board is stopped, settling or idle; ``make_safe`` stops the tail.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, TailbeatError, reason
from tailbeat.core.faults import ABORT_COMMAND, REBOOT, TILT, WALL, FaultInfo, fault_info
from tailbeat.core.records import decode_reference
from tailbeat.core.speed_source import Camera, Frame, speed_source
from tailbeat.core.trial_checks import HeadingDrift, heading_drift, heading_drift_of_frames
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.experiment.current import reference_of
from tailbeat.experiment.folder import Experiment
from tailbeat.learning.convergence import score_of
from tailbeat.learning.fish_model import trial_speeds
from tailbeat.learning.fit_quality import disturbance_of
from tailbeat.link.mavlink import Message
from tailbeat.link.messages import SIMULATED_FISH, BeatEvent, BoardStatus, TrialOutcome
from tailbeat.session.events import Event, LiveValues, Operator, TrialStopped
from tailbeat.session.guards import FrameRecorder, Guard, GuardedTrial, guards_of
from tailbeat.session.log import SessionLog
from tailbeat.session.outcome import BY_HAND, Decision, Ready, RecordedTrial, StopKind, StopReason
from tailbeat.session.trial import run_trial
from tailbeat.session.trial_camera import as_csv, position_store

STOPPED = ("ABORTED", "FAULT")
_BUSY = ("BOOT", "RUNNING", "SETTLING", "LEARNING")
_IMU_REST_S = 30.0  # of board time: so long it waits for the fish to rest after a trial
_MARGIN_S = 2.0
_LOOK_S = 0.25
_SAFE_TRIES = 3


def dangerous(fault: FaultInfo) -> bool:
    """Whether somebody has to look at the fish before it swims again: the board stopped by a rule
    of its own (battery, tilt, late tick, restart), not because the link or an operator said so."""
    return fault.kind == "fault" or fault.number in (TILT, REBOOT)


def stop_words(status: BoardStatus) -> str:
    """Why the board is stopped, and what to do about it."""
    fault = status.fault
    return f"the board stopped ({fault.name}): {fault.meaning}. {fault.remedy}"


def make_safe(fish: Fish) -> None:
    """The tail still and nothing armed, as far as the board can be reached; another Ctrl-C does
    not hinder it."""
    for _ in range(_SAFE_TRIES):
        try:
            with contextlib.suppress(TailbeatError):
                _make_safe(fish)
            return
        except KeyboardInterrupt:
            continue


def _make_safe(fish: Fish) -> None:
    status = fish.status()
    if status.state == "RUNNING":
        fish.abort()
    elif status.state == "ARMED":
        fish.disarm()


def require_still(fish: Fish) -> None:
    """Raises TailbeatError when the tail beats: somebody else swims this fish."""
    if fish.status().state == "RUNNING":
        raise TailbeatError("the fish swims already", "Wait, or stop it: tailbeat stop")


def settled(fish: Fish, expected: int | None = None) -> BoardStatus:
    """The status once the last trial is over for the board, too. ``expected``: a trial that may yet
    become pending after it was cut."""
    rate = max(fish.clock.rate, 1.0)
    wait_s = fish.params.get("SETTLE_S").value + _MARGIN_S
    if fish.speed_source().needs_rests:
        wait_s += _IMU_REST_S
    end_s = fish.transport.now_s() + wait_s / rate
    while True:
        status = fish.status()
        waits = status.state in STOPPED and status.pending_trial is None
        waits = waits and expected is not None and status.trial == expected
        if (status.state not in _BUSY and not waits) or fish.transport.now_s() >= end_s:
            return status
        fish.link.run(_LOOK_S / rate)


NO_SPEED = "beats have no speed"


def unmeasured_text(trial: Trial) -> str:
    """In words; empty when every executed beat has a speed."""
    known = np.isfinite(trial.beats.speed_m_s[: trial.executed_beats])
    missing = np.flatnonzero(~known)
    if not missing.size:
        return ""
    words = f"{missing.size} of {trial.executed_beats} {NO_SPEED}"
    hole_s = _longest_hole_s(trial, missing)
    if not hole_s:
        return words
    return (
        f"{words}: none came from the camera for {hole_s:.1f} s. It did not see the fish, or this"
        " computer is too slow for it (end other programs, take smaller pictures)"
    )


def _longest_hole_s(trial: Trial, missing: np.ndarray[tuple[int], np.dtype[np.intp]]) -> float:
    """Between speeds of the camera that came in time, next to beats without one; 0: no hole is
    longer than SPD_GAP_S, or speeds did not come from a camera as it swam."""
    allowed_s = trial.params.get("SPD_GAP_S", 0.0)
    if not speed_source(trial.params).sampled or trial.uploaded or not allowed_s:
        return 0.0
    table = trial.slots.table()
    end_s = trial.executed_beats * trial.beat_s
    times = np.concatenate([[0.0], np.sort(table["t_s"][table["samples"] > 0]), [end_s]])
    begins, ends = times[:-1], times[1:]
    at_s = missing[:, None] * trial.beat_s
    touched = ((begins < at_s + trial.beat_s) & (ends > at_s)).any(axis=0)
    holes = (ends - begins)[touched]
    longest = float(holes.max()) if holes.size else 0.0
    return longest if longest > allowed_s else 0.0


_NOT_COMPLETE = "not complete:"


def record_of(
    outcome: TrialOutcome, log: TrialLog, ready: Ready | None, stopped: StopReason | None = None
) -> RecordedTrial:
    """``stopped``: why this program stopped it; None = it did not, or what the event log says."""
    stopped = stopped or log.stopped
    trial = log.trial
    measured = int(np.isfinite(trial.beats.speed_m_s).sum())
    volts = [volt for t_s, volt in trial.battery_v if t_s >= 0] or [
        volt for _, volt in trial.battery_v
    ]
    return RecordedTrial(
        outcome=outcome,
        file=log.path,
        ready=ready,
        straight=log.straight,
        max_abs_error_m_s=trial.max_abs_error_m_s(),
        rms_error_m_s=trial.rms_error_m_s(),
        measured_beats=measured,
        beats=len(trial.beats.samples),
        battery_start_v=ready.battery_v if ready else (volts[0] if volts else None),
        battery_end_v=volts[-1] if volts else None,
        problems=tuple(_problems(outcome, log, measured, stopped)),
        judged=score_of(trial).judged,
        stopped=stopped,
    )


def _problems(
    outcome: TrialOutcome, log: TrialLog, measured: int, stopped: StopReason | None
) -> list[str]:
    trial, problems = log.trial, []
    if outcome.end != "complete":
        by = f" ({stopped})" if stopped else ""
        problems.append(f"{_NOT_COMPLETE} {outcome.end}{by}")
    if measured == 0:
        problems.append("no beat has a speed: there is nothing to learn from")
    elif words := unmeasured_text(trial):
        problems.append(words)
    if log.straight is not None and log.straight.crooked:
        off_deg = math.degrees(log.straight.worst_yaw_rad)
        problems.append(f"not straight: {off_deg:+.0f} degrees off ({log.straight.source})")
    if (bump := disturbance_of(trial_speeds(trial))) is not None:
        problems.append(bump.words())
    return problems + list(trial.problems)


def is_good(recorded: RecordedTrial) -> bool:
    """Whether nobody need be asked: it was executed to its end, and nothing speaks against it but
    a few missing beats."""
    others = [one for one in recorded.problems if not (recorded.judged and NO_SPEED in one)]
    return recorded.outcome.end == "complete" and not others


def proposed_decision(recorded: RecordedTrial) -> Decision:
    """A careful default; the operator decides. It follows from the trial's
    end and its problems, which are in its log and in the event log: asked again later it is the
    same."""
    if recorded.outcome.end == _ended(WALL):
        return Decision("discard", "too close to the wall")
    if recorded.stopped == BY_HAND:
        return Decision("discard", BY_HAND.text)
    if (
        recorded.outcome.end == _ended(ABORT_COMMAND) and not recorded.stopped
    ):  # no guard of this program's
        return Decision("discard", "stopped by a command")
    if recorded.measured_beats == 0:
        return Decision("discard", "no speeds")
    return Decision("keep")


def _ended(fault: int) -> str:
    return f"aborted:{fault_info(fault).name}"


@dataclass(frozen=True)
class TrialLog:
    """A trial's raw file, and what is in it and beside it. ``stopped``: why this program stopped
    it, as the event log has it; None = it did not, or the event log does not know the trial yet."""

    path: Path
    trial: Trial
    straight: HeadingDrift | None
    stopped: StopReason | None = None


@contextlib.contextmanager
def trial_is_safe(number: int, experiment: Experiment) -> Iterator[None]:
    """What the disk refuses comes out as one line; the trial waits on the board meanwhile."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"cannot keep trial {number} in {experiment.folder} ({reason(error)}); nothing is lost,"
            " it waits on the board",
            "Make room there and run the same command again: it goes on with this trial.",
        ) from error


def peek_log(fish: Fish, experiment: Experiment, number: int) -> Trial:
    """Pulls the log and keeps nothing. Raises InputError (disk full)."""
    with trial_is_safe(number, experiment):
        return read_trial(_pull(fish, experiment, number))


def _pull(fish: Fish, experiment: Experiment, number: int) -> Path:
    folder = experiment.folder / ".pulling"
    folder.mkdir(exist_ok=True)
    return fish.pull_trial(number, folder)


def drop_peeked(experiment: Experiment, number: int) -> None:
    """Of a log that is not to be kept, and what the camera may have seen of a trial before it."""
    folder = experiment.folder / ".pulling"
    with contextlib.suppress(OSError):
        (folder / f"{number:04d}.ulg").unlink(missing_ok=True)
        position_store(experiment, number).path.unlink(missing_ok=True)
        folder.rmdir()


def keep_log(fish: Fish, experiment: Experiment, number: int) -> TrialLog:
    """Pulls the log (an interrupted pull goes on), and keeps it and the positions of the camera.
    Raises InputError (disk full)."""
    with trial_is_safe(number, experiment):
        pulled = _pull(fish, experiment, number)
        kept = experiment.keep_trial(pulled)
        trial = read_trial(kept)
        stash = position_store(experiment, number)
        frames = stash.take(trial)
        if frames:
            experiment.add_raw(f"{kept.stem}_positions.csv", as_csv(frames, 0.0).encode())
        for path in (pulled, stash.path):
            path.unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # the beginning of another trial may lie there
            pulled.parent.rmdir()
    return TrialLog(kept, trial, _straight(trial, frames), _stopped(experiment, kept))


def recover_trial(fish: Fish, log: SessionLog, number: int) -> RecordedTrial:
    """The record of a trial that nobody here saw end; its log is saved. Raises InputError."""
    found = keep_log(fish, log.experiment, number)
    recorded = record_of(outcome_of(found.trial), found, None)
    log.recorded(recorded)
    return recorded


def _stopped(experiment: Experiment, kept: Path) -> StopReason | None:
    told = [entry for entry in experiment.journal.entries("swum") if entry.get("file") == kept.name]
    if not told:
        return None
    if (stopped := told[-1].get("stopped")) is not None:
        return StopReason(StopKind(stopped["kind"]), str(stopped["text"]))
    return _stopped_before(map(str, told[-1].get("problems") or ()))


def _stopped_before(problems: Iterable[str]) -> StopReason | None:
    """Of an entry of an older version, which has the reason in the words of a problem alone."""
    for problem in problems:
        if problem.startswith(_NOT_COMPLETE) and problem.endswith(")"):
            text = problem.partition(" (")[2].removesuffix(")")
            return BY_HAND if text == BY_HAND.text else StopReason(StopKind.CALLER, text)
    return None


def _straight(trial: Trial, frames: Sequence[Frame]) -> HeadingDrift | None:
    found = heading_drift(trial)
    if found is None and frames and trial.executed_beats:
        return heading_drift_of_frames(frames, 0.0, trial.executed_beats, trial.beat_s)
    return found


def outcome_of(trial: Trial) -> TrialOutcome:
    """Of a trial that nobody here saw: as its log tells it."""
    beats = trial.beats
    events = [
        BeatEvent(
            trial.number,
            k,
            float(beats.applied_rad[k]),
            float(beats.reference_m_s[k]),
            _number(beats.speed_m_s[k]),
            _number(beats.sigma_m_s[k]),
            int(beats.samples[k]),
            bool(beats.amplitude_rad[k] > beats.applied_rad[k]),
            provisional=False,
        )
        for k in range(min(trial.executed_beats, len(beats.samples)))
    ]
    return TrialOutcome(trial.number, trial.iteration, trial.end, trial.executed_beats, events)


def _number(value: np.float32) -> float | None:
    return float(value) if np.isfinite(value) else None


_LIVE_PERIOD_S = 0.1  # of the transport's clock: what an eye follows
_RUNNING = 3  # TAILBEAT_STATE


@dataclass
class LiveReporter:
    """What the board tells while it swims, as one event now and then. A guard that stops nothing:
    it is asked all the time, so it also shows how long the link has been silent. Speed and
    reference are those of the present beat: TAILBEAT_BEAT comes some beats later."""

    fish: Fish
    operator: Operator
    simulated: bool
    reference_m_s: Sequence[float]
    KINDS: ClassVar = ("TAILBEAT_STATUS", "TAILBEAT_LIVE")
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
            if math.isfinite(message.speed_m_s):
                changes["speed_m_s"] = message.speed_m_s
        if changes.get("beat", math.inf) < len(self.reference_m_s):
            changes["reference_m_s"] = self.reference_m_s[changes["beat"]]
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
    """What a trial is done with. ``guard``: of the caller."""

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
    around: TrialSetup, experiment: Experiment, guarded: GuardedTrial, heading_rad: float
) -> ExecutedTrial:
    """Swims the next trial and keeps what the camera saw. Raises what
    run_trial raises."""
    fish, operator = around.fish, around.operator
    record = reference_of(experiment)
    reference_m_s = () if record is None else decode_reference(record).speed_m_s.tolist()
    live = LiveReporter(fish, operator, fish.info().board in SIMULATED_FISH, reference_m_s)
    stopped: list[StopReason] = []

    def on_event(event: Event) -> None:
        if isinstance(event, TrialStopped):
            stopped.append(event.reason)
        operator.tell(event)

    seen, camera = FrameRecorder(), around.camera
    guard = guards_of(guarded, seen, live)
    stop_listening = fish.link.subscribe(live.hear, LiveReporter.KINDS)
    try:
        outcome = run_trial(
            fish, camera, on_event, guard, around.reconnect_s, direction_rad=heading_rad
        )
        if camera is not None:
            with trial_is_safe(outcome.number, experiment):
                position_store(experiment, outcome.number).put(seen.frames, camera, fish.clock)
    finally:
        stop_listening()
    return ExecutedTrial(outcome, stopped[0] if stopped else None)
