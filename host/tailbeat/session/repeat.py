"""One repeat of the best after the hull was open: it tells how far the fish has shifted."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace

from tailbeat.board.fish import Fish
from tailbeat.board.snapshot import Snapshot
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.faults import NO_BEST, refusal
from tailbeat.core.frames import Camera
from tailbeat.core.records import decode_learned
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.experiment.board_state import copy_state
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import library_of
from tailbeat.learning.assessment import series_of
from tailbeat.learning.convergence import input_crc
from tailbeat.learning.fish_model import FishModel
from tailbeat.learning.identification import Identified
from tailbeat.link.messages import BoardStatus
from tailbeat.session.collect import (
    STOPPED,
    keep_log,
    make_safe,
    outcome_of,
    proposed,
    record_of,
    settled,
)
from tailbeat.session.events import Event, Notice, TrialRecorded
from tailbeat.session.guards import Guard
from tailbeat.session.identify import prior_of
from tailbeat.session.log import AGAIN, SessionLog, held_before, repeat_path, write_held
from tailbeat.session.operator import Operator
from tailbeat.session.outcome import Decision, RecordedTrial
from tailbeat.session.preflight.step import GivenUp
from tailbeat.session.series import Options, Until, swim_series
from tailbeat.session.shift import Shift, require_best, shift_of

__all__ = ["Shift", "end_repeat", "held_before", "idle", "repeat_best", "write_held"]

REASON = "battery swap"
_RESTORED_INPUT = 3  # what made the amplitudes that swim next, memory_input_t
_TRIES = 3
_DISCARDS_MAX = 3


def idle(fish: Fish) -> BoardStatus:
    """Its status; a board that has just been switched on is not IDLE at once. Raises InputError."""
    status = settled(fish)
    if status.state != "IDLE":
        what = f" ({status.fault.name}: {status.fault.meaning})" if status.fault.number else ""
        raise InputError(
            f"the board is {status.state}{what}, not IDLE.",
            f"tailbeat board clear or tailbeat board disarm, then: {AGAIN}",
        )
    return status


def repeat_best(
    fish: Fish,
    experiment: Experiment,
    operator: Operator,
    options: Options,
    camera: Camera | None = None,
    guard: Guard | None = None,
) -> tuple[RecordedTrial, Shift]:
    """Swims the best amplitudes once (through the ritual, journalled as a repeat, not learned),
    then puts back the amplitudes and the iteration that were to swim next, also when it fails. A
    repeat that an earlier call left on the board is taken as it is. Raises what the series raises,
    GivenUp, and InputError when there is no best, or nothing of it to compare with."""
    account = SessionLog(experiment, experiment.journal)
    before = account.counting()
    held = held_before(experiment)
    status = idle(fish)
    if status.pending_trial is not None and not _swam_the_best(fish, held, status.pending_trial):
        raise InputError(
            f"trial {status.pending_trial} waits on the board, neither learned nor discarded.",
            f"tailbeat learn, or tailbeat trial discard --reason WHY; then: {AGAIN}",
        )
    if status.pending_trial is None:
        end_repeat(fish, experiment)
        held = _begin_repeat(fish, experiment, before, status)
    assert held is not None
    try:
        if status.pending_trial is not None:
            recorded = _left_over(fish, experiment, account, operator)
        else:
            fish.restore_best()
            recorded = _swum(fish, experiment, operator, options, camera, guard)
    finally:
        _put_back(fish, experiment, held)
    shift = _judged(fish, before, recorded)
    experiment.journal.add("shifted", **asdict(shift))
    return recorded, shift


def _begin_repeat(
    fish: Fish, experiment: Experiment, before: list[Trial], status: BoardStatus
) -> Snapshot:
    learned = fish.learned_record()
    if status.best_iteration is None or learned is None:
        raise refusal(NO_BEST)
    require_best(_series(fish, before), input_crc(fish.amplitudes(best=True).values))
    held = Snapshot("", {}, next_trial=status.next_trial, learned=learned)
    write_held(experiment, held)
    return held


def _swum(
    fish: Fish,
    experiment: Experiment,
    operator: Operator,
    options: Options,
    camera: Camera | None,
    guard: Guard | None,
) -> RecordedTrial:
    """One swim that counts, by the machinery of a series."""
    one = replace(options, until=Until(swims=1), learn=True, counts=("repeat",), of_best=True)
    end = swim_series(fish, experiment, _Repeating(operator), one, camera, guard)
    if end.why == "swims" and end.rounds:
        return end.rounds[-1].recorded

    raise GivenUp(f"no repeat was swum: {end.words}", f"When it is put right: {AGAIN}")


@dataclass
class _Repeating:
    """The operator, who is asked only whether the swim counts at all."""

    operator: Operator
    discards: int = field(default=0, init=False)

    def tell(self, event: Event) -> None:
        self.operator.tell(event)

    def wants_abort(self) -> bool:
        return self.operator.wants_abort()

    def confirm(self, question: str) -> bool:
        return self.operator.confirm(question)

    def decide(self, recorded: RecordedTrial) -> Decision:
        decision = self.operator.decide(recorded)
        if decision.kind != "discard" and not recorded.judged:
            why = proposed(recorded)
            text = why.reason or f"{recorded.measured_beats} of {recorded.beats} beats have a speed"
            decision = Decision("discard", f"tells no shift: {text}")
        if decision.kind != "discard":
            return Decision("repeat", REASON)
        self.discards += 1
        if self.discards >= _DISCARDS_MAX:
            raise TailbeatError(
                f"{self.discards} repeats came to nothing, the last one: {decision.reason}.",
                f"Put it right, then: {AGAIN}",
            )
        return decision


def _left_over(
    fish: Fish, experiment: Experiment, account: SessionLog, operator: Operator
) -> RecordedTrial:
    """The repeat of an earlier call that was broken off after the swim."""
    number = fish.status().pending_trial
    assert number is not None
    text = f"trial {number} is the repeat of an earlier call; it is not swum again"
    operator.tell(Notice(text))
    log = keep_log(fish, experiment, number)
    recorded = record_of(outcome_of(log.trial), log, None)
    account.recorded(recorded)
    operator.tell(TrialRecorded(recorded))
    decision = account.decision_on(recorded.file)
    if decision is None:
        decision = _Repeating(operator).decide(recorded)
        account.decided(recorded, decision)
    if decision.kind == "discard":
        raise TailbeatError(f"the repeat was discarded: {decision.reason}.", f"Again: {AGAIN}")
    if (book := library_of(fish)) is not None:
        book.keep(recorded.file)
    return recorded


def _put_back(fish: Fish, experiment: Experiment, held: Snapshot) -> None:
    """Ctrl-C does not stop it halfway. What fails is done by the next call: the file stays."""
    for attempt in range(1, _TRIES + 1):
        try:
            _undo(fish, experiment, held)
            return
        except KeyboardInterrupt:
            if attempt == _TRIES:
                raise
        except TailbeatError as error:
            raise TailbeatError(
                "the amplitudes that were to swim next could not be put back "
                f"({error.message.rstrip('.')}); they are kept in {repeat_path(experiment)}",
                f"Connect again, then: {AGAIN}",
            ) from error


def _undo(fish: Fish, experiment: Experiment, held: Snapshot) -> None:
    make_safe(fish)
    status = settled(fish)
    if status.state in STOPPED:
        fish.clear()
    pending = fish.status().pending_trial
    if pending is not None and not _swam_the_best(fish, held, pending):
        raise TailbeatError(f"trial {pending} waits on the board")
    if pending is not None:
        fish.discard(pending)  # its log stays on the board
    if held.learned is not None and fish.learned_record() != held.learned:
        fish.upload_learned(held.learned)
    copy_state(fish, experiment)
    repeat_path(experiment).unlink(missing_ok=True)


def _swam_the_best(fish: Fish, held: Snapshot | None, pending: int) -> bool:
    """Whether the trial that waits is the repeat, which nobody has learned from."""
    return held is not None and pending >= held.next_trial and _has_the_best(fish, held)


def _has_the_best(fish: Fish, held: Snapshot) -> bool:
    """Whether the best amplitudes are still in the place of those that were to swim next."""
    mine = fish.learned_record()
    if mine is None or held.learned is None:
        return False
    now, wanted = decode_learned(mine), decode_learned(held.learned)
    same = (now.reference_crc, now.iteration) == (wanted.reference_crc, wanted.iteration)
    return same and now.input == _RESTORED_INPUT


def end_repeat(fish: Fish, experiment: Experiment) -> None:
    """What a repeat that was broken off has left: the best as the next to swim. A board that has
    learned since, or was given something else, is left alone."""
    if (held := held_before(experiment)) is None:
        return
    if held.learned is not None and _has_the_best(fish, held):
        fish.upload_learned(held.learned)
        copy_state(fish, experiment)
    repeat_path(experiment).unlink(missing_ok=True)


def _judged(fish: Fish, before: list[Trial], recorded: RecordedTrial) -> Shift:
    identified = _identified(fish)
    repeat = read_trial(recorded.file)
    earlier = [trial for trial in _series(fish, before) if trial.number != repeat.number]
    return shift_of(earlier, repeat, _model(fish, identified), identified, recorded.straight)


def _series(fish: Fish, trials: list[Trial]) -> list[Trial]:
    """The last one of the board's reference. Raises InputError when there is none."""

    return series_of(trials, fish.status().reference_crc, _identified(fish))


def _identified(fish: Fish) -> Identified | None:
    try:
        return book.identified() if (book := library_of(fish)) is not None else None
    except InputError:
        return None  # a damaged file: the expected band is the one of any fish


def _model(fish: Fish, identified: Identified | None) -> FishModel:
    if identified is not None:
        return identified.model

    return prior_of(fish.params.values()).model
