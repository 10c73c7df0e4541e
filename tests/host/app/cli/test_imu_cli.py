"""The board's IMU from the host: what it says, settings that last, raw frames; and the commands."""

from __future__ import annotations

import csv
import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tailbeat.app.cli import run
from tailbeat.board.fish import Fish
from tailbeat.core.errors import Refused
from tailbeat.link import _dialect as mavlink
from tailbeat.link.frames import Framer
from tailbeat.link.messages import IMU_HEALTH, imu_health, unwrapped_s

BOOT_US = (1 << 32) - 500_000  # the board's clock; its low half wraps soon
NO_IMU, NOT_SIGNED = 59, 62


class ScriptedBoard:
    """Answers what these commands ask, and streams frames when asked to; virtual time."""

    name = "scripted"

    def __init__(self) -> None:
        self.info: dict[str, Any] = {
            "baud": 115200,
            "still_s": 12.0,
            "rate_hz": 100,
            "model": b"VN-100S-CR",
            "firmware": b"3.1.0.0",
            "port": 2,
            "state": 3,
            "problem": 0,
            "error": 0,
        }
        self.health: dict[str, int] = {"imu_frames": 1234}
        self.refuse_save = False
        self.refuse_stream = 0
        self.saved = 0
        self.intervals: list[float] = []
        self.lost_frames: set[int] = set()  # messages that begin with these are not sent
        self._mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._framer = Framer(mavlink.MAVLink(None))
        self._out = b""
        self._now_us = 0
        self._sequence = 1000
        self._next_us = 0

    def read(self) -> bytes:
        data, self._out = self._out, b""
        return data

    def wait(self, timeout_s: float) -> None:
        self._now_us += max(1, min(round(timeout_s * 1e6), 10_000))
        if self.intervals[-1:] == [0.0] and self._now_us >= self._next_us:
            self._next_us = self._now_us + 40_000
            self._send_frames()

    def now_s(self) -> float:
        return self._now_us * 1e-6

    def reopen(self) -> None:
        pass

    def close(self) -> None:
        pass

    def write(self, data: bytes) -> None:
        for message in self._framer.push(data):
            if message.get_type() == "COMMAND_LONG":
                self._command(message)
            elif message.get_type() == "TIMESYNC" and message.tc1 == 0:
                board_ns = (BOOT_US + self._now_us) * 1000
                self._send(mavlink.MAVLink_timesync_message(board_ns, message.ts1))

    def _command(self, m: Any) -> None:
        if m.command == mavlink.MAV_CMD_REQUEST_MESSAGE:
            told = {148: self._version, 52505: self._health, 52507: self._info}
            self._send(told[round(m.param1)]())
            return
        fault = 0
        if m.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            assert m.param1 == mavlink.MAVLINK_MSG_ID_TAILBEAT_IMU
            self.intervals.append(m.param2)
            fault = self.refuse_stream
        elif m.command == mavlink.TAILBEAT_CMD_IMU_SAVE:
            fault = NO_IMU if self.refuse_save else 0
            self.saved += not fault
        result = mavlink.MAV_RESULT_DENIED if fault else mavlink.MAV_RESULT_ACCEPTED
        self._send(mavlink.MAVLink_command_ack_message(m.command, result, 0, fault, 255, 190))

    def _version(self) -> Any:
        none = [0] * 8
        return mavlink.MAVLink_autopilot_version_message(0, 0, 0, 0, 0, none, none, none, 0, 0, 7)

    def _info(self) -> Any:
        return mavlink.MAVLink_tailbeat_imu_info_message(**self.info)

    def _health(self) -> Any:
        names = mavlink.MAVLink_tailbeat_health_message.fieldnames
        return mavlink.MAVLink_tailbeat_health_message(
            **{name: self.health.get(name, 0) for name in names}
        )

    def _send_frames(self) -> None:
        first, self._sequence = self._sequence, self._sequence + 4
        times = [(BOOT_US + self._now_us - 30_000 + 10_000 * i) & 0xFFFFFFFF for i in range(4)]
        vectors = [float(first + i) + axis / 4 for i in range(4) for axis in range(3)]
        if first not in self.lost_frames:
            fields = (times, vectors, [-v for v in vectors], [2 * v for v in vectors], first, 4)
            self._send(mavlink.MAVLink_tailbeat_imu_message(*fields))

    def _send(self, message: Any) -> None:
        self._out += message.pack(self._mav)


@pytest.fixture
def board() -> ScriptedBoard:
    return ScriptedBoard()


@pytest.fixture
def shell(
    board: ScriptedBoard, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., str]:
    """Runs a command against the scripted board."""

    def connect(url: str | None = None) -> Fish:
        del url
        fish = Fish(board)
        fish.clock.sync()
        return fish

    monkeypatch.setattr("tailbeat.board.fish.Fish.connect", connect)

    def command(*words: str, status: int = 0) -> str:
        assert run(["board", "imu", *words]) == status
        out, err = capsys.readouterr()
        err = "".join(line for line in err.splitlines(True) if "no key: anyone" not in line)
        assert (err == "") == (status == 0)
        return out if status == 0 else err

    return command


def test_all_is_well_in_one_line(shell: Callable[..., str]) -> None:
    line = "VN-100S-CR, firmware 3.1.0.0, 100 Hz at 115200 baud, port 2; 1234 frames\n"
    assert shell() == line
    document = json.loads(shell("--json"))
    assert document["problem"]["name"] == "NONE"
    assert (document["model"], document["port"], document["state"]) == (
        "VN-100S-CR", 2, "streaming",
    )  # fmt: skip
    assert document["health"]["imu_frames"] == 1234
    assert document["not_well"] == []


def test_what_is_wrong_why_and_what_to_do(shell: Callable[..., str], board: ScriptedBoard) -> None:
    board.info |= {"problem": 7, "error": 12, "state": 1, "port": 0, "baud": 0}
    board.health |= {"imu_health": 0x304, "imu_lost": 17}
    text = shell()
    assert text.startswith("the line is too slow for this rate. Raise IMU_BAUD")
    assert "the IMU said: the baud rate is too low" in text
    assert "it is a VN-100S-CR, firmware 3.1.0.0; the board is configuring" in text
    assert "missing frames, no frames, not set up" in text
    assert "since boot: frames 1234, lost 17" in text


def test_waits_for_the_boards_verdict(
    shell: Callable[..., str], board: ScriptedBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    wait = ScriptedBoard.wait

    def later(self: ScriptedBoard, timeout_s: float) -> None:
        self.info["problem"] = 1 if self.now_s() < 3.0 else 8
        wait(self, timeout_s)

    board.info["problem"] = 1
    monkeypatch.setattr(ScriptedBoard, "wait", later)
    assert "its frames do not come" in shell()
    board.info["problem"] = 1
    monkeypatch.setattr(ScriptedBoard, "wait", wait)
    assert "is being set up" in shell()  # but not for ever


def test_well_now_but_not_in_the_last_seconds(
    shell: Callable[..., str], board: ScriptedBoard
) -> None:
    board.health |= {"imu_health": 0x10, "imu_restarts": 1}
    text = shell()
    assert text.splitlines()[0].startswith("VN-100S-CR")
    assert "in the last seconds: a restart of the IMU" in text
    assert "to do: Check its supply and plug." in text


def test_save(shell: Callable[..., str], board: ScriptedBoard) -> None:
    assert shell("save") == "saved; the IMU restarts with these settings\n"
    assert board.saved == 1
    board.refuse_save = True
    assert "does not stream" in shell("save", status=1)
    with pytest.raises(Refused):
        Fish(board).imu_save()


def test_record(shell: Callable[..., str], board: ScriptedBoard, tmp_path: Path) -> None:
    out = tmp_path / "raw.csv"
    board.lost_frames = {1020, 1024, 1040}
    found = json.loads(shell("record", str(out), "--seconds", "1", "--json"))
    with out.open() as file:
        rows = list(csv.DictReader(file))
    assert found["frames"] == len(rows) == pytest.approx(88, abs=8)
    assert found["missing_frames"] == 12
    assert found["duration_s"] == pytest.approx(1, abs=0.06)
    assert board.intervals == [0.0, -1.0]
    sequence = [int(row["sequence"]) for row in rows]
    assert sequence[:4] == [1000, 1001, 1002, 1003]
    times = [float(row["t_s"]) for row in rows]
    assert all(a < b for a, b in itertools.pairwise(times))
    assert times[0] < (1 << 32) * 1e-6 < times[-1]  # beyond the wrap of what the wire carries
    row = rows[5]
    assert [row[k] for k in ("accel_x_m_s2", "accel_y_m_s2", "accel_z_m_s2")] == [
        "1005.0", "1005.25", "1005.5",
    ]  # fmt: skip
    assert (row["rate_z_rad_s"], row["yaw_deg"], row["roll_deg"]) == ("-1005.5", "2010.0", "2011.0")


def test_record_of_an_imu_that_is_silent(
    shell: Callable[..., str],
    board: ScriptedBoard,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ScriptedBoard, "_send_frames", lambda self: None)
    board.info["problem"] = 2
    text = shell("record", str(tmp_path / "raw.csv"), "--seconds", "3", status=1)
    assert "no frames came: nothing comes from the IMU. Check its supply" in text
    assert board.intervals[0] == 0.0
    assert board.intervals.count(0.0) >= 2  # the board may have ended the stream: asked again
    assert board.intervals[-1] == -1.0


@pytest.mark.parametrize("silent", [False, True])
def test_a_recording_that_never_begins_leaves_the_files_as_they_are(
    silent: bool,
    shell: Callable[..., str],
    board: ScriptedBoard,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if silent:
        monkeypatch.setattr(ScriptedBoard, "_send_frames", lambda self: None)
    else:
        board.refuse_stream = NOT_SIGNED
    held = tmp_path / "held.csv"
    held.write_text("yesterday's")
    for out in (held, tmp_path / "new.csv"):
        shell("record", str(out), "--seconds", "3", status=1)
    assert [path.name for path in tmp_path.iterdir()] == ["held.csv"]
    assert held.read_text() == "yesterday's"


def test_an_abandoned_stream_is_ended(board: ScriptedBoard) -> None:
    fish = Fish(board)
    fish.clock.sync()
    frames = fish.imu_frames()
    assert next(frames).sequence == 1000
    frames.close()
    assert board.intervals == [0.0, -1.0]


@pytest.mark.parametrize("board_s", [0.0, 4294.9, 4295.1, 9000.0, 123456.7])
@pytest.mark.parametrize("late_s", [-0.5, 0.0, 1.0, 2000.0])
def test_times_unwrap(board_s: float, late_s: float) -> None:
    time_s = max(board_s - late_s, 0.0)
    low_us = round(time_s * 1e6) & 0xFFFFFFFF
    assert unwrapped_s(low_us, board_s) == pytest.approx(time_s, abs=1e-6)


def test_health_bits_of_the_dialect_all_have_words() -> None:
    names = {
        number: entry.name
        for number, entry in mavlink.enums["TAILBEAT_IMU_HEALTH"].items()
        if not entry.name.endswith("ENUM_END")
    }
    assert set(names) == set(IMU_HEALTH)
    assert [words for words, _ in imu_health(0x108)] == [
        "bytes lost in the board's port", "no frames",
    ]  # fmt: skip


def test_the_simulated_board(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    with Fish.connect("sim:tank?seed=1") as fish:
        fish.link.run(5.0)
        info = fish.imu_info()
        assert info.problem.well
        assert (info.state, info.rate_hz) == ("streaming", 100)
        assert info.model is not None
        assert info.model.startswith("VN-100")
        frames = list(fish.imu_frames(2.0))
        assert len(frames) == pytest.approx(200, abs=10)
        assert [f.sequence for f in frames] == list(
            range(frames[0].sequence, frames[0].sequence + len(frames))
        )
        assert frames[-1].time_s == pytest.approx(fish.clock.now_s(), abs=0.3)
        assert all(abs(f.accel_m_s2[2] + 9.8) < 1 for f in frames)
    assert run(["board", "imu", "--connect", "sim"]) == 0
    assert capsys.readouterr().out.startswith("VN-100")
    out = tmp_path / "raw.csv"
    assert run(["board", "imu", "record", str(out), "--seconds", "6", "--connect", "sim"]) == 0
    assert "0 missing" in capsys.readouterr().out
