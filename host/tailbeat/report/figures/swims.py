"""How swims are told apart in figures: by what became of them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tailbeat.report.figures.style import FAINT, GREY, INK, LOOKS, Look

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

    from tailbeat.experiment.analysis import Analysis, TrialRow

KINDS = ("kept", "repeat", "undecided", "incomplete", "discarded")
_WORDS = {
    "kept": "kept",
    "repeat": "repeat, not learned from",
    "undecided": "not decided on",
    "incomplete": "incomplete",
    "discarded": "discarded",
}
_SPREAD = 0.42  # of an iteration, over which its swims lie side by side
_STEP = 0.13
_LANES = 0.6  # of an iteration, over which conditions lie side by side


def kind_of(row: TrialRow) -> str:
    """One of ``KINDS``. A swim whose amplitudes swam before, and that nothing was learned from, is
    a repeat; one that was cut short, or lacks the speeds of too many beats, is incomplete."""
    if row.undecided:
        return "undecided"
    if not row.counts:
        return "discarded"
    if not row.complete:
        return "incomplete"
    repeated = row.decision == "repeat" or (row.repeat_of != 0 and not row.learned)
    return "repeat" if repeated else "kept"


def places(rows: Sequence[TrialRow], at: int = 0, of: int = 1) -> list[float]:
    """Where each swim lies on the axis of iterations: those of one iteration side by side in the
    order they were swum, and condition ``at`` of ``of`` beside the others."""
    together: dict[int, list[int]] = defaultdict(list)
    for index, row in enumerate(rows):
        together[row.iteration].append(index)
    middle, width = lane(at, of)
    where = [0.0] * len(rows)
    for iteration, indices in together.items():
        step = min(_STEP, _SPREAD * width / max(1, len(indices) - 1))
        for n, index in enumerate(indices):
            where[index] = iteration + middle + step * (n - (len(indices) - 1) / 2)
    return where


def lane(at: int, of: int) -> tuple[float, float]:
    """(middle, width as a part of what one condition alone has) of a condition's lane."""
    return _LANES * ((at + 0.5) / of - 0.5), 1.0 / of


def marker(kind: str, look: Look, size: float = 4.0) -> dict[str, Any]:
    """How a swim of that kind is drawn."""
    if kind == "discarded":
        return {"marker": "x", "ms": size, "mec": FAINT, "mew": 0.8, "ls": "", "zorder": 2}
    if kind == "undecided":
        return {"marker": "+", "ms": 1.4 * size, "mec": GREY, "mew": 1.0, "ls": "", "zorder": 2}
    shape: dict[str, Any] = {"marker": look.marker, "ms": size, "mew": 0.9, "ls": "", "zorder": 4}
    shape |= {"mec": look.colour, "mfc": look.colour}
    if kind == "repeat":
        shape |= {"mfc": "white", "zorder": 3}
    if kind == "incomplete":
        shape |= {"marker": "|", "ms": 1.8 * size, "mew": 1.4}
    return shape


def legend_of_kinds(analyses: Sequence[Analysis]) -> list[Line2D]:
    """One entry for every kind that there is, if there is more than one; conditions in grey."""
    from matplotlib.lines import Line2D

    there = {kind_of(row) for analysis in analyses for row in analysis.last_rows}
    if there <= {"kept"}:
        return []
    look = LOOKS[0] if len(analyses) == 1 else Look(GREY, "o", "-")
    return [
        Line2D([], [], label=_WORDS[kind], **marker(kind, look)) for kind in KINDS if kind in there
    ]


def legend_of_conditions(names: Sequence[str]) -> list[Line2D]:
    """Line and marker of each, if there are several."""
    from matplotlib.lines import Line2D

    if len(names) < 2:
        return []
    return [
        Line2D([], [], color=look.colour, ls=look.dash, marker=look.marker, ms=4, label=name)
        for name, look in zip(names, LOOKS, strict=False)
    ]


def level(axes: Axes, value: float, text: str, **how: Any) -> None:
    """A line across with its name at one end: ``left``, above or below."""
    left, above = how.pop("left"), how.pop("above")
    size = how.pop("fontsize")
    axes.axhline(value, zorder=1, **how)
    axes.annotate(
        text, (0.005 if left else 0.995, value), (0, 1.5 if above else -2),
        xycoords=("axes fraction", "data"), textcoords="offset points", fontsize=size,
        ha="left" if left else "right", va="bottom" if above else "top", color=INK, zorder=5,
    )  # fmt: skip
