"""Radio modules and the serial line to them: what a UART at the wrong speed makes of bytes, an
HC-05 and an HC-06 that take commands, and ports in virtual time."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from dataclasses import dataclass, field

from tailbeat.link import _dialect as mavlink
from tailbeat.sim.board import SimBoard

FAST, SLOW = 115200, 9600
Burst = tuple[float, bytes]  # when its first bit leaves, and its bytes back to back


def level_of(bursts: list[Burst], baud: int) -> Callable[[float], int]:
    """The line's level over time: start bit, eight bits, lowest first, stop bit; high between."""
    spans = [(begin, begin + 10 * len(data) / baud, data) for begin, data in bursts]

    def level(time_s: float) -> int:
        for begin, end, data in spans:
            if begin <= time_s < end:
                bit = int((time_s - begin) * baud)
                which, bit = divmod(bit, 10)
                return 0 if bit == 0 else 1 if bit == 9 else data[which] >> (bit - 1) & 1
        return 1

    return level


def received(bursts: list[Burst], sent_at: int, read_at: int, keep_bad: bool) -> list[Burst]:
    """The bytes a UART at ``read_at`` baud takes from a line driven at ``sent_at``, and when. It
    waits for a low level, looks at the middle of each bit, and keeps or drops what has no stop
    bit; after a bad one it waits for the line to be high again."""
    level, bit_s, step_s = level_of(bursts, sent_at), 1 / read_at, 1 / (16 * max(sent_at, read_at))
    out: list[Burst] = []
    for begin, data in bursts:
        now, end = begin, begin + 10 * len(data) / sent_at
        while now < end:
            if level(now + step_s / 2) == 1:
                now += step_s
                continue
            bits = [level(now + (i + 1.5) * bit_s) for i in range(9)]
            if bits[8] == 1 or keep_bad:
                value = sum(bit << i for i, bit in enumerate(bits[:8]))
                out.append((now + 9.5 * bit_s, bytes([value])))
            now += 9.5 * bit_s
            while bits[8] == 0 and now < end and level(now + step_s / 2) == 0:
                now += step_s
    return out


def board_bursts(seconds: float, seed: int = 1) -> list[Burst]:
    """All that a board says while it hears nobody, and when."""
    board = SimBoard("tank", seed=seed)
    bursts = []
    while board.time_s < seconds:
        board.run(0.01, 0)
        if data := board.read():
            bursts.append((board.time_s, data))
    return bursts


def flat(bursts: list[Burst]) -> bytes:
    return b"".join(data for _, data in bursts)


def heartbeat(draw: random.Random, number: int, signed: bool) -> bytes:
    """One in any state; signed with any key at any time."""
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    mav.seq = number & 255
    state = draw.randrange(8) + 256 * draw.randrange(64)
    if signed:
        mav.signing.secret_key = draw.randbytes(32)
        mav.signing.timestamp = draw.randrange(1 << 40)
        mav.signing.sign_outgoing = True
    message = mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_SUBMARINE, mavlink.MAV_AUTOPILOT_GENERIC, draw.choice([0, 128]), state,
        draw.choice([3, 4]), 3,
    )  # fmt: skip
    return bytes(message.pack(mav))


class Recorded:
    """A port on which bytes come at recorded times, whatever is said to it; virtual time."""

    def __init__(self, bursts: list[Burst], name: str = "/dev/rfcomm0") -> None:
        self.name = name
        self._bursts = list(bursts)
        self._now_s = 0.0
        self.closed = False

    def read(self) -> bytes:
        come = [data for time_s, data in self._bursts if time_s <= self._now_s]
        del self._bursts[: len(come)]
        return b"".join(come)

    def write(self, data: bytes) -> None:
        pass

    def wait(self, timeout_s: float) -> None:
        due_s = self._bursts[0][0] - self._now_s if self._bursts else timeout_s
        self._now_s += max(0.001, min(timeout_s, due_s))

    def now_s(self) -> float:
        return self._now_s

    def reopen(self) -> None:
        pass

    def close(self) -> None:
        self.closed = True


@dataclass
class Module:
    """An HC-05 in AT mode: CR LF ends a command; what comes at another speed is garbage in its
    buffer. ``firmware`` 2, 3 (values of PSWD in quotes) or 4 (keeps silent about its name, and
    changes its speed at once)."""

    firmware: int = 2
    at_baud: int = 38400
    uart: str = "9600,0,0"
    name: str = "HC-05"
    pin: str = "1234"
    echo: bool = False
    delay_s: float = 0.02
    refuse: dict[str, str] = field(default_factory=dict)  # beginning of a command: its answer
    said: list[str] = field(default_factory=list)
    resets: int = 0
    buffer: bytes = b""

    def hear(self, data: bytes, baud: int) -> bytes:
        """Answers what the module sends back, at its speed."""
        if baud != self.at_baud:
            data = flat(received([(0.0, data)], baud, self.at_baud, True))
        out = data if self.echo else b""
        self.buffer += data
        while b"\r\n" in self.buffer:
            command, self.buffer = self.buffer.split(b"\r\n", 1)
            out += self.answer(command.decode("latin-1"))
        return out

    def answer(self, command: str) -> bytes:
        self.said.append(command)
        for beginning, reply in self.refuse.items():
            if command.startswith(beginning):
                return f"{reply}\r\n".encode()
        reply = self.reply(command)
        return b"".join(f"{line}\r\n".encode() for line in reply)

    def reply(self, command: str) -> list[str]:
        key, equals, value = command.removeprefix("AT+").partition("=")
        if command == "AT":
            return ["OK"]
        if command == "AT+RESET":
            self.resets += 1
            return ["OK"]
        if command in ("AT+VERSION?", "AT+VERSION"):
            texts = {2: "+VERSION:2.0-20100601", 3: "VERSION:3.0-20170601", 4: "+VERSION:x"}
            wanted = "AT+VERSION" if self.firmware == 3 else "AT+VERSION?"
            return [texts[self.firmware], "OK"] if command == wanted else ["ERROR:(0)"]
        if command == "AT+UART?":
            return [f"+UART:{self.uart}", "OK"]
        if command == "AT+NAME?":
            return [] if self.firmware == 4 else [f"+NAME:{self.name}", "OK"]
        if command == "AT+PSWD?":
            return [f'+PIN:"{self.pin}"' if self.firmware == 3 else f"+PSWD:{self.pin}", "OK"]
        if equals and key in ("UART", "NAME", "PSWD"):
            return self.change(key, value)
        return ["ERROR:(0)"]

    def change(self, key: str, value: str) -> list[str]:
        if key == "UART":
            if not re.fullmatch(r"(9600|38400|57600|115200),[01],[012]", value):
                return ["ERROR:(11)"]
            self.uart = value
            if self.firmware == 4:
                self.at_baud = int(value.split(",")[0])
        elif key == "NAME":
            self.name = value
        else:
            if (self.firmware == 3) != value.startswith('"'):
                return ["ERROR:(1D)"] if self.firmware == 3 else self._take_quotes(value)
            self.pin = value.strip('"')
        return ["OK"]

    def _take_quotes(self, value: str) -> list[str]:
        self.pin = value  # old firmware takes them for a part of the PIN
        return ["OK"]


@dataclass
class Hc06(Module):
    """No line ends: a command is over when nothing follows. Answers at once here, later there."""

    at_baud: int = 9600
    delay_s: float = 0.9

    def hear(self, data: bytes, baud: int) -> bytes:
        if baud != self.at_baud:
            return b""
        command = data.decode("latin-1")
        self.said.append(command)
        if command == "AT":
            return b"OK"
        if command == "AT+VERSION":
            return b"OKlinvorV1.8"
        if command == "AT+BAUD8":
            self.at_baud, self.uart = 115200, "115200,0,0"
            return b"OK115200"
        for key, text in (("AT+NAME", "setname"), ("AT+PIN", "setPIN")):
            if command.startswith(key):
                setattr(self, key.removeprefix("AT+").lower(), command.removeprefix(key))
                return f"OK{text}".encode()
        return b""


class FakeLine:
    """The adapter with a module on it; virtual time. ``noise``: what comes unasked each second."""

    name = "/dev/ttyUSB0"

    def __init__(self, module: Module | None, noise: bytes = b"", loop: bool = False) -> None:
        self.module, self.noise, self.loop = module, noise, loop
        self.baud = 0
        self._now_s = 0.0
        self._noise_s = 0.5
        self._in: list[tuple[float, bytes, int]] = []

    def set_baud(self, baud: int) -> None:
        self.baud = baud
        self._in.clear()

    def write(self, data: bytes) -> None:
        if self.loop:
            self._in.append((self._now_s, data, self.baud))
        if self.module is None:
            return
        at_baud = self.module.at_baud
        reply = self.module.hear(data, self.baud)
        if reply:
            self._in.append((self._now_s + self.module.delay_s, reply, at_baud))

    def read(self) -> bytes:
        come = [item for item in self._in if item[0] <= self._now_s]
        self._in = [item for item in self._in if item[0] > self._now_s]
        out = b""
        for _, data, baud in come:
            same = baud == self.baud
            out += data if same else flat(received([(0.0, data)], baud, self.baud, True))
        while self.noise and self._noise_s <= self._now_s:
            self._noise_s += 1.0
            out += self.noise
        return out

    def wait(self, timeout_s: float) -> None:
        self._now_s += max(0.001, min(timeout_s, 0.05))

    def now_s(self) -> float:
        return self._now_s

    def reopen(self) -> None:
        pass

    def close(self) -> None:
        pass
