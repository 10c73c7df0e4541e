"""What commands do with experiments and the trial library, and what they say of them."""

from __future__ import annotations

import math
from pathlib import Path
from shlex import quote
from tempfile import TemporaryDirectory
from typing import Any

from tailbeat.app.cli._options import connected
from tailbeat.app.cli._terminal import bytes_bar, table, warn
from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.printable import mm
from tailbeat.experiment.analysis import analyse
from tailbeat.experiment.compare import Comparison
from tailbeat.experiment.current import current
from tailbeat.experiment.folder import Experiment, list_experiments
from tailbeat.experiment.library import DISCARDED, Logbook, logbook_of
from tailbeat.learning.convergence import Verdict
from tailbeat.learning.identification import Identified
from tailbeat.learning.verdict import progress_of
from tailbeat.report.replay import Replay
from tailbeat.report.style import freedom_words
from tailbeat.session.decide import not_noted, noted_decision, pending_of, withdrawn_if_refused


def folder_or_current(folder: Path | None, connect: str | None) -> Experiment:
    """The one named, else that of the connected fish."""
    if folder is not None:
        return Experiment.open(folder)
    with connected(connect) as fish:
        found = current(fish)
    if found is None:
        raise InputError(
            "this fish is in no experiment.",
            "Name a folder, or begin one: tailbeat experiment new --reference thesis",
        )
    return found


def warn_of_problems(experiment: Experiment) -> None:
    """On stderr, one line each: raw files are never wrong in silence."""
    for line in experiment.raw_problems():
        warn(f"{line}; put a copy back, or do without that file")


def listed(root: Path) -> tuple[list[dict[str, Any]], str]:
    """(one row per experiment, the same for people)."""
    rows: list[dict[str, Any]] = []
    lines = []
    for experiment in list_experiments(root):
        trials, damaged = len(list(experiment.raw.glob("*.ulg"))), experiment.damaged()
        row = {"name": experiment.name, "folder": experiment.folder, "trials": trials}
        rows.append({**row, "damaged": damaged, "problems": experiment.raw_problems()})
        line = f"{experiment.name}  {trials} trial{'' if trials == 1 else 's'}"
        line += f"  DAMAGED: {', '.join(damaged)}" if damaged else ""
        unlisted = experiment.unlisted()
        lines.append(line + (f"  NOT LISTED: {', '.join(unlisted)}" if unlisted else ""))
    return rows, "\n".join(lines) or f"no experiments in {root}"


def show_document(experiment: Experiment) -> dict[str, Any]:
    """Settings, trials and notes; an experiment may have no trial yet."""
    settings = experiment.settings()
    document: dict[str, Any] = {
        "name": experiment.name,
        "folder": experiment.folder,
        "settings": settings,
        "conditions": settings.get("conditions", {}),
        "trials": [],
        "notes": experiment.notes(),
        "problems": experiment.raw_problems(),
    }
    if list(experiment.raw.glob("*.ulg")):
        try:
            found = analyse(experiment).document()
        except InputError as error:
            return document | {"problems": [*document["problems"], str(error)]}
        document |= {"trials": found["rows"], "problems": found["problems"]}
        document |= {
            key: found[key] for key in ("floor_m_s", "floor_by", "noise_m_s", "noise_freedom")
        }
    return document


def show_text(document: dict[str, Any]) -> str:
    """The same for people."""
    settings = document["settings"]
    simulated = ", simulated" if settings.get("simulated") else ""
    head = f"{document['name']}: {settings.get('fish')}, reference {settings.get('reference')}"
    lines = [f"{head}, law {settings.get('law')}{simulated}"]
    lines += [f"{key}: {settings[key]}" for key in ("configuration", "operator") if key in settings]
    lines += [f"{key}: {value}" for key, value in document["conditions"].items()]
    header = ["trial", "iteration", "end", "max|e| mm/s", "RMS", "yaw deg", "V", "decision"]
    rows = [_trial_cells(row) for row in document["trials"]]
    lines.append(table(header, rows, left=(2, 7)) if rows else "no trials yet")
    if document.get("floor_m_s") is not None:
        lines.append(f"error bound {mm(document['floor_m_s'])} mm/s ({document['floor_by']})")
    if document.get("noise_m_s") is not None:
        freedom = freedom_words(document["noise_freedom"])
        scatter = f"{mm(document['noise_m_s'])} mm/s (standard deviation, {freedom})"
        lines.append(f"repeats scatter by {scatter}")
    lines += [f"problem: {line}" for line in document["problems"]]
    notes = document["notes"].partition("\n")[2].strip()
    return "\n".join([*lines, *([notes] if notes else [])])


def _trial_cells(row: dict[str, Any]) -> list[str]:
    straight = row["straight"]
    yaw = "-" if straight is None else f"{math.degrees(straight['worst_yaw_rad']):.0f}"
    volts = [row["battery_start_v"], row["battery_end_v"]]
    decision = row["decision"] + (f": {row['reason']}" if row["reason"] else "")
    decision += f" (repeats trial {row['repeat_of']})" if row["repeat_of"] else ""
    decision += " (learned)" if row["learned"] and not row["rolled_back"] else ""
    decision += " (rolled back)" if row["rolled_back"] else ""
    return [
        str(row["trial"]),
        str(row["iteration"]),
        row["end"],
        mm(row["max_abs_error_m_s"]),
        mm(row["rms_error_m_s"]),
        yaw,
        "-" if volts[0] is None else f"{volts[0]:.2f}-{volts[1]:.2f}",
        decision.strip(),
    ]


def compared_text(found: Comparison, others: list[str], simulated: bool) -> str:
    """Two lines or three."""
    effect = f"effect g = {found.g:+.2f} (95 % interval {found.g_low:+.2f} to {found.g_high:+.2f})"
    need = "more than 1000" if found.repeats is None else str(found.repeats)
    lines = [
        found.words + (", simulated" if simulated else ""),
        f"{effect}, p = {found.p:.2g}; trials on each side to see such an effect: {need}",
    ]
    if others:
        lines.append(f"they differ in: {'; '.join(others)}")
    return "\n".join(lines)


def replay_text(found: Replay) -> str:
    """One quiet line when all is well."""
    head = "identical" if found.identical else "NOT identical"
    if found.identical and found.not_drawn:
        head = "nothing differs, but not all was compared"
    counts = [
        f"{found.raw} raw files",
        f"speeds of {len(found.recomputed)} trials",
        f"learning from {len(found.learned)}",
        f"{len(found.figures)} derived files",
    ]
    lines = [f"{head}: {', '.join(counts)} came out the same"]
    lines += [f"different: {line}" for line in found.different]
    lines += [f"not computed: trial {number}: {why}" for number, why in found.not_recomputed]
    lines += [f"not learned again: trial {number}: {why}" for number, why in found.not_learned]
    lines += [f"not compared: {name}: {why}" for name, why in found.not_drawn]
    return "\n".join(lines)


def keep_in_library(fish: Fish, path: Path) -> None:
    """Keeps a pulled trial; a library that cannot take it is reported on stderr and no reason to
    fail."""
    try:
        if (book := logbook_of(fish)) is not None:
            book.keep(path)
    except TailbeatError as error:
        warn(f"not kept in the trial library: {error}")


def discard_and_keep(fish: Fish, number: int | None, repeat: bool, reason: str = "") -> None:
    """Keeps the pending trial, then drops it without learning; only a ``repeat`` counts later. A
    trial that the library cannot keep (see stderr) is dropped all the same; one that belongs to
    an experiment only once it is there, with the ``reason``. Raises InputError (disk full), and
    Refused of a stopped board before anything is written."""
    pending = pending_of(fish, number, f"trial discard{_given(number, repeat, reason)}")
    noted = None
    if pending is not None:
        noted = noted_decision(fish, pending, "repeat" if repeat else "discard", reason)
    book, copy = None, None
    try:
        book = logbook_of(fish)
        if book is not None and pending is not None:
            copy = keep_pulled(fish, book, pending)
    except TailbeatError as error:
        warn(f"not kept in the trial library: {error}")
    with withdrawn_if_refused(noted):
        fish.discard(number)
    if noted is None and (line := not_noted(fish)):
        warn(line)
    if book is not None and copy is not None and not repeat:
        book.mark(copy, DISCARDED)


def _given(number: int | None, repeat: bool, reason: str) -> str:
    """What was typed behind the command."""
    words = [] if number is None else [str(number)]
    words += ["--repeat"] * repeat + (["--reason", quote(reason)] if reason else [])
    return "".join(f" {word}" for word in words)


def verdict_after_learning(
    fish: Fish, number: int, rolled_back: bool, kept: Path | None = None
) -> Verdict | None:
    """Assesses the trial by what the library has; fetches it unless it is ``kept`` there already.
    None without a library, or when the trial cannot be had (reported on stderr): the board has
    learned all the same."""
    try:
        if (book := logbook_of(fish)) is None:
            return None
        kept = kept or keep_pulled(fish, book, number)
        trials = [one.trial for one in book.kept(kept)[0] if not one.mark]
        return progress_of(trials, None, sound_identified(book), (), rolled_back).verdict
    except TailbeatError as error:
        warn(f"no assessment of trial {number}: {error}")
        return None


def pull_with_bar(fish: Fish, number: int, folder: Path) -> Path:
    """The trial's file, copied from the board into the folder."""
    with bytes_bar(f"trial {number}") as show:
        return fish.pull_trial(number, folder, show)


def keep_pulled(fish: Fish, book: Logbook, number: int) -> Path:
    """The trial's file in the trial library, copied from the board."""
    with TemporaryDirectory() as folder:
        return book.keep(pull_with_bar(fish, number, Path(folder)))


def warn_if_another(identified: Identified, unique_id: str) -> None:
    """Warns on stderr that the fish connected is not the one identified."""
    if identified.unique_id and identified.unique_id != unique_id:
        warn(f"identified on another fish ({identified.unique_id})")


def sound_identified(book: Logbook) -> Identified | None:
    """What was identified; None also for a damaged file, which is reported on stderr."""
    try:
        return book.identified()
    except TailbeatError as error:
        warn(error)
        return None


def verdict_text(verdict: Verdict | None) -> str:
    """The lines that follow what was learned."""
    if verdict is None:
        return ""
    lines = [verdict.words]
    if verdict.stop:
        lines += [f"stop: {verdict.stop_reason}", verdict.advice]
    elif verdict.saturation is not None:
        lines.append(verdict.saturation.text)
    return "".join(f"\n{line}" for line in lines)
