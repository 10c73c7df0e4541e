"""The verdict: its words, the noise it allows for, and how often it is wrong, by simulation."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import studentized_range, t

from tailbeat.core import reference
from tailbeat.core.arrays import F64
from tailbeat.core.trial_file import Beats, Slots, Trial
from tailbeat.learning import assessment, convergence
from tailbeat.learning.convergence import NoiseBand, Score, assess, assess_all, noise_band
from tailbeat.learning.fish_model import Conditions, FishModel
from tailbeat.learning.identification import Identified
from tailbeat.learning.scatter import Scatter

Array = F64

LIMIT_RAD = math.pi / 4
WANTED = reference.thesis().speed_m_s.astype(np.float64)
REST = float(WANTED.max())
# A near-optimal input of each fish, and median and p90 of max|e| of its repeats on the tank plant
# with all its noise (mm/s), as published for it.
PUBLISHED = {5: (18.3, 20.2), 10: (11.9, 13.9), 20: (7.7, 9.6)}


def scored(*mm: float, crcs: tuple[int, ...] = ()) -> list[Score]:
    names = crcs or tuple(range(1, len(mm) + 1))
    return [
        Score(at + 1, at + 1, crc, value / 1e3, True, np.array([value / 1e3], np.float32))
        for at, (value, crc) in enumerate(zip(mm, names, strict=True))
    ]


def fish(kappa: float) -> FishModel:
    return FishModel(kappa, 0.219, 0.197, 0.3)


def trial(model: FishModel, amplitude: Array, random: np.random.Generator) -> Array:
    """Errors of a trial that scatters as the tank plant does."""
    start, flow, gain = random.normal(size=3) * (0.002, 0.0015, 0.02)
    given = Conditions(abs(start), flow, 1 + gain)
    noise: Array = random.normal(0, 0.0006, len(amplitude))
    return WANTED - model.beats(amplitude, 1.0, given) - noise


def p_law(kappa: float, gain: float, trials: int, seed: int) -> tuple[Array, Array]:
    """(max|e| as measured, max|e| without noise) per trial of the P law with one beat's lead."""
    model, random = fish(kappa), np.random.default_rng(seed)
    ahead = np.minimum(np.arange(len(WANTED)) + 1, len(WANTED) - 1)
    amplitude = gain * WANTED[ahead]
    seen, true = np.empty(trials), np.empty(trials)
    for k in range(trials):
        applied = np.clip(amplitude, 0, LIMIT_RAD)
        error = trial(model, applied, random)
        seen[k] = np.abs(error).max()
        true[k] = np.abs(WANTED - model.beats(applied, 1.0)).max()
        amplitude = applied + gain * error[ahead]
    return seen, true


def good_input(kappa: float) -> Array:
    """What the P law without noise ends at."""
    model = fish(kappa)
    ahead = np.minimum(np.arange(len(WANTED)) + 1, len(WANTED) - 1)
    amplitude = np.zeros(len(WANTED))
    for _ in range(7):
        error = WANTED - model.beats(amplitude, 1.0)
        amplitude = np.clip(amplitude + 4 * error[ahead], 0, LIMIT_RAD)
    return amplitude


def test_words() -> None:
    kinds = {v.kind: v.words for v in assess_all(scored(67.7, 28.7, 15.9, 11.6, 12.7, 19.0))}
    assert kinds == {
        "first": "the first trial: 67.7 mm/s",
        "progress": "progress: 15.9 -> 11.6 mm/s",
        "noise": "within noise of the best "
        "(11.6 mm/s, repeats are expected to scatter by -27..+27 %)",
        "worse": "worse than noise explains: 19.0 mm/s "
        "(the best: 11.6 mm/s, repeats are expected to scatter by -27..+27 %)",
    }
    better = assess(scored(30, 12.0, 11.5))
    assert (better.kind, better.best_trial) == ("noise", 3)
    assert better.words.startswith("the best, but within noise of trial 2 (12.0 mm/s")


def test_a_rollback_names_whose_input_comes_back() -> None:
    scores = scored(30, 12, 17, 18)
    scores[-1] = replace(scores[-1], rolled_back=True)
    found = assess(scores)
    assert (found.kind, found.words) == ("rolled_back", "worse: rolled back to trial 2's input")
    assert found.best_max_abs_error_m_s == 0.012


def test_the_best_input_doing_badly_points_at_the_fish() -> None:
    found = assess(scored(30, 12, 22, crcs=(1, 2, 2)))
    assert found.kind == "worse"
    assert "with the best's own input; has the water, the battery" in found.words


def cut_short(error: Array, beats: int) -> Score:
    error = np.where(np.arange(len(error)) < beats, error, np.nan)
    worst = float(np.nanmax(np.abs(error)))
    return Score(9, 9, 9, worst, False, error_m_s=error.astype(np.float32))


def test_a_trial_cut_short_is_compared_on_the_beats_it_had() -> None:
    best = np.full(40, 0.012)
    best[:13] = 0.005
    whole = Score(1, 1, 1, 0.012, True, error_m_s=best.astype(np.float32))
    found = assess([whole, cut_short(np.full(40, -0.0041), 13)])
    assert found.kind == "incomplete"
    assert found.words == "incomplete: the first 13 beats 4.1 mm/s, the best had 5.0 there"
    assert (found.best_trial, found.stop) == (1, False)
    lonely = assess([cut_short(np.full(40, 0.004), 2)])
    assert (lonely.kind, lonely.best_trial) == ("incomplete", 0)
    nothing = Score(1, 1, 1, math.nan, False, error_m_s=np.full(4, np.nan, np.float32))
    assert assess([nothing]).words == "incomplete: no beat has a speed"


def test_a_band_from_repeats_by_the_formula() -> None:
    values = np.array([11.0, 12.5, 12.8, 10.9])
    expected = NoiseBand(0.8, 1.3, 0, 0.012)
    found = noise_band(scored(30, 14, *values, crcs=(1, 2, 3, 3, 3, 3)), expected)
    prior = 0.012 * 0.25 / t.ppf(0.975, 4)
    sigma = np.sqrt((4 * prior**2 + 3 * np.var(values * 1e-3, ddof=1)) / 7)
    half = t.ppf(0.975, 7) * sigma
    assert found.repeats == 4
    assert (found.high - found.low) * found.level_m_s == pytest.approx(2 * half, rel=1e-9)
    assert (found.high - 1) / (1 - found.low) == pytest.approx(0.3 / 0.2, rel=1e-9)


def test_two_of_an_input_are_not_repeats_enough() -> None:
    expected = NoiseBand(0.8, 1.3, 0, 0.012)
    assert noise_band(scored(12, 18, crcs=(1, 1)), expected) == expected
    assert noise_band([], expected) == expected
    assert noise_band(scored(12)).repeats == 0


@pytest.mark.parametrize("repeats", [3, 4, 5])
@pytest.mark.parametrize("sigma_mm", [1.0, 1.55, 2.2])
def test_the_band_of_few_repeats_covers_the_next(repeats: int, sigma_mm: float) -> None:
    """Also when what is expected is wrong by a factor of 1.5."""
    random = np.random.default_rng(repeats)
    inside = 0
    for _ in range(300):
        mm = 12 + sigma_mm * random.normal(size=repeats)
        band = noise_band(scored(*mm, crcs=(1,) * repeats))
        down, up = band.widths(math.nan)
        inside += -down <= sigma_mm * random.normal() / 1e3 <= up
    assert 0.88 <= inside / 300 <= 1.0


@pytest.mark.parametrize("kappa", [5, 10, 20])
def test_the_default_band_fits_the_published_scatter(kappa: float) -> None:
    """p90 over median is 1.28 sigma, the band 1.96."""
    median, p90 = PUBLISHED[int(kappa)]
    high = convergence.default_band(median / 1e3).high
    assert high - 1 == pytest.approx((p90 / median - 1) * 1.96 / 1.2816, rel=0.15)


def euler(kappa: float, amplitude: Array, draws: Array, noise: Array) -> Array:
    """max|e| of repeats, by small steps of the model's equation."""
    dt, per_beat = 0.01, 100
    start, flow, gain = np.abs(draws[:, 0]) * 0.002, draws[:, 1] * 0.0015, 1 + draws[:, 2] * 0.02
    steady = 0.219 * np.maximum(amplitude - 0.197, 0)
    v, mean = start.copy(), np.zeros((len(draws), len(amplitude)))
    for step in range(len(amplitude) * per_beat):
        beat = (step * dt - 0.3) // 1
        thrust = (gain * steady[int(beat)]) ** 2 if beat >= 0 else 0.0
        before = v
        v = v + dt * kappa * (thrust - v * np.abs(v))
        mean[:, step // per_beat] += (before + v) / 2 / per_beat
    worst: Array = np.abs(WANTED - mean - flow[:, None] - noise).max(axis=1)
    return worst


@pytest.mark.parametrize("kappa", [5, 10, 20])
def test_the_expected_band_is_that_of_simulated_repeats(kappa: float) -> None:
    amplitude = good_input(kappa)
    model = fish(kappa)
    scatter = Scatter(gain=0.02, flow_m_s=0.0015, start_m_s=0.002)
    known = Identified(model, [model], np.eye(4), scatter=scatter)
    band = convergence.expected_band(known, reference.thesis(), amplitude)
    assert band == convergence.expected_band(known, reference.thesis(), amplitude)
    random = np.random.default_rng(7)
    noise = random.normal(0, 0.001, (2000, len(amplitude)))
    worst = euler(kappa, amplitude, random.normal(size=(2000, 3)), noise)
    assert band.level_m_s == pytest.approx(np.median(worst), rel=0.03)
    low, high = np.percentile(worst, [2.5, 97.5]) / np.median(worst)
    assert band.low == pytest.approx(low, abs=0.04)
    assert band.high == pytest.approx(high, abs=0.04)
    assert band.repeats == 0


@pytest.mark.parametrize("what", ["gain", "flow_m_s", "start_m_s"])
def test_all_that_scatters_widens_the_expected_band(what: str) -> None:
    """The input is too weak throughout, so that gain and flow shift all errors alike."""
    model, amplitude = fish(10), 0.75 * good_input(10)
    amplitude[0] = 0.0  # the start speed is all there is
    none = Scatter(gain=0, flow_m_s=0, start_m_s=0)
    wanted = reference.thesis()
    if what == "start_m_s":
        wanted = replace(wanted, speed_m_s=np.zeros(40, np.float32))
        amplitude = np.zeros(40)
    bands = [
        convergence.expected_band(
            Identified(model, [model], np.eye(4), scatter=s), wanted, amplitude
        )
        for s in (none, replace(none, **{what: 0.02}))
    ]
    quiet, loud = (band.high - band.low for band in bands)
    assert loud > quiet + 0.02


def test_the_table_of_ranges_is_the_studentized_range() -> None:
    for at, value in enumerate(convergence._RANGE_SIGMAS):
        if at in (0, 3, 8, 18):
            assert value == pytest.approx(studentized_range.ppf(0.95, at + 2, 1e6), abs=0.01)


@pytest.mark.parametrize("kappa", [5, 10, 20])
def test_repeats_of_one_input_are_taken_for_noise(kappa: float) -> None:
    """Each trial by 95 %, within what 150 series tell."""
    model, amplitude, runs = fish(kappa), good_input(kappa), 150
    random = np.random.default_rng(11)
    kinds: list[str] = []
    for _ in range(runs):
        worst = [np.abs(trial(model, amplitude, random)).max() for _ in range(10)]
        kinds += [v.kind for v in assess_all(scored(*np.array(worst) * 1e3))[1:]]
    assert kinds.count("worse") / len(kinds) <= 0.06
    assert kinds.count("progress") / len(kinds) <= 0.06


@pytest.mark.parametrize(("kappa", "gain"), [(5, 4.0), (10, 4.0), (20, 4.0), (10, 2.0)])
def test_stops_when_learned_and_not_before(kappa: float, gain: float) -> None:
    """Without a known floor. Learned: max|e| without noise within 10 % of the series' smallest."""
    runs, trials = 60, 20
    early = late = 0
    for seed in range(runs):
        seen, true = p_law(kappa, gain, trials, seed)
        scores = scored(*seen * 1e3)
        ends = range(1, trials + 1)
        stop = next((n for n in ends if assess(scores[:n], rest_m_s=REST).stop), trials + 9)
        learned = 1 + int(np.flatnonzero(true <= 1.1 * true.min())[0])
        early += bool(true[:stop].min() - true.min() > convergence.SCATTER_M_S)
        late += stop > learned + 4
    assert early / runs <= 0.05
    assert late / runs <= 0.10


def test_the_reasons_to_stop_and_what_to_do() -> None:
    settled = assess(scored(30, 12, 12.5, 11.8, 12.4))
    assert settled.stop_reason == "the last 3 trials brought no progress beyond noise"
    assert settled.advice.startswith(
        "repeat the best twice to be sure: tailbeat trial learn --restore-best, trial run, "
        "trial discard --repeat"
    )
    fallen = assess(scored(30, 12, 12.5, 11.8, 22))
    assert fallen.words.startswith("worse than noise explains")
    assert fallen.stop_reason == "the last 3 trials brought nothing better, and this one is worse"
    growing = assess(scored(30, 12, 20, 25, 30))
    assert growing.stop_reason.startswith("the last 3 trials are worse than noise explains")
    near = assess(scored(60, 12.6, 12.3), floor_m_s=0.0113)
    assert (
        near.stop_reason
        == "the last 2 trials are within noise of the error of the L2-optimal input (11.3 mm/s)"
    )
    assert not assess(scored(60, 12.6, 12.3), floor_m_s=0.005).stop
    sure = assess(scored(30, 12, 12.5, 12.8, 12.4, crcs=(1, 2, 3, 2, 2)))
    assert sure.advice.startswith("done: trial 2's input was executed 3 times, repeats scatter by")


def test_a_series_is_not_ended_before_it_begins() -> None:
    stuck = scored(79.1, 79.0, 79.1, 79.0, 79.1)
    assert assess(stuck).stop
    assert not assess(stuck, rest_m_s=REST).stop
    assert not any(assess(scored(60, 30, 15, 12)[:n]).stop for n in (1, 2, 3, 4))
    assert assess(scored(30, 12, 18.2, 12.2, 12.8, 11.8)).stop  # back at the level
    sinking = scored(30, 28.5, 27, 25.5, 24, 22.5)
    assert not any(v.stop for v in assess_all(sinking))


def test_each_verdict_has_the_band_of_the_best_until_then() -> None:
    scores = scored(30, 20, 12, 13)
    bands = {score.trial: NoiseBand(0.9, 1.0 + score.trial / 10, 0) for score in scores}
    asked: list[int] = []

    def expected(score: Score) -> NoiseBand:
        asked.append(score.trial)
        return bands[score.trial]

    found = assess_all(scores, expected)
    assert [v.band.high for v in found] == [1.1, 1.2, 1.3, 1.3]
    assert asked == [1, 2, 3]


def test_input_crc_names_amplitudes() -> None:
    one = np.array([0.1, 0.2], np.float32)
    assert convergence.input_crc(one) == convergence.input_crc(one.astype(np.float64))
    assert convergence.input_crc(one) != convergence.input_crc(one[::-1])


def trial_of(number: int, amplitude: Array, error: Array, executed: int | None = None) -> Trial:
    beats = len(error)
    recorded = beats if executed is None else executed
    reached = np.arange(beats) < recorded
    full = np.full(beats, 0.05)
    columns = Beats(
        amplitude_rad=amplitude.astype(np.float32),
        applied_rad=np.where(reached, np.clip(amplitude, 0, 0.5), np.nan).astype(np.float32),
        reference_m_s=full.astype(np.float32),
        speed_m_s=np.where(reached, full - error, np.nan).astype(np.float32),
        sigma_m_s=full.astype(np.float32),
        samples=reached.astype(np.uint16),
    )
    none = Slots(*(np.zeros(0, kind) for kind in ("u2", "u1", "u1", "f4", "u2", "i2", "i2", "i2")))
    return Trial(
        number=number, iteration=number, reference_crc=7, beat_s=1.0, start_us=0, board="fish",
        build_id="", unique_id="00", end_fault=3 * (recorded != beats), executed_beats=recorded,
        end="complete", uploaded=False, params={"AMP_MAX_RAD": 0.5, "ROLLBACK_RATIO": 1.3},
        slots=none, rest_before=None, rest_after=None, beats=columns, battery_v=[],
    )  # fmt: skip


def test_scores_of_trials() -> None:
    wild = np.linspace(-0.1, 0.9, 10)
    whole = convergence.score_of(trial_of(3, wild, np.linspace(-0.02, 0.01, 10)))
    again = convergence.score_of(trial_of(4, np.clip(wild, 0, 0.5), np.zeros(10)))
    short = convergence.score_of(trial_of(5, wild, np.full(10, 0.003), executed=4))
    assert whole.max_abs_error_m_s == pytest.approx(0.02, abs=1e-6)
    assert whole.judged
    assert whole.input_crc == again.input_crc == short.input_crc  # as swum
    assert not short.judged
    assert short.error_m_s is not None
    np.testing.assert_array_equal(np.isfinite(short.error_m_s), np.arange(10) < 4)


def test_visits_count_what_each_beat_was_swum() -> None:
    wild, error = np.full(6, 0.3), np.zeros(6)
    hole = error.copy()
    hole[1] = np.nan
    trials = [trial_of(1, wild, error), trial_of(2, wild, error, 4), trial_of(3, wild, hole)]
    np.testing.assert_array_equal(assessment.visits(trials), [3, 2, 3, 3, 2, 2])
    stopped = replace(trial_of(4, wild, error), executed_beats=2)  # coasted on, and was seen
    np.testing.assert_array_equal(assessment.visits([stopped]), [1, 1, 0, 0, 0, 0])
    assert len(assessment.visits([])) == 0


def test_a_rollback_is_seen_in_the_files() -> None:
    from tailbeat.learning.assessment import progress_of, scores_of

    inputs = [0.1, 0.2, 0.3, 0.4, 0.2, 0.25]
    worst = [0.03, 0.012, 0.017, 0.018, 0.0121, 0.0119]
    trials = [
        trial_of(at + 1, np.full(8, u), np.full(8, e))
        for at, (u, e) in enumerate(zip(inputs, worst, strict=True))
    ]
    marks = [score.rolled_back for score in scores_of(trials)]
    assert marks == [False, False, False, True, False, False]
    by_hand = [trials[1], trial_of(9, np.full(8, 0.3), np.full(8, 0.013)), trials[4]]
    assert not any(score.rolled_back for score in scores_of(by_hand))
    found = progress_of(trials)
    assert [row.verdict for row in found.rows][3] == "rolled_back"
    assert [row.repeat_of for row in found.rows] == [0, 0, 0, 0, 2, 0]
    best = min(worst)
    assert found.verdict.best_max_abs_error_m_s == pytest.approx(best, abs=1e-6)
    assert all(a <= b for a, b in pairwise(np.sort(found.visits)))
