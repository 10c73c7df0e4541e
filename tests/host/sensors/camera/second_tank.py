"""Films of a fish whose speed is known exactly, for tests, drawn unlike the host tool's own.

Every sample of a pixel has its own place in it and its own moment in the exposure of its row (a
rolling shutter) and follows its ray through the moving surface (second_optics). The film is encoded
by a real codec at a given bit rate. A time stamp is the middle of the exposure of the picture's
middle row.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from .second_optics import Floats, Optics, Waves

Image = NDArray[np.uint8]
_CELL = 32  # texels of the marker's picture
_SIDE_CELLS = 6  # with its border, of DICT_4X4_50
_FINE_HZ = 500


@dataclass(frozen=True)
class Swim:
    """A fish that starts from rest at t = 0, swims so many beats of 1 s with a speed that bends
    every 2 s, and coasts. It surges, sways and yaws with its tail."""

    seed: int = 1
    beats: int = 24
    lead_s: float = 3.0
    coast_s: float = 2.5
    speed_m_s: tuple[float, float] = (0.045, 0.105)
    begin_m: float = 0.0
    _tables: dict[str, Floats] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        random = np.random.default_rng((self.seed, 3))
        knots_s = np.arange(0.0, self.beats + 0.1, 2.0)
        knots = random.uniform(*self.speed_m_s, len(knots_s))
        knots[0] = 0.0
        t_s = np.arange(-self.lead_s - 1, self.beats + self.coast_s + 1, 1 / _FINE_HZ)
        speed = np.where(t_s <= 0, 0.0, PchipInterpolator(knots_s, knots, extrapolate=True)(t_s))
        after = t_s > self.beats
        speed[after] = knots[-1] * np.exp(-(t_s[after] - self.beats) / 1.5)
        way = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2) / _FINE_HZ])
        way -= np.interp(0.0, t_s, way)
        strength = speed / 0.08
        p, q, r = random.uniform(0, 2 * np.pi, 3)
        surge = 2e-4 * np.sin(2 * np.pi * t_s + p) + 5e-4 * np.sin(4 * np.pi * t_s + q)
        sway = np.sin(2 * np.pi * t_s + r)
        drift = random.uniform(-0.04, 0.04)
        heading = drift + 0.09 * strength * np.sin(2 * np.pi * t_s + r + 1.2)
        self._tables.update(
            t=t_s,
            x=self.begin_m + way * np.cos(drift) + strength * surge,
            y=way * np.sin(drift) + 4e-3 * strength * sway,
            heading=heading,
        )

    def pose(self, t_s: Floats) -> tuple[Floats, Floats, Floats]:
        """x, y, heading of the marker at times of any shape."""
        table = self._tables
        x, y, heading = (np.interp(t_s, table["t"], table[name]) for name in ("x", "y", "heading"))
        return x, y, heading

    def true_beats(self, direction_rad: float) -> Floats:
        """Mean speed of the marker along a direction over each beat, (beats,)."""
        x, y, _ = self.pose(np.arange(self.beats + 1.0))
        return np.diff(x * np.cos(direction_rad) + y * np.sin(direction_rad))


@dataclass(frozen=True)
class Filming:
    """How it is filmed. ``readout_s``: from the first row to the last. ``jitter_s``: of the time
    stamps; ``lost``: part of the pictures that never come; ``restamped``: lost pictures are closed
    up, each stamp 1/fps after the one before. ``bit_rate``: of H.264, bit/s; None = constant
    quality."""

    optics: Optics = field(default_factory=Optics)
    waves: Waves = field(default_factory=Waves)
    depth_m: float = 0.0
    side_m: float = 0.06
    fps: float = 25.0
    exposure_s: float = 0.008
    readout_s: float = 0.018
    noise: float = 2.5
    bit_rate: int | None = None
    jitter_s: float = 0.0
    lost: float = 0.0
    restamped: bool = False
    seed: int = 1


class SecondTank:
    """Draws pictures. ``marker_id``: of DICT_4X4_50."""

    SAMPLES = 16  # of a pixel, a square number

    def __init__(self, swim: Swim, filming: Filming, marker_id: int = 7) -> None:
        self._swim, self._by = swim, filming
        self._random = np.random.default_rng((filming.seed, 11))
        words = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        tag = cv2.aruco.generateImageMarker(words, marker_id, _SIDE_CELLS * _CELL)
        page = np.pad(tag, _CELL, constant_values=235)
        page = np.clip(page, 22, 235)
        page[:, -_CELL // 4 :] = 60  # the hull begins: no edge as clear as the marker's own
        self._page = cv2.GaussianBlur(page.astype(np.float32), (0, 0), 2.0)
        self._floor = self._make_floor()
        self._grids()

    def _make_floor(self) -> NDArray[np.float32]:
        width, height = self._by.optics.size_px
        cloud = np.zeros((height, width), np.float32)
        for blur, size in ((2.0, 14.0), (9.0, 40.0), (40.0, 150.0)):
            grain = self._random.normal(size=(height, width)).astype(np.float32)
            cloud += size * cv2.GaussianBlur(grain, (0, 0), blur)
        return 118 + np.clip(cloud, -40, 40)

    def _grids(self) -> None:
        width, height = self._by.optics.size_px
        self._columns, self._rows = np.meshgrid(
            np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)
        )
        coarse = np.meshgrid(np.linspace(0, width - 1, 96), np.linspace(0, height - 1, 54))
        ray = self._by.optics.rays(*coarse)
        to = self._by.optics.height_m / ray[2]
        self._coarse_m = self._by.optics.x_m + ray[0] * to, self._by.optics.y_m + ray[1] * to
        self._grain = self._random.normal(0, 1, (height + 64, width + 64)).astype(np.float32)

    def picture(self, t_s: float) -> Image:
        """Taken around ``t_s``, grey."""
        scene = self._water(t_s)
        self._draw_fish(scene, t_s)
        down, right = self._random.integers(0, 64, 2)
        height, width = scene.shape
        scene += self._by.noise * self._grain[down : down + height, right : right + width]
        return np.clip(np.rint(scene), 0, 255).astype(np.uint8)

    def _water(self, t_s: float) -> NDArray[np.float32]:
        if self._by.waves.height_m == 0:
            return self._floor.copy()
        slope = self._by.waves.slopes(*self._coarse_m, t_s)
        size = self._by.optics.size_px
        px_m = 0.25 * 0.4 * self._by.optics.focal_px / self._by.optics.height_m  # 0.4 m deep
        du, dv = (cv2.resize((px_m * s).astype(np.float32), size) for s in slope)
        bent = cv2.remap(
            self._floor, self._columns + du, self._rows + dv, cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )  # fmt: skip
        curved = np.gradient(slope[0], axis=1) + np.gradient(slope[1], axis=0)
        bright = np.clip(-curved / 0.02, -1, 1).astype(np.float32)  # caustics
        return bent + 25 * cv2.resize(bright, size)

    def _draw_fish(self, scene: NDArray[np.float32], t_s: float) -> None:
        by, optics = self._by, self._by.optics
        x, y, _ = (float(part) for part in self._swim.pose(np.array(t_s)))
        reach_m = 0.19
        corners = [(x - reach_m, y - 0.09), (x - reach_m, y + 0.09), (x + 0.1, y - 0.09),
                   (x + 0.1, y + 0.09)]  # fmt: skip
        pixels = optics.pixels_of(np.array(corners), by.depth_m)
        low = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 4, 0)
        high = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 5, optics.size_px)
        if (high <= low).any():
            return
        u, v = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
        side = int(np.sqrt(self.SAMPLES))
        part = (np.arange(side) + 0.5) / side - 0.5
        in_u, in_v = (grid.ravel()[:, None, None] for grid in np.meshgrid(part, part))
        moment = (self._random.permutation(self.SAMPLES) + 0.5) / self.SAMPLES - 0.5
        row_s = ((v + 0.5) / optics.size_px[1] - 0.5) * by.readout_s
        at_s = t_s + row_s[None] + by.exposure_s * moment[:, None, None]
        seen = optics.seen_at(u[None] + in_u, v[None] + in_v, by.depth_m, by.waves, at_s)
        value, there = self._fish_at(*seen, at_s)
        value, there = value.mean(axis=0), there.mean(axis=0)
        window = scene[low[1] : high[1], low[0] : high[0]]
        drawn = value + (1 - there) * window
        scene[low[1] : high[1], low[0] : high[0]] = cv2.GaussianBlur(
            drawn.astype(np.float32), (0, 0), 0.6
        )

    def _fish_at(self, x_m: Floats, y_m: Floats, t_s: Floats) -> tuple[Floats, Floats]:
        """Brightness times presence, and presence (0..1), of what is at a place and moment."""
        x, y, heading = self._swim.pose(t_s)
        c, s = np.cos(heading), np.sin(heading)
        ahead = c * (x_m - x) + s * (y_m - y)
        aside = -s * (x_m - x) + c * (y_m - y)
        texels_m = _SIDE_CELLS * _CELL / self._by.side_m
        middle = (self._page.shape[0] - 1) / 2
        # The marker's upper edge points ahead, its right edge to the fish's right.
        across = (aside * texels_m + middle).astype(np.float32)
        along = (middle - ahead * texels_m).astype(np.float32)
        flat = across.reshape(across.shape[0], -1), along.reshape(along.shape[0], -1)
        tag = cv2.remap(self._page, *flat, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT,
                        borderValue=-1).reshape(across.shape)  # fmt: skip
        half = (_SIDE_CELLS / 2 + 1) * self._by.side_m / _SIDE_CELLS
        on_tag = (np.abs(ahead) < half) & (np.abs(aside) < half)
        hull = ((ahead + 0.045) / 0.13) ** 2 + (aside / 0.05) ** 2 < 1
        there = (on_tag | hull).astype(float)
        return np.where(on_tag, np.maximum(tag, 0), 75.0) * there, there


def moments(swim: Swim, by: Filming) -> Iterator[tuple[float, float]]:
    """When each picture is taken, and its time stamp, both counted from the swim's begin."""
    random = np.random.default_rng((by.seed, 13))
    count = int((swim.lead_s + swim.beats + swim.coast_s) * by.fps)
    kept = 0
    for k in range(count):
        lost = k > 0 and random.random() < by.lost
        shaken_s = random.normal(0, by.jitter_s) if by.jitter_s else 0.0
        if lost:
            continue
        taken_s = k / by.fps - swim.lead_s
        stamp_s = kept / by.fps - swim.lead_s if by.restamped else taken_s + shaken_s
        kept += 1
        yield taken_s, stamp_s


def write_film(path: Path, swim: Swim, by: Filming) -> float:
    """Encodes the film; the time of the swim's begin in it (the first picture is at 0)."""
    tank = SecondTank(swim, by)
    with av.open(str(path), "w") as container:
        options = {"preset": "veryfast", "g": "50"}
        if by.bit_rate is None:
            options["crf"] = "20"
        stream = container.add_stream("libx264", rate=Fraction(by.fps), options=options)
        stream.width, stream.height = by.optics.size_px
        stream.pix_fmt = "yuv420p"
        stream.thread_count = 1
        stream.codec_context.time_base = Fraction(1, 90000)
        if by.bit_rate is not None:
            stream.bit_rate = by.bit_rate
        first_s = last = None
        for taken_s, stamp_s in moments(swim, by):
            first_s = stamp_s if first_s is None else first_s
            ticks = round((stamp_s - first_s) * 90000)
            if last is not None and ticks <= last:
                ticks = last + 90
            last = ticks
            frame = av.VideoFrame.from_ndarray(tank.picture(taken_s), format="gray")
            frame.pts, frame.time_base = ticks, Fraction(1, 90000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    assert first_s is not None
    return -first_s


def board_pictures(board: Image, square_px: float, optics: Optics, count: int, seed: int = 1
                   ) -> Iterator[tuple[str, Image]]:  # fmt: skip
    """A flat board (its printed picture, squares of ``square_px``) held in front of the camera,
    each time tilted to another side, all over the picture."""
    random = np.random.default_rng((seed, 17))
    width, height = optics.size_px
    u, v = np.meshgrid(np.arange(width * 2) / 2 - 0.25, np.arange(height * 2) / 2 - 0.25)
    tilted = np.linalg.inv(optics.turn())
    ray = np.einsum("ij,j...->i...", tilted, optics.rays(u, v))
    wide_m = 0.42
    texel_m = wide_m / board.shape[1]
    for k in range(count):
        spot = np.array([(k % 3 - 1) * 0.33, (k // 3 % 3 - 1) * 0.30])
        spot += random.uniform(-0.03, 0.03, 2)
        middle = optics.middle_px + spot * optics.size_px
        towards = tilted @ optics.rays(np.array(middle[0]), np.array(middle[1]))
        centre = towards / towards[2] * 0.75
        lean, turn = random.uniform(0.35, 0.6), 2 * np.pi * k / count + random.uniform(-0.4, 0.4)
        turned, _ = cv2.Rodrigues(lean * np.array([np.cos(turn), np.sin(turn), 0.0]))
        rolled, _ = cv2.Rodrigues(np.array([0, 0, random.uniform(-0.3, 0.3)]))
        axes = rolled @ turned
        normal = axes[:, 2]
        way = (normal @ centre) / np.einsum("i,i...->...", normal, ray)
        hit = way * ray - centre[:, None, None]
        across = np.einsum("i,i...->...", axes[:, 0], hit) / texel_m + board.shape[1] / 2 - 0.5
        down = np.einsum("i,i...->...", axes[:, 1], hit) / texel_m + board.shape[0] / 2 - 0.5
        soft = cv2.GaussianBlur(board, (0, 0), max(0.6, 0.12 * square_px / 10))
        shown = cv2.remap(
            soft, across.astype(np.float32), down.astype(np.float32), cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT, borderValue=150,
        )  # fmt: skip
        small = cv2.resize(shown, (width, height), interpolation=cv2.INTER_AREA)
        noisy = small + random.normal(0, 2.0, small.shape)
        yield f"board {k}", np.clip(noisy, 0, 255).astype(np.uint8)
