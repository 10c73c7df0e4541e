"""Random fish: within their ranges, the same for every law, and judged by their own bound."""

from __future__ import annotations

import json
import math
import subprocess
from pathlib import Path

import numpy as np
import pytest

import tailbeat
from tailbeat.app.cli import run
from tailbeat.core.errors import InputError
from tailbeat.core.native import lib
from tailbeat.core.reference import thesis
from tailbeat.learning.error_bound import error_bound
from tailbeat.learning.error_bound_solve import plant_config
from tailbeat.studies.montecarlo.batch import FishBatch, batch_of
from tailbeat.studies.montecarlo.cell import cells, run_cell
from tailbeat.studies.montecarlo.populations import POPULATIONS, draw, still
from tailbeat.studies.montecarlo.recipe import load, parse
from tailbeat.studies.montecarlo.smallest_error import smallest_errors

MOST_RAD = math.pi / 4
WANTED = thesis().speed_m_s.astype(np.float64)


@pytest.mark.parametrize("population", POPULATIONS)
@pytest.mark.parametrize("plant", ["reactive", "tank"])
def test_every_fish_is_one_and_within_the_ranges(population: str, plant: str) -> None:
    known = POPULATIONS[population]
    fish = [draw(population, plant, seed) for seed in range(1, 61)]
    for one in fish:
        assert lib.sim_config_valid(plant_config(plant, one))
        for name, (low, high) in known.ranges.items():
            assert low <= one.get(name, low) <= high
    kappa = np.array([one["kappa_per_m"] for one in fish])
    assert 4 <= kappa.min() < 6 and 15 < kappa.max() <= 20
    assert np.median(kappa) == pytest.approx(math.sqrt(80), rel=0.3), "even in the logarithm"
    assert draw(population, plant, 7) == fish[6] != draw(population, plant, 8)
    assert ("fin_depth_m" in fish[0]) == (plant == "reactive")


def test_still_is_the_same_fish_without_noise() -> None:
    fish = draw("hard", "reactive", 3)
    amplitude = np.full((1, 12), 0.5)

    def speeds(settings: dict[str, float], number: int) -> np.ndarray:
        return FishBatch("reactive", [settings]).run(amplitude, number).true_m_s[0]

    quiet = still(fish) | {"drift_sigma": 0.0, "drift_trend": 0.0}
    assert np.array_equal(speeds(quiet, 1), speeds(quiet, 9))
    assert not np.array_equal(speeds(still(fish), 1), speeds(still(fish), 9)), "it drifts"
    off = np.mean([speeds(fish, number) for number in range(1, 41)], axis=0) / speeds(quiet, 1) - 1
    assert np.abs(off[4:]).max() < 0.1
    assert off[4:].std() > 0


def test_smallest_error_is_that_of_another_solver() -> None:
    """On the first plant, by linear programs in thrust with a table of steady speeds."""
    bound = error_bound(plant_config("tank", {"kappa_per_m": 8.0}), thesis(), MOST_RAD)
    fish = {"kappa_per_m": 8.0, "seed": 1.0}
    start = [np.full(40, 0.4), np.clip(WANTED / 0.219 + 0.2, 0, MOST_RAD)]
    (found, later), amplitude = smallest_errors("tank", fish, WANTED, 1.0, MOST_RAD, start, [1, 2])
    assert found == pytest.approx(bound.minimax_m_s, rel=0.01)
    assert later == pytest.approx(found, rel=0.001), "it does not drift"
    assert amplitude.min() >= 0 and amplitude.max() <= MOST_RAD


RECIPE = """
iterations = 3
seeds = 2
[[plant]]
plant = "tank"
population = "mild"
[[law]]
kind = "model"
[[law]]
kind = "repeats"
"""


def test_a_population_learns_and_is_judged_by_its_own_bound() -> None:
    recipe = parse(RECIPE, "two")
    tables = {cell.law.name: run_cell(recipe, cell) for cell in cells(recipe)}
    model = {name: np.array(tables["model"][name].to_pylist()) for name in (
        "iteration", "seed", "input_max_abs_error_m_s", "floor_minimax_m_s", "refuted",
        "kappa_per_m", "failure",
    )}  # fmt: skip
    learned = model["iteration"] == 3
    assert not any(model["failure"]) and len(set(model["kappa_per_m"])) == 2
    error, bound = model["input_max_abs_error_m_s"][learned], model["floor_minimax_m_s"][learned]
    assert np.all(bound > 0.002) and np.all(error >= bound)
    assert np.all(error <= 1.1 * bound + 0.0005) and not model["refuted"][learned].any()
    repeats = tables["repeats"]
    own = np.array(repeats["input_max_abs_error_m_s"].to_pylist())
    floor = np.array(repeats["floor_minimax_m_s"].to_pylist())
    later = np.array(repeats["iteration"].to_pylist()) > 0
    assert own[later] == pytest.approx(floor[later], rel=0.05), "but for the drift"


def test_refusals(tmp_path: Path) -> None:
    with pytest.raises(Exception, match="there is no population wild"):
        parse(RECIPE.replace("mild", "wild"), "x")
    recipe = parse('reference = "feasible"\n' + RECIPE, "x")
    with pytest.raises(Exception, match="no feasible reference"):
        run_cell(recipe, cells(recipe)[0])
    assert load("populations").plants[0].population == "mild"


FOREIGN = """
#include "tailbeat_plant.h"
uint32_t tailbeat_plant_abi(void) { return TAILBEAT_PLANT_ABI; }
bool tailbeat_plant_trial(uint64_t seed, uint32_t trial, double beat_s, uint32_t beats,
                          const double *amplitude_rad, const double *bias_rad, double *speed_m_s,
                          double *heading_rad) {
    double v = 0, gain = trial ? 1 + 0.02 * (double)((seed * 7 + trial * 13) % 5) / 5 : 1;
    (void)bias_rad;
    if (beats > 512) return false;
    for (uint32_t k = 0; k < beats; k++) {
        double a = amplitude_rad[k], wanted = gain * 0.16 * a / (0.4 + a), sum = 0;
        for (int i = 0; i < 100; i++) {
            v += beat_s / 100 * (wanted - v) * (0.3 + 5 * v);
            sum += v / 100;
        }
        speed_m_s[k] = sum;
        heading_rad[k] = 0;
    }
    return true;
}
"""


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("foreign")
    (folder / "swimmer.c").write_text(FOREIGN)
    include, out = Path(tailbeat.__file__).parent, folder / "swimmer.so"
    command = ["cc", "-std=c11", "-Wall", "-Werror", "-shared", "-fPIC", "-O2", f"-I{include}"]
    subprocess.run([*command, "-o", str(out), str(folder / "swimmer.c")], check=True)
    return out


def test_a_plant_compiled_elsewhere_learns(
    foreign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the command that a user types; the fish is no fish of ours."""
    arguments = [
        "sim",
        "montecarlo",
        "populations",
        "--plant",
        str(foreign),
        "--seeds",
        "2",
        "--pinned",
    ]
    assert run([*arguments, "--out", str(tmp_path / "out"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    (group,) = found["groups"]
    assert group["plant"] == "swimmer" and not found["claims"] and not found["failed_fish"]
    bound_m_s, errors = group["floor_lsq_m_s"], group["median_m_s"]
    assert 0 < bound_m_s < 0.02 and errors[6] < 1.5 * bound_m_s + 0.002
    assert run(["sim", "montecarlo", "--summary", str(tmp_path / "out")]) == 0
    assert "FAILS" not in capsys.readouterr().out


def test_what_is_no_plant_is_refused(foreign: Path, tmp_path: Path) -> None:
    batch = batch_of(str(foreign), [{"seed": 1.0}])
    with pytest.raises(InputError, match="refuses a trial of 600 beats"):
        batch.run(np.zeros((1, 600)), 1)
    (tmp_path / "text.so").write_text("no")
    with pytest.raises(InputError, match="is no plant"):
        batch_of(str(tmp_path / "text.so"), [])
    old = tmp_path / "old.c"
    old.write_text(FOREIGN.replace("return TAILBEAT_PLANT_ABI", "return 99"))
    include = Path(tailbeat.__file__).parent
    library = tmp_path / "old.so"
    command = ["cc", "-shared", "-fPIC", f"-I{include}", "-o", str(library), str(old)]
    subprocess.run(command, check=True)
    with pytest.raises(InputError, match="version 99"):
        batch_of(str(library), [])
