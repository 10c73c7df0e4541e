"""Whether one experiment did better than another: effect with its confidence interval."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tailbeat.experiment.analysis import Analysis


@dataclass(frozen=True)
class Comparison:
    """Of ``what`` (``max``: max|e|, ``rms``) over the swims that count on each side. ``difference``:
    mean of B minus mean of A with its 95 % interval by Welch; ``g``: the same over the pooled
    standard deviation, Hedges's, with its interval by the noncentral t distribution. ``repeats``:
    swims needed on each side to see an effect of that size (power 80 %, two-sided 5 %); None = the
    effect is too small for 1000. ``words``: one line for people, which does not claim more than the
    interval allows."""

    what: str
    a_m_s: tuple[float, ...]
    b_m_s: tuple[float, ...]
    difference_m_s: float
    difference_low_m_s: float
    difference_high_m_s: float
    g: float
    g_low: float
    g_high: float
    p: float
    repeats: int | None
    words: str


def counted(analysis: Analysis, iterations: Sequence[int] | None = None) -> list[float]:
    """max|e| of the swims that count: those of ``iterations``, or by default the repeats of the best
    input, and where those are fewer than three all complete ones from the iteration on from which
    the verdict saw no more progress. Never discarded ones."""
    raise NotImplementedError


def compare(
    a: Analysis, b: Analysis, what: str = "max", iterations: Sequence[int] | None = None
) -> Comparison:
    """Raises InputError: another reference, or fewer than two swims on a side, with how many more
    are needed."""
    raise NotImplementedError
