"""Makes the files beside it again: make.py [FOLDER]. Only dates and times differ each time."""

from __future__ import annotations

import shutil
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

import numpy as np

from tailbeat import Experiment, Fish, Reference, read_trial, reference, run_trial
from tailbeat.experiment.export import export
from tailbeat.experiment.folder import copy_state
from tailbeat.session.collect import TrialLog, record_of
from tailbeat.session.log import SessionLog
from tailbeat.session.outcome import Decision

TRIALS = 3


def make(folder: Path) -> None:
    """Two references, an experiment of three simulated trials, one annotated log."""
    desired = reference.cosine(0.07, 6, 12)
    desired.to_csv(folder / "reference_beats.csv")
    t_s = np.arange(0, 40.5, 0.5)
    table = np.column_stack([t_s, np.round(0.04 * (1 - np.cos(2 * np.pi * t_s / 20)), 6)])
    np.savetxt(folder / "reference_curve.csv", table, "%g", ",", header="t_s,v_m_s", comments="")
    shutil.rmtree(folder / "experiment", ignore_errors=True)
    experiment = Experiment.at(folder / "experiment", "carangi", desired.name, "p4-lead1")
    with Fish.connect("sim:tank?seed=1") as fish:
        execute(fish, experiment, desired)
    (experiment.folder / ".write-lock").unlink()
    with tempfile.TemporaryDirectory() as made:
        log = export(experiment, ["ulog"], Path(made))[-1]
        shutil.copy(log, folder / f"annotated_{log.name}")


def execute(fish: Fish, experiment: Experiment, desired: Reference) -> None:
    """Trials, each logged, decided on and learned from as in a session."""
    fish.params.apply({"AMP_MAX_RAD": 0.785, "ILC_LEAD": 1.0})
    fish.upload_reference(desired)
    experiment.add_raw("reference.bin", desired.record())
    board = fish.info()
    experiment.write_settings(
        {
            "simulated": board.simulated,
            "board": board.board,
            "unique_id": board.unique_id,
            "firmware": board.build_id,
            "params": fish.params.values(),
            "conditions": {"water_temperature_degc": 21.5},
        }
    )
    log = SessionLog(experiment)
    for number in range(1, TRIALS + 1):
        status = fish.status()
        log.begun(number, status.iteration, None, status.battery_v, fish.clock.now_s())
        outcome = run_trial(fish)
        with tempfile.TemporaryDirectory() as pulled:
            kept = experiment.keep_trial(fish.pull_trial(outcome.number, Path(pulled)))
        recorded = record_of(outcome, TrialLog(kept, read_trial(kept), None), None)
        log.recorded(recorded)
        log.decided(recorded, Decision("keep"))
        log.journal.add("learned", **asdict(fish.learn(outcome.number)))
        copy_state(fish, experiment)


if __name__ == "__main__":
    make(Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).parent)
