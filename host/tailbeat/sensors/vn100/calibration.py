"""Scales and axes of the IMU's gyroscopes and accelerometers, from turns by hand.

Nothing but gravity is needed to measure with: between two rests the gyroscopes say how the fish was
turned, and the accelerometers where down is before and after. A whole turn about an axis that is
held level tells that gyroscope's scale to some parts in ten thousand; rests on all sides tell what
accelerometers are off by. No pose has to be exact.

Corrected values are ``M (told - b)``: for the gyroscopes M is any matrix near the identity, for the
accelerometers a symmetric one, so that both end up in the accelerometers' axes. All is linearised
about the last estimate, a few times, with priors that are wider than any data sheet.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.extras import lazy
from tailbeat.link.messages import ImuFrame

transform = lazy("scipy.spatial.transform")

SCALE_SD_MAX, AXES_SD_MAX_RAD = 1e-4, 4e-4  # of a gyroscope: what a calibration has to reach
SCALE_SD_MIN = 2e-4  # that is still believed tomorrow, in another temperature
_BLOCK_S = 0.5
_STILL_BLOCKS = 4
_STILL_RAD = 0.012  # turned within a block: what a hand does that tries not to
_STILL_M_S2 = 0.5  # spread of the accelerations
_TREMBLES_S = 0.06  # a hand is somewhere else after that
_GAP_FRAMES = 2  # missing ones that their neighbours stand for
_FACE_COSINE = 0.85  # down is that much along an axis: the fish lies on that side
_RESTS_MIN = 8
_ITERATIONS = 4
_ODD = 3.0  # times the residuals that are expected: something else moved it
# Standard deviations. Of where down is after a turn, in m/s^2: white noise and drift of both
# sensors over a few seconds, and a hand that is not quite still. Of the gyroscopes at rest.
_DOWN_M_S2 = 1.5e-3
_REST_RAD_S = 2e-4
_G_M_S2 = (9.80665, 0.3)  # so vague that a scale which all accelerometers share stays as it is
# What is believed before: elements of the matrices, biases.
_PRIOR_ELEMENT, _PRIOR_RATE_RAD_S, _PRIOR_ACCEL_M_S2 = 5e-3, 0.02, 0.3
_SYMMETRIC = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_RATE, _RATE_BIAS, _ACCEL, _ACCEL_BIAS, _G = (
    slice(0, 9), slice(9, 12), slice(12, 18), slice(18, 21), 21,
)  # fmt: skip
_UNKNOWN = 22
AXES = ("x", "y", "z")
# From the sensor's axes to the fish's, by IMU_MOUNT; 0 takes them for the same.
_MOUNTS = (
    ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    ((-1, 0, 0), (0, -1, 0), (0, 0, 1)),
    ((0, -1, 0), (1, 0, 0), (0, 0, 1)),
    ((0, 1, 0), (-1, 0, 0), (0, 0, 1)),
)
MOUNTS: tuple[F64, ...] = tuple(np.array(_MOUNTS, dtype=np.float64))


@dataclass(frozen=True)
class ImuCalibration:
    """``rate`` and ``accel``: 3 x 3, what told values are multiplied with. ``scale_sd``: of the
    gyroscopes' scales; ``axes_sd_rad``: of where each one's axis points; ``oddness``: residuals
    over what is expected of them, root mean square; ``rests``: how many."""

    rate: F64
    rate_bias_rad_s: F64
    accel: F64
    accel_bias_m_s2: F64
    scale_sd: F64
    axes_sd_rad: F64
    oddness: float
    rests: int

    @property
    def scale_error(self) -> F64:
        """By how much each gyroscope told too little, relative."""
        return np.diag(self.rate) - 1

    @property
    def axes_error_rad(self) -> float:
        """How far the gyroscopes' axes are from the accelerometers', the worst one."""
        off = self.rate - np.diag(np.diag(self.rate))
        return float(np.sqrt((off**2).sum(axis=1)).max())

    def rows(self, mount: F64) -> F64:
        """Shape (6, 3): the accelerometers' matrix and the gyroscopes', in the sensor's own axes.
        ``mount``: from those to the fish's, 3 x 3."""
        return np.vstack([mount.T @ one @ mount for one in (self.accel, self.rate)])


@dataclass(frozen=True)
class HandRest:
    """``begin`` and ``end``: its frames. ``accel_m_s2``: mean. ``rate_rad_s``: of the line through
    its attitude, and what a trembling hand makes of that as ``rate_sd_rad_s``."""

    begin: int
    end: int
    accel_m_s2: F64
    rate_rad_s: F64
    rate_sd_rad_s: float

    @property
    def side(self) -> str:
        """Which axis points down, as "-z"; "" = none does."""
        down = -self.accel_m_s2 / np.linalg.norm(self.accel_m_s2)
        axis = int(np.argmax(np.abs(down)))
        return "+-"[int(down[axis] < 0)] + AXES[axis] if abs(down[axis]) > _FACE_COSINE else ""


def _turning(rate: F64, period_s: float) -> tuple[F64, float]:
    """The slope of the attitude, and its standard deviation."""
    attitude, n = np.cumsum(rate, axis=0) * period_s, len(rate)
    since = (np.arange(n) - 0.5 * (n - 1)) * period_s
    slope = since @ attitude / (since @ since)
    scatter = float(np.std(attitude - attitude.mean(axis=0) - np.outer(since, slope)))
    independent = max(n * period_s / _TREMBLES_S, 1.0)
    return slope, scatter * np.sqrt(12 / independent) / (n * period_s)


@dataclass
class Recording:
    """Frames as they come, and the rests among them."""

    period_s: float = 0.0
    rate: list[F64] = field(default_factory=list)
    accel: list[F64] = field(default_factory=list)
    rests: list[HandRest] = field(default_factory=list)
    _blocks: list[tuple[int, int]] = field(default_factory=list)  # still ones in a row
    _block: int = 0  # where the present one begins
    _last: ImuFrame | None = None

    def add(self, frame: ImuFrame) -> bool:
        """True = a rest has just become long enough; it may go on."""
        rate, accel = np.array(frame.rate_rad_s), np.array(frame.accel_m_s2)
        missing = 0 if self._last is None else frame.sequence - self._last.sequence - 1
        if missing < 0 or missing > _GAP_FRAMES:
            self._forget()
        elif self._last is not None:
            apart_s = (frame.time_s - self._last.time_s) / (missing + 1)
            self.period_s += (apart_s - self.period_s) / max(min(len(self.rate), 200), 1)
            for k in range(1, missing + 1):
                part, before = k / (missing + 1), -k  # the last one that came
                self.rate.append(self.rate[before] + part * (rate - self.rate[before]))
                self.accel.append(self.accel[before] + part * (accel - self.accel[before]))
        self.rate.append(rate)
        self.accel.append(accel)
        self._last = frame
        if not self.period_s or (len(self.rate) - self._block) * self.period_s < _BLOCK_S:
            return False
        return self._end_block()

    def _forget(self) -> None:
        """Nobody knows how it was turned meanwhile: what was before is of no use for what comes."""
        self.rate.clear()
        self.accel.clear()
        self.rests.clear()
        self._blocks.clear()
        self._block = 0

    def _end_block(self) -> bool:
        begin, end = self._block, len(self.rate)
        self._block = end
        turned = np.linalg.norm(np.sum(self.rate[begin:end], axis=0)) * self.period_s
        spread = np.std(self.accel[begin:end], axis=0).max()
        if turned > _STILL_RAD or spread > _STILL_M_S2:
            self._blocks.clear()
            return False
        self._blocks.append((begin, end))
        if len(self._blocks) < _STILL_BLOCKS:
            return False
        is_new = len(self._blocks) == _STILL_BLOCKS
        if not is_new:
            self.rests.pop()
        first = self._blocks[0][0]
        accel = np.mean(self.accel[first:end], axis=0)
        inner = self.rate[self._blocks[1][0] : self._blocks[-2][1]]
        self.rests.append(HandRest(first, end, accel, *_turning(np.array(inner), self.period_s)))
        return is_new

    @property
    def sides(self) -> set[str]:
        """On which the fish has lain."""
        return {rest.side for rest in self.rests} - {""}

    @property
    def is_still(self) -> bool:
        """Whether the last block was."""
        return bool(self._blocks)


def recorded(frames: Iterable[ImuFrame]) -> Recording:
    """All of them."""
    found = Recording()
    for frame in frames:
        found.add(frame)
    return found


def calibrate(recording: Recording) -> ImuCalibration:
    """What the rests and the turns between them tell. Raises InputError with what is missing. Costs
    about 0.03 s per minute of frames."""
    rests = recording.rests
    if len(rests) < _RESTS_MIN:
        raise InputError(
            f"the fish was at rest {len(rests)} times of at least {_RESTS_MIN}.",
            "Turn it, hold it still for 3 s, and so on; every side down once.",
        )
    problem = _Turns.of(recording)
    found, _ = _priors()
    for _ in range(_ITERATIONS):
        residual, jacobian = problem.linearised(found)
        found = found - np.linalg.solve(jacobian.T @ jacobian, jacobian.T @ residual)
    residual, jacobian = problem.linearised(found)
    own = len(residual) - _UNKNOWN  # without the priors
    oddness = float(np.sqrt(residual[:own] @ residual[:own] / max(own - _UNKNOWN, 1)))
    if oddness > _ODD:
        raise InputError(
            f"turns and rests contradict each other, {oddness:.1f} times as much as is usual.",
            "Hold the fish still between turns, turn it slowly, and begin anew.",
        )
    deviation = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian))) * max(oddness, 1.0)
    elements = deviation[_RATE].reshape(3, 3)
    rate, accel = _matrices(found)
    return ImuCalibration(
        rate=rate,
        rate_bias_rad_s=found[_RATE_BIAS],
        accel=accel,
        accel_bias_m_s2=found[_ACCEL_BIAS],
        scale_sd=np.diag(elements).copy(),
        axes_sd_rad=(elements - np.diag(np.diag(elements))).max(axis=0),
        oddness=oddness,
        rests=len(rests),
    )


def missing(recording: Recording) -> str:
    """What to do next, for people; "" = it is known well enough."""
    for side, words in _SIDES.items():
        if side not in recording.sides:
            return f"lay it {words}"
    try:
        found = calibrate(recording)
    except InputError as error:
        return error.remedy
    scale, axes = found.scale_sd / SCALE_SD_MAX, found.axes_sd_rad / AXES_SD_MAX_RAD
    if max(*scale, *axes) <= 1:
        return ""
    turn, of = ("whole", scale) if scale.max() > axes.max() else ("quarter", axes)
    return f"a {turn} turn {_TURNS[AXES[int(np.argmax(of))]]}"


_SIDES = {
    "+z": "belly down", "+y": "right side down", "-z": "belly up", "-y": "left side down",
    "+x": "nose down", "-x": "nose up",
}  # fmt: skip
_TURNS = {
    "x": "about its long axis, held level",
    "y": "nose over tail, upright",
    "z": "nose over tail, lying on its side",
}


def _matrices(unknown: F64) -> tuple[F64, F64]:
    rate, accel = np.eye(3) + unknown[_RATE].reshape(3, 3), np.eye(3)
    for value, (i, j) in zip(unknown[_ACCEL], _SYMMETRIC, strict=True):
        accel[i, j] += value
        accel[j, i] += value if i != j else 0.0
    return rate, accel


def _path(steps: F64) -> F64:
    """What comes of the first 0, 1, ... n steps one after the other, shape (n + 1, 3, 3). In blocks
    that go on side by side: one step at a time took two fifths of a calibration."""
    n = len(steps)
    side = int(np.ceil(np.sqrt(n)))
    path = np.tile(np.eye(3), (side * side, 1, 1))
    path[:n] = steps
    blocks = path.reshape(side, side, 3, 3)
    for k in range(1, side):
        blocks[:, k] = blocks[:, k - 1] @ blocks[:, k]
    for k in range(1, side):
        blocks[k] = blocks[k - 1, -1] @ blocks[k]
    return np.concatenate([np.eye(3)[None], path[:n]])


@dataclass(frozen=True)
class _Turns:
    """``turns``: for each pair of rests that follow each other the rates between their middles."""

    rests: Sequence[HandRest]
    turns: Sequence[F64]
    period_s: float

    @classmethod
    def of(cls, recording: Recording) -> _Turns:
        """From the mean attitude of a rest to that of the next: a hand is never quite still."""
        rests, rate = recording.rests, np.array(recording.rate)
        middle = [(rest.begin + rest.end) // 2 for rest in rests]
        mean = []
        for rest, at in zip(rests, middle, strict=True):
            own = rate[rest.begin : rest.end]
            turned = np.cumsum(own, axis=0)
            mean.append((turned - 0.5 * own).mean(axis=0) - turned[at - rest.begin - 1])
        ends = zip(pairwise(middle), pairwise(mean), strict=True)
        turns = [np.vstack([-before, rate[a:b], after]) for (a, b), (before, after) in ends]
        return cls(rests, turns, recording.period_s)

    def linearised(self, unknown: F64) -> tuple[F64, F64]:
        """(residuals over their standard deviations, their derivatives): of the turns, of the
        length of gravity, of the gyroscopes at rest; at last of the priors."""
        rate, accel = _matrices(unknown)
        force = [accel @ (rest.accel_m_s2 - unknown[_ACCEL_BIAS]) for rest in self.rests]
        by_accel = [self._by_accel(rest, unknown, accel) for rest in self.rests]
        rows, slopes = [], []
        for i, told in enumerate(self.turns):
            end, by_rate = self._turned(told, unknown, rate)
            before, slope = end.T @ force[i], np.zeros((3, _UNKNOWN))
            slope[:, _RATE.start : _RATE_BIAS.stop] = np.cross(by_rate, before, axisa=0, axisc=0)
            slope += by_accel[i + 1] - end.T @ by_accel[i]
            rows.append((force[i + 1] - before) / _DOWN_M_S2)
            slopes.append(slope / _DOWN_M_S2)
        for f, by in zip(force, by_accel, strict=True):
            size = float(np.linalg.norm(f))
            slope = (f / size) @ by
            slope[_G] = -1
            rows.append(np.array([size - unknown[_G]]) / _DOWN_M_S2)
            slopes.append(slope[None] / _DOWN_M_S2)
        for rest in self.rests:
            slope = np.zeros((3, _UNKNOWN))
            slope[:, _RATE_BIAS] = -np.eye(3)
            sigma_rad_s = np.hypot(rest.rate_sd_rad_s, _REST_RAD_S)
            rows.append((rest.rate_rad_s - unknown[_RATE_BIAS]) / sigma_rad_s)
            slopes.append(slope / sigma_rad_s)
        centre, sigma = _priors()
        rows.append((unknown - centre) / sigma)
        slopes.append(np.diag(1 / sigma))
        return np.concatenate(rows), np.vstack(slopes)

    def _turned(self, told: F64, unknown: F64, rate: F64) -> tuple[F64, F64]:
        """(body at the end to body at the begin, what a turn's error at the end is by the
        gyroscopes' matrix and bias, shape (3, 12))."""
        turn = (told - unknown[_RATE_BIAS]) @ rate.T * self.period_s
        path = _path(transform.Rotation.from_rotvec(turn).as_matrix())
        to_end = np.einsum("ji,njk->nik", path[-1], 0.5 * (path[1:] + path[:-1]))
        by_element = np.einsum("nij,nk->ijk", to_end, turn).reshape(3, 9)
        return path[-1], np.hstack([by_element, -to_end.sum(axis=0) * self.period_s])

    @staticmethod
    def _by_accel(rest: HandRest, unknown: F64, accel: F64) -> F64:
        slope, told = np.zeros((3, _UNKNOWN)), rest.accel_m_s2 - unknown[_ACCEL_BIAS]
        for k, (i, j) in enumerate(_SYMMETRIC):
            slope[i, _ACCEL.start + k] += told[j]
            slope[j, _ACCEL.start + k] += told[i] if i != j else 0.0
        slope[:, _ACCEL_BIAS] = -accel
        return slope


def _priors() -> tuple[F64, F64]:
    centre, sigma = np.zeros(_UNKNOWN), np.full(_UNKNOWN, _PRIOR_ELEMENT)
    sigma[_RATE_BIAS], sigma[_ACCEL_BIAS] = _PRIOR_RATE_RAD_S, _PRIOR_ACCEL_M_S2
    centre[_G], sigma[_G] = _G_M_S2
    return centre, sigma
