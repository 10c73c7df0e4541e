"""The board's state as the experiment last saw it: ``board/`` with its parameters and all that was
learned, so that another battery, or another board, can go on.

One file, ``board/state.json``, replaced in one step: half of a state would be worse than none.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tailbeat.errors import InputError
from tailbeat.faults import NO_REFERENCE, refusal
from tailbeat.lasting import write_whole
from tailbeat.plain import canonical

if TYPE_CHECKING:
    from tailbeat.experiment.folder import Experiment
    from tailbeat.fish import Fish

_FORMAT = "tailbeat board 1"


@dataclass(frozen=True)
class BoardState:
    """``learned``: Fish.learned_record, None = nothing yet. ``reference``: its record."""

    unique_id: str
    params: dict[str, float]
    iteration: int
    reference: bytes
    learned: bytes | None
    last_learned_trial: int | None


def copy_state(fish: Fish, experiment: Experiment) -> BoardState:
    """Reads it from the board and writes it whole, lasting. Raises InputError (disk full), Refused
    without a reference."""
    reference = fish.reference_record()
    if reference is None:
        raise refusal(NO_REFERENCE)
    status = fish.status()
    state = BoardState(
        unique_id=fish.unique_id(),
        params={name: p.value for name, p in fish.params.list().items()},
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
    write_whole(path, canonical(_document(state)))
    return state


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
    return state


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
