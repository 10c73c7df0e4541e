"""How the thesis's figures look: greys and line styles, made to survive a printer."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tailbeat.core.files import replace_file
from tailbeat.core.lazy import lazy
from tailbeat.report.style import STYLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

mpl: Any = lazy("matplotlib")
mpl_figure: Any = lazy("matplotlib.figure")

_DPI = 100
ACCENT = "#0b5394"  # prints as dark grey
LINES: tuple[dict[str, Any], ...] = (
    {"color": ACCENT, "lw": 2.6, "ls": "-"},
    {"color": "0.15", "lw": 2.0, "ls": (0, (6, 2.5))},
    {"color": "0.35", "lw": 2.0, "ls": (0, (1.5, 1.8))},
    {"color": "0.5", "lw": 2.2, "ls": (0, (8, 2, 1.5, 2))},
    {"color": "0.62", "lw": 2.4, "ls": "-"},
    {"color": "0.25", "lw": 1.4, "ls": (0, (3, 1.5))},
)
WANTED: dict[str, Any] = {"color": "0.8", "lw": 6.0, "ls": "-", "zorder": 1}


@contextmanager
def picture(path: Path, panels: int = 1, across: bool = True) -> Iterator[list[Axes]]:
    """Axes to draw on, side by side or on top of each other; written as a PNG at the end."""
    with mpl.rc_context(STYLE):
        size = (8.0 * panels, 6.0) if across else (10.0, 4.2 * panels)
        figure = mpl_figure.Figure(figsize=size, dpi=_DPI, facecolor="white", layout="constrained")
        grid: Any = figure.subplots(1 if across else panels, panels if across else 1, squeeze=False)
        axes = list(grid.ravel())
        for one in axes:
            one.grid(color="0.93", lw=1)
            one.set_axisbelow(True)
        yield axes
        out = io.BytesIO()
        figure.savefig(out, format="png", dpi=_DPI)
        replace_file(path, out.getvalue())


def legend(axes: Axes, **where: Any) -> None:
    """Beside the axes' box or in a corner that holds no data: over the plot by default."""
    place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": 2} | where
    axes.legend(frameon=False, fontsize=12.5, handlelength=2.8, **place)
