"""Speeds of your own tracker in a trial: external_camera.py [ADDRESS] (default: sim?seed=1).

Trial 1 gets positions while the fish swims, trial 2 gets beat speeds afterwards (SPD_SOURCE 1)."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from tailbeat import Fish, Reference, read_trial, reference, run_trial
from tailbeat.core.speed_source import Frame
from tailbeat.sensors.camera.render.source import SimulatedCamera


class OwnTracker:
    """Any class with these names is a camera; ``clock`` "host": t_s is that of time.monotonic()."""

    clock = "host"

    def __init__(self, fish: Fish) -> None:
        self.source = SimulatedCamera(fish.sim)  # your tracker takes its place
        self.fps = self.source.fps
        self.seen: list[Frame] = []

    def frames(self) -> list[Frame]:
        """Frames since the last call: t_s, x_m along the tank, y_m to the right, heading_rad."""
        self.seen += (new := self.source.frames())
        return new

    def close(self) -> None:
        """No more frames are needed."""


def beat_speeds(seen: list[Frame], begin_s: float, desired: Reference) -> np.ndarray:
    """Distance of each beat over its length, m/s; NaN outside of what was seen."""
    edges_s = begin_s + np.arange(desired.beats + 1) * desired.beat_s
    t_s, x_m = np.array([(frame.t_s, frame.x_m) for frame in seen]).T
    return np.diff(np.interp(edges_s, t_s, x_m, left=np.nan, right=np.nan)) / desired.beat_s


def main(address: str = "sim?seed=1") -> None:
    """One trial each way."""
    with Fish.connect(address) as fish, tempfile.TemporaryDirectory() as folder:
        fish.upload_reference(desired := reference.trapezoid(0.05, 3, 4))
        live = run_trial(fish, OwnTracker(fish))
        print(f"live: {fish.learn(live.number).measured_beats} of {desired.beats} beats")
        fish.params.set("SPD_SOURCE", 1.0)
        number = run_trial(fish, tracker := OwnTracker(fish)).number
        trial = read_trial(fish.pull_trial(number, Path(folder)))
        clock = fish.clock.reading  # the same moment by both clocks
        begin_s = clock.host_s + (trial.start_us * 1e-6 - clock.board_s) / fish.clock.rate
        fish.upload_speeds(number, beat_speeds(tracker.seen, begin_s, desired), 0.002)
        print(f"afterwards: {fish.learn(number).measured_beats} of {desired.beats} beats")


if __name__ == "__main__":
    main(*sys.argv[1:])
