"""What explains an error: each cause planted in trials of a known fish, and none in a healthy one.

How often it is right on random fish is measured by ``make soak``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from scipy.signal import lfilter

from tailbeat.core.arrays import F64
from tailbeat.core.law import Law
from tailbeat.core.reference import Reference, thesis
from tailbeat.learning import diagnosis
from tailbeat.learning.belief import believe
from tailbeat.learning.departures import Departure, Kind, departures
from tailbeat.learning.diagnosis import Cause, Evidence, diagnose
from tailbeat.learning.error_bound import error_bound, suggest
from tailbeat.learning.fish_model import Conditions, FishModel, TrialSpeeds
from tailbeat.learning.identification import Identified
from tailbeat.learning.model_law import ModelStepSetting, propose_by
from tailbeat.learning.scatter import MOVES_S

MODEL = FishModel(10.0, 0.21, 0.2, 0.3)
KNOWN = Identified(
    MODEL, [MODEL], np.diag(np.square([0.03, 0.01, 0.003, 0.02, 0.02, 0.0002, 0.02, 0.1]))
)
MOST_RAD = 0.9
FEASIBLE = suggest(KNOWN, thesis(), MOST_RAD).reference
RNG_SEED = 22


def trials_of(
    reference: Reference, count: int = 3, limit_rad: float = MOST_RAD, noise_m_s: float = 0.0007
) -> list[TrialSpeeds]:
    """Of the model law's first input, with the scatter of a healthy fish."""
    setting = ModelStepSetting(reference, limit_rad)
    amplitude = propose_by(believe(KNOWN, []), setting, []).amplitude_rad
    rng = np.random.default_rng(RNG_SEED)
    found = []
    for number in range(1, count + 1):
        own = Conditions(0.002, rng.normal(0, 0.0005), rng.normal(1, 0.01))
        speed = MODEL.beats(amplitude, 1.0, own) + rng.normal(0, noise_m_s, reference.beats)
        sigma = np.full(reference.beats, 0.0007)
        found.append(TrialSpeeds(amplitude, speed, sigma, 1.0, reference.crc, number))
    return found


def shifted(trials: list[TrialSpeeds], speed_m_s: Sequence[F64 | float]) -> list[TrialSpeeds]:
    rows = zip(trials, speed_m_s, strict=True)
    return [replace(one, speed_m_s=one.speed_m_s + more) for one, more in rows]


def causes(
    trials: list[TrialSpeeds], reference: Reference = FEASIBLE, limit_rad: float = MOST_RAD,
    law: Law | None = None,
) -> list[Cause]:  # fmt: skip
    belief = believe(KNOWN, trials)
    found = diagnose(Evidence(reference, limit_rad, trials, belief, law, MOST_RAD))
    assert all(one.share_m_s >= 0.0015 and one.number and one.place and one.proposal
               for one in found)  # fmt: skip
    return [one.cause for one in found]


@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_a_healthy_fish_needs_nothing(count: int) -> None:
    assert causes(trials_of(FEASIBLE, count)) == []


def test_saturation() -> None:
    low_rad = 0.8 * float(trials_of(FEASIBLE)[0].amplitude_rad.max())
    trials = trials_of(FEASIBLE, 1, low_rad)
    assert causes(trials, limit_rad=low_rad) == [Cause.SATURATION]
    found = diagnose(Evidence(FEASIBLE, low_rad, trials, believe(KNOWN, trials), None, MOST_RAD))
    gained = error_bound(MODEL, FEASIBLE, low_rad).minimax_m_s
    assert found[0].share_m_s == pytest.approx(gained, rel=0.1)
    assert "at the limit" in found[0].text and found[0].place.startswith("beat")
    stays = Evidence(FEASIBLE, low_rad, trials, believe(KNOWN, trials), None, low_rad)
    assert Cause.SATURATION not in {one.cause for one in diagnose(stays)}, "no room to raise"


def test_a_reference_that_stops_too_fast() -> None:
    speed = FEASIBLE.speed_m_s.copy()
    speed[15:20] *= 0.2
    dips = Reference(1.0, speed, "dips")
    assert causes(trials_of(dips, 1), dips)[0] is Cause.INFEASIBLE


def test_beats_without_a_speed() -> None:
    trials = trials_of(FEASIBLE, 2)
    speed = trials[-1].speed_m_s.copy()
    speed[5:20] = np.nan
    assert Cause.MISSING in causes([trials[0], replace(trials[1], speed_m_s=speed)])


def test_what_does_not_come_again() -> None:
    assert causes(trials_of(FEASIBLE, 2, noise_m_s=0.005)) == [], "two may differ by chance"
    assert causes(trials_of(FEASIBLE, 3, noise_m_s=0.005)) == [Cause.DISTURBANCE]
    assert causes(shifted(trials_of(FEASIBLE, 5), [0.015, -0.02, 0.02, -0.018, 0.016])) == [
        Cause.DISTURBANCE
    ]


def test_the_input_to_repeat_is_the_best_without_the_disturbance() -> None:
    """A wave hides the error of a worse input in the second trial."""
    trials = trials_of(FEASIBLE, 3)
    weaker = 0.9 * trials[1].amplitude_rad
    lost = MODEL.beats(trials[1].amplitude_rad, 1.0) - MODEL.beats(weaker, 1.0)
    worse = replace(trials[1], amplitude_rad=weaker)  # as fast by chance
    rng = np.random.default_rng(RNG_SEED)
    waves = [rng.normal(0, 0.006, FEASIBLE.beats) for _ in range(2)]
    swum = [*shifted([trials[0], trials[2]], waves), worse]
    by_measured = [np.abs(FEASIBLE.speed_m_s - one.speed_m_s).max() for one in swum]
    assert np.argmin(by_measured) == 2 and lost.max() > 0.004
    found = diagnose(Evidence(FEASIBLE, MOST_RAD, swum, believe(KNOWN, swum)))
    repeated = {one.value for one in found if one.cause is Cause.DISTURBANCE}
    assert repeated and repeated != {swum[2].trial}


def test_what_comes_again_from_the_first_trial_on() -> None:
    wave = 0.005 * np.sin(np.arange(FEASIBLE.beats))
    assert causes(shifted(trials_of(FEASIBLE), [wave] * 3)) == [Cause.MISFIT]
    assert causes(shifted(trials_of(FEASIBLE), [0.015] * 3)) == [Cause.MISFIT]


def test_a_fish_that_changed() -> None:
    trials = shifted(trials_of(FEASIBLE, 4), [0.0, 0.0, -0.02, -0.02])
    found = diagnose(Evidence(FEASIBLE, MOST_RAD, trials, believe(KNOWN, trials)))
    assert [(one.cause, one.place) for one in found] == [(Cause.CHANGED, "since trial 3")]
    assert found[0].share_m_s == pytest.approx(0.02, rel=0.3) and found[0].number.startswith("-")


def waves(size_m_s: float, trials: int, seed: int) -> F64:
    fresh = np.random.default_rng(seed).normal(0, size_m_s, (trials, FEASIBLE.beats))
    found: F64 = lfilter([1.0], [1.0, -np.exp(-1 / MOVES_S)], fresh, axis=1)
    return found


@pytest.mark.parametrize("seed", range(3))
def test_moving_water_hides_no_change(seed: int) -> None:
    """Trials that differ little as a whole show a change that is no larger than the waves."""
    lost = np.repeat([0.0, 0.006], 3)[:, None]
    found = departures_of(shifted(trials_of(FEASIBLE, 6), list(waves(0.0014, 6, seed) - lost)))
    assert found["changed"].chance > 0.95 and found["changed"].since == 3


@pytest.mark.parametrize("seed", [4, 5])
def test_trials_that_all_differ_are_no_change(seed: int) -> None:
    """Though the last two are both slower than the first, which is likely by chance."""
    trials = trials_of(FEASIBLE)
    own = [Conditions(gain=gain) for gain in (1.05, 0.9, 0.94)]
    amplitude = trials[0].amplitude_rad
    gained = [MODEL.beats(amplitude, 1.0, one) - MODEL.beats(amplitude, 1.0) for one in own]
    trials = shifted(trials, list(waves(0.002, 3, seed) + gained))
    assert departures_of(trials)["changed"].chance > 0.7
    assert causes(trials) == [Cause.DISTURBANCE]


def test_one_spoilt_trial_is_no_change() -> None:
    assert causes(shifted(trials_of(FEASIBLE, 4), [0.0, -0.02, 0.0, 0.0])) == []


def test_a_gain_near_the_one_that_diverges() -> None:
    trials = trials_of(FEASIBLE, 1)
    slope = MODEL.steady_slope(np.array([FEASIBLE.speed_m_s.max()]))[0]
    assert causes(trials, law=Law(kp_rad_s_m=2 / slope)) == [Cause.GAIN]
    assert causes(trials, law=Law(kp_rad_s_m=0.4 / slope)) == []


def departures_of(trials: list[TrialSpeeds]) -> dict[Kind, Departure]:
    return departures(believe(KNOWN, []), trials, FEASIBLE.speed_m_s.astype(np.float64))


def test_thrust_lost_around_some_amplitudes_is_a_misfit() -> None:
    """As little as 3 mm/s."""
    trials = trials_of(FEASIBLE)
    near = (trials[0].amplitude_rad - 0.75 * trials[0].amplitude_rad.max()) / 0.08
    weaker = trials[0].amplitude_rad * (1 - 0.035 * np.exp(-(near**2)))
    lost = MODEL.beats(weaker, 1.0) - MODEL.beats(trials[0].amplitude_rad, 1.0)
    assert 0.002 < np.abs(lost).max() < 0.004
    found = departures_of(shifted(trials, [lost] * 3))
    assert found["misfit"].chance > 0.9
    assert found["misfit"].effect_m_s == pytest.approx(lost[np.argmax(np.abs(lost))], rel=0.4)
    assert found["changed"].chance < 0.1 and found["disturbed"].chance < 0.1


@pytest.mark.parametrize(("count", "named"), [(3, []), (4, [Cause.CHANGED]), (5, [])])
def test_a_change_must_be_surer_at_first_and_in_a_long_series(
    count: int, named: list[Cause], monkeypatch: pytest.MonkeyPatch
) -> None:
    none = {kind: Departure(kind, 0.0, 0.0, 0, 0) for kind in get_args(Kind)}
    halfway = none | {"changed": Departure("changed", 0.5, -0.02, 1, 0)}
    monkeypatch.setattr(diagnosis, "departures", lambda *_: halfway)
    assert causes(trials_of(FEASIBLE, count)) == named


def test_beats_without_a_speed_tell_nothing_of_departures() -> None:
    trials = trials_of(FEASIBLE, 4)
    speed = trials[1].speed_m_s.copy()
    speed[::2] = np.nan
    trials[1] = replace(trials[1], speed_m_s=speed)
    assert causes(trials) == []
    since = departures_of(shifted(trials, [0.0, 0.0, -0.01, -0.01]))["changed"]
    assert since.chance > 0.9 and since.since == 2 and since.effect_m_s < 0
