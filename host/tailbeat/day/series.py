"""Swims one trial after the other: ritual, swim, keep, decide, learn, until there is enough."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from tailbeat.day.ritual import Wanted

if TYPE_CHECKING:
    from tailbeat.camera.base import Camera
    from tailbeat.day.person import Person
    from tailbeat.day.swum import Swum
    from tailbeat.experiment.folder import Experiment
    from tailbeat.fish import Fish, Guard
    from tailbeat.verdict import Verdict


@dataclass(frozen=True)
class Until:
    """When a series ends: after ``swims`` swims that were kept, when the verdict says that there is
    nothing more to gain (``converged``), always when the battery is too low to swim on."""

    swims: int | None = 1
    converged: bool = False

    @classmethod
    def parse(cls, text: str) -> Until:
        """``converged``, ``battery`` or a number. Raises InputError."""
        raise NotImplementedError


@dataclass(frozen=True)
class Options:
    """``wanted`` None: no ritual. ``learn``: kept swims are learned from at once."""

    until: Until = field(default_factory=Until)
    wanted: Wanted | None = field(default_factory=Wanted)
    learn: bool = True
    reconnect_s: float = 60.0


@dataclass(frozen=True)
class SeriesEnd:
    """``why``: ``swims``, ``converged``, ``battery``, ``interrupted`` (Ctrl-C or the person), or
    ``stopped`` (the board stopped by a rule of its own and is left so, with its reason)."""

    why: str
    words: str
    swums: list[Swum]
    verdict: Verdict | None


def swim_series(
    fish: Fish,
    experiment: Experiment,
    person: Person,
    options: Options,
    camera: Camera | None = None,
    guard: Guard | None = None,
) -> SeriesEnd:
    """Swims until ``options.until``. The experiment must be of this fish and of the board's
    reference (``require_same``). Order of every round: a trial that still waits on the board is decided
    first; ritual; swim; its log pulled into the raw files; the decision, journalled; only then the
    board learns or discards; its state copied (``experiment.board``). So whatever fails on the way
    (disk full, link gone, Ctrl-C) the next call goes on where this one stopped and nothing is lost.

    A swim stopped by the person is decided on like any other; then the series ends. Raises what the
    ritual, the swim and the disk raise; the tail is still then."""
    raise NotImplementedError
