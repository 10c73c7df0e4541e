"""How much faster than the film runs a fish is followed through it: decoding and tracking.

One core, one decoding thread, 1280x720 at 25 fps, drawn from the simulator's scene with ripples
and glare, the marker covered in one picture of ten. Judged by processor time, the best of three
turns, so that a busy machine does not slow it. Exits with 1 below twice real time.
"""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tailbeat.sensors.camera.marker.detector import Marker, detector_for
from tailbeat.sensors.camera.marker.tags import SearchWindow
from tailbeat.sensors.camera.render.painter import DrawnPose, Painter
from tailbeat.sensors.camera.render.scene import Scene
from tailbeat.sensors.camera.source.film import Film, FilmWriter
from tailbeat.sensors.camera.tracking.tracker import Tracker

FPS = 25.0
SCENE = Scene(ripples=0.5, glare=0.5, hidden=0.1)
MARKER = Marker("aruco", 7, 0.06)
HALF_WINDOW_PX = 60


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    film_s: float
    turns: int
    goal: float  # times real time


FULL, TINY = Load(film_s=8.0, turns=3, goal=2.0), Load(film_s=0.4, turns=1, goal=0.0)


@contextmanager
def one_core() -> Iterator[None]:
    """This process runs on one core, where the system can do that."""
    cv2.setNumThreads(1)
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def draw(path: Path, film_s: float) -> None:
    """A fish that swims along the tank."""
    painter = Painter(SCENE)
    with FilmWriter(path, SCENE.size_px, FPS) as writer:
        for k in range(int(FPS * film_s)):
            t_s = k / FPS
            wag = math.sin(2 * math.pi * t_s)
            truth = DrawnPose(t_s, 0.1 * t_s, 0.0, 0.1 * wag, 0.5 * wag, 0.0, 0.1)
            writer.add(painter.paint(truth, k), t_s)


def seconds(work: Callable[[], object], turns: int) -> float:
    """Of processor time, all threads of this process; the best of some turns."""
    best = math.inf
    for _ in range(turns):
        begin_s = time.process_time()
        work()
        best = min(best, time.process_time() - begin_s)
    return best


def follow(path: Path, tracker: Tracker | None) -> list[Any]:
    """Every picture's place; only decoded without a ``tracker``."""
    film, places = Film(path), []
    try:
        while (picture := film.read()) is not None:
            places.append(tracker.look(picture) if tracker else None)
    finally:
        film.close()
    return places


def search_ms(path: Path, turns: int) -> tuple[float, float]:
    """A search of the whole picture, and of a window as the tracker takes it."""
    film = Film(path)
    picture = film.read()
    film.close()
    assert picture is not None
    detector = detector_for(MARKER)
    (fish,) = detector.find(picture.image)
    u, v = np.rint(fish.centre_px).astype(int)
    window = SearchWindow(
        int(u) - HALF_WINDOW_PX,
        int(v) - HALF_WINDOW_PX,
        int(u) + HALF_WINDOW_PX,
        int(v) + HALF_WINDOW_PX,
    )
    whole_s = seconds(lambda: [detector.find(picture.image) for _ in range(10)], turns)
    window_s = seconds(lambda: [detector.find(picture.image, window) for _ in range(50)], turns)
    return whole_s / 10 * 1000, window_s / 50 * 1000


def main(load: Load = FULL) -> int:
    """Prints one line. Exit status 1 below the goal."""
    turns = load.turns
    with one_core(), tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fish.mp4"
        draw(path, load.film_s)
        calibration = SCENE.calibration()
        both_s = seconds(
            lambda: follow(path, Tracker(MARKER, calibration, "the film", patch=True)), turns
        )
        decode_s = seconds(lambda: follow(path, None), turns)
        whole_ms, window_ms = search_ms(path, turns)
        seen = sum(p.frame is not None for p in follow(path, Tracker(MARKER, calibration, "film")))
    pictures = FPS * load.film_s
    times = load.film_s / both_s
    picture_ms, decode_ms = both_s / pictures * 1000, decode_s / pictures * 1000
    print(
        f"camera tracking: {times:.1f} x real time on one core (goal {load.goal:.0f}), 1280x720 at "
        f"25 fps: {picture_ms:.1f} ms a picture, {decode_ms:.1f} of it decoding; whole search "
        f"{whole_ms:.1f} ms, window {window_ms:.1f} ms; fish seen in {seen / pictures:.0%}"
    )
    return 0 if times >= load.goal else 1


if __name__ == "__main__":
    raise SystemExit(main())
