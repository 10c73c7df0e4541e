"""The ledger of claims: what is claimed where, what is computed, by which criterion.

The head of ``ledger.toml`` states the standard of continuous-time theorems.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from itertools import pairwise
from typing import Any

FILE = "ledger.toml"


@dataclass(frozen=True)
class LedgerEntry:
    """One claim. ``claim``: in our words; ``where``: section, equation, figure or table;
    ``quote``: words of the thesis; ``criterion``: of "confirmed", after "reading:" of "confirmed
    under a stated reading"; ``ours``: the thesis does not say it."""

    id: str
    claim: str
    where: str
    computed: str
    criterion: str
    quote: str = ""
    ours: bool = False


@cache
def entries() -> Mapping[str, LedgerEntry]:
    """All claims by their id, in the ledger's order."""
    return {row["id"]: LedgerEntry(**row) for row in _document()["claim"]}


@cache
def _document() -> dict[str, Any]:
    return tomllib.loads(resources.files(__package__).joinpath(FILE).read_text(encoding="utf-8"))


@dataclass(frozen=True)
class ThesisFinding:
    """What was found. ``text``: a template of ``c``, by claim what was measured."""

    title: str
    text: str
    claims: tuple[str, ...]


@cache
def findings() -> tuple[ThesisFinding, ...]:
    """In the ledger's order."""
    return tuple(
        ThesisFinding(row["title"], row["text"], tuple(row["claims"]))
        for row in _document()["finding"]
    )


@dataclass(frozen=True)
class FigureComparison:
    """A numbered figure as it was found when looked at beside its caption and the text."""

    number: str
    agrees: bool
    why: str

    @property
    def words(self) -> str:
        """As a sentence."""
        return f"{'Agrees with' if self.agrees else 'Differs from'} the text: {self.why}."


@cache
def figure_comparisons() -> Mapping[str, FigureComparison]:
    """By number, in the thesis's order."""
    return {row["number"]: FigureComparison(**row) for row in _document()["figure"]}


@dataclass(frozen=True)
class SampledRun:
    """Errors of a theorem's law at one step. ``falls``: as promised up to the iterations that the
    thesis shows; ``departs_at``: the iteration from which they are above what is promised, or
    cannot be computed; None = not in the iterations that were run."""

    step: float
    falls: bool
    departs_at: int | None


def in_continuous_time(runs: Sequence[SampledRun]) -> tuple[bool, bool]:
    """(confirmed, confirmed under the reading "in continuous time"), by the ledger's standard."""
    by_step = sorted(runs, key=lambda run: -run.step)
    ends = [run.departs_at for run in by_step]
    never = float("inf")
    departs = [never if end is None else end for end in ends]
    later = all(a <= b for a, b in pairwise(departs)) and departs[0] < departs[-1]
    confirmed = all(run.falls and run.departs_at is None for run in by_step)
    return confirmed, confirmed or (by_step[-1].falls and (later or departs[0] == never))
