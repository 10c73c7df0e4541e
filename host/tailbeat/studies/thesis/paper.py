"""The paper: what was found, the ledger and the figures, as one PDF and one HTML page."""

from __future__ import annotations

import io
import re
import textwrap
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from tailbeat.core.extras import lazy
from tailbeat.core.files import write_whole
from tailbeat.core.parallel import one_thread
from tailbeat.report.style import GREY, INK, mpl_figure
from tailbeat.studies.thesis.example import VERDICTS, Claim, Example, Figure, Sketch
from tailbeat.studies.thesis.ledger import findings
from tailbeat.studies.thesis.picture import compose, sheets, with_ending
from tailbeat.studies.thesis.study import Study

_pdf: Any = lazy("matplotlib.backends.backend_pdf")

TITLE = "On Iterative Learning Control for Solving New Control Problems, recomputed"
SUBJECT = "X. Li, PhD thesis, National University of Singapore, 2016, chapters 2 to 8"
_A4_IN = (8.27, 11.69)
_LEFT, _TOP, _BOTTOM = 0.09, 0.93, 0.07  # of the page
_WITHIN = (0.09, 0.06, 0.82, 0.88)  # of the page: figures
_LINES = 68  # of small text on a page
_CHARS = 112  # of small text in a line


@dataclass(frozen=True)
class Paper:
    """``claims``: all that were judged; ``figures``: those with a number, in their order."""

    claims: Sequence[Claim]
    figures: Sequence[Figure]

    @property
    def counts(self) -> Mapping[str, int]:
        """The thesis's claims by verdict."""
        counted = Counter(claim.verdict for claim in self.claims if not claim.ours)
        return {verdict: counted[verdict] for verdict in VERDICTS}

    @property
    def findings(self) -> list[tuple[str, str]]:
        """(title, text) of those whose claims were all judged."""
        measured = {claim.id: claim.measured for claim in self.claims}
        return [
            (one.title, one.text.format(c=measured))
            for one in findings()
            if set(one.claims) <= set(measured)
        ]

    def by_chapter(self) -> Iterator[tuple[int, list[Claim]]]:
        """The claims in the thesis's order."""
        for chapter in sorted({int(claim.id[0]) for claim in self.claims}):
            yield chapter, [claim for claim in self.claims if int(claim.id[0]) == chapter]


def measured_text(claim: Claim) -> str:
    """What was measured, in four digits."""
    if isinstance(claim.measured, str):
        return claim.measured
    return ", ".join(f"{value:.4g}" for value in np.atleast_1d(claim.measured))


def write_html(paper: Paper, path: Path) -> None:
    """One file, its figures within. Raises InputError when it cannot be written."""
    templates = Environment(
        loader=PackageLoader("tailbeat", "studies/thesis"),
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    drawn = [
        (one, _inline(with_ending(one.path.with_name(one.path.stem), "svg").read_text("utf-8")))
        for one in paper.figures
    ]
    page = templates.get_template("paper.html.j2").render(
        paper=paper, title=TITLE, subject=SUBJECT, figures=drawn, measured=measured_text
    )
    write_whole(path, page)


def _inline(svg: str) -> str:
    return re.sub(r"^.*?(?=<svg)", "", svg, count=1, flags=re.DOTALL)


def write_pdf(
    paper: Paper, sketches: Sequence[tuple[Example, Sketch]], path: Path,
    show: Callable[[float], None] = lambda done: None,
) -> None:  # fmt: skip
    """Findings, ledger, then two figures a page, each composed anew: as vectors. Raises InputError
    when it cannot be written."""
    out = io.BytesIO()
    studies: dict[str, Study] = {}
    dates = {"CreationDate": None, "Producer": None, "Creator": "tailbeat", "Title": TITLE}
    with _pdf.PdfPages(out, metadata=dates) as pages:
        for lines in _pages(_text(paper)):
            pages.savefig(_text_page(lines))
        for at in range(0, len(sketches), 2):
            show(at / len(sketches))
            pages.savefig(_figure_page(sketches[at : at + 2], studies))
    write_whole(path, out.getvalue())


_Line = tuple[str, str]  # (kind, text)


def _text(paper: Paper) -> Iterator[_Line]:
    yield "title", TITLE
    yield "small", SUBJECT
    yield "small", ""
    for verdict, count in paper.counts.items():
        yield "small", f"{count:3d}  {verdict}"
    yield "head", "What was found"
    for title, text in paper.findings:
        yield "bold", title
        yield from _wrapped(text)
    for chapter, claims in paper.by_chapter():
        yield "head", f"Claims of chapter {chapter}"
        for claim in claims:
            yield "bold", f"{claim.claim}: {claim.verdict}"
            whose = "Not of the thesis" if claim.ours else claim.where
            quote = f' "{claim.quote}"' if claim.quote else ""
            yield from _wrapped(
                f"[{claim.id}] {whose}.{quote}",
                f"Computed: {claim.computed}. Criterion: {claim.criterion}.",
                f"Measured: {measured_text(claim)}. {claim.note}",
            )


def _wrapped(*paragraphs: str) -> Iterator[_Line]:
    for text in paragraphs:
        yield from (("small", line) for line in textwrap.wrap(text, _CHARS))
    yield "small", ""


_WIDTHS = {"title": 62, "head": 80, "bold": 96, "small": _CHARS}  # characters of a line
_HEIGHTS = {"title": 2, "head": 3, "bold": 1, "small": 1}  # lines of small text
_KEPT_WITH = {"head": 5, "bold": 3}  # lines of small text that must follow on the page
_LOOKS: dict[str, dict[str, Any]] = {
    "title": {"fontsize": 15, "fontweight": "bold"},
    "head": {"fontsize": 12, "fontweight": "bold"},
    "bold": {"fontsize": 9, "fontweight": "bold"},
    "small": {"fontsize": 8.6},
}


def _pages(lines: Iterator[_Line]) -> Iterator[list[_Line]]:
    """Whole pages; a heading is never the last on one."""
    page: list[_Line] = []
    used = 0
    for kind, text in lines:
        for part in textwrap.wrap(text, _WIDTHS[kind]) or [""]:
            needed = _HEIGHTS[kind] + _KEPT_WITH.get(kind, 0)
            if used + needed > _LINES:
                yield page
                page, used = [], 0
            page.append((kind, part))
            used += _HEIGHTS[kind]
    yield page


def _text_page(lines: Sequence[_Line]) -> Any:
    with sheets():
        page = mpl_figure.Figure(_A4_IN, facecolor="white")
        line, y = (_TOP - _BOTTOM) / _LINES, _TOP
        for kind, text in lines:
            y -= line * _HEIGHTS[kind]
            page.text(_LEFT, y, text, parse_math=False, color=INK, **_LOOKS[kind])
    return page


def _figure_page(sketches: Sequence[tuple[Example, Sketch]], studies: dict[str, Study]) -> Any:
    with sheets(8.0), one_thread(), np.errstate(all="ignore"):
        page = mpl_figure.Figure(_A4_IN, facecolor="white", layout="constrained")
        page.get_layout_engine().set(rect=_WITHIN)
        for (example, sketch), part in zip(sketches, page.subfigures(2, 1), strict=False):
            study = studies.setdefault(example.id, Study(example))
            drawing = sketch.compose(study)
            compose(part, drawing)
            words = f"{sketch.name}: {sketch.figure(drawing, Path()).words}"
            caption = "\n".join(textwrap.wrap(words, _CHARS))
            part.supxlabel(caption, fontsize=8, color=GREY, parse_math=False)
    return page
