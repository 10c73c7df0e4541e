"""References: the wanted mean speed of every beat.

A reference is built from a continuous curve by exact integration: ``speed_m_s[k]`` is the mean of
the curve over beat k, computed in float64 and rounded once to float32.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tailbeat.core.csv import read_rows, read_table, table_text, value_of
from tailbeat.core.errors import InputError, did_you_mean
from tailbeat.core.files import replacing_text
from tailbeat.core.lazy_arrays import F32, F64, NDArray, np
from tailbeat.core.records import encode_reference

Antiderivative = Callable[[F64], F64]

BEATS_MAX = 512
THESIS_PLATEAU_M_S = 0.0791
_ROUNDING = 1e-9  # of a beat: what float arithmetic may add to a whole number of beats
_UNEVEN = 1e-3  # of a beat: what other programs may round off


@dataclass(frozen=True)
class ReferenceProblem:
    """Why a reference cannot be executed, and what to do about it."""

    meaning: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.meaning} {self.remedy}"


@dataclass(frozen=True)
class ReferenceLimits:
    """What the board and the tank allow; a tank of 0 m is not checked."""

    speed_max_m_s: float = 0.3
    tank_m: float = 3.0
    fish_m: float = 0.36

    @classmethod
    def from_params(cls, params: dict[str, float]) -> ReferenceLimits:
        """The limits held in board parameters."""
        return cls(params["REF_MAX_M_S"], params["TANK_LEN_M"], params["FISH_LEN_M"])


@dataclass(frozen=True)
class Reference:
    """Reference speed profile of a trial: the mean speed of every beat.

    Attributes
    ----------
    beat_s : float
        Length of a beat, s; above 0.
    speed_m_s : ndarray of float32, shape (beats,)
        Mean speed of each beat, m/s; 0 or more, 1 to 512 beats.
    name : str
        Name in reports and folder names.
    """

    beat_s: float
    speed_m_s: F32
    name: str

    @property
    def beats(self) -> int:
        """How many beats the trial has."""
        return len(self.speed_m_s)

    @property
    def duration_s(self) -> float:
        """Length of the trial, s."""
        return self.beats * self.beat_s

    @property
    def travel_m(self) -> float:
        """Distance the reference covers, m."""
        return float(np.sum(self.speed_m_s, dtype=np.float64)) * self.beat_s

    def check(self, limits: ReferenceLimits) -> list[ReferenceProblem]:
        """Check whether board and tank can take the reference.

        Parameters
        ----------
        limits : ReferenceLimits
            What the board and the tank allow.

        Returns
        -------
        list of ReferenceProblem
            What speaks against it, with a remedy each; empty when nothing does.
        """
        if not 1 <= self.beats <= BEATS_MAX:
            return [ReferenceProblem(_too_long(f"{self.beats}"), "Shorten it.")]
        found = _value_problems(self.speed_m_s, limits.speed_max_m_s)
        need_m = self.travel_m + limits.fish_m
        if limits.tank_m > 0 and need_m > limits.tank_m:
            found.append(
                ReferenceProblem(
                    f"it travels {self.travel_m:.2f} m and the fish is {limits.fish_m:.2f} m long, "
                    f"but the tank has {limits.tank_m:.2f} m.",
                    "Shorten or slow it, or correct TANK_LEN_M (0 = not checked).",
                )
            )
        return found

    def record(self) -> bytes:
        """The reference as the board stores it (docs/reference/protocol.md, ``TBRF``)."""

        return encode_reference(self.beat_s, self.speed_m_s)

    @property
    def crc(self) -> int:
        """The identity of the reference: the u32 at offset 8 of its record."""
        return int.from_bytes(self.record()[8:12], "little")

    def to_csv(self, path: Path) -> None:
        """Write ``beat,t_s,v_m_s``: the beat means, t_s the middle of each beat, s.

        ``from_csv`` reads the very same reference.

        Parameters
        ----------
        path : Path
            The file; it is replaced in one step.

        Raises
        ------
        InputError
            The file cannot be written.
        """
        with replacing_text(path) as file:
            file.write(self.csv_text())

    def csv_text(self) -> str:
        """The content of the file that ``to_csv`` writes."""
        rows = (
            (beat, repr((beat + 0.5) * self.beat_s), repr(float(speed)))
            for beat, speed in enumerate(self.speed_m_s)
        )
        return table_text(("beat", "t_s", "v_m_s"), rows)


def _value_problems(speed: F32, limit: float) -> list[ReferenceProblem]:
    found = []
    bad = np.flatnonzero(~np.isfinite(speed))
    if bad.size:
        found.append(ReferenceProblem(f"beat {bad[0]} has no finite speed.", "Fill the gap."))
    slow = np.flatnonzero(speed < 0)
    if slow.size:
        found.append(
            ReferenceProblem(
                f"beat {slow[0]} wants {speed[slow[0]] * 1e3:.1f} mm/s.",
                "The fish cannot swim backwards; use speeds of 0 or more.",
            )
        )
    fast = np.flatnonzero(speed > np.float32(limit))
    if fast.size:
        found.append(
            ReferenceProblem(
                f"beat {fast[0]} wants {speed[fast[0]] * 1e3:.1f} mm/s; "
                f"the board allows {limit * 1e3:.1f}.",
                "Slow it down, or raise REF_MAX_M_S if the fish can do it.",
            )
        )
    return found


def _too_long(beats: str) -> str:
    return f"the reference has {beats} beats; 1 to {BEATS_MAX} fit on the board."


def _beat_means(integral: Antiderivative, beats: int, beat_s: float) -> F32:
    edges = np.arange(beats + 1, dtype=np.float64) * beat_s
    return (np.diff(integral(edges)) / beat_s).astype(np.float32)


def _whole_beats(duration_s: float, beat_s: float) -> int:
    """Beats that cover the duration: a begun beat counts. Raises InputError."""
    beats = duration_s / beat_s
    if beats > BEATS_MAX + _ROUNDING:
        raise InputError(
            _too_long(f"{beats:.0f}" if beats < 1e6 else f"{beats:.1e}"), "Shorten it."
        )
    return max(1, math.ceil(beats - _ROUNDING))


def thesis_speed(t_s: NDArray[np.floating[Any]]) -> F64:
    """The wanted speed of (8.31) at the given instants, m/s."""
    polynomial = 2.25 * t_s**2 * (t_s - 40) ** 2 / 40.0**4
    return np.asarray(np.where((t_s > 10) & (t_s <= 30), THESIS_PLATEAU_M_S, polynomial))


def thesis(speed: float = THESIS_PLATEAU_M_S, duration_s: float = 40.0) -> Reference:
    """The speed profile of the thesis, equation (8.31): 40 beats of 1 s, 2.20 m. With another
    ``speed`` (of the plateau, m/s) or ``duration_s`` the same shape."""
    _check_shape(speed, 0.0, duration_s, 1.0)
    m, s = speed / THESIS_PLATEAU_M_S, 40.0 / duration_s

    def integral(t: F64) -> F64:
        t = np.minimum(s * t, 40.0)
        polynomial = 2.25 / 40.0**4 * (t**5 / 5 - 20 * t**4 + 1600 * t**3 / 3)
        at_10 = 2.25 / 40.0**4 * (10.0**5 / 5 - 20 * 10.0**4 + 1600 * 10.0**3 / 3)
        at_30 = 2.25 / 40.0**4 * (30.0**5 / 5 - 20 * 30.0**4 + 1600 * 30.0**3 / 3)
        plateau = at_10 + THESIS_PLATEAU_M_S * (t - 10)
        end = at_10 + THESIS_PLATEAU_M_S * 20 + polynomial - at_30
        return np.asarray(m / s * np.where(t <= 10, polynomial, np.where(t <= 30, plateau, end)))

    plain = m == 1 and s == 1
    name = "thesis" if plain else f"thesis-{speed:g}-{duration_s:g}"
    means = _beat_means(integral, _whole_beats(duration_s, 1.0), 1.0)
    return Reference(1.0, np.maximum(means, 0), name)


def trapezoid(speed: float, ramp_s: float, hold_s: float, beat_s: float = 1.0) -> Reference:
    """Straight ramp up, hold, straight ramp down; speed in m/s."""
    _check_shape(speed, ramp_s, hold_s, beat_s)
    time = np.cumsum([0.0, ramp_s, hold_s, ramp_s])
    means = _linear_means(time, np.array([0.0, speed, speed, 0.0]), beat_s)
    return Reference(beat_s, means, f"trapezoid-{speed:g}-{ramp_s:g}-{hold_s:g}")


def cosine(speed: float, ramp_s: float, hold_s: float, beat_s: float = 1.0) -> Reference:
    """Half a cosine up, hold, half a cosine down; speed in m/s."""
    _check_shape(speed, ramp_s, hold_s, beat_s)
    total_s = 2 * ramp_s + hold_s

    def ramp(t: F64) -> F64:
        if ramp_s == 0:
            return np.zeros_like(t)
        t = np.clip(t, 0, ramp_s)
        return speed / 2 * (t - ramp_s / np.pi * np.sin(np.pi * t / ramp_s))

    def integral(t: F64) -> F64:
        hold = speed * np.clip(t - ramp_s, 0, hold_s)
        down = speed * ramp_s / 2 - ramp(total_s - t)
        return ramp(t) + hold + np.where(t > ramp_s + hold_s, down, 0.0)

    means = _beat_means(integral, _whole_beats(total_s, beat_s), beat_s)
    return Reference(beat_s, np.maximum(means, 0), f"cosine-{speed:g}-{ramp_s:g}-{hold_s:g}")


def _check_shape(speed: float, ramp_s: float, hold_s: float, beat_s: float) -> None:
    values = (speed, ramp_s, hold_s, beat_s)
    if not all(map(math.isfinite, values)) or min(speed, ramp_s, hold_s) < 0 or beat_s <= 0:
        raise InputError(
            "speed, ramp and hold must be 0 or more and the beat longer than 0.",
            "Give them in m/s and s, for example cosine:0.08,8,20.",
        )
    if 2 * ramp_s + hold_s <= 0:
        raise InputError("the reference lasts 0 s.", "Make the ramp or the hold longer.")


def _linear_means(time: F64, speed: F64, beat_s: float) -> F32:
    """Exact beat means of the straight lines through the points; the last value is held to the end
    of the last begun beat."""
    distance = np.concatenate([[0.0], np.cumsum(np.diff(time) * (speed[1:] + speed[:-1]) / 2)])

    def integral(t: F64) -> F64:
        inside = np.clip(t, 0.0, time[-1])
        i = np.clip(np.searchsorted(time, inside, side="right") - 1, 0, len(time) - 2)
        width = time[i + 1] - time[i]
        slope = np.where(width > 0, (speed[i + 1] - speed[i]) / np.where(width > 0, width, 1), 0.0)
        dt = inside - time[i]
        held = speed[-1] * (t - inside)
        return np.asarray(distance[i] + speed[i] * dt + slope * dt**2 / 2 + held)

    return _beat_means(integral, _whole_beats(float(time[-1]), beat_s), beat_s)


def curve(t_s: F64, v_m_s: F64, beat_s: float, name: str) -> Reference:
    """The reference of straight lines between points; t_s begins at 0 and rises."""
    return Reference(beat_s, _linear_means(t_s, v_m_s, beat_s), name)


def from_csv(path: Path, beat_s: float = 1.0) -> Reference:
    """Reads columns ``t_s,v_m_s`` (a header is required, further columns are ignored), or what
    ``Reference.to_csv`` has written: with a column ``beat`` they are beat means as they are.

    The curve is straight between the points; time starts at 0 and rises. A last beat that has begun
    is filled up with the last speed.
    """
    time, speed, has_beats = _read_points(path)
    if has_beats:
        return _of_beat_means(path, time, speed)
    if time[0] != 0:
        raise InputError(
            f"{path.name}, row 2, column t_s: the first time is {time[0]:g}, not 0.",
            "Subtract the first time from all of them.",
        )
    if len(time) < 2:
        raise InputError(f"{path.name} has one point only.", "Give at least a begin and an end.")
    if time[-1] > BEATS_MAX * beat_s * (1 + _ROUNDING):
        raise InputError(
            f"{path.name} lasts {time[-1]:g} s, that is more than {BEATS_MAX} beats.",
            "Shorten it, or check that t_s is in seconds.",
        )
    return curve(time, speed, beat_s, path.stem)


def _of_beat_means(path: Path, middle_s: F64, speed: F64) -> Reference:
    """Twice the middle of the first beat is the length of all."""
    beat_s = 2 * float(middle_s[0])
    off_s = np.abs(middle_s - (np.arange(len(middle_s)) + 0.5) * beat_s)
    even = off_s < _UNEVEN * beat_s
    if not even.all():
        beat = int(np.argmin(even))
        raise InputError(
            f"{path.name}, column t_s: {middle_s[beat]:g} is not the middle of beat {beat}.",
            "With a column beat the rows are beat means, t_s in the middle of each. Remove that"
            " column if they are points of a curve.",
        )
    if len(speed) > BEATS_MAX:
        raise InputError(
            f"{path.name} has {len(speed)} beats, more than {BEATS_MAX}.", "Shorten it."
        )
    return Reference(beat_s, speed.astype(np.float32), path.stem)


def _read_points(path: Path) -> tuple[F64, F64, bool]:
    """Times, speeds, and whether they are of beats."""
    table = read_table(path, "t_s,v_m_s")
    if not table:
        raise InputError(f"{path.name} is empty.", "It needs a header t_s,v_m_s and numbers.")
    points: list[tuple[float, float]] = []
    for number, (t_cell, v_cell) in read_rows(path, ("t_s", "v_m_s")):
        t = value_of(path.name, number, "t_s", t_cell, least=0.0)
        if points and t <= points[-1][0]:
            raise InputError(
                f"{path.name}, row {number}, column t_s: {t:g} does not come after "
                f"{points[-1][0]:g}.",
                "Sort by time.",
            )
        points.append((t, value_of(path.name, number, "v_m_s", v_cell, least=0.0)))
    time, speed = np.array(points).T
    return time, speed, "beat" in [cell.strip() for cell in table[0]]


_SHAPES: dict[str, tuple[Callable[..., Reference], str]] = {
    "thesis": (thesis, "0.0633,50 (m/s, s)"),
    "trapezoid": (trapezoid, "0.08,8,20 (m/s, s, s)"),
    "cosine": (cosine, "0.08,8,20 (m/s, s, s)"),
}
_NAMES = (
    "Use thesis, thesis:V,DURATION_S, trapezoid:V,RAMP_S,HOLD_S, cosine:V,RAMP_S,HOLD_S "
    "or a CSV file."
)


def from_text(text: str) -> Reference:
    """``thesis``, ``thesis:SPEED,DURATION_S``, ``trapezoid:SPEED,RAMP_S,HOLD_S``,
    ``cosine:SPEED,RAMP_S,HOLD_S`` or a CSV."""
    kind, _, arguments = text.partition(":")
    if text == "thesis":
        return thesis()
    if kind in _SHAPES and (arguments or kind == "thesis"):
        shape, example = _SHAPES[kind]
        try:
            numbers = [float(part) for part in arguments.split(",")]
            if len(numbers) != example.partition(" ")[0].count(",") + 1:
                raise ValueError
        except ValueError:
            raise InputError(
                f"'{text}' is not a reference.", f"Write it like {kind}:{example}."
            ) from None
        return shape(*numbers)
    path = Path(text)
    if not text.strip():
        raise InputError("the name of the reference is empty.", _NAMES)
    if path.is_dir():
        raise InputError(f"'{text}' is a folder, no reference.", "Name a CSV file in it.")
    if not path.exists():
        raise InputError(f"there is no reference '{text}'.", did_you_mean(kind, _SHAPES) + _NAMES)
    return from_csv(path)
