"""The private peripheral bus: NVIC, system control, SysTick, MPU and the cycle counter.

Registers: ARMv7-M Architecture Reference Manual, B3.2 to B3.5 and C1.8. What is not modelled is a
violation when it is touched.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from vboard.core import exceptions as ex
from vboard.core.bus import BusViolation
from vboard.core.clock import Clock
from vboard.core.mpu import REGION_COUNT, Mpu
from vboard.core.systick import CALIBRATION, SysTick

PPB_START, PPB_SIZE = 0xE0000000, 0x100000
CPUID_R2P0 = 0x412FC230
AIRCR_KEY, AIRCR_SYSRESETREQ, AIRCR_VECTCLRACTIVE = 0x05FA, 1 << 2, 1 << 1
AIRCR_VECTRESET = 1 << 0
SCR_SLEEPONEXIT, SCR_SLEEPDEEP = 1 << 1, 1 << 2
ICSR_NMIPENDSET, ICSR_PENDSVSET, ICSR_PENDSVCLR = 1 << 31, 1 << 28, 1 << 27
ICSR_PENDSTSET, ICSR_PENDSTCLR, ICSR_ISRPENDING = 1 << 26, 1 << 25, 1 << 22
ICSR_RETTOBASE = 1 << 11
DEMCR_TRCENA, DEMCR_MON_EN = 1 << 24, 1 << 16
DWT_CYCCNTENA = 1 << 0
CCR_KNOWN = 0x213
RESET_SOFTWARE = 3
# (bit of SHCSR, exception): active, pending, enabled.
_SHCSR_ACTIVE = ((0, 4), (1, 5), (3, 6), (7, 11), (8, 12), (10, 14), (11, 15))
_SHCSR_PENDING = ((12, 6), (13, 4), (14, 5), (15, 11))
_SHCSR_ENABLED = ((16, 4), (17, 5), (18, 6))
_RESERVED = (7, 8, 9, 10, 13)
_NARROW = ((0xE000E400, 0xE000E430), (0xE000ED18, 0xE000ED2C))


class System(Protocol):
    """What the private bus asks of the board."""

    clock: Clock

    def mck_ticks(self) -> int:
        """Clock ticks per cycle."""

    def request_reset(self, cause: int) -> None:
        """Resets the chip after the present instruction."""

    def trap_division(self, on: bool) -> None:
        """CCR.DIV_0_TRP changed."""


class PrivateBus:
    """Registers at 0xE0000000 in front of Exceptions, SysTick and Mpu."""

    def __init__(self, system: System, exceptions: ex.Exceptions, mpu: Mpu) -> None:
        self._system, self._exceptions, self.mpu = system, exceptions, mpu
        self.systick = SysTick(system.clock, system.mck_ticks, lambda: exceptions.pend(ex.SYSTICK))
        self._readers: dict[int, Callable[[], int]] = {}
        self._writers: dict[int, Callable[[int], None]] = {}
        self._bind_systick_and_scb()
        self._bind_nvic()
        self._bind_mpu()
        self._bind_debug()
        self.reset()

    def reset(self) -> None:
        """As after a reset of the processor."""
        self.systick.reset()
        self.mpu.reset()
        self._actlr = self._scr = self._demcr = self._dwt_control = 0
        self._cycles_from = 0

    def read(self, address: int, width: int) -> int:
        """A load by the processor. Raises BusViolation."""
        word = address & ~3
        if word not in self._readers:
            raise BusViolation(f"load from 0x{address:08x}: no such system register")
        self._check_width("load from", address, width)
        shift = 8 * (address & 3)
        return (self._readers[word]() & 0xFFFFFFFF) >> shift & ((1 << 8 * width) - 1)

    def write(self, address: int, width: int, value: int) -> None:
        """A store by the processor. Raises BusViolation."""
        word = address & ~3
        if word not in self._writers:
            raise BusViolation(f"store to 0x{address:08x}: no such writable system register")
        self._check_width("store to", address, width)
        if width != 4:
            shift = 8 * (address & 3)
            kept = 0 if word == 0xE000ED28 else self._readers[word]()
            value = kept & ~(((1 << 8 * width) - 1) << shift) | value << shift
        self._writers[word](value)
        self._exceptions.attention = True

    def _check_width(self, verb: str, address: int, width: int) -> None:
        if width == 4 and address % 4 == 0:
            return
        narrow = any(start <= address < end for start, end in _NARROW)
        if not narrow or address % width:
            raise BusViolation(f"{verb} 0x{address:08x} with {width * 8} bits; it takes 32")

    def _bind(
        self,
        address: int,
        read: Callable[[], int] | None,
        write: Callable[[int], None] | None = None,
    ) -> None:
        if read:
            self._readers[address] = read
        if write:
            self._writers[address] = write

    # NVIC.

    def _bind_nvic(self) -> None:
        exc = self._exceptions
        self._bind(0xE000E004, lambda: (ex.IRQ_COUNT - 1) // 32)
        for word in range((ex.IRQ_COUNT + 31) // 32):
            self._bind_bits(0x100, word, lambda: exc.enabled, self._enable)
            self._bind_bits(0x180, word, lambda: exc.enabled, self._disable)
            self._bind_bits(0x200, word, lambda: exc.pending, exc.pend)
            self._bind_bits(0x280, word, lambda: exc.pending, exc.unpend)
            self._bind_bits(0x300, word, lambda: exc.active, None)
        for first in range(0, ex.IRQ_COUNT, 4):
            self._bind_priorities(0xE000E400 + first, ex.FIRST_IRQ + first)
        self._bind(0xE000EF00, None, self._software_trigger)

    def _bind_bits(
        self,
        offset: int,
        word: int,
        source: Callable[[], int],
        act: Callable[[int], None] | None,
    ) -> None:
        first = ex.FIRST_IRQ + 32 * word
        count = min(32, ex.EXCEPTION_COUNT - first)

        def write(value: int) -> None:
            assert act is not None
            for bit in range(count):
                if value >> bit & 1:
                    act(first + bit)

        self._bind(
            0xE000E000 + offset + 4 * word,
            lambda: source() >> first & ((1 << count) - 1),
            write if act else None,
        )

    def _enable(self, number: int) -> None:
        self._exceptions.enabled |= 1 << number

    def _disable(self, number: int) -> None:
        self._exceptions.enabled &= ~(1 << number)

    def _bind_priorities(self, address: int, first: int) -> None:
        numbers = range(first, min(first + 4, ex.EXCEPTION_COUNT))

        def read() -> int:
            return sum(
                self._exceptions.priority[number] << 8 * lane for lane, number in enumerate(numbers)
            )

        def write(value: int) -> None:
            for lane, number in enumerate(numbers):
                if number not in _RESERVED:
                    self._exceptions.priority[number] = value >> 8 * lane & 0xF0

        self._bind(address, read, write)

    def _software_trigger(self, value: int) -> None:
        if value & 0x1FF >= ex.IRQ_COUNT:
            raise BusViolation(f"STIR: there is no interrupt {value & 0x1FF}")
        self._exceptions.pend(ex.FIRST_IRQ + (value & 0x1FF))

    # System control block and SysTick.

    def _bind_systick_and_scb(self) -> None:
        exc, tick = self._exceptions, self.systick
        self._bind(0xE000E008, lambda: self._actlr, self._write_actlr)
        self._bind(0xE000E010, tick.read_control, tick.write_control)
        self._bind(0xE000E014, tick.read_load, tick.write_load)
        self._bind(0xE000E018, tick.read_value, tick.write_value)
        self._bind(0xE000E01C, lambda: CALIBRATION)
        self._bind(0xE000ED00, lambda: CPUID_R2P0)
        self._bind(0xE000ED04, self._read_icsr, self._write_icsr)
        self._bind(0xE000ED08, lambda: exc.vector_table, self._write_vtor)
        self._bind(0xE000ED0C, self._read_aircr, self._write_aircr)
        self._bind(0xE000ED10, lambda: self._scr, self._write_scr)
        self._bind(0xE000ED14, lambda: exc.ccr, self._write_ccr)
        for first in (4, 8, 12):
            self._bind_priorities(0xE000ED14 + first, first)
        self._bind(0xE000ED24, self._read_shcsr, self._write_shcsr)
        self._bind(0xE000ED28, lambda: exc.cfsr, self._clear_cfsr)
        self._bind(0xE000ED2C, lambda: exc.hfsr, self._clear_hfsr)
        self._bind(0xE000ED30, lambda: 0, lambda _value: None)
        self._bind(0xE000ED34, lambda: exc.mmfar, lambda v: setattr(exc, "mmfar", v))
        self._bind(0xE000ED38, lambda: exc.bfar, lambda v: setattr(exc, "bfar", v))
        self._bind(0xE000ED3C, lambda: 0, lambda _value: None)

    def _write_actlr(self, value: int) -> None:
        self._actlr = value & 7

    def _read_icsr(self) -> int:
        exc = self._exceptions
        active = exc.cpu.exception_number()
        value = active | (exc.best_pending() or 0) << 12
        if exc.pending >> ex.FIRST_IRQ:
            value |= ICSR_ISRPENDING
        if not exc.active & ~(1 << active):
            value |= ICSR_RETTOBASE
        for bit, number in ((31, ex.NMI), (28, ex.PENDSV), (26, ex.SYSTICK)):
            value |= (exc.pending >> number & 1) << bit
        return value

    def _write_icsr(self, value: int) -> None:
        exc = self._exceptions
        if value & ICSR_NMIPENDSET:
            exc.pend(ex.NMI)
        if value & ICSR_PENDSVSET:
            exc.pend(ex.PENDSV)
        elif value & ICSR_PENDSVCLR:
            exc.unpend(ex.PENDSV)
        if value & ICSR_PENDSTSET:
            exc.pend(ex.SYSTICK)
        elif value & ICSR_PENDSTCLR:
            exc.unpend(ex.SYSTICK)

    def _write_vtor(self, value: int) -> None:
        if value & 0xFF:
            raise BusViolation(f"VTOR 0x{value:08x}: 61 vectors want an alignment of 256 bytes")
        self._exceptions.vector_table = value & 0x3FFFFF80

    def _read_aircr(self) -> int:
        group = (~self._exceptions.group_mask & 0xFF).bit_length() - 1
        return 0xFA05 << 16 | group << 8

    def _write_aircr(self, value: int) -> None:
        if value >> 16 != AIRCR_KEY:
            raise BusViolation(f"AIRCR written without its key (0x{value:08x})")
        if value & (AIRCR_VECTRESET | AIRCR_VECTCLRACTIVE):
            raise BusViolation("AIRCR: VECTRESET and VECTCLRACTIVE are for debuggers")
        self._exceptions.group_mask = ~((2 << (value >> 8 & 7)) - 1) & 0xFF
        if value & AIRCR_SYSRESETREQ:
            self._system.request_reset(RESET_SOFTWARE)

    def _write_scr(self, value: int) -> None:
        if value & SCR_SLEEPDEEP:
            raise BusViolation("SCR.SLEEPDEEP: wait and backup modes are not modelled")
        self._scr = value & 0x16
        self._exceptions.sleep_on_exit = bool(value & SCR_SLEEPONEXIT)

    def _write_ccr(self, value: int) -> None:
        if value & ~CCR_KNOWN:
            raise BusViolation(f"CCR: bits 0x{value & ~CCR_KNOWN:x} are unknown or not modelled")
        if (value ^ self._exceptions.ccr) & ex.CCR_DIV_0_TRP:
            self._system.trap_division(bool(value & ex.CCR_DIV_0_TRP))
        self._exceptions.ccr = value

    def _read_shcsr(self) -> int:
        exc, value = self._exceptions, 0
        for state, table in (
            (exc.active, _SHCSR_ACTIVE),
            (exc.pending, _SHCSR_PENDING),
            (exc.enabled, _SHCSR_ENABLED),
        ):
            for bit, number in table:
                value |= (state >> number & 1) << bit
        return value

    def _write_shcsr(self, value: int) -> None:
        exc = self._exceptions
        exc.active = _with_bits(exc.active, value, _SHCSR_ACTIVE)
        exc.pending = _with_bits(exc.pending, value, _SHCSR_PENDING)
        exc.enabled = _with_bits(exc.enabled, value, _SHCSR_ENABLED)

    def _clear_cfsr(self, value: int) -> None:
        self._exceptions.cfsr &= ~value

    def _clear_hfsr(self, value: int) -> None:
        self._exceptions.hfsr &= ~value

    # MPU.

    def _bind_mpu(self) -> None:
        mpu = self.mpu
        self._bind(0xE000ED90, lambda: REGION_COUNT << 8)
        self._bind(0xE000ED94, lambda: mpu.control, mpu.write_control)
        self._bind(0xE000ED98, lambda: mpu.number, mpu.select)
        for alias in range(0, 32, 8):
            self._bind(0xE000ED9C + alias, mpu.read_base, mpu.write_base)
            self._bind(0xE000EDA0 + alias, lambda: mpu.attributes[mpu.number], mpu.write_attributes)

    # Debug monitor and cycle counter.

    def _bind_debug(self) -> None:
        self._bind(0xE000EDF0, lambda: 0)
        self._bind(0xE000EDFC, lambda: self._demcr, self._write_demcr)
        self._bind(0xE0001000, lambda: self._dwt_control, self._write_dwt_control)
        self._bind(0xE0001004, self._read_cycles, self._write_cycles)

    def _write_demcr(self, value: int) -> None:
        self._demcr = value & (DEMCR_TRCENA | DEMCR_MON_EN)
        self._exceptions.debug_monitor = bool(value & DEMCR_MON_EN)

    def _write_dwt_control(self, value: int) -> None:
        if not self._demcr & DEMCR_TRCENA:
            raise BusViolation("DWT written while DEMCR.TRCENA is 0")
        if value & DWT_CYCCNTENA and not self._dwt_control & DWT_CYCCNTENA:
            self._write_cycles(0)
        self._dwt_control = value & DWT_CYCCNTENA

    def _read_cycles(self) -> int:
        if not self._dwt_control & DWT_CYCCNTENA:
            return 0
        return (self._system.clock.now - self._cycles_from) // self._system.mck_ticks()

    def _write_cycles(self, value: int) -> None:
        self._cycles_from = self._system.clock.now - value * self._system.mck_ticks()


def _with_bits(state: int, value: int, table: tuple[tuple[int, int], ...]) -> int:
    for bit, number in table:
        state = state & ~(1 << number) | (value >> bit & 1) << number
    return state
