"""Trial files: the ULog a board writes for every trial, and what can be recomputed from it."""

from __future__ import annotations

import contextlib
import csv
import io
import pickle
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F32
from tailbeat.core.errors import InputError, reason
from tailbeat.core.faults import fault_info
from tailbeat.core.files import replacing_text
from tailbeat.core.param_names import with_current_names
from tailbeat.core.reference import BEATS_MAX
from tailbeat.core.ulog import HEADER_BYTES, RECORD_TYPES, SIZES

# A board's formats are flat lists of numbers and it subscribes to each once. What is beyond that
# pyulog would unfold: a format of formats, of some bytes in the file, to more than memory holds.
_FIELD_TYPES = frozenset(SIZES)
_FORMAT_BYTES_MAX = 1024
_SUBSCRIPTIONS_MAX = 64
SLOT_S = 0.1
NO_MOTION = -32768
_SLOT_COLUMNS = {
    "index": np.uint16,
    "samples": np.uint8,
    "at_ms": np.uint8,
    "speed_m_s": np.float32,
    "sigma_10um_s": np.uint16,
    "gain_10um_s": np.int16,
    "way_um": np.int16,
    "turn_100urad": np.int16,
}
_BEAT_COLUMNS = {
    "amplitude_rad": np.float32,
    "applied_rad": np.float32,
    "reference_m_s": np.float32,
    "speed_m_s": np.float32,
    "sigma_m_s": np.float32,
    "samples": np.uint16,
}
_BEAT_LATER = frozenset[str]()  # columns that files of older boards lack
_SLOT_LATER = frozenset({"turn_100urad"})  # files of older boards lack these


@dataclass(frozen=True)
class Slots:
    """What the board knew of each 0.1 s, as rounded as it used it; all arrays have shape (slots,).

    ``samples`` counts the camera's; without any, speed and sigma mean nothing. ``gain_10um_s`` is
    the forward speed gained by the IMU, ``way_um`` the way beyond that of the speed at the slot's
    begin, ``turn_100urad`` how far its nose's heading turned, clockwise from above; NO_MOTION = not
    known.
    """

    index: NDArray[np.uint16]
    samples: NDArray[np.uint8]
    at_ms: NDArray[np.uint8]
    speed_m_s: F32
    sigma_10um_s: NDArray[np.uint16]
    gain_10um_s: NDArray[np.int16]
    way_um: NDArray[np.int16]
    turn_100urad: NDArray[np.int16]

    def table(self) -> dict[str, NDArray[Any]]:
        """In SI units: ``t_s`` (mean time of the camera's samples, or the slot's middle), ``v_m_s``
        and ``sigma_m_s`` of the camera, ``samples``, ``gain_m_s`` and ``turn_rad`` of the IMU;
        NaN = not known."""
        seen = self.samples > 0
        since_s = np.where(seen, self.at_ms * 1e-3, SLOT_S / 2)
        return {
            "t_s": self.index * SLOT_S + since_s,
            "v_m_s": np.where(seen, self.speed_m_s, np.nan),
            "sigma_m_s": np.where(seen, self.sigma_10um_s * 1e-5, np.nan),
            "samples": self.samples,
            "gain_m_s": np.where(self.gain_10um_s == NO_MOTION, np.nan, self.gain_10um_s * 1e-5),
            "turn_rad": np.where(self.turn_100urad == NO_MOTION, np.nan, self.turn_100urad * 1e-4),
        }


@dataclass(frozen=True)
class Rest:
    """The fish was still, by its IMU; time from the start of the trial.

    ``tilt_sigma_rad``: pitch left unknown beyond the sensor's noise (firmware/speed/estimate.h).
    """

    begin_s: float
    still_s: float
    tilt_sigma_rad: float = 0.0


@dataclass(frozen=True)
class Beats:
    """One row per beat of the reference, shape (beats,). NaN where the file has no record."""

    amplitude_rad: F32
    applied_rad: F32
    reference_m_s: F32
    speed_m_s: F32
    sigma_m_s: F32
    samples: NDArray[np.uint16]

    @property
    def error_m_s(self) -> F32:
        """Reference minus speed; NaN where not measured."""
        with np.errstate(invalid="ignore"):  # a damaged file may hold infinities
            return self.reference_m_s - self.speed_m_s

    def table(self) -> dict[str, NDArray[Any]]:
        """All columns by name, in the order of tables; the error stands behind the speed's
        sigma."""
        columns = {name: getattr(self, name) for name in _BEAT_COLUMNS}
        samples = columns.pop("samples")
        return columns | {"error_m_s": self.error_m_s, "samples": samples}


@dataclass(frozen=True)
class Trial:
    """One trial as its log tells it.

    Attributes
    ----------
    number, iteration : int
        Number of the trial on its board (1 = first), and of its amplitudes' iteration.
    reference_crc : int
        Identity of the reference, the CRC-32 of its record.
    beat_s : float
        Length of a beat, s.
    start_us : int
        Start by the board's clock, us since it booted.
    board, build_id, unique_id : str
        Kind of the board, build of its firmware, and its unique id in hexadecimal digits.
    end_fault : int or None
        Fault number of the end, 0 = complete; None: the file has no end record.
    executed_beats : int
        Beats that were executed.
    end : str
        ``complete``, ``aborted:REASON``, ``fault:NAME`` or ``unfinished``.
    uploaded : bool
        Whether the speeds were given after the trial.
    params : dict of str to float
        The board's parameters at the start, by their present names.
    slots : Slots
        What was known of each 0.1 s.
    rest_before, rest_after : Rest or None
        What the IMU measured at rest; None: nothing.
    beats : Beats
        Reference, amplitude, speed and error of each beat; arrays of shape (beats,).
    battery_v : list of (float, float)
        Time since the start, s, and voltage, V.
    problems : list of str
        What is wrong with the file, one line each.
    input : str
        What made the amplitudes: law, first, uploaded, restored; empty = not known.
    """

    number: int
    iteration: int
    reference_crc: int
    beat_s: float
    start_us: int
    board: str
    build_id: str
    unique_id: str
    end_fault: int | None  # None: the file has no end record
    executed_beats: int
    end: str  # ``complete``, ``aborted:REASON``, ``fault:NAME`` or ``unfinished``
    uploaded: bool  # the beats' speeds were given after the trial
    params: dict[str, float]
    slots: Slots
    rest_before: Rest | None
    rest_after: Rest | None
    beats: Beats
    battery_v: list[tuple[float, float]]  # (t_s, V)
    problems: list[str] = field(default_factory=list)
    input: str = ""  # what made its amplitudes: law, first, uploaded, restored; "" = not told

    def max_abs_error_m_s(self) -> float:
        """Over measured beats; NaN when there is none."""
        error = np.abs(self.beats.error_m_s[np.isfinite(self.beats.error_m_s)])
        return float(error.max()) if error.size else float("nan")

    def rms_error_m_s(self) -> float:
        """Over measured beats; NaN when there is none."""
        error = self.beats.error_m_s[np.isfinite(self.beats.error_m_s)].astype(np.float64)
        return float(np.sqrt(np.mean(error**2))) if error.size else float("nan")


def fault_text(number: int) -> str:
    """``complete``, ``aborted:LINK_LOST`` or ``fault:LATE_TICK`` for an end's fault number."""

    if number == 0:
        return "complete"
    fault = fault_info(number)
    return f"{'fault' if fault.kind == 'fault' else 'aborted'}:{fault.name}"


def read_trial(path: Path) -> Trial:
    """Read a trial file; one that was cut short as far as it goes.

    Parameters
    ----------
    path : Path
        The ULog file of a trial.

    Returns
    -------
    Trial
        The trial; ``problems`` says what is missing.

    Raises
    ------
    InputError
        The file cannot be read or is no trial.
    """
    try:
        raw = path.read_bytes()
    except FileNotFoundError as error:
        raise InputError(
            f"there is no trial file {path}.",
            "Check the path, or give a trial's number; 'tailbeat trial list' prints them.",
        ) from error
    except OSError as error:
        raise InputError(
            f"cannot read {path} ({reason(error)}).", "Pull the trial again."
        ) from error
    return parse_trial(raw, path.name)


def parse_trial(raw: bytes, name: str = "trial") -> Trial:
    """As ``read_trial``, from the bytes of the file."""
    trial: Trial = pickle.loads(_parsed(raw, name))
    return trial


@lru_cache(maxsize=256)  # a series reads all its trials again after each
def _parsed(raw: bytes, name: str) -> bytes:
    """The trial as a pickle, from which everybody gets one that is their own."""
    from pyulog import ULog

    if raw[:4] != b"ULog":
        raise InputError(f"{name} is not a ULog file.", "Pull the trial again.")
    sound, problems = _sound_part(raw)
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # pyulog prints what it thinks of a file
            log = ULog(io.BytesIO(sound))
    except Exception as error:  # it raises whatever its parsing stumbles over
        raise InputError(
            f"{name} is damaged before its first record: {error}.", "Pull the trial again."
        ) from error
    info = log.msg_info_dict
    missing = [key for key in ("trial", "beats", "reference_crc", "beat_s") if key not in info]
    if missing:
        raise InputError(
            f"{name} is no trial file: {', '.join(missing)} is missing.", "Pull the trial again."
        )
    tables: dict[str, dict[str, Any]] = {data.name: data.data for data in log.data_list}
    try:
        return pickle.dumps(_trial(log, info, tables, problems), pickle.HIGHEST_PROTOCOL)
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        raise InputError(
            f"{name} holds values that make no sense: {error}.", "Pull the trial again."
        ) from error


def _sound_part(raw: bytes) -> tuple[bytes, list[str]]:
    """The file up to the first record that is none, and what is wrong there. (Left to itself pyulog
    may search a damaged file for ever.)"""
    at = HEADER_BYTES
    subscriptions = 0
    while at + 3 <= len(raw):
        size = int.from_bytes(raw[at : at + 2], "little")
        kind = raw[at + 2 : at + 3]
        subscriptions += kind == b"A"
        bomb = subscriptions > _SUBSCRIPTIONS_MAX or (
            kind == b"F" and not _is_flat(raw[at + 3 : at + 3 + size])
        )
        if size == 0 or kind not in RECORD_TYPES or bomb:
            return raw[:at], ["the file is damaged; what comes after the damage is left out"]
        if at + 3 + size > len(raw):
            break
        at += 3 + size
    return raw[:at], ["the file is cut off in the middle of a record"] if at < len(raw) else []


def _is_flat(description: bytes) -> bool:
    """Whether a format is a short list of single numbers."""
    _, _, fields = description.partition(b":")
    types = (field.partition(b" ")[0].decode("latin-1") for field in fields.split(b";") if field)
    return len(description) <= _FORMAT_BYTES_MAX and all(kind in _FIELD_TYPES for kind in types)


def _trial(
    log: Any, info: dict[str, Any], tables: dict[str, dict[str, Any]], problems: list[str]
) -> Trial:
    if log.file_corruption:
        problems.append("the file is damaged in places")
    end = tables.get("trial_end")
    fault = int(end["end"][-1]) if end else None
    if fault is None:
        problems.append("the file has no end record: the trial was not closed")
    count = int(info["beats"])
    if not 1 <= count <= BEATS_MAX:
        raise ValueError(f"{count} beats")
    beats = _beats(tables.get("beat"), count)
    start_us = int(info.get("start_us", 0))
    measured = int(np.count_nonzero(np.isfinite(beats.applied_rad)))
    rests = _rests(tables.get("rest"))
    return Trial(
        number=int(info["trial"]),
        iteration=int(info.get("iteration", 0)),
        reference_crc=int(info["reference_crc"]),
        beat_s=float(info["beat_s"]),
        start_us=start_us,
        board=str(info.get("board", "")),
        build_id=str(info.get("ver_sw", "")),
        unique_id=str(info.get("unique_id", "")),
        end_fault=fault,
        executed_beats=int(end["executed"][-1]) if end else measured,
        end="unfinished" if fault is None else fault_text(fault),
        uploaded=_uploaded(tables.get("beat"), end),
        params=_params(log),
        slots=_slots(tables.get("slot")),
        rest_before=next((rest for rest in rests if rest.begin_s < 0), None),
        rest_after=next((rest for rest in rests if rest.begin_s >= 0), None),
        beats=beats,
        battery_v=_battery(tables.get("battery"), start_us),
        problems=problems,
        input=str(info.get("input", "")),
    )


def _params(log: Any) -> dict[str, float]:
    params = {name: float(value) for name, value in log.initial_parameters.items()}
    return with_current_names(params)


def _slots(table: dict[str, Any] | None) -> Slots:
    table = table or {name: [] for name in _SLOT_COLUMNS}
    unknown = [NO_MOTION] * len(table["index"])
    columns = {
        name: np.asarray(table.get(name, unknown) if name in _SLOT_LATER else table[name], kind)
        for name, kind in _SLOT_COLUMNS.items()
    }
    return Slots(**columns)


def _rests(table: dict[str, Any] | None) -> list[Rest]:
    if not table:
        return []
    # older files have no tilt sigma
    tilts = table.get("tilt_sigma_rad", [0.0] * len(table["begin_s"]))
    return [
        Rest(float(begin), float(still), float(tilt))
        for begin, still, tilt in zip(table["begin_s"], table["still_s"], tilts, strict=True)
    ]


def _beats(table: dict[str, Any] | None, beats: int) -> Beats:
    columns: dict[str, NDArray[Any]] = {
        name: np.full(beats, 0 if kind is np.uint16 else np.nan, kind)
        for name, kind in _BEAT_COLUMNS.items()
    }
    table = table or {"beat": ()}
    for row, beat in enumerate(table["beat"]):
        for name, column in columns.items() if beat < beats else ():
            if name not in _BEAT_LATER or name in table:
                column[beat] = table[name][row]
    return Beats(**columns)


def _uploaded(beats: dict[str, Any] | None, end: dict[str, Any] | None) -> bool:
    """Beats are written when the trial is over; what comes later than its end was uploaded."""
    return bool(beats and end and max(beats["timestamp"]) > end["timestamp"][-1])


def _battery(table: dict[str, Any] | None, start_us: int) -> list[tuple[float, float]]:
    if not table:
        return []
    time = (np.asarray(table["timestamp"], dtype=np.float64) - start_us) / 1e6
    return [(float(t), float(v)) for t, v in zip(time, table["voltage_v"], strict=True)]


def beats_csv(trial: Trial, path: Path) -> None:
    """Writes one row per beat, units in the header; empty cells where nothing is known."""
    table = trial.beats.table()
    samples = table.pop("samples")
    with replacing_text(path) as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(["beat", "t_s", *table, "samples"])
        for k, count in enumerate(samples):
            cells = [_cell(column[k]) for column in table.values()]
            out.writerow([k, _cell((k + 0.5) * trial.beat_s), *cells, int(count)])


def _cell(value: Any) -> str:
    number = float(value)
    return "" if number != number else repr(number)
