"""The simulated fish in the plane and in somebody's hands, through the firmware: where it goes,
what its camera and its IMU say of it, and the words of a second keyboard."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError
from tailbeat.core.reference import Reference
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.sensors.camera.render.source import SimulatedCamera
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport, SimulatedBoard
from tailbeat.sim.config import config_field
from tailbeat.sim.world import VERBS, BoardControls, CameraFrame, CommandLines, World

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
        url += "&place_sigma_m=0&place_sigma_rad=0"
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
            self.truth = board.world.truth()
            self.beats_m_s = board.world.true_beats()
            self.pictures = camera.seen
            self.board = board

    @property
    def turned_rad(self) -> float:
        """By the IMU, over all slots of the file."""
        turns = self.trial.slots.table()["turn_rad"]
        assert np.isfinite(turns).mean() > 0.9
        return float(np.nansum(turns))

    def seen_heading_rad(self) -> float:
        """By the camera, at the end of the way: the mean over the last beat that was executed."""
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
    truth = board.world.truth()
    assert (truth.x_m, truth.y_m, truth.heading_rad, truth.v_m_s) == (0, 0, 0, 0)


def test_another_pack_boots_the_board_and_keeps_its_flash() -> None:
    board = SimBoard("tank", battery_v=6.0)
    board.run(10.0)
    flash = board.flash
    board.world.swap_battery(8.3, 0.95, 0.02)
    assert board.board_time_s < 0.1
    assert board.flash == flash
    board.run(3.0)
    assert Fish(SimTransport(board)).status().battery_v == pytest.approx(8.3, abs=0.05)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e9])
def test_senseless_handling_is_refused(bad: float) -> None:
    board = SimBoard("tank", place_sigma_m=0.0)
    acts: tuple[Callable[[], None], ...] = (
        lambda: board.world.push(bad),
        lambda: board.world.hold(bad),
        lambda: board.world.stir(bad),
        lambda: board.world.set_start(bad),
        lambda: board.world.set_tilt_rad(bad),
        lambda: board.world.turn(bad, 0, 0, 1),
        lambda: board.world.turn(0, 0, 0, bad),
        lambda: board.world.set_battery_v(bad),
        lambda: board.world.place(bad, 0, 0),
        lambda: board.world.place(0, bad, 0),
        lambda: board.world.place(0, 0, bad),
        lambda: board.world.swap_battery(bad),
        lambda: board.world.swap_battery(8, bad),
        lambda: board.world.swap_battery(8, 1, bad),
    )
    for act in acts:
        with pytest.raises(InputError):
            act()
    board.run(2.0)
    assert board.world.truth().x_m == 0


class Told:
    """Stands for the C library and for the board: notes what is done. ``lines`` obeys them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.done: list[tuple[Any, ...]] = []
        monkeypatch.setattr("tailbeat.sim.world.lib", self)
        board = BoardControls(
            now_us=lambda: 5,
            power_cycle=lambda: self.done.append(("power_cycle",)),
            set_radio=lambda connected: self.done.append(("set_radio", connected)),
            imu_changed=lambda: self.done.append(("imu_changed",)),
        )
        self.lines = CommandLines(World(None, board), {})

    def __getattr__(self, name: str) -> Any:
        return lambda _, *values: self.done.append((name, *values))


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> Told:
    return Told(monkeypatch)


def obey(board: SimBoard, line: str) -> str:
    return CommandLines(board.world, {"plant": board.plant}).obey(line)


IMU = ("imu_changed",)
SAID: dict[str, list[tuple[Any, ...]]] = {
    "push -0.05": [("world_push", -0.05)],
    "hold 3": [("world_hold", 3.0)],
    "stir 0.01": [("world_stir", 0.01)],
    "place 0 0.1 -0.2": [("world_place", 0.0, 0.1, -0.2)],
    "start 0.02": [("world_set_start", 0.02)],
    "tilt 0.5": [("world_set_tilt_rad", 0.5)],
    "turn 1.5 0 -6.3 4": [("world_turn", 1.5, 0.0, -6.3, 4.0)],
    "battery 6.2": [("world_set_battery_v", 6.2)],
    "swap 8.2": [("world_swap_battery", 8.2, 1.0, 0.0), ("power_cycle",)],
    "swap 8.2 0.97 0.02": [("world_swap_battery", 8.2, 0.97, 0.02), ("power_cycle",)],
    "camera off": [("world_set_camera", False)],
    "camera on": [("world_set_camera", True)],
    "radio off": [("set_radio", False)],
    "radio on": [("set_radio", True)],
    "imu off": [("world_set_imu", 5, False), IMU],
    "imu on": [("world_set_imu", 5, True), IMU],
    "imu reboot": [("world_imu_reboot", 5), IMU],
    "imu wedge": [("world_imu_wedge",), IMU],
    "power cycle": [("power_cycle",)],
    "swim 7": [("world_set_swim", 7)],
}


def test_every_verb_does_what_it_says(told: Told) -> None:
    assert {line.split()[0] for line in SAID} == VERBS.keys()
    for line, done in SAID.items():
        told.done.clear()
        assert told.lines.obey(f"  {line} \r") == "ok"
        assert told.done == done


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
def test_a_wrong_line_says_what_is_right(told: Told, line: str, words: str) -> None:
    answer = told.lines.obey(line)
    assert words in answer
    assert "\n" not in answer
    assert told.done == []


def test_truth_is_json_and_help_tells_all_words() -> None:
    board = SimBoard("tank")
    obey(board, "place 0.1 0.2 0.3")
    assert json.loads(obey(board, "truth"))["heading_rad"] == 0.3
    names = [line.split()[0] for line in obey(board, "help").splitlines()]
    assert names == [*VERBS, "truth", "config", "help"]


def test_the_page_has_every_verb_and_its_method() -> None:
    path = Path(__file__).parents[3] / "docs" / "how-to" / "simulate.md"
    page = path.read_text().replace("\\|", "|")
    for verb in VERBS.values():
        assert f"| `{verb.use}` |" in page
    methods = {name for name, value in vars(World).items() if callable(value) and name[0] != "_"}
    for name in methods - {"truth", "true_beats", "true_speeds_25hz"}:
        assert f"`{name}(" in page


def test_lines_come_in_pieces(told: Told) -> None:
    lines = told.lines
    assert lines.hear(b"pu") == b""
    assert lines.hear(b"sh 0.1\n\n# a bump\nhold") == b"ok\n"
    assert lines.hear(b" 2\r\nstir 0.01") == b"ok\n"
    assert told.done == [("world_push", 0.1), ("world_hold", 2.0)]
    assert lines.hear(b"", last=True) == b"ok\n"
    assert told.done[-1] == ("world_stir", 0.01)
    assert b"there is no word" in lines.hear(b"x" * 5000)
    assert b"there is no word" in lines.hear(b"\xff\xfe\n")
    assert lines.hear(b"tilt 0\n") == b"ok\n"


def test_a_short_name_of_several_values_says_which() -> None:
    with pytest.raises(InputError, match=r"battery may mean battery_v, battery_"):
        config_field("battery")
    with pytest.raises(InputError, match=r"Did you mean kappa\?"):
        config_field("kapa")
