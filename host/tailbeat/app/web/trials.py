"""The experiment that the page goes on in, its trials as they are shown, and its notes."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from tailbeat.app.web.view import Screen
from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.reference import Reference, ReferenceLimits
from tailbeat.experiment import current as notes
from tailbeat.experiment.analysis import analyse
from tailbeat.experiment.current import begin, current, make, require_same
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import name_reference


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
            if found is not None:
                require_same(fish, found)
        except InputError as another:
            if fish.status().reference_crc is None:  # what it has learned is to be given back
                self._screen.trouble(another)
            else:
                self._screen.say(f"not going on in {found.name if found else ''}: {another}")
            found = None
        if found is not None and self._is_of_another_run(fish, found):
            self._screen.say(f"not going on in {found.name}: this board has begun anew since")
            found = None
        self._go_on_in(found)

    @staticmethod
    def _is_of_another_run(fish: Fish, experiment: Experiment) -> bool:
        """Whether the board knows nothing of what the folder holds: a simulated one that was
        started again. One that was given back what it had learned goes on."""
        status = fish.status()
        there = (experiment.raw / f"{status.next_trial:04d}.ulg").exists()
        return there and status.iteration == 0

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
        if self.experiment is None or not any(self.experiment.raw.glob("*.ulg")):
            name = self.experiment.name if self.experiment is not None else ""
            self._screen.set(
                rows=(), error_bound_m_s=None, start_error_m_s=None, assessment="", experiment=name
            )
            return
        self._screen.set(experiment=self.experiment.name)
        try:
            found = analyse(self.experiment)
        except (TailbeatError, OSError) as error:
            self._screen.trouble(error)
            return
        self._screen.set(
            rows=tuple(found.rows),
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
