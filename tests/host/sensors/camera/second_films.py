"""Films of the second tank (second_tank) through the host tool: calibration, track, speed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.core.errors import InputError
from tailbeat.sensors.camera.calibration.calibrate import Height, calibrate
from tailbeat.sensors.camera.calibration.file import Calibration
from tailbeat.sensors.camera.calibration.points import TankPoint, rectangle
from tailbeat.sensors.camera.marker.detector import Marker
from tailbeat.sensors.camera.marker.tags import board
from tailbeat.sensors.camera.source.film import Film
from tailbeat.sensors.camera.speed import swim_speed
from tailbeat.sensors.camera.tracking.track import Track, track

from .second_optics import Floats, Optics, Waves
from .second_tank import Filming, Swim, board_pictures, write_film

MARKER = Marker("aruco", 7, 0.06)
_SQUARE_PX = 60


def filming(kind: str, seed: int, optics: Optics | None = None) -> Filming:
    """One of KINDS, or ``restamped``. The camera hangs elsewhere for every seed, if it is not
    given."""
    usual = Filming(optics=optics or hung(seed), seed=seed)
    return replace(usual, **_OTHERWISE[kind](seed))


def hung(seed: int) -> Optics:
    """A camera about 2 m over the water that sees 2.5 m of it."""
    random = np.random.default_rng((seed, 19))
    focal_px = random.uniform(700, 800)
    lean, middle = random.uniform(-0.04, 0.04, 2), random.uniform(-6, 6, 2)
    return Optics(
        focal_px=focal_px, height_m=2.0 * focal_px / 760, lean_rad=(lean[0], lean[1]),
        middle_off_px=(middle[0], middle[1]),
    )  # fmt: skip


_OTHERWISE: dict[str, Callable[[int], dict[str, Any]]] = {
    "plain": lambda seed: {},
    "waves": lambda seed: {"waves": Waves(0.002, seed), "depth_m": 0.05},
    "blur": lambda seed: {"exposure_s": 0.039, "readout_s": 0.03},
    "150 kbit/s": lambda seed: {"bit_rate": 150_000},
    "15 cm deep": lambda seed: {"waves": Waves(0.0003, seed), "depth_m": 0.15},
    "jitter": lambda seed: {"jitter_s": 0.005, "lost": 0.03},
    "restamped": lambda seed: {"restamped": True, "lost": 0.05},
}
KINDS = tuple(kind for kind in _OTHERWISE if kind != "restamped")


@lru_cache(maxsize=4)
def calibration_of(optics: Optics, depth_m: float, pictures: int = 14) -> Calibration:
    """As a user makes it: pictures of the board, points measured within 0.5 mm on the surface."""
    random = np.random.default_rng(int(optics.focal_px * 1e6))
    columns, rows = board().getChessboardSize()
    page = board().generateImage((columns * _SQUARE_PX, rows * _SQUARE_PX), None, 0, 1)
    held = list(board_pictures(page, _SQUARE_PX, optics, pictures))
    half_m = 0.85 * optics.size_px[1] / 2 / optics.focal_px * optics.height_m
    long_m = 0.85 * optics.size_px[0] / 2 / optics.focal_px * optics.height_m
    points = []
    for x in np.linspace(optics.x_m - long_m, optics.x_m + long_m, 4):
        for y in (optics.y_m - half_m, optics.y_m, optics.y_m + half_m):
            pixel = optics.pixels_of(np.array([[x, y]]), 0.0)[0] + random.normal(0, 0.15, 2)
            place = float(x + random.normal(0, 5e-4)), float(y + random.normal(0, 5e-4))
            name = f"{x:.2f}, {y:.2f}"
            points.append(TankPoint(name, place, (float(pixel[0]), float(pixel[1]))))
    still = np.full(optics.size_px[::-1], 120, np.uint8)
    area = rectangle([optics.x_m - long_m, optics.y_m - half_m, optics.x_m + long_m,
                      optics.y_m + half_m])  # fmt: skip
    return calibrate(
        points, ("tank", still), held, Height(0.0, depth_m) if depth_m else None, area
    ).calibration


@dataclass(frozen=True)
class Measured:
    """A film's beats: error and sigma (beats,), NaN = no speed. ``refused``: why there are none."""

    error_m_s: Floats
    sigma_m_s: Floats
    noise_m: float = 0.0
    refused: str = ""


def tracked(path: Path, swim: Swim, by: Filming) -> tuple[Track, float]:
    """Draws and encodes the film as ``path``, follows the fish through it; when the swim begins."""
    start_s = write_film(path, swim, by)
    return track(Film(path), MARKER, calibration_of(by.optics, by.depth_m)), start_s


def measured(found: Track, start_s: float, swim: Swim, by: Filming) -> Measured:
    """Speeds of the beats against the truth."""
    nothing = np.full(swim.beats, np.nan)
    try:
        curve = swim_speed(found, 1.0, start_s, beats=swim.beats)
        known = calibration_of(by.optics, by.depth_m)
    except InputError as error:
        return Measured(nothing, nothing, refused=str(error))
    speed, sigma = curve.with_scale_sigma(known.scale_sigma).beats(swim.beats)
    return Measured(speed - swim.true_beats(curve.direction_rad), sigma, curve.noise_m)
