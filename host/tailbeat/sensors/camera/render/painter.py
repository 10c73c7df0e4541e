"""What moves over the whole picture: light on the waves, glare, and the sensor's noise.

Draws one picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tailbeat.core.arrays import F32, F64
from tailbeat.sensors.camera import cv2
from tailbeat.sensors.camera.render import sprites
from tailbeat.sensors.camera.render.scene import Optics, Scene, chance
from tailbeat.sensors.camera.render.sprites import (
    FINER,
    backdrop,
    dimming,
    stamp,
    water,
    whole_elements,
)
from tailbeat.sensors.camera.source.picture import Image
from tailbeat.sim.world import CameraFrame

_COARSE = 8  # pixels per element of the waves
_TILE = 128  # elements, after which the pattern of the waves repeats
_WAVE_M = 0.22  # length of a wave
_DRIFTS_M_S = ((0.05, 0.02), (-0.03, 0.045))  # of the two patterns whose meeting is bright
_CAUSTIC = 110  # how bright, of 255, at ripples 1
_GLARE_M = 0.3  # radius of the spot at glare 1
_GLARE_PERIODS_S = (31.0, 19.0)
_SHIFTS = 64  # pixels the noise is shifted by, at most, each way


class Waves:
    """The bright net that waves throw on the floor, slowly changing."""

    def __init__(self, scene: Scene, optics: Optics) -> None:
        self._size_px = scene.size_px
        self._elements_per_m = optics.px_per_m / _COARSE
        self._bright = _within(water(scene, optics)) * np.float32(scene.ripples * _CAUSTIC)
        waves = max(2, round(_TILE / (_WAVE_M * self._elements_per_m)))
        chances = np.random.default_rng([scene.seed, 2])
        rows, columns = self._bright.shape
        beyond = (0, rows + 1), (0, columns + 1)  # as far as a shifted one may be looked at
        self._patterns = [
            np.pad(_pattern(chances, waves), beyond, mode="wrap") for _ in _DRIFTS_M_S
        ]

    def add_to(self, image: Image, t_s: float) -> Image:
        """``image`` with them, a fresh array."""
        if not self._bright.any():
            return image.copy()
        one, other = (
            self._shifted(pattern, drift, t_s)
            for pattern, drift in zip(self._patterns, _DRIFTS_M_S, strict=True)
        )
        net = cv2.min(one, other)
        light = (net * net * self._bright).astype(np.uint8)
        full = cv2.resize(light, self._size_px, interpolation=cv2.INTER_LINEAR)
        return np.asarray(cv2.add(image, full, dst=full))

    def _shifted(self, pattern: F32, drift_m_s: tuple[float, float], t_s: float) -> F32:
        along, across = (part * t_s * self._elements_per_m % _TILE for part in drift_m_s)
        rows, columns = self._bright.shape
        middle = (along + (columns - 1) / 2, across + (rows - 1) / 2)
        return np.asarray(cv2.getRectSubPix(pattern, (columns, rows), middle))


def _within(mask: Image) -> F32:
    """1 for elements so far within the water that none of their light falls on the rim."""
    height, width = mask.shape
    size = (-(-width // _COARSE), -(-height // _COARSE))
    coarse = cv2.resize(mask, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.erode((coarse == 255).astype(np.float32), np.ones((3, 3))))


def _pattern(chances: np.random.Generator, waves: int) -> F32:
    """Ridges, 0..1, that go on at the tile's edges."""
    place = 2 * np.pi * np.arange(_TILE) / _TILE
    total = np.zeros((_TILE, _TILE))
    for _ in range(9):
        angle, phase = chances.uniform(0, 2 * np.pi, 2)
        length = waves * chances.uniform(0.6, 1.3)
        kx, ky = np.round(length * np.cos(angle)), np.round(length * np.sin(angle))
        total += np.cos(kx * place[None, :] + ky * place[:, None] + phase)
    return np.asarray(np.exp(-np.abs(total) / 0.9), dtype=np.float32)


class Glare:
    """A lamp's reflection that wanders over the tank."""

    def __init__(self, scene: Scene, optics: Optics) -> None:
        self._optics = optics
        self._spot = _spot(scene.glare * _GLARE_M * optics.px_per_m)
        self._middle = np.mean(scene.walls_m(), axis=0)
        self._reach = np.array(scene.tank_m) * (0.42, 0.22)
        self._phases = [2 * np.pi * chance(scene.seed, "glare", axis) for axis in "xy"]

    def add_to(self, image: Image, t_s: float) -> None:
        """Draws it over all there is."""
        turns = [2 * np.pi * t_s / period for period in _GLARE_PERIODS_S]
        swing = np.sin(np.add(turns, self._phases))
        centre = self._optics.pixels((self._middle + self._reach * swing)[None])[0]
        half = len(self._spot) // 2
        left, top = np.round(centre).astype(int) - half
        height, width = image.shape
        rows = slice(max(top, 0), min(top + len(self._spot), height))
        columns = slice(max(left, 0), min(left + len(self._spot), width))
        part = self._spot[
            rows.start - top : rows.stop - top, columns.start - left : columns.stop - left
        ]
        image[rows, columns] = cv2.add(image[rows, columns], part)


def _spot(radius_px: float) -> Image:
    """Overexposed in the middle, with a wide halo."""
    half = int(np.ceil(2.2 * radius_px))
    line = np.arange(-half, half + 1, dtype=np.float64) / max(radius_px, 1e-9)
    far = np.hypot(line[None, :], line[:, None] * 1.25)
    grey = 420 * np.exp(-((far / 0.62) ** 2)) + 60 * np.exp(-(far**2))
    edge = np.clip((2.2 - far) / 0.5, 0, 1)
    spot: Image = np.clip(np.rint(grey * edge), 0, 255).astype(np.uint8)
    return spot


class Noise:
    """The sensor's: white, of the same strength everywhere."""

    def __init__(self, scene: Scene) -> None:
        self._seed = scene.seed
        width, height = scene.size_px
        self._size = height, width
        chances = np.random.default_rng([scene.seed, 3])
        noise = chances.standard_normal((height + _SHIFTS, width + _SHIFTS), dtype=np.float32)
        drawn = np.rint(noise * np.float32(scene.pixel_noise))
        self._more = np.clip(drawn, 0, 255).astype(np.uint8)
        self._less = np.clip(-drawn, 0, 255).astype(np.uint8)
        self._silent = scene.pixel_noise <= 0

    def add_to(self, image: Image, index: int) -> None:
        """Draws picture ``index``'s: another piece of one large carpet of noise."""
        if self._silent:
            return
        down, right = (int(chance(self._seed, axis, index) * _SHIFTS) for axis in "vu")
        piece = np.s_[down : down + self._size[0], right : right + self._size[1]]
        cv2.add(image, self._more[piece], dst=image)
        cv2.subtract(image, self._less[piece], dst=image)


_BESIDE_M = (0.12, 0.45)  # where the second fish swims
_LED_STEPS = 16
_STEP_PX = 0.4  # of a moving marker, that is drawn where it is and not as its way
_STEPS_MAX = 16


@dataclass(frozen=True)
class DrawnPose(CameraFrame):
    """The fish in the middle of an exposure. Its speed along x and the turn of its heading blur the
    picture."""

    speed_m_s: float = 0.0
    turn_rad_s: float = 0.0


class Painter:
    """Pictures of ``scene``. Deterministic: the same truth and index give the same bytes, whatever
    was drawn before. About 5 ms for 1280x720 on one core: what stands still is drawn once."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._optics = optics = Optics(scene)
        self._backdrop = backdrop(scene, optics)
        self._dimming = dimming(scene)
        self._waves = Waves(scene, optics)
        self._glare = Glare(scene, optics) if scene.glare > 0 else None
        self._noise = Noise(scene)
        side_m, steps = scene.marker_side_m, _LED_STEPS if scene.led else 0
        px_per_m = whole_elements(scene.marker, side_m, FINER * optics.px_per_m)
        self._where = sprites.Body(side_m)
        self._tail = sprites.tail(self._where, px_per_m)
        self._foam = sprites.foam(side_m, scene.seed, px_per_m)
        lit = [step / _LED_STEPS for step in range(steps + 1)]
        self._bodies = [sprites.body(scene, part, px_per_m) for part in lit]

    def paint(self, truth: DrawnPose, index: int) -> Image:
        """Grey, shape (height, width), a fresh array."""
        image = self._waves.add_to(self._backdrop, truth.time_s)
        if self._scene.fish > 1:
            self._draw(image, _beside(truth))
        self._draw(image, truth)
        if chance(self._scene.seed, "hidden", index) < self._scene.hidden:
            self._hide(image, truth, index)
        if self._glare is not None:
            self._glare.add_to(image, truth.time_s)
        self._noise.add_to(image, index)
        return image

    def _draw(self, image: Image, truth: DrawnPose) -> None:
        poses = self._poses(truth)
        hinge = _turned(-truth.tail_rad, self._where.hinge_m)
        body = self._bodies[round(truth.led * (len(self._bodies) - 1))]
        blur_px, gain = self._scene.blur_px, self._gain(poses[0])
        stamp(image, self._tail, [pose @ hinge for pose in poses], blur_px, gain)
        stamp(image, body, poses, blur_px, gain)

    def _hide(self, image: Image, truth: DrawnPose, index: int) -> None:
        quarter = math.floor(4 * chance(self._scene.seed, "half", index))
        pose = self._pose(truth, 0.0) @ _turned(quarter * math.pi / 2, 0.0)
        stamp(image, self._foam, [pose], self._scene.blur_px, self._gain(pose))

    def _poses(self, truth: DrawnPose) -> list[F64]:
        """The fish's places during the exposure, evenly spread around its middle."""
        exposure_s = self._scene.exposure_s
        reach_m = abs(truth.speed_m_s) + abs(truth.turn_rad_s) * self._scene.marker_side_m / 2
        way_px = reach_m * exposure_s * self._optics.px_per_m
        steps = min(_STEPS_MAX, max(1, math.ceil(way_px / _STEP_PX)))
        return [
            self._pose(truth, ((step + 0.5) / steps - 0.5) * exposure_s) for step in range(steps)
        ]

    def _pose(self, truth: DrawnPose, later_s: float) -> F64:
        centre = truth.x_m + truth.speed_m_s * later_s, truth.y_m
        heading = truth.heading_rad + truth.turn_rad_s * later_s
        return self._optics.near(centre, heading, self._scene.marker_side_m)

    def _gain(self, pose: F64) -> float:
        height, width = self._dimming.shape
        u, v = np.rint(pose[:2, 2] / pose[2, 2]).astype(int)
        return float(self._dimming[min(max(v, 0), height - 1), min(max(u, 0), width - 1)])


def _turned(angle_rad: float, ahead_m: float) -> F64:
    """From a part that is turned clockwise, its origin so far ahead of the marker, to the fish."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, ahead_m], [s, c, 0], [0, 0, 1.0]])


def _beside(truth: DrawnPose) -> DrawnPose:
    """The second fish: out of step, without LED."""
    return replace(
        truth,
        x_m=truth.x_m + _BESIDE_M[0],
        y_m=truth.y_m + _BESIDE_M[1],
        heading_rad=-truth.heading_rad,
        tail_rad=-truth.tail_rad,
        turn_rad_s=-truth.turn_rad_s,
        led=0.0,
    )
