"""How figures look: sizes, lines and colours that also tell each other apart in grey."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tailbeat.experiment.analysis import Analysis

Draw = Callable[["Sequence[Analysis]", "Style"], "Figure"]


@dataclass(frozen=True)
class Style:
    """``width_m``: of one column as printed. Text is ``text_pt`` high there, never smaller than
    6 pt."""

    name: str
    width_m: float
    text_pt: float


PAGE = Style("page", 0.190, 9.0)
PAPER = Style("paper", 0.0889, 8.0)  # one column of an IEEE journal, 3.5 inches


def save(figure: Figure, path: Path) -> None:
    """As PDF, SVG or PNG by the name's ending, the same bytes for the same figure on one machine:
    no dates, no random ids."""
    raise NotImplementedError
