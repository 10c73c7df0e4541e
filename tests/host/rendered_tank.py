"""A simulated fish whose speed comes from drawn pictures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tailbeat.board.fish import Fish
from tailbeat.core.arrays import F64
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.sensors.camera.marker.detector import Marker
from tailbeat.sensors.camera.render.scene import Scene
from tailbeat.sensors.camera.render.source import RenderedDevice, SimulatedCamera
from tailbeat.sensors.camera.tracking.live import VideoCamera
from tailbeat.sensors.camera.tracking.track import Track
from tailbeat.sensors.camera.tracking.tracker import Tracker
from tailbeat.session.trial import run_trial


@contextmanager
def drawn_camera(fish: Fish, scene: Scene, patch: bool = False) -> Iterator[VideoCamera]:
    """What ``tailbeat trial run --camera rendered`` looks through."""
    source = RenderedDevice(SimulatedCamera(fish.sim), scene)
    marker = Marker(scene.marker, scene.marker_id, scene.marker_side_m)
    tracker = Tracker(marker, scene.calibration(), source.name, patch=patch)
    camera = VideoCamera(source, tracker, threaded=False)
    try:
        yield camera
    finally:
        camera.close()


@dataclass(frozen=True)
class Swum:
    """A trial, the film of it, and the truth. ``start_s``: of the swim in the film's time."""

    trial: Trial
    track: Track
    true_beats: F64
    start_s: float


def swim_before_the_camera(fish: Fish, scene: Scene, patch: bool = False) -> Swum:
    """The next trial, filmed. It stays pending."""
    with drawn_camera(fish, scene, patch) as camera:
        outcome = run_trial(fish, camera)
        track = camera.track()
    trial = read(fish, outcome.number)
    boot_s = fish.sim.time_s - fish.sim.board_time_s
    return Swum(trial, track, np.array(fish.sim.world.true_beats()), trial.start_us * 1e-6 + boot_s)


def read(fish: Fish, number: int) -> Trial:
    with TemporaryDirectory() as folder:
        return read_trial(fish.pull_trial(number, Path(folder)))
