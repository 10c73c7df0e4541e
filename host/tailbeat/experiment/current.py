"""Which experiment a fish is in: what 'trial run' adds to when no folder is named."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tailbeat.experiment.folder import Experiment

if TYPE_CHECKING:
    from tailbeat.fish import Fish


def current(fish: Fish) -> Experiment | None:
    """The one last made or used with this fish, if its folder is still there; from its logbook."""
    raise NotImplementedError


def use(fish: Fish, experiment: Experiment) -> None:
    """Makes it the current one. Does nothing for a board without a logbook."""
    raise NotImplementedError


def require_same(fish: Fish, experiment: Experiment) -> None:
    """Raises InputError, with what to do, when the board is another fish than the experiment's (by
    its unique id), or has another reference."""
    raise NotImplementedError


def begin(
    fish: Fish,
    root: Path,
    name: str | None = None,
    conditions: dict[str, str | float] | None = None,
) -> Experiment:
    """A new experiment of the board's reference, law and parameters, and the current one from now
    on; with a copy of what was identified (``raw/identified.json``) where there is one. ``name``:
    the fish's. Raises Refused without a reference."""
    raise NotImplementedError
