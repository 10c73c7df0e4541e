"""The main job on the simulated board."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tailbeat.app.demo import DemoOptions, DemoResult, Mismatch, compare, run_demo
from tailbeat.app.demo_laws import run_both
from tailbeat.core import law as laws
from tailbeat.core.errors import InputError
from tailbeat.core.law import Law
from tailbeat.experiment.analysis import analyse
from tailbeat.experiment.folder import Experiment
from tailbeat.report.replay import replay

GOLDEN_M_S = {
    4: [0.0791, 0.0353, 0.0139, 0.0049, 0.0018, 0.0010, 0.0010],
    7: [0.0791, 0.0021, 0.0013, 0.0011, 0.0010, 0.0010, 0.0010],
    10: [0.0791, 0.0483, 0.0373, 0.0245, 0.0181, 0.0123, 0.0089],
}


@pytest.mark.parametrize("gain", [4, 7, 10])
def test_golden_series_of_the_thesis_plant(gain: int, tmp_path: Path) -> None:
    result = run_demo(DemoOptions("thesis", gain=gain, trials=6, out=tmp_path))
    assert (result.lead, len(result.trials)) == (0, 7)
    for row, golden in zip(result.trials, GOLDEN_M_S[gain], strict=True):
        limit = max(0.02 * golden, 0.0002)
        assert row.max_abs_error_m_s == pytest.approx(golden, abs=limit)
        assert row.true_max_abs_error_m_s == pytest.approx(golden, abs=limit)


@pytest.fixture(scope="module")
def tank(tmp_path_factory: pytest.TempPathFactory) -> tuple[DemoResult, Path]:
    folder = tmp_path_factory.mktemp("tank")
    seen: list[float] = []
    result = run_demo(DemoOptions(trials=3, out=folder), lambda done, _: seen.append(done))
    assert seen == sorted(seen)
    return result, folder


def test_document_has_the_promised_keys(tank: tuple[DemoResult, Path]) -> None:
    document = json.loads(json.dumps(tank[0].as_dict(), allow_nan=False))
    assert list(document) == [
        "plant", "gain", "lead", "seed", "floor_m_s", "floor_lsq_m_s", "trials", "report",
    ]  # fmt: skip
    assert list(document["trials"][1]) == [
        "iteration", "trial", "max_abs_error_m_s", "rms_error_m_s", "true_max_abs_error_m_s",
        "max_abs_error_25hz_m_s", "saturated_beats", "distance_m", "duration_s", "end",
    ]  # fmt: skip
    assert (document["plant"], document["lead"]) == ("tank", 1)
    assert document["floor_m_s"] == pytest.approx(0.0104, rel=0.01)


def test_iteration_0_is_listed_but_not_swum(tank: tuple[DemoResult, Path]) -> None:
    zero, first = tank[0].trials[:2]
    assert (zero.iteration, zero.trial, zero.duration_s) == (0, 0, 0)
    assert zero.max_abs_error_m_s == np.float32(0.0791)
    assert (first.iteration, first.duration_s, first.end) == (1, 40, "complete")


@pytest.mark.painted
def test_folder_is_an_experiment_with_a_report(
    tank: tuple[DemoResult, Path], tmp_path: Path
) -> None:
    result, folder = tank
    experiment = Experiment.open(folder)
    assert experiment.damaged() == []
    assert [trial.iteration for trial in experiment.trials()] == [1, 2, 3]
    assert experiment.settings()["params"]["ILC_LEAD"] == 1
    assert [row.decision for row in analyse(experiment).rows] == ["keep"] * 3
    again = replay(experiment, tmp_path)
    assert again.identical and again.learned == again.recomputed == [1, 2, 3]
    assert result.report == folder / "report" / "report.html"
    page = result.report.read_text()
    assert "simulated" in page and "sim-tank learns the thesis speed profile" in page


@pytest.mark.painted
def test_both_laws_on_the_same_fish(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same number of runs each; measuring the fish counts. The trial libraries of the user
    have nothing of it: a second demo finds the fish as unknown as the first did."""
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "library"))
    seen: list[float] = []
    both = run_both(DemoOptions(trials=4, out=tmp_path), lambda done, _: seen.append(done))
    assert seen == sorted(seen) and seen[-1] == 1.0
    document = json.loads(json.dumps(both.as_dict(), allow_nan=False))
    p_law, start = document["laws"]
    assert p_law["law"] == "P law, gain 4, lead 1", "the thesis has no lead"
    assert (p_law["measuring_runs"], len(p_law["max_abs_error_m_s"])) == (0, 4)
    assert (start["measuring_runs"], len(start["max_abs_error_m_s"])) == (3, 1)
    assert start["max_abs_error_m_s"][0] < 0.5 * p_law["max_abs_error_m_s"][1]
    assert both.runs[1].run_of(both.runs[1].best) == 4
    assert both.figure.read_bytes().startswith(b"\x89PNG")
    assert all(report.is_file() for report in both.reports)
    assert not (tmp_path / "library").exists()


def test_same_seed_same_run(tank: tuple[DemoResult, Path], tmp_path: Path) -> None:
    again = run_demo(DemoOptions(trials=2, out=tmp_path))
    assert again.trials == tank[0].trials[:3]
    other = run_demo(DemoOptions(trials=1, seed=9, out=tmp_path))
    assert other.trials[1] != again.trials[1]


def test_somebody_elses_folder_is_left_alone(tmp_path: Path) -> None:
    made = Experiment.at(tmp_path, "fish", "thesis", "p4")
    made.add_raw("0001.ulg", b"precious")
    with pytest.raises(InputError, match="no demo made"):
        run_demo(DemoOptions(trials=1, out=tmp_path))
    assert made.damaged() == []


def test_no_trials(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        run_demo(DemoOptions(trials=0, out=tmp_path))
    assert list(tmp_path.iterdir()) == []


def test_a_bit_of_difference_is_noticed(tank: tuple[DemoResult, Path]) -> None:
    first, second, _ = Experiment.open(tank[1]).trials()
    law = Law.from_params(first.params)
    learned = second.beats.amplitude_rad
    compare(first, law, learned)
    with pytest.raises(Mismatch, match="the amplitudes"):
        compare(first, law, np.nextafter(learned, np.float32(9)))
    with pytest.raises(Mismatch, match="the amplitudes"):
        compare(first, replace(law, kp_rad_s_m=4.0001), learned)
    fading, visits = replace(law, fade=0.5, fade_from=0), np.full(40, 2, dtype=np.uint8)
    error, measured = laws.errors_of(first.beats.reference_m_s, first.beats.speed_m_s)
    faded, _ = laws.update(fading, first.beats.amplitude_rad, error, measured, visits)
    compare(first, fading, faded, visits=visits)
    with pytest.raises(Mismatch, match="the amplitudes"):
        compare(first, fading, faded)
    first.beats.speed_m_s[7] = np.nextafter(first.beats.speed_m_s[7], np.float32(9))
    with pytest.raises(Mismatch, match="beat means"):
        compare(first, law, learned)


def test_what_the_address_says_about_the_simulator_holds(tmp_path: Path) -> None:
    url = "sim:tank?seed=9&kappa=6"
    told = run_demo(DemoOptions(trials=1, seed=9, connect=url, out=tmp_path / "a"))
    same = DemoOptions(trials=1, seed=9, overrides={"kappa": 6.0}, out=tmp_path / "b")
    expected = run_demo(same)
    assert told.seed == 9
    assert told.floor_m_s == expected.floor_m_s
    assert told.trials == expected.trials


def test_plant_and_seed_hold_for_a_simulated_address(tmp_path: Path) -> None:
    options = DemoOptions("thesis", seed=5, trials=1, connect="sim", out=tmp_path)
    result = run_demo(options)
    assert (result.plant, result.seed, result.lead) == ("thesis", 5, 0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (DemoOptions("tank", connect="tcp:127.0.0.1:1"), "plant given for a board that is not"),
        (DemoOptions(seed=1, connect="/dev/x"), "seed given for a board that is not"),
        (DemoOptions(overrides={"kappa": 5.0}, connect="udp:5"), "simulator values given"),
        (DemoOptions("tank", connect="sim:thesis"), "two plants"),
        (DemoOptions(seed=2, connect="sim?seed=3"), "seed is given as 3 and as 2"),
    ],
)
def test_what_does_not_belong_to_the_board_is_refused(options: DemoOptions, message: str) -> None:
    with pytest.raises(InputError, match=message):
        run_demo(options)
