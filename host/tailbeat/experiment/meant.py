"""Which parameters a board is meant to have: what its experiment had last, what was set since.

Everything else is lost (a battery swap takes what was not saved) or somebody else's doing. A swim
would go on with it, and the law learn by it, without a word: so it is told first.

An experiment knows its own in its journal and its copy of the board's state. Before there is one,
and between two, the fish's logbook does: ``meant.json``, what commands have set on this board.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import TYPE_CHECKING

from tailbeat.errors import InputError
from tailbeat.experiment.board import expected_params, set_held_params
from tailbeat.experiment.current import swims_for
from tailbeat.logbook import logbook_of

if TYPE_CHECKING:
    from tailbeat.experiment.folder import Experiment
    from tailbeat.fish import Fish

Strayed = dict[str, tuple[float, float]]
"""Parameters that are not as they are meant to be: (what the board has, what is meant)."""

_MEANT = "meant.json"
_NAMED_MAX = 3
_OFF = "it was switched off, or somebody else has set it"
_REMEDY = (
    "To give it back, as after a battery swap: tailbeat session resume. If it is meant so:"
    " tailbeat params save"
)


def note_set(fish: Fish, params: Mapping[str, float], experiment: Experiment | None = None) -> None:
    """What was set on purpose, into the logbook and into ``experiment``, by default the one the
    fish swims for. Raises InputError (disk full); the board then counts as strayed."""
    note_board(fish, params)
    if (experiment := experiment or swims_for(fish)) is None:
        return
    known = expected_params(experiment)
    new = {n: v for n, v in params.items() if n not in known or not same(known[n], v)}
    if new:
        experiment.journal.add("set", params=new)
        set_held_params(experiment, new)


def note_board(fish: Fish, params: Mapping[str, float]) -> None:
    """What the board is meant to have, into the logbook alone. Does nothing for a board without
    one. Raises InputError."""
    if (book := logbook_of(fish)) is not None:
        with book.changing():
            book.put(_MEANT, _board_params(fish) | dict(params))


def note_all(fish: Fish) -> None:
    """Whatever the board has now was set on purpose."""
    note_set(fish, _values(fish))


def note_restored(fish: Fish) -> None:
    """The board has what it is meant to have again: the logbook follows. Raises InputError."""
    note_board(fish, _values(fish))


def strayed(fish: Fish, experiment: Experiment | None) -> Strayed:
    """From what ``experiment`` had, or without one from what was set. What only one of the two
    knows is another firmware's."""
    wanted = _board_params(fish) if experiment is None else expected_params(experiment)
    now = _values(fish)
    return {
        name: (now[name], value)
        for name, value in wanted.items()
        if name in now and not same(now[name], value)
    }


def require_meant(fish: Fish, experiment: Experiment) -> None:
    """Raises InputError when the board's parameters are not as ``experiment`` had them."""
    if not (found := strayed(fish, experiment)):
        return
    known = _board_params(fish)
    if all(name in known and same(known[name], now) for name, (now, _) in found.items()):
        raise InputError(
            f"the board is set for another experiment than {experiment.name} ({_words(found)}).",
            f"To go on with what {experiment.name} had: tailbeat session resume. With what the"
            " board has: tailbeat params save",
        )
    raise InputError(
        f"the board is not as {experiment.name} last had it ({_words(found)}): {_OFF}.", _REMEDY
    )


def require_as_set(fish: Fish) -> None:
    """Raises InputError when the board's parameters are not as commands have set them; for a board
    that swims for no experiment yet."""
    if found := strayed(fish, None):
        raise InputError(f"the board is not as it was set last ({_words(found)}): {_OFF}.", _REMEDY)


def require_meant_here(fish: Fish) -> None:
    """As ``require_meant``, in the experiment the fish swims for, or ``require_as_set``."""
    if (experiment := swims_for(fish)) is not None:
        require_meant(fish, experiment)
    else:
        require_as_set(fish)


def accept(fish: Fish) -> Strayed:
    """Whatever the board has is meant so from now on; what had strayed."""
    found = strayed(fish, swims_for(fish))
    note_all(fish)
    return found


def same(value: float, other: float) -> bool:
    """As a board holds them."""
    return struct.pack("<f", value) == struct.pack("<f", other)


def _values(fish: Fish) -> dict[str, float]:
    return {name: p.value for name, p in fish.params.list().items()}


def _words(found: Strayed) -> str:
    words = [f"{name} is {now:g}, was {was:g}" for name, (now, was) in found.items()]
    if len(words) > _NAMED_MAX:
        words = [*words[:_NAMED_MAX], f"{len(words) - _NAMED_MAX} more"]
    return ", ".join(words)


def _board_params(fish: Fish) -> dict[str, float]:
    """As the logbook has them; empty = nothing was set. Raises InputError when it is damaged."""
    book = logbook_of(fish)
    if book is None or not (path := book.folder / _MEANT).is_file():
        return {}
    try:
        held = json.loads(path.read_bytes())
        return {str(name): float(value) for name, value in held.items()}
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise InputError(
            f"{path} is damaged: nobody knows how the board was set.",
            "Look at its parameters (tailbeat params list), then delete the file.",
        ) from error
