"""Speeds measured after the trial: what files may say, and what reaches the board."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.app.cli import run
from tailbeat.board.fish import Fish
from tailbeat.core.arrays import F64
from tailbeat.core.csv import BeatSpeeds, read_speeds
from tailbeat.core.errors import InputError, Refused
from tailbeat.core.native import ffi, lib
from tailbeat.core.trial_file import read_trial
from tailbeat.sensors.camera import speed as smoother
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport

Floats = F64
Write = Callable[[str], Path]

HEADER = ",".join(smoother.COLUMNS)


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def put(text: str) -> Path:
        path = tmp_path / "speed.csv"
        path.write_text(text)
        return path

    return put


def rows(
    t: Floats, v: Floats, sigma: Floats | float = 0.001, window: float = 1.0, trial: str = "3"
) -> str:
    sigmas = np.broadcast_to(sigma, t.shape)
    lines = [
        f"{a:.6f},{float(b)!r},{float(s)!r},{window},{trial}"
        for a, b, s in zip(t, v, sigmas, strict=True)
    ]
    return "\n".join([HEADER, *lines]) + "\n"


def curve(t: Floats) -> Floats:
    return np.asarray(0.05 + 0.02 * np.sin(t) + 0.003 * t)


TENTHS = np.arange(-5, 66) / 10  # six beats, and half a beat more at either end


def test_a_window_of_one_beat_gives_the_value_in_its_middle(write: Write) -> None:
    sigma = 0.001 + 1e-4 * TENTHS**2
    found = read_speeds(write(rows(TENTHS, curve(TENTHS), sigma)), 6, 1.0, 3)
    middle = np.arange(6) + 0.5
    np.testing.assert_allclose(found.speed_m_s, curve(middle), rtol=1e-6)
    assert found.sigma_m_s is not None
    np.testing.assert_allclose(found.sigma_m_s, 0.001 + 1e-4 * middle**2, rtol=1e-6)
    assert found.measured == 6


def test_between_two_rows_the_middle_is_interpolated(write: Write) -> None:
    t = TENTHS + 0.03
    found = read_speeds(write(rows(t, 0.01 * t)), 6, 1.0, 3)
    np.testing.assert_allclose(found.speed_m_s, 0.01 * (np.arange(6) + 0.5), rtol=1e-5)


@pytest.mark.parametrize("window_s", [0.0, 0.2, 0.5, 0.9])
def test_a_shorter_window_is_averaged_as_the_board_does(write: Write, window_s: float) -> None:
    """Against firmware/speed: the same rows as slots of 0.1 s."""
    t = np.arange(80) / 10 + 0.05
    v = np.round(curve(t - 1), 6)
    speed = ffi.new("speed_t *")
    config = ffi.new("speed_config_t *", [window_s, 0.15, 1.0])
    lib.speed_init(speed)
    for at, value in zip(t, v, strict=True):
        assert lib.speed_add(speed, config, [float(at), float(value), 0.002])
        if at < 7.8:
            lib.speed_close_slot(speed, ffi.NULL)
    board = [lib.speed_beat(speed, config, float(k), 1.0) for k in range(1, 7)]
    found = read_speeds(write(rows(t - 1, v, 0.002, window_s)), 6, 1.0, 3)
    np.testing.assert_allclose(found.speed_m_s, [b.speed_m_s for b in board], atol=2e-6)
    assert found.sigma_m_s is not None
    if window_s > 0:
        np.testing.assert_allclose(found.sigma_m_s, [b.sigma_m_s for b in board], rtol=0.06)
    else:  # the board takes rows for independent, a file's may share their noise
        np.testing.assert_allclose(found.sigma_m_s, 0.002, rtol=1e-6)


def test_a_hole_leaves_its_beats_unmeasured(write: Write) -> None:
    keep = (TENTHS < 2.35) | (TENTHS > 2.75)
    found = read_speeds(write(rows(TENTHS[keep], curve(TENTHS[keep]))), 6, 1.0, 3)
    assert np.isfinite(found.speed_m_s).tolist() == [True, True, False, True, True, True]
    assert found.sigma_m_s is not None
    assert np.isnan(found.sigma_m_s[2]) and found.measured == 5
    at_edge = (TENTHS < 2.55) | (TENTHS > 2.95)  # up to the middle of beat 2 it was seen
    found = read_speeds(write(rows(TENTHS[at_edge], curve(TENTHS[at_edge]))), 6, 1.0, 3)
    assert found.measured == 6
    lone = np.isin(np.round(TENTHS, 1), [2.5]) | keep
    found = read_speeds(write(rows(TENTHS[lone], curve(TENTHS[lone]))), 6, 1.0, 3)
    assert found.measured == 6


def test_a_file_that_ends_early_or_begins_late(write: Write) -> None:
    some = TENTHS[(TENTHS > 0.75) & (TENTHS < 4.45)]
    found = read_speeds(write(rows(some, curve(some))), 6, 1.0, 3)
    assert np.isfinite(found.speed_m_s).tolist() == [False, True, True, True, False, False]


def test_other_beats_than_a_second(write: Write) -> None:
    t = np.arange(0, 81) * 0.05
    found = read_speeds(write(rows(t, curve(t), window=0.5)), 8, 0.5, 3)
    np.testing.assert_allclose(found.speed_m_s, curve((np.arange(8) + 0.5) * 0.5), rtol=1e-6)


def test_without_a_window_it_is_the_mean_over_each_beat(write: Write) -> None:
    path = write("t_s,v_m_s\n0,0\n2,0.06\n8,0.06\n10,0\n")
    found = read_speeds(path, 10, 1.0)
    wanted = [0.015, 0.045, *[0.06] * 6, 0.045, 0.015]
    np.testing.assert_allclose(found.speed_m_s, wanted, atol=1e-7)
    assert found.sigma_m_s is None


def test_more_columns_in_any_order_are_no_matter(write: Write) -> None:
    path = write("note,sigma_m_s,v_m_s,t_s\nx,0.002,0.05,0\ny,0.004,0.05,2\n")
    found = read_speeds(path, 2, 1.0, 9)
    np.testing.assert_allclose(found.speed_m_s, 0.05)
    assert found.sigma_m_s is not None
    np.testing.assert_allclose(found.sigma_m_s, [0.0025, 0.0035])


def test_beats_as_they_are(write: Write) -> None:
    found = read_speeds(write("beat,speed_m_s\n0,0.01\n1,\n2,0.03\n"), 3, 1.0, 7)
    assert np.isnan(found.speed_m_s[1]) and found.measured == 2 and found.sigma_m_s is None


GOOD = rows(TENTHS, curve(TENTHS))


def spoiled(row: int, column: str, cell: str) -> str:
    lines = GOOD.splitlines()
    cells = lines[row - 1].split(",")
    cells[HEADER.split(",").index(column)] = cell
    lines[row - 1] = ",".join(cells)
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("row", "column", "cell", "words"),
    [
        (5, "v_m_s", "nan", "'nan' is no finite number"),
        (5, "v_m_s", "inf", "'inf' is no finite number"),
        (5, "v_m_s", "", "'' is no finite number"),
        (5, "v_m_s", "79.1", "'79.1' makes no sense. It is in m/s"),
        (72, "sigma_m_s", "-0.001", "'-0.001' makes no sense"),
        (72, "sigma_m_s", "0", "'0' makes no sense"),
        (72, "sigma_m_s", "1.2", "'1.2' makes no sense"),
        (2, "t_s", "early", "'early' is no finite number"),
        (9, "t_s", "-0.4", "time does not rise"),
        (9, "window_s", "0.5", "another window than above"),
        (2, "window_s", "-1", "'-1' makes no sense"),
        (2, "window_s", "2", "a mean over 2 s, and a beat of this trial has 1 s"),
        (4, "trial", "6", "these speeds are of trial 6, not 3"),
        (4, "trial", "three", "'three' is no trial"),
    ],
)
def test_what_makes_no_sense_is_told_with_its_place(
    write: Write, row: int, column: str, cell: str, words: str
) -> None:
    with pytest.raises(InputError) as refused:
        read_speeds(write(spoiled(row, column, cell)), 6, 1.0, 3)
    assert f"speed.csv, row {row}, column {column}: " in str(refused.value)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value) and refused.value.remedy


def test_a_film_without_a_trial_is_refused(write: Write) -> None:
    path = write(rows(TENTHS, curve(TENTHS), trial=""))
    with pytest.raises(InputError, match="not paired with a trial") as refused:
        read_speeds(path, 6, 1.0, 3)
    assert "tailbeat camera track FILM --trial 0003.ulg" in str(refused.value)
    assert read_speeds(path, 6, 1.0).measured == 6  # nobody asks whose they are


def test_a_film_s_own_time_covers_no_beat(write: Write) -> None:
    path = write(rows(TENTHS * 1e3, curve(TENTHS)))
    with pytest.raises(InputError, match=r"covers no beat: its times are -500 to 6500"):
        read_speeds(path, 6, 1.0, 3)
    with pytest.raises(InputError, match="covers no beat"):
        read_speeds(write(rows(TENTHS[:1], TENTHS[:1])), 6, 1.0, 3)


@pytest.mark.parametrize("text", ["", "\n\n", HEADER, "t_s,speed\n0,1\n"])
def test_files_with_nothing_in_them(write: Write, text: str) -> None:
    with pytest.raises(InputError, match=r"speed\.csv"):
        read_speeds(write(text), 6, 1.0, 3)


def test_what_the_tracker_writes_is_what_is_read(tmp_path: Path) -> None:
    t = np.arange(0, 61) / 10 + 100
    made = smoother.SpeedCurve(t, curve(t - 100), 1e-3 + 1e-5 * t, 1.0, 100.0, 0.0, 1e-3)
    path = tmp_path / "speed.csv"
    smoother.write_speeds(made, path, 12)
    found = read_speeds(path, 6, 1.0, 12)
    speed, sigma = made.beats(6)
    assert found.sigma_m_s is not None
    np.testing.assert_allclose(found.speed_m_s, speed, atol=2e-6)
    np.testing.assert_allclose(found.sigma_m_s, sigma, atol=2e-6)
    smoother.write_speeds(made, path)
    with pytest.raises(InputError, match="not paired"):
        read_speeds(path, 6, 1.0, 12)


Upload = Callable[..., tuple[int, Any, str]]


@pytest.fixture
def board(monkeypatch: pytest.MonkeyPatch, reference: bytes) -> Iterator[SimBoard]:
    """One that waits for the speeds of trial 1, of eight beats."""
    simulated = SimBoard("tank", seed=1)
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: SimTransport(simulated))
    with Fish.connect("it") as fish:
        fish.params.set("SPD_SOURCE", 1)
        fish.upload_reference(reference)
        assert run_trial(fish).number == 1
    yield simulated


@pytest.fixture
def upload(board: SimBoard, capsys: pytest.CaptureFixture[str]) -> Upload:
    def command(path: Path, *words: str) -> tuple[int, Any, str]:
        status = run(["trial", "speeds", "1", str(path), *words, "--connect", "it", "--json"])
        out, err = capsys.readouterr()
        document = json.loads(out)
        assert ("error" in document) is (status != 0)
        return status, None if status else document, err

    return command


def learned(tmp_path: Path) -> BeatSpeeds:
    """What the board holds of its trial once it has learned from it."""
    with Fish.connect("it") as fish:
        assert fish.learn(1).trial == 1
        beats = read_trial(fish.pull_trial(1, tmp_path)).beats
    return BeatSpeeds(beats.speed_m_s, beats.sigma_m_s)


def test_sigmas_go_up_beat_by_beat(upload: Upload, write: Write, tmp_path: Path) -> None:
    t = np.arange(0, 81) / 10
    seen = (t < 3.35) | (t > 3.75)
    sigma = 0.001 + 1e-4 * t
    path = write(rows(t[seen], curve(t[seen]), sigma[seen], trial="1"))
    status, document, err = upload(path)
    assert (status, err) == (0, "")
    assert document["measured_beats"] == 7 and document["sigma_m_s"][3] is None
    held = learned(tmp_path)
    middle = np.arange(8) + 0.5
    there = np.arange(8) != 3
    assert held.sigma_m_s is not None
    np.testing.assert_allclose(held.speed_m_s[there], curve(middle)[there], rtol=1e-6)
    np.testing.assert_allclose(held.sigma_m_s[there], 0.001 + 1e-4 * middle[there], rtol=1e-6)
    assert np.isnan(held.speed_m_s[3])


@pytest.mark.parametrize(("words", "sigma"), [((), 0.001), (("--sigma", "0.0025"), 0.0025)])
def test_a_sigma_for_all(
    upload: Upload, write: Write, tmp_path: Path, words: tuple[str, ...], sigma: float
) -> None:
    t = np.arange(0, 81) / 10
    bare = [f"{a},{b}" for a, b in zip(t, curve(t), strict=True)]
    text = "\n".join(["t_s,v_m_s", *bare]) if not words else rows(t, curve(t), 0.007, trial="1")
    status, document, _ = upload(write(text), *words)
    assert status == 0
    np.testing.assert_allclose(document["sigma_m_s"], sigma, rtol=1e-6)
    held = learned(tmp_path)
    assert held.sigma_m_s is not None
    np.testing.assert_allclose(held.sigma_m_s, sigma, rtol=1e-6)


def test_a_refused_file_changes_nothing(upload: Upload, write: Write) -> None:
    t = np.arange(0, 81) / 10
    status, document, err = upload(write(rows(t, curve(t), trial="6")))
    assert (status, document) == (1, None)
    assert err.startswith("tailbeat: ") and err.count("\n") == 1
    assert "these speeds are of trial 6, not 1" in err
    for sigma in ("0", "-0.001", "5"):
        assert upload(write(rows(t, curve(t), trial="1")), "--sigma", sigma)[0] == 2
    with Fish.connect("it") as fish:
        assert fish.status().pending_trial == 1
        with pytest.raises(Refused, match="no beat of the trial has a speed"):
            fish.learn(1)
