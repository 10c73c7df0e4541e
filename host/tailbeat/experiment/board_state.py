"""The board's state as the experiment last saw it: ``board/`` with its parameters and all that was
learned, so that another battery, or another board, can go on.

One file, ``board/state.json``, replaced in one step: half of a state would be worse than none.
``state-N.json`` is one that knew more than what replaced it.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tailbeat.core.errors import InputError
from tailbeat.core.faults import NO_REFERENCE, refusal
from tailbeat.core.files import MAKE_ROOM, canonical, write_whole
from tailbeat.core.param_names import with_current_names
from tailbeat.core.records import decode_learned

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tailbeat.board.fish import Fish
    from tailbeat.experiment.folder import Experiment

_FORMAT = "tailbeat board 1"
_ASIDE_MAX = 999


@dataclass(frozen=True)
class BoardState:
    """``learned``: Fish.learned_record, None = nothing yet. ``reference``: its record."""

    unique_id: str
    params: dict[str, float]
    iteration: int
    reference: bytes
    learned: bytes | None
    last_learned_trial: int | None

    @property
    def has_best(self) -> bool:
        """Whether something was learned along this reference, as far as its record can be read."""
        try:
            return self.learned is not None and decode_learned(self.learned).best_iteration > 0
        except InputError:
            return False

    def knows_more(self, than: BoardState) -> bool:
        """Whether ``than`` has learned less: a board whose storage was erased counts iterations
        and trials from the beginning, one that got its reference again only iterations."""
        if self.learned is None or self.learned == than.learned:
            return False
        if self.has_best and not than.has_best:
            return True  # trial numbers run on from one reference to the next
        last, its_last = self.last_learned_trial or 0, than.last_learned_trial or 0
        ahead = self.iteration - max(1, than.iteration)
        return (last > its_last and ahead >= 0) or (last == its_last and ahead > 0)


def copy_state(fish: Fish, experiment: Experiment) -> BoardState:
    """Reads it from the board and writes it whole, lasting; a copy that knows more stays beside it.
    The parameters are those it is meant to have: a board that restarted has lost what was not
    saved. Raises InputError (disk full), Refused without a reference."""
    reference = fish.reference_record()
    if reference is None:
        raise refusal(NO_REFERENCE)
    status = fish.status()
    state = BoardState(
        unique_id=fish.unique_id(),
        params=expected_params(experiment) or _params(fish),
        iteration=status.iteration,
        reference=reference,
        learned=fish.learned_record(),
        last_learned_trial=status.last_learned_trial,
    )
    path = _path(experiment)
    try:
        path.parent.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make {path.parent}.", "Make the folder writable.") from error
    with experiment.changing():
        _set_aside(experiment, state)
        write_whole(path, canonical(_document(state)), MAKE_ROOM)
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


def held_state(experiment: Experiment) -> BoardState | None:
    """As it was written last; None = never. Raises InputError when it is damaged."""
    path = _path(experiment)
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return None
    try:
        document = json.loads(content)
        state = _state(document)
        if document["format"] != _FORMAT or document["sha256"] != _document(state)["sha256"]:
            raise ValueError("sum")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{path} is damaged: it is not what was copied from the board.",
            "Put a copy back, or delete it and go on with what the board itself has.",
        ) from error
    return replace(state, params=with_current_names(state.params))


def expected_params(experiment: Experiment) -> dict[str, float]:
    """What its board is meant to have: what the copy has, which follows what commands set; without
    one what the experiment was made with, and what was set since. Empty = made by hand."""
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
            new = replace(held, params=held.params | dict(params))
            write_whole(_path(experiment), canonical(_document(new)), MAKE_ROOM)


def _set_aside(experiment: Experiment, state: BoardState) -> None:
    try:
        held = held_state(experiment)
    except InputError:
        return  # what cannot be read cannot be given back
    if held is None or not held.knows_more(state):
        return
    content, path = canonical(_document(held)), _path(experiment)
    for number in range(1, _ASIDE_MAX):
        aside = path.with_name(f"state-{number}.json")
        if not aside.exists():
            write_whole(aside, content, MAKE_ROOM)
            return
        if aside.read_bytes() == content:
            return


def _params(fish: Fish) -> dict[str, float]:
    return {name: p.value for name, p in fish.params.list().items()}


def _path(experiment: Experiment) -> Path:
    return experiment.folder / "board" / "state.json"


def _document(state: BoardState) -> dict[str, Any]:
    """``sha256``: of all the rest, so that a digit changed by hand or by a bad disk is found."""
    held: dict[str, Any] = {
        "format": _FORMAT,
        "unique_id": state.unique_id,
        "params": state.params,
        "iteration": state.iteration,
        "reference": state.reference,
        "learned": state.learned,
        "last_learned_trial": state.last_learned_trial,
    }
    return held | {"sha256": hashlib.sha256(canonical(held)).hexdigest()}


def _state(raw: dict[str, Any]) -> BoardState:
    learned = raw["learned"]
    return BoardState(
        unique_id=str(raw["unique_id"]),
        params={str(name): float(value) for name, value in raw["params"].items()},
        iteration=int(raw["iteration"]),
        reference=bytes.fromhex(raw["reference"]),
        learned=None if learned is None else bytes.fromhex(learned),
        last_learned_trial=raw["last_learned_trial"],
    )
