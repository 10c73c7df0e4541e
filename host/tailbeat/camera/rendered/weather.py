"""What moves over the whole picture: light on the waves, glare, and the sensor's noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tailbeat.camera.extra import need_cv2
from tailbeat.camera.pictures.picture import Image
from tailbeat.camera.rendered.backdrop import water
from tailbeat.camera.rendered.chance import chance
from tailbeat.camera.rendered.optics import Optics
from tailbeat.camera.rendered.scene import Scene

cv2 = need_cv2()

Layer = NDArray[np.float32]

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

    def _shifted(self, pattern: Layer, drift_m_s: tuple[float, float], t_s: float) -> Layer:
        along, across = (part * t_s * self._elements_per_m % _TILE for part in drift_m_s)
        rows, columns = self._bright.shape
        middle = (along + (columns - 1) / 2, across + (rows - 1) / 2)
        return np.asarray(cv2.getRectSubPix(pattern, (columns, rows), middle))


def _within(mask: Image) -> Layer:
    """1 for elements so far within the water that none of their light falls on the rim."""
    height, width = mask.shape
    size = (-(-width // _COARSE), -(-height // _COARSE))
    coarse = cv2.resize(mask, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.erode((coarse == 255).astype(np.float32), np.ones((3, 3))))


def _pattern(chances: np.random.Generator, waves: int) -> Layer:
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
