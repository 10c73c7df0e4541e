"""The command that goes the whole way, on a film of the simulated tank: results or nothing."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.app.cli import run
from tailbeat.app.exercise import Exercise, ExerciseOptions, make_exercise
from tailbeat.board.fish import Fish
from tailbeat.core import reference
from tailbeat.core.csv import read_speeds
from tailbeat.core.errors import InputError
from tailbeat.sensors.camera import film_to_speed
from tailbeat.sensors.camera.calibration.file import load_calibration
from tailbeat.sensors.camera.render.scene import Scene
from tailbeat.sensors.camera.source.film import Film
from tailbeat.sensors.camera.source.open import Beginning
from tailbeat.sensors.camera.sync import Sync
from tailbeat.sensors.camera.tracking.track import Track
from tailbeat.session.trial import run_trial
from tailbeat.session.trial_camera import default_camera

BEATS = 6
SIZE_PX = (640, 360)
SYNC_MAX_S = 0.010
SPEED_MAX_M_S = 0.001
SHORT = ("--seconds", "2.6", "--start", "2")


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Exercise:
    """A short trial, filmed in a small picture."""
    speed = 0.06 * np.sin(np.linspace(0.3, 2.8, BEATS)).astype(np.float32)
    folder = tmp_path_factory.mktemp("film")
    options = ExerciseOptions(
        reference.Reference(1.0, speed, "bump"),
        Scene(size_px=SIZE_PX, marker_side_m=0.1),
        overrides={"camera_lost": 0.05, "place_sigma_m": 0, "place_sigma_rad": 0},
    )
    return make_exercise(folder / "swim.mp4", options)


@pytest.fixture(scope="module")
def another_trial(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Trial 2 of some fish."""
    folder = tmp_path_factory.mktemp("another")
    with Fish.connect("sim:tank", seed=2) as fish:
        speed = np.full(BEATS, 0.04, dtype=np.float32)
        fish.upload_reference(reference.Reference(1.0, speed, "cruise"))
        fish.discard(run_trial(fish, default_camera(fish)).number)
        return fish.pull_trial(run_trial(fish, default_camera(fish)).number, folder)


@pytest.fixture(scope="module")
def whole() -> list[Track]:
    """The film's track, once somebody went through all of it."""
    return []


@pytest.fixture
def seen_once(whole: list[Track], monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the first of the tests that track the whole film does it."""
    really = film_to_speed.track

    def remembered(*arguments: Any) -> Track:
        if not whole:
            whole.append(really(*arguments))
        return whole[0]

    monkeypatch.setattr(film_to_speed, "track", remembered)


def track(film: Exercise, out: Path, *more: str) -> int:
    known = ("--calibration", str(film.calibration), "--out", str(out))
    return run(["camera", "track", str(film.film), *known, *more])


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.usefixtures("seen_once")
def test_from_film_and_trial_to_speeds(
    film: Exercise, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "swim"
    assert track(film, out, "--trial", str(film.trial_file), "--json") == 0
    document = json.loads(capsys.readouterr().out)
    summary = json.loads((out / "summary.json").read_text())
    assert document == {"folder": str(out), **summary}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["swim"]
    names = ["beats.csv", "speed.csv", "summary.json", "track.csv"]
    assert sorted(path.name for path in out.iterdir()) == names

    assert summary["sync"]["how"] == "led"
    assert abs(summary["sync"]["start_s"] - film.swim_begin_s) <= SYNC_MAX_S
    assert summary["seen"] + summary["bridged"] + summary["lost"] == summary["pictures"]
    assert summary["seen"] == film.pictures
    beats = rows(out / "beats.csv")
    speed = np.array([float(row["speed_m_s"]) for row in beats])
    np.testing.assert_allclose(speed, film.true_speed_m_s[:BEATS], atol=SPEED_MAX_M_S)
    uploaded = read_speeds(out / "speed.csv", BEATS, film.beat_s, film.trial)
    np.testing.assert_allclose(uploaded.speed_m_s, speed, atol=1e-5)


def test_positions_tracked_elsewhere_are_synchronised_by_the_led(
    film: Exercise, whole: list[Track], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A table of DeepLabCut, of the places that the host tool found itself."""
    track_rows, known = whole[0], load_calibration(film.calibration)
    seen = track_rows.seen()
    back = np.column_stack([track_rows.x_m, track_rows.y_m])[seen]
    heading = track_rows.heading_rad[seen]
    ahead = back + 0.05 * np.column_stack([np.cos(heading), np.sin(heading)])
    lines = ["scorer" + ",DLC" * 6, "bodyparts" + ",snout" * 3 + ",back" * 3]
    lines += ["coords" + ",x,y,likelihood" * 2]
    pixels = zip(known.to_pixels(ahead), known.to_pixels(back), strict=True)
    lines += [f"{k},{h[0]},{h[1]},1,{b[0]},{b[1]},1" for k, (h, b) in enumerate(pixels)]
    table = tmp_path / "swimDLC.csv"
    table.write_text("\n".join(lines))
    more = ("--positions", str(table), "--point", "back", "--head", "snout", "--json")
    assert track(film, tmp_path / "swim", "--trial", str(film.trial_file), *more) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["sync"]["how"] == "led"
    assert abs(summary["sync"]["start_s"] - film.swim_begin_s) <= SYNC_MAX_S
    speed = np.array([float(row["speed_m_s"]) for row in rows(tmp_path / "swim" / "beats.csv")])
    np.testing.assert_allclose(speed, film.true_speed_m_s[:BEATS], atol=SPEED_MAX_M_S)
    blind = [part for part in more if part not in ("--head", "snout", "--json")]
    assert track(film, tmp_path / "other", "--trial", str(film.trial_file), *blind) == 1
    assert "have no heading, and the trial's begin is not known" in capsys.readouterr().err


def test_text_says_what_to_do_next(
    film: Exercise, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "swim"
    assert track(film, out, "--trial", str(film.trial_file), *SHORT) == 0
    text = capsys.readouterr().out
    assert "the trial begins at 2.000 s, as given" in text
    begin = json.loads((out / "summary.json").read_text())["sync"]
    assert begin["sigma_s"] == pytest.approx(0.5 / film.fps / math.sqrt(3), rel=1e-3)
    assert f"of {BEATS} beats have no speed" in text
    assert f"next: tailbeat trial speeds {film.trial} {out / 'speed.csv'}" in text


@pytest.mark.usefixtures("seen_once")
def test_without_a_trial_it_tells_the_led_s_number(
    film: Exercise, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "swim"
    assert track(film, out) == 0
    text = capsys.readouterr().out
    assert f"by the LED, which shows trial {film.trial} (or one 256 away)" in text
    assert "next:" not in text
    assert {row["trial"] for row in rows(out / "speed.csv")} == {""}


@pytest.mark.painted
def test_overlay_and_plot_on_request(film: Exercise, tmp_path: Path) -> None:
    out = tmp_path / "swim"
    assert track(film, out, "--overlay", "--plot", *SHORT) == 0
    names = ["overlay.mp4", "speed.csv", "summary.json", "track.csv", "track.png"]
    assert sorted(path.name for path in out.iterdir()) == names
    drawn = Film(out / "overlay.mp4")
    assert drawn.size_px == SIZE_PX
    drawn.close()
    png = (out / "track.png").read_bytes()
    assert png.startswith(b"\x89PNG")


def fails(code: int, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert code == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert words in said.err


def test_errors_leave_nothing(
    film: Exercise,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "swim"
    fails(run(["camera", "track", str(film.film)]), "no tank.json here", capsys)
    fails(
        track(film, out, "--seconds", "0.5", "--start", "99"),
        "the trial should begin at 99 s",
        capsys,
    )
    fails(
        track(film, out, "--seconds", "0.2", "--marker-id", "9"),
        "no aruco marker with id 9",
        capsys,
    )
    fails(track(film, out, "--trial", str(film.film)), "is not a ULog file", capsys)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("seen_once")
def test_the_film_of_another_trial_is_refused(
    film: Exercise, another_trial: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    refused = track(film, tmp_path / "swim", "--trial", str(another_trial))
    fails(refused, "the film shows trial 1 (or one 256 away), the file is trial 2", capsys)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("seen_once")
def test_a_film_paired_by_the_yaw_is_questioned(
    film: Exercise,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with_led = film_to_speed.track

    def without_led(*arguments: Any) -> Track:
        seen = with_led(*arguments)
        assert seen.patch is not None
        return replace(seen, patch=np.zeros_like(seen.patch))

    monkeypatch.setattr(film_to_speed, "track", without_led)
    assert track(film, tmp_path / "swim", "--trial", str(film.trial_file)) == 0
    text = capsys.readouterr().out
    assert "by the fish's yaw oscillation; trials with nearly equal amplitudes look alike" in text
    assert f"is it trial {film.trial}'s film?" in text


@pytest.mark.usefixtures("seen_once")
def test_error_bars_hold_that_the_begin_is_not_exactly_known(
    film: Exercise, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sigmas, rise_m_s2 = {}, np.empty(0)
    for sigma_s in (0.0, 0.1):
        begin = Sync(film.swim_begin_s, sigma_s, "led", film.trial, 1.0)
        monkeypatch.setattr(film_to_speed, "begin_of", lambda *_, begin=begin: begin)
        out = tmp_path / f"{sigma_s}"
        assert track(film, out, "--trial", str(film.trial_file)) == 0
        curve = rows(out / "speed.csv")
        t_s, v_m_s, sigma_m_s = (
            np.array([float(row[name]) for row in curve]) for name in ("t_s", "v_m_s", "sigma_m_s")
        )
        rise_m_s2 = np.gradient(v_m_s, t_s)
        beat = np.array([float(row["sigma_m_s"]) for row in rows(out / "beats.csv")])
        sigmas[sigma_s] = sigma_m_s, beat
    assert np.abs(rise_m_s2).max() > 0.01
    wanted = np.hypot(sigmas[0.0][0], 0.1 * rise_m_s2)
    np.testing.assert_allclose(sigmas[0.1][0], wanted, atol=3e-6)
    middles = np.isin(np.round(t_s * 10), 10 * np.arange(BEATS) + 5)
    np.testing.assert_allclose(sigmas[0.1][1], wanted[middles], atol=3e-6)


def test_ctrl_c_leaves_nothing(
    film: Exercise, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments: object, **more: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(film_to_speed, "write_speeds", interrupted)
    assert track(film, tmp_path / "swim", "--overlay", *SHORT) == 130
    assert list(tmp_path.iterdir()) == []


def test_other_folders_are_left_alone(
    film: Exercise, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "thesis"
    out.mkdir()
    (out / "chapter8.tex").write_text("all of it")
    fails(track(film, out), "is no film's analysis", capsys)
    assert (out / "chapter8.tex").read_text() == "all of it"
    (out / "chapter8.tex").unlink()
    with film_to_speed.new_folder(out) as part:
        (part / "summary.json").write_text('{"made_by": "tailbeat camera track"}')
        (part / "track.png").touch()
    (out / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="is no film's analysis"), film_to_speed.new_folder(out):
        pass
    (out / "notes.txt").unlink()
    with film_to_speed.new_folder(out) as part:
        (part / "summary.json").write_text("{}")
    assert [path.name for path in out.iterdir()] == ["summary.json"]


def test_the_beginning_of_a_film(film: Exercise) -> None:
    source = Beginning(Film(film.film), 1.0)
    times = []
    while (picture := source.read()) is not None:
        times.append(picture.t_s)
    assert source.ended
    assert 20 <= len(times) <= 25
    assert times[-1] - times[0] < 1.0
    source.close()
