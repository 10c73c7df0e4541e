"""``tailbeat report``: a page to look at, figures and tables for a paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tailbeat.experiment.folder import Experiment

FIGURES = ("learning", "trials", "contraction", "comparison")


@dataclass(frozen=True)
class Written:
    """``page``: the HTML file, which needs nothing else; ``figures``, ``tables``: all files."""

    page: Path
    figures: list[Path]
    tables: list[Path]


def write_report(
    experiment: Experiment,
    paper: bool = False,
    against: Sequence[Experiment] = (),
    folder: Path | None = None,
) -> Written:
    """Into ``report/`` of the experiment (or ``folder``): ``report.html``; with ``paper`` also every
    figure as PDF and SVG in one column's width, and ``tables/`` (CSV, MATLAB, Parquet: trials,
    beats, slots). ``against``: other experiments of the same reference; then there is the
    ``comparison``. Everything of a simulated fish carries the word ``simulated``: page, every
    figure, every table. Also writes ``analysis.json``. Raises InputError."""
    raise NotImplementedError
