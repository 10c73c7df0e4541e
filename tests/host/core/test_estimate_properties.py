"""The estimate for 1 to 512 beats of 0.2 to 4 s: a speed known exactly, its means in double."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from hypothesis import given, settings
from hypothesis import strategies as st

from tailbeat.core.native import ffi, lib

Floats = npt.NDArray[Any]
SLOT_S = 0.1
VISION, IMU = 0, 2


@dataclass(frozen=True)
class Swim:
    """``frames`` of 20 ms make a beat; ``seed`` makes the speed."""

    beats: int
    frames: int
    seed: int

    @property
    def beat_s(self) -> float:
        return self.frames * 0.02

    @property
    def slots(self) -> int:
        """With all the time after the last beat that the estimate can take."""
        return int((self.beats + lib.NATIVE_SMOOTHER_AFTER) * self.beat_s / SLOT_S) + 60

    def wave(self, times_s: Floats) -> Floats:
        """Never the same twice in a row, never too fast for a fish, slower than a beat changes."""
        random = np.random.default_rng(self.seed)
        total = np.full_like(times_s, 0.05)
        for period_s in random.uniform(4, 20, 3):
            phase = random.uniform(0, 6)
            total += 0.012 * np.sin(6.283185307179586 * times_s / period_s + phase)
        return total

    def edges_s(self) -> Floats:
        return self.beat_s * np.arange(self.beats + 1)


trials = st.builds(
    Swim,
    st.one_of(st.integers(1, 40), st.integers(1, 512)),
    st.one_of(st.integers(10, 60), st.integers(10, 200)),
    st.integers(0, 2**32 - 1),
)


def means(times_s: Floats, speeds_m_s: Floats, edges_s: Floats) -> Floats:
    """Of the lines through the points (held beyond them) between the edges, exactly."""
    all_s = np.unique(np.concatenate([times_s, edges_s]))
    values = np.interp(all_s, times_s, speeds_m_s)
    way = np.concatenate([[0.0], np.cumsum(np.diff(all_s) * (values[1:] + values[:-1]) / 2)])
    return np.asarray(np.diff(np.interp(edges_s, all_s, way)) / np.diff(edges_s))


def estimated(
    trial: Swim,
    source: int,
    slots: list[dict[str, Any]],
    before: Any,
    after: Any,
    sigma_max_m_s: float = 1e6,
) -> tuple[list[Any], Floats, Floats]:
    """Provisional beats, final speeds, sigmas: as the board goes through a trial."""
    config = ffi.new("estimate_config_t *", {
        "source": ffi.cast("speed_source_t", source), "beat_s": trial.beat_s, "beats": trial.beats,
        "vision": {"window_s": 0.0, "gap_max_s": 0.5, "plausible_m_s": 0.5},
        "rest_sigma_m_s": 0.003, "rest_min_s": 5.0, "sigma_max_m_s": sigma_max_m_s,
        "model_sigma": 0.25,
    })  # fmt: skip
    speed, sigma = ffi.new("float[]", 512), ffi.new("float[]", 512)
    ring, estimate = ffi.new("speed_t *"), ffi.new("estimate_t *")
    lib.speed_init(ring)
    lib.estimate_begin(estimate, config, ffi.new("estimate_rest_t *", before), speed, sigma)
    early = []
    for slot in slots:
        assert lib.speed_restore_slot(ring, ffi.new("speed_slot_t *", slot))
        closed_s = np.float32(ring.next_close) * np.float32(SLOT_S)
        while (
            estimate.next < trial.beats + lib.NATIVE_SMOOTHER_AFTER
            and lib.estimate_needs_s(estimate) <= closed_s
        ):
            early.append(lib.estimate_beat(estimate, ring, 0.0))
    assert len(early) == trial.beats + lib.NATIVE_SMOOTHER_AFTER
    lib.estimate_after(estimate, trial.beats, ffi.new("estimate_rest_t *", after))
    while not lib.estimate_finish(estimate):
        pass
    final = [np.array(ffi.unpack(values, trial.beats)) for values in (speed, sigma)]
    return early[: trial.beats], final[0], final[1]


def camera_slots(trial: Swim, at_ms: npt.NDArray[np.int64], speeds: Floats) -> list[dict[str, Any]]:
    """One sample of 1 mm/s a slot, no IMU."""
    return [
        {"index": i, "samples": 1, "at_ms": int(ms), "speed_m_s": float(v), "sigma_10um_s": 100,
         "gain_10um_s": lib.NATIVE_SPEED_NO_MOTION}
        for i, (ms, v) in enumerate(zip(at_ms, speeds, strict=True))
    ]  # fmt: skip


@settings(max_examples=25, deadline=None, derandomize=True)
@given(trials)
def test_a_camera_alone_gives_the_mean_of_its_line_over_each_beat(trial: Swim) -> None:
    random = np.random.default_rng(trial.seed + 1)
    at_ms = random.integers(0, 100, trial.slots)
    times_s = SLOT_S * np.arange(trial.slots) + 1e-3 * at_ms
    speeds = trial.wave(times_s)
    slots = camera_slots(trial, at_ms, speeds)
    early, speed, sigma = estimated(trial, VISION, slots, {}, {})
    wanted = means(times_s, speeds, trial.edges_s())
    assert all(beat.measured for beat in early)
    np.testing.assert_allclose(speed, wanted, rtol=0, atol=1e-4)
    samples = np.array([beat.samples for beat in early])
    # 1 mm/s a sample: those of the slots that the beat touches, and one on either side.
    whole = trial.beat_s / SLOT_S
    assert np.all((samples >= whole - 1) & (samples <= whole + 4))
    np.testing.assert_allclose(sigma, 1e-3 / np.sqrt(samples), rtol=0.05)


def test_a_camera_that_freezes_at_the_end_leaves_the_last_of_512_beats_unmeasured() -> None:
    trial = Swim(512, 10, 1)
    speeds = trial.wave(SLOT_S * np.arange(trial.slots))
    speeds[1010:] = speeds[1010]
    slots = camera_slots(trial, np.full(trial.slots, 50), speeds)
    _, speed, _ = estimated(trial, VISION, slots, {}, {}, sigma_max_m_s=0.005)
    assert np.isfinite(speed[:500]).all()
    assert np.isnan(speed[510:]).all()


@settings(max_examples=25, deadline=None, derandomize=True)
@given(trials)
def test_an_exact_imu_between_two_rests_gives_each_beats_mean(trial: Swim) -> None:
    swum_s = trial.beats * trial.beat_s
    last = int(swum_s / SLOT_S)  # the slot in which the trial ends: from its begin on all is still
    speeds = np.zeros(trial.slots + 1)
    rise = np.clip(np.arange(last + 1) / 10, 0, 1) * np.clip(
        (last - np.arange(last + 1)) / 10, 0, 1
    )
    speeds[: last + 1] = rise * trial.wave(SLOT_S * np.arange(last + 1))
    gains = 2 * np.round(np.diff(speeds) / 2e-5).astype(int)  # even: half of it is whole, too
    gains[last - 1 if last > 0 else 0] -= gains[:last].sum()
    points = 1e-5 * np.concatenate([[0], np.cumsum(gains)])
    # A constant acceleration: the way beyond that of the first speed is gain * 0.1 s / 2.
    slots = [
        {"index": i, "gain_10um_s": int(g), "way_um": int(g) // 2} for i, g in enumerate(gains)
    ]
    still_s = lib.NATIVE_SMOOTHER_AFTER * trial.beat_s + 1.0
    after = {"begin_s": SLOT_S * last, "still_s": still_s}
    before = {"begin_s": -8.0, "still_s": 8.0}
    _, speed, _ = estimated(trial, IMU, slots, before, after)
    wanted = means(SLOT_S * np.arange(trial.slots + 1), points, trial.edges_s())
    np.testing.assert_allclose(speed, wanted, rtol=0, atol=1e-4)
