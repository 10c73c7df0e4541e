"""Conditions side by side: the trials that count, their means, and what the difference is."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tailbeat.core.errors import InputError
from tailbeat.experiment.analysis import Analysis
from tailbeat.experiment.compare import compare, counted
from tailbeat.learning.convergence import student_t
from tailbeat.report.style import (
    LOOKS,
    Axes,
    Figure,
    Style,
    blank,
    drawing,
    earlier_words,
    labels,
    marked,
    mpl_ticker,
    nothing,
)

_LINE = 1.3  # of text, in heights of it
_STRIP = 0.12  # half the width the trials are spread over


def verdicts(analyses: Sequence[Analysis]) -> list[str]:
    """One line per pair, the first experiment against each other one; or why there is none."""
    named = [replace(a, name=name) for a, name in zip(analyses, labels(analyses), strict=True)]
    lines = []
    for other in named[1:]:
        try:
            words = compare(other, named[0]).words
        except InputError as error:
            words = f"{named[0].name} against {other.name}: {error}"
        lines.append(words.rstrip(".") + ".")
    return lines


def mean_and_interval(values: Sequence[float]) -> tuple[float, float]:
    """(mean, half of its 95 % interval by Student's t); the second is NaN for fewer than two."""
    n = len(values)
    if n < 2:
        return (values[0] if n else math.nan), math.nan
    mean = math.fsum(values) / n
    squares = math.fsum((value - mean) ** 2 for value in values)
    return mean, student_t(n - 1) * math.sqrt(squares / (n - 1) / n)


def draw(analyses: Sequence[Analysis], style: Style) -> Figure:
    """Strips of max|e| with mean and 95 % interval; underneath the differences in words."""
    width = style.chars(0.98)
    lines = [
        part
        for line in verdicts(analyses)
        for part in textwrap.wrap(line, width, subsequent_indent="   ")
    ]
    foot = (len(lines) + 0.6) * _LINE * style.small_pt
    with drawing(style):
        figure = blank(analyses, style, 0.062, foot)
        axes = figure.subplots()
        any_shown = [_strip(axes, analysis, at) for at, analysis in enumerate(analyses)]
        if not any(any_shown):
            nothing(axes, "no trial counts", style)
        _axes(axes, analyses, style)
        figure.text(
            0.012, 0.35 * foot / 72 / figure.get_figheight() / max(1, len(lines)), "\n".join(lines),
            fontsize=style.small_pt, va="bottom", linespacing=_LINE,
        )  # fmt: skip
    return figure


def _strip(axes: Axes, analysis: Analysis, at: int) -> bool:
    look = LOOKS[at]
    values = [1e3 * value for value in counted(analysis)]
    if not values:
        return False
    spread = np.linspace(-_STRIP, _STRIP, len(values)) if len(values) > 1 else np.zeros(1)
    axes.plot(
        at - 0.1 + spread, values, look.marker, ms=3.8, mfc="white", mec=look.colour, mew=0.9,
        zorder=3, gid=f"counted {at}",
    )  # fmt: skip
    mean, half = mean_and_interval(values)
    axes.errorbar(
        [at + 0.22], [mean], yerr=None if math.isnan(half) else [half], fmt=look.marker,
        color=look.colour, ms=5.0, lw=1.3, capsize=3, capthick=1.0, zorder=4,
    )  # fmt: skip
    return True


def _axes(axes: Axes, analyses: Sequence[Analysis], style: Style) -> None:
    room = style.chars(0.8 / len(analyses))
    names = [
        f"{textwrap.fill(name, room)}\nn = {len(counted(analysis))}"
        for name, analysis in zip(labels(analyses), analyses, strict=True)
    ]
    axes.set_xticks(range(len(analyses)), names)
    axes.set_xlim(-0.55, len(analyses) - 0.45)
    axes.tick_params(axis="x", length=0)
    axes.margins(y=0.12)
    axes.grid(axis="y")
    axes.yaxis.set_major_locator(mpl_ticker.MaxNLocator(nbins=7, steps=[1, 2, 5, 10]))
    axes.set_ylabel("max|e| (mm/s)")


def alternative(analyses: Sequence[Analysis]) -> str:
    """Text for who does not see the figure."""
    return marked("Errors of the conditions side by side with means and intervals", analyses)


def caption(analyses: Sequence[Analysis]) -> str:
    """What the figure shows, with n and the differences."""
    sizes = ", ".join(
        f"{name}: n = {len(counted(analysis))}"
        for name, analysis in zip(labels(analyses), analyses, strict=True)
    )
    return (
        f"Comparison of conditions ({sizes}). Open: every trial that counts; filled: mean with its "
        f"95 % interval (Student's t). {' '.join(verdicts(analyses))} Intervals of differences by "
        f"Welch.{earlier_words(analyses)}"
    )
