"""The learning law, computed by the C code the board runs (firmware/ilc/law.h), bit for bit."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from tailbeat.core.errors import InputError, did_you_mean, reason
from tailbeat.core.lazy_arrays import F32, ArrayLike, NDArray, np
from tailbeat.core.native import ffi, lib
from tailbeat.core.param_names import current_name

_PARAMS = {
    "ILC_GAIN": "kp_rad_s_m",
    "ILC_KD": "kd_rad_s2_m",
    "AMP_MAX_RAD": "amplitude_max_rad",
    "DU_MAX_RAD": "step_max_rad",
    "ILC_LEAD": "lead_beats",
    "ILC_DECR_RATE": "fade",
    "ILC_DECR_FROM": "fade_from",
    "ILC_Q_LEN": "q_len",
    "ILC_END_EXT": "tail",
}
_DESIGNED = ("ILC_GAIN", "ILC_KD", "ILC_LEAD", "ILC_END_EXT", "ILC_Q_LEN", "ILC_DECR_RATE")
_SINCE_FADE = {"ILC_DECR_RATE": 0.0, "ILC_DECR_FROM": 5.0}  # files of older firmware have neither
_SHORT = {
    "gain": "kp_rad_s_m",
    "kp": "kp_rad_s_m",
    "kd": "kd_rad_s2_m",
    "lead": "lead_beats",
    "amplitude_max": "amplitude_max_rad",
    "step_max": "step_max_rad",
}
_TAILS = {"hold": 0, "keep": 1, "hold-new": 2, "hold-old": 3}
LAST = 0  # ILC_KIND of a law that learns from the last trial alone
_KINDS = ("kind", "ILC_KIND")
_WHOLE = ("fade_from", "q_len", "tail")
_VISITS_MAX = 255
_BEATS_MAX = 512
_REFUSALS = {
    1: (
        "the law does not fit: a gain, a limit, fade, lead_beats, q_len or kd is out of range.",
        "Gains are finite, limits above 0, fade is 0 or more. lead_beats is a multiple of 0.5 and "
        "shorter than the trial, and 2*q_len-1 fits into it. With ILC_KIND 1, ILC_KD is 0.",
    ),
    2: ("an amplitude or a measured error is not finite.", "Check the values for gaps."),
    3: ("no beat has a measured speed.", "Upload the speeds of the trial, or swim it again."),
}


@dataclass(frozen=True)
class Law:
    """The learning law of the board, mirror of ``law_t`` (firmware/ilc/law.h).

    The plain P-type law of the thesis (8.16) is ``Law(kp_rad_s_m=gamma)``.

    Attributes
    ----------
    kp_rad_s_m : float
        Learning gain on the speed error, rad s/m.
    kd_rad_s2_m : float
        Gain on the error's change from beat to beat, rad s^2/m.
    amplitude_max_rad : float
        Saturation: the largest amplitude, rad; above 0.
    step_max_rad : float
        Largest change of an amplitude per trial, rad; 0 = no limit.
    beat_s : float
        Length of a beat, s.
    lead_beats : float
        How far the error is looked at ahead, beats; a multiple of 0.5.
    fade : float
        Decrease of the gain: a beat's gain is divided by 1 + fade * (updates beyond fade_from).
    fade_from : int
        Number of updates of a beat from which its gain decreases.
    q_len : int
        Length of the zero-phase filter, beats; 1 = none.
    tail : int
        Extension of the error beyond the end of the trial, 0 to 3 (``ILC_END_EXT``).
    """

    kp_rad_s_m: float = 4.0
    kd_rad_s2_m: float = 0.0
    amplitude_max_rad: float = math.pi / 4
    step_max_rad: float = 0.0
    beat_s: float = 1.0
    lead_beats: float = 0  # a multiple of 0.5
    fade: float = 0.0  # a beat's gain is divided by 1 + fade * (visits beyond fade_from)
    fade_from: int = 5
    q_len: int = 1
    tail: int = 0

    @classmethod
    def from_params(cls, params: Mapping[str, float], beat_s: float = 1.0) -> Law:
        """Make the law that the board runs with these parameters.

        Parameters
        ----------
        params : mapping of str to float
            Board parameters by name, with their units; may hold more than the law's.
        beat_s : float
            Length of a beat, s.

        Returns
        -------
        Law
            The law.

        Raises
        ------
        KeyError
            A parameter of the law is missing.
        """
        known = _SINCE_FADE | dict(params)
        values: dict[str, Any] = {field: known[name] for name, field in _PARAMS.items()}
        for field in _WHOLE:
            values[field] = int(values[field])
        return cls(**values, beat_s=beat_s)

    def params(self) -> dict[str, float]:
        """The parameters with which a board runs this law on its last trial alone.

        Returns
        -------
        dict
            By name; without its limits, and without the visit at which the gain begins to fall.
        """
        law = {name: float(getattr(self, _PARAMS[name])) for name in _DESIGNED}
        return law | {"ILC_KIND": float(LAST)}

    def native(self, ffi: Any) -> Any:
        """Make a ``law_t`` for the C code.

        Parameters
        ----------
        ffi : cffi.FFI
            Of ``core.native``.

        Returns
        -------
        cdata
            A ``law_t *``, which lives as long as somebody holds it.
        """
        return ffi.new("law_t *", vars(self))

    def label(self) -> str:
        """Short text for a folder name, ``p4`` or ``p4-lead0.5``."""
        text = f"p{self.kp_rad_s_m:g}"
        text += f"d{self.kd_rad_s2_m:g}" if self.kd_rad_s2_m else ""
        text += f"-lead{self.lead_beats:g}" if self.lead_beats else ""
        text += f"-fade{self.fade:g}" if self.fade else ""
        return text + (f"-q{self.q_len}" if self.q_len > 1 else "")


@dataclass(frozen=True)
class PastKind:
    """A kind of law by what it learns from. ``number``: its ILC_KIND. ``label``: what a folder name
    says of it. ``earlier``: trials it looks back on; None = one less than its window. ``running``:
    what the board keeps of them is their mean."""

    number: int
    label: str
    earlier: int | None
    running: bool = False


PAST_KINDS = {
    "last": PastKind(LAST, "", earlier=0),
    "mean": PastKind(1, "mean-", earlier=1, running=True),
    "window": PastKind(2, "avg{window}-", earlier=None),
}


@dataclass(frozen=True)
class Averaging:
    """What the board's law learns from: ``kind``, a number of ``PAST_KINDS``, with a ``window`` of
    so many trials. ILC_KIND and ILC_WINDOW; firmware without them has the last trial alone."""

    kind: int = LAST
    window: int = 3

    @classmethod
    def from_params(cls, params: Mapping[str, float]) -> Averaging:
        """What the board learns from with these parameters."""
        return cls(int(params.get("ILC_KIND", cls.kind)), int(params.get("ILC_WINDOW", cls.window)))

    @property
    def traits(self) -> PastKind:
        """Of the kind."""
        by_number = {kind.number: kind for kind in PAST_KINDS.values()}
        return by_number.get(self.kind, PAST_KINDS["window"])

    @property
    def earlier(self) -> int:
        """How many earlier trials it looks back on."""
        found = self.traits.earlier
        return self.window - 1 if found is None else found

    def label(self) -> str:
        """What a folder name says of it ahead of the law's label; "" for the last trial."""
        return self.traits.label.format(window=self.window)


@dataclass(frozen=True)
class LawReport:
    """Mirror of ``law_report_t``; errors over measured beats, m/s."""

    max_abs_error_m_s: float
    rms_error_m_s: float
    measured_beats: int
    saturated_beats: int


def load(path: Path) -> Law:
    """Reads a LAW.json: an object of ``Law`` fields or of parameter names; what is missing is
    as in (8.16), with amplitudes up to pi/4. ``gain`` and ``lead`` are understood too, and the
    tail by name: hold, keep, hold-new or hold-old."""
    try:
        raw = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(
            f"cannot read {path} ({reason(error)}).",
            'Give a file like {"kp_rad_s_m": 4, "lead_beats": 1}.',
        ) from error
    if not isinstance(raw, dict):
        raise InputError(f"{path.name} holds no JSON object.", 'Write it like {"kp_rad_s_m": 4}.')
    values: dict[str, Any] = {}
    for key, value in raw.items():
        if current_name(key) in _KINDS:
            _check_kind(path, key, value)
            continue
        field = _PARAMS.get(current_name(key)) or _SHORT.get(key) or key
        values[field] = _law_value(path, key, field, value)
    return Law(**values)


def _check_kind(path: Path, key: str, value: object) -> None:
    if isinstance(value, bool) or value != LAST:
        raise InputError(
            f"{path.name}: {key} is not 0. An average needs its earlier trials, and this applies "
            "the law to one.",
            f"Leave {key} out; the board averages with ILC_KIND 1 or 2 (trial learn --dry-run).",
        )


def _law_value(path: Path, key: str, field: str, value: object) -> float | int:
    names = [f.name for f in fields(Law)]
    if field not in names:
        raise InputError(
            f"{path.name}: unknown key {key}.",
            f"{did_you_mean(key, names)}Known are {', '.join(names)}.",
        )
    if field == "tail" and isinstance(value, str) and value in _TAILS:
        return _TAILS[value]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{path.name}: {key} is not a number.", "Write it like 4 or 0.785.")
    if field == "lead_beats":
        return _lead(path, key, value)
    if field not in _WHOLE:
        return float(value)
    if not 0 <= value <= 65535 or value != int(value) or (field == "tail" and value > 3):
        raise InputError(f"{path.name}: {key} is not a whole number that fits.", "Use 0, 1, 2, …")
    return int(value)


def _lead(path: Path, key: str, value: float) -> float:
    if not 0 <= value <= 65535 or 2 * value != int(2 * value):
        raise InputError(
            f"{path.name}: {key} is no multiple of half a beat.", "Use 0, 0.5, 1, 1.5, …"
        )
    return float(value)


def errors_of(reference_m_s: ArrayLike, speed_m_s: ArrayLike) -> tuple[F32, NDArray[np.bool_]]:
    """(error, measured) per beat: reference minus speed in float32, 0 where the speed is NaN."""
    reference = np.asarray(reference_m_s, dtype=np.float32)
    speed = np.asarray(speed_m_s, dtype=np.float32)
    measured = np.isfinite(speed)
    error = np.where(measured, reference - np.where(measured, speed, 0), 0).astype(np.float32)
    return error, measured


class LawCall:
    """The C arguments of one law call, kept alive together."""

    def __init__(
        self,
        law: Law,
        amplitudes: F32,
        errors: F32,
        measured: ArrayLike | None,
        visits: ArrayLike | None = None,
    ):
        beats = len(amplitudes)
        if len(errors) != beats or not 1 <= beats <= _BEATS_MAX:
            raise InputError(
                f"{beats} amplitudes and {len(errors)} errors do not make a trial.",
                "Give one of each per beat, 1 to 512 beats.",
            )
        mask = np.ones(beats, bool) if measured is None else np.asarray(measured, dtype=bool)
        self.law = law.native(ffi)
        self.amplitudes = ffi.new("float[]", amplitudes.tolist())
        self.errors = ffi.new("float[]", errors.tolist())
        self.mask = ffi.new("uint8_t[]", mask.astype(int).tolist())
        self.visits = ffi.new("uint8_t[]", update_counts(visits, beats))
        self.trial = ffi.new(
            "law_trial_t *",
            {
                "beats": beats,
                "error_m_s": self.errors,
                "measured": self.mask,
                "visits": self.visits,
            },
        )
        self.report = ffi.new("law_report_t *")
        self.scratch = ffi.new("float[]", beats)

    def law_report(self) -> LawReport:
        return LawReport(*(getattr(self.report, f.name) for f in fields(LawReport)))

    def next_amplitudes(self) -> F32:
        return np.frombuffer(ffi.buffer(self.amplitudes), dtype=np.float32).copy()


def refused(result: int) -> None:
    """Raises InputError when the C code turned a law or a trial down."""
    if result:
        raise InputError(*_REFUSALS[result])


def update_counts(visits: ArrayLike | None, beats: int) -> list[int]:
    """One count per beat, 0 to 255; none when ``visits`` is None. Raises InputError."""
    counts = np.zeros(beats, np.int64) if visits is None else np.asarray(visits, dtype=np.int64)
    if counts.shape != (beats,) or np.any((counts < 0) | (counts > _VISITS_MAX)):
        raise InputError(
            "the update counts are not one per beat.",
            f"Give whole numbers from 0 to {_VISITS_MAX}.",
        )
    return [int(count) for count in counts]


def update(
    law: Law,
    amplitudes: ArrayLike,
    errors: ArrayLike,
    measured: ArrayLike | None = None,
    visits: ArrayLike | None = None,
) -> tuple[F32, LawReport]:
    """One step of the law: (next amplitudes in rad, unsaturated; report).

    ``amplitudes`` rad and ``errors`` m/s have one value per beat; ``measured`` False = no speed;
    ``visits``: how many trials have corrected each beat before, 0 to 255 (default: none).
    """
    u, e = np.asarray(amplitudes, dtype=np.float32), np.asarray(errors, dtype=np.float32)
    call = LawCall(law, u, e, measured, visits)
    refused(lib.law_update(call.law, call.trial, call.amplitudes, call.scratch, call.report))
    return call.next_amplitudes(), call.law_report()


def judge(
    law: Law, amplitudes: ArrayLike, errors: ArrayLike, measured: ArrayLike | None = None
) -> LawReport:
    """Max|e|, RMS and saturation of a trial, without learning."""
    u, e = np.asarray(amplitudes, dtype=np.float32), np.asarray(errors, dtype=np.float32)
    call = LawCall(law, u, e, measured)
    refused(lib.law_judge(call.law, call.trial, call.amplitudes, call.report))
    return call.law_report()


def saturate(law: Law, amplitudes: ArrayLike) -> F32:
    """What the servo gets."""
    native = law.native(ffi)
    values = np.asarray(amplitudes, dtype=np.float32)
    return np.array([lib.law_saturate(native, float(u)) for u in values], dtype=np.float32)
