"""An experiment for tests: six trials of a simulated fish, one discarded, one a repeat."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tailbeat.board.fish import Fish
from tailbeat.core.reference import Reference
from tailbeat.experiment.current import make
from tailbeat.experiment.folder import Experiment, copy_state
from tailbeat.session.trial import run_trial

BEATS = 12
DISCARDED, REPEAT = 3, 5
DECISIONS = ("keep", "keep", "discard", "keep", "repeat", "keep")
REASONS = ("", "", "bumped the wall", "", "once more for the noise", "")
REFERENCE = Reference(1.0, (0.07 * np.sin(np.linspace(0.2, 2.9, BEATS))).astype(np.float32), "hill")


def swim_experiment(root: Path, plant: str = "tank", seed: int = 1, **params: float) -> Experiment:
    """Swum, decided and learned as a series does it, each step journalled; the board's state is
    copied. ``params``: besides those of a fish that is known."""
    with Fish.connect(f"sim:{plant}?seed={seed}") as fish:
        for name, value in {"ILC_LEAD": 1.0, "AMP_MAX_RAD": 0.785, **params}.items():
            fish.params.set(name, value)
        fish.upload_reference(REFERENCE)
        experiment = make(fish, root, REFERENCE, "carangi", {"water_temperature_degc": 21.5})
        for decision, reason in zip(DECISIONS, REASONS, strict=True):
            swim_one(fish, experiment, decision, reason)
    return experiment


def swim_one(fish: Fish, experiment: Experiment, decision: str, reason: str = "") -> Path:
    """One round of a series."""
    journal = experiment.journal
    fish.arm()
    outcome = run_trial(fish)
    with TemporaryDirectory() as folder:
        kept = experiment.keep_trial(fish.pull_trial(outcome.number, Path(folder)))
    told = {"iteration": outcome.iteration, "end": outcome.end, "file": kept.name}
    journal.add("swum", trial=outcome.number, **told)
    journal.add("decided", trial=outcome.number, decision=decision, reason=reason, file=kept.name)
    if decision == "keep":
        journal.add("learned", **asdict(fish.learn(outcome.number)))
    else:
        fish.discard(outcome.number)
    copy_state(fish, experiment)
    return kept


def writable(path: Path) -> Path:
    """As somebody who tampers makes it."""
    path.chmod(0o644)
    return path
