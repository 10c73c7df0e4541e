"""How far the next trial will come: against the simulator's own way, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core import reference
from tailbeat.core.errors import InputError, Refused
from tailbeat.core.reference import thesis, trapezoid
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.experiment.library import TrialLibrary
from tailbeat.learning.identification import any_fish
from tailbeat.session.outcome import Travel
from tailbeat.session.travel import last_measured, travel_next, travel_of
from tailbeat.session.trial import run_trial

THESIS_LIMITS = {"AMP_MAX_RAD": math.pi / 4, "DU_MAX_RAD": 0.0}
ROOM_M = 3.0 - 0.36


def swimmer(plant: str, seed: int, **params: float) -> Fish:
    """Along the thesis's reference; nobody catches the fish."""
    fish = Fish.connect(f"sim:{plant}", seed=seed, caught_after_s=90, placed_after_s=90)
    for name, value in (THESIS_LIMITS | params).items():
        fish.params.set(name, value)
    fish.upload_reference(thesis().record())
    return fish


def swim(fish: Fish, folder: Path) -> tuple[float, Trial]:
    """(true way over ground until the coast is over, its log)."""
    assert fish.sim is not None
    number = run_trial(fish).number  # settling takes as long as the coast
    way_m = fish.sim.world.truth().x_m
    return way_m, read_trial(fish.pull_trial(number, folder))


@pytest.fixture
def tank() -> Iterator[Fish]:
    with swimmer("tank", 3, ILC_GAIN=4, ILC_LEAD=1) as fish:
        yield fish


@pytest.mark.parametrize("plant", ["tank", "thesis"])
def test_gain_ten_does_not_swim_its_first_trial_in_three_metres(plant: str) -> None:
    with swimmer(plant, 1, ILC_GAIN=10) as fish:
        found = travel_next(fish, None)
        assert found.expected_m == pytest.approx(3.35, abs=0.1)
        with pytest.raises(
            InputError, match=r"3\.\d\d m .* tank clearance is 2\.64 m.*AMP_MAX_RAD"
        ):
            found.require_room()
        fish.params.set("TANK_LEN_M", 4.0)
        travel_next(fish, None).require_room()


@pytest.mark.parametrize(("plant", "lead", "gain"), [("tank", 1, 7), ("thesis", 0, 4)])
def test_the_usual_inputs_of_the_thesis_s_reference_fit(
    plant: str, lead: int, gain: float, tmp_path: Path
) -> None:
    """Gain 4 on the tank, and 20 fish of each: below."""
    errors = []
    with swimmer(plant, 2, ILC_GAIN=gain, ILC_LEAD=lead) as fish:
        for iteration in range(1, 4):
            found = travel_next(fish, None)
            found.require_room()
            assert found.expected_m <= found.worst_m
            way_m, _ = swim(fish, tmp_path)
            errors.append(found.expected_m - way_m)
            fish.learn()
            assert iteration == 1 or "trial" in found.by
    print(plant, gain, np.round(errors, 3))
    assert np.abs(errors[1:]).max() < 0.33  # two days' gain and flow apart: 0.11 m, one sigma


def test_nothing_on_the_board_changes_and_arming_makes_what_was_said(tank: Fish) -> None:
    before = tank.status(), tank.params.values()
    found = travel_next(tank, None)
    assert before[0].iteration == tank.status().iteration == 0
    assert before[1] == tank.params.values()
    tank.arm()
    tank.disarm()
    assert travel_next(tank, None) == found
    again = travel_of(tank.amplitudes().values, before[1], 1.0)
    assert again == found
    tank.params.set("ILC_GAIN", 6.0)  # the first amplitudes follow the gain of the moment
    assert travel_next(tank, None).expected_m > found.expected_m + 0.3


def test_the_step_limit_does_not_shorten_a_swim(tank: Fish, tmp_path: Path) -> None:
    """DU_MAX_RAD acts when the board learns; what is uploaded is executed up to AMP_MAX_RAD."""
    tank.params.set("DU_MAX_RAD", 0.05)
    tank.params.set("AMP_MAX_RAD", 0.45)
    tank.upload_reference(reference.cosine(0.06, 3, 2).record())
    tank.upload_amplitudes(np.full(8, 0.6, np.float32))
    found = travel_next(tank, None)
    _, trial = swim(tank, tmp_path)
    assert np.allclose(trial.beats.applied_rad, 0.45)
    assert found == travel_of(np.full(8, 0.45), trial.params, 1.0)


def test_what_a_trial_came_farther_is_expected_again(tank: Fish, tmp_path: Path) -> None:
    params = tank.params.values()
    wanted = reference.cosine(0.06, 8, 2)
    amplitude = np.full(wanted.beats, 0.45)
    tank.upload_reference(wanted.record())
    tank.upload_amplitudes(amplitude.astype(np.float32))
    _, trial = swim(tank, tmp_path)
    for factor in (0.75, 1.0, 1.3):
        speed = (trial.beats.speed_m_s * factor).astype(np.float32)
        last = replace(trial, beats=replace(trial.beats, speed_m_s=speed))
        found = travel_of(amplitude, params, 1.0, last=last)
        measured_m = float(np.nansum(speed))
        coast_m = found.expected_m - measured_m
        assert 0.06 < coast_m < 0.25, factor
    unknown = travel_of(amplitude, params, 1.0)
    assert found.worst_m - found.expected_m < 0.4 * (unknown.worst_m - unknown.expected_m)


def test_a_trial_that_tells_nothing_teaches_nothing(tank: Fish, tmp_path: Path) -> None:
    params = tank.params.values()
    amplitude = np.full(12, 0.45)
    _, trial = swim(tank, tmp_path)
    plain = travel_of(amplitude, params, 1.0)
    for speed in (np.nan, 0.0):
        beats = replace(trial.beats, speed_m_s=np.full(40, speed, np.float32))
        assert travel_of(amplitude, params, 1.0, last=replace(trial, beats=beats)) == plain


def test_the_library_s_trials(tank: Fish, tmp_path: Path) -> None:
    """The one learned from last counts, fetched if need be; discarded ones and runs never."""
    book = TrialLibrary.of(tank.unique_id(), tmp_path)
    assert last_measured(tank, book) is None
    _, first = swim(tank, tmp_path)
    tank.learn()
    found = last_measured(tank, book)
    assert found is not None and found.number == first.number
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Fish, "pull_trial", None)  # a second time it is there
        assert last_measured(tank, book) is found
    book.keep(tmp_path / f"{first.number:04d}.ulg")
    for mark in ("discarded", "run"):
        _, other = swim(tank, tmp_path)
        tank.discard()
        book.keep(tmp_path / f"{other.number:04d}.ulg", mark)
    found = last_measured(tank, book)
    assert found is not None and found.number == first.number
    assert travel_next(tank, book).by.endswith(f"and trial {first.number}")


def test_a_damaged_identification_is_none(tank: Fish, tmp_path: Path) -> None:
    book = TrialLibrary.of(tank.unique_id(), tmp_path)
    plain = travel_next(tank, book)
    (book.folder).mkdir(parents=True, exist_ok=True)
    (book.folder / "identified.json").write_text("{")
    assert travel_next(tank, book) == plain


def test_an_unknown_fish_is_not_refused_what_is_expected_to_fit(tank: Fish) -> None:
    found = travel_next(tank, None)
    assert found.by == "the board's model"
    tank.params.set("ILC_GAIN", 7)
    found = travel_next(tank, None)
    assert found.worst_m > ROOM_M > found.expected_m
    found.require_room()


def test_words() -> None:
    found = Travel(2.212, 2.4, 2.64, "the identified fish")
    assert found.text() == "about 2.21 m, at worst 2.40, of 2.64 m (by the identified fish)"
    assert "of" not in replace(found, room_m=math.inf).text().split("(")[0]
    assert replace(found, expected_m=2.64).fits and not replace(found, expected_m=2.65).fits
    assert replace(found, expected_m=99, room_m=math.inf).fits


def test_without_a_reference() -> None:
    with Fish.connect("sim:tank") as fish, pytest.raises(Refused):
        travel_next(fish, None)


def test_a_tank_that_is_not_checked(tank: Fish) -> None:
    tank.params.set("TANK_LEN_M", 0)
    tank.params.set("ILC_GAIN", 10)
    found = travel_next(tank, None)
    assert math.isinf(found.room_m)
    found.require_room()


@pytest.mark.soak
@pytest.mark.parametrize(("plant", "lead"), [("tank", 1), ("thesis", 0)])
@pytest.mark.parametrize("gain", [4.0, 7.0, 10.0])
def test_expected_against_true(plant: str, lead: int, gain: float, tmp_path: Path) -> None:
    errors, beyond = [], 0
    for seed in range(1, 21):
        params = {"ILC_GAIN": gain, "ILC_LEAD": lead, "TANK_LEN_M": 0, "ROLLBACK_RATIO": 0}
        with swimmer(plant, seed, **params) as fish:
            for _ in range(6):
                found = travel_next(fish, None)
                way_m, _ = swim(fish, tmp_path)
                (tmp_path / f"{fish.status().pending_trial:04d}.ulg").unlink()
                fish.learn()
                errors.append(found.expected_m - way_m)
                beyond += way_m > found.worst_m
    table = np.array(errors).reshape(20, 6)
    print(plant, gain, "mean", table.mean(axis=0).round(3), "max", np.abs(table).max(axis=0))
    assert np.abs(table[:, 1:]).max() < 0.3 and beyond <= 8


def test_what_a_model_will_plan_goes_as_far_as_the_reference(tmp_path: Path) -> None:
    """Where nothing was learned yet the board's own first input may be far from it."""
    with Fish.connect("sim?seed=4") as fish:
        fish.upload_reference(trapezoid(0.04, 5, 20).record())
        book = TrialLibrary.of(fish.unique_id(), tmp_path)
        by_board = travel_next(fish, book, planned=True).expected_m
        assert by_board == travel_next(fish, book).expected_m
        book.set_identified(replace(any_fish(), source="runs"))
        planned_m = travel_next(fish, book, planned=True).expected_m
        assert planned_m == pytest.approx(1.0, abs=0.08)
        assert abs(by_board - 1.0) > 0.2
