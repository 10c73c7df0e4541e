"""A fish from a table of steady speeds: Table 8.1 of the thesis, and tables that are none."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from tailbeat.app.cli import run
from tailbeat.core.errors import InputError
from tailbeat.learning.identification import (
    Identified,
    SpeedTable,
    ThesisFish,
    from_table,
    identify_table,
)

AMPLITUDES = (math.pi / 4, 7 * math.pi / 36, 5 * math.pi / 36)
SPEEDS = (0.12762, 0.09282, 0.05117)


@pytest.fixture
def table_8_1(tmp_path: Path) -> Path:
    path = tmp_path / "amplitude.csv"
    rows = [f"{a!r},{v!r}" for a, v in zip(AMPLITUDES, SPEEDS, strict=True)]
    path.write_text("\n".join(["amplitude_rad,speed_m_s", *rows]) + "\n")
    return path


def by_quadrature(amplitude: float) -> tuple[float, float]:
    """H1 and H2 of the thesis's fish by adaptive quadrature over a beat of 1 s."""
    from scipy.integrate import quad

    half = 1000 * (math.pi * 0.165**2 / 4) / 2

    def heave(t: float) -> float:
        angle = amplitude * math.sin(2 * math.pi * t)
        speed = 2 / 3 * math.pi * amplitude * 0.36 * math.cos(2 * math.pi * t)
        return (speed / math.cos(angle) ** 2) ** 2

    def slope(t: float) -> float:
        return math.tan(amplitude * math.sin(2 * math.pi * t)) ** 2

    exact = {"epsabs": 1e-12, "epsrel": 1e-12, "limit": 200}
    return half * quad(heave, 0, 1, **exact)[0], half * quad(slope, 0, 1, **exact)[0]


def test_the_thesis_number(table_8_1: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["session", "identify", "--table", str(table_8_1), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["alpha_kg_m"] == pytest.approx(165.7105, abs=5e-4)
    assert found["kappa_thesis_per_m"] == pytest.approx(414.28, abs=0.01)
    assert found["coast_thesis_s"] == pytest.approx(0.015, abs=5e-4)
    slope, offset = np.polyfit(AMPLITUDES, SPEEDS, 1)
    assert found["slope_m_s_rad"] == pytest.approx(slope, rel=1e-9)
    assert found["dead_zone_rad"] == pytest.approx(-offset / slope, rel=1e-9)
    assert (round(slope, 3), round(-offset / slope, 3)) == (0.219, 0.197)
    assert found["gain_min_m_s_rad"] == pytest.approx(0.199, abs=5e-4)
    assert found["gain_max_m_s_rad"] == pytest.approx(0.239, abs=5e-4)
    misses = [row["line_residual_m_s"] for row in found["rows"]]
    assert sum(misses) == pytest.approx(0, abs=1e-12)
    assert max(map(abs, misses)) == pytest.approx(2.283e-3, abs=1e-6)
    assert "414 1/m" in found["note"] and "15 ms" in found["note"]
    assert set(found["assumed"]) == {"kappa_per_m", "delay_s"}


def test_thrust_against_quadrature() -> None:
    h1, h2 = ThesisFish().thrust_terms(np.array(AMPLITUDES))
    for k, amplitude in enumerate(AMPLITUDES):
        assert (h1[k], h2[k]) == pytest.approx(by_quadrature(amplitude), rel=1e-9)


def test_another_fish(table_8_1: Path) -> None:
    """Drag goes with the density and the tail's area, kappa with one over the mass."""
    usual = from_table(table_8_1)
    dense = from_table(table_8_1, ThesisFish(density_kg_m3=1025.0))
    heavy = from_table(table_8_1, ThesisFish(mass_kg=0.8))
    assert dense.alpha_kg_m == pytest.approx(1.025 * usual.alpha_kg_m, rel=1e-12)
    assert heavy.alpha_kg_m == usual.alpha_kg_m
    assert heavy.kappa_thesis_per_m == pytest.approx(usual.kappa_thesis_per_m / 2, rel=1e-12)


def test_what_is_not_known_is_spread(table_8_1: Path, tmp_path: Path) -> None:
    found = from_table(table_8_1).identified
    assert (found.source, found.assumed) == ("table", ("kappa_per_m", "delay_s"))
    assert found.band["kappa_per_m"] == (5.0, 20.0)
    assert found.band["delay_s"] == (0.1, 0.5)
    assert len(found.models) == 3 * 3 * 4
    slopes = sorted({round(m.slope_m_s_rad, 6) for m in found.models})
    assert slopes[0] == pytest.approx(0.19939, abs=1e-5)  # without the last row
    assert slopes[-1] == pytest.approx(0.23864, abs=1e-5)  # without the first
    assert np.all(np.linalg.eigvalsh(found.covariance) > -1e-12)
    found.save(tmp_path / "fish.json")
    assert Identified.load(tmp_path / "fish.json").models == found.models


def test_rows_in_any_order_and_repeats(table_8_1: Path, tmp_path: Path) -> None:
    lines = table_8_1.read_text().splitlines()
    mixed = tmp_path / "mixed.csv"
    mixed.write_text("\n".join([lines[0], lines[2], "", lines[3], lines[1], lines[1]]) + "\n")
    assert from_table(mixed).alpha_kg_m == from_table(table_8_1).alpha_kg_m


def test_two_rows_are_a_line() -> None:
    found: SpeedTable = identify_table(np.array([0.4, 0.8]), np.array([0.05, 0.13]))
    assert found.line.slope_m_s_rad == pytest.approx(0.2)
    assert found.line.dead_zone_rad == pytest.approx(0.15)
    assert len(found.identified.models) == 9


def test_no_negative_dead_zone() -> None:
    found = identify_table(np.array([0.2, 0.4]), np.array([0.05, 0.06]))
    assert found.line.dead_zone_rad == 0
    assert found.line.slope_m_s_rad == pytest.approx((0.2 * 0.05 + 0.4 * 0.06) / 0.2)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no column amplitude_rad"),
        ("theta,speed_m_s\n0.4,0.05\n", "no column amplitude_rad"),
        ("amplitude_rad,speed_m_s\n", "a header but no numbers"),
        ("amplitude_rad,speed_m_s\n0.4,0.05\n", "1 row of use"),
        ("amplitude_rad,speed_m_s\n0.4,0.05\n0.4,0.06\n", "two amplitudes"),
        ("amplitude_rad,speed_m_s\n0.4,0.05\n0.6,fast\n", "row 3, column speed_m_s: 'fast'"),
        ("amplitude_rad,speed_m_s\n0.4,0.05\n0.6\n", "row 3, column speed_m_s: ''"),
        ("amplitude_rad,speed_m_s\n0.4,0.05\n0.6,nan\n", "row 3, column speed_m_s: 'nan'"),
        ("amplitude_rad,speed_m_s\n0.4,-0.05\n0.6,0.1\n", "row 2, column speed_m_s: -0.05"),
        ("amplitude_rad,speed_m_s\n25,0.05\n45,0.12\n", "does not swing by 25 rad"),
        ("amplitude_rad,speed_m_s\n0.4,0.1\n0.6,0.05\n", "does not rise"),
        ("amplitude_rad,speed_m_s\n0.4,51.17\n0.6,92.8\n", "so fast"),
    ],
)
def test_bad_tables(
    text: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    assert run(["session", "identify", "--table", str(path), "--json"]) == 1
    out, err = capsys.readouterr()
    error = json.loads(out)["error"]
    assert err.startswith(f"tailbeat: {error['message']}") and error["remedy"] in err
    assert says in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("field", ["mass_kg", "length_m", "density_kg_m3", "tail_area_m2"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_a_fish_that_cannot_be(field: str, value: float) -> None:
    with pytest.raises(InputError, match=field):
        identify_table(np.array([0.4, 0.8]), np.array([0.05, 0.13]), ThesisFish(**{field: value}))


@pytest.mark.painted
def test_a_picture(table_8_1: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "map.png"
    assert run(["session", "identify", "--table", str(table_8_1), "--plot", str(picture)]) == 0
    assert capsys.readouterr().out.startswith("alpha 165.71 kg/m")
    assert picture.read_bytes().startswith(b"\x89PNG")
