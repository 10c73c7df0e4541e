"""A VN-100 on a port: a pty, sources in virtual time, and the simulator's sensor."""

from __future__ import annotations

import binascii
import heapq
import json
import os
import re
import struct
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tailbeat.app.cli import run
from tailbeat.core.errors import InputError, LinkLostError
from tailbeat.core.native import ffi, lib
from tailbeat.sensors.vn100.decode import Reader
from tailbeat.sensors.vn100.live import (
    BAUDS,
    Driver,
    LiveSensor,
    SensorError,
    SerialSource,
    configure,
    find_baud,
)

YMR = (
    b"$VNYMR,+100.949,-007.330,+000.715,-00.0049,-00.2449,+00.5397,-01.258,-00.100,-09.701,"
    b"-00.000018,+00.001122,-00.000551*69\r\n"
)


def fish_frame(time_ns: int) -> bytes:
    """The 64-byte frame the fish uses."""
    values = (10.0, -2.5, 0.75, 0.01, -0.02, 0.5, -0.4, -0.4, -9.8, 0.016, -0.25, 0.004)
    frame = struct.pack("<BBHHQ12f", 0xFA, 0x11, 0x0129, 0x0040, time_ns, *values)
    return frame + struct.pack(">H", binascii.crc_hqx(frame[1:], 0))


class ScriptedSource:
    """Sends ``make(now_s)`` every 20 ms, in virtual time. ``make`` may raise."""

    name = "scripted"
    has_baud = True

    def __init__(self, make: Callable[[float], bytes], right_baud: int = 115200) -> None:
        self.make = make
        self.right_baud = right_baud
        self.baud = 0
        self.bauds: list[int] = []
        self.sent = b""
        self.closed = False
        self._time_s = 100.0
        self._next_s = 100.02
        self._waiting = b""

    def read(self) -> bytes:
        data, self._waiting = self._waiting, b""
        return data if self.baud == self.right_baud else bytes(0x80 | b >> 1 for b in data)

    def write(self, data: bytes) -> None:
        self.sent += data

    def wait(self, timeout_s: float) -> None:
        self._time_s = min(self._time_s + max(timeout_s, 1e-6), self._next_s)
        if self._time_s == self._next_s:
            self._waiting += self.make(self._time_s)
            self._next_s += 0.02

    def now_s(self) -> float:
        return self._time_s

    def set_baud(self, baud: int) -> None:
        self.baud = baud
        self.bauds.append(baud)

    def reopen(self) -> None:
        """There is nothing to open."""

    def close(self) -> None:
        self.closed = True


class SimulatedSensor:
    """The simulator's VN-100 on its line, in virtual time; keywords are those of sim_config_t."""

    name = "the simulated sensor"
    has_baud = True

    def __init__(self, **overrides: float) -> None:
        config = ffi.new("sim_config_t *")
        lib.sim_config_default(config, 1)
        for name, value in overrides.items():
            setattr(config, name, value)
        self.baud = 115200
        self._world: Any = ffi.gc(lib.world_new(config), lib.world_free)
        assert self._world != ffi.NULL
        self._now_us = 0
        self._waiting = b""
        self._under_way: list[tuple[int, int, bytes, int]] = []  # of both directions
        self._count = 0
        lib.world_imu_power_on(self._world, 0)

    def plug(self, plugged: bool) -> None:
        """Its connector."""
        lib.world_set_imu(self._world, self._now_us, plugged)

    def wedge(self) -> None:
        """Silent and deaf."""
        lib.world_imu_wedge(self._world)

    def reboot(self) -> None:
        """As by its own watchdog."""
        lib.world_imu_reboot(self._world, self._now_us)

    def read(self) -> bytes:
        data, self._waiting = self._waiting, b""
        return data

    def write(self, data: bytes) -> None:
        self._send(self._now_us, data, -self.baud)

    def wait(self, timeout_s: float) -> None:
        end_us = self._now_us + max(1, round(timeout_s * 1e6))
        while not self._waiting and self._now_us < end_us:
            self._advance(end_us)

    def now_s(self) -> float:
        return self._now_us * 1e-6

    def set_baud(self, baud: int) -> None:
        self.baud = baud

    def reopen(self) -> None:
        """There is nothing to open."""

    def close(self) -> None:
        pass

    def _send(self, begin_us: int, data: bytes, baud: int) -> None:
        """Negative ``baud``: towards the sensor."""
        arrival_us = begin_us + len(data) * 10_000_000 // abs(baud)
        self._count += 1
        heapq.heappush(self._under_way, (arrival_us, self._count, data, baud))

    def _advance(self, end_us: int) -> None:
        """To the next thing that happens, or to ``end_us``."""
        due_us = int(lib.world_imu_due_us(self._world))
        arrival_us = self._under_way[0][0] if self._under_way else end_us
        next_us = min(due_us, arrival_us, end_us)
        while lib.world_time_us(self._world) + 20_000 <= next_us:
            lib.world_frame(self._world, lib.world_time_us(self._world) + 20_000, 0)
        self._now_us = max(self._now_us, next_us)
        if due_us <= next_us:
            self._leaves(due_us)
        elif self._under_way and arrival_us <= next_us:
            self._arrives(*heapq.heappop(self._under_way)[2:])

    def _leaves(self, due_us: int) -> None:
        out = ffi.new("uint8_t[]", 640)
        baud = int(lib.world_imu_baud(self._world))
        length = lib.world_imu_read(self._world, out)
        self._send(due_us, bytes(ffi.buffer(out, length)), baud)

    def _arrives(self, data: bytes, baud: int) -> None:
        if baud < 0:
            lib.world_imu_write(self._world, self._now_us, data, len(data), -baud)
        elif baud == self.baud:
            self._waiting += data
        else:
            self._waiting += bytes(0x80 | byte >> 1 for byte in data)


@pytest.fixture
def use(monkeypatch: pytest.MonkeyPatch) -> Callable[[Any], None]:
    """Makes the command open this source, under the name of a port."""

    def put(source: Any) -> None:
        monkeypatch.setattr("tailbeat.app.cli.imu.open_source", lambda name, baud: source)
        monkeypatch.setattr("tailbeat.app.cli.imu.is_port", lambda name: True)

    return put


def frames() -> Callable[[float], bytes]:
    """The fish's frame for every 20 ms of a scripted source."""
    return lambda now_s: fish_frame(round(now_s * 1e9))


def lines_of(capsys: pytest.CaptureFixture[str], *words: str) -> list[dict[str, Any]]:
    assert run(["board", "imu", "decode", "port", "--json", *words]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    return [json.loads(text) for text in out.splitlines()]


def test_listens_at_the_usual_rate_first(
    capsys: pytest.CaptureFixture[str], use: Callable[[Any], None]
) -> None:
    source = ScriptedSource(frames())
    use(source)
    found = lines_of(capsys, "--seconds", "1")
    assert found[0] == {"event": "found", "source": "scripted", "baud": 115200}
    kinds = {f["kind"] for f in found if f["event"] == "message"}
    assert kinds == {"groups=11 fields=0129,0040"}
    assert found[1]["values"]["yaw_deg"] == 10.0
    assert found[1]["values"]["rate_y_rad_s"] == -0.02
    summary = found[-1]
    assert (summary["event"], summary["skipped_bytes"]) == ("summary", 0)
    assert summary["binary_valid"] == len(found) - 2 >= 49
    assert summary["rate_hz"] == pytest.approx(50)
    assert (summary["lost_frames"], summary["hints"], source.sent) == (0, [], b"")
    assert source.closed


def test_finds_another_rate() -> None:
    source = ScriptedSource(lambda now_s: YMR, right_baud=921600)
    assert find_baud(LiveSensor(source)) == 921600
    assert source.bauds == list(BAUDS[: BAUDS.index(921600) + 1])


def test_only_one_rate_when_told(
    capsys: pytest.CaptureFixture[str], use: Callable[[Any], None]
) -> None:
    source = ScriptedSource(lambda now_s: YMR, right_baud=921600)
    use(source)
    assert run(["board", "imu", "decode", "port", "--baud", "115200"]) == 1
    assert "no message of a VN-100 at 115200 baud" in capsys.readouterr().err
    assert source.bauds == [115200]


def test_silence_is_told_with_what_to_look_at(
    capsys: pytest.CaptureFixture[str], use: Callable[[Any], None]
) -> None:
    source = ScriptedSource(lambda now_s: b"")
    use(source)
    begin_s = source.now_s()
    assert run(["board", "imu", "decode", "port"]) == 1
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    for words in ("nothing comes from scripted", "pins 8", "RS-232", "register 75", "--config"):
        assert words in err
    assert source.now_s() - begin_s < 3
    assert source.closed


def test_control_c_ends_with_the_summary(
    capsys: pytest.CaptureFixture[str], use: Callable[[Any], None]
) -> None:
    def make(now_s: float) -> bytes:
        if now_s > 101:
            raise KeyboardInterrupt
        return YMR

    use(ScriptedSource(make))
    assert run(["board", "imu", "decode", "port"]) == 0
    out, _ = capsys.readouterr()
    assert out.splitlines()[0] == "scripted: messages at 115200 baud"
    assert "$VNYMR: 50 lines" in out


def test_a_lost_port_is_an_error_behind_the_summary(
    capsys: pytest.CaptureFixture[str], use: Callable[[Any], None]
) -> None:
    def make(now_s: float) -> bytes:
        if now_s > 101:
            raise LinkLostError("the port is gone", "Look.")
        return YMR

    use(ScriptedSource(make))
    assert run(["board", "imu", "decode", "port"]) == 1
    out, err = capsys.readouterr()
    assert "$VNYMR: 50 lines" in out
    assert err == "tailbeat: the port is gone. Look.\n"
    use(ScriptedSource(make))
    assert run(["board", "imu", "decode", "port", "--json"]) == 1
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines[-2]["event"] == "summary"
    assert lines[-1] == {"error": {"message": "the port is gone", "remedy": "Look."}}


def test_a_person_sees_one_line(
    capsys: pytest.CaptureFixture[str],
    use: Callable[[Any], None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shown: list[str] = []
    monkeypatch.setattr("tailbeat.app.cli.imu.Display.show", lambda _, text: shown.append(text))
    use(ScriptedSource(lambda now_s: YMR if now_s < 102 else b""))
    assert run(["board", "imu", "decode", "port", "--seconds", "5"]) == 0
    assert re.fullmatch(r"1[0-2] messages, 0 damaged", shown[1])
    assert shown[-1].endswith("; silent for 3 s")
    shown.clear()
    use(ScriptedSource(lambda now_s: YMR))
    assert run(["board", "imu", "decode", "port", "--seconds", "5", "--json"]) == 0
    assert not shown


def test_csv_of_a_live_source(
    capsys: pytest.CaptureFixture[str], use: Callable[[Any], None], tmp_path: Path
) -> None:
    use(ScriptedSource(frames()))
    out = tmp_path / "live.csv"
    lines_of(capsys, "--seconds", "0.2", "--csv", str(out))
    rows = out.read_text().splitlines()
    assert rows[0].startswith("t_s,time_startup_ns,yaw_deg,")
    assert len(rows) >= 11
    assert float(rows[2].split(",")[0]) == pytest.approx(0.02, abs=0.001)


def test_a_half_message_is_given_up_in_a_silence() -> None:
    def make(now_s: float) -> bytes:
        return fish_frame(1) if now_s > 100.5 else fish_frame(0)[:40] if now_s < 100.03 else b""

    source = ScriptedSource(make)
    source.set_baud(115200)
    live = LiveSensor(source)
    assert sum(map(len, live.batches(1.0))) >= 20
    assert live.reader.counters.crc_failed == 0
    assert live.reader.counters.dropped == 1


@pytest.fixture
def pty_port(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A serial port that brings a frame for every wait."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    wait = SerialSource.wait
    sent = 0

    def feed(self: SerialSource, timeout_s: float) -> None:
        nonlocal sent
        os.write(ours, YMR + fish_frame(sent * 10_000_000))
        sent += 1
        wait(self, timeout_s)

    monkeypatch.setattr(SerialSource, "wait", feed)
    yield os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


def test_a_serial_port(capsys: pytest.CaptureFixture[str], pty_port: str) -> None:
    assert run(["board", "imu", "decode", pty_port, "--json", "--seconds", "0.02"]) == 0
    found = [json.loads(text) for text in capsys.readouterr().out.splitlines()]
    assert found[0] == {"event": "found", "source": pty_port, "baud": 115200}
    assert (found[-1]["binary_valid"], found[-1]["ascii_valid"]) >= (1, 1)
    assert (found[-1]["skipped_bytes"], found[-1]["lost_frames"]) == (0, 0)


@pytest.mark.parametrize("firmware", [2, 3])
@pytest.mark.parametrize(("port", "baud", "rate"), [(1, 115200, 100), (2, 230400, 200)])
def test_sets_the_simulated_sensor_up(firmware: int, port: int, baud: int, rate: int) -> None:
    sensor = SimulatedSensor(imu_firmware=firmware, imu_port=port, imu_noise=1.0)
    live = LiveSensor(sensor, Driver(baud, rate, sensor.now_s()))
    setup = configure(live)
    assert sensor.now_s() < 5
    assert setup.model.startswith("VN-100")
    assert setup.firmware.startswith(f"{firmware}.")
    assert (setup.port, setup.baud, setup.found_baud, setup.rate_hz) == (port, baud, 115200, rate)
    assert setup.problem.well
    set_to = {r.register: r.values for r in setup.registers}
    assert set_to.get(5) == (str(baud) if baud != 115200 else None)
    assert set_to[6] == "0"
    assert set_to[75] == f"{port},{800 // rate},11,0129,0040"
    assert set_to[85].startswith(f"0,{800 // rate},{800 // rate},")
    assert (sensor.baud, live.driver and live.driver.state) == (baud, "streaming")


def test_config_command(capsys: pytest.CaptureFixture[str], use: Callable[[Any], None]) -> None:
    use(SimulatedSensor(imu_baud=460800))
    found = lines_of(capsys, "--config", "--seconds", "2")
    head, summary = found[0], found[-1]
    assert (head["event"], head["baud"], head["found_baud"]) == ("configured", 115200, 460800)
    assert {r["register"] for r in head["registers"]} >= {5, 6, 75, 85}
    assert all(r["name"] for r in head["registers"])
    assert summary["headers"].keys() == {"groups=11 fields=0129,0040"}
    assert summary["binary_valid"] == pytest.approx(200, abs=3)
    assert summary["bytes"] - 64 * summary["binary_valid"] in range(64)  # none from before
    assert (summary["lost_frames"], summary["skipped_bytes"]) == (0, 0)
    use(SimulatedSensor())
    assert run(["board", "imu", "decode", "port", "--config", "--seconds", "0.1"]) == 0
    out, _ = capsys.readouterr()
    assert "VN-100" in out.splitlines()[0]
    assert "port 2, 115200 baud, 100 Hz" in out.splitlines()[0]
    assert "register 75  2,8,11,0129,0040" in out


def test_config_says_what_is_wrong() -> None:
    unplugged = SimulatedSensor()
    unplugged.plug(False)
    with pytest.raises(SensorError, match=r"nothing comes.*pins 8"):
        configure(LiveSensor(unplugged, Driver(115200, 100, 0.0)))
    assert unplugged.now_s() < 6
    talking = ScriptedSource(lambda now_s: YMR)
    with pytest.raises(SensorError, match="answers no command"):
        configure(LiveSensor(talking, Driver(115200, 100, talking.now_s())))


def test_a_restarted_sensor_is_set_up_again() -> None:
    sensor = SimulatedSensor()
    live = LiveSensor(sensor, Driver(115200, 100, sensor.now_s()))
    configure(live)
    list(live.batches(1.0))
    sensor.reboot()
    counted = [len(batch) for batch in live.batches(8.0)]
    assert live.driver is not None
    assert live.driver.state == "streaming"
    assert sum(counted) > 300


def test_a_clock_that_falls_is_a_restart() -> None:
    sensor = SimulatedSensor()
    driver = Driver(115200, 100, sensor.now_s())
    configure(LiveSensor(sensor, driver))
    (message,) = Reader().push(fish_frame(10**15))
    driver.take(message, sensor.now_s())
    assert driver.state == "streaming"
    (message,) = Reader().push(fish_frame(10**9))
    driver.take(message, sensor.now_s())
    assert driver.state == "searching"


@pytest.mark.parametrize(
    ("baud", "rate", "words"),
    [(115200, 200, "too slow for 200"), (115200, 7, "800 / rate"), (250000, 100, "does not know")],
)
def test_wishes_that_cannot_be(baud: int, rate: int, words: str) -> None:
    with pytest.raises(InputError, match=words):
        Driver(baud, rate, 0.0)
