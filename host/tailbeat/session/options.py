"""When a series of trials ends, and how its trials are made."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from tailbeat.core.errors import InputError, did_you_mean
from tailbeat.learning.diagnosis import Cause
from tailbeat.session.next_law import LawName
from tailbeat.session.outcome import DecisionKind
from tailbeat.session.preflight_step import PreflightLimits

CONVERGED, BATTERY = "converged", "battery"
_SWIMS_MAX = 999


@dataclass(frozen=True)
class Until:
    """When a series ends: after ``trials`` trials that were kept, when the verdict says that there
    is nothing more to gain (``converged``), always when the battery is too low to swim on."""

    trials: int | None = 1
    converged: bool = False

    @classmethod
    def parse(cls, text: str) -> Until:
        """``converged``, ``battery`` or a number. Raises InputError."""
        word = text.strip().lower()
        if word == CONVERGED:
            return cls(None, converged=True)
        if word == BATTERY:
            return cls(None)
        if word.isascii() and word.isdigit() and 1 <= int(word) <= _SWIMS_MAX:
            return cls(int(word))
        raise InputError(
            f"'{text}' says no end of a series.",
            f"{did_you_mean(word, (CONVERGED, BATTERY))}Say {CONVERGED}, {BATTERY} or a number"
            f" of trials (1 to {_SWIMS_MAX}).",
        )

    def beyond(self, counted: int) -> Until:
        """With at least one trial more than ``counted``."""
        return self if self.trials is None else replace(self, trials=max(self.trials, counted + 1))


@dataclass(frozen=True)
class Options:
    """``wanted`` None: no preflight checks. ``learn``: kept trials are learned from at once;
    otherwise the series ends with the first, which waits. ``counts``: what a trial must have become
    to count for ``until.swims``. ``of_best``: these are the repeats of the best after a battery
    swap. ``typed``: the command, for the event log. ``law``: of the inputs.
    ``proposes``: a diagnosis asks whether its proposal is to be carried out, once for each of the
    causes that are not in ``declined``. ``plan_anew``: an input that was uploaded before is not
    kept. ``counted``: trials of the same job that count already.
    """

    until: Until = field(default_factory=Until)
    wanted: PreflightLimits | None = field(default_factory=PreflightLimits)
    learn: bool = True
    reconnect_s: float = 60.0
    counts: tuple[DecisionKind, ...] = ("keep",)
    of_best: bool = False
    typed: str = ""
    law: LawName = "auto"
    proposes: bool = False
    declined: set[Cause] = field(default_factory=set)
    plan_anew: bool = False
    counted: int = 0
