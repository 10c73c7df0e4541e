"""The log of a swim, from the board into the experiment's raw files, and what it tells."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tailbeat.day.positions import as_csv, stash_of
from tailbeat.day.swums import stopped_by
from tailbeat.errors import InputError, reason
from tailbeat.results import BeatEvent, TrialOutcome
from tailbeat.straight import straightness, straightness_of_frames
from tailbeat.trial_log import read_trial

if TYPE_CHECKING:
    from tailbeat.camera.base import Frame
    from tailbeat.experiment.folder import Experiment
    from tailbeat.fish import Fish
    from tailbeat.straight import Straightness
    from tailbeat.trial_log import Trial


@dataclass(frozen=True)
class Log:
    """A swim's raw file, and what is in it and beside it. ``stopped``: why this program stopped it,
    as the journal has it; empty = it did not, or the journal does not know the swim yet."""

    path: Path
    trial: Trial
    straight: Straightness | None
    stopped: str = ""


@contextlib.contextmanager
def trial_is_safe(number: int, experiment: Experiment) -> Iterator[None]:
    """What the disk refuses comes out as one line; the trial waits on the board meanwhile."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"cannot keep trial {number} in {experiment.folder} ({reason(error)}); nothing is lost,"
            " it waits on the board",
            "Make room there and run the same command again: it goes on with this trial.",
        ) from error


def peek_log(fish: Fish, experiment: Experiment, number: int) -> Trial:
    """Pulls the log and keeps nothing. Raises InputError (disk full)."""
    with trial_is_safe(number, experiment):
        folder = experiment.folder / ".pulling"
        folder.mkdir(exist_ok=True)
        return read_trial(fish.pull_trial(number, folder))


def drop_peeked(experiment: Experiment, number: int) -> None:
    """Of a log that is not to be kept, and what the camera may have seen of a swim before it."""
    folder = experiment.folder / ".pulling"
    with contextlib.suppress(OSError):
        (folder / f"{number:04d}.ulg").unlink(missing_ok=True)
        stash_of(experiment, number).drop()
        folder.rmdir()


def keep_log(fish: Fish, experiment: Experiment, number: int) -> Log:
    """Pulls the log (an interrupted pull goes on), and keeps it and the positions of the camera.
    Raises InputError (disk full)."""
    with trial_is_safe(number, experiment):
        folder = experiment.folder / ".pulling"
        folder.mkdir(exist_ok=True)
        pulled = fish.pull_trial(number, folder)
        kept = experiment.keep_trial(pulled)
        trial = read_trial(kept)
        stash = stash_of(experiment, number)
        frames = stash.take(trial)
        if frames:
            experiment.add_raw(f"{kept.stem}_positions.csv", as_csv(frames, 0.0).encode())
        for path in (pulled, stash.path):
            path.unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # the beginning of another trial may lie there
            folder.rmdir()
    return Log(kept, trial, _straight(trial, frames), _stopped(experiment, kept))


def _stopped(experiment: Experiment, kept: Path) -> str:
    told = [entry for entry in experiment.journal.entries("swum") if entry.get("file") == kept.name]
    return stopped_by(map(str, told[-1].get("problems") or ())) if told else ""


def _straight(trial: Trial, frames: Sequence[Frame]) -> Straightness | None:
    found = straightness(trial)
    if found is None and frames and trial.executed_beats:
        return straightness_of_frames(frames, 0.0, trial.executed_beats, trial.beat_s)
    return found


def outcome_of(trial: Trial) -> TrialOutcome:
    """Of a swim that nobody here saw: as its log tells it."""
    beats = trial.beats
    events = [
        BeatEvent(
            trial.number,
            k,
            float(beats.applied_rad[k]),
            float(beats.reference_m_s[k]),
            _number(beats.speed_m_s[k]),
            _number(beats.sigma_m_s[k]),
            int(beats.samples[k]),
            bool(beats.amplitude_rad[k] > beats.applied_rad[k]),
            provisional=False,
        )
        for k in range(min(trial.executed_beats, len(beats.samples)))
    ]
    return TrialOutcome(trial.number, trial.iteration, trial.end, trial.executed_beats, events)


def _number(value: np.float32) -> float | None:
    return float(value) if np.isfinite(value) else None
