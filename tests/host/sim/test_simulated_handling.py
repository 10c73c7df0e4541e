"""The simulated fish in the plane and in somebody's hands, through the firmware: where it goes,
what its camera and its IMU say of it, and the words of a second keyboard."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError
from tailbeat.core.reference import Reference
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.sensors.camera.simulated import SimulatedCamera
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import CameraFrame, SimTransport, SimulatedBoard
from tailbeat.sim.commands import WORDS, Lines, obey
from tailbeat.sim.native import SimBoard

US_PER_RAD = 572.9578
TURN_PER_M_RAD = -3.0
BEATS = 10
AMPLITUDE_RAD = 0.6


class Filming(SimulatedCamera):
    """Keeps what it has seen."""

    def __init__(self, board: SimulatedBoard) -> None:
        super().__init__(board)
        self.seen: list[CameraFrame] = []

    def moments(self) -> list[CameraFrame]:
        """As the camera's."""
        new = super().moments()
        self.seen += new
        return new


class Swum:
    """One swim at a steady amplitude with a tail that is mounted askew by ``centre_rad``."""

    def __init__(self, folder: Path, centre_rad: float, centre_us: float = 1500.0) -> None:
        url = f"sim:tank?seed=3&tail_centre_rad={centre_rad}&flow_sigma_m_s=0"
        with Fish.connect(url) as fish:
            board = fish.sim
            assert board is not None
            fish.params.set("SERVO_CENTRE_US", centre_us)
            fish.params.set("AMP_MAX_RAD", 0.7)
            fish.params.set("DU_MAX_RAD", 0)
            fish.upload_reference(Reference(1.0, np.full(BEATS, 0.05, np.float32), "even").record())
            fish.upload_amplitudes([AMPLITUDE_RAD] * BEATS)
            fish.link.run(9.0)  # at rest the IMU learns which way is down
            fish.arm()
            camera = Filming(board)
            outcome = run_trial(fish, camera)
            assert outcome.end == "complete"
            self.trial: Trial = read_trial(fish.pull_trial(outcome.number, folder))
            self.truth = board.truth()
            self.beats_m_s = board.true_beats()
            self.pictures = camera.seen
            self.board = board

    @property
    def turned_rad(self) -> float:
        """By the IMU, over all slots of the file."""
        turns = self.trial.slots.table()["turn_rad"]
        assert np.isfinite(turns).mean() > 0.9
        return float(np.nansum(turns))

    def seen_heading_rad(self) -> float:
        """By the camera, at the end of the way: the mean over the last beat that was swum."""
        far = max(picture.x_m for picture in self.pictures)
        last = [p.heading_rad for p in self.pictures if abs(p.x_m - far) < 0.03]
        assert len(last) > 5
        return float(np.mean(last))


@pytest.fixture(scope="module")
def straight(tmp_path_factory: pytest.TempPathFactory) -> Swum:
    return Swum(tmp_path_factory.mktemp("straight"), 0.0)


@pytest.fixture(scope="module")
def crooked(tmp_path_factory: pytest.TempPathFactory) -> Swum:
    return Swum(tmp_path_factory.mktemp("crooked"), 0.12)


def test_a_crooked_tail_turns_it_by_its_way(straight: Swum, crooked: Swum) -> None:
    way_m = float(crooked.beats_m_s.sum())
    assert way_m > 0.5
    assert straight.truth.heading_rad == 0
    assert np.allclose(crooked.beats_m_s, straight.beats_m_s, atol=1e-12)
    turned = TURN_PER_M_RAD * 0.12 * way_m
    assert turned < -0.15
    assert min(p.heading_rad for p in crooked.pictures) < turned


def test_camera_and_imu_agree(straight: Swum, crooked: Swum) -> None:
    assert crooked.turned_rad == pytest.approx(crooked.seen_heading_rad(), abs=0.01)
    assert crooked.turned_rad < -0.15
    assert straight.turned_rad == pytest.approx(0, abs=0.03)
    assert straight.seen_heading_rad() == pytest.approx(0, abs=0.03)


def test_it_swims_to_port(crooked: Swum) -> None:
    port = min(p.y_m for p in crooked.pictures)
    assert port < -0.05
    way_m = float(crooked.beats_m_s.sum())
    radius_m = 1 / (3 * 0.12)
    far = max(crooked.pictures, key=lambda p: p.x_m)
    assert math.hypot(far.x_m, far.y_m + radius_m) == pytest.approx(radius_m, abs=0.02)
    assert far.x_m < way_m + 0.15  # it coasts on for a second


def test_trimmed_it_swims_as_a_straight_one(straight: Swum, tmp_path: Path) -> None:
    trimmed = Swum(tmp_path, 0.12, 1500 - 0.12 * US_PER_RAD)
    assert abs(trimmed.turned_rad) < 0.03
    assert max(abs(p.y_m) for p in trimmed.pictures) < 0.03
    # Its pulses are whole ticks about a centre that is none.
    assert np.allclose(trimmed.beats_m_s, straight.beats_m_s, atol=2e-4)


def test_pictures_show_it_back_at_the_start(crooked: Swum) -> None:
    board = crooked.board
    board.run(10.0)
    last = board.camera_frames()[-25:]
    assert all(abs(p.x_m) < 0.01 and abs(p.y_m) < 0.01 for p in last)
    assert np.mean([p.heading_rad for p in last]) == pytest.approx(0, abs=0.01)
    truth = board.truth()
    assert (truth.x_m, truth.y_m, truth.heading_rad, truth.v_m_s) == (0, 0, 0, 0)


def test_another_pack_boots_the_board_and_keeps_its_flash() -> None:
    board = SimBoard("tank", battery_v=6.0)
    board.run(10.0)
    flash = board.flash
    board.swap_battery(8.3, 0.95, 0.02)
    assert board.board_time_s < 0.1
    assert board.flash == flash
    board.run(3.0)
    assert Fish(SimTransport(board)).status().battery_v == pytest.approx(8.3, abs=0.05)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e9])
def test_senseless_handling_is_refused(bad: float) -> None:
    board = SimBoard("tank")
    acts: tuple[Callable[[], None], ...] = (
        lambda: board.push(bad),
        lambda: board.hold(bad),
        lambda: board.stir(bad),
        lambda: board.set_start(bad),
        lambda: board.set_tilt_rad(bad),
        lambda: board.set_battery_v(bad),
        lambda: board.place(bad, 0, 0),
        lambda: board.place(0, bad, 0),
        lambda: board.place(0, 0, bad),
        lambda: board.swap_battery(bad),
        lambda: board.swap_battery(8, bad),
        lambda: board.swap_battery(8, 1, bad),
    )
    for act in acts:
        with pytest.raises(InputError):
            act()
    board.run(2.0)
    assert board.truth().x_m == 0


class Told:
    """A board that notes what is done to it."""

    def __init__(self) -> None:
        self.done: list[tuple[Any, ...]] = []

    def __getattr__(self, name: str) -> Any:
        return lambda *values: self.done.append((name, *values))


@pytest.fixture
def told() -> Iterator[Any]:
    yield Told()


SAID = {
    "push -0.05": ("push", -0.05),
    "hold 3": ("hold", 3.0),
    "stir 0.01": ("stir", 0.01),
    "place 0 0.1 -0.2": ("place", 0.0, 0.1, -0.2),
    "start 0.02": ("set_start", 0.02),
    "tilt 0.5": ("set_tilt_rad", 0.5),
    "battery 6.2": ("set_battery_v", 6.2),
    "swap 8.2": ("swap_battery", 8.2),
    "swap 8.2 0.97 0.02": ("swap_battery", 8.2, 0.97, 0.02),
    "camera off": ("set_camera", False),
    "camera on": ("set_camera", True),
    "radio off": ("set_radio", False),
    "radio on": ("set_radio", True),
    "imu off": ("set_imu", False),
    "imu on": ("set_imu", True),
    "imu reboot": ("reboot_imu",),
    "imu wedge": ("wedge_imu",),
    "power cycle": ("power_cycle",),
    "swim 7": ("set_swim", 7),
}


def test_every_word_does_what_it_says(told: Any) -> None:
    assert {line.split()[0] for line in SAID} == WORDS.keys() - {"truth", "help", "config"}
    for line, done in SAID.items():
        told.done.clear()
        assert obey(told, f"  {line} \r") == "ok"
        assert told.done == [done]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("pusch 1", "push, hold, stir"),
        ("push", "Write: push M_S"),
        ("push fast", "Write: push M_S"),
        ("push 1 2", "Write: push M_S"),
        ("place 0 0", "Write: place X_M Y_M HEADING_RAD"),
        ("swap", "Write: swap V [GAIN] [CENTRE_RAD]"),
        ("swap 8 1 0 0", "Write: swap V"),
        ("camera", "Write: camera on|off"),
        ("camera of", "Write: camera on|off"),
        ("imu on off", "Write: imu on|off|reboot|wedge"),
        ("swim 1.5", "1 is the first"),
        ("swim nan", "1 is the first"),
        ("swim inf", "1 is the first"),
        ("swim 0", "1 is the first"),
        ("truth now", "Write: truth"),
    ],
)
def test_a_wrong_line_says_what_is_right(told: Any, line: str, words: str) -> None:
    answer = obey(told, line)
    assert words in answer
    assert "\n" not in answer
    assert told.done == []


def test_truth_is_json_and_help_tells_all_words() -> None:
    board = SimBoard("tank")
    obey(board, "place 0.1 0.2 0.3")
    assert json.loads(obey(board, "truth"))["heading_rad"] == 0.3
    assert [line.split()[0] for line in obey(board, "help").splitlines()] == list(WORDS)


def test_the_page_has_every_word_and_its_method() -> None:
    page = (Path(__file__).parents[3] / "docs" / "simulator.md").read_text().replace("\\|", "|")
    for word in WORDS.values():
        assert f"| `{word.use}` |" in page
    for done in SAID.values():
        name = str(done[0])
        assert f"`{name}(" in page
        assert hasattr(SimBoard, name)


def test_lines_come_in_pieces(told: Any) -> None:
    lines = Lines(told)
    assert lines.hear(b"pu") == b""
    assert lines.hear(b"sh 0.1\n\n# a bump\nhold") == b"ok\n"
    assert lines.hear(b" 2\r\nstir 0.01") == b"ok\n"
    assert told.done == [("push", 0.1), ("hold", 2.0)]
    assert lines.hear(b"", last=True) == b"ok\n"
    assert told.done[-1] == ("stir", 0.01)
    assert b"there is no word" in lines.hear(b"x" * 5000)
    assert b"there is no word" in lines.hear(b"\xff\xfe\n")
    assert lines.hear(b"tilt 0\n") == b"ok\n"
