"""Commissioning a fish that nobody knows: rules for the limit, the runs, the steps on a board."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from tailbeat.app.cli.app import app
from tailbeat.board.fish import Fish
from tailbeat.core import reference
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.trial_checks import HeadingDrift
from tailbeat.experiment.current import begin
from tailbeat.experiment.folder import copy_state
from tailbeat.learning import fit
from tailbeat.learning.fish_model import FishModel, TrialSpeeds
from tailbeat.learning.identification import Identified
from tailbeat.learning.saturation import needed_rad, servo_rad
from tailbeat.link.params import known_parameters
from tailbeat.session.commission import CommissionStep, commission_fish
from tailbeat.session.events import Countdown, Event, StepProgress, TrialStarted
from tailbeat.session.limit import LimitIncrease, limit_offer, tried_rad
from tailbeat.session.log import Drain
from tailbeat.session.measure import RUNS_MAX, measure_fish, rise
from tailbeat.session.outcome import Decision, RecordedTrial
from tailbeat.session.status import fall_per_swim, status_of, swims_left, words
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport

THESIS = reference.thesis()
DEFAULTS = {name: known.default for name, known in known_parameters().items()}
STRAIGHT = HeadingDrift(0.0, 0.05, 0.02, "imu")
CROOKED = HeadingDrift(0.1, 0.3, 0.2, "imu")
TANK = FishModel(10.0, 0.212, 0.203, 0.32)


def known(model: FishModel = TANK, *others: FishModel, tried: float = 0.8) -> Identified:
    """Measured up to ``tried`` rad."""
    known = np.diag([0.01, 1e-4, 1e-4, 1e-3, 1e-3, 1e-7, 1e-4, 1e-2])
    amplitude = rise(tried, 8)
    runs = [TrialSpeeds(amplitude, model.beats(amplitude, 1.0), np.full(len(amplitude), 1e-3))]
    return Identified(model, [model, *others], known, source="runs", trials=runs)


class Somebody:
    """Says yes, or no to the question with ``refuses`` in it."""

    def __init__(self, refuses: str = "") -> None:
        self.refuses = refuses
        self.asked: list[str] = []
        self.told: list[Event] = []

    def tell(self, event: Event) -> None:
        self.told.append(event)

    def wants_abort(self) -> bool:
        return False

    def decide(self, recorded: RecordedTrial) -> Decision:
        return Decision("keep")

    def confirm(self, question: str) -> bool:
        self.asked.append(question)
        return not (self.refuses and self.refuses in question)

    def number(self, question: str, value: float) -> float | None:
        return value


# The rules


def stays(said: LimitIncrease | str) -> str:
    assert isinstance(said, str)
    assert said.startswith("AMP_MAX_RAD stays ") and "\n" not in said
    return said


def test_as_much_as_the_reference_needs() -> None:
    found = limit_offer(DEFAULTS, THESIS, known(), STRAIGHT)
    assert isinstance(found, LimitIncrease) and found.name == "AMP_MAX_RAD"
    need = needed_rad(known(), THESIS)
    assert found.was == 0.5 and found.to == pytest.approx(need, abs=0.0101) and found.to >= need
    raised = DEFAULTS | {"AMP_MAX_RAD": float(np.float32(found.to))}
    assert "enough" in stays(limit_offer(raised, THESIS, known(), STRAIGHT))


def test_the_reason_has_its_figures() -> None:
    found = limit_offer(DEFAULTS, THESIS, known(), STRAIGHT)
    assert isinstance(found, LimitIncrease)
    assert f"{TANK.amplitude_rad(0.0791):.2f} for its 79 mm/s" in found.reason
    assert "a trial went to 0.80 without a fault" in found.reason
    assert "of 2.64 m" in found.reason


def test_no_more_than_a_run_has_shown() -> None:
    found = limit_offer(DEFAULTS, THESIS, known(tried=0.56), STRAIGHT)
    assert isinstance(found, LimitIncrease) and found.to == pytest.approx(0.56)
    gentle = limit_offer(DEFAULTS, THESIS, known(tried=0.5), STRAIGHT)
    assert "no trial of the fish went beyond 0.50 rad" in stays(gentle)
    untried = limit_offer(DEFAULTS, THESIS, replace(known(), trials=[]), STRAIGHT)
    assert "tailbeat session commission" in stays(untried)


def test_a_weaker_model_asks_for_more() -> None:
    weak = replace(TANK, slope_m_s_rad=0.19)
    assert needed_rad(known(TANK, weak), THESIS) > needed_rad(known(), THESIS) + 0.02
    slow = reference.thesis(0.04, 40.0)
    assert "enough" in stays(limit_offer(DEFAULTS, slow, known(), STRAIGHT))


def test_a_sluggish_fish_needs_more_than_its_top_speed() -> None:
    """It has to be pushed on the way there."""
    sluggish = needed_rad(known(replace(TANK, kappa_per_m=2.5)), THESIS)
    assert sluggish > needed_rad(known(), THESIS) + 0.05


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ((None, STRAIGHT, False), "tailbeat session commission"),
        ((known(), None, False), "tells its heading error"),
        ((known(), CROOKED, False), "tailbeat session trim"),
        ((known(), STRAIGHT, True), "rolled back"),
    ],
)
def test_why_not(given: tuple[Any, Any, bool], why: str) -> None:
    identified, straight, rolled_back = given
    assert why in stays(limit_offer(DEFAULTS, THESIS, identified, straight, rolled_back))


def test_the_servo_ends_it() -> None:
    near = DEFAULTS | {"SERVO_MAX_US": 1500 + 0.55 * DEFAULTS["SERVO_US_RAD"]}
    assert servo_rad(near) == pytest.approx(0.55)
    found = limit_offer(near, THESIS, known(), STRAIGHT)
    assert isinstance(found, LimitIncrease) and found.to == pytest.approx(0.55)
    there = near | {"AMP_MAX_RAD": 0.55}
    assert "the servo turns 0.55 rad" in stays(limit_offer(there, THESIS, known(), STRAIGHT))
    askew = DEFAULTS | {"SERVO_CENTRE_US": 1200.0}
    assert servo_rad(askew) == pytest.approx(300 / DEFAULTS["SERVO_US_RAD"])
    assert servo_rad(DEFAULTS) == pytest.approx(math.pi / 3)


def test_the_tank_ends_it() -> None:
    short = DEFAULTS | {"TANK_LEN_M": 2.3}
    assert "tank clearance is used up" in stays(limit_offer(short, THESIS, known(), STRAIGHT))
    unchecked = DEFAULTS | {"TANK_LEN_M": 0.0}
    assert isinstance(limit_offer(unchecked, THESIS, known(), STRAIGHT), LimitIncrease)


# The runs


def test_a_run_rises_and_coasts() -> None:
    amplitude = rise(0.7, 12)
    assert amplitude.max() == 0.7 and np.all(np.diff(amplitude[:12]) > 0)
    assert np.all(amplitude[-6:] == 0)


@pytest.mark.parametrize("kappa_per_m", [5.0, 20.0])
def test_one_run_measures_a_fish(kappa_per_m: float) -> None:
    """After what a trim tells: here nothing, so the first run stays within the limit."""
    board = SimBoard("tank", seed=3, kappa_per_m=kappa_per_m)
    with Fish(SimTransport(board)) as fish:
        fish.link.run(6.0)
        somebody = Somebody()
        found = measure_fish(fish, THESIS, somebody)
        assert fish.params.get("AMP_MAX_RAD").value == 0.5
        assert fish.status().state == "IDLE" and fish.status().pending_trial is None
    assert 2 <= found.runs <= RUNS_MAX
    assert "0.50 rad;" in somebody.asked[0] and "beyond its limit of 0.50" in somebody.asked[1]
    model = found.identified.model
    assert model.kappa_per_m == pytest.approx(kappa_per_m, rel=0.35)
    assert float(model.steady_m_s(0.55)) == pytest.approx(0.0735, rel=0.05)
    assert tried_rad(found.identified) >= needed_rad(found.identified, THESIS) - 0.01
    assert found.straight is not None and not found.straight.crooked


def test_a_tank_too_short_for_any_run(fish: Fish) -> None:
    fish.link.run(6.0)
    fish.params.set("TANK_LEN_M", 0.6)
    with pytest.raises(InputError, match="too short"):
        measure_fish(fish, THESIS, Somebody())


def test_a_run_that_fails_says_so_and_puts_the_limit_back(fish: Fish) -> None:
    fish.link.run(6.0)
    assert fish.sim is not None

    class Unlucky(Somebody):
        def tell(self, event: Event) -> None:
            if isinstance(event, TrialStarted):
                fish.sim.world.set_battery_v(5.0)  # type: ignore[union-attr]

    with pytest.raises(TailbeatError, match="identification trial 1 ended with"):
        measure_fish(fish, THESIS, Unlucky())
    assert fish.params.get("AMP_MAX_RAD").value == 0.5


# The session


@pytest.fixture
def quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Identified without a bootstrap, which takes seconds and is tested elsewhere."""
    monkeypatch.setattr(fit, "bootstrap", lambda *_, **__: [])


def limit(fish: Fish) -> float:
    return fish.params.get("AMP_MAX_RAD").value


def test_the_whole_of_it(quickly: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path))
    board = SimBoard("tank", seed=1, tail_centre_rad=0.05)
    with Fish(SimTransport(board)) as fish:
        somebody = Somebody()
        steps = list(commission_fish(fish, THESIS, somebody))
        names = ["health", "tank", "trim", "measure", "limit", "law"]
        assert [step.name for step in steps] == names
        assert all(step.done for step in steps), steps
        counted = sum(isinstance(e, Countdown) and e.left_s == 0 for e in somebody.told)
        trials = sum(isinstance(e, TrialStarted) for e in somebody.told)
        rests = sum(
            isinstance(e, StepProgress) and e.step == "rest" and e.ok is True for e in somebody.told
        )
        assert trials == counted == rests == 3, "the preflight checks go before each"
        blind = [e for e in somebody.told if "not checked" in str(getattr(e, "text", ""))]
        assert blind == [], "its camera looks at every start"
        (raised,) = [step.limit for step in steps if step.limit is not None]
        assert raised.was == pytest.approx(0.5) and limit(fish) == pytest.approx(raised.to)
        assert fish.status().reference_crc == THESIS.crc
        assert fish.params.get("ILC_LEAD").value >= 0.5
        # 0.05 rad askew; what the servo does to a beat is left of it
        centre = fish.params.get("SERVO_CENTRE_US").value
        assert centre == pytest.approx(1500 - 0.05 * DEFAULTS["SERVO_US_RAD"], abs=6)
        held = fish.params.values()
        board.world.power_cycle()
        fish.link.run(1.0)
        assert fish.params.values() == held  # saved
        for question in somebody.asked:
            assert question.endswith("?"), question
    assert (tmp_path / fish_folder(tmp_path) / "identified.json").is_file()


def fish_folder(library: Path) -> str:
    return next(path.name for path in library.iterdir())


@pytest.mark.parametrize("refused", ["The tank is", "Trial 1 to"])
def test_no_is_no(refused: str, fish: Fish, quickly: None) -> None:
    steps = list(commission_fish(fish, THESIS, Somebody(refused)))
    assert not steps[-1].done and "the answer was no" in steps[-1].words
    assert limit(fish) == pytest.approx(0.5)


def test_a_limit_that_nobody_types_stays(fish: Fish, quickly: None) -> None:
    class Doubtful(Somebody):
        def number(self, question: str, value: float) -> float | None:
            assert f"to {value:.2f} rad" in question
            return None

    steps = {step.name: step for step in commission_fish(fish, THESIS, Doubtful())}
    assert steps["limit"].done and steps["limit"].limit is None
    assert "stays 0.50" in steps["limit"].words
    assert limit(fish) == pytest.approx(0.5)
    assert steps["law"].done, "the law is designed for the limit there is"


def test_a_fish_that_turns_gets_no_more_amplitude(quickly: None) -> None:
    """Its trim is refused: nobody sets it."""
    board = SimBoard("tank", seed=1, tail_centre_rad=0.3)
    with Fish(SimTransport(board)) as fish:
        steps = {s.name: s for s in commission_fish(fish, THESIS, Somebody("Set it?"))}
        assert not steps["trim"].done and "does not swim straight" in steps["limit"].words
        assert limit(fish) == pytest.approx(0.5)


def broken(do: Callable[[SimBoard], None], **config: float) -> tuple[list[CommissionStep], float]:
    board = SimBoard("tank", seed=1, **config)
    do(board)
    board.run(1.0)
    with Fish(SimTransport(board)) as fish:
        return list(commission_fish(fish, THESIS, Somebody())), limit(fish)


def test_nothing_begins_on_an_empty_battery_or_without_a_camera() -> None:
    for steps, reached in (
        broken(lambda board: board.world.set_battery_v(6.3)),
        broken(lambda board: None, camera_fps=0),
        broken(lambda board: board.world.set_camera(False)),
    ):
        print(steps)
        assert [step.name for step in steps] == ["health"] and not steps[0].done
        assert reached == pytest.approx(0.5)


def test_a_trial_that_waits_comes_first(fish: Fish) -> None:
    fish.upload_reference(reference.trapezoid(0.05, 2, 2))
    run_trial(fish)
    steps = list(commission_fish(fish, THESIS, Somebody()))
    assert len(steps) == 1 and "neither learned nor discarded" in steps[0].words
    assert fish.status().pending_trial == 1


def test_what_was_learned_is_not_given_up_unasked(fish: Fish) -> None:
    fish.upload_reference(reference.trapezoid(0.05, 2, 2))
    run_trial(fish)
    fish.learn()
    mine = fish.learned_record()
    steps = list(commission_fish(fish, THESIS, Somebody("resets its learning")))
    assert not steps[-1].done and fish.learned_record() == mine


# Where it stands


def test_swims_left() -> None:
    drains = [Drain(8.2, 8.1, 8.0), Drain(8.1, 8.0, 7.9)]
    assert fall_per_swim(drains, 8.0) == pytest.approx(0.1)
    assert fall_per_swim([], 8.0) is None
    assert swims_left(8.0, 6.6, 0.1) == 15  # 8.0, 7.9, ... 6.6
    assert swims_left(6.6, 6.6, 0.1) == 1
    assert swims_left(6.59, 6.6, 0.1) == 0
    assert swims_left(8.0, 6.6, 0.0) is None
    assert swims_left(8.0, 6.6, None) is None


def test_status_before_and_after_a_swim(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fish: Fish
) -> None:
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "logbook"))
    fish.upload_reference(reference.trapezoid(0.05, 2, 2))
    experiment = begin(fish, tmp_path)
    copy_state(fish, experiment)
    lines = words(status_of(fish, experiment))
    assert any("no trial on it yet" in line for line in lines)
    assert "learning    0 trials, nothing learned yet" in lines
    assert lines[-1].startswith("limits      AMP_MAX_RAD stays 0.50: the amplitude that")


def test_at_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path))
    done = CliRunner().invoke(app, ["session", "commission", "--connect", "sim:tank", "--json"])
    document = json.loads(done.stdout)
    assert done.exit_code == 1 and document["ok"] is False
    assert "Begin again with the same command" in document["steps"][-1]["words"]
    assert document["params"]["AMP_MAX_RAD"] == pytest.approx(0.5)
    nowhere = CliRunner().invoke(app, ["session", "status", "--connect", "sim:tank"])
    assert nowhere.exit_code != 0 and "is in no experiment" in str(nowhere.exception)
