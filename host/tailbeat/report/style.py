"""How figures look: sizes, lines and colours that also tell each other apart in grey.

How trials are distinguished in figures: by what became of them.
"""

from __future__ import annotations

import io
import textwrap
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tailbeat.core.errors import InputError
from tailbeat.core.extras import lazy
from tailbeat.core.files import write_whole
from tailbeat.experiment.analysis import Analysis
from tailbeat.experiment.trial_rows import TrialRow

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure
else:
    Axes = Figure = Any

mpl_figure: Any = lazy("matplotlib.figure")
_lines: Any = lazy("matplotlib.lines")
mpl_patches: Any = lazy("matplotlib.patches")
mpl_ticker: Any = lazy("matplotlib.ticker")
_agg: Any = lazy("matplotlib.backends.backend_agg")
_style: Any = lazy("matplotlib.style")

TEXT_PT_MIN = 6.0  # what journals ask for, as printed
INK, GREY, FAINT, BAND, GRID = "0.10", "0.40", "0.62", "0.87", "0.93"
ACCENT = "#0b5394"  # prints as dark grey
DASHED, DOTTED = (0, (5, 2)), (0, (1.2, 1.6))
SIMULATED = "simulated"
_INCH_M = 0.0254
_PT_PER_INCH = 72.0
_NAME_CHARS_MAX = 34
_HEAD_PT = 11.0  # the strip above everything that says simulated
_EDGE_PT = 2.0
_DPI = 300
_SCREEN_DPI = 100
_NOTHING_ELSE: dict[str, dict[str, Any]] = {  # matplotlib's version and the date are left out
    "pdf": {"Creator": "tailbeat", "Producer": None, "CreationDate": None},
    "svg": {"Creator": None, "Date": None},
    "png": {"Software": None},
}
_EM_PER_CHAR = 0.53  # mean width of a character of DejaVu Sans in text


@dataclass(frozen=True)
class Style:
    """``width_m``: of one column as printed. Text is ``text_pt`` high there, never smaller than
    6 pt."""

    name: str
    width_m: float
    text_pt: float

    @property
    def width_in(self) -> float:
        """For matplotlib."""
        return self.width_m / _INCH_M

    @property
    def wide(self) -> bool:
        """Room for two panels side by side."""
        return self.width_m > 0.12

    @property
    def small_pt(self) -> float:
        """Of labels inside the axes."""
        return max(TEXT_PT_MIN, self.text_pt - 1.5)

    def chars(self, part: float = 1.0) -> int:
        """How many characters of small text fit into that part of the width."""
        return int(part * self.width_in * _PT_PER_INCH / (_EM_PER_CHAR * self.small_pt))


PAGE = Style("page", 0.190, 9.0)
PAPER = Style("paper", 0.0889, 8.0)  # one column of an IEEE journal, 3.5 inches; phones too
SCREEN = Style("screen", 0.4064, 14.0)  # 1600 pixels


@dataclass(frozen=True)
class Look:
    """Of one condition. Colours by Okabe and Ito, in an order whose greys differ too."""

    colour: str
    marker: str
    dash: Any


LOOKS = (
    Look("#0b0b0b", "o", "-"),
    Look("#d55e00", "s", (0, (5, 1.6))),
    Look("#0072b2", "^", (0, (1.2, 1.3))),
    Look("#e69f00", "D", (0, (6, 1.6, 1.2, 1.6))),
    Look("#009e73", "v", (0, (3, 1.2, 1.2, 1.2, 1.2, 1.2))),
    Look("#56b4e9", "P", (0, (8, 2))),
)


@contextmanager
def drawing(style: Style) -> Iterator[None]:
    """The settings figures are made with, whatever this computer's own are."""
    settings: dict[Any, Any] = {
        "font.family": "DejaVu Sans",
        "font.size": style.text_pt,
        "text.color": INK,
        "text.parse_math": False,
        "axes.labelsize": style.text_pt,
        "axes.labelcolor": INK,
        "axes.edgecolor": GREY,
        "axes.linewidth": 0.6,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.axisbelow": True,
        "axes.titlesize": style.text_pt + 1,
        "axes.titleweight": "bold",
        "axes.titlelocation": "left",
        "axes.titlepad": 12,
        "grid.color": GRID,
        "grid.linewidth": 0.6,
        "axes.unicode_minus": True,
        "xtick.color": INK,
        "ytick.color": INK,
        "xtick.labelsize": style.small_pt,
        "ytick.labelsize": style.small_pt,
        "xtick.major.width": 0.6,
        "ytick.major.width": 0.6,
        "xtick.major.size": 2.5,
        "ytick.major.size": 2.5,
        "legend.fontsize": style.small_pt,
        "legend.frameon": False,
        "legend.handlelength": 2.2,
        "legend.handletextpad": 0.5,
        "legend.columnspacing": 1.2,
        "legend.borderpad": 0.1,
        "legend.borderaxespad": 0.2,
        "legend.labelspacing": 0.25,
        "lines.linewidth": 1.2,
        "lines.markersize": 4.0,
    }
    with _style.context(["default", settings]):
        yield


def blank(
    analyses: Sequence[Analysis], style: Style, height_m: float, foot_pt: float = 0
) -> Figure:
    """An empty figure of the style's width that says what of it is simulated. ``foot_pt``: room
    left free at the bottom. Raises InputError when there are too many conditions to tell apart."""
    if len(analyses) > len(LOOKS):
        raise InputError(
            f"{len(analyses)} experiments are more than one figure can tell apart.",
            f"Compare at most {len(LOOKS)}.",
        )
    mark = simulated_mark(analyses)
    head = _HEAD_PT / _PT_PER_INCH if mark else 0.0
    foot = foot_pt / _PT_PER_INCH
    height = height_m / _INCH_M + head + foot
    figure: Figure = mpl_figure.Figure(
        figsize=(style.width_in, height), facecolor="white", layout="constrained"
    )
    engine: Any = figure.get_layout_engine()
    engine.set(rect=(0, foot / height, 1, 1 - (head + foot) / height), w_pad=0.02, h_pad=0.02)
    if mark:
        figure.text(
            1 - _EDGE_PT / (style.width_in * _PT_PER_INCH),
            1 - _EDGE_PT / (height * _PT_PER_INCH), mark, ha="right", va="top",
            fontsize=style.small_pt, fontweight="bold", color=GREY, gid=SIMULATED,
        )  # fmt: skip
    return figure


def head_legend(figure: Figure, entries: Sequence[Any], columns: int) -> None:
    """A legend above the axes, filled row by row; the figure grows by its height."""
    if not entries:
        return
    columns = min(columns, len(entries))
    by_rows = [entry for column in range(columns) for entry in entries[column::columns]]
    legend = figure.legend(handles=by_rows, loc="upper left", ncols=columns)
    legend.set_in_layout(False)
    renderer = _agg.FigureCanvasAgg(figure).get_renderer()
    room = legend.get_window_extent(renderer).height / figure.dpi
    mark = [text for text in figure.texts if text.get_gid() == SIMULATED]
    head = _HEAD_PT / _PT_PER_INCH if mark else 0.0
    height = figure.get_figheight() + room
    figure.set_figheight(height)
    for text in mark:
        text.set_y(1 - _EDGE_PT / (height * _PT_PER_INCH))
    legend.set_bbox_to_anchor((0, 0, 1, 1 - head / height), figure.transFigure)
    engine: Any = figure.get_layout_engine()
    engine.set(rect=(0, 0, 1, 1 - (head + room) / height))


def freedom_words(*freedoms: int) -> str:
    """How well scatter is known: ``from 1 pair: rough``, ``5 degrees of freedom``; of several
    conditions in their order."""
    if set(freedoms) == {1}:
        return "from 1 pair: rough"
    alike = freedoms[:1] if len(set(freedoms)) == 1 else freedoms
    return f"{', '.join(map(str, alike))} degrees of freedom"


def earlier_words(analyses: Sequence[Analysis]) -> str:
    """For captions: which trials a figure does not show because the board began anew after them."""
    parts = [
        f"{len(analysis.rows) - len(analysis.last_rows)}"
        + (f" of {name}" if len(analyses) > 1 else "")
        for analysis, name in zip(analyses, labels(analyses), strict=True)
        if analysis.epoch
    ]
    if not parts:
        return ""
    return f" The board began anew; trials before that, not in this figure: {', '.join(parts)}."


def simulated_mark(analyses: Sequence[Analysis]) -> str:
    """What a figure of these has to say; empty for real fish."""
    made_up = [analysis.simulated for analysis in analyses]
    if not any(made_up):
        return ""
    return SIMULATED if all(made_up) else "partly simulated"


def marked(words: str, analyses: Sequence[Analysis]) -> str:
    """A sentence that says, in brackets, when its data are simulated."""
    mark = simulated_mark(analyses)
    return f"{words} ({mark})." if mark else f"{words}."


def labels(analyses: Sequence[Analysis]) -> list[str]:
    """Short names of conditions: what their folders' names do not share, the simulated ones marked
    where others are not."""
    parts = [analysis.name.strip("_").split("_") for analysis in analyses]
    if len(parts) > 1 and len({len(part) for part in parts}) == 1:
        differ = [len(set(column)) > 1 for column in zip(*parts, strict=True)]
        parts = [[p for p, keep in zip(part, differ, strict=True) if keep] for part in parts]
    names = [textwrap.shorten(" ".join(part) or "?", _NAME_CHARS_MAX) for part in parts]
    if len(set(names)) < len(names):
        names = [f"{name} [{at + 1}]" for at, name in enumerate(names)]
    if simulated_mark(analyses) in ("", SIMULATED):
        return names
    made_up = [analysis.simulated for analysis in analyses]
    return [f"{n} ({SIMULATED})" if s else n for n, s in zip(names, made_up, strict=True)]


def log_axis(axes: Axes, values_mm_s: Sequence[float], room: tuple[float, float]) -> None:
    """Logarithmic, around the values with that room as factors below and above, and with ticks at
    1, 2, 5 and between where there are few."""
    low, high = min(values_mm_s) / room[0], max(values_mm_s) * room[1]
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    for steps in ((1, 2, 5), (1, 1.5, 2, 3, 5, 7), (1, 1.2, 1.4, 1.6, 1.8, 2, 2.5, 3, 4, 5, 6, 8)):
        ticks = [t * 10.0**p for p in range(-6, 7) for t in steps]
        ticks = [tick for tick in ticks if low <= tick <= high]
        if len(ticks) >= 3:
            break
    axes.yaxis.set_major_locator(mpl_ticker.FixedLocator(ticks))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_locator(mpl_ticker.NullLocator())
    axes.yaxis.set_minor_formatter(mpl_ticker.NullFormatter())
    axes.grid(axis="y")


def iteration_axis(axes: Axes, iterations: Sequence[int]) -> None:
    """Whole numbers, with half an iteration of room."""
    first, last = min(iterations, default=1), max(iterations, default=1)
    axes.set_xlim(first - 0.6, last + 0.6)
    axes.xaxis.set_major_locator(mpl_ticker.MaxNLocator(integer=True, nbins=10, min_n_ticks=1))
    axes.set_xlabel("iteration")


def nothing(axes: Axes, words: str, style: Style) -> None:
    """Says in empty axes why they are."""
    axes.text(
        0.5, 0.5, words, transform=axes.transAxes, ha="center", va="center",
        fontsize=style.small_pt, color=GREY,
    )  # fmt: skip


def mm(value_m_s: float) -> str:
    """A speed in mm/s with three digits, without unit."""
    value = value_m_s * 1e3
    return f"{value:.0f}" if value >= 99.5 else f"{value:.1f}" if value >= 0.95 else f"{value:.2g}"


def written(figure: Figure, kind: str, dpi: int = _DPI) -> bytes:
    """The file's content, ``kind``: pdf, svg or png; the same bytes for the same figure on one
    machine: no dates, no random ids. Text stays text in a PDF; in an SVG it is outlines, which look
    the same on a computer without the font."""
    settings: dict[Any, Any] = {
        "pdf.fonttype": 42,
        "svg.fonttype": "path",
        "svg.hashsalt": "tailbeat",
        "savefig.dpi": dpi,
    }
    out, engine, draw = io.BytesIO(), figure.get_layout_engine(), figure.draw

    def draw_laid_out(renderer: Any) -> None:
        if engine is not None:
            engine.execute(figure)
        draw(renderer)

    # Else matplotlib draws all of it twice, the first time for the layout alone; same bytes.
    vars(figure).update(get_layout_engine=lambda: None, draw=draw_laid_out)
    with _style.context(["default", settings]):
        figure.savefig(out, format=kind, dpi=dpi, metadata=_NOTHING_ELSE[kind])
    del vars(figure)["get_layout_engine"], vars(figure)["draw"]
    return out.getvalue()


@contextmanager
def picture(
    path: Path,
    width_px: float,
    height_px: float,
    title: str = "",
    subtitle: str = "",
    text_pt: float = SCREEN.text_pt,
    **how: Any,
) -> Iterator[Figure]:
    """An empty figure for a screen under a title; the PNG is written, whole, where the block ends.
    ``how``: as ``Figure`` takes it. Raises InputError when it cannot be written."""
    size = width_px / _SCREEN_DPI, height_px / _SCREEN_DPI
    with drawing(replace(SCREEN, text_pt=text_pt)):
        figure: Figure = mpl_figure.Figure(size, _SCREEN_DPI, facecolor="white", **how)
        bold: dict[str, Any] = {"fontsize": 20, "fontweight": "bold"}
        plain: dict[str, Any] = {"fontsize": SCREEN.text_pt, "color": GREY}
        for text, below_px, look in ((title, 43, bold), (subtitle, 87, plain)):
            if text:
                figure.text(0.02, 1 - below_px / height_px, text, va="center", **look)
        yield figure
        write_whole(path, written(figure, "png", _SCREEN_DPI))


KINDS = ("kept", "repeat", "undecided", "incomplete", "discarded")
_WORDS = {
    "kept": "kept",
    "repeat": "repeat, not learned from",
    "undecided": "not decided on",
    "incomplete": "incomplete",
    "discarded": "discarded",
}
_SPREAD = 0.42  # of an iteration, over which its trials lie side by side
_STEP = 0.13
_LANES = 0.6  # of an iteration, over which conditions lie side by side


def kind_of(row: TrialRow) -> str:
    """One of ``KINDS``. A trial whose amplitudes swam before, and that nothing was learned from, is
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
    """Where each trial lies on the axis of iterations: those of one iteration side by side in the
    order they were executed, and condition ``at`` of ``of`` beside the others."""
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
    """How a trial of that kind is drawn."""
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


def entry(label: str, **how: Any) -> Any:
    """Of a legend: a line or a marker, as ``Axes.plot`` takes it."""
    return _lines.Line2D([], [], label=label, **how)


def legend_of_kinds(analyses: Sequence[Analysis]) -> list[Any]:
    """One entry for every kind that there is, if there is more than one; conditions in grey."""
    there = {kind_of(row) for analysis in analyses for row in analysis.last_rows}
    if there <= {"kept"}:
        return []
    look = LOOKS[0] if len(analyses) == 1 else Look(GREY, "o", "-")
    return [
        _lines.Line2D([], [], label=_WORDS[kind], **marker(kind, look))
        for kind in KINDS
        if kind in there
    ]


def legend_of_conditions(names: Sequence[str]) -> list[Any]:
    """Line and marker of each, if there are several."""
    if len(names) < 2:
        return []
    return [
        _lines.Line2D([], [], color=look.colour, ls=look.dash, marker=look.marker, ms=4, label=name)
        for name, look in zip(names, LOOKS, strict=False)
    ]


def level(
    axes: Axes,
    value: float,
    text: str,
    left: bool = False,
    above: bool = True,
    fontsize: float = SCREEN.small_pt,
    **line: Any,
) -> None:
    """A line across with its name at one end."""
    axes.axhline(value, **{"zorder": 1, **line})
    axes.annotate(
        text, (0.005 if left else 0.995, value), (0, 1.5 if above else -2),
        xycoords=("axes fraction", "data"), textcoords="offset points", fontsize=fontsize,
        ha="left" if left else "right", va="bottom" if above else "top", color=INK, zorder=5,
    )  # fmt: skip
