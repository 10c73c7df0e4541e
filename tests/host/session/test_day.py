"""A whole day at the tank through the command line, as a researcher types it, on a simulated board
in virtual time: trim, identify, design, first trials, an abort at beat 13, a bump, a discarded
trial, a battery swap, convergence, a second reference, the report; and all of it again from raw.

With the flash image on the emulated chip: ``pytest -m soak``.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tailbeat.sim.board import SimBoard
from tailbeat.sim.emulated import EmulatedBoard

from ..tank_day import Day, Tank

CENTRE_RAD = 0.08  # the tail is mounted so far askew: the fish would swim in a wide circle
US_PER_RAD = 572.9578
PLATEAU_M_S = 0.0791


@pytest.fixture(params=["sim", pytest.param("vboard", marks=pytest.mark.soak)])
def day(
    request: pytest.FixtureRequest,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> Iterator[Day]:
    kind = SimBoard if request.param == "sim" else EmulatedBoard
    args: tuple[object, ...] = ("tank",) if request.param == "sim" else (None, "tank")
    board = kind(*args, seed=7, tail_centre_rad=CENTRE_RAD, battery_sag_v_per_trial=0.02)
    tank = Tank(board)
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: tank)
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "logbook"))
    monkeypatch.chdir(tmp_path)
    yield Day(board, tank, capsys)


def test_a_day_at_the_tank(day: Day, tmp_path: Path) -> None:
    trim_identify_design(day)
    new = day.types(
        "experiment", "new", "--reference", "thesis", "--fish", "carangi", "--water-temp", 21.5,
        "--condition", "water_depth_m=0.5",
    )  # fmt: skip
    first = Path(new["folder"])
    day.types("experiment", "note", first, "a new tail fin", connected=False)
    begin_to_learn(day)
    abort_and_bump(day)
    swap_battery(day)
    series = day.types("trial", "run", "--until", "converged", "--then", "keep")
    assert series["why"] == "converged"
    assert series["verdict"]["best_max_abs_error_m_s"] < 0.2 * PLATEAU_M_S
    second = another_reference(day)
    for words in ((first, "--paper"), (second,)):
        written = day.types("report", *words, connected=False)
        assert Path(written["page"]).is_file()
    assert again(day, second)["identical"]
    elsewhere = tmp_path / "elsewhere" / "moved"
    shutil.copytree(first, elsewhere)
    assert again(day, elsewhere)["identical"]
    what_the_folder_says(first)


def trim_identify_design(day: Day) -> None:
    for name, value in {"AMP_MAX_RAD": 0.785, "DU_MAX_RAD": 0.0}.items():
        day.types("params", "set", name, value)
    trim = day.types("session", "trim", "--yes", "--apply")
    assert trim["held_us"] == pytest.approx(1500 - CENTRE_RAD * US_PER_RAD, abs=6)
    day.types("reference", "upload", "thesis")
    found = day.types("session", "identify", "--yes")
    assert found["model"]["kappa_per_m"] == pytest.approx(10, rel=0.2)
    assert day.types("session", "design", "--reference", "thesis", "--apply")["lead_beats"] == 1
    day.types("params", "save")
    day.types("params", "set", "TLM_RATE_HZ", 10)  # and forgets to save


def begin_to_learn(day: Day) -> None:
    series = day.types("trial", "run", "--until", 2, "--then", "keep")
    assert [trial["decision"] for trial in series["swims"]] == ["keep", "keep"]
    for trial in series["swims"]:
        assert trial["ready"]["drift"]["speed_m_s"] < 0.002
        assert trial["ready"]["rested_s"] >= 30
        assert abs(trial["straight"]["worst_yaw_rad"]) < math.radians(5)  # it is trimmed
        assert trial["battery_end_v"] < trial["battery_start_v"]
        assert trial["ready"]["travel"]["expected_m"] < trial["ready"]["travel"]["room_m"]


def abort_and_bump(day: Day) -> None:
    before = day.types("info")["status"]
    day.happens(13, day.abort_by_console)
    cut = day.types("trial", "run", "--then", "discard", "--reason", "stopped by hand")["swims"][0]
    assert (cut["end"], cut["executed_beats"]) == ("aborted:ABORT_COMMAND", 13)
    day.happens(20, lambda: day.board.world.push(-0.05))
    bump = day.types("trial", "run", "--then", "discard", "--reason", "bumped the wall")
    assert bump["swims"][0]["end"] == "complete"
    after = day.types("info")["status"]
    assert after["iteration"] == before["iteration"] == 3
    assert after["last_learned_trial"] == before["last_learned_trial"]


def swap_battery(day: Day) -> None:
    day.board.world.swap_battery(8.2, 0.99, 0.0)
    trials = day.trials()
    refused = day.types("trial", "run", "--then", "keep", status=1)
    assert "TLM_RATE_HZ" in str(refused) and "session resume" in str(refused)
    assert day.trials() == trials
    resumed = day.types("session", "resume", "--yes")
    assert resumed["restored"]["params"] == {"TLM_RATE_HZ": 10}
    assert resumed["restored"]["iteration"] == 3
    assert resumed["shift"]["within"], resumed["shift"]["words"]
    assert day.types("info")["status"]["iteration"] == 3


def another_reference(day: Day) -> Path:
    day.types("reference", "upload", "thesis:0.06,40", "--warm-start", "board")
    series = day.types("trial", "run", "--until", "converged", "--then", "keep")
    assert series["why"] == "converged"
    assert series["swims"][0]["max_abs_error_m_s"] < 0.3 * 0.06  # it need not begin anew
    folder = Path(series["experiment"])
    assert json.loads((folder / "settings.json").read_text())["reference"] == "thesis-0.06-40"
    return folder


def again(day: Day, folder: Path) -> Any:
    found = day.types("experiment", "replay", folder, connected=False)
    assert found["different"] == []
    assert len(found["recomputed"]) == len(list((folder / "raw").glob("*.ulg")))
    assert found["figures"]
    return found


def what_the_folder_says(folder: Path) -> None:
    analysis = json.loads((folder / "analysis.json").read_text())
    rows = analysis["rows"]
    told = [(row["decision"], row["reason"]) for row in rows if row["decision"] != "keep"]
    assert told == [
        ("discard", "stopped by hand"), ("discard", "bumped the wall"), ("repeat", "battery swap"),
    ]  # fmt: skip
    repeat = next(row for row in rows if row["decision"] == "repeat")
    best = min(rows[:2], key=lambda row: row["max_abs_error_m_s"])
    assert (repeat["repeat_of"], repeat["iteration"]) == (best["trial"], best["iteration"])
    assert analysis["conditions"] == {"water_depth_m": 0.5, "water_temperature_degc": 21.5}
    assert "a new tail fin" in (folder / "notes.md").read_text()
    assert "Simulated" in (folder / "report" / "captions.txt").read_text()
    redo = (folder / "redo.md").read_text()
    assert ": `tailbeat trial run --until 2 --then keep --json" in redo
    assert ": `tailbeat session resume --yes --json" in redo
