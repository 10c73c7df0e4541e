"""The speeds of a trial's beats, computed again from its file by the estimator the board runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tailbeat.core.arrays import F32
from tailbeat.core.errors import InputError
from tailbeat.core.native import ffi, lib
from tailbeat.core.speed_source import speed_source
from tailbeat.core.trial_file import SLOT_S, Rest, Trial

_BEAT_MIN_S, _BEAT_MAX_S = 0.1, 4.0


def recompute_beats(trial: Trial) -> tuple[F32, F32]:
    """(speed_m_s, sigma_m_s) per beat from the logged slots and rests; NaN where unmeasured.

    They equal the logged ones bit for bit, unless the speeds were uploaded (SPD_SOURCE 1): then
    there is nothing to compute and all are NaN.
    """
    return _Recompute(trial).run()


class NothingToRecompute(InputError):
    """The speeds of a trial did not come from its log, or the log was not written to its end."""


@dataclass(frozen=True)
class Recomputed:
    """``identical``: these are the logged ones, bit for bit."""

    speed_m_s: F32
    sigma_m_s: F32
    identical: bool


def recomputed(trial: Trial) -> Recomputed:
    """A trial's speeds computed again and compared. Raises NothingToRecompute."""
    if trial.uploaded or speed_source(trial.params).uploaded:
        raise NothingToRecompute("its speeds were uploaded", "They are what the file says.")
    if trial.executed_beats == 0 or trial.end_fault is None:
        raise NothingToRecompute("its log was not written to the end", "Pull it again.")
    speed, sigma = recompute_beats(trial)
    pairs = ((speed, trial.beats.speed_m_s), (sigma, trial.beats.sigma_m_s))
    # float32 numbers that are equal have equal bits, but for a zero's sign; NaN = not measured
    identical = all(np.array_equal(again, was, equal_nan=True) for again, was in pairs)
    return Recomputed(speed, sigma, identical)


class _Recompute:
    def __init__(self, trial: Trial) -> None:
        if not _BEAT_MIN_S <= trial.beat_s <= _BEAT_MAX_S:
            raise InputError(
                f"beats of {trial.beat_s} s are none a board swims", "Pull the trial again."
            )
        beats = lib.NATIVE_BEATS_MAX
        self._trial = trial
        self._count = len(trial.beats.speed_m_s)
        self._speed_m_s = ffi.new("float[]", [float("nan")] * beats)
        self._sigma_m_s = ffi.new("float[]", [float("nan")] * beats)
        self._slots = ffi.new("speed_t *")
        self._estimate = ffi.new("estimate_t *")
        lib.speed_init(self._slots)
        before = _rest(trial.rest_before)
        config = _config(trial)
        lib.estimate_begin(self._estimate, config, before, self._speed_m_s, self._sigma_m_s)

    def run(self) -> tuple[F32, F32]:
        """Slots in, beats as soon as their slots are there, then the way back."""
        recorded = min(self._count, self._trial.executed_beats)
        for slot in _slots(self._trial):
            self._take(slot["index"], slot, recorded)
        self._advance(self._slots.next_close, recorded)
        while self._estimate.next < recorded:
            end = int(lib.estimate_needs_s(self._estimate) / SLOT_S) + 2
            self._take(end, {"index": end, "gain_10um_s": lib.NATIVE_SPEED_NO_MOTION}, recorded)
        trusted = _trusted_beats(self._trial, recorded)
        lib.estimate_after(self._estimate, trusted, _rest(self._trial.rest_after))
        while not lib.estimate_finish(self._estimate):
            pass
        speed, sigma = (
            np.array(ffi.unpack(values, self._count), dtype=np.float32)
            for values in (self._speed_m_s, self._sigma_m_s)
        )
        return speed, sigma

    def _take(self, index: int, slot: dict[str, Any], recorded: int) -> None:
        """Beats that need no slot from |index| on are taken before it."""
        self._advance(index, recorded)
        lib.speed_restore_slot(self._slots, ffi.new("speed_slot_t *", slot))

    def _advance(self, closed: int, recorded: int) -> None:
        closed_s = np.float32(closed) * np.float32(SLOT_S)
        applied = self._trial.beats.applied_rad
        steps = recorded + lib.NATIVE_SMOOTHER_AFTER
        while self._estimate.next < steps:
            if lib.estimate_needs_s(self._estimate) > closed_s:
                return
            k = int(self._estimate.next)
            amplitude_rad = float(applied[k]) if k < recorded else 0.0
            lib.estimate_beat(self._estimate, self._slots, amplitude_rad)


def _slots(trial: Trial) -> list[dict[str, Any]]:
    s = trial.slots
    names = ("index", "samples", "at_ms", "speed_m_s", "sigma_10um_s", "gain_10um_s", "way_um")
    columns = [getattr(s, name).tolist() for name in names]
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def _rest(rest: Rest | None) -> Any:
    return ffi.new("estimate_rest_t *", vars(rest) if rest is not None else {})


def _trusted_beats(trial: Trial, recorded: int) -> int:
    guard_beats = lib.params_whole(_params(trial), lib.PARAM_GUARD_BEATS)
    return int(lib.stop_rules_trusted_beats(trial.end_fault or 0, recorded, guard_beats))


def _params(trial: Trial) -> Any:
    params = ffi.new("params_t *")
    lib.params_reset(params)
    for name, value in trial.params.items():
        param = lib.param_find(name.encode().ljust(lib.NATIVE_PARAM_NAME_BYTES, b"\0"))
        if param < lib.PARAM_COUNT:
            lib.params_set(params, param, value)
    return params


def _config(trial: Trial) -> Any:
    """The board's own way from parameters to the estimate's configuration."""
    config = ffi.new("estimate_config_t *")
    beats = len(trial.beats.speed_m_s)
    config[0] = lib.settings_estimate(_params(trial), trial.beat_s, beats)
    return config
