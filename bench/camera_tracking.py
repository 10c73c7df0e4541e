"""How much faster than the film runs a fish is followed through it: decoding and tracking.

Two threads, one that decodes and one that tracks: on two cores a film takes as long as the busier
of them. Their processor times are judged, the best of some turns, so that a busy machine does not
slow it. Films are drawn from the simulator's scene with ripples and glare, the marker covered in
one picture of ten. The limit is decoding alone. Exits with 1 below a goal.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tailbeat.sensors.camera.marker.detector import Marker, detector_for
from tailbeat.sensors.camera.marker.tags import SearchWindow
from tailbeat.sensors.camera.render.painter import DrawnPose, Painter
from tailbeat.sensors.camera.render.scene import Scene
from tailbeat.sensors.camera.source.film import Film, FilmWriter
from tailbeat.sensors.camera.source.picture import TimedImage
from tailbeat.sensors.camera.tracking.track import track

MARKER = Marker("aruco", 7, 0.06)
HALF_WINDOW_PX = 60


@dataclass(frozen=True)
class Format:
    """Of a film. ``goal``: times real time."""

    size_px: tuple[int, int]
    fps: float
    goal: float

    @property
    def scene(self) -> Scene:
        return Scene(size_px=self.size_px, ripples=0.5, glare=0.5, hidden=0.1)


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    film_s: float
    turns: int


FORMATS = (Format((1280, 720), 25.0, 6.0), Format((1920, 1080), 60.0, 2.0))
FULL = Load(film_s=6.0, turns=3)


def draw(path: Path, form: Format, film_s: float) -> None:
    """A fish that swims along the tank."""
    painter = Painter(form.scene)
    with FilmWriter(path, form.size_px, form.fps) as writer:
        for k in range(int(form.fps * film_s)):
            t_s = k / form.fps
            wag = math.sin(2 * math.pi * t_s)
            truth = DrawnPose(t_s, 0.1 * t_s, 0.0, 0.1 * wag, 0.5 * wag, 0.0, 0.1)
            writer.add(painter.paint(truth, k), t_s)


def decode(path: Path) -> list[TimedImage]:
    """All pictures."""
    film, pictures = Film(path), []
    while (picture := film.read()) is not None:
        pictures.append(picture)
    return pictures


def cpu_s(work: Callable[[], object], turns: int) -> float:
    """Of this thread, the best of some turns."""
    best = math.inf
    for _ in range(turns):
        begin_s = time.thread_time()
        work()
        best = min(best, time.thread_time() - begin_s)
    return best


def follow(path: Path, form: Format) -> tuple[float, float, float]:
    """(wall seconds, CPU seconds of the thread that tracks, part of the pictures with a fish)."""
    film = Film(path)
    begin_s, begin_cpu_s = time.perf_counter(), time.thread_time()
    found = track(film, MARKER, form.scene.calibration(), patch=True)
    spent = time.perf_counter() - begin_s, time.thread_time() - begin_cpu_s
    film.close()
    return *spent, float(found.seen().mean())


def search_ms(path: Path, turns: int) -> tuple[float, float]:
    """A search of the whole picture, and of a window as the tracker takes it."""
    picture = decode(path)[0]
    detector = detector_for(MARKER)
    (fish,) = detector.find(picture.image)
    u, v = np.rint(fish.centre_px).astype(int)
    low_u, low_v, high_u, high_v = (int(at + side) for side in (-HALF_WINDOW_PX, HALF_WINDOW_PX)
                                    for at in (u, v))  # fmt: skip
    window = SearchWindow(low_u, low_v, high_u, high_v)
    whole_s = cpu_s(lambda: [detector.find(picture.image) for _ in range(10)], turns)
    window_s = cpu_s(lambda: [detector.find(picture.image, window) for _ in range(50)], turns)
    return whole_s / 10 * 1000, window_s / 50 * 1000


def measured(form: Format, load: Load) -> bool:
    """Prints one line; whether the goal is met."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fish.mp4"
        draw(path, form, load.film_s)
        turns = [follow(path, form) for _ in range(load.turns)]
        decode_s = cpu_s(lambda: decode(path), load.turns)
        whole_ms, window_ms = search_ms(path, load.turns)
    wall_s, track_s = (min(turn[column] for turn in turns) for column in (0, 1))
    pictures = form.fps * load.film_s
    times, limit = load.film_s / max(track_s, decode_s), load.film_s / decode_s
    width, height = form.size_px
    print(
        f"camera tracking, {width}x{height} at {form.fps:.0f} fps: {times:.1f} x real time on two"
        f" cores (goal {form.goal:.0f}, limit by decoding {limit:.1f}, {times / limit:.2f} of it;"
        f" wall {load.film_s / wall_s:.1f} x); a picture: decoding {decode_s / pictures * 1e3:.1f}"
        f" ms, tracking {track_s / pictures * 1e3:.1f} ms; search of all {whole_ms:.1f} ms, of a"
        f" window {window_ms:.1f} ms; fish seen in {turns[0][2]:.0%}"
    )
    return times >= form.goal


def main(load: Load = FULL) -> int:
    """Prints a line for each format. Exit status 1 below a goal."""
    cv2.setNumThreads(1)
    met = [measured(form, load) for form in FORMATS]
    return 0 if all(met) else 1


if __name__ == "__main__":
    raise SystemExit(main())
