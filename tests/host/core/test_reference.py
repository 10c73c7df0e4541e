"""References: exact beat means, and clear words about bad input."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from tailbeat.core import reference
from tailbeat.core.errors import InputError
from tailbeat.core.records import decode_reference
from tailbeat.core.reference import Reference, ReferenceLimits


def test_thesis_is_the_exact_mean_of_8_31() -> None:
    made = reference.thesis()
    for beat in (0, 5, 9, 10, 20, 29, 30, 35, 39):
        integral, _ = quad(
            lambda t: float(reference.thesis_speed(np.array([t]))[0]), beat, beat + 1, epsabs=1e-14
        )
        assert made.speed_m_s[beat] == np.float32(integral) or made.speed_m_s[
            beat
        ] == pytest.approx(integral, rel=1e-6)
    assert made.speed_m_s.dtype == np.float32
    assert made.beats == 40
    assert made.travel_m == pytest.approx(2.203, abs=1e-3)


def test_thesis_fits_the_default_tank() -> None:
    assert reference.thesis().check(ReferenceLimits()) == []


def test_trapezoid_beat_means() -> None:
    made = reference.trapezoid(0.1, 2.0, 3.0)
    expected = np.array([0.025, 0.075, 0.1, 0.1, 0.1, 0.075, 0.025], dtype=np.float32)
    np.testing.assert_allclose(made.speed_m_s, expected, rtol=1e-6)


def test_trapezoid_without_ramps_is_constant() -> None:
    np.testing.assert_allclose(reference.trapezoid(0.1, 0, 3).speed_m_s, [0.1] * 3, rtol=1e-6)


def test_cosine_is_symmetric_and_covers_what_it_should() -> None:
    made = reference.cosine(0.08, 4.0, 10.0)
    np.testing.assert_allclose(made.speed_m_s, made.speed_m_s[::-1], rtol=1e-5)
    assert made.travel_m == pytest.approx(0.08 * 14, rel=1e-6)
    assert made.speed_m_s[4:14] == pytest.approx(0.08, rel=1e-6)


def test_a_begun_beat_counts() -> None:
    assert reference.trapezoid(0.1, 1.0, 1.5).beats == 4


@pytest.mark.parametrize("values", [(-1, 1, 1), (0.1, -1, 1), (0.1, float("nan"), 1), (0.1, 0, 0)])
def test_shapes_that_make_no_sense(values: tuple[float, float, float]) -> None:
    with pytest.raises(InputError):
        reference.trapezoid(*values)


def csv(folder: Path, text: str) -> Path:
    path = folder / "swim.csv"
    path.write_text(text)
    return path


def test_csv_means_are_exact(tmp_path: Path) -> None:
    made = reference.from_csv(csv(tmp_path, "t_s,v_m_s\n0,0\n0.5,0.1\n2,0.1\n3,0\n"))
    np.testing.assert_allclose(made.speed_m_s, [0.075, 0.1, 0.05], rtol=1e-6)
    assert made.name == "swim"


def test_csv_holds_the_last_speed_to_the_end_of_its_beat(tmp_path: Path) -> None:
    made = reference.from_csv(csv(tmp_path, "t_s,v_m_s,remark\n0,0.1,a\n1.9,0.1,b\n"))
    np.testing.assert_allclose(made.speed_m_s, [0.1, 0.1], rtol=1e-6)


def test_csv_with_byte_order_mark_and_blank_lines(tmp_path: Path) -> None:
    assert reference.from_csv(csv(tmp_path, "\ufefft_s, v_m_s\n\n0,0\n1,0.1\n\n")).beats == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        ("t_s,v_m_s\n", "no numbers"),
        ("0,0\n1,0.1\n", "row 1: the header has no column t_s"),
        ("t_s,speed\n0,0\n", "row 1: the header has no column v_m_s"),
        ("t_s,v_m_s\n0,0\n1,nan\n", "row 3, column v_m_s: 'nan' is no finite number"),
        ("t_s,v_m_s\n0,0\n1,inf\n", "row 3, column v_m_s"),
        ("t_s,v_m_s\n0,0\n1,-0.1\n", "row 3, column v_m_s: -0.1 is less than 0"),
        ("t_s,v_m_s\n0,0\n2,0.1\n1,0.1\n", "row 4, column t_s: 1 does not come after 2"),
        ("t_s,v_m_s\n0,0\n1,0.1\n1,0.2\n", "row 4, column t_s"),
        ("t_s,v_m_s\n0,0\n1,fast\n", "row 3, column v_m_s: 'fast' is no finite number"),
        ("t_s,v_m_s\n0,0\n1\n", "row 3, column v_m_s: '' is no finite number"),
        ("t_s,v_m_s\n5,0\n6,0.1\n", "row 2, column t_s: the first time is 5"),
        ("t_s,v_m_s\n0,0\n", "one point only"),
        ("t_s,v_m_s\n0,0\n1e9,0.1\n", "more than 512 beats"),
        ("beat,t_s,v_m_s\n0,0,0\n1,1,0.1\n", "column t_s: 0 is not the middle of beat 0"),
        ("beat,t_s,v_m_s\n0,0.5,0\n2,2.5,0.1\n", "column t_s: 2.5 is not the middle of beat 1"),
        ("beat,t_s,v_m_s\n" + "".join(f"{k},{k + 0.5},0\n" for k in range(513)), "513 beats"),
    ],
)
def test_csv_that_is_refused(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        reference.from_csv(csv(tmp_path, text))
    assert words in caught.value.message
    assert caught.value.remedy


@settings(max_examples=60, deadline=None)
@given(
    beat_s=st.one_of(st.sampled_from([1.0, 0.7, 1 / 3]), st.floats(0.1, 10.0)),
    speeds=st.lists(st.floats(0.0, 0.5, width=32), min_size=1, max_size=512),
)
def test_what_is_written_is_read_again(
    tmp_path_factory: pytest.TempPathFactory, beat_s: float, speeds: list[float]
) -> None:
    made = Reference(beat_s, np.array(speeds, np.float32), "made")
    path = tmp_path_factory.mktemp("csv") / "swim.csv"
    made.to_csv(path)
    found = reference.from_text(str(path))
    assert found.record() == made.record() and found.crc == made.crc
    assert (found.beat_s, found.name) == (beat_s, "swim")


def test_beat_means_that_another_program_has_rounded(tmp_path: Path) -> None:
    found = reference.from_csv(csv(tmp_path, "t_s,beat,v_m_s\n0.25,0,0.05\n0.7502,1,0.06\n"))
    assert found.beat_s == 0.5
    np.testing.assert_array_equal(found.speed_m_s, np.array([0.05, 0.06], np.float32))


def test_missing_and_binary_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read"):
        reference.from_csv(tmp_path / "none.csv")
    (tmp_path / "x.csv").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InputError, match="cannot read"):
        reference.from_csv(tmp_path / "x.csv")


def test_record_carries_the_values_bit_for_bit() -> None:
    made = reference.thesis()
    found = decode_reference(made.record())
    assert found.beat_s == 1.0
    assert found.speed_m_s.tobytes() == made.speed_m_s.tobytes()
    assert found.crc == made.crc


@pytest.mark.parametrize(
    ("speeds", "limits", "words"),
    [
        ([], ReferenceLimits(), "0 beats"),
        ([0.1] * 513, ReferenceLimits(tank_m=0), "513 beats"),
        ([0.1, 0.4], ReferenceLimits(), "beat 1 wants 400.0 mm/s"),
        ([0.1, -0.1], ReferenceLimits(), "beat 1 wants -100.0 mm/s"),
        ([float("nan")], ReferenceLimits(), "beat 0 has no finite speed"),
        ([0.1] * 27, ReferenceLimits(), "travels 2.70 m"),
    ],
)
def test_check_finds(speeds: list[float], limits: ReferenceLimits, words: str) -> None:
    made = Reference(1.0, np.array(speeds, dtype=np.float32), "x")
    problems = made.check(limits)
    assert any(words in str(problem) for problem in problems)
    assert all(problem.remedy for problem in problems)


def test_a_tank_of_0_m_is_not_checked() -> None:
    made = Reference(1.0, np.full(100, 0.1, dtype=np.float32), "x")
    assert made.check(ReferenceLimits(tank_m=0)) == []


def test_from_text(tmp_path: Path) -> None:
    assert reference.from_text("thesis").beats == 40
    assert reference.from_text("cosine:0.08,8,20").beats == 36
    for text in ("cosine:0.08", "trapezoid:a,b,c", str(tmp_path / "none.csv")):
        with pytest.raises(InputError):
            reference.from_text(text)


def test_to_csv_has_units_in_the_header(tmp_path: Path) -> None:
    reference.thesis().to_csv(tmp_path / "out.csv")
    lines = (tmp_path / "out.csv").read_text().splitlines()
    assert lines[0] == "beat,t_s,v_m_s"
    assert len(lines) == 41
    assert np.float32(lines[21].split(",")[2]) == np.float32(0.0791)


@pytest.mark.parametrize(
    ("text", "beats"),
    [
        ("thesis:0.06,600", "600"),
        ("trapezoid:0.06,5,1e9", "1.0e+09"),
        ("thesis:0.06,1e300", "1.0e+300"),
        ("cosine:0.06,5,510", "520"),
    ],
)
def test_more_beats_than_the_board_takes(text: str, beats: str) -> None:
    """Before a beat of them is computed."""
    with pytest.raises(InputError, match=re.escape(f"has {beats} beats; 1 to 512 fit")):
        reference.from_text(text)
