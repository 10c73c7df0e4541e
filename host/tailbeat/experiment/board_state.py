"""The board's state as the experiment last saw it: ``board/`` with its parameters and all that was
learned, so that another battery, or another board, can go on.

One file, ``board/state.json``, replaced in one step: half of a state would be worse than none.
``state-N.json`` is one that knew more than what replaced it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from tailbeat.board.fish import Fish
from tailbeat.board.snapshot import Snapshot, make_folder
from tailbeat.core.errors import InputError
from tailbeat.core.faults import NO_REFERENCE, refusal
from tailbeat.core.files import MAKE_ROOM, write_whole
from tailbeat.experiment.folder import Experiment

_ASIDE_MAX = 999


def copy_state(fish: Fish, experiment: Experiment) -> Snapshot:
    """Reads it from the board and writes it whole, lasting; a copy that knows more stays beside it.
    The parameters are the expected ones: a board that restarted has lost what was not saved. Raises
    InputError (disk full), Refused without a reference."""
    taken = Snapshot.take(fish, expected_params(experiment) or None)
    state = replace(taken, next_trial=0, signed=False)  # as the file has it
    if state.reference is None:
        raise refusal(NO_REFERENCE)
    path = _path(experiment)
    make_folder(path.parent)
    with experiment.changing():
        _set_aside(experiment, state)
        state.write_file(path)
    return state


def require_not_lost(fish: Fish, experiment: Experiment) -> None:
    """Raises InputError when the board has forgotten what the copy holds (its storage was erased,
    or its reference was uploaded again): what it swims and learns next would take its place."""
    held, status = held_state(experiment), fish.status()
    if held is None:
        return
    now = replace(
        held,
        iteration=status.iteration,
        last_learned_trial=status.last_learned_trial,
        learned=fish.learned_record(),
    )
    if not held.knows_more(now):
        return
    first = "" if status.pending_trial is None else "tailbeat trial discard --reason WHY, then "
    raise InputError(
        f"the board has lost what it had learned: it is at iteration {max(1, now.iteration)}, and "
        f"{experiment.name} has a copy of iteration {held.iteration}.",
        f"To give it back: {first}tailbeat session resume. To begin anew: tailbeat experiment new",
    )


def held_state(experiment: Experiment) -> Snapshot | None:
    """As it was written last; None = never. Raises InputError when it is damaged."""
    return Snapshot.read_file(_path(experiment))


def expected_params(experiment: Experiment) -> dict[str, float]:
    """The parameters that its board is expected to have: those of the copy, which follows what
    commands set; without one those the experiment was made with, and what was set since. Empty =
    made by hand."""
    if (held := held_state(experiment)) is not None:
        return held.params
    params = dict(experiment.settings().get("params") or {})
    for entry in experiment.journal.entries("set"):
        params |= entry.get("params") or {}
    return {str(name): float(value) for name, value in params.items()}


def set_held_params(experiment: Experiment, params: Mapping[str, float]) -> None:
    """These were set on purpose since the copy was made; without a copy nothing is done."""
    with experiment.changing():
        if (held := held_state(experiment)) is not None:
            replace(held, params=held.params | dict(params)).write_file(_path(experiment))


def _set_aside(experiment: Experiment, state: Snapshot) -> None:
    try:
        held = held_state(experiment)
    except InputError:
        return  # what cannot be read cannot be given back
    if held is None or not held.knows_more(state):
        return
    content, path = held.file_content(), _path(experiment)
    for number in range(1, _ASIDE_MAX):
        aside = path.with_name(f"state-{number}.json")
        if not aside.exists():
            write_whole(aside, content, MAKE_ROOM)
            return
        if aside.read_bytes() == content:
            return


def _path(experiment: Experiment) -> Path:
    return experiment.folder / "board" / "state.json"
