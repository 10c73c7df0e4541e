"""experiment new, use, set, note, list, show, compare, replay, export."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

from tailbeat.app.cli._fish import Connect, ConnectedFish
from tailbeat.app.cli._lazy import arg, opt
from tailbeat.app.cli._options import EXPERIMENTS, ReferenceName, Root, current_of, warn_of_problems
from tailbeat.app.cli._terminal import Output, lines_of, numbers, pick, table, warn
from tailbeat.core.errors import InputError
from tailbeat.core.printable import mm
from tailbeat.experiment.analysis import analyse, parse_conditions, set_conditions
from tailbeat.experiment.compare import Comparison, other_differences
from tailbeat.experiment.compare import compare as compare_sides
from tailbeat.experiment.current import made_before, make, own_reference, require_same
from tailbeat.experiment.current import use as make_current
from tailbeat.experiment.export import FORMATS, missing_formats
from tailbeat.experiment.export import export as export_files
from tailbeat.experiment.folder import Experiment, list_experiments
from tailbeat.experiment.library import library_of
from tailbeat.experiment.redo import redo_text, write_redo
from tailbeat.report.replay import Replay
from tailbeat.report.replay import replay as replay_all
from tailbeat.report.style import freedom_words

Folder = Annotated[Experiment, arg("The experiment's folder.", "FOLDER", by=Experiment.open)]
FolderOrCurrent = Annotated[
    Experiment | None,
    arg("Default: the one the connected fish is in.", "FOLDER", by=Experiment.open),
]

_FORMATS = "|".join(FORMATS)


@dataclass(frozen=True)
class ConditionOptions:
    """The conditions of an experiment."""

    water_temp: float | None = opt("Of the water, degrees Celsius.", "C")
    condition: list[str] | None = opt("Like water_depth_m=0.35 (unit in the name).", "KEY=VALUE")
    configuration: str | None = opt("How the fish is built, in a few words.")
    operator: str | None = opt("Who is at the tank.")

    def numbers(self) -> dict[str, str | float]:
        """Those with a unit. Raises InputError."""
        return parse_conditions(self.condition or [], self.water_temp)

    def words(self) -> dict[str, str]:
        """The others."""
        given = {"configuration": self.configuration, "operator": self.operator}
        return {key: value.strip() for key, value in given.items() if value is not None}


def new(
    fish: ConnectedFish,
    *,
    reference: ReferenceName = None,
    fish_name: str | None = opt("Name of the fish.", name="--fish"),
    given: ConditionOptions,
    another: bool = opt("Also when the last one has no trial."),
    root: Root = EXPERIMENTS,
) -> Output:
    """Make the folder of a new series, with the settings of the connected board.

    From now on 'trial run' of this fish adds to it. The same command again before any trial makes
    no second folder.

    Example: tailbeat experiment new --reference thesis --fish carangi --water-temp 21.5
    """
    conditions, words = given.numbers(), given.words()
    profile = reference or own_reference(fish)
    settings = {"conditions": conditions, **words, **({"fish": fish_name} if fish_name else {})}
    made = None if another else made_before(fish, root, profile, settings)
    if made is None:
        made = make(fish, root, profile, fish_name, conditions, words)
    same = fish.status().reference_crc == profile.crc
    if not same:
        file = made.folder / "reference.csv"
        warn(f"the board has another reference: tailbeat reference upload {file}")
    return Output({"folder": made.folder, "board_has_reference": same}, str(made.folder))


def use(fish: ConnectedFish, experiment: Folder) -> Output:
    """Continue an experiment: 'trial run' of the connected fish adds to it.

    Example: tailbeat experiment use experiments/2026-05-04_carangi_thesis_p4_01
    """
    require_same(fish, experiment)
    make_current(fish, experiment)
    remembered = library_of(fish) is not None
    experiment.journal.add("opened", unique_id=fish.unique_id())
    if not remembered:
        warn(
            "a simulated fish in this process is new every time. Name the folder in every"
            " command, or give it a seed (sim?seed=1) and set TAILBEAT_LOGBOOK."
        )
    warn_of_problems(experiment)
    document = {"folder": experiment.folder, "remembered": remembered}
    return Output(document, f"the fish is in {experiment.name}")


def set_(
    *,
    experiment: FolderOrCurrent = None,
    given: ConditionOptions,
    connect: Connect = None,
) -> Output:
    """Set conditions that became known later; the event log keeps the earlier ones.

    Example: tailbeat experiment set FOLDER --water-temp 22 --condition salinity_psu=0.3
    """
    experiment = experiment or current_of(connect)
    set_conditions(experiment, given.numbers(), given.words())
    write_redo(experiment)
    now = experiment.settings()
    text = ", ".join(f"{key} = {value}" for key, value in now["conditions"].items())
    document = {"folder": experiment.folder, "conditions": now["conditions"]}
    return Output(document, text or "set")


def list_(root: Root = EXPERIMENTS) -> Output:
    """Print the experiments below a folder, oldest first.

    Example: tailbeat experiment list
    """
    rows: list[dict[str, Any]] = []
    lines = []
    for experiment in list_experiments(root):
        trials, damaged = len(list(experiment.raw.glob("*.ulg"))), experiment.damaged()
        row = pick(experiment, "name", "folder") | {"trials": trials, "damaged": damaged}
        rows.append({**row, "problems": experiment.raw_problems()})
        line = f"{experiment.name}  {trials} trial{'' if trials == 1 else 's'}"
        line += f"  DAMAGED: {', '.join(damaged)}" if damaged else ""
        unlisted = experiment.unlisted()
        lines.append(line + (f"  NOT LISTED: {', '.join(unlisted)}" if unlisted else ""))
    status = int(any(row["problems"] for row in rows))
    text = "\n".join(lines) or f"no experiments in {root}"
    return Output({"experiments": rows}, text, status)


def show(
    experiment: FolderOrCurrent = None,
    redo: bool = opt("Print how to do it again, and write redo.md."),
    connect: Connect = None,
) -> Output:
    """Print an experiment: conditions, trials with their decisions, notes.

    Example: tailbeat experiment show experiments/2026-05-04_carangi_thesis_p4_01
    """
    experiment = experiment or current_of(connect)
    status = int(bool(experiment.raw_problems()))
    if redo:
        text = redo_text(experiment)
        warn_of_problems(experiment)
        return Output({"file": write_redo(experiment), "text": text}, text.rstrip(), status)
    document = _show_document(experiment)
    return Output(document, lambda: _show_text(document), status)


def _show_document(experiment: Experiment) -> dict[str, Any]:
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
        keys = ("problems", "floor_m_s", "floor_by", "noise_m_s", "noise_freedom")
        document |= {"trials": found["rows"]} | {key: found[key] for key in keys}
    return document


def _show_text(document: dict[str, Any]) -> str:
    """The same for people."""
    settings = document["settings"]
    simulated = ", simulated" if settings.get("simulated") else ""
    head = f"{document['name']}: {settings.get('fish')}, reference {settings.get('reference')}"
    header = ["trial", "iteration", "end", "max|e| mm/s", "RMS", "yaw deg", "V", "decision"]
    rows = [_trial_cells(row) for row in document["trials"]]
    bound, noise = document.get("floor_m_s"), document.get("noise_m_s")
    freedom = freedom_words(document["noise_freedom"]) if noise is not None else ""
    return lines_of(
        f"{head}, law {settings.get('law')}{simulated}",
        [f"{key}: {settings[key]}" for key in ("configuration", "operator") if key in settings],
        [f"{key}: {value}" for key, value in document["conditions"].items()],
        table(header, rows, left=(2, 7)) if rows else "no trials yet",
        bound is not None and f"error bound {mm(bound)} mm/s ({document['floor_by']})",
        freedom and f"repeats scatter by {mm(noise)} mm/s (standard deviation, {freedom})",
        [f"problem: {line}" for line in document["problems"]],
        document["notes"].partition("\n")[2].strip(),
    )


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


def note(
    first: str = arg("What to remember.", "[FOLDER] TEXT"),
    second: str | None = arg("", hidden=True),
    connect: Connect = None,
) -> Output:
    """Add a line with the time to the experiment's notes.

    Example: tailbeat experiment note experiments/2026-05-04_fish_thesis_p4_01 "water 22 °C"
    """
    text = first if second is None else second
    if not text.strip():
        raise InputError("the note is empty.", "Say what is to be remembered.")
    if second is None and Path(first).is_dir():
        raise InputError(f"what is to be noted in {first}?", 'Write it behind: note FOLDER "TEXT"')
    experiment = current_of(connect) if second is None else Experiment.open(Path(first))
    experiment.note(text)
    write_redo(experiment)
    return Output({"folder": experiment.folder, "notes": experiment.notes()}, "noted")


def compare(
    a: Experiment = arg("An experiment's folder.", "A", by=Experiment.open),
    b: Experiment = arg("Another one, of the same reference.", "B", by=Experiment.open),
    what: str = opt("Which error.", "max|rms", default="max"),
    iterations: str | None = opt("Default: repeats of the best input.", "4,5,6"),
) -> Output:
    """Compare two experiments: effect with its confidence interval, repeats needed.

    Example: tailbeat experiment compare experiments/A experiments/B --iterations 4,5,6
    """
    if a.folder.resolve() == b.folder.resolve():
        raise InputError(f"{a.folder} and {b.folder} are the same experiment.", "Name two.")
    chosen = numbers(iterations, "--iterations", int) if iterations else None
    sides = analyse(a), analyse(b)
    found = compare_sides(*sides, what, chosen)
    others = other_differences(a, b)
    warn_of_problems(a)
    warn_of_problems(b)
    simulated = any(side.simulated for side in sides)
    document = {**vars(found), "also_different": others}
    return Output(document, lambda: _compared_text(found, others, simulated))


def _compared_text(found: Comparison, others: list[str], simulated: bool) -> str:
    """Two lines or three."""
    effect = f"effect g = {found.g:+.2f} (95 % interval {found.g_low:+.2f} to {found.g_high:+.2f})"
    need = "more than 1000" if found.repeats is None else found.repeats
    return lines_of(
        found.words + (", simulated" if simulated else ""),
        f"{effect}, p = {found.p:.2g}; trials on each side to see such an effect: {need}",
        others and f"they differ in: {'; '.join(others)}",
    )


def replay(experiment: Folder) -> Output:
    """Compute everything again from the raw files, and compare each bit.

    Sums of the raw files, speeds and learning by the board's own code, then the analysis and the
    report's figures and tables.

    Example: tailbeat experiment replay experiments/2026-05-04_carangi_thesis_p4_01
    """
    with TemporaryDirectory() as scratch:
        found = replay_all(experiment, Path(scratch))
    document = {**vars(found), "identical": found.identical}
    return Output(document, lambda: _replay_text(found), status=0 if found.identical else 1)


def _replay_text(found: Replay) -> str:
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
    return lines_of(
        f"{head}: {', '.join(counts)} came out the same",
        [f"different: {line}" for line in found.different],
        [f"not computed: trial {number}: {why}" for number, why in found.not_recomputed],
        [f"not learned again: trial {number}: {why}" for number, why in found.not_learned],
        [f"not compared: {name}: {why}" for name, why in found.not_drawn],
    )


def export(
    experiment: Folder,
    formats: list[str] | None = opt(
        "Default: csv, mat and parquet; repeatable.", _FORMATS, name="--format"
    ),
    mcap: bool = opt("As --format mcap: one file with all trials and films."),
) -> Output:
    """Write the trials for other programs: tables, MCAP (Foxglove), annotated ULog (PlotJuggler).

    Example: tailbeat experiment export FOLDER --mcap
    """
    formats = list(dict.fromkeys([*(formats or []), *(["mcap"] if mcap else [])]))
    files = export_files(experiment, formats)
    if not formats and (line := missing_formats()):
        warn(line)
    warn_of_problems(experiment)
    return Output({"files": files}, "\n".join(map(str, files)))
