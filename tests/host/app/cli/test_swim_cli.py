"""tailbeat trial run with a camera: from the options to what is told in the end."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.app.cli import run
from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core.errors import InputError
from tailbeat.core.speed_source import Frame
from tailbeat.core.trial_file import read_trial
from tailbeat.sensors.camera.calibration.file import Calibration
from tailbeat.sensors.camera.source.film import Film
from tailbeat.sensors.camera.source.picture import TimedImage
from tailbeat.sensors.camera.sync import Sync
from tailbeat.sensors.camera.tracking.live import VideoCamera
from tailbeat.sensors.camera.tracking.tracker import TrackedImage
from tailbeat.sim.board import SimBoard, SimTransport, SimulatedBoard
from tailbeat.sim.world import CameraFrame

SIZE = (64, 48)
Swim = Callable[..., tuple[int, Any, str]]


SEEN: dict[int, CameraFrame] = {}  # by the picture's number


class Device:
    """The simulated board's camera, as pictures that nobody drew."""

    def __init__(self, board: SimulatedBoard, latency_s: float) -> None:
        self.name, self.clock, self.fps, self.size_px, self.ended = "cam", "host", 25.0, SIZE, False
        self._board, self._due = board, deque[CameraFrame]()
        board.watched = True
        self.closed = False
        self.latency_s = latency_s
        self.fails_at_s = np.inf

    def read(self) -> TimedImage | None:
        self._due += self._board.camera_frames()
        if self._board.time_s > self.fails_at_s:
            raise InputError("cam was unplugged", "Plug it in.")
        if not self._due:
            return None
        at = self._due.popleft()
        index = round(at.time_s * 25)
        SEEN[index] = at
        return TimedImage(index, at.time_s - self.latency_s, np.zeros(SIZE[::-1], np.uint8))

    def close(self) -> None:
        self.closed = True


class Eyes:
    """Knows where the fish is."""

    def __init__(self, marker: Any, calibration: Any, name: str, patch: bool = False) -> None:
        pass

    def look(self, picture: TimedImage) -> TrackedImage:
        at = SEEN[picture.index]
        frame = Frame(picture.t_s, at.x_m, at.y_m, at.heading_rad)
        return TrackedImage(picture.index, picture.t_s, frame, None, None)


@pytest.fixture
def board(monkeypatch: pytest.MonkeyPatch) -> SimBoard:
    """One with a camera of its own at /dev/video0, and six beats to swim."""
    simulated = SimBoard("tank", seed=1)
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: SimTransport(simulated))
    monkeypatch.setattr("tailbeat.app.cli._camera.Tracker", Eyes)
    with Fish.connect("it") as fish:
        fish.upload_reference(records.encode_reference(1.0, [0.03, 0.06, 0.08, 0.08, 0.08, 0.03]))
        fish.params.set("DU_MAX_RAD", 0)
        fish.params.set("AMP_MAX_RAD", 0.7)
        fish.upload_amplitudes(np.array([0.33, 0.47, 0.56, 0.56, 0.56, 0.33], np.float32))
    return simulated


@pytest.fixture
def trial(
    board: SimBoard, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Swim:
    def in_step(source: Any, tracker: Any, threaded: bool, on_picture: Any) -> VideoCamera:
        assert threaded  # as it must be for a real device
        return VideoCamera(source, tracker, False, on_picture)

    monkeypatch.setattr("tailbeat.app.cli._camera.VideoCamera", in_step)

    def command(*words: str, prepare: Callable[[Device], None] | None = None) -> Any:
        devices = []

        def opened(
            address: str, size_px: tuple[int, int] | None = None, latency_s: float = 0.0
        ) -> Device:
            assert address == "0"
            assert size_px is not None  # the calibration's: the driver's own choice may be another
            devices.append(Device(board, latency_s))
            if prepare is not None:
                prepare(devices[-1])
            return devices[-1]

        monkeypatch.setattr("tailbeat.sensors.camera.source.open.Device", opened)
        status = run(["trial", "run", "--connect", "it", *words])
        out, err = capsys.readouterr()
        assert all(device.closed for device in devices)
        return status, json.loads(out) if "--json" in words and out else out, err

    return command


@pytest.fixture
def tank(tmp_path: Path) -> Callable[..., str]:
    """A calibration whose far wall is so far from the start."""

    def made(front_m: float | None = 2.5, size_px: tuple[int, int] = SIZE) -> str:
        area = None
        if front_m is not None:
            area = np.array([(-0.5, -0.9), (front_m, -0.9), (front_m, 0.9), (-0.5, 0.9)])
        camera = np.array([[500.0, 0, 31.5], [0, 500.0, 23.5], [0, 0, 1]])
        to_tank = np.array([[0.05, 0, -0.5], [0, 0.05, -0.9], [0, 0, 1.0]])
        path = tmp_path / "tank.json"
        Calibration(size_px, camera, np.zeros(5), to_tank, area_m=area, scale_error=0.0).save(path)
        return str(path)

    return made


def test_a_device_measures_the_swim(trial: Swim, tank: Callable[..., str]) -> None:
    status, document, err = trial("--camera", "0", "--calibration", tank(), "--json")
    assert (status, err, document["end"]) == (0, "", "complete")
    assert all(beat["speed_m_s"] is not None for beat in document["beats"])
    camera = document["camera"]
    assert camera["pictures"] == camera["seen"] > 6 * 25
    assert set(camera) == {"pictures", "seen", "dropped"}


def test_in_words(trial: Swim, tank: Callable[..., str]) -> None:
    status, text, err = trial("--camera", "0", "--calibration", tank())
    lines = text.splitlines()
    assert (status, err) == (0, "") and len(lines) == 2
    assert lines[0].startswith("trial 1, iteration 1: complete, 6 beats, max|e| ")
    assert lines[1].startswith("camera: ") and lines[1].count("pictures, the fish seen in") == 1


def test_a_wall_stops_it(trial: Swim, tank: Callable[..., str]) -> None:
    near = tank(0.45)
    status, document, err = trial("--camera", "0", "--calibration", near, "--json")
    assert status == 1 and document["end"] == "aborted:WALL"
    assert err.count("tailbeat: stopped: wall: ") == 1


def test_a_wall_that_is_switched_off(trial: Swim, tank: Callable[..., str]) -> None:
    words = ("--camera", "0", "--calibration", tank(0.45), "--wall", "0", "--json")
    assert trial(*words)[1]["end"] == "complete"


def test_walls_for_the_simulator_s_own_positions(trial: Swim, tank: Callable[..., str]) -> None:
    _, document, _ = trial("--calibration", tank(0.45), "--json")
    assert document["end"] == "aborted:WALL" and "camera" not in document


def test_the_film_holds_every_picture(
    trial: Swim, tank: Callable[..., str], tmp_path: Path
) -> None:
    path = tmp_path / "swim.mkv"
    words = ("--camera", "0", "--calibration", tank(), "--video", str(path), "--json")
    _, document, _ = trial(*words)
    film = Film(path)
    count = 0
    while film.read() is not None:
        count += 1
    film.close()
    assert count == document["camera"]["pictures"]


def test_a_device_pulled_out_in_mid_swim(
    trial: Swim, tank: Callable[..., str], board: SimBoard, tmp_path: Path
) -> None:
    def prepare(device: Device) -> None:
        device.fails_at_s = board.time_s + 4.0

    path = tmp_path / "swim.mkv"
    words = ("--camera", "0", "--calibration", tank(), "--wall", "0", "--video", str(path))
    status, text, err = trial(*words, prepare=prepare)
    assert status == 1 and "aborted:ABORT_COMMAND" in text
    assert "tailbeat: cam was unplugged. Plug it in. The trial has no camera any more.\n" in err
    film = Film(path)  # what was seen until then is kept
    assert film.read() is not None
    film.close()


def led(monkeypatch: pytest.MonkeyPatch, start_s: float, trial: int = 1) -> None:
    monkeypatch.setattr(
        "tailbeat.app.cli._camera.sync_by_led",
        lambda track, known: Sync(start_s, 0.004, "led", trial, 1.0),
    )


@pytest.mark.parametrize("late_s", [0.012, 0.085, -0.04])
def test_the_led_tells_how_late_the_stamps_are(
    trial: Swim,
    tank: Callable[..., str],
    board: SimBoard,
    monkeypatch: pytest.MonkeyPatch,
    late_s: float,
) -> None:
    words = ("--camera", "0", "--calibration", tank(), "--latency", "0.01", "--json")
    assert trial(*words)[0] == 0
    with Fish.connect("it") as fish:
        begun_s = fish.pull_trial(1, Path(tank()).parent)
        start_us = read_trial(begun_s).start_us
        fish.discard(1)
    off_s = board.time_s - board.board_time_s
    led(monkeypatch, start_us * 1e-6 + off_s + late_s)

    def again(known: Any, number: int, folder: Path) -> Path:
        return begun_s  # the second trial's file would hold another begin

    monkeypatch.setattr(Fish, "pull_trial", again)
    led(monkeypatch, start_us * 1e-6 + off_s + late_s, trial=2)
    status, document, err = trial(*words)
    assert status == 0
    assert document["camera"]["late_s"] == pytest.approx(late_s, abs=2e-3)
    assert document["camera"]["late_sigma_s"] == 0.004
    if abs(late_s) < 0.03:
        assert err == ""
    else:
        side = "late" if late_s > 0 else "early"
        assert f"{abs(late_s) * 1e3:.0f} ms {side} by the fish's LED" in err
        assert f"--latency {0.01 + late_s:.3f}" in err and err.count("\n") == 1


def test_another_fish_s_led_says_nothing(
    trial: Swim, tank: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    led(monkeypatch, 0.0, trial=9)
    status, document, err = trial("--camera", "0", "--calibration", tank(), "--json")
    assert (status, err) == (0, "") and "late_s" not in document["camera"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--camera", "0"), "a camera needs a calibration"),
        (("--camera", "0", "--calibration", "OTHER"), "64x48"),
        (("--camera", "0", "--calibration", "NOWHERE", "--wall", "0.2"), "where the walls are"),
        (("--wall", "0.2"), "where the walls are"),
        (("--video", "film.mkv"), "only positions"),
        (("--camera", "tcp:127.0.0.1:1", "--video", "film.mkv"), "only positions"),
        (("--camera", "tcp:127.0.0.1:1"), "no camera answers"),
        (("--camera", "0", "--calibration", "no such file"), "no such file"),
    ],
)
def test_what_cannot_be_is_one_line_and_nothing_swims(
    trial: Swim, tank: Callable[..., str], words: tuple[str, ...], told: str
) -> None:
    real = {"OTHER": tank(size_px=(640, 480)), "NOWHERE": ""}
    if "NOWHERE" in words:
        real["NOWHERE"] = tank(None)
    status, out, err = trial(*(real.get(word, word) for word in words))
    assert status == 1 and not out
    assert err.startswith("tailbeat: ") and err.count("\n") == 1 and told in err
    with Fish.connect("it") as fish:
        assert fish.status().next_trial == 1 and fish.status().state == "IDLE"


@pytest.mark.parametrize(
    "words",
    [
        ("--marker", "dog"),
        ("--marker-side", "60"),
        ("--marker", "blob", "--marker-id", "3"),
        ("--wall", "-1"),
    ],
)
def test_senseless_options(trial: Swim, words: tuple[str, ...]) -> None:
    status, _, err = trial(*words)
    assert status == 2 and err.count("\n") == 1


def test_a_rendered_fish(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The only one here with real pictures and the real tracker."""
    simulated = SimBoard("tank", seed=1, camera_fps=15)
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: SimTransport(simulated))
    with Fish.connect("it") as fish:
        fish.upload_reference(records.encode_reference(1.0, [0.03, 0.06]))
        fish.params.set("DU_MAX_RAD", 0)
        fish.upload_amplitudes(np.array([0.4, 0.5], np.float32))
    words = ["trial", "run", "--camera", "rendered", "--marker-id", "3", "--connect", "it"]
    assert run([*words, "--json"]) == 0
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert err == "" and document["end"] == "complete"
    assert document["camera"]["seen"] > 2 * 15
    measured = document["beats"][1]
    assert measured["speed_m_s"] == pytest.approx(simulated.world.true_beats()[1], abs=2.5e-3)


def test_only_a_board_in_this_process_can_be_drawn(
    trial: Swim, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Fish, "sim", None)
    status, _, err = trial("--camera", "rendered")
    assert status == 1 and "tailbeat sim" in err
