"""The law through the C code, against the same arithmetic in numpy float32."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from tailbeat.core import law as laws
from tailbeat.core.errors import InputError
from tailbeat.core.law import Averaging, Law
from tailbeat.core.law_memory import LawMemory, Memory, first_amplitudes
from tailbeat.link.params import known_parameters

F = np.float32


def plain_step(law: Law, u: np.ndarray, e: np.ndarray) -> np.ndarray:
    """(8.16) with a whole lead and a held tail, in float32."""
    lead = int(law.lead_beats)
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


def error_at(place: float, e: np.ndarray, measured: np.ndarray) -> np.float32:
    """e at a place on the beats' own grid: between two beats their mean, or the measured one."""
    near = sorted({math.floor(place), math.ceil(place)})
    seen = [j for j in near if measured[j]]
    if not seen:
        return F(0)
    return e[seen[0]] if len(seen) == 1 else F(0.5) * (e[seen[0]] + e[seen[1]])


def difference_at(place: float, e: np.ndarray, measured: np.ndarray) -> np.float32:
    """The forward difference there, the last one repeated; 0 where it has an unmeasured end."""
    last = len(e) - 1
    found = []
    for near in (math.floor(place), math.ceil(place)):
        j = min(near, last - 1)
        found.append(e[j + 1] - e[j] if measured[j] and measured[j + 1] else F(0))
    return found[0] if place == int(place) else F(0.5) * (found[0] + found[1])


def contract_step(
    law: Law, u: np.ndarray, e: np.ndarray, measured: np.ndarray, visits: np.ndarray
) -> np.ndarray:
    """The contract of firmware/ilc/law.h without filter and step limit, in float32. Tails: 0 the
    last error, 1 keep, 2 the last new input, 3 the last old one."""
    last = len(u) - 1
    old = np.clip(u, F(0), F(law.amplitude_max_rad))
    out = old.copy()
    held = None
    for k in range(len(u)):
        place = k + law.lead_beats
        if place > last and law.tail:
            if held is not None and law.tail > 1:
                out[k] = (out if law.tail == 2 else old)[held]
            continue
        held = k
        beyond = max(0, int(visits[k]) - law.fade_from)
        fade = F(1) + F(law.fade) * F(beyond)
        proportional = F(law.kp_rad_s_m) / fade * error_at(min(place, last), e, measured)
        kd = F(law.kd_rad_s2_m) / F(law.beat_s) / fade
        out[k] += proportional + kd * difference_at(min(place, last), e, measured)
    return out


@pytest.mark.parametrize("tail", [0, 1, 2, 3])
@pytest.mark.parametrize(("fade", "kd"), [(0.0, 0.0), (0.37, 0.0), (0.2, -1.3)])
@pytest.mark.parametrize("lead", [0, 0.5, 1, 1.5, 2.5, 15.5, 39, 39.5])
def test_half_leads_tails_and_fading_gains_bit_for_bit(
    lead: float, fade: float, kd: float, tail: int
) -> None:
    random = np.random.default_rng(int(10 * lead) + tail)
    law = Law(
        kp_rad_s_m=4.3, kd_rad_s2_m=kd, beat_s=0.7, lead_beats=lead, fade=fade, fade_from=2,
        tail=tail,
    )  # fmt: skip
    for _ in range(20):
        u = random.normal(0.4, 0.4, 40).astype(F)
        e = random.normal(0, 0.02, 40).astype(F)
        measured = random.random(40) > 0.3
        visits = random.integers(0, 256, 40)
        following, _ = laws.update(law, u, e, measured, visits)
        assert following.tobytes() == contract_step(law, u, e, measured, visits).tobytes()


def test_the_next_visits_follow_from_the_trials_of_a_memory() -> None:
    """A gain that fades by 1/k makes the amplitude the mean of what each trial asked for."""
    random = np.random.default_rng(7)
    law = Law(kp_rad_s_m=1, fade=1, fade_from=0, amplitude_max_rad=9)
    wanted = 1 + random.normal(0, 0.1, (20, 1)).astype(F)
    held = np.ones(1, dtype=F)
    for visits, asked in enumerate(wanted):
        memory = Memory(1, held, 0, held, 0.0, 0, np.array([visits], dtype=np.uint8))
        learner = LawMemory.of(memory)
        learner.learn(law, asked - held, [True], True)
        held = learner.amplitude_rad
    assert held[0] == pytest.approx(wanted.mean(), abs=1e-6)


@pytest.mark.parametrize("visits", [[1], [1, 2, 3], [-1, 0], [0, 256]])
def test_visits_that_are_none(visits: list[int]) -> None:
    with pytest.raises(InputError, match="not one per beat"):
        laws.update(Law(), [0.1, 0.1], [0.1, 0.1], visits=visits)


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
        first_amplitudes(Law(kp_rad_s_m=4, step_max_rad=0.01), wanted).tolist()
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
        (Law(lead_beats=0.25), [0.1], [0.1]),
        (Law(lead_beats=math.nan), [0.1], [0.1]),
        (Law(fade=-1), [0.1], [0.1]),
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
    assert (law.kp_rad_s_m, law.amplitude_max_rad, law.lead_beats) == (4, 0.5, 1)
    assert law.step_max_rad == pytest.approx(0.15)
    assert (law.fade, law.fade_from) == (0, 5)
    assert law == Law.from_params({k: v for k, v in params.items() if "FADE" not in k})


def write(folder: Path, content: object) -> Path:
    path = folder / "law.json"
    path.write_text(json.dumps(content))
    return path


def test_load_knows_fields_parameters_and_short_names(tmp_path: Path) -> None:
    for content in (
        {"kp_rad_s_m": 7, "lead_beats": 1},
        {"ILC_GAIN": 7, "ILC_LEAD": 1},
        {"gain": 7, "lead": 1},
    ):
        assert laws.load(write(tmp_path, content)) == Law(kp_rad_s_m=7, lead_beats=1)
    for tail, name in enumerate(("hold", "keep", "hold-new", "hold-old")):
        assert laws.load(write(tmp_path, {"tail": name})).tail == tail
        assert laws.load(write(tmp_path, {"ILC_END_EXT": tail, "ILC_KIND": 0})).tail == tail
    assert laws.load(write(tmp_path, {"lead": 1.5, "fade": 0.1})) == Law(lead_beats=1.5, fade=0.1)


@pytest.mark.parametrize(
    "content",
    [
        [],
        {"gamma": 4},
        {"gain": "4"},
        {"gain": True},
        {"lead": 1.25},
        {"lead": -1},
        {"fade_from": 0.5},
        {"tail": 4},
        {"tail": "drop"},
        {"kind": 1},
        {"ILC_KIND": 2},
        {"kind": False},
    ],
)
def test_load_refuses(tmp_path: Path, content: object) -> None:
    with pytest.raises(InputError) as caught:
        laws.load(write(tmp_path, content))
    assert caught.value.remedy


def test_an_average_of_one_trial_is_refused_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="needs its earlier trials") as caught:
        laws.load(write(tmp_path, {"ILC_KIND": 1}))
    assert "ILC_KIND 1 or 2" in caught.value.remedy


def test_load_of_no_json(tmp_path: Path) -> None:
    (tmp_path / "law.json").write_text("{")
    with pytest.raises(InputError, match="cannot read"):
        laws.load(tmp_path / "law.json")


def test_label() -> None:
    assert Law().label() == "p4"
    assert Law(kp_rad_s_m=4.6, kd_rad_s2_m=1, lead_beats=1, q_len=3).label() == "p4.6d1-lead1-q3"
    assert Law(lead_beats=0.5).label() == "p4-lead0.5"
    assert Law(lead_beats=2.0, fade=0.25).label() == "p4-lead2-fade0.25"
    averages = [Averaging(), Averaging(1), Averaging(2, 5)]
    assert [past.label() for past in averages] == ["", "mean-", "avg5-"]
    assert Averaging.from_params({}) == Averaging()
    assert Averaging.from_params({"ILC_KIND": 2.0, "ILC_WINDOW": 4.0}) == Averaging(2, 4)
