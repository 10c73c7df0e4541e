"""The board's state as the experiment last saw it: ``board/`` with its parameters and all that was
learned, so that another battery, or another board, can go on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tailbeat.experiment.folder import Experiment
    from tailbeat.fish import Fish


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
    """Reads it from the board and writes it whole, lasting. Raises InputError (disk full)."""
    raise NotImplementedError


def held_state(experiment: Experiment) -> BoardState | None:
    """As it was written last; None = never. Raises InputError when it is damaged."""
    raise NotImplementedError
