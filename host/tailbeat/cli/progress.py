"""progress: what the trials prove, and when to stop."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.cli.common import Connect, Json, connected, mm, say, table

if TYPE_CHECKING:
    from tailbeat.model.identified import Identified
    from tailbeat.progress import Progress
    from tailbeat.trial_log import Trial


def progress(
    experiment: Annotated[
        Path | None,
        typer.Option("--experiment", metavar="DIR", help="Its trials; default: the logbook's."),
    ] = None,
    reference: Annotated[
        str | None,
        typer.Option("--reference", metavar="CRC", help="Like 0x1a2b3c4d; default: the last."),
    ] = None,
    plot: Annotated[Path | None, typer.Option("--plot", metavar="PNG", help="Draw it.")] = None,
    apply: Annotated[
        bool, typer.Option("--apply", help="Set the advised LAW_FADE, LAW_FADE_FROM on the board.")
    ] = False,
    logbook: Annotated[
        Path | None, typer.Option("--logbook", metavar="DIR", help="Folder of all logbooks.")
    ] = None,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Print what each trial proved, noise or progress, and whether to go on.

    Example: tailbeat progress --experiment experiments/2026-05-04_fish_thesis_p4_01
    """
    trials, identified, problems = _material(experiment, logbook, connect)
    from tailbeat.progress import progress_of

    found = progress_of(trials, _crc(reference), identified, problems)
    applied = _apply(found, connect) if apply else None
    if plot is not None:
        from tailbeat.report.progress_png import progress_png

        progress_png(found, plot)
    for problem in problems:
        typer.echo(f"tailbeat: {problem}", err=True)
    say(json, _document(found) | {"applied": applied}, lambda: _text(found, applied))


def _material(
    experiment: Path | None, root: Path | None, connect: str | None
) -> tuple[list[Trial], Identified | None, list[str]]:
    from tailbeat.cli.keeping import sound_identified
    from tailbeat.errors import InputError
    from tailbeat.logbook import logbook_of

    if experiment is not None:
        from tailbeat.progress import read_trials

        trials, problems = read_trials(experiment)
        return trials, None, problems
    with connected(connect) as fish:
        book = logbook_of(fish, root)
    if book is None:
        raise InputError(
            "a simulated fish in this process keeps no logbook.",
            "Give --experiment DIR, or --logbook DIR.",
        )
    trials, problems = book.load()
    return trials, sound_identified(book), problems


def _crc(text: str | None) -> int | None:
    from tailbeat.errors import InputError

    if text is None:
        return None
    try:
        return int(text, 0)
    except ValueError:
        raise InputError(f"'{text}' is no reference's CRC.", "Write it like 0x1a2b3c4d.") from None


def _apply(found: Progress, connect: str | None) -> dict[str, float]:
    from tailbeat.errors import InputError

    if found.fade is None:
        raise InputError(
            "there is nothing to apply: the series fluctuates no more than its noise.",
            "Run it without --apply.",
        )
    wanted = {"LAW_FADE": found.fade.fade, "LAW_FADE_FROM": float(found.fade.fade_from)}
    with connected(connect) as fish:
        return {name: fish.params.set(name, value).value for name, value in wanted.items()}


def _document(found: Progress) -> dict[str, Any]:
    fade = found.fade
    return {
        "reference_crc": found.reference_crc,
        "trials": found.rows,
        "verdict": found.verdict,
        "floor_m_s": found.floor_m_s,
        "visits": found.visits,
        "fluctuation": found.fluctuation,
        "fade": fade and {"LAW_FADE": fade.fade, "LAW_FADE_FROM": fade.fade_from},
        "problems": found.problems,
    }


def _text(found: Progress, applied: dict[str, float] | None) -> str:
    header = ["trial", "iteration", "max|e| mm/s", "RMS mm/s", "repeats", "verdict"]
    rows = [
        [
            str(row.trial),
            str(row.iteration),
            mm(row.max_abs_error_m_s),
            mm(row.rms_error_m_s),
            f"trial {row.repeat_of}" if row.repeat_of else "",
            row.words.partition(" (")[0],
        ]
        for row in found.rows
    ]
    return "\n".join([table(header, rows, left=(5,)), *_conclusion(found, applied)])


def _conclusion(found: Progress, applied: dict[str, float] | None) -> list[str]:
    verdict = found.verdict
    lines = []
    if verdict.best_trial:
        best = f"best: trial {verdict.best_trial}, {mm(verdict.best_max_abs_error_m_s)} mm/s"
        floor = f"; floor by the identified model {mm(found.floor_m_s)} mm/s"
        lines.append(f"{best}, {verdict.band.text()}{floor if found.floor_m_s else ''}")
    if verdict.stop:
        lines += [f"stop: {verdict.stop_reason}", verdict.advice]
    else:
        lines.append("go on: tailbeat trial run, tailbeat learn")
    if found.fade is not None and found.fluctuation is not None:
        names = f"LAW_FADE {found.fade.fade:g}, LAW_FADE_FROM {found.fade.fade_from}"
        how = "set" if applied else "set it with --apply"
        lines.append(
            f"trials fluctuate {found.fluctuation:.1f} times as much as repeats: "
            f"let the gain fall, {names} ({how})"
        )
    return lines
