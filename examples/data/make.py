"""Makes the files beside it again: make.py [FOLDER]. Only dates and times differ each time."""

from __future__ import annotations

import math
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
from tailbeat.sim.world import Wires

TRIALS = 3
FILM_S, FILM_FPS, FILM_PX, MARKER_M = 2.0, 25.0, (640, 360), 0.12
IMU_S = 3.0


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
    (folder / "imu_rest.bin").write_bytes(imu_recording(IMU_S))
    film(folder / "film.mp4")
    with tempfile.TemporaryDirectory() as made:
        log = export(experiment, ["ulog"], Path(made))[-1]
        shutil.copy(log, folder / f"annotated_{log.name}")


def imu_recording(length_s: float) -> bytes:
    """What a VN-100 with factory settings sends at rest."""
    wires, recorded = Wires("tank", 1), b""
    wires.imu_power(on=True, now_us=0)
    while (due_us := wires.imu_due_us()) is not None and due_us < length_s * 1e6:
        wires.rest(due_us)
        recorded += wires.imu_read()
    return recorded


def film(path: Path) -> None:
    """A fish with a marker that moves along a tank at 0.1 m/s (needs the extra camera)."""
    from tailbeat.sensors.camera.render.painter import DrawnPose, Painter
    from tailbeat.sensors.camera.render.scene import Scene
    from tailbeat.sensors.camera.source.film import FilmWriter

    painter = Painter(Scene(size_px=FILM_PX, marker_side_m=MARKER_M, pixel_noise=0.5, ripples=0.2))
    with FilmWriter(path, FILM_PX, FILM_FPS) as writer:
        for picture in range(round(FILM_S * FILM_FPS)):
            t_s = picture / FILM_FPS
            tail_rad = 0.5 * math.sin(2 * math.pi * t_s)
            pose = DrawnPose(t_s, 0.1 * t_s, 0.0, 0.2 * tail_rad, tail_rad, 0.0, 0.1)
            writer.add(painter.paint(pose, picture), t_s)


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
