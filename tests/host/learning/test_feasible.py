"""The nearest reference that a fish can follow, judged by the simulator's plant."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tailbeat.app.cli import run
from tailbeat.core import reference
from tailbeat.core.errors import InputError
from tailbeat.core.reference import ReferenceLimits, from_csv
from tailbeat.learning.error_bound import (
    TARGET_M_S,
    Suggestion,
    error_bound,
    lsq_max_abs_m_s,
    suggest,
)
from tailbeat.learning.error_bound_solve import plant_config
from tailbeat.learning.fish_model import FishModel
from tailbeat.learning.identification import Identified

AMPLITUDE_MAX_RAD = math.pi / 4
TANK = FishModel(10.0, 0.219, 0.197, 0.3)
REFERENCES = [
    "thesis",
    "trapezoid:0.08,0,20",
    "trapezoid:0.08,5,20",
    "trapezoid:0.15,5,5",
    "trapezoid:0.08,5,40",
    "cosine:0.2,20,0",
    "cosine:0.08,3,2",
]
FISH = [TANK, FishModel(10, 0.219, 0.197, 0.8), FishModel(5, 0.219, 0.197, 1.3)]


def identified(*models: FishModel) -> Identified:
    return Identified(models[0], list(models), np.eye(4))


def acceleration(found: Suggestion) -> np.ndarray:
    return np.diff(found.v_m_s) / np.diff(found.t_s)


@pytest.mark.parametrize("kappa", [5.0, 10.0, 20.0])
def test_the_thesis_made_feasible(kappa: float) -> None:
    wanted = reference.thesis()
    found = suggest(replace(TANK, kappa_per_m=kappa), wanted, AMPLITUDE_MAX_RAD)
    config = plant_config("tank", {"kappa_per_m": kappa})
    left = error_bound(config, found.reference, AMPLITUDE_MAX_RAD)
    assert left.lsq_max_abs_m_s < 0.0005
    assert left.spots == ()
    assert found.reference.beats == wanted.beats
    assert found.reference.speed_m_s[11:29] == pytest.approx(wanted.speed_m_s[11:29], abs=1e-5)
    assert found.reference.check(ReferenceLimits()) == []
    assert left.lsq_input[1:39].min() > 0.197  # it swims to the end: learning has a grip


@pytest.mark.parametrize("kappa", [5.0, 10.0, 20.0])
def test_a_fish_with_a_fifth_less_drag_still_follows(kappa: float) -> None:
    found = suggest(replace(TANK, kappa_per_m=kappa), reference.thesis(), AMPLITUDE_MAX_RAD)
    slippery = plant_config("tank", {"kappa_per_m": 0.8 * kappa})
    assert lsq_max_abs_m_s(slippery, found.reference, AMPLITUDE_MAX_RAD) < 0.0015


def test_a_bent_map_and_a_slow_servo_follow_too() -> None:
    """A slow servo swings less than commanded, which widens the dead zone."""
    wrong = {"map_bend_m_s_rad2": 0.15, "slope_m_s_rad": 0.15, "servo_lag_s": 0.12}
    config = plant_config("tank", {"kappa_per_m": 5.0, **wrong})
    found = suggest(replace(TANK, kappa_per_m=5.0), reference.thesis(), AMPLITUDE_MAX_RAD)
    assert lsq_max_abs_m_s(config, found.reference, AMPLITUDE_MAX_RAD) < 0.0005


@pytest.mark.parametrize("fish", FISH, ids=str)
@pytest.mark.parametrize("text", REFERENCES)
def test_any_shape(text: str, fish: FishModel) -> None:
    wanted = reference.from_text(text)
    found = suggest(fish, wanted, AMPLITUDE_MAX_RAD)
    assert found.floor_m_s <= TARGET_M_S
    assert found.floor_m_s == lsq_max_abs_m_s(fish, found.reference, AMPLITUDE_MAX_RAD)
    assert found.reference.check(ReferenceLimits()) == []
    assert found.floor_m_s < lsq_max_abs_m_s(fish, wanted, AMPLITUDE_MAX_RAD)


@pytest.mark.parametrize("text", REFERENCES)
def test_speed_and_slope_are_continuous(text: str) -> None:
    found = suggest(TANK, reference.from_text(text), AMPLITUDE_MAX_RAD)
    slope = acceleration(found)
    assert found.v_m_s[0] == 0
    assert slope[0] == 0
    # a jump would stay as large as it is on a grid 20 times finer than a beat
    assert np.abs(np.diff(slope)).max() < 0.15 * np.abs(slope).max()
    coast = -10.0 * found.v_m_s**2
    assert np.all(slope >= np.minimum(coast[1:], coast[:-1]) - 5e-4)


def test_nothing_moves_before_the_thrust_comes() -> None:
    found = suggest(replace(TANK, delay_s=1.3), reference.thesis(), AMPLITUDE_MAX_RAD)
    assert np.all(found.v_m_s[found.t_s < 1.3] == 0)


def test_a_reference_within_reach_stays() -> None:
    wanted = reference.thesis()
    agile = FishModel(400.0, 0.219, 0.197, 0.0)
    found = suggest(agile, wanted, AMPLITUDE_MAX_RAD)
    assert found.reference.speed_m_s == pytest.approx(wanted.speed_m_s, abs=0.0011)


def test_the_least_drag_of_the_identified_set_counts() -> None:
    models = [replace(TANK, kappa_per_m=k) for k in np.linspace(6, 14, 21)]
    sure, unsure = identified(TANK), identified(TANK, *models)
    ends = [suggest(who, reference.thesis(), AMPLITUDE_MAX_RAD) for who in (sure, unsure)]
    assert ends[0].v_m_s[-1] < ends[1].v_m_s[-1]
    slippery = replace(TANK, kappa_per_m=6.4)
    assert lsq_max_abs_m_s(slippery, ends[1].reference, AMPLITUDE_MAX_RAD) <= TARGET_M_S
    assert lsq_max_abs_m_s(slippery, ends[0].reference, AMPLITUDE_MAX_RAD) > TARGET_M_S


def test_a_short_tank_shortens_the_cruise() -> None:
    found = suggest(TANK, reference.thesis(), AMPLITUDE_MAX_RAD, ReferenceLimits(tank_m=2.0))
    assert found.reference.travel_m + 0.36 <= 2.0
    assert found.reference.beats < 40
    assert float(found.reference.speed_m_s.max()) == pytest.approx(0.0791, rel=1e-3)
    assert "fewer, to fit into the tank" in found.changes[0]


def test_a_tank_too_short_for_the_ramps_slows_it() -> None:
    found = suggest(
        TANK, reference.cosine(0.08, 15, 0), AMPLITUDE_MAX_RAD, ReferenceLimits(tank_m=1.0)
    )
    assert found.reference.travel_m + 0.36 <= 1.0


def test_a_small_amplitude_slows_the_cruise() -> None:
    found = suggest(TANK, reference.thesis(), 0.5)
    assert float(found.reference.speed_m_s.max()) <= 0.219 * (0.5 - 0.197)
    assert found.floor_m_s <= TARGET_M_S
    assert "instead of 79.1" in found.changes[0]


def test_the_words_are_true() -> None:
    wanted = reference.thesis()
    found = suggest(TANK, wanted, AMPLITUDE_MAX_RAD)
    late = float((found.reference.speed_m_s - wanted.speed_m_s)[35:].max()) * 1e3
    assert found.changes[-2:] == (
        f"beats 35 to 39 up to {late:.1f} mm/s faster",
        f"ends at {found.v_m_s[-1] * 1e3:.1f} mm/s",
    )


def test_twice_the_same(tmp_path: Path) -> None:
    first, second = (suggest(TANK, reference.thesis(), AMPLITUDE_MAX_RAD) for _ in range(2))
    assert first.reference.crc == second.reference.crc
    first.to_csv(tmp_path / "a.csv")
    assert from_csv(tmp_path / "a.csv").crc == first.reference.crc


@pytest.mark.parametrize(
    ("text", "amplitude_max", "limits", "words"),
    [
        ("thesis", 0.19, ReferenceLimits(), "give this fish no thrust"),
        ("thesis", 0.7, ReferenceLimits(tank_m=0.3), "no longer than the fish"),
        ("trapezoid:0.08,0,1", 0.7, ReferenceLimits(), "before this fish is under way"),
    ],
)
def test_what_cannot_be(
    text: str, amplitude_max: float, limits: ReferenceLimits, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        suggest(TANK, reference.from_text(text), amplitude_max, limits)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "fish.json"
    identified(TANK, replace(TANK, kappa_per_m=9.5), replace(TANK, kappa_per_m=10.5)).save(path)
    return path


def check(*words: str) -> int:
    return run(["reference", "check", *words])


def test_check_without_a_board(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert check("thesis", "--identified", str(file), "--amp-max", "0.785") == 0
    fits, told, where, hint = capsys.readouterr().out.splitlines()
    assert fits.startswith("fits: 40 beats")
    assert told.startswith("error bound 10.4 mm/s (")
    assert told.endswith("the L2-optimal input leaves 11.3")
    assert where == "  beats 37-39: up to 11.3 mm/s too fast: drag alone slows it"
    assert "--suggest" in hint
    fast = ("trapezoid:0.09,8,10", "--identified", str(file), "--amp-max", "0.5")
    assert check(*fast) == 0
    (saturation,) = (s for s in capsys.readouterr().out.splitlines() if s.startswith("saturation"))
    assert "reference.csv" not in saturation, "the board's, which was not asked"
    assert saturation.endswith(f"tailbeat reference check {' '.join(fast)} --suggest")


def test_check_suggests(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "better.csv"
    words = ("thesis", "--identified", str(file), "--amp-max", "0.785", "--suggest")
    assert check(*words, "--out", str(out), "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["floor"]["lsq_max_abs_m_s"] == pytest.approx(0.01126, rel=1e-2)
    assert document["floor"]["spots"][0]["why"] == "drag alone slows it"
    found = document["suggestion"]
    assert found["floor_lsq_m_s"] < 0.001
    assert found["path"] == str(out)
    assert from_csv(out).crc == found["crc"]
    assert check(str(out), "--identified", str(file), "--amp-max", "0.785") == 0
    assert "too fast" not in capsys.readouterr().out


def test_check_suggests_for_a_tank_too_short(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("thesis", "--identified", str(file), "--amp-max", "0.785", "--tank", "2")
    assert check(*words) == 1
    assert "the tank has 2.00 m" in capsys.readouterr().err
    out = tmp_path / "short.csv"
    assert check(*words, "--suggest", "--out", str(out)) == 0
    assert "beats of the cruise fewer" in capsys.readouterr().out
    assert from_csv(out).travel_m < 1.64


def test_check_of_a_fish_nobody_identified(capsys: pytest.CaptureFixture[str]) -> None:
    assert check("trapezoid:0.05,5,5", "--connect", "sim:tank") == 0
    assert "error bound unknown" in capsys.readouterr().out
    assert check("trapezoid:0.05,5,5", "--connect", "sim:tank", "--suggest") == 1
    assert "tailbeat session identify" in capsys.readouterr().err
