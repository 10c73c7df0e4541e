"""Notes written before there is an experiment: they wait on disk until it begins."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from tailbeat.core.locks import locked
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.journal import Journal


def put_by(root: Path, unique_id: str, text: str, at: datetime) -> None:
    """Keeps it for the next experiment of this fish. Raises InputError, OSError."""
    root.mkdir(parents=True, exist_ok=True)
    with locked(root):
        _waiting(root, unique_id).add("note", at, text=text)


def bring(root: Path, unique_id: str, experiment: Experiment) -> int:
    """Writes what waits into the experiment, with the time of each; how many. What a full disk
    stops waits on. Raises InputError, OSError."""
    waiting = _waiting(root, unique_id)
    if not waiting.path.exists():
        return 0
    with locked(root):
        return _bring(waiting, experiment)


def _bring(waiting: Journal, experiment: Experiment) -> int:
    notes = waiting.entries("note")
    there = {(entry["time"], entry["text"]) for entry in experiment.journal.entries("note")}
    for note in notes:
        if (note["time"], note["text"]) not in there:  # else it was stopped half way
            experiment.note(note["text"], datetime.fromisoformat(note["time"]))
    waiting.path.unlink(missing_ok=True)
    return len(notes)


def _waiting(root: Path, unique_id: str) -> Journal:
    return Journal(root / f"notes-{unique_id}.jsonl")
