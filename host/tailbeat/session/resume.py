"""After the hull was open: the board gets back what it has lost, and one repeat of the best input
shows how much the fish has changed.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace

from tailbeat.board.fish import Fish
from tailbeat.board.preserve import restore_interrupted
from tailbeat.board.snapshot import Differences, Snapshot
from tailbeat.board.snapshot import restore_params as set_params
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.faults import NO_BEST, refusal
from tailbeat.core.records import INPUT_RESTORED, decode_learned, record_crc
from tailbeat.core.speed_source import Camera
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.experiment.current import note_restored, reference_of, strayed, use
from tailbeat.experiment.folder import Experiment, copy_state, expected_params, held_state
from tailbeat.experiment.library import identified_if_readable, library_of, preserve_folder
from tailbeat.learning.assessment import series_of
from tailbeat.learning.convergence import input_crc
from tailbeat.learning.fish_model import FishModel
from tailbeat.learning.identification import Identified
from tailbeat.link.messages import BoardStatus
from tailbeat.session.change import FishChange, change_of, require_best
from tailbeat.session.collect import STOPPED, make_safe, proposed_decision, recover_trial, settled
from tailbeat.session.events import Event, Notice, Operator, TrialRecorded
from tailbeat.session.guards import Guard
from tailbeat.session.identify import prior_of
from tailbeat.session.log import RESUME_COMMAND, SessionLog, held_before, repeat_path, write_held
from tailbeat.session.options import Options, Until
from tailbeat.session.outcome import Decision, RecordedTrial
from tailbeat.session.preflight_step import GivenUp
from tailbeat.session.series import run_series

REASON = "battery swap"

_TRIES = 3
_DISCARDS_MAX = 3


def idle(fish: Fish) -> BoardStatus:
    """Its status; a board that has just been switched on is not IDLE at once. Raises InputError."""
    status = settled(fish)
    if status.state != "IDLE":
        what = f" ({status.fault.name}: {status.fault.meaning})" if status.fault.number else ""
        raise InputError(
            f"the board is {status.state}{what}, not IDLE.",
            f"tailbeat board clear or tailbeat board disarm, then: {RESUME_COMMAND}",
        )
    return status


def repeat_best(
    fish: Fish,
    experiment: Experiment,
    operator: Operator,
    options: Options,
    camera: Camera | None = None,
    guard: Guard | None = None,
) -> tuple[RecordedTrial, FishChange]:
    """Swims the best amplitudes once (with preflight checks, logged as a repeat, not learned),
    then puts back the amplitudes and the iteration that were to swim next, also when it fails. A
    repeat that an earlier call left on the board is taken as it is. Raises what the series raises,
    GivenUp, and InputError when there is no best, or nothing of it to compare with."""
    account = SessionLog(experiment)
    before = account.counting()
    held = held_before(experiment)
    status = idle(fish)
    if status.pending_trial is not None and not _swam_the_best(fish, held, status.pending_trial):
        raise InputError(
            f"trial {status.pending_trial} waits on the board, neither learned nor discarded.",
            f"tailbeat trial learn, or tailbeat trial discard --reason WHY; then: {RESUME_COMMAND}",
        )
    if status.pending_trial is None:
        end_repeat(fish, experiment)
        held = _begin_repeat(fish, experiment, before, status)
    assert held is not None
    try:
        if status.pending_trial is not None:
            recorded = _left_over(fish, account, operator)
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
    """One trial that counts, by the machinery of a series."""
    one = replace(options, until=Until(trials=1), learn=True, counts=("repeat",), of_best=True)
    end = run_series(fish, experiment, _Repeating(operator), one, camera, guard)
    if end.why == "swims" and end.rounds:
        return end.rounds[-1].recorded

    raise GivenUp(f"no repeat was executed: {end.words}", f"When it is put right: {RESUME_COMMAND}")


@dataclass
class _Repeating:
    """The operator, who is asked only whether the trial counts at all."""

    operator: Operator
    discards: int = field(default=0, init=False)

    def tell(self, event: Event) -> None:
        self.operator.tell(event)

    def wants_abort(self) -> bool:
        return self.operator.wants_abort()

    def confirm(self, question: str) -> bool:
        return self.operator.confirm(question)

    def number(self, question: str, value: float) -> float | None:
        """As the operator."""
        return self.operator.number(question, value)

    def decide(self, recorded: RecordedTrial) -> Decision:
        decision = self.operator.decide(recorded)
        if decision.kind != "discard" and not recorded.judged:
            why = proposed_decision(recorded)
            text = why.reason or f"{recorded.measured_beats} of {recorded.beats} beats have a speed"
            decision = Decision("discard", f"tells no shift: {text}")
        if decision.kind != "discard":
            return Decision("repeat", REASON)
        self.discards += 1
        if self.discards >= _DISCARDS_MAX:
            raise TailbeatError(
                f"{self.discards} repeats came to nothing, the last one: {decision.reason}.",
                f"Put it right, then: {RESUME_COMMAND}",
            )
        return decision


def _left_over(fish: Fish, account: SessionLog, operator: Operator) -> RecordedTrial:
    """The repeat of an earlier call that was broken off after the trial."""
    number = fish.status().pending_trial
    assert number is not None
    text = f"trial {number} is the repeat of an earlier call; it is not executed again"
    operator.tell(Notice(text))
    recorded = recover_trial(fish, account, number)
    operator.tell(TrialRecorded(recorded))
    decision = account.decision_on(recorded.file)
    if decision is None:
        decision = _Repeating(operator).decide(recorded)
        account.decided(recorded, decision)
    if decision.kind == "discard":
        raise TailbeatError(
            f"the repeat was discarded: {decision.reason}.", f"Again: {RESUME_COMMAND}"
        )
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
                "the next feedforward input could not be put back "
                f"({error.message.rstrip('.')}); they are kept in {repeat_path(experiment)}",
                f"Connect again, then: {RESUME_COMMAND}",
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
    return same and now.input == INPUT_RESTORED


def end_repeat(fish: Fish, experiment: Experiment) -> None:
    """What a repeat that was broken off has left: the best as the next to swim. A board that has
    learned since, or was given something else, is left alone."""
    if (held := held_before(experiment)) is None:
        return
    if held.learned is not None and _has_the_best(fish, held):
        fish.upload_learned(held.learned)
        copy_state(fish, experiment)
    repeat_path(experiment).unlink(missing_ok=True)


def _judged(fish: Fish, before: list[Trial], recorded: RecordedTrial) -> FishChange:
    identified = identified_if_readable(library_of(fish))
    repeat = read_trial(recorded.file)
    earlier = [trial for trial in _series(fish, before) if trial.number != repeat.number]
    return change_of(earlier, repeat, _model(fish, identified), identified, recorded.straight)


def _series(fish: Fish, trials: list[Trial]) -> list[Trial]:
    """The last one of the board's reference. Raises InputError when there is none."""

    return series_of(trials, fish.status().reference_crc, identified_if_readable(library_of(fish)))


def _model(fish: Fish, identified: Identified | None) -> FishModel:
    if identified is not None:
        return identified.model

    return prior_of(fish.params.values()).model


@dataclass(frozen=True)
class Restored:
    """What the board got back. ``params``: those that differed, ``params_before`` what it had of
    them; ``reference``, ``learned``: whether it had to be given again. ``iteration`` swims next.
    ``pending_trial``: waits to be decided on, and is left alone. ``notes``: what else an operator
    should know, one line each."""

    params: dict[str, float]
    params_before: dict[str, float]
    reference: bool
    learned: bool
    iteration: int
    battery_v: float
    pending_trial: int | None = None
    notes: tuple[str, ...] = ()


def restore(fish: Fish, experiment: Experiment, another_board: bool = False) -> Restored:
    """Compares the board with what the experiment had last and gives it back what it lacks:
    parameters (saved, so that the next battery does not lose them; what a command has set since is
    meant, see experiment.meant), reference, all that was learned. A board that is ahead of the copy
    keeps what it has, and the copy is made anew. What an identification or a trim that was broken
    off has left is put back first. A trial that waits on the board is left alone.
    ``another_board``: it was replaced and takes the other's place. Raises InputError before
    anything is written: another fish, nothing held, not idle, both have learned."""
    notes: list[str] = []
    restore_interrupted(fish, preserve_folder(library_of(fish)), notes.append)
    held = _held(experiment)
    pending = idle(fish).pending_trial
    before = _other_board(fish, experiment, held, another_board)
    lacks = _lacks(fish, experiment, held, notes) if pending is None else _Lacks()
    if before is not None:  # first: a second call then finds the board it is about
        experiment.write_settings({"unique_id": fish.unique_id(), "board_before": before})
    use(fish, experiment)
    found = _strayed(fish, experiment, notes)
    given = _give_params(fish, {name: meant for name, (_, meant) in found.items()}, notes)
    if pending is None:
        end_repeat(fish, experiment)
        _give(fish, held, lacks)
        copy_state(fish, experiment)
    status = fish.status()
    restored = Restored(
        params=given,
        params_before={name: found[name][0] for name in given},
        reference=lacks.reference,
        learned=lacks.learned,
        iteration=status.iteration,
        battery_v=status.battery_v,
        pending_trial=pending,
        notes=tuple(notes),
    )
    experiment.journal.add("resumed", **asdict(restored), board_s=fish.clock.now_s())
    return restored


def restore_params(fish: Fish) -> tuple[dict[str, tuple[float, float]], list[str]]:
    """For a board that swims for no experiment yet: what commands have set, and it has lost, is
    given back and saved: (what it was, what it is now), and notes."""
    notes: list[str] = []
    idle(fish)
    found = strayed(fish, None)
    given = _give_params(fish, {name: meant for name, (_, meant) in found.items()}, notes)
    return {name: found[name] for name in given}, notes


def _held(experiment: Experiment) -> Snapshot:
    """The copy; before the first trial what the experiment was made with."""
    if (held := held_state(experiment)) is not None:
        return held
    if (reference := reference_of(experiment)) is None:
        raise InputError(
            f"{experiment.name} has no copy of a board, and no reference.",
            "Name another experiment (--into), or begin one: tailbeat experiment new",
        )
    return Snapshot(
        unique_id=str(experiment.settings().get("unique_id") or ""),
        params=expected_params(experiment),
        reference=reference,
    )


def _other_board(
    fish: Fish, experiment: Experiment, held: Snapshot, another_board: bool
) -> str | None:
    """The board that this one takes the place of."""
    wanted = str(experiment.settings().get("unique_id") or held.unique_id)
    found = fish.unique_id()
    if wanted == found:
        return None
    if not another_board:
        raise InputError(
            f"this is another fish: {experiment.name} is of {wanted}, the board is {found}.",
            f"Connect the right one; if its board was replaced: {RESUME_COMMAND} --another-board",
        )
    return wanted


def _strayed(fish: Fish, experiment: Experiment, notes: list[str]) -> Differences:
    found, wanted = strayed(fish, experiment), expected_params(experiment)
    if missing := sorted(set(wanted) - set(fish.params.list())):
        notes.append(f"this firmware has no {', '.join(missing)}")
    return found


def _give_params(fish: Fish, wanted: dict[str, float], notes: list[str]) -> dict[str, float]:
    """What the board took."""
    given, refused = set_params(fish, wanted)
    note_restored(fish)
    notes += [f"{name} = {wanted[name]:g} was refused: {why}" for name, why in refused.items()]
    return given


@dataclass(frozen=True)
class _Lacks:
    """What the board is to be given again."""

    reference: bool = False
    learned: bool = False


def _lacks(fish: Fish, experiment: Experiment, held: Snapshot, notes: list[str]) -> _Lacks:
    """Changes nothing. Raises InputError when giving would lose what the board has learned."""
    assert held.reference is not None
    status, crc = fish.status(), record_crc(held.reference)
    if status.reference_crc == crc:
        return _Lacks(False, _is_behind(fish, held, notes))
    if status.best_iteration is not None:
        raise InputError(
            f"the board has another reference ({status.reference_crc:08x}) than {experiment.name} "
            f"({crc:08x}) and has learned along it. Restoring this one would lose that.",
            "Nothing was changed. Name that reference's experiment, or upload this one's yourself: "
            f"tailbeat reference upload {experiment.folder / 'reference.csv'}",
        )
    return _Lacks(True, held.learned is not None)


def _is_behind(fish: Fish, held: Snapshot, notes: list[str]) -> bool:
    """Whether the board has learned less than the copy knows, along the same reference."""
    mine = fish.learned_record()
    if held.learned is None or mine == held.learned:
        return False
    status = fish.status()
    if held.has_best and status.best_iteration is None:
        return True  # trial numbers run on from one reference to the next
    last, held_last = status.last_learned_trial or 0, held.last_learned_trial or 0
    if last > held_last or (last == held_last and status.iteration >= held.iteration):
        if mine is not None and last == held_last and status.iteration == held.iteration:
            notes.append("the board's next amplitudes are not the copy's; the board's stay")
        elif mine is not None:
            notes.append(
                f"the board has learned more than the copy has (iteration {status.iteration}, not "
                f"{held.iteration}). It keeps that, and the copy is new"
            )
        return False
    if status.best_iteration is not None and status.iteration > held.iteration:
        raise InputError(
            f"the board and the copy have both learned, separately. The board is at "
            f"iteration {status.iteration} and last learned from trial {last}, the copy at "
            f"{held.iteration} and from trial {held_last}.",
            "Nothing was changed. Begin a new experiment for what the board has: tailbeat "
            "experiment new",
        )
    return True


def _give(fish: Fish, held: Snapshot, lacks: _Lacks) -> None:
    if lacks.reference and held.reference is not None:
        fish.upload_reference(held.reference)
    if not lacks.learned or held.learned is None:
        return
    fish.upload_learned(held.learned)
    if fish.learned_record() != held.learned:
        raise TailbeatError(
            "the board does not hold what it was given back.", f"Do it again: {RESUME_COMMAND}"
        )
