"""Native peripherals, each in the place of its reference model."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import c_int64
from functools import partial
from typing import Any, Protocol, cast

from vboard.core.bus import Peripheral, Reg, Soc
from vboard.native.core import Core
from vboard.native.library import NEVER, library
from vboard.native.line import NativeSerialLine
from vboard.periph.models import Models
from vboard.periph.pwm import PeriodListener, Pwm
from vboard.periph.supply import SlowClock
from vboard.periph.tc import TcChannel
from vboard.periph.usart import SerialPort, Uart, Usart
from vboard.periph.wdt import Wdt
from vboard.wires.serial_line import SerialLine


class NativeSoc(Soc, Protocol):
    """A chip whose models are native."""

    core: Core


def _core_of(soc: Soc) -> Core:
    return cast(NativeSoc, soc).core


class _Native(Peripheral):
    """Registers that are in C; what the reference calls read_NAME() and write_NAME() as well."""

    core: Core

    def _bind(self, reg: Reg, index: int) -> None:
        offset, key = reg.offset + index * reg.stride, _key(reg, index)
        if "r" in reg.access:
            self._readers[offset] = (key, partial(self._read_native, offset))
        if "w" in reg.access:
            self._writers[offset] = (key, partial(self._write_native, offset))
        if reg.count == 1:
            setattr(self, f"read_{reg.name.lower()}", partial(self._read_native, offset))
            setattr(self, f"write_{reg.name.lower()}", partial(self._write_native, offset))

    def write(self, offset: int, value: int) -> str:
        """Register name. Raises BusViolation."""
        return Peripheral.write(self, offset, value)

    def _read_native(self, offset: int) -> int:
        value = self.core.read(self.base + offset)
        assert value is not None, f"{self.name} +0x{offset:x} is no register in C"
        return value

    def _write_native(self, offset: int, value: int) -> None:
        known = self.core.write(self.base + offset, value)
        assert known, f"{self.name} +0x{offset:x} is no register in C"


def _key(reg: Reg, index: int) -> str:
    return reg.name if reg.count == 1 else f"{reg.name}{index}"


class _NativePort(_Native, SerialPort):
    """A serial port and its PDC."""

    usart = False

    def __init__(self, soc: Soc, name: str, base: int, pid: int) -> None:
        self.core = _core_of(soc)
        self._at = self.core.add_port(name, base, pid, self.usart)
        self._index = len(self.core.txd_given) - 1
        self.line: SerialLine | None = None
        Peripheral.__init__(self, soc, name, base, pid)

    @property
    def txd_given(self) -> Callable[[], bool] | None:
        """Whether the pin is handed over."""
        return self.core.txd_given[self._index]

    @txd_given.setter
    def txd_given(self, given: Callable[[], bool] | None) -> None:
        self.core.txd_given[self._index] = given or (lambda: True)

    def connect(self, line: SerialLine) -> None:
        """Solders the wire to the port."""
        assert isinstance(line, NativeSerialLine), "the line has another board's clock"
        self.line = line
        self.core.call("vb_port_connect", self._at, line.handle)
        line.connect(self)

    def reset(self) -> None:
        """All off; a byte being sent is lost."""
        self.core.call("vb_port_reset", self._at)

    def retime(self) -> None:
        """The master clock or the divider changed."""
        self.core.call("vb_port_retime", self._at)

    def sending(self) -> bool:
        """Whether a byte is on the wire."""
        return self.next_sent() is not None

    def sync(self) -> None:
        """Receives and sends what time allows up to now."""
        self.core.call("vb_port_sync", self._at)

    def replan(self) -> None:
        """Starts what can start, drives the interrupt, plans the next event."""
        self.core.call("vb_port_replan", self._at)

    def next_sent(self) -> int | None:
        """When the byte on the wire has left it."""
        return _time(self.core.call("vb_port_next_sent", self._at))

    def all_sent(self) -> int | None:
        """When everything known is sent."""
        return _time(self.core.call("vb_port_all_sent", self._at))


class NativeUart(_NativePort, Uart):
    """The console port."""


class NativeUsart(_NativePort, Usart):
    """A USART."""

    usart = True


class NativeTcChannel(_Native, TcChannel):
    """A channel of a timer block."""

    def __init__(self, soc: Soc, name: str, base: int, pid: int, slow: SlowClock) -> None:
        self.core, self.slow = _core_of(soc), slow
        self._at = self.core.add_timer(name, base, pid)
        Peripheral.__init__(self, soc, name, base, pid)

    def reset(self) -> None:
        """Off, at 0."""
        self.core.call("vb_timer_reset", self._at)

    def retime(self) -> None:
        """The clock's frequency changes or changed."""
        self.core.call("vb_timer_retime", self._at)


class NativeWdt(_Native, Wdt):
    """The watchdog; it tells the other models of the slow clock, too."""

    def __init__(self, soc: Soc, name: str, base: int, slow: SlowClock) -> None:
        self.core, self.slow = _core_of(soc), slow
        self.core.set_slow_hz(slow.hz)
        self._at, self._shared = self.core.add_watchdog(base)
        Peripheral.__init__(self, soc, name, base)
        slow.before_change.append(self._hold)
        slow.after_change.append(self._changed)

    def _fed_so_far(self) -> int:
        return int(self._shared.fed)

    def _shortest_left(self) -> float | None:
        left = float(self._shared.shortest_left_s)
        return None if left < 0 else left

    # The reference has attributes.
    fed: Any = property(_fed_so_far)
    shortest_left_s: Any = property(_shortest_left)

    def reset(self) -> None:
        """Runs from the reset on, with the longest time."""
        self.core.call("vb_watchdog_reset", self._at)

    def power_off(self) -> None:
        """Stops."""
        self._hold()
        self.slow.before_change.remove(self._hold)
        self.slow.after_change.remove(self._changed)

    def counter(self) -> float:
        """Counts left."""
        return float(library.vb_watchdog_counter(self._at))

    def idle(self, sleeping: bool) -> None:
        """The processor goes to sleep or wakes."""
        self.core.call("vb_watchdog_idle", self._at, sleeping)

    def _hold(self) -> None:
        self.core.call("vb_watchdog_hold", self._at)

    def _changed(self) -> None:
        self.core.set_slow_hz(self.slow.hz)
        self.core.call("vb_watchdog_run", self._at)


class NativePwm(_Native, Pwm):
    """The PWM controller."""

    def __init__(self, soc: Soc, name: str, base: int, pid: int) -> None:
        self.core = _core_of(soc)
        self.on_period: list[PeriodListener] = []
        self.on_change: list[Callable[[], None]] = []
        self._at = self.core.add_pwm(base, pid)
        self.core.pwm_period = self._period
        self.core.pwm_changed = self._tell
        Peripheral.__init__(self, soc, name, base, pid)

    def reset(self) -> None:
        """All channels off."""
        self.core.call("vb_pwm_reset", self._at)

    def retime(self) -> None:
        """The master clock jumped (crystal failure): running channels go on at the new rate."""
        self.core.call("vb_pwm_retime", self._at)

    def waveform(self, channel: int, output: str = "L") -> tuple[bool, int | None]:
        """Level of PWML ("L") or PWMH ("H") now, and when it changes within this period."""
        turn = c_int64()
        level = library.vb_pwm_waveform(self._at, channel, output == "H", ctypes.byref(turn))
        return bool(level), _time(turn.value)

    def running(self, channel: int) -> bool:
        """Whether the channel counts."""
        return bool(library.vb_pwm_running(self._at, channel))

    def high_counts(self, channel: int, output: str = "L") -> int:
        """High time of an output in the present period, in counts of the channel's clock."""
        return int(library.vb_pwm_high_counts(self._at, channel, output == "H"))

    def refuse_if_running(self, what: str = "the master clock changed") -> None:
        """Raises BusViolation while a channel counts."""
        self.core.call("vb_pwm_refuse_if_running", self._at, what.encode())

    def _period(self, channel: int, start: int, period: int, high: int) -> None:
        for call in self.on_period:
            call(channel, start, period, high)


def _time(ticks: Any) -> int | None:
    return None if ticks == NEVER else int(ticks)


NATIVE = Models(NativeUart, NativeUsart, NativeTcChannel, NativePwm, NativeWdt)
