"""The law through the C code, against the same arithmetic in numpy float32."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from tailbeat import laws
from tailbeat.errors import InputError
from tailbeat.laws import Law
from tailbeat.parameters import known_parameters

F = np.float32


def plain_step(law: Law, u: np.ndarray, e: np.ndarray) -> np.ndarray:
    """(8.16) with a lead and a held tail, in float32."""
    lead = law.lead_beats
    ahead = np.concatenate([e[lead:], np.full(lead, e[-1], dtype=F)])
    return np.clip(u, F(0), F(law.amplitude_max_rad)) + F(law.kp_rad_s_m) * ahead


@pytest.mark.parametrize("lead", [0, 1, 3])
def test_update_is_the_thesis_law_bit_for_bit(lead: int) -> None:
    random = np.random.default_rng(lead)
    law = Law(kp_rad_s_m=4, lead_beats=lead)
    u = random.normal(0.4, 0.4, 40).astype(F)
    e = random.normal(0, 0.02, 40).astype(F)
    following, report = laws.update(law, u, e)
    assert following.tobytes() == plain_step(law, u, e).tobytes()
    assert report.max_abs_error_m_s == np.abs(e).max()
    assert report.saturated_beats == np.count_nonzero(u > F(math.pi / 4))


def test_old_input_is_saturated_before_the_correction() -> None:
    following, _ = laws.update(Law(kp_rad_s_m=1), [5.0], [-0.1])
    assert following[0] == pytest.approx(math.pi / 4 - 0.1, abs=1e-6)


def test_unmeasured_beats_keep_their_input() -> None:
    following, report = laws.update(Law(), [0.3, 0.3], [0.1, 99.0], [True, False])
    assert following[1] == F(0.3)
    assert report.measured_beats == 1


def test_first_is_the_gain_times_the_reference() -> None:
    wanted = np.array([0.0, 0.05, 0.0791], dtype=F)
    assert (
        laws.first(Law(kp_rad_s_m=4, step_max_rad=0.01), wanted).tolist()
        == (F(4) * wanted).tolist()
    )


def test_judge_changes_nothing_and_reports_the_same() -> None:
    u = np.array([0.3, 0.9], dtype=F)
    assert laws.judge(Law(), u, [0.01, -0.02]) == laws.update(Law(), u, [0.01, -0.02])[1]
    assert u.tolist() == [F(0.3), F(0.9)]


def test_saturate() -> None:
    assert laws.saturate(Law(amplitude_max_rad=0.5), [-1, 0.25, 2]).tolist() == [0, 0.25, 0.5]


@pytest.mark.parametrize(
    ("law", "u", "e"),
    [
        (Law(kp_rad_s_m=math.nan), [0.1], [0.1]),
        (Law(lead_beats=1), [0.1], [0.1]),
        (Law(q_len=2), [0.1], [0.1]),
        (Law(amplitude_max_rad=0), [0.1], [0.1]),
        (Law(), [math.nan], [0.1]),
        (Law(), [0.1], [math.inf]),
        (Law(), [0.1], [0.1, 0.2]),
        (Law(), [], []),
    ],
)
def test_refusals_have_a_remedy(law: Law, u: list[float], e: list[float]) -> None:
    with pytest.raises(InputError) as caught:
        laws.update(law, u, e)
    assert caught.value.remedy


def test_nothing_measured_is_refused() -> None:
    with pytest.raises(InputError, match="no beat has a measured speed"):
        laws.update(Law(), [0.1], [0.1], [False])


def test_errors_of() -> None:
    error, measured = laws.errors_of([0.1, 0.1], [0.04, math.nan])
    assert error.dtype == F
    assert error.tolist() == [F(0.1) - F(0.04), 0]
    assert measured.tolist() == [True, False]


def test_from_params_takes_the_boards_defaults() -> None:
    params = {name: known.default for name, known in known_parameters().items()}
    law = Law.from_params(params)
    assert (law.kp_rad_s_m, law.amplitude_max_rad, law.lead_beats) == (4, 0.5, 0)
    assert law.step_max_rad == pytest.approx(0.15)


def write(folder: Path, content: object) -> Path:
    path = folder / "law.json"
    path.write_text(json.dumps(content))
    return path


def test_load_knows_fields_parameters_and_short_names(tmp_path: Path) -> None:
    for content in (
        {"kp_rad_s_m": 7, "lead_beats": 1},
        {"LAW_GAIN": 7, "LAW_LEAD": 1},
        {"gain": 7, "lead": 1},
    ):
        assert laws.load(write(tmp_path, content)) == Law(kp_rad_s_m=7, lead_beats=1)
    assert laws.load(write(tmp_path, {"tail": "keep"})).tail == 1


@pytest.mark.parametrize(
    "content",
    [[], {"gamma": 4}, {"gain": "4"}, {"gain": True}, {"lead": 1.5}, {"lead": -1}, {"tail": 2}],
)
def test_load_refuses(tmp_path: Path, content: object) -> None:
    with pytest.raises(InputError) as caught:
        laws.load(write(tmp_path, content))
    assert caught.value.remedy


def test_load_of_no_json(tmp_path: Path) -> None:
    (tmp_path / "law.json").write_text("{")
    with pytest.raises(InputError, match="cannot read"):
        laws.load(tmp_path / "law.json")


def test_label() -> None:
    assert Law().label() == "p4"
    assert Law(kp_rad_s_m=4.6, kd_rad_s2_m=1, lead_beats=1, q_len=3).label() == "p4.6d1-lead1-q3"
