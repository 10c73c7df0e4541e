"""Learning with the model: how fast, how it fails, and that every decision can be made again."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.app.cli._terminal import Output
from tailbeat.app.cli.learn import learn_with_model
from tailbeat.board.fish import Fish, board_reference, rest
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.files import plain
from tailbeat.core.law import Law
from tailbeat.core.law_memory import first_amplitudes
from tailbeat.core.reference import Reference, cosine, thesis, trapezoid
from tailbeat.experiment.library import TrialLibrary
from tailbeat.learning.belief import Beliefs, believe
from tailbeat.learning.fish_model import Conditions, FishModel, TrialSpeeds
from tailbeat.learning.fit import Prior
from tailbeat.learning.identification import Identified
from tailbeat.learning.model_law import (
    ModelStepSetting,
    Proposal,
    document_of,
    predicted_by,
    propose,
    propose_by,
    repropose,
)
from tailbeat.session.next_input import (
    ModelStep,
    choose_next_input,
    numbering_restarted,
    trials_since,
)
from tailbeat.session.trial import run_trial
from tailbeat.studies.montecarlo.batch import FishBatch

Array = F64

AMPLITUDE_MAX_RAD = math.pi / 4
SEEDS = range(1, 7)
TRUE = FishModel(10.0, 0.219, 0.197, 0.3)
LSQ_M_S = {5: 0.0172, 10: 0.0113, 20: 0.0072}


SHAPE_SIGMA = (0.05, 0.0005, 0.02, 0.1)


def known(model: FishModel, sigma: Sequence[float] = (0.1, 0.02, 0.01, 0.05)) -> Identified:
    """As if identified."""
    sigma = (*sigma, *SHAPE_SIGMA)
    return Identified(model, [model], np.diag(np.square(sigma)))


class Tank:
    """One simulated fish; remembers its trials."""

    def __init__(self, seed: int, **settings: float) -> None:
        self.batch = FishBatch("tank", [{"seed": float(seed), **settings}])
        self.trials: list[TrialSpeeds] = []
        self.flow_m_s = 0.0

    def trial(self, amplitude: Array, reference: Reference) -> float:
        """True max|e|, m/s."""
        number = len(self.trials) + 1
        recorded = self.batch.run(amplitude[None, :], number, reference.beat_s)
        self.trials.append(
            TrialSpeeds(
                amplitude_rad=amplitude,
                speed_m_s=recorded.speed_m_s[0] + self.flow_m_s,
                sigma_m_s=recorded.sigma_m_s[0],
                beat_s=reference.beat_s,
                reference_crc=reference.crc,
                trial=number,
            )
        )
        true = recorded.true_m_s[0] + self.flow_m_s
        return float(np.abs(reference.speed_m_s - true).max())

    def learn(self, identified: Identified, reference: Reference, count: int) -> list[float]:
        return [
            self.trial(
                propose(
                    identified, ModelStepSetting(reference, AMPLITUDE_MAX_RAD), self.trials
                ).amplitude_rad,
                reference,
            )
            for _ in range(count)
        ]


def medians(identified: Identified, count: int, **settings: float) -> Array:
    rows = [Tank(seed, **settings).learn(identified, thesis(), count) for seed in SEEDS]
    return np.asarray(np.median(rows, axis=0))


@pytest.mark.parametrize("kappa", [5, 10, 20])
def test_right_model_is_at_the_floor_at_once_and_stays(kappa: int) -> None:
    found = medians(known(replace(TRUE, kappa_per_m=kappa)), 2, kappa_per_m=kappa)
    assert np.all(found <= 1.1 * LSQ_M_S[kappa]), found


@pytest.mark.parametrize(
    ("kappa", "factor", "delay_s", "slope", "dead"),
    [
        (5, 0.6, 0.5, 0.85, 1.3),
        (10, 1.4, 0.5, 1.15, 0.7),
        (20, 1.4, 0.1, 0.85, 1.3),
        (20, 0.6, 0.1, 1.15, 0.7),
    ],
)
def test_second_swim_is_at_the_floor_though_another_fish_was_identified(
    kappa: int, factor: float, delay_s: float, slope: float, dead: float
) -> None:
    wrong = FishModel(factor * kappa, slope * 0.219, dead * 0.197, delay_s)
    sure = known(wrong, (0.05, 0.01, 0.005, 0.02))
    found = medians(sure, 2, kappa_per_m=kappa)
    assert found[0] > 1.4 * LSQ_M_S[kappa], "the corner is none"
    assert found[1] <= 1.1 * LSQ_M_S[kappa], found


def test_map_of_another_form_and_a_slow_servo_do_not_stop_it() -> None:
    found = medians(known(TRUE), 2, map_bend_m_s_rad2=0.3, servo_lag_s=0.12)
    assert found[0] > 1.2 * LSQ_M_S[10]
    assert found[1] <= 1.1 * LSQ_M_S[10], found


def test_poor_camera_does_not_stop_it() -> None:
    found = medians(known(TRUE), 3, camera_noise_m=0.005, camera_lost=0.1)
    assert found[2] <= 1.15 * LSQ_M_S[10], found


@pytest.mark.parametrize("other", [cosine(0.09, 10, 12), trapezoid(0.05, 6, 20)])
def test_another_reference_begins_where_the_first_one_ended(other: Reference) -> None:
    wrong = known(FishModel(14.0, 0.252, 0.138, 0.5))
    carried, cold = [], []
    for seed in SEEDS[:4]:
        tank = Tank(seed)
        tank.learn(wrong, thesis(), 2)
        carried += tank.learn(wrong, other, 1)
        cold.append(Tank(seed).trial(_first_of_p(other), other))
    assert np.median(carried) <= 0.25 * np.median(cold)


def _first_of_p(reference: Reference) -> Array:
    first = first_amplitudes(Law(lead_beats=1), reference.speed_m_s).astype(np.float64)
    return np.clip(first, 0, AMPLITUDE_MAX_RAD)


def test_flow_that_repeats_is_learned_also_for_another_reference() -> None:
    identified, tank = known(TRUE), Tank(1)
    tank.flow_m_s = 0.006
    slow = cosine(0.05, 8, 10)
    tank.learn(identified, slow, 2)
    assert believe(identified, tank.trials).typical.flow_m_s > 0.002
    tank.flow_m_s = 0.0
    still = Tank(1)
    still.learn(identified, slow, 2)
    assert abs(believe(identified, still.trials).typical.flow_m_s) < 0.001


def test_fish_that_changes_is_named_and_learned_at_once() -> None:
    identified, tank, changed = known(TRUE), Tank(1), Tank(1, slope_m_s_rad=0.219 * 0.6)
    setting = ModelStepSetting(thesis(), AMPLITUDE_MAX_RAD)
    tank.learn(identified, thesis(), 2)
    trials, reasons = list(tank.trials), []
    error = math.nan
    for _ in range(4):
        proposal = propose(identified, setting, trials)
        reasons.append(proposal.reason)
        assert proposal.law == "model"
        error = changed.trial(proposal.amplitude_rad, thesis())
        trials.append(replace(changed.trials[-1], trial=len(trials) + 1))
    assert error <= 1.25 * LSQ_M_S[10]
    belief = believe(identified, trials)
    now = belief.model.steady_m_s(0.6) * math.exp(belief.level()[0])
    assert now == pytest.approx(0.6 * TRUE.steady_m_s(0.6), rel=0.08)
    assert any("since trial 3" in reason for reason in reasons), reasons


def test_refuted_goes_back_to_the_best_input_or_takes_a_step_of_p() -> None:
    wanted = thesis()
    good = _as_modelled(TRUE, 0.3 + 0.1 * np.sin(np.arange(40)), wanted)
    nonsense = np.where(np.arange(40) % 7 < 3, 0.08, 0.0)
    odd = replace(good, speed_m_s=nonsense, trial=2, amplitude_rad=good.amplitude_rad + 0.05)
    odd.speed_m_s[7] = np.nan
    setting = ModelStepSetting(wanted, 0.5, law=Law(kp_rad_s_m=3.0, lead_beats=1))
    found = propose(known(TRUE), setting, [good, odd])
    assert found.law == "best" and found.chance < 1e-3
    assert np.array_equal(found.amplitude_rad, good.amplitude_rad)
    alone = propose(known(TRUE), setting, [odd])
    assert alone.law == "p"
    error = np.r_[(wanted.speed_m_s - odd.speed_m_s)[1:], np.nan]
    expected = np.clip(odd.amplitude_rad + 3.0 * error, 0, 0.5)
    seen = np.isfinite(expected)
    np.testing.assert_allclose(alone.amplitude_rad[seen], expected[seen], atol=1e-6)


def test_fish_of_no_sense_is_left_to_p() -> None:
    identified, said = known(TRUE), []
    trials: list[TrialSpeeds] = []
    for number in range(1, 5):
        proposal = propose(identified, ModelStepSetting(thesis(), AMPLITUDE_MAX_RAD), trials)
        said.append(proposal.law)
        trial = _as_modelled(TRUE, proposal.amplitude_rad, thesis(), number)
        trials.append(replace(trial, speed_m_s=np.where(np.arange(40) % 7 < 3, 0.08, 0.0)))
    assert said == ["model", "p", "p", "p"]


def _as_modelled(
    model: FishModel, amplitude: Array, reference: Reference, trial: int = 1
) -> TrialSpeeds:
    """A swim without noise."""
    speed = model.beats(amplitude, reference.beat_s, Conditions(start_m_s=0.0016))
    sigma = np.full(len(speed), 0.0007)
    return TrialSpeeds(amplitude, speed, sigma, reference.beat_s, reference.crc, trial, trial)


def test_disturbance_is_what_all_trials_together_say_of_it() -> None:
    """The recursion against one normal distribution of the disturbance and all residuals."""
    amplitude = np.full(40, 0.5)
    bump = np.zeros(40)
    bump[20:23] = 0.003, -0.004, 0.003
    clean = _as_modelled(TRUE, amplitude, thesis())
    speed = clean.speed_m_s + bump
    speed[30] = np.nan
    trials = [replace(clean, speed_m_s=speed, trial=number) for number in (1, 2, 3)]
    belief = believe(known(TRUE), trials)
    assert belief.fit is not None and not belief.refuted
    mean, covariance = belief.disturbance(thesis().crc, 40)
    scatter, seen = belief.scatter, np.arange(40) != 30
    apart = np.abs(np.subtract.outer(np.arange(40), np.arange(40)))
    begin = max(0.001, belief.misfit_m_s) ** 2 * np.exp(-apart / 2.0)
    begin += np.diag(scatter.alone(belief.model, amplitude) - scatter.model_m_s**2)
    noise = scatter.moves_m_s**2 * np.exp(-apart / 6.0)
    noise += np.eye(40) * (0.0007**2 + scatter.model_m_s**2)
    walks = np.minimum.outer(np.arange(3), np.arange(3)) * 0.0003**2
    states = np.kron(np.ones((3, 3)), begin) + np.kron(walks, np.eye(40))
    told = states + np.kron(np.diag(1 / belief.weights), noise)
    kept = np.tile(seen, 3)
    weight = np.linalg.solve(told[np.ix_(kept, kept)], states[np.ix_(kept, np.arange(80, 120))])
    residuals = np.concatenate(belief.fit.residual_m_s)[kept]
    np.testing.assert_allclose(mean, weight.T @ residuals, atol=1e-9)
    left = states[80:, 80:] - weight.T @ states[np.ix_(kept, np.arange(80, 120))]
    np.testing.assert_allclose(covariance, left, atol=1e-13)
    assert covariance[30, 30] > covariance[29, 29]
    assert not belief.disturbance(12345, 40)[0].any()


def test_band_holds_nine_tenths_and_the_test_raises_no_false_alarm() -> None:
    seen = FishModel(10.2, 0.2115, 0.2037, 0.295)  # as the tank's is with its servo
    identified = known(seen)
    inside, alarms, largest = [], 0, []
    for seed in SEEDS:
        tank = Tank(seed)
        for _ in range(2):
            proposal = propose(
                identified, ModelStepSetting(thesis(), AMPLITUDE_MAX_RAD), tank.trials
            )
            tank.trial(proposal.amplitude_rad, thesis())
            speed = tank.trials[-1].speed_m_s
            inside.append(np.mean((speed >= proposal.low_m_s) & (speed <= proposal.high_m_s)))
            low, _, high = proposal.predicted_max_abs_error_m_s
            largest.append(low <= np.abs(thesis().speed_m_s - speed).max() <= high)
            alarms += believe(identified, tank.trials).refuted
    assert np.mean(inside) >= 0.9 and np.mean(largest) >= 0.8
    assert alarms == 0


def test_step_limit_holds_and_is_said() -> None:
    tank = Tank(1)
    first = propose(known(TRUE), ModelStepSetting(thesis(), AMPLITUDE_MAX_RAD, step_max_rad=0.02))
    off = np.where(np.arange(40) < 20, -0.1, 0.1)
    tank.trial(np.clip(first.amplitude_rad + off, 0, 0.6), thesis())
    last = tank.trials[-1].amplitude_rad
    for step in (0.02, 0.15):
        found = propose(
            known(TRUE), ModelStepSetting(thesis(), 0.6, step_max_rad=step), tank.trials
        )
        assert np.abs(found.amplitude_rad - last).max() <= step + 1e-12
        assert found.amplitude_rad.max() <= 0.6
        assert (found.limited_beats > 5) == (step == 0.02)
    assert first.limited_beats == 0


def test_decision_is_made_again_bit_for_bit() -> None:
    identified = known(replace(TRUE, kappa_per_m=13.0))
    tank = Tank(3, camera_lost=0.3)
    tank.learn(identified, thesis(), 2)
    law = Law(lead_beats=1)
    proposal = propose(
        identified,
        ModelStepSetting(thesis(), AMPLITUDE_MAX_RAD, step_max_rad=0.1, law=law),
        tank.trials,
    )
    document = document_of(
        proposal,
        identified,
        ModelStepSetting(thesis(), AMPLITUDE_MAX_RAD, step_max_rad=0.1, law=law),
        tank.trials,
    )
    read = json.loads(json.dumps(document, allow_nan=False))
    made = repropose(read, tank.trials[::-1])
    for name in ("amplitude_rad", "predicted_m_s", "low_m_s", "disturbance_m_s"):
        assert getattr(made, name).tobytes() == getattr(proposal, name).tobytes()
    assert made.model == proposal.model and read["input_crc"] == document["input_crc"]
    touched = replace(tank.trials[1], speed_m_s=tank.trials[1].speed_m_s + 1e-12)
    with pytest.raises(InputError, match="trial 2"):
        repropose(read, [tank.trials[0], touched])
    with pytest.raises(InputError, match="no proposal"):
        repropose(read | {"fallback": {"gain": 4}}, tank.trials)
    with pytest.raises(InputError, match=r"of another law .*proposal 1"):
        repropose(read | {"format": "tailbeat proposal 1"}, tank.trials)


def test_a_series_and_its_files_call_the_same_trial_spoilt() -> None:
    """Trials are known by what was measured, not by the objects that hold it."""
    tank, setting = Tank(7), ModelStepSetting(thesis(), AMPLITUDE_MAX_RAD)
    tank.learn(known(TRUE), thesis(), 3)
    error = thesis().speed_m_s - tank.trials[2].speed_m_s
    pushed = replace(tank.trials[2], speed_m_s=tank.trials[2].speed_m_s + 0.9 * error)
    shaken = replace(
        tank.trials[1], speed_m_s=tank.trials[1].speed_m_s + 0.02 * np.sin(np.arange(40) * 2.1)
    )
    trials = [*tank.trials[:2], replace(pushed, amplitude_rad=pushed.amplitude_rad * 0.85), shaken]
    beliefs = Beliefs(known(TRUE))
    for count in range(1, 5):
        now = [replace(trial) for trial in trials[:count]]
        belief = beliefs.after(now)
        made = propose_by(belief, setting, now)
    assert belief.spoilt[2] and made.law == "best"
    again = propose(known(TRUE), setting, [replace(trial) for trial in trials])
    assert made.amplitude_rad.tolist() == again.amplitude_rad.tolist()
    assert made.amplitude_rad.tolist() in [one.amplitude_rad.tolist() for one in trials[:2]]


def test_foretold_is_what_was_known_before() -> None:
    identified, tank = known(TRUE), Tank(1)
    tank.learn(identified, thesis(), 2)
    known_then = believe(identified, tank.trials[:-1])
    said = predicted_by(known_then, thesis(), tank.trials)
    before = propose(identified, ModelStepSetting(thesis(), AMPLITUDE_MAX_RAD), tank.trials[:1])
    assert said == pytest.approx(before.predicted_max_abs_error_m_s, rel=0.02)
    assert predicted_by(known_then, thesis(), []) is None
    assert predicted_by(known_then, cosine(0.05, 8, 10), tank.trials) is None


def test_no_swim_no_speed_and_damage() -> None:
    blind = replace(_as_modelled(TRUE, np.full(40, 0.4), thesis()), speed_m_s=np.full(40, np.nan))
    none, unseen = (propose(known(TRUE), ModelStepSetting(thesis(), 0.5), s) for s in ([], [blind]))
    assert none.amplitude_rad.tobytes() == unseen.amplitude_rad.tobytes()
    short = replace(_as_modelled(TRUE, np.full(20, 0.4), thesis()), trial=9)
    with pytest.raises(InputError, match="trial 9"):
        propose(known(TRUE), ModelStepSetting(thesis(), 0.5), [short])


def test_only_swims_after_the_identification_count() -> None:
    trials = [_as_modelled(TRUE, np.full(40, 0.4), thesis(), number) for number in range(1, 6)]
    identified = replace(known(TRUE), unique_id="aa", trials=trials[1:3])
    assert [trial.trial for trial in trials_since(identified, trials, "aa")] == [4, 5]
    assert [trial.trial for trial in trials_since(identified, trials, "bb")] == [1, 2, 3, 4, 5]
    assert len(trials_since(replace(identified, trials=[]), trials, "aa")) == 5
    again = replace(identified, trials=[trials[1], trials[3]])  # measured once more later
    assert [trial.trial for trial in trials_since(again, trials, "aa")] == [3, 5]


def test_numbers_that_come_again_hide_no_swim() -> None:
    """A board that lost its store, or a simulated one that starts again, counts from 1."""
    runs = [_as_modelled(TRUE, np.full(40, 0.4), thesis(), number) for number in (1, 2, 3, 4)]
    later = [_as_modelled(TRUE, np.full(40, 0.45), thesis(), number) for number in (5, 1, 2)]
    identified = replace(known(TRUE), unique_id="aa", trials=runs)
    since = trials_since(identified, [*runs, *later], "aa")
    assert [trial.trial for trial in since] == [5, 1, 2]
    assert numbering_restarted([*runs, *later], since)
    assert not numbering_restarted(runs, runs)
    assert not numbering_restarted(runs, [runs[3], runs[1]])  # pulled late


def foreseeing(law: str, median_m_s: float) -> Proposal:
    found = propose(known(TRUE), ModelStepSetting(SHORT, 0.5))
    return replace(found, law=law, predicted_max_abs_error_m_s=(0.0, median_m_s, 1.0))


def test_after_a_rollback_only_something_better_is_uploaded() -> None:
    assert choose_next_input(foreseeing("p", 0.5), False, 0.01).upload
    assert choose_next_input(foreseeing("model", 0.5), False, 0.01).words == ""
    assert not choose_next_input(foreseeing("p", 0.001), True, 0.01).upload
    better = choose_next_input(foreseeing("model", 0.009), True, 0.01)
    assert better.upload and "takes the place of the best" in better.words
    worse = choose_next_input(foreseeing("model", 0.0101), True, 0.01)
    assert not worse.upload and "nothing better (10.1 mm/s, the best had 10.0)" in worse.words


@pytest.mark.parametrize(("law", "median_m_s"), [("p", 1e-4), ("model", 1e-4), ("model", 1.0)])
def test_words_after_a_rollback_are_true(
    fish: Fish,
    book: TrialLibrary,
    identified_file: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    law: str,
    median_m_s: float,
) -> None:
    fish.upload_reference(SHORT.record())
    learn_with_model(fish, None, Identified.load(identified_file), False)
    book.keep(fish.pull_trial(run_trial(fish).number, tmp_path))
    fish.learn()
    best = fish.amplitudes(best=True).values
    for _ in range(2):
        fish.upload_amplitudes(np.full(SHORT.beats, 0.1))
        number = run_trial(fish).number
        if fish.status().worse_streak == 0:
            book.keep(fish.pull_trial(number, tmp_path))
            fish.learn()
    proposal = replace(foreseeing(law, median_m_s), amplitude_rad=np.full(SHORT.beats, 0.3))
    monkeypatch.setattr(
        "tailbeat.app.cli.learn.next_step", lambda *_: ModelStep(proposal, None, {"law": law})
    )
    pulls: list[int] = []
    pull = fish.pull_trial

    def counted(trial: int, folder: Path, progress: Any = None) -> Path:
        pulls.append(trial)
        return pull(trial, folder, progress)

    monkeypatch.setattr(fish, "pull_trial", counted)
    capsys.readouterr()
    said = printed(learn_with_model(fish, None, Identified.load(identified_file), False))
    assert pulls == [number]  # once: the radio is slow
    recorded = fish.amplitudes().values
    if law == "model" and median_m_s < 1:
        assert "the model's plan takes the place of the best amplitudes" in said
        assert "rolled back to trial 1's input, which the model's plan replaces" in said
        assert recorded == pytest.approx(0.3)
        return
    assert "the best input is next" in said and "replaces" not in said
    assert said.endswith("rolled back to trial 1's input")
    assert recorded.tolist() == best.tolist()
    again = learn_with_model(fish, None, Identified.load(identified_file), False)  # nothing pending
    assert "the best input is next" in printed(again)
    assert fish.amplitudes().values.tolist() == best.tolist()


def test_another_fishs_model_is_told(
    fish: Fish, book: TrialLibrary, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fish.upload_reference(SHORT.record())
    for unique_id, said in (("abc", True), (fish.unique_id(), False)):
        replace(known(Prior().model), unique_id=unique_id).save(tmp_path / "other.json")
        learn_with_model(fish, None, Identified.load(tmp_path / "other.json"), False)
        err = capsys.readouterr().err
        assert (err == f"tailbeat: identified on another fish ({unique_id})\n") is said


def test_a_reference_that_stands_for_none(
    fish: Fish, book: TrialLibrary, identified_file: Path
) -> None:
    fish.upload_reference(rest())
    assert board_reference(fish) is None
    with pytest.raises(InputError, match="the board has no reference"):
        learn_with_model(fish, None, Identified.load(identified_file), False)


@pytest.fixture
def identified_file(tmp_path: Path) -> Path:
    path = tmp_path / "fish.json"
    known(Prior().model).save(path)
    return path


@pytest.fixture
def book(fish: Fish, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> TrialLibrary:
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "books"))
    return TrialLibrary.of(fish.unique_id())


SHORT = cosine(0.06, 5.0, 6.0)


def printed(output: Output) -> str:
    """The text for people."""
    return output.text() if callable(output.text) else output.text


def test_session_on_a_board(
    fish: Fish, book: TrialLibrary, identified_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fish.params.set("ILC_LEAD", 1)
    fish.upload_reference(SHORT.record())

    def learn(dry_run: bool = False) -> dict[str, Any]:
        output = learn_with_model(fish, None, Identified.load(identified_file), dry_run)
        document = plain(output.document)
        assert isinstance(document, dict)
        return document

    planned = learn()
    assert planned["trial"] is None and planned["uploaded"] is True
    recorded = fish.amplitudes()
    assert recorded.iteration == 1
    assert recorded.values.tolist() == np.float32(planned["amplitude_rad"]).tolist()
    fish.arm()
    run_trial(fish)
    dry = learn(dry_run=True)
    assert dry["dry_run"] is True and fish.status().pending_trial == 1 and not book.speeds()
    learned = learn()
    assert learned["amplitude_rad"] == dry["amplitude_rad"]
    status = fish.status()
    assert (status.pending_trial, status.iteration, status.best_iteration) == (None, 2, 1)
    assert fish.amplitudes().values.tolist() == np.float32(learned["amplitude_rad"]).tolist()
    assert [trial.trial for trial in book.speeds()] == [1]
    kept = book.proposals()
    assert [one["input_crc"] for one in kept] == [planned["input_crc"], learned["input_crc"]]
    assert repropose(kept[1], book.speeds()).amplitude_rad.tolist() == learned["amplitude_rad"]
    replanned = learn()
    assert replanned["amplitude_rad"] == learned["amplitude_rad"]
    assert fish.status().iteration == 2


def test_session_says_one_line(
    fish: Fish, book: TrialLibrary, identified_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fish.upload_reference(SHORT.record())
    line = printed(learn_with_model(fish, None, Identified.load(identified_file), False))
    assert line.startswith("planned with the identified model") and "\n" not in line
    fish.arm()
    run_trial(fish)
    first = printed(
        learn_with_model(fish, None, Identified.load(identified_file), False)
    ).splitlines()[0]
    assert first.startswith("trial 1: max|e| ") and "predicted" in first and "next max|e|" in first


def test_board_that_was_never_identified_is_told_so(fish: Fish, book: TrialLibrary) -> None:
    fish.upload_reference(SHORT.record())
    with pytest.raises(InputError, match="has not been identified"):
        learn_with_model(fish, None, None, False)
    book.set_identified(known(Prior().model))
    learn_with_model(fish, None, None, False)
    assert fish.amplitudes().values.max() > 0.3


def test_proposal_is_complete() -> None:
    found: Proposal = propose(known(TRUE), ModelStepSetting(thesis(), 0.5))
    assert np.all((found.amplitude_rad >= 0) & (found.amplitude_rad <= 0.5))
    assert np.all((found.low_m_s < found.predicted_m_s) & (found.predicted_m_s < found.high_m_s))
    low, median, high = found.predicted_max_abs_error_m_s
    assert 0 < low < median < high
    assert (found.law, found.trials) == ("model", ())
