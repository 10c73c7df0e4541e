"""After the hull was open: the board gets back what it knew and has lost."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from tailbeat.board.fish import Fish
from tailbeat.board.preserve import restore_interrupted
from tailbeat.board.snapshot import Differences, Snapshot
from tailbeat.board.snapshot import restore_params as set_params
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.records import record_crc
from tailbeat.experiment.board_state import copy_state, expected_params, held_state
from tailbeat.experiment.current import note_restored, reference_of, strayed, use
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import library_of, preserve_folder
from tailbeat.session.log import AGAIN
from tailbeat.session.repeat import end_repeat, idle

__all__ = ["Restored", "restore"]


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
    """The copy; before the first swim what the experiment was made with."""
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
            f"Connect the right one; if its board was replaced: {AGAIN} --another-board",
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
            f"({crc:08x}) and has learned along it; giving it this one would lose that.",
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
                f"the board has learned more than the copy knew (iteration {status.iteration}, not "
                f"{held.iteration}); it keeps that, and the copy is new"
            )
        return False
    if status.best_iteration is not None and status.iteration > held.iteration:
        raise InputError(
            f"the board and the copy have both learned without each other: the board is at "
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
            "the board does not hold what it was given back.", f"Do it again: {AGAIN}"
        )
