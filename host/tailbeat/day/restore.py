"""After the hull was open: the board gets back what it knew and has lost."""

from __future__ import annotations

import struct
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from tailbeat.day.repeat import AGAIN, end_repeat, idle
from tailbeat.errors import InputError, LinkLostError, TailbeatError
from tailbeat.experiment.board import copy_state, held_state
from tailbeat.experiment.current import use
from tailbeat.logbook import logbook_of
from tailbeat.model.lent import put_back_left, safe_folder
from tailbeat.records import record_crc

if TYPE_CHECKING:
    from tailbeat.experiment.board import BoardState
    from tailbeat.experiment.folder import Experiment
    from tailbeat.fish import Fish
    from tailbeat.parameters import Parameter

__all__ = ["Restored", "restore"]


@dataclass(frozen=True)
class Restored:
    """What the board got back. ``params``: names that differed; ``reference``, ``learned``: whether
    it had to be given again. ``iteration`` swims next. ``pending_trial``: waits to be decided on,
    and is left alone. ``notes``: what else a person should know, one line each."""

    params: dict[str, float]
    reference: bool
    learned: bool
    iteration: int
    battery_v: float
    pending_trial: int | None = None
    notes: tuple[str, ...] = ()


def restore(fish: Fish, experiment: Experiment, another_board: bool = False) -> Restored:
    """Compares the board with ``experiment.board`` and gives it back what it lacks: parameters it
    holds at their defaults (saved, so that the next battery does not lose them), reference, all
    that was learned. What was set on purpose since stays, and so does a board that is ahead of the
    copy, which is made anew. What an identification or a trim that was broken off has left is put
    back first. A trial that waits on the board is left alone. ``another_board``: it was replaced,
    takes the other's place and all its parameters. Raises InputError before anything is written:
    another fish, nothing held, not idle, both have learned."""
    notes: list[str] = []
    put_back_left(fish, safe_folder(logbook_of(fish)), notes.append)
    held = _held(experiment)
    pending = idle(fish).pending_trial
    before = _other_board(fish, experiment, held, another_board)
    lacks = _lacks(fish, experiment, held, notes) if pending is None else _Lacks()
    if before is not None:  # first: a second call then finds the board it is about
        experiment.write_settings({"unique_id": fish.unique_id(), "board_before": before})
        use(fish, experiment)
    given = _give_params(fish, _lost(fish, experiment, held, another_board, notes), notes)
    if pending is None:
        end_repeat(fish, experiment)
        _give(fish, held, lacks)
        copy_state(fish, experiment)
    status = fish.status()
    found = Restored(
        params=given,
        reference=lacks.reference,
        learned=lacks.learned,
        iteration=status.iteration,
        battery_v=status.battery_v,
        pending_trial=pending,
        notes=tuple(notes),
    )
    experiment.journal.add("resumed", **asdict(found))
    return found


def _held(experiment: Experiment) -> BoardState:
    held = held_state(experiment)
    if held is None:
        raise InputError(
            f"{experiment.name} has no copy of a board: no trial of it was swum yet.",
            "tailbeat trial run makes one after every swim; name another experiment, or go on.",
        )
    return held


def _other_board(
    fish: Fish, experiment: Experiment, held: BoardState, another_board: bool
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


def _lost(
    fish: Fish, experiment: Experiment, held: BoardState, every: bool, notes: list[str]
) -> dict[str, float]:
    """Parameters the board holds at their defaults and the copy does not: those it has lost. Any
    other that differs was set since and stays, as a note tells. ``every``: all that differ."""
    now = fish.params.list()
    centre_us = _trimmed_us(experiment)
    lost: dict[str, float] = {}
    for name, value in held.params.items():
        if name not in now or _same(now[name].value, value):
            continue
        if name == "SERVO_CENTRE_US" and _same(now[name].value, centre_us):
            continue
        if every or _at_default(now[name]):
            lost[name] = value
        else:
            notes.append(
                f"{name} is {now[name].value:g}, and was {value:g} when the copy was made; it stays"
            )
    if missing := sorted(set(held.params) - set(now)):
        notes.append(f"this firmware has no {', '.join(missing)}")
    return lost


def _at_default(held: Parameter) -> bool:
    return _same(held.value, held.default)


def _give_params(fish: Fish, wanted: dict[str, float], notes: list[str]) -> dict[str, float]:
    """What the board took. Some fit only once others are set: what is refused is tried again after
    the rest."""
    given: dict[str, float] = {}
    refused: dict[str, str] = {}
    for name, value in [*wanted.items(), *wanted.items()]:
        if name in given:
            continue
        try:
            given[name] = fish.params.set(name, value).value
            refused.pop(name, None)
        except LinkLostError:
            raise
        except TailbeatError as error:
            refused[name] = error.message
    if given:
        fish.params.save()
    notes += [f"{name} = {wanted[name]:g} was refused: {why}" for name, why in refused.items()]
    return given


def _trimmed_us(experiment: Experiment) -> float | None:
    """The centre that was found last: trimmed after the copy was made, it is the newer one."""
    trimmed = experiment.journal.entries("trimmed")
    centre_us = trimmed[-1].get("centre_us") if trimmed else None
    return float(centre_us) if isinstance(centre_us, int | float) else None


def _same(value: float, other: float | None) -> bool:
    """As the board holds them."""
    return other is not None and struct.pack("<f", value) == struct.pack("<f", other)


@dataclass(frozen=True)
class _Lacks:
    """What the board is to be given again."""

    reference: bool = False
    learned: bool = False


def _lacks(fish: Fish, experiment: Experiment, held: BoardState, notes: list[str]) -> _Lacks:
    """Changes nothing. Raises InputError when giving would lose what the board has learned."""
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


def _is_behind(fish: Fish, held: BoardState, notes: list[str]) -> bool:
    """Whether the board has learned less than the copy knows, along the same reference."""
    mine = fish.learned_record()
    if held.learned is None or mine == held.learned:
        return False
    status = fish.status()
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


def _give(fish: Fish, held: BoardState, lacks: _Lacks) -> None:
    if lacks.reference:
        fish.upload_reference(held.reference)
    if not lacks.learned or held.learned is None:
        return
    fish.upload_learned(held.learned)
    if fish.learned_record() != held.learned:
        raise TailbeatError(
            "the board does not hold what it was given back.", f"Do it again: {AGAIN}"
        )
