"""What ILC_EXTRAP does for beats that no trial has reached: many simulated fish whose trials are
all cut short, and then one that gets there. ``pytest -s -m soak -k beyond tests/host`` prints
the table of docs/explanation/safety.md."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.law import Law
from tailbeat.core.native import ffi, lib
from tailbeat.core.reference import thesis
from tailbeat.studies.montecarlo.batch import FishBatch

KEEP, HOLD, TAPER = range(3)
NAMES = ("keep", "hold", "taper")
LEAD = {"thesis": 0.0, "tank": 1.0}
ROLLBACK = 1.3
ROOM_M = 3.0 - 0.36  # of the thesis's tank for its fish
WANTED = np.asarray(thesis().speed_m_s, dtype=np.float32)
BEATS = len(WANTED)
LATE_BEATS = 2  # swum until the board knows a beat's speed, and stops for it
SEED = 7  # of the lengths

Array = F64
Counts = NDArray[np.int64]


class School:
    """Fish that learn with the board's memory, seeds 1, 2, ..."""

    def __init__(self, plant: str, gain: float, beyond: int, fish: int) -> None:
        law = Law(kp_rad_s_m=gain, lead_beats=LEAD[plant], amplitude_max_rad=math.pi / 4)
        self.law = ffi.new("law_t *", {**asdict(law), "step_max_rad": 0.0, "beat_s": 1.0})
        self.rules = ffi.new("memory_rules_t *", {"rollback_ratio": ROLLBACK, "beyond": beyond})
        self.batch = FishBatch(plant, [{"seed": seed} for seed in range(1, fish + 1)])
        self.memories = ffi.new("memory_t[]", fish)
        self.scratch = ffi.new("float[]", BEATS)
        self.trial = 0
        wanted = ffi.new("float[]", WANTED.tolist())
        for memory in self._each():
            lib.memory_begin(memory, 1, BEATS)
            assert lib.memory_first(memory, self.law, wanted, self.scratch) == 0

    def _each(self) -> list[Any]:
        return [self.memories + i for i in range(len(self.memories))]

    def visits(self) -> Counts:
        return np.array([list(memory.visits[0:BEATS]) for memory in self._each()])

    def execute(self) -> tuple[Array, Array]:
        """The next trial as if none were cut: speeds as measured and as they are."""
        self.trial += 1
        rows = np.array([list(memory.amplitude_rad[0:BEATS]) for memory in self._each()])
        trials = self.batch.run(np.clip(rows, 0, math.pi / 4), self.trial)
        return trials.speed_m_s, trials.true_m_s

    def learn(self, speed_m_s: Array, executed: Counts) -> None:
        report = ffi.new("memory_report_t *")
        for memory, speed, count in zip(self._each(), speed_m_s, executed, strict=True):
            measured = (np.arange(BEATS) < count) & np.isfinite(speed)
            error = np.where(measured, WANTED - speed, 0)
            arrays = {
                "error_m_s": ffi.new("float[]", error.tolist()),
                "measured": ffi.new("uint8_t[]", measured.tolist()),
            }
            recorded = ffi.new("law_trial_t *", {"beats": BEATS, **arrays})
            complete, rules = bool(count >= BEATS), self.rules
            result = lib.memory_learn(
                memory, self.law, recorded, self.trial, complete, rules, self.scratch, report
            )
            assert result == 0


@dataclass(frozen=True)
class Found:
    """Per fish. ``late_m_s``: max|e| over beats that no trial had corrected, in the first whole
    trial; NaN = there was none left. ``way_m``: what that trial covers."""

    late_m_s: Array
    way_m: Array


def cut_at_random(
    plant: str, gain: float, beyond: int, fish: int, spread: tuple[int, int], trials: int
) -> Found:
    """Lengths evenly from ``spread``, 40 or more = whole; the last trial is whole at any rate.
    Whole first trials do not count: there is nothing to fill yet."""
    school = School(plant, gain, beyond, fish)
    random = np.random.default_rng(SEED)
    late, way = np.full(fish, np.nan), np.full(fish, np.nan)
    for trial in range(1, trials + 1):
        executed = np.minimum(random.integers(spread[0], spread[1] + 1, fish), BEATS)
        if trial == trials:
            executed[:] = BEATS
        speed, true = school.execute()
        never = school.visits() == 0
        now = (executed == BEATS) & np.isnan(way) & (trial > 1)
        error = np.where(never, np.abs(WANTED - true), -1).max(axis=1)
        late[now] = np.where(error < 0, np.nan, error)[now]
        way[now] = true.sum(axis=1)[now]
        school.learn(speed, executed)
    return Found(late, way)


@dataclass(frozen=True)
class Through:
    """Per fish: trials until one was whole, the longest way of them, and by how much the fish was
    ever too fast."""

    trials: Counts
    way_m: Array
    too_fast_m_s: Array


def cut_by_errors(plant: str, gain: float, beyond: int, fish: int, limit_m_s: float) -> Through:
    """As ERR_MAX_M_S does it."""
    school = School(plant, gain, beyond, fish)
    trials = np.zeros(fish, dtype=np.int64)
    way, fast = np.zeros(fish), np.zeros(fish)
    while (trials == 0).any() and school.trial < 60:
        speed, true = school.execute()
        guilty = np.abs(WANTED - speed) > limit_m_s
        known = np.where(guilty.any(axis=1), guilty.argmax(axis=1) + 1 + LATE_BEATS, BEATS + 1)
        executed = np.minimum(known, BEATS)
        recorded = np.arange(BEATS) < executed[:, None]
        todo = trials == 0
        way = np.where(todo, np.maximum(way, np.where(recorded, true, 0).sum(axis=1)), way)
        over = np.where(recorded, true - WANTED, 0).max(axis=1)
        fast = np.where(todo, np.maximum(fast, over), fast)
        trials = np.where(todo & (known > BEATS), school.trial, trials)
        school.learn(speed, executed)
    assert trials.all()
    return Through(trials, way, fast)


@pytest.mark.parametrize("plant", ["thesis", "tank"])
def test_what_is_known_of_the_policies_holds_for_a_few_fish(plant: str) -> None:
    found = [cut_at_random(plant, 4, policy, 12, (10, 30), 9) for policy in range(3)]
    late = [float(np.median(one.late_m_s)) for one in found]
    print(NAMES, [f"{1e3 * one:.1f} mm/s" for one in late])
    assert late[TAPER] < 0.75 * late[KEEP] < 0.75 * late[HOLD]
    assert max(found[KEEP].way_m.max(), found[TAPER].way_m.max()) < ROOM_M < found[HOLD].way_m.max()


def test_a_taper_gets_through_the_error_limit_in_half_the_trials() -> None:
    keep, hold, taper = (cut_by_errors("tank", 4, policy, 8, 0.03) for policy in range(3))
    print([np.median(one.trials) for one in (keep, hold, taper)])
    assert np.median(taper.trials) < 0.7 * np.median(keep.trials)
    assert taper.too_fast_m_s.max() < 0.03 < hold.too_fast_m_s.min()
    assert max(keep.way_m.max(), taper.way_m.max()) < ROOM_M


@pytest.mark.soak
@pytest.mark.parametrize("gain", [4.0, 2.0])
@pytest.mark.parametrize("plant", ["thesis", "tank"])
def test_the_table(plant: str, gain: float) -> None:
    for policy, name in enumerate(NAMES):
        cells = [plant, f"{gain:g}", name]
        for spread, trials in (((10, 30), 9), ((20, 50), 10)):
            found = cut_at_random(plant, gain, policy, 200, spread, trials)
            middle, high = 1e3 * np.nanpercentile(found.late_m_s, [50, 90])
            out = 100 * np.mean(found.way_m > ROOM_M)
            cells.append(f"{middle:.0f}, {high:.0f} mm/s; {found.way_m.max():.2f} m, {out:.0f} %")
            assert policy == HOLD or out == 0
        through = cut_by_errors(plant, gain, policy, 200, 0.03)
        fast = 1e3 * float(np.median(through.too_fast_m_s))
        cells.append(f"{np.median(through.trials):.0f}; {through.way_m.max():.2f} m; {fast:.0f}")
        print("| " + " | ".join(cells) + " |")
