"""Which parameters an experiment's board is meant to have: what it had last, what was set since.

Everything else is lost (a battery swap takes what was not saved) or somebody else's doing. A swim
would go on with it, and the law learn by it, without a word: so it is told first.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

from tailbeat.errors import InputError
from tailbeat.experiment.board import expected_params, set_held_params
from tailbeat.experiment.current import swims_for

if TYPE_CHECKING:
    from tailbeat.experiment.folder import Experiment
    from tailbeat.fish import Fish

_NAMED_MAX = 3


def note_set(fish: Fish, params: Mapping[str, float], experiment: Experiment | None = None) -> None:
    """What was set on purpose, into ``experiment``, by default the one the fish swims for; without
    one nothing is noted. Raises InputError (disk full); the board then counts as strayed."""
    experiment = experiment or swims_for(fish)
    if experiment is not None and params:
        experiment.journal.add("set", params=dict(params))
        set_held_params(experiment, params)


@contextmanager
def meant(fish: Fish) -> Iterator[None]:
    """Notes what changes of the board's parameters meanwhile."""
    before = _values(fish)
    yield
    after = _values(fish)
    note_set(fish, {name: value for name, value in after.items() if before.get(name) != value})


def strayed(fish: Fish, experiment: Experiment) -> dict[str, tuple[float, float]]:
    """Parameters that are not as they are meant to be: (what the board has, what is meant). What
    only one of the two knows is another firmware's."""
    now = _values(fish)
    return {
        name: (now[name], value)
        for name, value in expected_params(experiment).items()
        if name in now and not same(now[name], value)
    }


def require_meant(fish: Fish, experiment: Experiment) -> None:
    """Raises InputError when the board's parameters are not as they are meant to be."""
    found = strayed(fish, experiment)
    if not found:
        return
    words = [f"{name} is {now:g}, was {was:g}" for name, (now, was) in found.items()]
    if len(words) > _NAMED_MAX:
        words = [*words[:_NAMED_MAX], f"{len(words) - _NAMED_MAX} more"]
    raise InputError(
        f"the board is not as {experiment.name} last had it ({', '.join(words)}): it was switched"
        " off, or somebody else has set it.",
        "To give it back, as after a battery swap: tailbeat session resume. If it is meant so:"
        " tailbeat params save",
    )


def accept(fish: Fish) -> dict[str, float]:
    """What has strayed in the experiment the fish swims for is meant so from now on; what it is."""
    if (experiment := swims_for(fish)) is None:
        return {}
    found = {name: now for name, (now, _) in strayed(fish, experiment).items()}
    note_set(fish, found, experiment)
    return found


def require_meant_here(fish: Fish) -> None:
    """As ``require_meant``, in the experiment the fish swims for."""
    if (experiment := swims_for(fish)) is not None:
        require_meant(fish, experiment)


def same(value: float, other: float) -> bool:
    """As a board holds them."""
    return struct.pack("<f", value) == struct.pack("<f", other)


def _values(fish: Fish) -> dict[str, float]:
    return {name: p.value for name, p in fish.params.list().items()}
