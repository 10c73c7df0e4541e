"""What the commands of experiments say, and which folder they mean."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tailbeat.app.cli._terminal import connected, echo, mm, table

if TYPE_CHECKING:
    from tailbeat.experiment.compare import Comparison
    from tailbeat.experiment.folder import Experiment
    from tailbeat.report.replay import Replay


def folder_or_current(folder: Path | None, connect: str | None) -> Experiment:
    """The one named, else that of the connected fish."""
    from tailbeat.core.errors import InputError
    from tailbeat.experiment.current import current
    from tailbeat.experiment.folder import Experiment

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


def tell_problems(experiment: Experiment) -> None:
    """On stderr, one line each: raw files are never wrong in silence."""
    for line in experiment.raw_problems():
        echo(f"tailbeat: {line}; put a copy back, or do without that file", err=True)


def listed(root: Path) -> tuple[list[dict[str, Any]], str]:
    """(one row per experiment, the same for people)."""
    from tailbeat.experiment.folder import list_experiments

    rows: list[dict[str, Any]] = []
    lines = []
    for experiment in list_experiments(root):
        trials, problems = len(list(experiment.raw.glob("*.ulg"))), experiment.raw_problems()
        damaged = experiment.damaged()
        row = {"name": experiment.name, "folder": experiment.folder, "trials": trials}
        rows.append({**row, "damaged": damaged, "problems": problems})
        line = f"{experiment.name}  {trials} trial{'' if trials == 1 else 's'}"
        line += f"  DAMAGED: {', '.join(damaged)}" if damaged else ""
        unlisted = experiment.unlisted()
        lines.append(line + (f"  NOT LISTED: {', '.join(unlisted)}" if unlisted else ""))
    return rows, "\n".join(lines) or f"no experiments in {root}"


def show_document(experiment: Experiment) -> dict[str, Any]:
    """Settings, trials and notes; an experiment may have no trial yet."""
    from tailbeat.core.errors import InputError
    from tailbeat.experiment.analysis import analyse

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
    from tailbeat.report.style import freedom_words

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
        lines.append(f"floor {mm(document['floor_m_s'])} mm/s ({document['floor_by']})")
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
        f"{effect}, p = {found.p:.2g}; swims on each side to see such an effect: {need}",
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
