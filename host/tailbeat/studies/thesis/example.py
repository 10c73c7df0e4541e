"""What may be asked of an example beyond the thesis's own settings.

The nouns: an example, a run of it, what the thesis claims of it and what came out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis.learner import Precision

Uptake = Literal["clip", "abs", "monod", "none"]


@dataclass(frozen=True)
class ExampleOptions:
    """None = as the thesis has it. An example refuses those that it does not know
    (``Example.knows``) when it is asked for by name."""

    lengths: str | None = None  # how long the trials are: see tailbeat.thesis.lengths
    seed: int = 1  # of what is drawn
    step: float | None = None  # integration and control step, in the example's unit of time
    iterations: int | None = None  # the last iteration; the first is 0, in chapters 4 and 5 1
    m: int | None = None  # of the moving average (chapter 3): m + 1 trials
    beta: float | None = None  # gain of each of these trials; None: 1/(m + 1)
    delta: float | None = None  # lead (chapter 7), min
    uptake: Uptake | None = None  # phi below v = 0 (chapter 7): see AdvectionPlant
    precision: Precision = "double"  # of the laws; the plants always compute in double


COMES_OUT = "comes out"
UNDER_A_READING = "comes out under a stated reading"
DOES_NOT = "does not come out"
VERDICTS = (COMES_OUT, UNDER_A_READING, DOES_NOT)


@dataclass(frozen=True)
class Claim:
    """One statement of the thesis, or beside it. ``measured``: the figure that was computed just
    now, never one written down; ``note``: the reading taken, or why it does not come out;
    ``ours``: the thesis does not say it, so it does not count among its claims."""

    text: str
    source: str  # section, equation or figure of the thesis
    verdict: str  # one of VERDICTS
    measured: float | list[float] | str
    note: str = ""
    ours: bool = False


def verdict(plainly: bool, under_a_reading: bool = False) -> str:
    """Of what was found as it is printed, and of what was found under the reading that the note
    tells. The first outweighs the second."""
    if plainly:
        return COMES_OUT
    return UNDER_A_READING if under_a_reading else DOES_NOT


@dataclass(frozen=True)
class ExampleRun:
    """Errors per iteration. ``max_abs_error``: over the whole wanted record, beyond a cut too (the
    plant goes on virtually); one value per iteration, or one row of one per component.
    ``executed``: over what each trial reached, where trials are cut. ``diverged``: the iteration
    at which it could not be computed any more; the arrays end before it."""

    iterations: NDArray[np.int64]
    max_abs_error: F64
    executed: F64 | None = None
    lengths: F64 | None = None
    diverged: int | None = None
    traces: dict[str, Any] = field(default_factory=dict)  # for figures; not in JSON


class Study(Protocol):
    """What claims and figures are computed with. Runs with the same options are computed once."""

    def run(self, **changes: Any) -> ExampleRun:
        """A run of this example with the thesis's settings but for ``changes`` (of ``Options``)."""

    def tick(self, done: float) -> None:
        """Tells how much of the claims is done, 0 to 1."""


@dataclass(frozen=True)
class Figure:
    """A picture that was drawn. ``contradicts``: what the text's own numbers say against it."""

    path: Path
    name: str  # of the thesis: "Fig. 2.3"
    caption: str
    contradicts: str = ""


@dataclass(frozen=True)
class Example:
    """An example of the thesis. The functions are pure but for files in the figures' folder."""

    id: str
    chapter: int
    title: str
    law: str  # short, with the equation's number
    knows: frozenset[str]  # names of Options it takes, beside precision
    run: Callable[[ExampleOptions], ExampleRun]
    claims: Callable[[Study], list[Claim]]
    figures: Callable[[Study, Path], list[Figure]]
    weight: float = 1.0  # seconds that run and claims take, about
    settings: Callable[[ExampleOptions], dict[str, Any]] | None = None
    """What a run with these options uses of all that the example knows; a seed of None: it draws
    nothing. Raises InputError as ``run`` does, before anything is computed."""

    def settings_of(self, options: ExampleOptions) -> dict[str, Any]:
        """The same with the precision; by default the options as they are."""
        found = (
            {name: getattr(options, name) for name in self.knows}
            if self.settings is None
            else self.settings(options)
        )
        return dict(sorted(found.items())) | {"precision": options.precision}
