"""Does an experiment again from its raw files, and tells whether every bit comes out the same.

All of it happens in a copy: what is in the folder is only read, and what is made anew can depend on
nothing but raw files, journal, settings and notes.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tailbeat.core.errors import InputError
from tailbeat.core.speed_estimate import NothingToRecompute, recomputed
from tailbeat.core.trial_file import Trial
from tailbeat.experiment.analysis import ANALYSIS, Analysis, analyse, write_analysis
from tailbeat.experiment.folder import Experiment, held_state
from tailbeat.experiment.redo import relearn, write_redo
from tailbeat.report.paper import MADE, MAKERS, made_with, write_report

__all__ = ["Replay", "replay", "write_redo"]

REPORT = "report"
_COPIED = ("raw", "board", "settings.json", "journal.jsonl", "notes.md", "reference.csv")
_DRAWN = (".html", ".pdf", ".svg", ".png", ".mat", ".parquet")  # their bytes are the libraries'
_PARQUET = ".parquet"
_PARQUET_MAKER = "pyarrow"
_STALE = "is not what the folder gives now: it is older than the last entry, or was changed"


@dataclass
class Replay:
    """``raw``: files checked against their sums; ``recomputed``: trials whose speeds the board's
    own code gave again bit for bit; ``not_recomputed``: number and why (speeds were uploaded);
    ``learned``: trials after which the law, applied again, gives the very amplitudes of the next,
    ``not_learned``: those of which that cannot be told, and why; ``figures``: files that were made
    again, the analysis among them, ``not_drawn``: those that were not compared, and why;
    ``different``: what did not come out the same or is missing, one line each."""

    raw: int = 0
    recomputed: list[int] = field(default_factory=list)
    not_recomputed: list[tuple[int, str]] = field(default_factory=list)
    learned: list[int] = field(default_factory=list)
    figures: list[str] = field(default_factory=list)
    different: list[str] = field(default_factory=list)
    not_learned: list[tuple[int, str]] = field(default_factory=list)
    not_drawn: list[tuple[str, str]] = field(default_factory=list)

    @property
    def identical(self) -> bool:
        """Whether everything came out the same."""
        return not self.different


_RAW_FIRST = "raw files are not as they were: put them back from a copy, then again"


def replay(experiment: Experiment, scratch: Path) -> Replay:
    """Raw files against ``raw/SHA256SUMS``; speeds by recompute; learning by the C law; then
    ``analysis.json`` and the report's figures and tables, made anew in ``scratch`` and compared
    byte by byte with those in the folder. Raises InputError when there is nothing to compare."""
    analysis = analyse(experiment)
    raw = len(experiment.sums()) - len(experiment.damaged())
    found = Replay(raw, different=_problems(experiment, analysis))
    for trial in analysis.trials:
        _recompute(trial, found)
    _relearn(experiment, analysis, found)
    if experiment.raw_problems():
        found.not_drawn.append((f"{ANALYSIS} and {REPORT}", _RAW_FIRST))
    else:
        _make_again(experiment, scratch, found)
    return found


def _make_again(experiment: Experiment, scratch: Path, found: Replay) -> None:
    copy = _copy(experiment, scratch)
    if (experiment.folder / ANALYSIS).is_file():
        write_analysis(copy)
        _compare(experiment.folder, copy.folder, [ANALYSIS], found)
    else:
        found.not_drawn.append((ANALYSIS, "it is not there; make it: tailbeat report"))
    _redraw(experiment, copy, scratch, found)


def _problems(experiment: Experiment, analysis: Analysis) -> list[str]:
    """Raw files that cannot be trusted, and trials that cannot be read."""
    lines = experiment.raw_problems()
    read = {row.file for row in analysis.rows}
    unread = [path.name for path in experiment.trial_files() if path.name not in read]
    told = " ".join([*lines, *analysis.problems])
    return lines + [f"raw/{name} cannot be read" for name in unread if _is_bad(name, told)]


def _is_bad(name: str, told: str) -> bool:
    """Not those of another reference, runs, or a shorter copy of the same trial."""
    return name in told and f"raw/{name}" not in told and f"{name}: it has another" not in told


def _recompute(trial: Trial, found: Replay) -> None:
    number = trial.number
    try:
        is_same = recomputed(trial).identical
    except NothingToRecompute as error:
        found.not_recomputed.append((number, error.message))
        return
    except InputError as error:
        found.different.append(f"the speeds of trial {number} cannot be computed: {error.message}")
        return
    if is_same:
        found.recomputed.append(number)
    else:
        found.different.append(
            f"the speeds of trial {number}, computed again, are not those in its log"
            " (its firmware may have computed otherwise)"
        )


def _relearn(experiment: Experiment, analysis: Analysis, found: Replay) -> None:
    try:
        held = held_state(experiment)
    except InputError as error:
        found.different.append(error.message)
        held = None
    learning = relearn(analysis, held)
    found.learned, found.not_learned = learning.learned, learning.not_learned
    found.different += learning.different


def _copy(experiment: Experiment, scratch: Path) -> Experiment:

    folder = scratch / "again"
    folder.mkdir(parents=True)
    for name in _COPIED:
        source = experiment.folder / name
        if source.is_dir():
            shutil.copytree(source, folder / name)
        elif source.is_file():
            shutil.copy(source, folder / name)
    return Experiment.open(folder)


def _redraw(experiment: Experiment, copy: Experiment, scratch: Path, found: Replay) -> None:
    """The report as it was asked for; ``report/report.json`` tells how and by what."""

    folder = experiment.folder / REPORT
    if not (folder / MADE).is_file():
        if folder.is_dir():
            found.not_drawn.append((REPORT, f"it has no {MADE}: its options are unknown"))
        return
    made = _made(folder / MADE)
    files = _files(folder)
    others = _others(experiment, made)
    if isinstance(others, str):
        found.different.append(
            f"{REPORT} cannot be made again: {others}, which it compares with, is gone. Put it"
            " back, or make the report without it: tailbeat report"
        )
        found.not_drawn += [(f"{REPORT}/{name}", f"{others} is gone") for name in files]
        return
    write_report(copy, bool(made.get("paper")), others, scratch / REPORT)
    other_arrow = _changed_makers(made, (_PARQUET_MAKER,))
    missing = [
        name
        for name in _files(scratch / REPORT)
        if name not in (*files, ANALYSIS) and not (other_arrow and name.endswith(_PARQUET))
    ]
    found.different += [
        f"{REPORT}/{name} is missing; make it again: tailbeat report" for name in missing
    ]
    others_changed = _changed_makers(made, [name for name in MAKERS if name != _PARQUET_MAKER])
    for changed, kinds in ((others_changed, _DRAWN), (other_arrow, (_PARQUET,))):
        if changed:
            drawn = [name for name in files if name.endswith(kinds)]
            found.not_drawn += [(f"{REPORT}/{name}", f"made with {changed}") for name in drawn]
            files = [name for name in files if name not in drawn]
    _compare(
        folder, scratch / REPORT, [name for name in files if name != MADE], found, f"{REPORT}/"
    )


def _made(path: Path) -> dict[str, Any]:
    try:
        made = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(made, dict):
            raise ValueError("no object")
    except ValueError as error:
        raise InputError(f"{path} is damaged.", "Make the report again: tailbeat report") from error
    return made


def _others(experiment: Experiment, made: dict[str, Any]) -> list[Experiment] | str:
    """The experiments it was compared with, which lie beside it; or where one that is gone lay."""

    names = [str(name) for name in made.get("against", [])]
    gone = [name for name in names if not Experiment.is_at(experiment.folder / name)]
    return gone[0] if gone else [Experiment(experiment.folder / name) for name in names]


def _changed_makers(made: dict[str, Any], makers: Iterable[str]) -> str:
    """Another version draws other bytes of the same picture."""
    was, now = made.get("versions", {}), made_with()
    changed = [name for name in makers if was.get(name) != now[name]]
    return ", ".join(f"{name} {was.get(name, 'unknown')} (now {now[name]})" for name in changed)


def _files(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def _compare(was: Path, now: Path, names: Sequence[str], found: Replay, prefix: str = "") -> None:
    for name in names:
        again = now / name
        if not again.is_file():
            found.different.append(f"{prefix}{name} is not made any more")
        elif again.read_bytes() == (was / name).read_bytes():
            found.figures.append(f"{prefix}{name}")
        else:
            found.different.append(f"{prefix}{name} {_STALE}; make it again: tailbeat report")
