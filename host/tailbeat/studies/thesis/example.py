"""The nouns: an example, a run of it, what the thesis claims of it, what came out, what is drawn.

An example is a row of data. Claims and figures are functions that name their example:
``@claim(EXAMPLE, id)`` and ``@figure(EXAMPLE, number, caption)``.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.files import write_whole
from tailbeat.studies.thesis.learner import Precision
from tailbeat.studies.thesis.ledger import LedgerEntry, entries, figure_comparisons
from tailbeat.studies.thesis.picture import Panel, Panels, draw, with_ending

Uptake = Literal["clip", "abs", "monod", "none"]


@dataclass(frozen=True)
class ExampleOptions:
    """None = as the thesis has it. An example refuses those that it does not know
    (``Example.knows``) when it is asked for by name."""

    lengths: str | None = None  # how long the trials are: see ``options.parse``
    seed: int = 1  # of what is drawn
    step: float | None = None  # integration and control step, in the example's unit of time
    iterations: int | None = None  # the last iteration; the first is 0, in chapters 4 and 5 1
    m: int | None = None  # of the moving average (chapter 3): m + 1 trials
    beta: float | None = None  # gain of each of these trials; None: 1/(m + 1)
    delta: float | None = None  # lead (chapter 7), min
    uptake: Uptake | None = None  # phi below v = 0 (chapter 7): see AdvectionPlant
    precision: Precision = "double"  # of the laws; the plants always compute in double


CONFIRMED = "confirmed"
READING = "confirmed under a stated reading"
NOT_CONFIRMED = "not confirmed"
UNDECIDED = "cannot be decided from the text"
VERDICTS = (CONFIRMED, READING, NOT_CONFIRMED, UNDECIDED)


@dataclass(frozen=True)
class Claim(LedgerEntry):
    """A claim that was judged. ``measured``: the figure that was computed just now, never one
    written down; ``note``: the reading taken, or why it is not confirmed."""

    verdict: str = UNDECIDED  # one of VERDICTS
    measured: float | list[float] | str = ""
    note: str = ""


@dataclass(frozen=True)
class Found:
    """What the check of a claim found. ``holds``: as it is printed; ``reading``: under the reading
    that the note states. The first outweighs the second. ``decided``: whether the text says enough
    to decide. Lines of the note are joined."""

    holds: bool | np.bool_
    measured: ArrayLike
    note: str = ""
    reading: bool | np.bool_ = False
    decided: bool = True

    @property
    def verdict(self) -> str:
        """One of ``VERDICTS``."""
        if not self.decided:
            return UNDECIDED
        return CONFIRMED if self.holds else READING if self.reading else NOT_CONFIRMED


@dataclass(frozen=True)
class Statement:
    """A claim that is yet to be judged, by ``check``."""

    entry: LedgerEntry
    check: Callable[[Any], Found]

    def judge(self, study: Any) -> Claim:
        """The claim as the runs of ``study`` have it."""
        found = self.check(study)
        number = found.measured
        measured = number if isinstance(number, str) else np.asarray(number, np.float64).tolist()
        note = " ".join(found.note.split())
        return Claim(**vars(self.entry), verdict=found.verdict, measured=measured, note=note)


@dataclass(frozen=True)
class ExampleRun:
    """Errors per iteration. ``max_abs_error``: over the whole reference, beyond a cut too (the
    plant goes on virtually); one value per iteration, or one row of one per component.
    ``executed``: over what each trial reached, where trials are cut. ``diverged``: the iteration
    at which it could not be computed any more; the arrays end before it. ``traces``: the
    ``SeriesOutcome`` or the ``LoopTrials``, for claims and figures; not in JSON."""

    iterations: NDArray[np.int64]
    max_abs_error: F64
    executed: F64 | None = None
    lengths: F64 | None = None
    diverged: int | None = None
    traces: Any = None


@dataclass(frozen=True)
class Figure:
    """A figure that was drawn: ``path`` with the endings .pdf, .svg, .png and, for the caption,
    .txt. ``contradicts``: what the text's own numbers say against it; ``comparison``: with the
    text, as the ledger has it. Both are empty for a figure that is not of the thesis."""

    path: Path
    name: str  # of the thesis: "Fig. 2.3"; empty: the thesis has none
    caption: str
    contradicts: str = ""
    comparison: str = ""

    @property
    def words(self) -> str:
        """The caption with what was found."""
        against = f"Against the text's own numbers: {self.contradicts}" if self.contradicts else ""
        return " ".join(filter(None, (self.caption, against.rstrip(), self.comparison)))


@dataclass(frozen=True)
class Sketch:
    """A figure that is yet to be drawn, by ``compose``. ``number``: of the thesis, as in its
    caption; a name where it has none."""

    number: str
    caption: str
    compose: Callable[[Any], Panel | Panels]

    @property
    def name(self) -> str:
        """Of the thesis."""
        return f"Fig. {self.number}" if _NUMBER.fullmatch(self.number) else ""

    def figure(self, drawing: Panel | Panels, path: Path) -> Figure:
        """What ``drawing``, composed of it, is as a figure."""
        compared = figure_comparisons().get(self.number)
        comparison = "" if compared is None else compared.words
        return Figure(path, self.name, self.caption, drawing.contradicts, comparison)

    def draw(self, study: Any, folder: Path) -> Figure:
        """Writes it into ``folder``."""
        drawing, stem = self.compose(study), folder / f"fig-{self.number}"
        draw(stem, drawing)
        found = self.figure(drawing, with_ending(stem, "pdf"))
        whose = f"{self.name} of the thesis, recomputed" if self.name else "Not of the thesis"
        write_whole(with_ending(stem, "txt"), f"{whose}: {found.words}\n")
        return found


_NUMBER = re.compile(r"[0-9A]+\.[0-9]+")


@dataclass(frozen=True)
class Prepared:
    """An example with options: the settings that its run uses of all that it knows (a seed of None:
    it draws nothing), and the run."""

    settings: dict[str, Any]
    run: Callable[[], ExampleRun]


Setting = Any  # of a chapter: the case of its law and plant, or a gain


@dataclass(frozen=True)
class Example:
    """An example of the thesis. ``prepare``: (setting, options) -> what they come to; it raises
    InputError before anything is computed."""

    id: str
    title: str
    law: str  # short, with the equation's number
    setting: Setting
    prepare: Callable[[Setting, ExampleOptions], Prepared]
    knows: frozenset[str]  # names of ExampleOptions it takes, beside precision
    weight: float = 1.0  # seconds that run and claims take, about
    claims: list[Statement] = field(default_factory=list)
    figures: list[Sketch] = field(default_factory=list)
    on_board: bool = True  # whether the board has this law; else it never flies

    @property
    def chapter(self) -> int:
        """Of the thesis."""
        return int(self.id[2])

    def run(self, options: ExampleOptions) -> ExampleRun:
        """Pure."""
        return self.prepare(self.setting, options).run()

    def settings_of(self, options: ExampleOptions) -> dict[str, Any]:
        """What ``run`` uses, with the precision."""
        found = self.prepare(self.setting, options).settings
        return dict(sorted(found.items())) | {"precision": options.precision}

    def with_setting(self, setting: Setting) -> Example:
        """The same example of another case."""
        return replace(self, setting=setting)


Function = TypeVar("Function", bound=Callable[..., Any])


def claim(example: Example, entry_id: str) -> Callable[[Function], Function]:
    """The function checks this claim of the ledger: Study -> Found. Claims are judged in the order
    of their functions."""

    def keep(check: Function) -> Function:
        example.claims.append(Statement(entries()[entry_id], check))
        return check

    return keep


def figure(example: Example, number: str, caption: str) -> Callable[[Function], Function]:
    """The function composes this figure: Study -> Panels."""

    def keep(compose: Function) -> Function:
        example.figures.append(Sketch(number, caption, compose))
        return compose

    return keep
