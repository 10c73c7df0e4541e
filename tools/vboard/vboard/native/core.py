"""A vb_chip_t, as the chip or a bench of peripherals owns it, and how C reaches Python."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import c_uint32
from typing import Any

from vboard.core.memory import Buffer
from vboard.native.clock import NativeClock
from vboard.native.library import (
    UNKNOWN,
    Calls,
    Engine,
    State,
    WatchdogFields,
    handle_of,
    library,
)
from vboard.periph.pmc import GATED, Pmc

_ALL_PIDS = (1 << 64) - 1
_GATED_MASK = sum(1 << pid for pid in GATED)

PwmPeriod = Callable[[int, int, int, int], None]


class Core:
    """``calls``: Python's functions by their name in vb_calls_t; those that are left out are never
    called, but for set_irq and request_reset, which mean a chip without a processor.

    ``txd_given``: by index of the port. ``pwm_period`` and ``pwm_changed`` belong to the PWM.
    """

    def __init__(
        self, clock: NativeClock, flash: Buffer, ram: Buffer, calls: dict[str, Callable[..., Any]]
    ) -> None:
        self.time = clock.shared
        self._memory = ctypes.create_string_buffer(library.vb_chip_bytes())
        self._hosts = [(ctypes.c_char * len(buffer)).from_buffer(buffer) for buffer in (flash, ram)]
        self.state = State.from_buffer(self._memory)
        self.handle = handle_of(self._memory)
        self.txd_given: list[Callable[[], bool]] = []
        self.pwm_period: PwmPeriod = lambda channel, start, period, high: None
        self.pwm_changed: Callable[[], None] = lambda: None
        self._calls = self._table(calls)
        self._engine: Engine | None = None
        flash_at, ram_at = (handle_of(host) for host in self._hosts)
        library.vb_chip_init(self.handle, self.time.handle, flash_at, ram_at, self._calls)

    def _table(self, calls: dict[str, Callable[..., Any]]) -> Calls:
        own: dict[str, Callable[..., Any]] = {
            "txd_given": lambda index: self.txd_given[index](),
            "pwm_period": lambda *period: self.pwm_period(*period),
            "pwm_changed": lambda: self.pwm_changed(),
        }
        table = Calls()
        for name, kind, *_ in Calls._fields_:
            function = {**own, **calls}.get(name)
            if function is not None:
                setattr(table, name, kind(self.time.guard(function, 0)))
        return table

    def connect(self, engine: Engine) -> None:
        """The processor."""
        self._engine = engine
        library.vb_chip_connect(self.handle, engine)

    def follow(self, pmc: Pmc) -> None:
        """Clocks of chip and peripherals are this controller's."""

        def clock_changed() -> None:
            self.state.mck_ticks = pmc.mck_ticks

        def gates_changed(clocked: int) -> None:
            self.state.clocked = _ALL_PIDS & ~_GATED_MASK | clocked

        pmc.on_mck.insert(0, clock_changed)
        pmc.on_gates.append(gates_changed)
        clock_changed()
        gates_changed(pmc.gates)

    def drop(self) -> None:
        """The power is gone: nothing happens any more."""
        library.vb_chip_drop(self.handle)

    def call(self, name: str, *arguments: Any) -> Any:
        """A function of the library. Raises what fails in it."""
        result = getattr(library, name)(*arguments)
        self.time.check()
        return result

    def set_slow_hz(self, hz: int) -> None:
        """Frequency of the 32 kHz clock."""
        library.vb_chip_set_slow_hz(self.handle, hz)

    def read(self, address: int) -> int | None:
        """A register of a native model; None: there is none to be read."""
        value = c_uint32()
        status = self.call("vb_place_read", self.handle, address, value)
        return None if status == UNKNOWN else value.value

    def write(self, address: int, value: int) -> bool:
        """A register of a native model; False: there is none to be written."""
        status = self.call("vb_place_write", self.handle, address, value & 0xFFFFFFFF)
        return bool(status != UNKNOWN)

    def add_port(self, name: str, base: int, pid: int, usart: bool) -> int:
        """A serial port; its address."""
        self.txd_given.append(lambda: True)
        return int(library.vb_chip_add_port(self.handle, name.encode(), base, pid, int(usart)))

    def add_timer(self, name: str, base: int, pid: int) -> int:
        """A timer channel; its address."""
        return int(library.vb_chip_add_timer(self.handle, name.encode(), base, pid))

    def add_pwm(self, base: int, pid: int) -> int:
        """The PWM; its address."""
        return int(library.vb_chip_add_pwm(self.handle, base, pid))

    def add_watchdog(self, base: int) -> tuple[int, WatchdogFields]:
        """The watchdog: its address and what it shares."""
        address = int(library.vb_chip_add_watchdog(self.handle, base))
        return address, WatchdogFields.from_address(address)
