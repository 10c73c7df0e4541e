"""tailbeat board check: well on a board that is, and each check finds the fault it is there for."""

from __future__ import annotations

import contextlib
import errno
import itertools
import json
import os
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tailbeat.app.cli import run
from tailbeat.board import connect
from tailbeat.board.diagnostics import examine
from tailbeat.board.diagnostics.evidence import OK, PROBLEM, WARNING, Finding, gather
from tailbeat.board.fish import Fish
from tailbeat.board.memory import CrashReport
from tailbeat.board.provision import HELD, MISSING, OPEN, KeyStatus, set_key
from tailbeat.core.errors import InputError
from tailbeat.link import _dialect as mavlink
from tailbeat.link import serial
from tailbeat.link.frames import Framer
from tailbeat.link.keystore import KeyStore, StoredKey
from tailbeat.link.transport import Transport
from tailbeat.sim.board import CONSOLE, SimBoard, SimTransport

NAMES = [
    "port", "board", "firmware", "link", "imu", "battery", "storage", "key", "clock", "state",
    "restart", "radio",
]  # fmt: skip
QUICK_S = 0.5
needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="no ptys")

Edit = Callable[[Any], None]


class Forged:
    """A board whose messages are changed on the way, on a slower or a later line."""

    def __init__(self, inner: Transport) -> None:
        self.inner = inner
        self.name = f"forged {inner.name}"
        self.edits: dict[str, Edit | None] = {}  # None: the message is dropped
        self.lost = 0  # of each kind, of ten frames
        self.late_s = 0.0
        self._seen: Counter[str] = Counter()
        self.pace = 1.0  # of our clock
        self._mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._framer = Framer(mavlink.MAVLink(None))
        self._under_way: list[tuple[float, bytes]] = []

    def read(self) -> bytes:
        due_s = self.inner.now_s() + self.late_s
        for message in self._framer.push(self.inner.read()):
            kind = message.get_type()
            self._seen[kind] += 1
            edit = self.edits.get(kind, lambda m: None)
            if edit is None or self._seen[kind] % 10 < self.lost:
                continue
            edit(message)
            self._mav.seq = message.get_seq()
            self._under_way.append((due_s, bytes(message.pack(self._mav))))
        come = [data for due, data in self._under_way if due <= self.inner.now_s()]
        del self._under_way[: len(come)]
        return b"".join(come)

    def wait(self, timeout_s: float) -> None:
        due_s = self._under_way[0][0] - self.inner.now_s() if self._under_way else timeout_s
        self.inner.wait(max(0.001, min(timeout_s / self.pace, due_s)))

    def write(self, data: bytes) -> None:
        self.inner.write(data)

    def now_s(self) -> float:
        return self.inner.now_s() * self.pace

    def reopen(self) -> None:
        self.inner.reopen()

    def close(self) -> None:
        self.inner.close()


@pytest.fixture
def board() -> SimBoard:
    """One that has been on for a while."""
    board = SimBoard("tank", seed=1)
    board.run(6.0)
    return board


@pytest.fixture
def forged(board: SimBoard) -> Forged:
    return Forged(SimTransport(board))


@pytest.fixture
def look(monkeypatch: pytest.MonkeyPatch) -> Callable[..., dict[str, Finding]]:
    """Examines a transport; the findings by name."""

    def examined(transport: Transport, measure_s: float = QUICK_S) -> dict[str, Finding]:
        monkeypatch.setattr(
            "tailbeat.board.diagnostics.evidence.open_transport", lambda url: transport
        )
        findings = examine("it", measure_s)
        assert [f.name for f in findings] == NAMES
        for finding in findings:
            assert "\n" not in finding.line
            assert bool(finding.remedy) or finding.status != PROBLEM, finding
            assert finding.text[-1] not in ". ", finding
        return {finding.name: finding for finding in findings}

    return examined


Look = Callable[..., dict[str, Finding]]


def set_to(**values: Any) -> Edit:
    def edit(message: Any) -> None:
        for name, value in values.items():
            setattr(message, name, value)

    return edit


def others(found: dict[str, Finding], *names: str) -> set[str]:
    """Status of all checks but these; a forged board has no key, which is a warning."""
    return {f.status for name, f in found.items() if name not in (*names, "key")}


# A board that is well


def test_a_healthy_board(look: Look, board: SimBoard) -> None:
    found = look(SimTransport(board))
    assert {f.status for f in found.values()} == {OK}
    link = found["link"].measured
    assert (link["lost"], link["burst_missing"]) == (0, 0)
    assert 0.001 < link["round_trip_s"] <= link["round_trip_max_s"] < 0.05
    assert 11_000 < link["bytes_per_s"] <= 11_700
    clock = found["clock"].measured
    assert clock["offset_s"] == pytest.approx(board.board_time_s - board.time_s, abs=0.02)
    assert abs(clock["rate"] - 1) <= clock["rate_error"]
    assert 0.005 < clock["rate_error"] < 0.05  # round trip over the time watched


def test_a_forged_board_that_is_well(look: Look, forged: Forged) -> None:
    found = look(forged)
    assert others(found) == {OK}
    assert (found["key"].status, "Bluetooth range" in found["key"].text) == (WARNING, True)


def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["board", "check", "--connect", "sim:tank"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert [line.split()[1] for line in out.splitlines()] == NAMES
    assert {line.split()[0] for line in out.splitlines()} == {"ok"}
    assert run(["board", "check", "--connect", "sim:tank?battery_v=6.3", "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert document["ok"] is False
    assert [check["name"] for check in document["checks"]] == NAMES
    wrong = [check for check in document["checks"] if check["status"] == PROBLEM]
    assert [check["name"] for check in wrong] == ["battery"]
    assert wrong[0]["measured"]["battery_v"] == pytest.approx(6.3, abs=0.05)
    assert "Charge" in wrong[0]["remedy"]


def test_it_changes_nothing(look: Look, board: SimBoard) -> None:
    before = board.flash
    look(SimTransport(board))
    assert board.flash == before


# The way to the board


def test_nothing_connected(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(connect, "likely_ports", lambda: iter([]))
    monkeypatch.setattr(connect, "DEFAULT_PORT", 1)
    assert run(["board", "check"]) == 1
    line = capsys.readouterr().out
    assert line == (
        "problem  port  no fish found: no serial port looks like a Bluetooth link or has a Due's"
        " USB ids, no simulator at tcp:127.0.0.1:1. Switch the fish on, pair its Bluetooth module,"
        " or name its port with --connect. Without a fish: tailbeat sim\n"
    )


def test_a_senseless_address() -> None:
    with pytest.raises(InputError):
        examine("xyz")


def port_finding(path: str) -> Finding:
    (finding,) = examine(path)
    assert (finding.name, finding.status) == ("port", PROBLEM)
    return finding


def test_a_port_that_is_not_there() -> None:
    finding = port_finding("/dev/no-such-port")
    assert "there is no such port" in finding.text
    assert "cable" in finding.remedy


@needs_pty
def test_a_port_in_use() -> None:
    master, slave = os.openpty()
    path = os.ttyname(slave)
    take = "import serial,sys,time; p=serial.Serial(sys.argv[1],exclusive=True); print('has it',"
    take += "flush=True); time.sleep(60)"
    holder = subprocess.Popen([sys.executable, "-c", take, path], stdout=subprocess.PIPE)
    try:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"has it\n"
        os.close(slave)
        finding = port_finding(path)
    finally:
        holder.kill()
        holder.wait()
        os.close(master)
    assert f"({holder.pid})" in finding.text
    assert "in use by" in finding.text
    assert "Close that program" in finding.remedy


@pytest.mark.parametrize(
    ("number", "text", "remedy"),
    [
        (errno.EACCES, "you may not use it", "usermod -aG dialout"),
        (errno.EBUSY, "in use by another program", "Close"),
        (errno.EHOSTDOWN, "the Bluetooth module does not answer", "Switch the fish on"),
        (errno.EIO, "Input/output error", "cable"),
    ],
)
@needs_pty
def test_a_port_the_system_refuses(
    number: int, text: str, remedy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = os.open

    def refuse(path: Any, *args: Any, **named: Any) -> int:
        if path == "/dev/rfcomm9":
            raise OSError(number, os.strerror(number), path)
        return real(path, *args, **named)

    monkeypatch.setattr("serial.serialposix.os.open", refuse)
    finding = port_finding("/dev/rfcomm9")
    assert text in finding.text
    assert remedy in finding.remedy


def test_the_group_is_the_ports_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pathlib.Path.group", lambda self: "uucp")
    refused = serial.cannot_open("/dev/ttyACM0", PermissionError(errno.EACCES, "no"))
    assert "usermod -aG uucp $USER" in refused.remedy


# What the board says


def test_firmware_of_another_version(look: Look, forged: Forged) -> None:
    forged.edits["AUTOPILOT_VERSION"] = set_to(flight_sw_version=0x00090300)
    found = look(forged)
    assert found["firmware"].status == PROBLEM
    assert "0.9.3" in found["firmware"].text
    assert "tailbeat board flash" in found["firmware"].remedy
    assert others(found, "firmware") == {OK}


def test_another_build_of_the_same_version(look: Look, forged: Forged) -> None:
    forged.edits["STATUSTEXT"] = set_to(_text_raw=b"tailbeat 0.1.0-99-gabcdef0")
    found = look(forged)["firmware"]
    assert found.status == WARNING
    assert "0.1.0-99-gabcdef0" in found.text


def test_messages_in_another_form(look: Look, forged: Forged) -> None:
    forged.edits["TAILBEAT_HEALTH"] = None
    found = look(forged)
    assert found["firmware"].status == PROBLEM
    assert "TAILBEAT_HEALTH" in found["firmware"].text
    for name in ("storage", "restart", "radio", "key"):
        assert (found[name].status, "not known" in found[name].text) == (WARNING, True)
    assert found["link"].status == OK


def test_a_board_that_falls_silent(monkeypatch: pytest.MonkeyPatch, forged: Forged) -> None:
    for kind in ("TIMESYNC", "TAILBEAT_STATUS", "TAILBEAT_HEALTH", "AUTOPILOT_VERSION"):
        forged.edits[kind] = None
    monkeypatch.setattr("tailbeat.board.diagnostics.evidence.open_transport", lambda url: forged)
    findings = examine("it", QUICK_S)
    assert [f.name for f in findings] == ["port", "board", "link"]
    assert findings[-1].status == PROBLEM
    assert "does not answer" in findings[-1].text


def test_a_slow_line(look: Look) -> None:
    board = SimBoard("tank", seed=1, link_bytes_per_s=960.0)
    board.run(6.0)
    found = look(SimTransport(board))["link"]
    assert found.status == PROBLEM
    assert found.measured["bytes_per_s"] == pytest.approx(960, rel=0.1)
    assert "board bluetooth" in found.remedy


@pytest.mark.parametrize(("lose", "status"), [(0.0, OK), (0.05, WARNING), (0.3, PROBLEM)])
def test_a_lossy_line(lose: float, status: str, board: SimBoard, spoil: Any, look: Look) -> None:
    fish = Fish(SimTransport(board))
    radio = spoil(fish, seed=3, lose=lose)
    found = look(radio, 3.0)["link"]
    assert found.status == status
    assert (found.measured["lost"] > 0) == (lose > 0)


@pytest.mark.parametrize(("lost", "status"), [(0, OK), (1, WARNING), (3, PROBLEM)])
def test_whole_frames_lost(lost: int, status: str, look: Look, forged: Forged) -> None:
    forged.lost = lost
    found = look(forged, 3.0)["link"]
    assert found.status == status
    listed = found.measured["burst_frames"] + found.measured["burst_missing"]
    assert (found.measured["lost"], found.measured["burst_missing"]) == (
        pytest.approx(3 * lost, abs=2), pytest.approx(listed * lost / 10, abs=2),
    )  # fmt: skip
    assert found.measured["damaged_from_board"] == 0


def test_a_line_that_damages(board: SimBoard, spoil: Any, look: Look) -> None:
    found = look(spoil(Fish(SimTransport(board)), seed=5, damage=0.2), 3.0)["link"]
    assert found.status in (WARNING, PROBLEM)
    assert found.measured["damaged_from_board"] > 0
    assert found.measured["damaged_to_board"] > 0


def test_frames_that_came_damaged_to_the_board(look: Look, forged: Forged) -> None:
    counted = itertools.count(5)
    forged.edits["TAILBEAT_HEALTH"] = lambda m: setattr(m, "link_bad_frames", next(counted))
    found = look(forged)["link"]
    assert (found.status, found.measured["damaged_to_board"]) == (WARNING, 1)
    assert "damaged frames: 0 in, 1 out" in found.text


def test_a_slow_answer(look: Look, forged: Forged) -> None:
    forged.late_s = 1.1
    found = look(forged)
    assert found["link"].status == PROBLEM
    assert found["link"].measured["round_trip_s"] == pytest.approx(1.1, abs=0.05)
    assert found["clock"].status == OK
    forged.late_s = 0.4
    assert look(forged)["link"].status == WARNING


def test_an_imu_that_fell_silent(look: Look, board: SimBoard) -> None:
    board.world.set_imu(False)
    board.run(6.0)
    found = look(SimTransport(board))
    assert found["imu"].status == PROBLEM
    assert "supply" in found["imu"].remedy
    assert others(found, "imu") == {OK}


def test_no_imu_matters_only_where_it_is_needed(look: Look) -> None:
    board = SimBoard("tank", seed=1, imu_firmware=0)
    board.run(6.0)
    found = look(SimTransport(board))["imu"]
    assert (found.status, found.measured["problem"]) == (WARNING, "SILENT")
    Fish(SimTransport(board)).params.set("SPD_SOURCE", 2)
    assert look(SimTransport(board))["imu"].status == PROBLEM
    Fish(SimTransport(board)).params.set("SPD_SOURCE", 0)
    Fish(SimTransport(board)).params.set("IMU_TIMEOUT_S", 1)
    assert look(SimTransport(board))["imu"].status == PROBLEM


@pytest.mark.parametrize(
    ("volts", "status", "text"),
    [(7.4, OK, ""), (6.7, WARNING, "little above"), (6.4, PROBLEM, "arming is refused"),
     (5.8, PROBLEM, "BATT_CRIT_V"), (0.0, PROBLEM, "no battery"),
     (12.0, PROBLEM, "9.90 V or more (reading at its limit): arming is refused")],
)  # fmt: skip
def test_battery(volts: float, status: str, text: str, look: Look, board: SimBoard) -> None:
    board.world.set_battery_v(volts)
    board.run(8.0)
    found = look(SimTransport(board))
    assert found["battery"].status == status
    assert text in found["battery"].text
    assert others(found, "battery") == {OK}


def test_limits_of_the_battery_are_the_boards(look: Look, board: SimBoard) -> None:
    Fish(SimTransport(board)).params.set("BATT_LOW_V", 9.0)
    assert look(SimTransport(board))["battery"].status == PROBLEM


def test_a_bare_board_needs_no_battery(look: Look, board: SimBoard) -> None:
    board.world.set_battery_v(12.0)
    board.run(1.0)
    fish = Fish(SimTransport(board))
    fish.params.set("BATT_LOW_V", 0.0)
    fish.params.set("BATT_CRIT_V", 0.0)
    found = look(SimTransport(board))["battery"]
    assert (found.status, "not checked" in found.text) == (OK, True)


@pytest.mark.parametrize(
    ("values", "status"),
    [
        ({"store_failures": 3}, PROBLEM),
        ({"store_free_bytes": 2048}, PROBLEM),
        ({"store_free_bytes": 16384}, WARNING),
        ({"store_free_bytes": 65536}, OK),
    ],
)
def test_storage(values: dict[str, int], status: str, look: Look, forged: Forged) -> None:
    forged.edits["TAILBEAT_HEALTH"] = set_to(**values)
    found = look(forged)
    assert found["storage"].status == status
    assert others(found, "storage") == {OK}


KEY = StoredKey(bytes(range(32)), "cafe" * 8, "lab")


@pytest.mark.parametrize(
    ("key", "status", "text", "remedy"),
    [
        (
            KeyStatus(OPEN, "cafe", None, None, {}),
            WARNING,
            "Bluetooth range",
            "tailbeat board key set",
        ),
        (
            KeyStatus(OPEN, "cafe", None, KEY, {}),
            PROBLEM,
            "imitates this board",
            "tailbeat board key set",
        ),
        (
            KeyStatus(MISSING, "cafe", None, None, {}),
            PROBLEM,
            "rejects commands",
            "board key import",
        ),
        (KeyStatus(HELD, "cafe", KEY, None, {}), OK, KEY.fingerprint, ""),
        (KeyStatus(HELD, "cafe", KEY, None, {"refused_wrong": 9}), WARNING, "9 frames", ""),
    ],
)
def test_key(
    key: KeyStatus,
    status: str,
    text: str,
    remedy: str,
    look: Look,
    forged: Forged,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("tailbeat.board.diagnostics.evidence.key_status", lambda fish, health: key)
    found = look(forged)["key"]
    assert found.status == status
    assert text in found.text
    assert remedy in found.remedy
    assert KEY.key.hex() not in found.line


@pytest.fixture
def keyed(board: SimBoard) -> SimBoard:
    """With a key that this computer has."""
    with Fish(SimTransport(board, CONSOLE)) as fish:
        fish.clock.sync()
        set_key(fish)
    return board


def test_a_board_whose_key_is_here(look: Look, keyed: SimBoard) -> None:
    found = look(SimTransport(keyed))
    assert {f.status for f in found.values()} == {OK}
    assert "signs with" in found["key"].text


@pytest.mark.parametrize("lose", [0.0, 0.1])
def test_a_board_whose_key_is_elsewhere(
    look: Look, keyed: SimBoard, spoil: Any, lose: float
) -> None:
    """What a stranger is refused is no sign of another version."""
    for key in KeyStore().usable():
        KeyStore().delete(key)
    found = look(spoil(Fish(SimTransport(keyed)), seed=3, lose=lose))
    assert found["key"].status == PROBLEM
    assert "tailbeat board key import" in found["key"].remedy
    assert found["key"].text.startswith("the board has a key that this computer has not")
    assert int(found["key"].measured["refused_unsigned"] or 0) > 0 or lose
    for name in ("firmware", "imu"):
        assert (found[name].status, found[name].text) == (
            WARNING,
            "only for authenticated hosts",
        )
    assert others(found, "firmware", "imu", "link") == {OK}
    patient = gather(SimTransport(keyed), QUICK_S)
    assert patient.unanswered == []
    assert patient.untold == ["TAILBEAT_IMU_INFO", "AUTOPILOT_VERSION"]


def test_a_board_behind_a_bad_line_is_in_this_process() -> None:
    found = {f.name: f for f in examine("sim?line=delay=0.01:0.02", QUICK_S)}
    assert "a board in this process" in found["port"].text
    assert found["key"].status == OK


def test_clock_of_a_dead_crystal(look: Look, forged: Forged) -> None:
    forged.pace = 1.05
    found = look(forged)["clock"]
    assert found.measured["rate"] == pytest.approx(1 / 1.05, abs=found.measured["rate_error"])
    assert found.status == OK  # a simulated board may run at any pace
    forged.edits["AUTOPILOT_VERSION"] = set_to(board_version=1)
    forged.pace = 1.15
    found = look(forged)["clock"]
    assert found.status == PROBLEM
    assert "crystal" in found.remedy


def test_clock_too_uncertain_to_start_by(look: Look, forged: Forged) -> None:
    forged.late_s = 2.2
    assert look(forged)["clock"].status == PROBLEM


def test_state_with_the_tables_words(look: Look, forged: Forged) -> None:
    forged.edits["TAILBEAT_STATUS"] = set_to(state=6, fault=4)
    found = look(forged)["state"]
    assert found.status == PROBLEM
    assert found.text == "ABORTED: the fish tilted too far"
    assert "TILT_MAX_RAD" in found.remedy


CRASHED = CrashReport("assertion", "store.c:12", [], 3.0, 1, "0.1.0", {}, [])


def test_restarts(look: Look, forged: Forged, monkeypatch: pytest.MonkeyPatch) -> None:
    forged.edits["TAILBEAT_HEALTH"] = set_to(reset_cause=2)
    assert look(forged)["restart"].status == PROBLEM
    forged.edits["TAILBEAT_HEALTH"] = set_to(reset_cause=3)
    assert look(forged)["restart"].status == OK
    monkeypatch.setattr(Fish, "crash_report", lambda self: CRASHED)
    found = look(forged)["restart"]
    assert (found.status, "store.c:12" in found.text) == (WARNING, True)
    assert "tailbeat board crash" in found.remedy
    forged.edits["TAILBEAT_STATUS"] = set_to(state=7, fault=25)
    assert look(forged)["restart"].status == PROBLEM


@pytest.mark.parametrize(("count", "status"), [(0, OK), (5, OK), (500, PROBLEM)])
def test_a_radio_at_another_speed(count: int, status: str, look: Look, forged: Forged) -> None:
    forged.edits["TAILBEAT_HEALTH"] = set_to(radio_framing=count)
    found = look(forged)["radio"]
    assert found.status == status
    assert ("board bluetooth" in found.remedy) == (status == PROBLEM)


def test_bad_bytes_while_we_come_by_that_radio(
    look: Look, forged: Forged, monkeypatch: pytest.MonkeyPatch
) -> None:
    forged.edits["TAILBEAT_HEALTH"] = set_to(radio_framing=500)
    monkeypatch.setattr("tailbeat.board.diagnostics.evidence.by_radio", lambda transport: True)
    found = look(forged)["radio"]
    assert (found.status, "wires" in found.remedy) == (WARNING, True)


def test_a_swim_is_not_disturbed(look: Look, forged: Forged) -> None:
    forged.edits["TAILBEAT_STATUS"] = set_to(state=3)
    forged.edits["PARAM_VALUE"] = None
    found = look(forged)
    assert found["link"].measured["burst_frames"] is None
    assert found["state"].text == "RUNNING"


# Real ports


@pytest.fixture
def pty_path() -> Iterator[str]:
    """A simulated board behind a pseudo terminal, in real time."""
    import tty

    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    board = SimBoard("tank", seed=1)
    board.run(6.0)
    over = threading.Event()

    def serve() -> None:
        while not over.wait(0.005):
            with contextlib.suppress(BlockingIOError):
                board.write(os.read(master, 4096))
            board.run(0.005)
            os.write(master, board.read())

    thread = threading.Thread(target=serve)
    thread.start()
    yield os.ttyname(slave)
    over.set()
    thread.join()
    os.close(slave)
    os.close(master)


@needs_pty
def test_a_serial_port(pty_path: str) -> None:
    findings = examine(pty_path, 0.3)
    assert [f.name for f in findings] == NAMES
    assert "a serial port" in findings[0].text
    # How the machine is loaded shows in the figures of link and clock only.
    assert {f.status for f in findings if f.name not in ("key", "link", "clock")} == {OK}


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="no /proc")
@needs_pty
def test_a_port_that_two_read(pty_path: str) -> None:
    with Path(pty_path).open() as port:
        reader = subprocess.Popen(["sleep", "60"], stdin=port)
    try:
        findings = examine(pty_path, 0.3)
    finally:
        reader.kill()
        reader.wait()
    assert [f.name for f in findings] == NAMES
    assert findings[0].status == PROBLEM
    assert f"({reader.pid})" in findings[0].text
    assert "Close that program" in findings[0].remedy


def test_findings_are_plain() -> None:
    finding = Finding("link", OK, "fine")
    assert replace(finding, remedy="Do it.").line == "fine. Do it."
