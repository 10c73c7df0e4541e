"""Sets a Bluetooth serial module up: an HC-05 in its AT mode, or an HC-06, on a USB-serial adapter.

An HC-05 takes commands that end with CR LF, and answers with lines, the last of which is OK or
ERROR:(n). An HC-06 takes a command as ended when nothing follows, and answers without line ends.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from tailbeat.core.errors import ConnectError, InputError, TailbeatError
from tailbeat.link import _dialect as mavlink
from tailbeat.link.frames import Framer
from tailbeat.link.serial import BAUD
from tailbeat.link.transport import Transport

# The AT mode of an HC-05 has a speed of its own; the one entered while it runs ("mini") keeps the
# speed of its data.
AT_BAUDS = (38400, 9600, 115200)
_HC06_BAUDS = (9600, 115200, 57600, 38400, 19200)
_HC06_BAUD_CODE = 8  # of 115200
_AT_S, _REPLY_S, _HC06_REPLY_S = 0.7, 3.0, 1.6
_SETTLE_S = 0.15  # between replies: some firmwares lose a command that comes at once
_AT_TRIES = 3
_HEARD_MAX = 4096
_LISTEN_S = 1.2  # a fish says something every second

# Of the module's manual.
_ERRORS = {
    0x0: "it does not know the command",
    0x1: "the value is the default anyway",
    0x2: "it could not store the value",
    0x3: "the name is too long",
    0x4: "the name is missing",
    0xE: "the PIN is missing",
    0xF: "the PIN is too long",
    0x11: "it does not have this baud rate",
    0x12: "it does not have these stop bits",
    0x13: "it does not have this parity",
    0x1D: "the PIN's length is wrong",
}
# Settings that an HC-05 keeps: its command, the form of its answer, the word in messages.
_VALUES = {
    "name": ("NAME", r"\+?NAME:\s*(.*)", "name"),
    "pin": ("PSWD", r"\+?(?:PSWD|PIN):\s*(.*)", "PIN"),
}
_AT_MODE = (
    "Put it into AT mode: power off, hold its KEY (EN, or the button) high, power on. Its LED then"
    " blinks once in two seconds; quick blinking is data mode. Check ground, TX to RX and RX to TX."
)


class ModuleLine(Transport, Protocol):
    """A serial port whose speed can be changed while it is open."""

    def set_baud(self, baud: int) -> None:
        """Another speed from now on."""


@dataclass(frozen=True)
class ModuleSettings:
    """What a module is set to; None = it does not say. ``stop``: 0 = one stop bit; ``parity``: 0 =
    none."""

    baud: int | None = None
    stop: int | None = None
    parity: int | None = None
    name: str | None = None
    pin: str | None = None

    @property
    def fits(self) -> bool:
        """Whether the board can talk to it."""
        return (self.baud, self.stop, self.parity) == (BAUD, 0, 0)


@dataclass(frozen=True)
class SetupReport:
    """What was found and done. ``changed``: names of the settings that were changed."""

    module: str
    firmware: str | None
    at_baud: int
    found: ModuleSettings
    now: ModuleSettings
    changed: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class ModuleReply:
    """Lines of an answer before OK; ``error``: why it was refused, in words; None when it was not.
    ``came``: anything came at all."""

    lines: list[str]
    ok: bool
    error: str | None
    came: bool

    def value(self, pattern: str) -> re.Match[str] | None:
        """The first line that is ``pattern``."""
        return next((m for line in self.lines if (m := re.fullmatch(pattern, line))), None)


def setup(line: ModuleLine, name: str | None = None, pin: str | None = None) -> SetupReport:
    """Finds the module on ``line`` and brings it to 115200 baud 8N1, and to ``name`` and ``pin``
    when given. What is set so already is left alone. Raises ConnectError, InputError,
    TailbeatError."""
    expected = _checked(name, pin)
    asking = _Asking(line)
    for baud in AT_BAUDS:
        line.set_baud(baud)
        if asking.greet():
            return _Hc05(asking, baud).setup(expected)
    for baud in _HC06_BAUDS:
        line.set_baud(baud)
        if asking.plain("AT").startswith("OK"):
            return _setup_hc06(asking, baud, expected)
    raise _nobody(asking)


class _Asking:
    """Commands and answers, and all that was heard."""

    def __init__(self, line: ModuleLine) -> None:
        self.line = line
        self.heard = bytearray()
        self.sent = bytearray()

    def greet(self) -> bool:
        """Whether an HC-05 is there. Its first answer may be an error: what came before it at
        another speed counts as the beginning of the command."""
        refused = None
        for _ in range(_AT_TRIES):
            reply = self.ask("AT", _AT_S)
            if reply.ok:
                return True
            refused = reply.error or refused
            if not reply.came:
                break
        if refused:
            raise TailbeatError(
                f"the module on {self.line.name} refuses even AT: {refused}",
                "Power it off and on with KEY high, and try again.",
            )
        return False

    def ask(self, command: str, timeout_s: float = _REPLY_S) -> ModuleReply:
        """A command of an HC-05 and its answer."""
        text, ended = self._exchange(f"{command}\r\n", timeout_s, _ended)
        lines = [part.strip() for part in text.splitlines()]
        said = [part for part in lines if part and part != "OK"]
        error = next((words for part in said if (words := _error(part)) is not None), None)
        return ModuleReply(said, ended and error is None, error, bool(text))

    def plain(self, command: str) -> str:
        """A command of an HC-06 and its answer."""
        text, _ = self._exchange(command, _HC06_REPLY_S, lambda _: False)
        return text.strip()

    def listen(self, seconds: float) -> None:
        """Takes in what comes unasked."""
        self._exchange("", seconds, lambda _: False)

    def _exchange(
        self, command: str, timeout_s: float, ended: Callable[[str], bool]
    ) -> tuple[str, bool]:
        line = self.line
        line.wait(_SETTLE_S)
        self._keep(line.read())
        line.write(command.encode())
        self.sent += command.encode()
        deadline = line.now_s() + timeout_s
        got = b""
        while (left := deadline - line.now_s()) > 0:
            line.wait(left)
            got += line.read()
            if ended(text := got.decode("latin-1")):
                self._keep(got)
                return text, True
        self._keep(got)
        return got.decode("latin-1"), False

    def _keep(self, data: bytes) -> None:
        self.heard += data[: _HEARD_MAX - len(self.heard)]


def _ended(text: str) -> bool:
    complete = [part.strip() for part in text.splitlines(keepends=True) if part.endswith("\n")]
    return any(part == "OK" or _error(part) is not None for part in complete)


def _error(text: str) -> str | None:
    """The words for ERROR:(n) and its variants; None when it is none."""
    match = re.fullmatch(r"(?:ERROR|FAIL)\W*([0-9A-Fa-f]*)\W*", text)
    if match is None:
        return None
    words = _ERRORS.get(int(match[1], 16)) if match[1] else None
    return f"{text} ({words})" if words else text


class _Hc05:
    """One HC-05 that answers."""

    def __init__(self, asking: _Asking, at_baud: int) -> None:
        self._asking = asking
        self._at_baud = at_baud

    def setup(self, expected: Mapping[str, str]) -> SetupReport:
        firmware = self._firmware()
        found = _with(self._uart(), {key: self._value(key) for key in expected})
        if found.baud is None:
            raise TailbeatError(
                "the module does not report its speed",
                "Check that it is an HC-05: see 'Wire the fish' in the documentation.",
            )
        now, changed = found, []
        if not found.fits:
            now, changed = self._set_uart(now), ["baud"]
        for key, value in expected.items():
            if value != getattr(found, key):
                now = _with(now, {key: self._set(key, value)})
                changed.append(key)
        if changed:
            self._asking.ask("AT+RESET")
        return SetupReport("HC-05", firmware, self._at_baud, found, now, changed)

    def _firmware(self) -> str | None:
        for question in ("AT+VERSION?", "AT+VERSION"):
            if match := self._asking.ask(question).value(r"\+?VERSION:\s*(.+)"):
                return match[1]
        return None

    def _uart(self) -> ModuleSettings:
        reply = self._asking.ask("AT+UART?")
        if match := reply.value(r"\+?UART:\s*(\d+),\s*(\d),\s*(\d)"):
            baud, stop, parity = map(int, match.groups())
            return ModuleSettings(baud, stop, parity)
        return ModuleSettings()

    def _value(self, key: str) -> str | None:
        command, pattern, _ = _VALUES[key]
        match = self._asking.ask(f"AT+{command}?").value(pattern)
        return match[1].strip('"') if match else None

    def _set_uart(self, before: ModuleSettings) -> ModuleSettings:
        reply = self._asking.ask(f"AT+UART={BAUD},0,0")
        if reply.error:
            raise TailbeatError(
                f"the module refuses {BAUD} baud: {reply.error}",
                "Restore its factory settings (AT+ORGL) or use another module.",
            )
        after = self._uart()
        if after.baud is None:  # some change their speed at once
            self._asking.line.set_baud(BAUD)
            self._asking.greet()
            after = self._uart()
        if not after.fits:
            raise _did_not_keep("speed", after.baud)
        return replace(before, baud=after.baud, stop=after.stop, parity=after.parity)

    def _set(self, key: str, value: str) -> str:
        """Some firmwares want quotes around a value, others take them for a part of it."""
        command, _, what = _VALUES[key]
        refused: str | None = None
        kept: str | None = None
        for text in (value, f'"{value}"'):
            reply = self._asking.ask(f"AT+{command}={text}")
            refused = reply.error or refused
            if not reply.ok:
                continue
            kept = self._value(key)
            if kept in (value, None):  # it need not be able to say
                return value
        if kept is None and refused:
            raise TailbeatError(
                f"the module refuses the {what} {value}: {refused}", "Choose another."
            )
        raise _did_not_keep(command.lower(), kept)


def _setup_hc06(asking: _Asking, baud: int, expected: Mapping[str, str]) -> SetupReport:
    """It tells neither name nor PIN, so those are written whenever they are given."""
    firmware = asking.plain("AT+VERSION").removeprefix("OK") or None
    found = ModuleSettings(baud, 0, 0)
    now, changed = found, []
    if baud != BAUD:
        reply = asking.plain(f"AT+BAUD{_HC06_BAUD_CODE}")
        asking.line.set_baud(BAUD)
        if not asking.plain("AT").startswith("OK"):
            raise _did_not_keep("speed", reply or None)
        now, changed = replace(now, baud=BAUD), ["baud"]
    for key, value in expected.items():
        if not asking.plain(f"AT+{key.upper()}{value}").startswith("OK"):
            raise TailbeatError(f"the module refuses the {key} {value}", "Choose another.")
        now = _with(now, {key: value})
        changed.append(key)
    return SetupReport("HC-06", firmware, baud, found, now, changed)


def _with(settings: ModuleSettings, values: Mapping[str, Any]) -> ModuleSettings:
    return replace(settings, **values)


def _checked(name: str | None, pin: str | None) -> dict[str, str]:
    """The settings that are given, by their names. Raises InputError."""
    if name is not None and not re.fullmatch(r"[A-Za-z0-9 ._-]{1,20}", name):
        raise InputError(
            f"'{name}' is no name for a module",
            "Take 1 to 20 letters, digits, spaces, dots, dashes or underscores.",
        )
    if pin is not None and not re.fullmatch(r"\d{4}", pin):
        raise InputError(f"'{pin}' is no PIN", "Take four digits.")
    return {key: value for key, value in (("name", name), ("pin", pin)) if value is not None}


def _did_not_keep(what: str, kept: object) -> TailbeatError:
    says = "it says nothing" if kept is None else f"it says {kept}"
    return TailbeatError(
        f"the module took the {what} and did not keep it: {says}",
        "Power it off and on with KEY high, and try again.",
    )


def _nobody(asking: _Asking) -> ConnectError:
    """What to say when nothing answers to AT, by what came instead."""
    line = asking.line
    asking.line.set_baud(BAUD)
    before = bytes(asking.heard)
    asking.heard.clear()  # it may be full of what came at other speeds
    asking.listen(_LISTEN_S)
    if Framer(mavlink.MAVLink(None)).push(bytes(asking.heard)):
        return ConnectError(
            f"{line.name} is a board, not a Bluetooth module",
            "PORT is a USB-serial adapter with the module alone on it: see 'Wire the fish' in the"
            " documentation.",
        )
    heard = before + bytes(asking.heard)
    if heard and heard in bytes(asking.sent):
        return ConnectError(
            f"what is sent on {line.name} comes back: there is no module, TX and RX are joined",
            "Wire the adapter's TX to the module's RXD and its RX to TXD.",
        )
    speeds = ", ".join(map(str, AT_BAUDS[:-1])) + f" and {AT_BAUDS[-1]}"
    if heard:
        return ConnectError(
            f"bytes come on {line.name}, but no answer to AT at {speeds} baud: the module is in"
            " data mode, and connected",
            _AT_MODE,
        )
    return ConnectError(f"nothing answers to AT on {line.name} at {speeds} baud", _AT_MODE)
