"""The law for any number of beats of any length, against its formulas in double (ilc/law.h)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from hypothesis import given, settings
from hypothesis import strategies as st

from tailbeat.core.native import ffi, lib

Floats = npt.NDArray[Any]
HOLD, KEEP, HOLD_NEW, HOLD_OLD = range(4)
TRIALS = 8


@dataclass(frozen=True)
class Case:
    """A law and what it learns from; ``seed`` makes the numbers of the beats."""

    beats: int
    law: dict[str, Any]
    seed: int

    def numbers(self) -> tuple[Floats, Floats, npt.NDArray[np.bool_], npt.NDArray[np.uint8]]:
        """Amplitudes, errors, which are measured, visits; as the board has them, in float32."""
        random = np.random.default_rng(self.seed)
        amplitude = random.uniform(-0.2, 1.2, self.beats).astype(np.float32).astype(float)
        error = random.normal(0, 0.03, self.beats).astype(np.float32).astype(float)
        measured = random.random(self.beats) < random.choice([0.3, 0.9, 1.1])
        measured[random.integers(self.beats)] = True
        return amplitude, error, measured, random.integers(0, 12, self.beats, dtype=np.uint8)


@st.composite
def cases(draw: st.DrawFn) -> Case:
    beats = draw(st.one_of(st.integers(1, 8), st.integers(1, 512), st.just(512)))
    law = {
        "kp_rad_s_m": draw(st.integers(1, 800).map(lambda n: n / 16)),
        "kd_rad_s2_m": draw(st.sampled_from([0.0, 0.5, -3.0])),
        "amplitude_max_rad": draw(st.sampled_from([0.5, 0.75, 1.0])),
        "step_max_rad": draw(st.sampled_from([0.0, 0.0, 0.0625])),
        "beat_s": draw(st.integers(10, 200)) * 0.02,
        "lead_beats": draw(st.integers(0, min(2 * beats - 1, 32))) / 2,
        "fade": draw(st.sampled_from([0.0, 0.25, 2.0])),
        "fade_from": draw(st.integers(0, 8)),
        "q_len": draw(st.integers(1, min((beats + 1) // 2, 64))),
        "tail": draw(st.integers(0, 3)),
    }
    return Case(beats, law, draw(st.integers(0, 2**32 - 1)))


def as_float(values: Floats) -> Any:
    return ffi.new("float[]", values.tolist())


def native_law(case: Case) -> Any:
    return ffi.new("law_t *", {**case.law, "tail": ffi.cast("law_tail_t", case.law["tail"])})


def differences(error: Floats, measured: npt.NDArray[np.bool_], beat_s: float) -> Floats:
    """Forward; 0 at unmeasured beats; the last repeats the one before it."""
    if len(error) == 1:
        return np.zeros(1)
    known = measured[:-1] & measured[1:]
    inner = np.where(known, np.diff(error) / np.float32(beat_s), 0.0)
    return np.append(inner, inner[-1])


def correction(
    case: Case, error: Floats, measured: npt.NDArray[np.bool_], slope: Floats, k: int
) -> float | None:
    """kp e + kd de for beat |k|; None where the lead is past the last beat and nothing is held."""
    law, last = case.law, case.beats - 1
    place = k + law["lead_beats"]
    if place > last:
        if law["tail"] != HOLD:
            return None
        near = [last]
    else:
        near = [int(np.floor(place)), int(np.ceil(place))]
    seen = [error[j] for j in near if measured[j]]
    mean = float(np.mean(seen)) if seen else 0.0
    return float(law["kp_rad_s_m"] * mean + law["kd_rad_s2_m"] * np.mean(slope[near]))


def smoothed(values: Floats, q_len: int) -> Floats:
    """The triangle, divided by what of it lies inside."""
    weights = np.concatenate([np.arange(1, q_len + 1), np.arange(q_len - 1, 0, -1)]).astype(float)
    inside = np.convolve(np.ones_like(values), weights)[q_len - 1 : q_len - 1 + len(values)]
    return np.convolve(values, weights)[q_len - 1 : q_len - 1 + len(values)] / inside


def plain_update(case: Case) -> Floats:
    """All of (8.16), (7.10), (6.31) as the header says it."""
    law = case.law
    amplitude, error, measured, visits = case.numbers()
    old = np.clip(amplitude, 0.0, law["amplitude_max_rad"])
    fade = 1 + law["fade"] * np.maximum(0, visits.astype(int) - law["fade_from"])
    slope = differences(error, measured, law["beat_s"])
    new, tail = old.copy(), []
    for k in range(case.beats):
        moved = correction(case, error, measured, slope, k)
        if moved is None:
            tail.append(k)
        else:
            new[k] += moved / fade[k]
    if tail and tail[0] > 0 and law["tail"] in (HOLD_NEW, HOLD_OLD):
        new[tail] = (new if law["tail"] == HOLD_NEW else old)[tail[0] - 1]
    new = smoothed(new, law["q_len"])
    step = law["step_max_rad"]
    return np.clip(new, old - step, old + step) if step > 0 else new


@settings(max_examples=60, deadline=None, derandomize=True)
@given(cases())
def test_one_trial_teaches_what_the_formula_says(case: Case) -> None:
    amplitude, error, measured, visits = case.numbers()
    given_error = np.where(measured, error, np.nan)
    fields = {
        "beats": case.beats,
        "error_m_s": (errors := as_float(given_error)),
        "measured": (seen := ffi.new("uint8_t[]", measured.astype(int).tolist())),
        "visits": (visited := ffi.new("uint8_t[]", visits.tolist())),
    }
    found, report = as_float(amplitude), ffi.new("law_report_t *")
    scratch = ffi.new("float[]", case.beats)
    trial = ffi.new("law_trial_t *", fields)
    assert lib.law_update(native_law(case), trial, found, scratch, report) == lib.LAW_OK
    assert errors is not None and seen is not None and visited is not None  # alive until here
    largest = 1 + correction_scale(case).max()
    np.testing.assert_allclose(
        ffi.unpack(found, case.beats), plain_update(case), rtol=0, atol=4e-6 * largest
    )
    assert report.measured_beats == measured.sum()
    assert report.saturated_beats == (amplitude > case.law["amplitude_max_rad"]).sum()
    np.testing.assert_allclose(report.max_abs_error_m_s, np.abs(error[measured]).max(), rtol=1e-6)
    rms = np.sqrt(np.mean(error[measured] ** 2))
    np.testing.assert_allclose(report.rms_error_m_s, rms, rtol=1e-5)


def correction_scale(case: Case) -> Floats:
    """How large what is added can be: what float32 rounds grows with it."""
    _, error, measured, _ = case.numbers()
    slope = differences(error, measured, case.law["beat_s"])
    largest: Floats = np.abs(case.law["kp_rad_s_m"] * error)
    largest += np.abs(case.law["kd_rad_s2_m"] * slope)
    return largest


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.integers(1, 512), st.integers(1, 200), st.integers(0, 2**32 - 1))
def test_the_mean_of_all_trials_grows_as_its_definition(beats: int, gain: int, seed: int) -> None:
    """(2.10): the mean over all trials' inputs and errors, the errors with i + 2 times the gain."""
    random = np.random.default_rng(seed)
    law = ffi.new("law_t *", {"kp_rad_s_m": gain / 4, "amplitude_max_rad": 0.75, "beat_s": 0.2,
                              "q_len": 1})  # fmt: skip
    mean_rad, mean_error = ffi.new("float[]", beats), ffi.new("float[]", beats)
    inputs, errors = [], []
    for ended in range(1, TRIALS + 1):
        inputs.append(random.uniform(-0.2, 1.0, beats).astype(np.float32).astype(float))
        errors.append(random.normal(0, 0.03, beats).astype(np.float32).astype(float))
        given_error = as_float(errors[-1])
        trial = ffi.new("law_trial_t *", {"beats": beats, "error_m_s": given_error})
        now, before = lib.past_mean_now(ended), lib.past_mean_before(ended)
        total = ffi.new("float[]", beats)
        if ended > 1:
            means = ffi.new("law_trial_t *", {"beats": beats, "error_m_s": mean_error})
            past = ffi.new("law_weights_t *", before)
            assert lib.law_add(law, past, means, mean_rad, total) == lib.LAW_OK
        weights = ffi.new("law_weights_t *", now)
        recorded = as_float(inputs[-1])
        assert lib.law_add(law, weights, trial, recorded, total) == lib.LAW_OK
        lib.past_mean_add(law, ended, trial, recorded, mean_rad, mean_error)
        wanted = np.clip(inputs, 0, 0.75).mean(0) + (ended + 1) * gain / 4 * np.mean(errors, 0)
        # Each mean is rounded; the gain of the mean makes that larger.
        atol = 3e-6 + 2e-8 * (ended + 1) * gain
        np.testing.assert_allclose(ffi.unpack(total, beats), wanted, rtol=0, atol=atol)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.integers(2, 8), st.lists(st.floats(0.1, 3.0), min_size=24, max_size=24), st.data())
def test_a_window_that_fills_up_keeps_its_sum(
    window: int, values: list[float], data: st.DataObject
) -> None:
    """However few are there, the inputs weigh 1 in all, the errors what the whole window does."""
    parts = [dict(zip(("input", "kp", "kd"), values[3 * i : 3 * i + 3], strict=True))
             for i in range(window)]  # fmt: skip
    weights = ffi.new("law_weights_t[]", parts)
    present = data.draw(st.integers(1, window))
    found = [lib.past_window_weight(weights, window, present, i) for i in range(present)]
    sums = {name: sum(part[name] for part in parts) for name in ("input", "kp", "kd")}
    there = {name: sum(part[name] for part in parts[:present]) for name in sums}
    for part, weight in zip(parts, found, strict=False):
        np.testing.assert_allclose(weight.input, part["input"] / there["input"], rtol=1e-5)
        for name in ("kp", "kd"):
            wanted = part[name] * sums[name] / there[name]
            np.testing.assert_allclose(getattr(weight, name), wanted, rtol=1e-5)
