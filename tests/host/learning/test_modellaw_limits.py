"""The model law under the board's step limit and after a trial that was cut short."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tailbeat.core.law import Law
from tailbeat.core.reference import thesis
from tailbeat.learning.belief import believe
from tailbeat.learning.fish_model import FishModel, TrialSpeeds, last_input
from tailbeat.learning.identification import Identified
from tailbeat.learning.model_law import ModelStepSetting, Proposal, predicted_by, propose
from tailbeat.studies.montecarlo.batch import FishBatch

LIMIT_RAD = math.pi / 4
REFERENCE = thesis()


def known(kappa: float, slope: float = 0.219) -> Identified:
    model = FishModel(kappa, slope, 0.197, 0.3)
    sigma = [0.1, 0.02, 0.01, 0.05, 0.05, 0.0005, 0.02, 0.1]
    return Identified(model, [model], np.diag(np.square(sigma)))


def recorded(batch: FishBatch, proposal: Proposal, number: int) -> tuple[TrialSpeeds, float]:
    """One trial, and its true max|e|."""
    found = batch.run(proposal.amplitude_rad[None, :], number)
    error = np.abs(REFERENCE.speed_m_s - found.true_m_s[0]).max()
    trial = TrialSpeeds(
        proposal.amplitude_rad,
        found.speed_m_s[0],
        found.sigma_m_s[0],
        1.0,
        REFERENCE.crc,
        number,
    )
    return trial, float(error)


@pytest.mark.parametrize(("believed", "kappa"), [(5.0, 20.0), (6.0, 10.0)])
def test_a_step_limit_delays_and_does_not_prevent(believed: float, kappa: float) -> None:
    """Beats that were planned to rest have to push once the drag is known."""
    step = 0.15
    batch = FishBatch("tank", [{"seed": 1.0, "kappa_per_m": kappa}])
    trials: list[TrialSpeeds] = []
    errors = []
    for number in range(1, 6):
        proposal = propose(
            known(believed),
            ModelStepSetting(REFERENCE, LIMIT_RAD, step_max_rad=step, law=None),
            trials,
        )
        if trials:
            change = np.abs(proposal.amplitude_rad - trials[-1].amplitude_rad)
            assert change.max() <= step + 1e-9
        trial, error = recorded(batch, proposal, number)
        trials.append(trial)
        errors.append(error)
    floor = {20.0: 0.0072, 10.0: 0.0113}[kappa]
    assert min(errors[:1]) > 1.7 * floor
    assert max(errors[3:]) < 1.35 * floor


def test_only_what_the_step_limit_holds_is_counted() -> None:
    batch = FishBatch("tank", [{"seed": 2.0}])
    first, _ = recorded(batch, propose(known(10), ModelStepSetting(REFERENCE, LIMIT_RAD)), 1)
    for step in (0.15, 1.0, 100.0):
        assert (
            propose(
                known(10),
                ModelStepSetting(REFERENCE, LIMIT_RAD, step_max_rad=step, law=None),
                [first],
            ).limited_beats
            == 0
        )
    strong = known(10, slope=0.3)  # believes that less will do
    setting = ModelStepSetting(REFERENCE, LIMIT_RAD, step_max_rad=0.02)
    before, _ = recorded(batch, propose(strong, setting), 1)
    weak, _ = recorded(batch, propose(strong, setting, [before]), 2)  # one may have been spoilt
    held = propose(strong, setting, [before, weak])
    binds = np.isclose(np.abs(held.amplitude_rad - weak.amplitude_rad), 0.02)
    assert 10 < held.limited_beats <= np.count_nonzero(binds)


def cut(trial: TrialSpeeds, beats: int) -> TrialSpeeds:
    """As trial_speeds gives a trial that was stopped."""
    executed = np.arange(trial.beats) < beats
    return replace(
        trial,
        amplitude_rad=np.where(executed, trial.amplitude_rad, 0.0),
        speed_m_s=np.where(executed, trial.speed_m_s, np.nan),
        swum_beats=beats,
        trial=trial.trial + 1,
    )


def test_a_cut_trial_leaves_the_beats_behind_it_as_they_were() -> None:
    batch = FishBatch("tank", [{"seed": 3.0}])
    first, _ = recorded(batch, propose(known(10), ModelStepSetting(REFERENCE, LIMIT_RAD)), 1)
    stopped = cut(first, 20)
    assert last_input([first, stopped], 40).tolist() == first.amplitude_rad.tolist()
    assert np.isnan(last_input([stopped], 40)[20:]).all()
    for step in (0.0, 0.15):
        following = propose(
            known(10),
            ModelStepSetting(REFERENCE, LIMIT_RAD, step_max_rad=step, law=None),
            [first, stopped],
        )
        _, error = recorded(batch, following, 3)
        assert following.law == "model" and error < 0.015


def test_a_refuted_cut_trial_is_stepped_from_the_whole_input() -> None:
    """A P step from zeros would leave the fish at rest beyond the cut."""
    batch = FishBatch("tank", [{"seed": 4.0}])
    first, _ = recorded(batch, propose(known(10), ModelStepSetting(REFERENCE, LIMIT_RAD)), 1)
    nonsense = np.where(np.arange(40) % 7 < 3, 0.08, 0.0)
    stopped = cut(replace(first, speed_m_s=nonsense), 20)
    law = Law(kp_rad_s_m=4.0, lead_beats=1)
    whole = replace(first, speed_m_s=nonsense)
    following = propose(
        known(10), ModelStepSetting(REFERENCE, LIMIT_RAD, law=law), [whole, stopped]
    )
    assert following.law == "p"
    beyond = slice(21, 40)  # the lead reaches one beat back from the first unmeasured one
    assert following.amplitude_rad[beyond] == pytest.approx(np.float32(first.amplitude_rad[beyond]))


def test_a_cut_trial_is_never_the_best_input() -> None:
    """Only its ramp was executed, whose errors are small."""
    batch = FishBatch("tank", [{"seed": 6.0}])
    before = ModelStepSetting(REFERENCE, LIMIT_RAD)
    first, _ = recorded(batch, propose(known(10), before), 1)
    early = cut(first, 6)
    shaken = replace(first, speed_m_s=first.speed_m_s + 0.02 * np.sin(np.arange(40) * 2.1))
    least = [np.nanmax(np.abs(one.error_m_s(REFERENCE.speed_m_s))) for one in (early, first)]
    assert least[0] < least[1]
    following = propose(known(10), before, [first, early, shaken])
    assert following.law == "best"
    assert following.amplitude_rad.tolist() == first.amplitude_rad.tolist()
    assert propose(known(10), before, [early, replace(shaken, swum_beats=39)]).law == "p"


def test_what_was_foretold_is_of_the_beats_that_were_swum() -> None:
    """Cut before the end that nobody can follow: the error to expect is a small one."""
    batch = FishBatch("tank", [{"seed": 5.0}])
    first, _ = recorded(batch, propose(known(10), ModelStepSetting(REFERENCE, LIMIT_RAD)), 1)
    before = believe(known(10), [])
    whole = predicted_by(before, REFERENCE, [first])
    early = predicted_by(before, REFERENCE, [cut(first, 20)])
    assert whole is not None and early is not None
    assert whole[1] > 0.009 and early[1] < 0.6 * whole[1]
