"""What is said of an amplitude limit that holds a trial back."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tailbeat.app.web.state import PageState, after
from tailbeat.board.fish import Fish
from tailbeat.core.reference import thesis, trapezoid
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.learning.assessment import progress_of
from tailbeat.learning.fish_model import FishModel, trial_speeds
from tailbeat.learning.identification import Identified
from tailbeat.learning.saturation import (
    KnownFish,
    at_limit,
    expected_saturation,
    known_fish,
    needed_rad,
    saturation_of,
)
from tailbeat.link.params import known_parameters
from tailbeat.session.events import Event
from tailbeat.session.status import assessed
from tailbeat.session.trial import run_trial

TANK = FishModel(10.0, 0.219, 0.197, 0.3)
TRIALS = 6
PARAMS = {name: known.default for name, known in known_parameters().items()}


def known(model: FishModel = TANK) -> KnownFish:
    covariance = np.diag([0.01, 1e-4, 1e-4, 1e-3])
    return KnownFish(
        Identified(model, [model], covariance, source="runs"), "by the identified model"
    )


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> list[Trial]:
    """Along the thesis's reference with the default limit."""
    folder = tmp_path_factory.mktemp("trials")
    with Fish.connect("sim:tank", seed=5) as fish:
        fish.upload_reference(thesis())
        for _ in range(TRIALS):
            fish.pull_trial(run_trial(fish).number, folder)
            fish.learn()
    return [read_trial(path) for path in sorted(folder.glob("*.ulg"))]


def test_the_need_by_the_model_and_by_the_trials_agree(series: list[Trial]) -> None:
    by_model = saturation_of(series[-1], known().identified, series)
    by_trials = saturation_of(series[-1], None, series)
    assert by_model is not None and by_model.needed_rad is not None
    assert by_trials is not None and by_trials.needed_rad is not None
    assert by_model.needed_rad == pytest.approx(needed_rad(known().identified, thesis()))
    assert by_trials.needed_rad == pytest.approx(by_model.needed_rad, abs=0.04)
    assert "by the identified model" in by_model.words
    assert "by a model fitted to 6 trials, extrapolated beyond the limit" in by_trials.words
    applied = series[-1].beats.applied_rad
    assert by_model.beats == by_trials.beats == np.count_nonzero(applied == np.float32(0.5)) > 15
    assert (by_model.trial_beats, by_model.limit_rad, by_model.expected) == (40, 0.5, False)


def test_what_to_do_is_a_command(series: list[Trial]) -> None:
    found = saturation_of(series[-1], known().identified, series)
    assert found is not None
    assert "If the fish's commissioning allows more" in found.action
    assert "tailbeat params set AMP_MAX_RAD 0.64. " in found.action
    assert found.action.endswith("tailbeat reference upload thesis:0.061,40 --warm-start board")
    stiff = replace(series[-1], params={**series[-1].params, "SERVO_MAX_US": 1500 + 0.5 * 572.9578})
    found = saturation_of(stiff, known().identified, series)
    assert found is not None and found.action.startswith("The servo turns 0.50 rad at most. Use a")


def test_another_reference_is_slowed_by_check_suggest() -> None:
    fast = trapezoid(0.09, 8, 10)
    found = expected_saturation(known(), fast, PARAMS)
    assert found is not None and "check reference.csv --suggest" in found.action
    assert "tailbeat session identify" not in found.action
    by_trials = KnownFish(replace(known().identified, source="trials"), "")
    found = expected_saturation(by_trials, fast, PARAMS)
    assert found is not None
    assert "tailbeat session identify, then tailbeat reference show" in found.action


@pytest.mark.parametrize("limit", [0.6, 0.7])
def test_overshooting_beats_are_no_saturation(series: list[Trial], limit: float) -> None:
    beats = replace(series[-1].beats, applied_rad=np.full(40, limit, np.float32))
    trial = replace(series[-1], beats=beats, params={**series[-1].params, "AMP_MAX_RAD": limit})
    assert saturation_of(trial, known().identified, series) is None
    assert expected_saturation(known(), thesis(), PARAMS | {"AMP_MAX_RAD": limit}) is None


def test_no_beat_at_the_limit_is_none(series: list[Trial]) -> None:
    assert saturation_of(series[0], known().identified, series) is None
    assert at_limit([0.1, math.nan, 0.499], 0.5) == 0


def test_beforehand(series: list[Trial]) -> None:
    found = expected_saturation(known(), thesis(), PARAMS)
    assert found is not None and found.expected and found.beats == 24
    assert found.text.startswith("saturation expected: 24 of 40 beats at the limit 0.50 rad; ")
    assert "--warm-start" not in found.action, "nothing was learned yet"
    one = known_fish(None, [trial_speeds(series[0])])
    assert one is not None and "fitted to 1 trial," in one.basis
    assert expected_saturation(one, thesis(), PARAMS) is not None
    assert known_fish(None, []) is None


def test_without_any_speed_the_need_is_not_known(series: list[Trial]) -> None:
    silent = replace(series[-1].beats, speed_m_s=np.full(40, np.nan, np.float32))
    trial = replace(series[-1], beats=silent)
    found = saturation_of(trial, None, [trial])
    assert found is not None and found.needed_rad is None
    assert found.words.endswith("how much the reference needs is not known")
    assert "tailbeat session identify" in found.action


def test_progress_says_so_instead_of_advising_a_falling_gain(series: list[Trial]) -> None:
    again = [*series, *(replace(series[-1], number=7 + k, iteration=7 + k) for k in range(4))]
    found = progress_of(again)
    saturation = found.verdict.saturation
    assert saturation is not None and found.fade is None
    assert found.verdict.stop and found.verdict.advice == saturation.action
    assert saturation.words in found.verdict.stop_reason


def test_the_page_shows_the_words(series: list[Trial]) -> None:
    verdict = progress_of(series).verdict
    assert verdict.saturation is not None

    class Listener:
        def __init__(self) -> None:
            self.now = PageState()

        def tell(self, event: Event) -> None:
            self.now = after(self.now, event, "12:00")

    page = Listener()
    page.tell(assessed(verdict))
    assert verdict.saturation.words in page.now.assessment
    assert "'Parameters' on this page" in page.now.assessment
    assert "--" not in page.now.assessment, "an option that no control of the page has"
