"""The experiment that the page goes on in, its trials as they are shown, and its notes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from tailbeat.app.web.state import Screen, TrialCurve
from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.reference import Reference, ReferenceLimits
from tailbeat.core.trial_file import Trial
from tailbeat.experiment import current as notes
from tailbeat.experiment.analysis import analyse
from tailbeat.experiment.current import begin, current, has_lost, make, require_same
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import name_reference
from tailbeat.experiment.redo import write_redo
from tailbeat.experiment.trial_rows import TrialRow
from tailbeat.report.paper import write_report

_CURVES_MAX = 30
_AT_LIMIT = 1 - 1e-6


def _curve_of(trial: Trial) -> TrialCurve:
    beats, executed = trial.beats, trial.executed_beats
    limit_rad = trial.params.get("AMP_MAX_RAD", math.inf) * _AT_LIMIT
    speed = [float(v) if v == v else None for v in beats.speed_m_s]
    applied = [float(a) if k < executed else None for k, a in enumerate(beats.applied_rad)]
    return TrialCurve(
        trial.number,
        trial.iteration,
        tuple(map(float, beats.reference_m_s)),
        tuple(speed),
        tuple(applied),
        tuple(a is not None and a >= limit_rad for a in applied),
    )


class PageTrials:
    """``experiment``: None = the first trial begins one, below ``root``. Used by the worker's
    thread alone, but for ``raw_file``."""

    def __init__(self, root: Path, screen: Screen) -> None:
        self.root = root
        self.experiment: Experiment | None = None
        self._screen = screen
        self._uploaded: Reference | None = None

    def find(self, fish: Fish) -> None:
        """The one this fish is in, if it can go on there."""
        found = current(fish)
        try:
            if found is not None and not has_lost(fish, found):  # START gives it back
                require_same(fish, found)
        except InputError as another:
            self._screen.say(f"not going on in {found.name if found else ''}: {another}")
            found = None
        if found is not None and self._is_of_another_run(fish, found):
            self._screen.say(f"not going on in {found.name}: this board has begun anew since")
            found = None
        self._go_on_in(found)

    @staticmethod
    def _is_of_another_run(fish: Fish, experiment: Experiment) -> bool:
        """Whether the board knows nothing of what the folder holds: a simulated one that was
        started again. One that was given back what it had learned goes on, one that has lost its
        reference is given it."""
        status = fish.status()
        there = (experiment.raw / f"{status.next_trial:04d}.ulg").exists()
        return there and status.iteration == 0 and status.reference_crc is not None

    def for_series(self, fish: Fish) -> Experiment:
        """The one that the next trial is added to."""
        if self.experiment is None or self._is_of_another_run(fish, self.experiment):
            return self._begin(fish)
        return self.experiment

    def _begin(self, fish: Fish) -> Experiment:
        """A new one."""
        named = self._uploaded
        if named is not None and named.crc == fish.status().reference_crc:
            made = make(fish, self.root, named)
        else:
            made = begin(fish, self.root)
        self._screen.say(f"new experiment {made.folder}")
        self._go_on_in(made)
        return made

    def _go_on_in(self, experiment: Experiment | None) -> None:
        """From now on; with the notes that waited for it."""
        self.experiment = experiment
        if experiment is not None:
            try:
                if count := notes.bring(self.root, self._screen.now.unique_id, experiment):
                    self._screen.say(f"{count} earlier note(s) written into {experiment.name}")
            except (TailbeatError, OSError) as error:
                self._screen.trouble(error)
        self.refresh()

    def refresh(self) -> None:
        """Shows the trials as they are in the folder now."""
        name = self.experiment.name if self.experiment is not None else ""
        self._screen.set(experiment=name, reported=self.report_page() is not None)
        if self.experiment is None or not any(self.experiment.raw.glob("*.ulg")):
            self._screen.set(
                rows=(), made_by=(), curves=(), error_bound_m_s=None, start_error_m_s=None,
                assessment="", diagnosis="",
            )  # fmt: skip
            return
        try:
            found = analyse(self.experiment)
            entries = list(self.experiment.journal.entries())
        except (TailbeatError, OSError) as error:
            self._screen.trouble(error)
            return
        start = None if self._screen.now.track else last_start(entries)
        self._screen.set(
            rows=tuple(found.rows),
            made_by=made_by(found.rows, entries),
            start_pose=start or self._screen.now.start_pose,
            curves=tuple(map(_curve_of, found.trials[-_CURVES_MAX:])),
            error_bound_m_s=found.floor_m_s,
            start_error_m_s=found.start_error_m_s,
        )

    def upload(self, fish: Fish, reference: Reference) -> None:
        """Another reference for the board, with which learning begins anew."""
        limits = ReferenceLimits.from_params(fish.params.values())
        if problems := reference.check(limits):
            raise InputError(
                " ".join(p.meaning for p in problems), " ".join(p.remedy for p in problems)
            )
        fish.upload_reference(reference)
        name_reference(fish, reference)
        self._uploaded = reference
        self._screen.say(
            f"reference {reference.name}: {reference.beats} beats, {reference.travel_m:.2f} m"
        )

    def report(self) -> None:
        """Writes the report; the page shows where it is."""
        if self.experiment is None or not self._screen.now.rows:
            raise InputError("there is nothing to report yet.", "Run a trial first.")
        page = write_report(self.experiment).page
        write_redo(self.experiment)
        self._screen.set(reported=True)
        self._screen.say(f"report {page}")

    def report_page(self) -> Path | None:
        """The last report; None = there is none."""
        folder = self.experiment.folder if self.experiment is not None else None
        page = folder / "report" / "report.html" if folder is not None else None
        return page if page is not None and page.is_file() else None

    def note(self, text: str, at: datetime) -> None:
        """One that cannot be written stops nothing else."""
        try:
            if self.experiment is not None:
                self.experiment.note(text, at)
                self._screen.say(f"noted: {text}")
            else:
                notes.put_by(self.root, self._screen.now.unique_id, text, at)
                self._screen.say(f"noted, for the experiment that the first trial begins: {text}")
        except (TailbeatError, OSError) as error:
            self._screen.trouble(error)

    def raw_file(self, name: str) -> Path | None:
        """A file of the experiment's raw ones; only those listed in the snapshot."""
        experiment = self.experiment
        listed = {Path(row.file).name for row in self._screen.now.rows}
        return None if experiment is None or name not in listed else experiment.raw / name


Entry = Mapping[str, Any]

_LAWS = {
    "p": "P law on the board",
    "model": "model-based",
    "best": "best input so far",
    "uploaded": "uploaded",
    "": "not known",
}
# By the trial's file, which the board wrote: it has the last word. What was uploaded is told apart
# by the event log.
_BY_THE_BOARD = {"law": "p", "first": "p", "restored": "best"}


@dataclass(frozen=True)
class _Made:
    """By the event log: what made an input."""

    law: str
    why: str


def made_by(rows: Sequence[TrialRow], entries: Iterable[Entry]) -> tuple[str, ...]:
    """What made the input of each trial, in words; with the reason wherever it is another than that
    of the trial before."""
    logged = _logged(entries)
    words, before = [], None
    for row in rows:
        made = logged.get(row.file, _Made("", ""))
        law = _BY_THE_BOARD.get(row.input, made.law or row.input)
        why = made.why if law == made.law and law != before else ""
        name = _LAWS.get(law, law)
        words.append(f"{name} ({why})" if why else name)
        before = law
    return tuple(words)


def _logged(entries: Iterable[Entry]) -> dict[str, _Made]:
    """By the file's name. A number comes again after a board was made anew: the last one begun
    before the trial's file was kept is meant."""
    chosen: dict[Any, Entry] = {}
    laws: dict[Any, str] = {}
    found = {}
    for entry in entries:
        trial = entry.get("trial")
        match entry["what"]:
            case "input":
                chosen[trial] = entry
            case "begun":
                laws[trial] = str(entry.get("law") or "")
            case "swum":
                by = chosen.pop(trial, {})
                law = laws.pop(trial, "") or str(by.get("law", ""))
                why = str(by.get("why", "")) if by.get("law") == law else ""
                found[str(entry.get("file", ""))] = _Made(law, why)
    return found


def last_start(entries: Iterable[Entry]) -> tuple[float, float, float] | None:
    """x, y and heading of the last trial's start, as the camera had it; None: it never did."""
    poses = [entry.get("pose") for entry in entries if entry["what"] == "swum"]
    seen = [pose for pose in poses if pose and pose.get("source") == "camera"]
    if not seen:
        return None
    x_m, y_m, heading_rad = (float(seen[-1][name]) for name in ("x_m", "y_m", "heading_rad"))
    return x_m, y_m, heading_rad
