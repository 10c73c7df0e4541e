"""Positions tracked by other programs, each in its own layout, to speeds."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cv2")

from tailbeat.app.cli import run
from tailbeat.core.errors import InputError
from tailbeat.sensors.camera.calibration.file import Calibration
from tailbeat.sensors.camera.render.scene import Scene
from tailbeat.sensors.camera.source.film import FilmWriter
from tailbeat.sensors.camera.tracking.positions import read_points, read_positions

from .second_optics import Floats
from .second_tank import Swim

DEEPLABCUT = """scorer,DLC_resnet50,DLC_resnet50,DLC_resnet50,DLC_resnet50,DLC_resnet50,DLC_resnet50
bodyparts,snout,snout,snout,back,back,back
coords,x,y,likelihood,x,y,likelihood
0,10.5,20.25,0.99,30.0,40.0,0.98
1,11.5,20.5,0.30,31.0,40.5,0.97
"""
DEEPLABCUT_ANIMALS = """scorer,DLC,DLC,DLC,DLC,DLC,DLC
individuals,fish1,fish1,fish1,fish2,fish2,fish2
bodyparts,back,back,back,back,back,back
coords,x,y,likelihood,x,y,likelihood
0,10.5,20.25,0.99,,,
"""
SLEAP = """track,frame_idx,instance.score,head.x,head.y,head.score,back.x,back.y,back.score
track_0,0,0.91,10.5,20.25,0.95,30.0,40.0,0.92
track_0,2,0.91,,,0,31.0,40.5,0.92
"""
SLEAP_ANIMALS = """track,frame_idx,instance.score,back.x,back.y,back.score
track_0,0,0.91,10.5,20.25,0.95
track_1,0,0.88,30.0,40.0,0.92
"""
TREX = """frame,missing,time,X (cm),Y (cm),SPEED (cm/s),X#wcentroid (cm),Y#wcentroid (cm),ANGLE
0,0,0,2.1,4.05,3.2,6.0,8.0,0.1
1,1,0.04,inf,inf,inf,inf,inf,inf
"""
IDTRACKER = """time,x1,y1,x2,y2
0.0,10.5,20.25,30.0,40.0
0.04,11.5,20.5,nan,nan
"""
TRACKER = "mass_A\t\t\nt\tx\ty\n0.000E0\t1.05E-2\t2.025E-2\n4.000E-2\t1.150E-2\t\n"
TRACKER_MULTI = "#multi:\n\tcm A\t\tcm B\t\nt\tx\ty\tx\ty\n0,00\t0,0105\t0,02025\t0,03\t0,04\n"
TRACKER_PIXELS = "mass A,,\nframe,pixelx,pixely\n0,10.5,20.25\n1,11.5,20.5\n"


def points(tmp_path: Path, text: str) -> dict[str, tuple[Floats, Floats, str]]:
    path = tmp_path / "table.csv"
    path.write_text(text)
    return {one.name: (one.at, one.places, one.unit) for one in read_points(path)}


@pytest.mark.parametrize(
    ("text", "name", "at", "places", "unit"),
    [
        (DEEPLABCUT, "snout", [0, 1], [[10.5, 20.25], [np.nan, np.nan]], "px"),
        (DEEPLABCUT, "back", [0, 1], [[30, 40], [31, 40.5]], "px"),
        (DEEPLABCUT_ANIMALS, "fish1/back", [0], [[10.5, 20.25]], "px"),
        (DEEPLABCUT_ANIMALS, "fish2/back", [0], [[np.nan, np.nan]], "px"),
        (SLEAP, "head", [0, 2], [[10.5, 20.25], [np.nan, np.nan]], "px"),
        (SLEAP_ANIMALS, "track_1/back", [0], [[30, 40]], "px"),
        (TREX, "wcentroid", [0, 1], [[6, 8], [np.nan, np.nan]], "cm"),
        (TREX.replace(" (cm)", ""), "X", [0, 1], [[2.1, 4.05], [np.nan, np.nan]], "cm"),
        (IDTRACKER, "1", [0, 1], [[10.5, 20.25], [11.5, 20.5]], "px"),
        (IDTRACKER.replace("time", "seconds"), "2", [0, 1], [[30, 40], [np.nan, np.nan]], "px"),
        (TRACKER, "mass_A", [0, 0.04], [[0.0105, -0.02025], [0.0115, np.nan]], "m"),
        (TRACKER_MULTI, "cm B", [0], [[0.03, -0.04]], "m"),
        (TRACKER_PIXELS, "mass A", [0, 1], [[10.5, 20.25], [11.5, 20.5]], "px"),
    ],
)
def test_layouts(
    tmp_path: Path, text: str, name: str, at: list[float], places: list[list[float]], unit: str
) -> None:
    found = points(tmp_path, text)[name]
    np.testing.assert_allclose(found[0], at)
    np.testing.assert_allclose(found[1], places)
    assert found[2] == unit


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        ("", {}, "is no table of positions of DeepLabCut, SLEAP, TRex, idtracker.ai, Tracker"),
        ("beat,speed\n0,1\n", {}, "is no table of positions"),
        (SLEAP.splitlines()[0], {}, "is a table of SLEAP without positions"),
        ("track,frame_idx,A.x\nt,1,3\n", {}, "is a table of SLEAP that is cut off or damaged"),
        ("frame_idx,A.x,A.y,track\n1\n", {}, "is a table of SLEAP that is cut off"),
        ("s,a,a\nb,b\ncoords,x,y,likelihood,x\n0,1,2,1,1\n", {}, "of DeepLabCut that is cut off"),
        ("frame,X (px),Y (px)\na,1,2\n", {}, "is a table of TRex without positions"),
        ("frame,X (px)\n0," + "1" * 200_000, {}, "is no table"),
        (DEEPLABCUT, {}, r"holds 2 points: snout, back. Choose one: --point NAME"),
        (DEEPLABCUT, {"point": "fin"}, r"has no point fin. It has snout, back"),
        (TREX, {"point": "wcentroid"}, r"--cm-per-pixel X"),
        (TRACKER, {"cm_per_px": 0.2}, "does not hold centimetres"),
    ],
)
def test_tables_that_say_too_little(
    tmp_path: Path, text: str, options: dict[str, str | float], words: str
) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_positions(path, **options)  # type: ignore[arg-type]


SWIM = Swim(seed=4, beats=6, lead_s=1.0, coast_s=1.0)
SCENE = Scene(size_px=(320, 180))
FPS = 25.0


@dataclass(frozen=True)
class Filmed:
    """A film without anything in it, and where the fish was: in the film and in the tank."""

    path: Path
    calibration: Path
    back_px: Floats
    head_px: Floats
    back_m: Floats


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Filmed:
    folder = tmp_path_factory.mktemp("film")
    known: Calibration = SCENE.calibration()
    known.save(folder / "tank.json")
    t_s = np.arange(int(FPS * 8)) / FPS
    x, y, heading = SWIM.pose(t_s - SWIM.lead_s)
    noise = np.random.default_rng(6).normal(0, 2e-4, (len(t_s), 2))
    back = np.column_stack([x, y]) + noise
    head = back + 0.08 * np.column_stack([np.cos(heading), np.sin(heading)])
    with FilmWriter(folder / "swim.mp4", SCENE.size_px, FPS) as writer:
        for time_s in t_s:
            writer.add(np.full(SCENE.size_px[::-1], 90, np.uint8), time_s)
    in_film = known.to_pixels(back), known.to_pixels(head)
    return Filmed(folder / "swim.mp4", folder / "tank.json", *in_film, back)


def table(program: str, film: Filmed) -> tuple[str, list[str]]:
    """What the program would export, and the options that it takes."""
    rows = list(enumerate(zip(film.back_px, film.head_px, film.back_m, strict=True)))
    if program == "DeepLabCut":
        lines = DEEPLABCUT.splitlines()[:3]
        lines += [f"{k},{h[0]},{h[1]},0.9,{b[0]},{b[1]},0.9" for k, (b, h, _) in rows]
        return "\n".join(lines), ["--point", "back", "--head", "snout"]
    if program == "SLEAP":
        lines = SLEAP.splitlines()[:1]
        lines += [f",{k},1,{h[0]},{h[1]},1,{b[0]},{b[1]},1" for k, (b, h, _) in rows if k % 9]
        return "\n".join(lines), ["--point", "back", "--head", "head"]
    if program == "TRex":
        lines = ["frame,missing,time,X#wcentroid (cm),Y#wcentroid (cm)"]
        lines += [f"{k},0,{k / FPS},{b[0] * 0.5},{b[1] * 0.5}" for k, (b, _, _) in rows]
        return "\n".join(lines), ["--cm-per-pixel", "0.5"]
    if program == "idtracker.ai":
        lines = ["time,x1,y1", *(f"{k / FPS},{b[0]},{b[1]}" for k, (b, _, _) in rows)]
        return "\n".join(lines), []
    lines = ["mass_A\t\t", "t\tx\ty", *(f"{k / FPS}\t{m[0]}\t{-m[1]}" for k, (_, _, m) in rows)]
    return "\n".join(lines), []


@pytest.mark.parametrize("program", ["DeepLabCut", "SLEAP", "TRex", "idtracker.ai", "Tracker"])
def test_from_positions_to_speeds(program: str, filmed: Filmed, tmp_path: Path) -> None:
    text, options = table(program, filmed)
    positions, out = tmp_path / "positions.csv", tmp_path / "swim"
    positions.write_text(text)
    known = ["--calibration", str(filmed.calibration), "--out", str(out), "--start", "1"]
    command = ["camera", "track", str(filmed.path), "--positions", str(positions)]
    assert run([*command, *options, *known]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["seen"] == (200 if program != "SLEAP" else 200 - 23)
    assert (summary["straight"] is None) == ("--head" not in options)
    rows = np.genfromtxt(out / "speed.csv", delimiter=",", names=True)
    truth = SWIM.true_beats(summary["direction_rad"])
    middle = np.arange(6) + 1.5  # of each beat, in the film's time
    at = [int(np.argmin(np.abs(rows["t_s"] - t_s))) for t_s in middle]
    error, sigma = rows["v_m_s"][at] - truth, rows["sigma_m_s"][at]
    print(f"{program}: error {error * 1e3}, sigma {sigma * 1e3}")
    assert np.sqrt(np.mean(error**2)) < 0.8e-3
    assert (np.abs(error) < 4 * sigma).all()


def test_a_table_of_another_film(
    filmed: Filmed, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    positions = tmp_path / "positions.csv"
    known = ["--calibration", str(filmed.calibration), "--out", str(tmp_path / "swim")]
    command = ["camera", "track", str(filmed.path), "--positions", str(positions), *known]
    positions.write_text("time,x1,y1\n" + "\n".join(f"{k},9,9" for k in range(400)))
    assert run(command) == 1
    assert "has picture 399, swim.mp4 only 200: another film's" in capsys.readouterr().err
    positions.write_text("time,x1,y1\n" + "\n".join(f"{k},nan,nan" for k in range(200)))
    assert run(command) == 1
    assert re.search("has no position for any picture", capsys.readouterr().err)
    assert run(["camera", "track", str(filmed.path), "--point", "back", *known]) == 2
    assert not (tmp_path / "swim").exists()
