"""examples/: each program runs as it is and says what it should; its data open in the tool."""

from __future__ import annotations

import csv
import json
import os
import runpy
import shutil
import subprocess
import sys
import types
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from pyulog import ULog

from tailbeat.app.cli import run as run_tool
from tailbeat.board.fish import Fish
from tailbeat.core.reference import Reference, ReferenceLimits, from_csv
from tailbeat.core.trial_file import read_trial
from tailbeat.experiment.analysis import analyse
from tailbeat.experiment.folder import Experiment
from tailbeat.report.replay import replay

EXAMPLES = Path(__file__).parents[2] / "examples"
DATA = EXAMPLES / "data"
PROGRAMS = sorted(EXAMPLES.glob("*.py"))
LINES_MAX, DATA_BYTES_MAX = 60, 600_000


def run(name: str, folder: Path, *arguments: object) -> str:
    """What a program prints."""
    command = [sys.executable, EXAMPLES / name, *map(str, arguments)]
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, env=environment, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_program_is_short() -> None:
    assert len(PROGRAMS) == 4
    for path in PROGRAMS:
        assert len(path.read_text().splitlines()) <= LINES_MAX, path.name


def test_own_law_learns(tmp_path: Path) -> None:
    lines = run("own_law.py", tmp_path).splitlines()
    errors_mm_s = [float(line.split()[-2]) for line in lines]
    assert len(errors_mm_s) == 6
    assert errors_mm_s[-1] < 0.25 * errors_mm_s[0]


def test_own_tracker_measures_every_beat(tmp_path: Path) -> None:
    lines = run("external_camera.py", tmp_path).splitlines()
    assert lines == ["live: 10 of 10 beats", "afterwards: 10 of 10 beats"]


def test_own_tracker_gives_each_frame_once() -> None:
    module = runpy.run_path(str(EXAMPLES / "external_camera.py"))
    with Fish.connect("sim?seed=1") as fish:
        tracker = module["OwnTracker"](fish)
        assert fish.sim is not None and tracker.fps == 25.0
        fish.link.run(2.0)
        assert len(tracker.frames()) >= 49 and tracker.frames() == []


def test_batch_analysis_writes_every_trial(tmp_path: Path) -> None:
    for name in ("a", "b"):
        shutil.copytree(DATA / "experiment", tmp_path / "experiments" / name)
    empty = tmp_path / "experiments" / "c"
    shutil.copytree(DATA / "experiment", empty)
    shutil.rmtree(empty / "raw")
    lines = run("batch_analysis.py", tmp_path).splitlines()
    assert len(lines) == 1 and "6 trials, smallest max|e| 1" in lines[0]
    with (tmp_path / "trials.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["trial"] for row in rows] == ["1", "2", "3"] * 2
    assert {row["fish"] for row in rows} == {"carangi"}


def test_the_recording_is_what_the_sensor_sends(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_tool(["board", "imu", "decode", str(DATA / "imu_rest.bin"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["ascii_valid"] == found["ascii_types"]["VNYMR"] == 110
    assert found["skipped_bytes"] == found["checksum_failed"] == 0


def test_the_fish_is_found_in_every_picture_of_the_film() -> None:
    pytest.importorskip("cv2")
    from tailbeat.sensors.camera.marker.detector import Marker
    from tailbeat.sensors.camera.render.scene import Scene
    from tailbeat.sensors.camera.source.film import Film
    from tailbeat.sensors.camera.tracking.track import track

    calibration = Scene(size_px=(640, 360), marker_side_m=0.12).calibration()
    found = track(Film(DATA / "film.mp4"), Marker("aruco", 7, 0.12), calibration)
    assert found.seen().tolist() == [True] * 50


def test_the_ros_node_says_what_it_needs(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, EXAMPLES / "ros2_node.py"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert done.stderr.startswith("ros2_node.py needs ROS 2 (No module named 'rclpy'). Source")


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[Any]]:
    """As much of ROS 2 as the node uses; what was published, by topic."""
    published: dict[str, list[Any]] = {}

    class Publisher:
        def __init__(self, kind: type, topic: str, depth: int) -> None:
            self.kind, self.messages = kind, published.setdefault(topic, [])

        def publish(self, message: Any) -> None:
            assert type(message) is self.kind
            self.messages.append(message.data)

    class Node:
        def __init__(self, name: str) -> None:
            assert name == "tailbeat"

        create_publisher = Publisher

    class Message:
        def __init__(self, data: object) -> None:
            self.data = data

    kinds = {name: type(name, (Message,), {}) for name in ("Float64", "String")}
    modules: dict[str, dict[str, Any]] = {
        "rclpy": {"init": lambda: None, "ok": lambda: True},
        "rclpy.node": {"Node": Node},
        "std_msgs": {},
        "std_msgs.msg": kinds,
    }
    for name, content in modules.items():
        module = types.ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    return published


def test_the_ros_node_publishes_what_the_board_reports(
    ros: dict[str, list[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    left = iter([True] * 40 + [False])
    monkeypatch.setattr(sys.modules["rclpy"], "ok", lambda: next(left), raising=False)
    runpy.run_path(str(EXAMPLES / "ros2_node.py"))["main"]("sim?seed=1")
    assert ros["tailbeat/status/state"][0] == "IDLE"
    assert 6 < ros["tailbeat/status/battery_v"][0] < 9
    assert all(isinstance(value, float) for value in ros["tailbeat/status/time_s"])
    assert ros["tailbeat/status/time_s"] == sorted(ros["tailbeat/status/time_s"])


def test_the_data_are_small() -> None:
    assert sum(path.stat().st_size for path in DATA.rglob("*")) < DATA_BYTES_MAX


@pytest.mark.parametrize("name", ["reference_beats.csv", "reference_curve.csv"])
def test_the_references_are_feasible(name: str) -> None:
    found = from_csv(DATA / name)
    assert isinstance(found, Reference)
    assert found.check(ReferenceLimits()) == []
    assert 0.06 < found.speed_m_s.max() < 0.09


def test_the_experiment_replays(tmp_path: Path) -> None:
    copy = Experiment(Path(shutil.copytree(DATA / "experiment", tmp_path / "experiment")))
    assert [row.complete for row in analyse(copy).rows] == [True] * 3
    (tmp_path / "scratch").mkdir()
    found = replay(copy, tmp_path / "scratch")
    assert found.identical and len(found.recomputed) == 3 and len(found.learned) == 3


def test_the_annotated_log_opens() -> None:
    path = DATA / "annotated_0003.ulg"
    assert read_trial(path).number == 3 and read_trial(path).problems == []
    info = ULog(str(path)).msg_info_dict
    assert info["unit_beat_speed_m_s"] == "m/s"
    made_us = datetime(2025, 1, 1, tzinfo=UTC).timestamp() * 1e6
    assert info["start_utc_us"] > made_us


def test_the_data_can_be_made_again(tmp_path: Path) -> None:
    run("data/make.py", tmp_path, tmp_path)
    names = {path.relative_to(DATA) for path in DATA.rglob("*") if path.suffix in (".csv", ".ulg")}
    made = {p.relative_to(tmp_path) for p in tmp_path.rglob("*") if p.suffix in (".csv", ".ulg")}
    assert made == names
    for name in sorted(names):
        if name.suffix == ".csv":
            assert (tmp_path / name).read_bytes() == (DATA / name).read_bytes()
