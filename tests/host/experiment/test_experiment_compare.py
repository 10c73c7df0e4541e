"""Comparing experiments, against published examples and against simulated draws."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import chi2

from tailbeat.core.errors import InputError
from tailbeat.experiment.analysis import Analysis, analyse
from tailbeat.experiment.compare import (
    _compared,
    _noncentrality,
    _unbiased,
    compare,
    count,
    counted,
    hedges,
    noncentral_t,
    other_differences,
    power,
    repeats_needed,
    welch,
)
from tailbeat.experiment.folder import Experiment

from .. import made_analyses as made
from ..swum_experiment import REPEAT, swim_experiment

# Rosetta Code, "Welch's t-test": samples and two-sided p
WELCH = [
    (
        [19.8, 20.4, 19.6, 17.8, 18.5, 18.9, 18.3, 18.9, 19.5, 22.0],
        [28.2, 26.6, 20.1, 23.3, 25.2, 22.1, 17.7, 27.6, 20.6, 13.7, 23.2, 17.5, 20.6, 18.0, 23.9,
         21.6, 24.3, 20.4, 24.0, 13.2],
        0.035972271029797,
    ),
    (
        [30.02, 29.99, 30.11, 29.97, 30.01, 29.99],
        [29.89, 29.93, 29.72, 29.98, 30.02, 29.98],
        0.090773324285671,
    ),
    ([3.0, 4.0, 1.0, 2.1], [490.2, 340.0, 433.9], 0.010751561149785),
]  # fmt: skip


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    return swim_experiment(tmp_path_factory.mktemp("compare"))


@pytest.fixture(scope="module")
def analysis(recorded: Experiment) -> Analysis:
    return analyse(recorded)


@pytest.mark.parametrize(("a", "b", "p"), WELCH)
def test_welch_as_published(a: list[float], b: list[float], p: float) -> None:
    difference, low, high, found = welch(a, b)
    assert found == pytest.approx(p, rel=1e-6)
    assert difference == pytest.approx(sum(b) / len(b) - sum(a) / len(a))
    assert low < difference < high
    assert (low <= 0 <= high) == (p > 0.05)


def test_power_as_in_cohens_table() -> None:
    """Cohen 1988, table 2.4.1: n per group for 80 %, two-sided 5 %; G*Power gives the same."""
    table = {0.2: 394, 0.5: 64, 0.8: 26, 1.0: 17, -0.5: 64}
    assert {g: repeats_needed(g) for g in table} == table
    assert repeats_needed(0.05) is None
    assert repeats_needed(math.inf) == 2
    assert repeats_needed(math.nan) is None
    assert power(0.5, 63) < 0.8 <= power(0.5, 64)


def test_the_correction_as_in_hedges_table() -> None:
    """Hedges 1981, table 1: c(m)."""
    for freedom, c in {2: 0.5642, 3: 0.7236, 4: 0.7979, 10: 0.9228, 50: 0.9849}.items():
        assert _unbiased(freedom) == pytest.approx(c, abs=6e-5)


@pytest.mark.parametrize("freedom", [2, 3, 9, 60, 1998])
def test_the_noncentral_t_distribution_is_its_integral(freedom: int) -> None:
    """Of P(Z <= limit * S - shift) over S, the root of chi-squared over its degrees of freedom."""
    s = np.linspace(0, 6, 400_001)[1:]
    log_density = chi2.logpdf(freedom * s**2, freedom) + np.log(2 * freedom * s)
    for limit in (-40.0, -9.0, -2.0, 0.0, 0.3, 2.0, 7.9, 8.1, 40.0):
        for shift in (-35.0, -3.0, 0.0, 1.0, 30.0):
            integral = np.trapezoid(np.exp(log_density) * ndtr(limit * s - shift), s)
            assert noncentral_t(limit, freedom, shift) == pytest.approx(integral, abs=1e-7)


def test_noncentrality_as_in_kelley() -> None:
    """MBESS (Kelley 2007), conf.limits.nct(t.value=2.83, df=126)."""
    assert _noncentrality(2.83, 126, 0.975) == pytest.approx(0.8337502, abs=1e-5)
    assert _noncentrality(2.83, 126, 0.025) == pytest.approx(4.815359, abs=1e-5)


@pytest.mark.parametrize(("sizes", "effect"), [((2, 3), 0.5), ((4, 5), -1.5), ((6, 6), 6.0)])
def test_the_interval_covers_the_true_effect(sizes: tuple[int, int], effect: float) -> None:
    """By draws of which the truth is known: 95 of 100 intervals hold it."""
    random = np.random.default_rng(7)
    inside = 0
    draws = 250
    for _ in range(draws):
        a, b = random.normal(0, 1, sizes[0]), random.normal(effect, 1, sizes[1])
        _, low, high = hedges(a.tolist(), b.tolist())
        inside += low <= effect <= high
    assert abs(inside / draws - 0.95) < 3.3 * math.sqrt(0.95 * 0.05 / draws)


def test_g_by_hand_with_the_sign_of_b_less_a() -> None:
    """Both sides scatter by 1 (n = 3), the means differ by 2: d = 2, times c(4) = 0.7979."""
    assert hedges([1, 2, 3], [3, 4, 5])[0] == pytest.approx(2 * 0.7979, abs=2e-4)
    g, low, high = hedges([3, 4, 5], [1, 2, 3])
    assert g == pytest.approx(-2 * 0.7979, abs=2e-4)
    assert low < -2 < high


def test_the_power_is_what_draws_show() -> None:
    from scipy.stats import ttest_ind

    random = np.random.default_rng(9)
    a, b = random.normal(0, 1, (5, 20000)), random.normal(1.2, 1, (5, 20000))
    seen = float(np.mean(ttest_ind(a, b).pvalue < 0.05))
    assert power(1.2, 5) == pytest.approx(seen, abs=0.015)


def test_what_does_not_scatter() -> None:
    same = _compared("max", [0.01, 0.01], [0.01, 0.01])
    assert (same.difference_m_s, same.p, same.g) == (0.0, 1.0, 0.0)
    less = _compared("max", [0.02, 0.02], [0.01, 0.01])
    assert less.g == -math.inf
    assert less.repeats == 2


def test_words_claim_no_more_than_the_interval() -> None:
    unclear = _compared("max", [0.010, 0.014, 0.012], [0.011, 0.013, 0.0125], ("old", "new"))
    assert unclear.difference_low_m_s < 0 < unclear.difference_high_m_s
    assert unclear.words.startswith(
        "no difference in max|e| is shown: new is 0.2 mm/s worse than old (95 %: 4.0 better to 4.3"
        " worse; 3 trials against 3); "
    )
    assert "trials on each side to see" in unclear.words
    clear = _compared("rms", [0.020, 0.021, 0.0205], [0.010, 0.011, 0.0105], ("old", "new"))
    assert clear.words == (
        "new is 10.0 mm/s better than old in RMS (95 %: 8.9 to 11.1 mm/s; 3 trials against 3)"
    )
    worse = _compared("max", [0.010, 0.011], [0.020, 0.021, 0.0205], ("old", "new"), (1, 0))
    assert worse.words.startswith("new is 10.0 mm/s worse than old in max|e| (95 %: ")
    assert worse.words.endswith("3 trials against 2, 0 and 1 of them worse than noise explains)")
    assert "no difference" not in clear.words


def test_discarded_and_cut_swims_never_count(analysis: Analysis) -> None:
    errors = {row.trial: row.max_abs_error_m_s for row in analysis.rows}
    assert counted(analysis, [3]) == [errors[4]]  # trial 3 of iteration 3 was discarded
    assert counted(analysis, [4]) == [errors[5], errors[6]]
    rows = [replace(r, complete=r.trial != REPEAT) for r in analysis.rows]
    assert counted(replace(analysis, rows=rows), [4]) == [errors[6]]


def test_by_default_the_repeats_of_the_best_then_what_came_after_progress(
    analysis: Analysis,
) -> None:
    errors = {row.trial: row.max_abs_error_m_s for row in analysis.rows}
    assert counted(analysis) == [errors[5], errors[6]]  # the last progress was in iteration 4
    third = replace(analysis.rows[-1], trial=7)
    more = replace(
        analysis, rows=[*analysis.rows, third], trials=[*analysis.trials, analysis.trials[-1]]
    )
    assert counted(more) == [errors[5], errors[6]]  # not the one that made it the best


def test_the_swim_that_made_an_input_the_best_does_not_count_among_its_repeats(
    analysis: Analysis,
) -> None:
    at = min(
        (n for n, row in enumerate(analysis.rows) if row.counts and row.complete),
        key=lambda n: analysis.rows[n].max_abs_error_m_s,
    )
    rows = [replace(analysis.rows[at], trial=number) for number in (21, 22)]
    trials = [replace(analysis.trials[at], number=number) for number in (21, 22)]
    more = replace(analysis, rows=[*analysis.rows, *rows], trials=[*analysis.trials, *trials])
    recorded = [row.trial for row in count(more).rows]
    assert analysis.rows[at].trial not in recorded
    assert {21, 22} <= set(recorded)


def test_swims_that_stand_out_since_progress_ended_count_and_are_told() -> None:
    """Worse than noise explains with amplitudes of their own, or rolled back; not the best's."""
    errors = [0.06, 0.02, 0.021, 0.04, 0.0205, 0.0215, 0.021]
    analysis = made.series(errors)
    rolled = [replace(row, rolled_back=row.trial == 6) for row in analysis.rows]
    found = count(replace(analysis, rows=rolled))
    assert [row.trial for row in found.rows] == [2, 3, 4, 5, 6, 7]
    assert found.worse == 2
    again = [replace(trial, beats=analysis.trials[1].beats) for trial in analysis.trials]
    slow = analysis.trials[3].beats.speed_m_s
    bad = replace(again[3], beats=replace(again[3].beats, speed_m_s=slow))
    trials = [*analysis.trials[:3], bad, *analysis.trials[4:]]
    assert count(replace(analysis, trials=trials)).worse == 0
    assert count(analysis, [4]).worse == 0
    both = compare(analysis, replace(analysis, rows=rolled))
    assert both.worse == (1, 2)


def test_only_swims_since_the_board_began_anew_count() -> None:
    analysis = made.series([0.06, 0.01, 0.011, 0.06, 0.03, 0.031])
    rows = [replace(row, epoch=int(row.trial > 3)) for row in analysis.rows]
    again = replace(analysis, rows=rows)
    assert [row.trial for row in count(again).rows] == [5, 6]
    assert count(again, [1, 2, 3]).rows == []


def test_too_few_and_another_reference_are_refused(analysis: Analysis) -> None:
    with pytest.raises(InputError, match=r"has 1 complete trial of iterations 3 .*1 more time"):
        compare(analysis, analysis, "max", [3])
    with pytest.raises(InputError, match=r"has 0 complete trials .*2 more times"):
        compare(analysis, analysis, "max", [77])
    with pytest.raises(InputError, match="different references"):
        compare(analysis, replace(analysis, reference_crc=1))
    with pytest.raises(InputError, match="max or rms"):
        compare(analysis, analysis, "mean")


def test_an_experiment_against_itself(analysis: Analysis) -> None:
    for what in ("max", "rms"):
        found = compare(analysis, analysis, what)
        assert found.a_m_s == found.b_m_s
        assert (found.difference_m_s, found.g, found.repeats) == (0.0, 0.0, None)
        assert found.p == pytest.approx(1.0)
        assert found.g_low == pytest.approx(-found.g_high)
    assert compare(analysis, analysis, "rms").a_m_s == tuple(
        row.rms_error_m_s for row in analysis.rows if row.trial in (5, 6)
    )


def test_what_else_differs_is_named(recorded: Experiment, tmp_path: Path) -> None:
    other = Experiment.at(tmp_path / "b", "carangi", "hill", "p4-lead1")
    other.write_settings({**recorded.settings(), "conditions": {"water_temperature_degc": 24.0}})
    assert other_differences(recorded, other) == ["water_temperature_degc 21.5 against 24"]
    assert other_differences(recorded, recorded) == []
