"""The port to the SmartFusion2 on QEMU's model of Emcraft's board.

QEMU counts instructions instead of time, so that the firmware takes the same time on any computer,
and no tick comes late on a busy one. The board's time is several times as quick as real time.
"""

from __future__ import annotations

import contextlib
import select
import socket
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from tailbeat.link.transport import START_LINE

QEMU = "qemu-system-arm"
NOR_BYTES = 16 << 20

_NS_PER_INSTRUCTION = 5  # as a power of two
_FRAME_BYTES, _SYNC = 7, 0xA5
_TICK_S = 0.02
_LOOK_S = 0.005
_SUM_DIGITS = 2
_LIMIT_S = 60.0  # of real time


@dataclass(frozen=True)
class PulseFrame:
    """What the board says about one frame of a servo (hal/smartfusion2/servo.c)."""

    servo: int
    width_ticks: int
    number: int


def decode_pulses(data: bytes) -> list[PulseFrame]:
    """The frames in the bytes of the second UART, without one that has only begun. Raises
    ValueError at a damaged one."""
    frames = []
    for at in range(0, len(data) - _FRAME_BYTES + 1, _FRAME_BYTES):
        frame = data[at : at + _FRAME_BYTES]
        if frame[0] != _SYNC or sum(frame[:-1]) & 0xFF != frame[-1]:
            raise ValueError(f"frame {at // _FRAME_BYTES} is damaged: {frame.hex()}")
        width, number = int.from_bytes(frame[2:4], "little"), int.from_bytes(frame[4:6], "little")
        frames.append(PulseFrame(frame[1], width, number))
    return frames


class EmcraftBoard:
    """The board, running ``image``, and the transport to its console. What it writes lies in
    ``folder``, the storage too, so that a later board in the same folder has the earlier one's. A
    context manager: at its end the power goes off."""

    def __init__(self, image: Path, folder: Path) -> None:
        self.name = "qemu:emcraft-sf2"
        storage, self._pulses = folder / "nor.bin", folder / "pulses.bin"
        if not storage.is_file():
            storage.write_bytes(b"\xff" * NOR_BYTES)
        self._pulses.write_bytes(b"")
        with _listener() as console, _listener() as gdb:
            command = [
                QEMU, "-M", "emcraft-sf2", "-display", "none", "-monitor", "none",
                "-icount", f"shift={_NS_PER_INSTRUCTION}", "-kernel", str(image),
                "-chardev", f"socket,id=console,fd={console.fileno()},server=on,wait=off",
                "-serial", "chardev:console", "-serial", f"file:{self._pulses}",
                "-drive", f"if=mtd,format=raw,cache=unsafe,file={storage}",
                "-chardev", f"socket,id=gdb,fd={gdb.fileno()},server=on,wait=off",
                "-gdb", "chardev:gdb",
            ]  # fmt: skip
            self._process = subprocess.Popen(command, pass_fds=(console.fileno(), gdb.fileno()))
            self._console = socket.create_connection(console.getsockname(), _LIMIT_S)
            self._debugger_at = gdb.getsockname()

    # The transport (tailbeat.link.transport).

    def read(self) -> bytes:
        """What the board has sent."""
        self._console.setblocking(False)
        pieces = []
        with contextlib.suppress(BlockingIOError):
            while piece := self._console.recv(65536):
                pieces.append(piece)
        return b"".join(pieces)

    def write(self, data: bytes) -> None:
        """Bytes towards the board. QEMU takes them as the UART has room."""
        self._console.settimeout(_LIMIT_S)
        self._console.sendall(data)

    def wait(self, timeout_s: float) -> None:
        """Until bytes come or so much of the board's time is over."""
        end_s, limit_s = self.now_s() + timeout_s, time.monotonic() + timeout_s + _LIMIT_S
        heard = False
        while not heard and self.now_s() < end_s:
            assert time.monotonic() < limit_s, "the board has stopped"
            heard = bool(select.select([self._console], [], [], _LOOK_S)[0])

    def now_s(self) -> float:
        """Time of the board since its power came on, by its ticks."""
        return self._pulses.stat().st_size // _FRAME_BYTES * _TICK_S

    def reopen(self) -> None:
        """There is nothing to open."""

    def close(self) -> None:
        """The board lives on with its owner."""

    # The rest of the board.

    def pulses(self) -> list[PulseFrame]:
        """Every frame of the servo since the power came on."""
        return decode_pulses(self._pulses.read_bytes())

    def await_start(self) -> None:
        """Returns when the firmware says that it starts."""
        heard, end_s = b"", self.now_s() + _LIMIT_S
        while START_LINE not in heard:
            assert self.now_s() < end_s, f"no start: {heard!r}"
            self.wait(1.0)
            heard += self.read()

    def divert(self, pc: int, r0: int) -> None:
        """Makes the processor go on at ``pc``, as in a call with the argument ``r0``."""
        with socket.create_connection(self._debugger_at, _LIMIT_S) as debugger:
            _ask(debugger, "qXfer:features:read:target.xml:0,fff")  # else QEMU takes no register
            for register, value in ((0, r0), (15, pc & ~1)):
                _ask(debugger, f"P{register:x}={value.to_bytes(4, 'little').hex()}")
            _ask(debugger, "D")

    def __enter__(self) -> EmcraftBoard:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.kill()
        self._process.wait()
        self._console.close()


def _ask(debugger: socket.socket, words: str) -> None:
    """A packet of gdb's remote protocol. Raises AssertionError when QEMU does not take it."""
    debugger.sendall(f"${words}#{sum(words.encode()) & 0xFF:02x}".encode())
    answer = b""
    while len(answer.partition(b"#")[2]) < _SUM_DIGITS:
        piece = debugger.recv(4096)
        assert piece, "QEMU has ended"
        answer += piece
    debugger.sendall(b"+")
    assert b"$E" not in answer and b"$#" not in answer, f"QEMU answers {words} with {answer!r}"


def _listener() -> socket.socket:
    """At a port of its own, which QEMU takes over."""
    end = socket.socket()
    end.bind(("127.0.0.1", 0))
    end.listen(1)
    return end
