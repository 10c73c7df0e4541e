"""Flashing: USB ports, the touch that erases, and the real conversation over a serial line."""

from __future__ import annotations

import contextlib
import os
import queue
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial

from tailbeat.board.fish import Fish
from tailbeat.board.flash import ports
from tailbeat.board.flash.backup import back_up
from tailbeat.board.flash.ports import BoardPort
from tailbeat.board.flash.procedure import FlashPlan, Surroundings, flash
from tailbeat.board.flash.programs import ProgramResult, run_program
from tailbeat.board.snapshot import restore
from tailbeat.core import records
from tailbeat.core.errors import ConnectError, InputError
from tailbeat.experiment.folder import backup_places
from tailbeat.link.serial import USB_IDS, PortKind, SerialTransport, likely_ports
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import FLASH_BYTES, SimBoard, SimTransport
from tailbeat.sim.server import SimServer

ACM = "/dev/ttyACM0"
needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="no ptys")
needs_proc = pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="no /proc")


@dataclass
class Listed:
    device: str
    vid: int | None = None
    pid: int | None = None
    description: str = ""
    name: str = ""


IDS = {kind: ids for ids, kind in USB_IDS.items()}


def listed(device: str, kind: PortKind) -> Listed:
    return Listed(device, *IDS[kind])


OTHERS = [Listed("/dev/ttyS0"), Listed("/dev/ttyUSB0", 0x0403, 0x6001), Listed("/dev/x", 0x2341, 1)]


# Which port


@pytest.mark.parametrize(
    "ids",
    [(0x2341, 0x003D), (0x2341, 0x003E), (0x2A03, 0x003D), (0x2A03, 0x003E), (0x03EB, 0x6124)],
    ids=lambda ids: f"{ids[0]:04x}:{ids[1]:04x}",
)
def test_the_only_port_is_found_among_others(
    ids: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Arduino sold the Due under the vendors 2341 and 2A03."""
    found = ports.find_port(None, lambda: [*OTHERS, Listed(ACM, *ids)])
    kinds = {0x003D: PortKind.PROGRAMMING, 0x003E: PortKind.NATIVE, 0x6124: PortKind.SAM_BA}
    assert found == BoardPort(ACM, kinds[ids[1]])
    assert found.by_usb == (ids[1] != 0x003D)
    plugged = [*OTHERS, Listed(ACM, *ids)]
    monkeypatch.setattr("tailbeat.link.serial.list_ports.comports", lambda: plugged)
    assert list(likely_ports()) == ([ACM] if ids[0] in (0x2341, 0x2A03) else [])


def test_no_board() -> None:
    with pytest.raises(ConnectError, match="no board is plugged in") as refused:
        ports.find_port(None, lambda: OTHERS)
    assert "programming port" in refused.value.remedy


def test_several_boards() -> None:
    def both() -> list[Listed]:
        return [listed("/dev/ttyACM1", PortKind.NATIVE), listed(ACM, PortKind.PROGRAMMING)]

    with pytest.raises(ConnectError, match=r"board's: /dev/ttyACM0, /dev/ttyACM1\.") as refused:
        ports.find_port(None, both)
    assert refused.value.remedy.startswith("Say which one, for example --port /dev/ttyACM0")
    assert ports.find_port("/dev/ttyACM1", both).kind is PortKind.NATIVE


@pytest.mark.parametrize(
    ("port", "touched"),
    [(Listed("/dev/ttyUSB0", 0x1A86, 0x7523), False), (OTHERS[1], False), (OTHERS[0], False),
     (Listed("/dev/ttyACM3", 0x1B4F, 0x003D), True)],
)  # fmt: skip
def test_a_port_of_another_make_is_taken_when_it_is_named(port: Listed, touched: bool) -> None:
    found = ports.find_port(port.device, lambda: [port, listed(ACM, PortKind.NATIVE)])
    assert (found.device, found.kind) == (port.device, PortKind.OTHER)
    assert (found.may_be_touched, found.by_usb) == (touched, False)
    with pytest.raises(ConnectError, match="no board is plugged in"):
        ports.find_port(None, lambda: [port])


def test_a_port_that_is_not_there() -> None:
    with pytest.raises(ConnectError) as refused:
        ports.find_port("/dev/no-such-port", lambda: [*OTHERS, listed(ACM, PortKind.NATIVE)])
    assert str(refused.value) == (
        "there is no port /dev/no-such-port (ports of boards: /dev/ttyACM0). Check the cable (it"
        " must carry data) and the name."
    )


def test_a_port_by_another_name(tmp_path: Path) -> None:
    device, link = tmp_path / "ttyACM0", tmp_path / "by-id"
    device.touch()
    link.symlink_to(device)
    found = ports.find_port(str(link), lambda: [listed(str(device), PortKind.NATIVE)])
    assert found.device == str(device)


# Who uses it


def test_holders_are_named(tmp_path: Path) -> None:
    for number, (name, target) in {
        7: ("picocom", ACM), 40: ("bash", "/dev/pts/1"), os.getpid(): ("pytest", ACM),
    }.items():  # fmt: skip
        process = tmp_path / "proc" / str(number)
        (process / "fd").mkdir(parents=True)
        (process / "comm").write_text(f"{name}\n")
        (process / "fd" / "3").symlink_to(target)
    (tmp_path / "proc" / "99").mkdir()  # one whose files are not ours to see
    assert ports.holders(ACM, tmp_path / "proc") == ["picocom (7)"]
    assert ports.holders("/dev/ttyACM1", tmp_path / "proc") == []


@needs_pty
@needs_proc
def test_a_port_that_another_process_holds() -> None:
    master, slave = os.openpty()
    path = os.ttyname(slave)
    holder = subprocess.Popen(["cat"], stdin=slave, stdout=subprocess.DEVNULL)
    try:
        with pytest.raises(ConnectError, match=rf"is in use by \S+ \({holder.pid}\)"):
            ports.require_free(path)
    finally:
        holder.kill()
        holder.wait()
    ports.require_free(path)
    os.close(master)
    os.close(slave)


@needs_pty
def test_two_of_us_cannot_have_one_port() -> None:
    master, slave = os.openpty()
    path = os.ttyname(slave)
    with contextlib.closing(SerialTransport(path)):
        with pytest.raises(ConnectError, match="cannot open"):
            SerialTransport(path)
        with pytest.raises(ConnectError, match="cannot touch"):
            ports.touch(BoardPort(path, PortKind.PROGRAMMING))
    os.close(master)
    os.close(slave)


# 1200 baud


class Line:
    """serial.Serial as far as the touch goes, and the ATmega16U2 behind it."""

    log: list[str]

    def __init__(self, baudrate: int, exclusive: bool) -> None:
        assert exclusive
        Line.log = []
        self.__dict__.update(baudrate=baudrate, dtr=True, rts=True)

    def open(self) -> None:
        Line.log.append(f"open {self.port} at {self.baudrate}")

    def close(self) -> None:
        Line.log.append("close")

    def __setattr__(self, name: str, value: Any) -> None:
        self.__dict__[name] = value
        Line.log.append(f"{name} {value}")


@pytest.mark.parametrize(
    ("kind", "after"),
    [
        (PortKind.PROGRAMMING, ["baudrate 115200"]),
        (PortKind.NATIVE, []),
        (PortKind.OTHER, ["baudrate 115200"]),
    ],
)
def test_the_touch(kind: PortKind, after: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Left at 1200 baud, the programming port would erase the board again at the next open."""
    monkeypatch.setattr(serial, "Serial", Line)
    ports.touch(BoardPort(ACM, kind))
    lines = [f"port {ACM}", f"open {ACM} at 1200", "dtr False", "rts False"]
    assert Line.log == [*lines, *after, "close"]


def test_nobody_else_opens_at_1200_baud() -> None:
    with pytest.raises(InputError, match="1200 baud would erase the board"):
        SerialTransport(ACM, 1200)
    source = Path(ports.__file__).resolve().parents[2]
    users = [
        path.relative_to(source).as_posix()
        for path in source.rglob("*.py")
        if "serial.Serial(" in path.read_text()
    ]
    assert sorted(users) == ["board/flash/ports.py", "link/serial.py"]


# The board at the other end


class Resets(SimTransport):
    """A programming port: it resets the board a moment after it was opened, when the board may have
    answered already; then the board is silent until it has booted."""

    def __init__(self, board: SimBoard, boot_s: float) -> None:
        super().__init__(board)
        self._reset_s = board.time_s + 0.02
        self._up_s = self._reset_s + boot_s
        self._booted = False

    def _down(self) -> bool:
        return self._reset_s <= self.board.time_s and not self._booted

    def read(self) -> bytes:
        data = super().read()
        return b"" if self._down() else data

    def write(self, data: bytes) -> None:
        if not self._down():
            super().write(data)

    def wait(self, timeout_s: float) -> None:
        super().wait(min(timeout_s, 0.01))
        if self._down() and self.board.time_s >= self._up_s:
            self._booted = True
            self.board.world.power_cycle()


@pytest.mark.parametrize("boot_s", [0.0, 0.5, 1.5, 2.5])
def test_a_wired_connect_survives_the_reboot_it_causes(
    boot_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "tailbeat.board.fish.open_transport", lambda url: Resets(SimBoard(), boot_s)
    )
    with Fish.connect(ACM) as fish:
        assert fish.info().status.state == "IDLE"
        assert len(fish.params.list()) > 10


@dataclass
class Console:
    """A board in its own thread, its console on a pty."""

    path: str
    board: SimBoard
    jobs: queue.SimpleQueue[Callable[[], None]]

    def wipe(self) -> None:
        """Has the board's thread erase the board and start it again."""
        done = threading.Event()

        def wipe() -> None:
            self.board.flash = b"\xff" * FLASH_BYTES
            self.board.world.power_cycle()
            done.set()

        self.jobs.put(wipe)
        assert done.wait(600.0)


@pytest.fixture
def console() -> Iterator[Console]:
    board = SimBoard("tank")
    with Fish(SimTransport(board)) as fish:
        fish.params.set("ILC_LEAD", 1)
        fish.params.set("SERVO_CENTRE_US", 1487.25)
        fish.params.save()
        fish.upload_reference(records.encode_reference(1.0, np.full(8, 0.04)))
        fish.learn(run_trial(fish).number)
    server = SimServer(board, "tcp:127.0.0.1:0", pty=True, speed=40.0)
    stop = threading.Event()
    jobs: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()

    def stopped() -> bool:
        while not jobs.empty():
            jobs.get()()
        return stop.is_set()

    thread = threading.Thread(target=server.serve, args=(stopped,))
    thread.start()
    assert server.addresses.pty is not None
    yield Console(server.addresses.pty, board, jobs)
    stop.set()
    thread.join()
    server.close()


@needs_pty
def test_there_and_back_over_a_serial_line(console: Console, tmp_path: Path) -> None:
    steps: list[str] = []
    with Fish.connect(console.path) as fish:
        kept = back_up(
            fish,
            backup_places(tmp_path / "out", tmp_path / "none"),
            lambda _, text: steps.append(text),
        )
        learned = fish.learned_record()
        assert (kept.folder / "trials" / "0001.ulg").read_bytes() == fish.ftp.read(
            "/trials/0001.ulg"
        )
        fish.params.reset()
        fish.params.save()
        fish.upload_reference(records.encode_reference(1.0, np.full(5, 0.03)))
        result = restore(fish, kept.snapshot)
        assert fish.learned_record() == learned is not None
        assert fish.params.values() == kept.snapshot.params
    assert steps[-1] == "pulling trial 1"
    assert result.back[1:] == ["the reference", "all that was learned"]
    assert "SERVO_CENTRE_US" in kept.snapshot.params


@needs_pty
def test_the_whole_procedure_over_a_serial_line(console: Console, tmp_path: Path) -> None:
    with Fish.connect(console.path) as fish:
        build_id = fish.info().build_id
        learned = fish.learned_record()
    image = tmp_path / "tailbeat.bin"
    marked = b"tailbeat build id: " + build_id.encode() + b"\0"
    image.write_bytes(struct.pack("<II", 0x20088000, 0x80101) + bytes(512) + marked)
    calls: list[Sequence[str]] = []

    def bossac(command: Sequence[str], timeout_s: float) -> ProgramResult:
        calls.append(command[3:])
        return ProgramResult(0, "")

    around = Surroundings(
        enumerate_ports=lambda: [listed(console.path, PortKind.PROGRAMMING)],
        touch=lambda port: console.wipe(),
        require_program=lambda name, package: None,
        run=bossac,
        sleep=lambda duration_s: None,
    )
    report = flash(FlashPlan(image, places=backup_places(tmp_path / "backups")), around=around)
    assert calls == [["-e", "-w", "-v", "-b", str(image)], ["-R"]]
    assert report.verified
    assert report.restored[1:] == ["the reference", "all that was learned"]
    assert [path.name for path in report.trials_pulled] == ["0001.ulg"]
    with Fish.connect(console.path) as fish:
        assert fish.learned_record() == learned is not None
        assert fish.params.get("SERVO_CENTRE_US").value == 1487.25
        assert fish.trials() == []


# Other programs


def test_a_program_that_hangs_is_ended() -> None:
    code = "print('began', flush=True); import time; time.sleep(600)"
    outcome = run_program([sys.executable, "-c", code], 0.5)
    assert not outcome.ok
    assert outcome.output.splitlines()[-1] == "it did not end within 0.5 s"


def test_last_words() -> None:
    done = run_program([sys.executable, "-c", "print('[=] 1%\\r[==] 2%\\rno device\\n\\n')"], 30.0)
    assert (done.ok, done.last_words) == (True, "no device")
    quiet = run_program([sys.executable, "-c", "import sys; sys.exit(3)"], 30.0)
    assert quiet.last_words == "exit status 3"
