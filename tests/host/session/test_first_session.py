"""The first session with a fish nobody knows: rules for the limits, and the steps on a board."""

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
from tailbeat.core.trial_checks import HeadingDrift
from tailbeat.experiment.current import begin
from tailbeat.experiment.folder import copy_state
from tailbeat.learning import fit
from tailbeat.learning.fish_model import FishModel
from tailbeat.learning.identification import Identified
from tailbeat.learning.saturation import needed_rad, servo_rad
from tailbeat.link.params import known_parameters
from tailbeat.session import commission, commission_steps
from tailbeat.session.commission import CommissionStep, commission_fish
from tailbeat.session.commission_steps import INCREASE_MAX_RAD, LimitIncrease, next_limit_increase
from tailbeat.session.events import Countdown, Event, StepProgress, TrialStarted
from tailbeat.session.log import Drain
from tailbeat.session.outcome import Decision, RecordedTrial
from tailbeat.session.status import fall_per_swim, status_of, swims_left, words
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport

THESIS = reference.thesis()
DEFAULTS = {name: known.default for name, known in known_parameters().items()}
STRAIGHT = HeadingDrift(0.0, 0.05, 0.02, "imu")
CROOKED = HeadingDrift(0.1, 0.3, 0.2, "imu")
TANK = FishModel(10.0, 0.212, 0.203, 0.32)


def known(model: FishModel = TANK, *others: FishModel) -> Identified:
    known = np.diag([0.01, 1e-4, 1e-4, 1e-3, 1e-3, 1e-7, 1e-4, 1e-2])
    return Identified(model, [model, *others], known, source="runs")


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


def test_in_small_steps_up_to_what_the_reference_needs() -> None:
    params, steps = dict(DEFAULTS), []
    while isinstance(
        found := next_limit_increase(params, THESIS, known(), STRAIGHT), LimitIncrease
    ):
        assert found.name == "AMP_MAX_RAD" and found.was == params["AMP_MAX_RAD"]
        assert 0 < found.to - found.was <= INCREASE_MAX_RAD + 1e-9
        steps.append(found.to)
        params["AMP_MAX_RAD"] = float(np.float32(found.to))
    need = needed_rad(known(), THESIS)
    assert steps == [pytest.approx(0.6), pytest.approx(need, abs=0.0101)]
    assert need - 1e-6 <= params["AMP_MAX_RAD"] + 0.006
    assert "enough" in stays(found)


def test_the_reason_has_its_figures() -> None:
    found = next_limit_increase(DEFAULTS, THESIS, known(), STRAIGHT)
    assert isinstance(found, LimitIncrease)
    assert f"{TANK.amplitude_rad(0.0791):.2f} rad hold the 79 mm/s" in found.reason
    assert "at most 0.1 at once" in found.reason and "DU_MAX_RAD stays 0.15" in found.reason
    assert "of 2.64 m" in found.reason


def test_a_weaker_model_asks_for_more() -> None:
    weak = replace(TANK, slope_m_s_rad=0.19)
    assert needed_rad(known(TANK, weak), THESIS) > needed_rad(known(), THESIS) + 0.02
    slow = reference.thesis(0.04, 40.0)
    assert "enough" in stays(next_limit_increase(DEFAULTS, slow, known(), STRAIGHT))


def test_a_sluggish_fish_needs_more_than_its_top_speed() -> None:
    """It has to be pushed on the way there."""
    sluggish = needed_rad(known(replace(TANK, kappa_per_m=2.5)), THESIS)
    assert sluggish > needed_rad(known(), THESIS) + 0.05


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ((None, STRAIGHT, False), "tailbeat session identify"),
        ((known(), None, False), "nothing tells whether it swims straight"),
        ((known(), CROOKED, False), "tailbeat session trim"),
        ((known(), STRAIGHT, True), "rolled back"),
    ],
)
def test_why_not(given: tuple[Any, Any, bool], why: str) -> None:
    identified, straight, rolled_back = given
    assert why in stays(next_limit_increase(DEFAULTS, THESIS, identified, straight, rolled_back))


def test_the_servo_ends_it() -> None:
    near = DEFAULTS | {"SERVO_MAX_US": 1500 + 0.55 * DEFAULTS["SERVO_US_RAD"]}
    assert servo_rad(near) == pytest.approx(0.55)
    found = next_limit_increase(near, THESIS, known(), STRAIGHT)
    assert isinstance(found, LimitIncrease) and found.to == pytest.approx(0.55)
    assert "the servo turns no farther" in found.reason
    there = near | {"AMP_MAX_RAD": 0.55}
    assert "the servo turns 0.55 rad" in stays(
        next_limit_increase(there, THESIS, known(), STRAIGHT)
    )
    askew = DEFAULTS | {"SERVO_CENTRE_US": 1200.0}
    assert servo_rad(askew) == pytest.approx(300 / DEFAULTS["SERVO_US_RAD"])
    assert servo_rad(DEFAULTS) == pytest.approx(math.pi / 3)


def test_the_tank_ends_it() -> None:
    short = DEFAULTS | {"TANK_LEN_M": 2.3}
    assert "no room for more" in stays(next_limit_increase(short, THESIS, known(), STRAIGHT))
    unchecked = DEFAULTS | {"TANK_LEN_M": 0.0}
    assert isinstance(next_limit_increase(unchecked, THESIS, known(), STRAIGHT), LimitIncrease)


# The proving swim


def test_a_profile_that_fits_or_none() -> None:
    params = DEFAULTS | {"AMP_MAX_RAD": 0.7}
    long = commission_steps.profile(0.7, known(), params)
    short = commission_steps.profile(0.7, known(), params | {"TANK_LEN_M": 1.4})
    assert long is not None and short is not None and len(short) < len(long)
    assert long.max() == pytest.approx(0.7) and np.all(long[-4:] == 0)
    assert commission_steps.profile(0.7, known(), params | {"TANK_LEN_M": 0.9}) is None


def test_proofs(fish: Fish) -> None:
    fish.link.run(6.0)
    before = fish.params.get("AMP_MAX_RAD").value
    found = commission_steps.try_limit(fish, 0.6, known(), Somebody())
    assert found.why_not == "" and "of the speed foretold" in found.words
    assert found.straight is not None and not found.straight.crooked
    stronger = commission_steps.try_limit(
        fish, 0.6, known(replace(TANK, slope_m_s_rad=0.3)), Somebody()
    )
    assert "slower than foretold" in stronger.why_not
    assert fish.params.get("AMP_MAX_RAD").value == before
    assert fish.status().state == "IDLE" and fish.status().pending_trial is None


def test_a_proof_that_turns() -> None:
    board = SimBoard("tank", seed=1, tail_centre_rad=0.3)
    with Fish(SimTransport(board)) as fish:
        fish.link.run(15.0)
        found = commission_steps.try_limit(fish, 0.6, known(), Somebody())
    assert "NOT STRAIGHT" in found.why_not


# The session


@pytest.fixture
def quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Identified without a bootstrap, which takes seconds and is tested elsewhere."""
    monkeypatch.setattr(fit, "bootstrap", lambda *_, **__: [])


@pytest.fixture
def known_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Identified and trimmed by a seer."""

    def identify(self: Any) -> CommissionStep:
        self.identified, self.straight = known(), STRAIGHT
        return CommissionStep("identify", True, "seen")

    monkeypatch.setattr(commission._Session, "identify", identify)
    monkeypatch.setattr(
        commission._Session, "trim", lambda self: CommissionStep("trim", False, "left out")
    )
    monkeypatch.setattr(
        commission._Session, "design", lambda self: CommissionStep("design", True, "given")
    )


def limit(fish: Fish) -> float:
    return fish.params.get("AMP_MAX_RAD").value


def test_the_whole_of_it(quickly: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path))
    board = SimBoard("tank", seed=1, tail_centre_rad=0.05)
    with Fish(SimTransport(board)) as fish:
        somebody = Somebody()
        steps = list(commission_fish(fish, THESIS, somebody))
        assert [step.name for step in steps[:4]] == ["look", "trim", "identify", "design"]
        assert all(step.done for step in steps), steps
        counted = sum(isinstance(e, Countdown) and e.left_s == 0 for e in somebody.told)
        trials = sum(isinstance(e, TrialStarted) for e in somebody.told)
        rests = sum(
            isinstance(e, StepProgress) and e.step == "rest" and e.ok is True for e in somebody.told
        )
        assert (
            trials >= 8 and counted == rests == trials
        )  # the preflight checks goes before every one
        blind = [e for e in somebody.told if "not checked" in str(getattr(e, "text", ""))]
        assert blind == [], "its camera looks at every start"
        raises = [one for step in steps for one in step.raises]
        assert [one.was for one in raises] == pytest.approx([0.5, 0.6])
        assert limit(fish) == pytest.approx(raises[-1].to)
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


@pytest.mark.parametrize(
    ("refused", "ends_at", "reached"),
    [("tank is", "look", 0.5), ("from 0.50", "limits", 0.5), ("from 0.60", "limits", 0.6)],
)
def test_no_is_no(
    refused: str, ends_at: str, reached: float, fish: Fish, known_at_once: None
) -> None:
    steps = list(commission_fish(fish, THESIS, Somebody(refused)))
    assert steps[-1].name == ends_at and not steps[-1].done
    assert "the answer was no" in steps[-1].words
    assert limit(fish) == pytest.approx(reached)


def test_a_proof_that_fails_leaves_the_limit(
    fish: Fish, known_at_once: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    fish.sim.world.swap_battery(8.2, gain=0.7)  # type: ignore[union-attr]
    fish.link.run(1.0)
    steps = list(commission_fish(fish, THESIS, Somebody()))
    assert not steps[-1].done and "slower than foretold" in steps[-1].words
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
        assert [step.name for step in steps] == ["look"] and not steps[0].done
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
    steps = list(commission_fish(fish, THESIS, Somebody("forget")))
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
    assert lines[-1].startswith("limits      AMP_MAX_RAD stays 0.50: nobody knows yet")


def test_at_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path))
    done = CliRunner().invoke(app, ["session", "commission", "--connect", "sim:tank", "--json"])
    document = json.loads(done.stdout)
    assert done.exit_code == 1 and document["ok"] is False
    assert "--yes answers" in document["steps"][-1]["words"]
    assert document["params"]["AMP_MAX_RAD"] == pytest.approx(0.5)
    nowhere = CliRunner().invoke(app, ["session", "status", "--connect", "sim:tank"])
    assert nowhere.exit_code != 0 and "is in no experiment" in str(nowhere.exception)
