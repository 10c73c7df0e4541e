"""report, experiment progress."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from tailbeat.app.cli._fish import Connect, connected
from tailbeat.app.cli._lazy import arg, opt
from tailbeat.app.cli._options import (
    EXPERIMENTS,
    Library,
    Plot,
    Root,
    sound_identified,
    verdict_lines,
)
from tailbeat.app.cli._terminal import Output, lines_of, pick, table, warn
from tailbeat.core.errors import InputError
from tailbeat.core.printable import mm
from tailbeat.core.trial_checks import never_measured
from tailbeat.experiment.current import note_set
from tailbeat.experiment.export import missing_formats
from tailbeat.experiment.folder import Experiment, list_experiments
from tailbeat.experiment.library import DISCARDED, library_of, read_trials
from tailbeat.experiment.redo import write_redo
from tailbeat.experiment.store import Kept
from tailbeat.learning.assessment import Progress, progress_of
from tailbeat.learning.identification import Identified
from tailbeat.report.figures.convergence import draw_progress
from tailbeat.report.paper import Written, write_report

_LIST = "list"


def _crc(text: str) -> str | int:
    try:
        return text if text == _LIST else int(text, 0)
    except ValueError:
        raise InputError(f"'{text}' is no reference's CRC.", "Write it like 0x1a2b3c4d.") from None


def progress(
    experiment: Path | None = opt("Its trials; default: those of the trial library.", "DIR"),
    reference: str | int | None = opt("0x1a2b3c4d, or list; default: the last.", "CRC", by=_crc),
    plot: Plot = None,
    apply: bool = opt("Set the advised ILC_DECR_RATE, ILC_DECR_FROM on the board."),
    library: Library = None,
    connect: Connect = None,
) -> Output:
    """Assess the convergence: disturbance or progress in each trial, go on or stop.

    Example: tailbeat experiment progress --experiment experiments/2026-05-04_fish_thesis_p4_01
    """
    known = _material(experiment, library, connect)
    for problem in known.problems:
        warn(problem)
    if isinstance(reference, str):
        rows = references_of(known)
        return Output({"references": rows}, lambda: _references_text(rows))

    trials = [one.trial for one in known.kept if not one.mark]
    found = progress_of(trials, reference, known.identified, known.problems)
    for problem in found.problems[len(known.problems) :]:
        warn(problem)
    left_out = _discarded(known, found)
    applied = _apply(found, connect) if apply else None
    if plot is not None:
        draw_progress(found, plot)
    document = _progress_document(found) | {"applied": applied, "discarded": left_out}
    return Output(document, lambda: _progress_text(found, applied, left_out))


@dataclass(frozen=True)
class _Material:
    kept: list[Kept]
    identified: Identified | None
    problems: list[str]


def _material(experiment: Path | None, root: Path | None, connect: str | None) -> _Material:
    if experiment is not None:
        kept, problems = read_trials(experiment)
        return _Material(kept, _identified_in(experiment), problems)
    with connected(connect) as fish:
        book = library_of(fish, root)
    if book is None:
        raise InputError(
            "a simulated fish in this process has no trial library.",
            "Give --experiment DIR, or --library DIR.",
        )
    kept, problems = book.kept()
    return _Material(kept, sound_identified(book), problems)


def _identified_in(experiment: Path) -> Identified | None:
    """What lies beside the trials."""
    for folder in (experiment / "raw", experiment):
        if (folder / "identified.json").is_file():
            return Identified.load(folder / "identified.json")
    return None


def references_of(known: _Material) -> list[dict[str, Any]]:
    """Every reference that was used, in the order of its last trial."""
    rows: dict[int, dict[str, Any]] = {}
    for one in known.kept:
        if one.mark:
            continue
        crc = one.trial.reference_crc
        row = rows.pop(crc, {"reference_crc": crc, "trials": 0})
        kept_at = datetime.fromtimestamp(one.path.stat().st_mtime)
        rows[crc] = {
            **row,
            "trials": row["trials"] + 1,
            "beats": len(one.trial.beats.samples),
            "last": kept_at.isoformat(sep=" ", timespec="minutes"),
        }
    return list(rows.values())


def _references_text(rows: list[dict[str, Any]]) -> str:
    cells = [
        [f"{row['reference_crc']:#010x}", row["trials"], row["beats"], row["last"]] for row in rows
    ]
    return table(["reference", "trials", "beats", "last"], cells, left=(0, 3))


def _discarded(known: _Material, found: Progress) -> list[int]:
    mine = [one for one in known.kept if one.trial.reference_crc == found.reference_crc]
    return [one.trial.number for one in mine if one.mark == DISCARDED]


def _apply(found: Progress, connect: str | None) -> dict[str, float]:
    if found.fade is None:
        raise InputError(
            "there is nothing to apply: the series fluctuates no more than its noise.",
            "Run it without --apply.",
        )
    with connected(connect) as fish:
        held = {name: fish.params.set(name, value).value for name, value in _advised(found).items()}
        note_set(fish, held)
    return held


def _advised(found: Progress) -> dict[str, float]:
    """The parameters of a decreasing gain, if one is advised."""
    fade = found.fade
    return {"ILC_DECR_RATE": fade.fade, "ILC_DECR_FROM": fade.fade_from} if fade else {}


def _progress_document(found: Progress) -> dict[str, Any]:
    return {
        **pick(found, "reference_crc", "verdict", "floor_m_s", "visits", "fluctuation", "problems"),
        "trials": found.rows,
        "fade": _advised(found) or None,
    }


def _progress_text(found: Progress, applied: dict[str, float] | None, discarded: list[int]) -> str:
    header = ["trial", "iteration", "max|e| mm/s", "RMS mm/s", "repeats", "assessment"]
    rows = [
        [
            row.trial,
            row.iteration,
            mm(row.max_abs_error_m_s),
            mm(row.rms_error_m_s),
            f"trial {row.repeat_of}" if row.repeat_of else "",
            row.words.partition(" (")[0],
        ]
        for row in found.rows
    ]
    missing = never_measured(found.visits)
    return lines_of(
        table(header, rows, left=(5,)),
        discarded and f"discarded, not counted: trial {', '.join(map(str, discarded))}",
        missing,
        _conclusion(found, applied),
    )


def _conclusion(found: Progress, applied: dict[str, float] | None) -> str:
    verdict, fade = found.verdict, found.fade
    best = fluctuates = ""
    if verdict.best_trial:
        best = f"best: trial {verdict.best_trial}, {mm(verdict.best_max_abs_error_m_s)} mm/s"
        bound = f"; the L2-optimal input leaves {mm(found.floor_m_s)} mm/s"
        best += f", {verdict.band.text()}{bound if found.floor_m_s else ''}"
    if fade is not None and found.fluctuation is not None:
        fluctuates = (
            f"trials fluctuate {found.fluctuation:.1f} times as much as repeats: use a decreasing"
            f" gain, ILC_DECR_RATE {fade.fade:g}, ILC_DECR_FROM {fade.fade_from}"
            f" ({'set' if applied else 'set it with --apply'})"
        )
    go_on = "go on: tailbeat trial run, tailbeat trial learn"
    return lines_of(best, verdict_lines(verdict) or go_on, fluctuates)


def report(
    experiment: Experiment | None = arg(
        "The experiment's folder; default: the newest below --root.",
        "FOLDER",
        by=Experiment.open,
        show_default=False,
    ),
    paper: bool = opt("Also figures as PDF and SVG, captions and tables."),
    against: list[Experiment] | None = opt(
        "Compare with another; repeatable.", "FOLDER", by=Experiment.open
    ),
    out: Path | None = opt("Default: report/ in the experiment.", "DIR", show_default=False),
    root: Root = EXPERIMENTS,
) -> Output:
    """Write one page about an experiment, and figures and tables for a paper.

    Example: tailbeat report --paper
    """
    chosen = experiment or newest(root)
    written = write_report(chosen, paper, against or [], out)
    write_redo(chosen)
    document = {"experiment": chosen.folder, **pick(written, "page", "figures", "tables")}
    if written.tables and (line := missing_formats()):
        warn(line)
    return Output(document, lambda: _text_report(chosen, written, named=experiment is not None))


def newest(root: Path) -> Experiment:
    """The one made last below ``root``. Raises InputError when there is none."""
    found = list_experiments(root)
    if not found:
        raise InputError(
            f"there is no experiment below {root}.",
            "Name its folder, or begin one: tailbeat experiment new --reference thesis",
        )
    return max(found, key=_made)


def _made(experiment: Experiment) -> tuple[float, str]:
    """When, by its settings; one without a time is the oldest."""
    try:
        moment = datetime.fromisoformat(str(experiment.settings().get("made", "")))
    except ValueError:
        return 0.0, experiment.name
    return moment.timestamp(), experiment.name


def _text_report(experiment: Experiment, written: Written, named: bool) -> str:
    figures, tables = written.figures, written.tables
    return lines_of(
        not named and f"the newest: {experiment.folder}",
        str(written.page),
        figures and f"{len(figures)} files of figures in {figures[0].parent}",
        tables and f"{len(tables)} tables in {tables[0].parent}",
    )
