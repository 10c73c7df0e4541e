"""``tailbeat report``: a page to look at, figures and tables for a paper."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tailbeat.core.csv import spreadsheet_text
from tailbeat.core.errors import InputError, reason
from tailbeat.core.files import canonical, replacing_text, write_whole
from tailbeat.experiment.analysis import Analysis, analyse, round_to
from tailbeat.experiment.compare import compare
from tailbeat.experiment.export import export
from tailbeat.experiment.folder import Experiment
from tailbeat.report.figures import comparison, contraction, learning, trials
from tailbeat.report.page import Picture, material, page
from tailbeat.report.style import PAGE, PAPER, simulated_mark, written

if TYPE_CHECKING:
    from matplotlib.figure import Figure


FIGURES = {  # in the order of the page; each has draw, caption and alternative
    "learning": learning,
    "trials": trials,
    "contraction": contraction,
    "comparison": comparison,  # the last: only of several experiments
}
PAGE_NAME = "report.html"
CAPTIONS_NAME = "captions.txt"
MADE = "report.json"
MAKERS = ("tailbeat", "matplotlib", "numpy", "scipy", "pyarrow")
_FOLDER = "report"
_TABLES = "tables"
_COMPARISON_NAME = "comparison.csv"
_PAPER_KINDS = ("pdf", "svg")
_EFFECT_DIGITS = 6  # found by bisection to 1e-10, over nodes of matrix algebra


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
    """Into ``report/`` of the experiment (or ``folder``): ``report.html``; with ``paper`` also
    every figure as PDF and SVG in one column's width with ``captions.txt``, and ``tables/`` (CSV,
    MATLAB, Parquet if pyarrow is installed: trials, beats, slots). ``against``: other experiments
    of the same reference; then there is the ``comparison``. Everything of a simulated fish carries
    the word ``simulated``: page, every figure, every table. ``report.json`` holds the options and
    versions, for a replay. Figures for a paper that are there already are made anew, never left
    behind older than the page. Also writes ``analysis.json``, with ``folder`` in there. The same
    experiment gives the same bytes. Raises InputError."""

    analyses = [analyse(one) for one in (experiment, *against)]
    require_one_reference(analyses)
    target = folder or experiment.require_own(experiment.folder / _FOLDER)
    if folder is None:
        experiment.require_own(target / _TABLES)
    paper = paper or any((target / f"{name}.pdf").is_file() for name in FIGURES)
    try:
        return _write(experiment, analyses, target, _Options(paper, against, folder is None))
    except OSError as error:
        raise InputError(
            f"cannot write the report into {target} ({reason(error)}).",
            "Make room on this computer, or name another folder with --out.",
        ) from error


@dataclass(frozen=True)
class _Options:
    paper: bool
    against: Sequence[Experiment]
    in_place: bool


def _write(
    experiment: Experiment, analyses: Sequence[Analysis], folder: Path, options: _Options
) -> Written:

    folder.mkdir(parents=True, exist_ok=True)
    beside = experiment.folder if options.in_place else folder
    write_whole(beside / "analysis.json", canonical(analyses[0].document()))
    drawings = draw_all(analyses)
    path = folder / PAGE_NAME
    write_whole(path, page(analyses, material(experiment), [one.picture for one in drawings]))
    figures: list[Path] = []
    tables: list[Path] = []
    if options.paper:
        _remove_comparison(folder)
        figures = _paper_figures(drawings, simulated_mark(analyses), folder)
        tables = _tables(experiment, analyses, folder / _TABLES)
    write_whole(folder / MADE, json.dumps(_told(experiment, options), indent=2) + "\n")
    return Written(path, figures, tables)


@dataclass(frozen=True)
class Drawing:
    """A figure for the page, and the same for a paper, of which the narrow picture is made."""

    picture: Picture
    printed: Figure


def draw_all(analyses: Sequence[Analysis]) -> list[Drawing]:
    """The figures there are of these; a comparison takes two."""
    drawings = []
    for name, module in FIGURES.items():
        if module is comparison and len(analyses) < 2:
            continue
        printed = module.draw(analyses, PAPER)
        wide = written(module.draw(analyses, PAGE), "svg")
        picture = Picture(
            name,
            wide,
            written(printed, "svg"),
            module.caption(analyses),
            module.alternative(analyses),
        )
        drawings.append(Drawing(picture, printed))
    return drawings


def _remove_comparison(folder: Path) -> None:
    """An older one may be of other experiments."""
    old = [folder / f"comparison.{kind}" for kind in _PAPER_KINDS]
    for path in (*old, folder / _TABLES / _COMPARISON_NAME):
        path.unlink(missing_ok=True)


def _told(experiment: Experiment, options: _Options) -> dict[str, Any]:
    """Where the others lie seen from this experiment, so that a copy of all of them replays."""

    others = [Path(os.path.relpath(one.folder, experiment.folder)) for one in options.against]
    against = [other.as_posix() for other in others]
    return {"paper": options.paper, "against": against, "versions": made_with()}


def require_one_reference(analyses: Sequence[Analysis]) -> None:
    """Errors against different references do not compare. Raises InputError."""
    first = analyses[0]
    for other in analyses[1:]:
        if (other.reference_crc, other.beat_s) != (first.reference_crc, first.beat_s):
            raise InputError(
                f"{other.name} has the reference {other.reference_name or 'without a name'} "
                f"({other.reference_crc:#010x}), {first.name} "
                f"{first.reference_name or 'one without a name'} ({first.reference_crc:#010x}).",
                "Compare experiments of one reference.",
            )


def _paper_figures(drawings: Sequence[Drawing], mark: str, folder: Path) -> list[Path]:
    """``mark``: what the captions say of simulated fish."""

    paths, captions = [], []
    for drawing in drawings:
        picture = drawing.picture
        for kind in _PAPER_KINDS:
            path = folder / f"{picture.name}.{kind}"
            is_svg = kind == "svg"
            write_whole(path, picture.narrow if is_svg else written(drawing.printed, kind))
            paths.append(path)
        simulated = f"{mark.capitalize()}. " if mark else ""
        captions.append(f"{picture.name}\n{simulated}{picture.caption}\n")
    words = folder / CAPTIONS_NAME
    write_whole(words, "\n".join(captions))
    return [*paths, words]


def _tables(experiment: Experiment, analyses: Sequence[Analysis], folder: Path) -> list[Path]:

    paths = export(experiment, folder=folder)
    if len(analyses) > 1:
        paths.append(_comparison_table(analyses, folder / _COMPARISON_NAME))
    return paths


def _comparison_table(analyses: Sequence[Analysis], path: Path) -> Path:
    """One row per other experiment and measure, this one less the other; none where too few trials
    count."""
    import csv

    rows: list[list[Any]] = []
    for other in analyses[1:]:
        for what in ("max", "rms"):
            try:
                found = compare(other, analyses[0], what)
            except InputError:
                continue
            made_up = other.simulated or analyses[0].simulated
            rows.append([read(found, other, analyses[0], made_up) for read in _COMPARISON.values()])
    with replacing_text(path) as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(_COMPARISON)
        out.writerows([[_cell(value) for value in row] for row in rows])
    return path


def _cell(value: Any) -> Any:

    return spreadsheet_text(value) if isinstance(value, str) else value


_COMPARISON: dict[str, Callable[..., Any]] = {
    "what": lambda found, *_: found.what,
    "experiment": lambda _found, _other, this, _: this.name,
    "against": lambda _found, other, *_: other.name,
    "swims": lambda found, *_: len(found.b_m_s),
    "swims_against": lambda found, *_: len(found.a_m_s),
    "difference_m_s": lambda found, *_: round_to(found.difference_m_s),
    "low_m_s": lambda found, *_: round_to(found.difference_low_m_s),
    "high_m_s": lambda found, *_: round_to(found.difference_high_m_s),
    "hedges_g": lambda found, *_: round_to(found.g, _EFFECT_DIGITS),
    "hedges_g_low": lambda found, *_: round_to(found.g_low, _EFFECT_DIGITS),
    "hedges_g_high": lambda found, *_: round_to(found.g_high, _EFFECT_DIGITS),
    "p": lambda found, *_: round_to(found.p, _EFFECT_DIGITS),
    "worse": lambda found, *_: found.worse[1],
    "worse_against": lambda found, *_: found.worse[0],
    "repeats_needed": lambda found, *_: "" if found.repeats is None else found.repeats,
    "simulated": lambda *given: given[-1],
}


def made_with() -> dict[str, str]:
    """Versions of what draws and writes: for ``report/report.json``."""
    found = {}
    for name in MAKERS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found
