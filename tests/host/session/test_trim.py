"""The tail's centre from two short trials, on the simulated fish; the board gets all back."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from tailbeat.app.cli.app import app
from tailbeat.board import preserve
from tailbeat.board.fish import Fish
from tailbeat.core import reference
from tailbeat.core.errors import InputError, LinkLostError, TailbeatError
from tailbeat.core.reference import thesis
from tailbeat.core.trial_checks import heading_drift
from tailbeat.core.trial_file import read_trial
from tailbeat.experiment.current import set_and_save
from tailbeat.experiment.library import RUN, TrialLibrary, library_of, preserve_folder
from tailbeat.learning.fish_model import trial_speeds
from tailbeat.learning.identification import any_fish
from tailbeat.link.messages import BeatEvent
from tailbeat.link.params import known_parameters
from tailbeat.session import trial, trim
from tailbeat.session.events import Event, Notice, StepProgress, TrialStarted
from tailbeat.session.measure import measured_before
from tailbeat.session.outcome import Decision, RecordedTrial
from tailbeat.session.preflight_step import GivenUp
from tailbeat.session.travel import travel_model_of
from tailbeat.session.trial import run_trial
from tailbeat.session.trim import CENTRE, Trim, TrimTrial, apply, centre_of, find_centre, plan

US_RAD = 572.9578
PARAMS = {name: known.default for name, known in known_parameters().items()}


class Somebody:
    """Says yes and lets it swim, unless told otherwise."""

    def __init__(self, stop: Callable[[Event], object] | None = None, says: bool = True) -> None:
        self.events: list[Event] = []
        self.stop, self.says, self.pressed = stop, says, False

    def tell(self, event: Event) -> None:
        self.events.append(event)
        if self.stop is not None and self.stop(event):
            self.pressed = True

    def wants_abort(self) -> bool:
        return self.pressed

    def decide(self, recorded: RecordedTrial) -> Decision:
        raise AssertionError(recorded)

    def confirm(self, question: str) -> bool:
        assert "start" in question
        return self.says

    def number(self, question: str, value: float) -> float | None:
        return value


def askew(rad: float, seed: int = 1, **more: float) -> Fish:
    return Fish.connect("sim:tank", seed=seed, tail_centre_rad=rad, **more)


@pytest.fixture
def learned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Fish]:
    """A fish with its tail askew that has learned from a trial, with a trial library, and a
    parameter that is changed but not saved."""
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "books"))
    with askew(0.1, 4) as fish:
        fish.upload_reference(reference.cosine(0.06, 3, 2))
        run_trial(fish)
        fish.learn()
        fish.params.set("ILC_GAIN", 3.5)
        yield fish


def state(fish: Fish) -> dict[str, Any]:
    status = fish.status()
    best = fish.amplitudes(best=True)
    return {
        "reference": fish.reference_record(),
        "amplitudes": fish.amplitudes().values.tobytes(),
        "best": best.values.tobytes(),
        "status": [status.state, status.iteration, status.best_iteration, status.pending_trial],
        "params": fish.params.values(),
    }


def check_found(rad: float, seeds: range, tmp_path: Path) -> None:
    misses, left = [], []
    for seed in seeds:
        with askew(rad, seed) as fish:
            found = find_centre(fish, Somebody())
            assert found.source == "imu"
            misses.append(found.centre_us - (1500 - rad * US_RAD))
            assert abs(misses[-1]) < 3 * found.sigma_us
            apply(fish, found)
            fish.params.set("ILC_GAIN", 7)
            fish.params.set("AMP_MAX_RAD", 0.785)
            fish.upload_reference(thesis().record())
            fish.link.run(30)
            number = run_trial(fish).number
            assert fish.sim is not None
            left.append(math.degrees(fish.sim.world.truth().heading_rad))
            felt = heading_drift(read_trial(fish.pull_trial(number, tmp_path / f"{rad}{seed}")))
            assert felt is not None and not felt.crooked
    rms = np.sqrt(np.mean(np.square(misses)))
    print(f"askew {rad:+.2f}: centre within {np.abs(misses).max():.1f} us, RMS {rms:.1f}")
    print(f"then within {np.abs(left).max():.1f} degrees")
    assert np.abs(misses).max() < 6.0 and np.abs(left).max() < 4.0


@pytest.mark.parametrize("rad", [-0.1, 0.1])
def test_the_centre_is_found_and_the_fish_swims_straight(rad: float, tmp_path: Path) -> None:
    check_found(rad, range(1, 3), tmp_path)


@pytest.mark.soak
@pytest.mark.parametrize("rad", [-0.1, 0.0, 0.1])
def test_of_twenty_fish(rad: float, tmp_path: Path) -> None:
    check_found(rad, range(1, 21), tmp_path)


def test_by_a_camera_when_the_imu_is_unplugged() -> None:
    with askew(0.1) as fish:
        assert fish.sim is not None
        fish.sim.world.set_imu(False)
        found = find_centre(fish, Somebody())
    assert found.source == "camera"
    assert found.centre_us == pytest.approx(1500 - 0.1 * US_RAD, abs=5.0)
    with askew(0.1) as fish:  # a gyro's zero is of a fish that may have turned by a degree
        assert find_centre(fish, Somebody()).sigma_us > 1.4 * found.sigma_us


def test_neither_imu_nor_camera() -> None:
    with askew(0.1, camera_fps=0) as fish:
        assert fish.sim is not None
        fish.sim.world.set_imu(False)
        with pytest.raises(InputError, match="nothing felt how the fish turned"):
            find_centre(fish, Somebody())
        assert fish.params.get(CENTRE).value == 1500


def test_without_speeds_the_way_is_the_model_s() -> None:
    """The turn per metre is as wrong as the way, and none is none."""
    with askew(0.1, camera_fps=0) as fish:
        fish.params.set("SPD_SOURCE", 1)
        found = find_centre(fish, Somebody())
    assert found.centre_us == pytest.approx(1500 - 0.1 * US_RAD, abs=8.0)


def test_it_says_how_far_before_it_swims(learned: Fish) -> None:
    somebody = Somebody()
    find_centre(learned, somebody)
    order = [type(e) for e in somebody.events if isinstance(e, StepProgress | TrialStarted)]
    assert order == [StepProgress, TrialStarted] * 2
    told = [e.text for e in somebody.events if isinstance(e, StepProgress)]
    assert all(" m, at worst " in text and "of 2.64 m" in text for text in told)


def test_the_board_has_everything_back_and_the_library_has_the_runs(learned: Fish) -> None:
    before, trials = state(learned), learned.status().next_trial
    find_centre(learned, Somebody())
    assert state(learned) == before
    book = TrialLibrary.of(learned.unique_id())
    kept = book.kept()[0]
    assert [one.mark for one in kept if one.trial.number >= trials] == [RUN, RUN]
    assert not preserve_folder(book).exists()  # type: ignore[union-attr]
    for one in kept[-2:]:
        assert np.nanmax(one.trial.beats.applied_rad) <= before["params"]["AMP_MAX_RAD"]
    asked = [one.trial.params[CENTRE] for one in kept[-2:]]
    assert asked == pytest.approx([1500 - 0.06 * US_RAD, 1500 + 0.06 * US_RAD], abs=0.01)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), TailbeatError("x", "y")])
@pytest.mark.parametrize("at", [0, 3, 20, 45])
def test_after_a_failure_too(learned: Fish, at: int, error: BaseException) -> None:
    before, events = state(learned), 0

    def fail(_: Event) -> None:
        nonlocal events
        events += 1
        if events == at + 1:
            raise error

    with pytest.raises(type(error)):
        find_centre(learned, Somebody(fail))
    assert events > at
    assert state(learned) == before
    learned.link.run(1.0)  # the coast to the centre
    assert learned.sim is not None and not learned.sim.world.truth().swimming


def test_stopped_by_hand(learned: Fish) -> None:
    before = state(learned)
    somebody = Somebody(lambda event: isinstance(event, BeatEvent) and event.beat == 4)
    with pytest.raises(GivenUp, match="stopped by hand"):
        find_centre(learned, somebody)
    assert state(learned) == before
    assert learned.sim is not None and len(learned.sim.world.true_beats()) < 10
    with pytest.raises(GivenUp):
        find_centre(learned, Somebody(says=False))
    assert state(learned) == before


class Killed(BaseException):
    """As by kill -9: nothing is put back."""


def test_a_trim_that_was_broken_off_is_put_back_by_the_next(
    learned: Fish, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = state(learned)

    def fail(event: Event) -> None:
        if isinstance(event, BeatEvent):
            raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(preserve, "_put_back", lambda *_: None)
        patch.setattr(trial, "_abort", lambda _: None)
        with pytest.raises(Killed):
            find_centre(learned, Somebody(fail))
    assert learned.params.get(CENTRE).value != 1500
    with pytest.raises(InputError, match="executes a trial"):
        find_centre(learned, Somebody())
    while learned.status().state not in ("IDLE", "ABORTED"):
        learned.link.run(1.0)
    assert learned.status().pending_trial is not None
    somebody = Somebody()
    found = find_centre(learned, somebody)
    assert found.was_us == 1500  # what was set before the first one, not what it left
    assert any("was interrupted" in e.text for e in somebody.events if isinstance(e, Notice))
    assert state(learned) == before


def test_when_the_link_stays_away_a_copy_is_left(
    learned: Fish, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(*_: Any) -> None:
        raise LinkLostError("gone", "")

    monkeypatch.setattr(preserve, "_restore", gone)
    with pytest.raises(TailbeatError, match=r"a copy is in .*flash --restore"):
        find_centre(learned, Somebody())


def test_applied_for_good_and_nothing_else_is(learned: Fish) -> None:
    found = find_centre(learned, Somebody())
    held = apply(learned, found)
    assert held == pytest.approx(found.centre_us, abs=0.06)
    assert learned.params.get("ILC_GAIN").value == 3.5
    assert learned.sim is not None
    learned.sim.world.power_cycle()
    learned.link.run(3)
    assert learned.params.get(CENTRE).value == held
    assert learned.params.get("ILC_GAIN").value == 4  # was never saved


def test_set_for_good_says_what_is_held(learned: Fish) -> None:
    assert set_and_save(learned, {"ILC_LEAD": 1.0}) == {"ILC_LEAD": 1.0}


def test_what_is_refused_leaves_all_as_it_was(learned: Fish) -> None:
    assert learned.params.get("ILC_GAIN").value == 3.5  # not saved
    with pytest.raises(InputError, match="DU_MAX_RAD"):
        set_and_save(learned, {"ILC_LEAD": 2.0, "DU_MAX_RAD": 99.0})
    assert (learned.params.get("ILC_GAIN").value, learned.params.get("ILC_LEAD").value) == (3.5, 1)


def test_trials_with_another_centre_do_not_tell_how_straight_it_swims(learned: Fish) -> None:
    """The two of a trim turn the fish on purpose."""
    find_centre(learned, Somebody())
    book = library_of(learned)
    assert book is not None
    run = trial_speeds(book.kept()[0][-1].trial)
    book.set_identified(replace(any_fish(), trials=[run]))
    known = measured_before(learned)
    assert known is not None and known.straight is None
    set_and_save(learned, {CENTRE: book.kept()[0][-1].trial.params[CENTRE] + 3.0})
    known = measured_before(learned)
    assert known is not None and known.straight is not None


# -- the line, without a fish ---------------------------------------------------------------------


def made(low: float, high: float, sigma: float = 0.01) -> Trim:
    trials = TrimTrial(1466.0, low, sigma), TrimTrial(1534.0, high, sigma)
    return centre_of(trials, 1500.0, "imu", PARAMS)


def test_the_line_and_its_sigma() -> None:
    """By 4000 draws of both turns."""
    found = made(-0.12, -0.49)
    rng = np.random.default_rng(8)
    low, high = -0.12 + 0.01 * rng.standard_normal((2, 4000)) + np.array([[0.0], [-0.37]])
    drawn = 1466 - low * 68 / (high - low)
    assert found.centre_us == pytest.approx(np.median(drawn), abs=0.3)
    assert found.sigma_us == pytest.approx(np.std(drawn), rel=0.1)
    assert found.turn_rad(1500.0) == pytest.approx((-0.12 - 0.49) / 2 * 2.2)
    assert abs(found.turn_rad(found.centre_us)) < 1e-12
    assert "left" in found.text() and "right" in made(0.49, 0.12).text()


@pytest.mark.parametrize(
    ("low", "high"), [(0.1, 0.1), (-0.3, -0.27), (math.nan, 0.1), (0.0, math.nan)]
)
def test_turns_that_tell_no_centre(low: float, high: float) -> None:
    with pytest.raises(InputError, match=r"turned alike.*Nothing was changed"):
        made(low, high)


def test_a_centre_that_is_too_far_off() -> None:
    assert made(-0.9, -1.3).centre_us == pytest.approx(1313, abs=1)
    with pytest.raises(InputError, match=r"too far for a trim.*horn"):
        made(-1.0, -1.3)
    narrow = PARAMS | {"SERVO_MIN_US": 1200.0}
    with pytest.raises(InputError, match="no full swing"):
        centre_of(made(-0.12, -0.49).swims, 1500.0, "imu", narrow)


def test_a_swim_is_as_brisk_as_is_allowed() -> None:
    usual = plan(travel_model_of(PARAMS), PARAMS)
    assert usual.amplitude_rad.max() == pytest.approx(0.5)
    assert np.count_nonzero(usual.amplitude_rad == usual.amplitude_rad.max()) == 8
    assert np.diff(usual.amplitude_rad[:5]).max() < 0.07  # gently
    for more, most in (
        ({"AMP_MAX_RAD": 0.35}, 0.35),
        ({"AMP_MAX_RAD": 1.0}, 0.5),
        ({"SERVO_MIN_US": 1300.0}, 200 / US_RAD - 0.06),
    ):
        found = plan(travel_model_of(PARAMS), PARAMS | more)
        assert found.amplitude_rad.max() <= most + 1e-9
    for tank_m in (1.6, 2.0):
        found = plan(travel_model_of(PARAMS), PARAMS | {"TANK_LEN_M": tank_m})
        assert found.travel.worst_m <= tank_m - 0.36 - 0.15
    with pytest.raises(InputError, match="too short to trim"):
        plan(travel_model_of(PARAMS), PARAMS | {"TANK_LEN_M": 0.7})
    with pytest.raises(InputError, match="hardly move"):
        plan(travel_model_of(PARAMS), PARAMS | {"AMP_MAX_RAD": 0.2})


# -- the command ----------------------------------------------------------------------------------

SIM = ["--connect", "sim:tank?tail_centre_rad=0.1&seed=2"]


def test_the_command_finds_and_sets_only_when_told() -> None:
    told = CliRunner().invoke(app, ["session", "trim", "--json", *SIM])
    document = json.loads(told.stdout)
    assert told.exit_code == 0 and document["applied"] is False and document["held_us"] is None
    assert document["centre_us"] == pytest.approx(1500 - 0.1 * US_RAD, abs=6)
    assert document["turn_before_rad_m"] == pytest.approx(-0.3, abs=0.06)
    again = CliRunner().invoke(app, ["session", "trim", "--apply", "--rest", "5", *SIM])
    assert again.exit_code == 0 and "set for good: SERVO_CENTRE_US 144" in again.stdout


def test_a_real_fish_is_not_swum_unasked(monkeypatch: pytest.MonkeyPatch) -> None:
    usual = Fish.info
    monkeypatch.setattr(Fish, "info", lambda self: replace(usual(self), simulated=False))
    told = CliRunner().invoke(app, ["session", "trim", *SIM])
    assert told.exit_code != 0 and trim.CENTRE not in told.stdout
    assert "--yes" in str(told.exception) + told.stderr
