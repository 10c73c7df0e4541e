"""One ATSAM3X8E from power-on to power-off: processor, interrupts and peripherals in one time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from unicorn import UC_PROT_ALL, UC_PROT_EXEC, UC_PROT_NONE, UC_PROT_READ

from vboard.core.bus import Bus, BusViolation, Peripheral, Soc
from vboard.core.clock import TICKS_PER_S, Clock
from vboard.core.cpu import Cpu, Stop
from vboard.core.division import Division
from vboard.core.exceptions import CCR_DIV_0_TRP, DIVBYZERO, Exceptions, Lockup
from vboard.core.memory import BANK_SIZE, FLASH_START, Memory, is_flash
from vboard.core.mpu import Mpu
from vboard.core.nvic import PPB_SIZE, PPB_START, PrivateBus
from vboard.periph.eefc import Eefc
from vboard.periph.flash import Flash

CYCLES_PER_INSTRUCTION = 2
"""Assumed, for want of a model of flash wait states and pipeline: how long code takes is a guess
within a factor of two; what peripherals time is exact."""

PERIPHERALS_START, PERIPHERALS_SIZE = 0x40000000, 0x20000000
LONGEST_SLICE_TICKS = TICKS_PER_S // 1000
MASKED_STEPS, MASKED_SLICE = 20_000, 256
"""With an interrupt pending that a mask holds back, single steps see the unmasking at once. Code
that masks for longer than this many instructions hangs: then slices see it soon enough."""
GPNVM_BOOT_FLASH = 1 << 1
RESET_POWER_UP, RESET_USER = 0, 4
_BREAKPOINT_BYTES = 2

Factory = Callable[[Soc], Mapping[str, Peripheral]]
Where = Callable[[int], str]


class Chip:
    """Implements Soc for its peripherals. ``off``: after power_off().

    ``divide_traps``: False gives 0 for a division by zero, whatever the image asks for, and is
    faster. ``where`` names an address for messages. ``on_breakpoint`` is asked at BKPT with its
    number; True goes on behind it.
    """

    def __init__(
        self,
        clock: Clock,
        flash: Flash,
        factory: Factory,
        *,
        seed: int = 1,
        where: Where = hex,
        trace: bool = False,
    ) -> None:
        self.clock, self.flash = clock.part(), flash
        self.memory = Memory(flash.memory, seed)
        self._prepare()
        self.instructions = self._idle_ticks = 0
        self._asleep_since: int | None = None
        self.on_breakpoint: Callable[[int], bool] | None = None
        self.divide_traps = True
        self._where = where
        self.off = self._sleeping = self._running = False
        self._masked_steps = 0
        self._reset_cause: int | None = None
        self._cost = CYCLES_PER_INSTRUCTION
        self._slice_start = self._slice_end = 0
        self._blocked = [False, False]
        self._deferred: list[Callable[[], None]] = []
        self.cpu = self._new_cpu()
        spans = self._map_memory()
        self.mpu = self._new_mpu(spans)
        self.exceptions = self._new_exceptions()
        self.nvic = PrivateBus(self, self.exceptions, self.mpu)
        self.bus = self._new_bus()
        self.bus.trace = [] if trace else None
        self.periph: dict[str, Any] = {}
        self.periph.update(factory(self))
        self._wire()
        self._start(RESET_POWER_UP)

    # Of what it is made.

    def _prepare(self) -> None:
        """Comes before everything but clock and memory."""

    def _new_cpu(self) -> Cpu:
        return Cpu(self._on_protected, self.memory.read)

    def _new_mpu(self, spans: list[tuple[int, int, int]]) -> Mpu:
        return Mpu(self.cpu.protect, spans, self._mpu_changed)

    def _new_exceptions(self) -> Exceptions:
        return Exceptions(self.cpu, self.memory, self.mpu, self._spend)

    def _new_bus(self) -> Bus:
        return Bus(self.clock)

    @property
    def idle_ticks(self) -> int:
        """Time asleep in WFI."""
        since = self._asleep_since
        return self._idle_ticks + (0 if since is None else self.clock.now - since)

    @property
    def asleep(self) -> bool:
        """Whether the processor sleeps in WFI."""
        return bool(self._sleeping)

    # What peripherals ask for (Soc).

    def mck_hz(self) -> int:
        """Master clock now."""
        return self.periph["PMC"].mck_hz if "PMC" in self.periph else TICKS_PER_S

    def mck_ticks(self) -> int:
        """Clock ticks per cycle of the master clock."""
        return TICKS_PER_S // self.mck_hz()

    def pid_clocked(self, pid: int) -> bool:
        """Whether the clock of a peripheral is on."""
        return "PMC" not in self.periph or self.periph["PMC"].pid_clocked(pid)

    def set_irq(self, number: int, level: bool) -> None:
        """Drives an interrupt line."""
        self.exceptions.set_line(number, level)

    def read_memory(self, address: int, length: int) -> bytes:
        """As a bus master: flash and RAM."""
        return self.memory.read(address, length)

    def write_memory(self, address: int, data: bytes) -> None:
        """As a bus master: RAM."""
        self.memory.write(address, data)

    def request_reset(self, cause: int) -> None:
        """Resets processor and peripherals after the present instruction."""
        if self._reset_cause is None:
            self._reset_cause = cause
        self.exceptions.attention = True

    def trap_division(self, on: bool) -> None:
        """CCR.DIV_0_TRP changed."""
        self._defer(partial(self.cpu.trap_division, on and self.divide_traps))

    # Running.

    def run_until(self, tick: int, stop: Callable[[], bool] | None = None) -> bool:
        """Runs until the clock reaches ``tick`` or ``stop()`` is true; tells whether it was stop.

        ``stop`` is asked after each millisecond at the latest and whenever something happened. Ends
        early when the power goes.
        """
        self._running = True
        try:
            if self._run(tick, stop):
                return True
        except (BusViolation, Lockup) as error:
            raise self._located(error) from error
        finally:
            self._running = False
            self._close_if_off()
        return stop is not None and stop()

    def _run(self, tick: int, stop: Callable[[], bool] | None) -> bool:
        """Whether ``stop`` ended it."""
        while self.clock.now < tick and not self.off:
            if stop is not None and stop():
                return True
            self._step(tick, stop)
        return False

    def divert(self, address: int) -> None:
        """Goes on at ``address``, as a debugger would make it."""
        self._sleeping = False
        self._tell_watchdog()
        self.cpu.pc = address

    def power_off(self) -> None:
        """The supply is gone at this very instant."""
        for peripheral in self.periph.values():
            peripheral.power_off()
        self.flash.on_change.remove(self._flash_changed)
        self.clock.drop()
        self.off = self.exceptions.attention = True
        self._close_if_off()

    def _close_if_off(self) -> None:
        """Power may go in the middle of a run; the processor is given back after it."""
        if self.off and not self._running:
            self.cpu.close()

    def _step(self, tick: int, stop: Callable[[], bool] | None) -> None:
        """One decision and one slice, or one sleep."""
        self.clock.advance(self.clock.now)
        if self.off:
            return
        while self._deferred:
            self._deferred.pop(0)()
        if self._reset_cause is not None:
            self._reset()
        if self._sleeping and not self._awake():
            self._sleep(tick, stop)
            return
        masked = self.exceptions.dispatch()
        if self.clock.now < tick:
            self._slice(tick, single=masked)

    def _slice(self, tick: int, single: bool) -> None:
        clock, cpu, exceptions = self.clock, self.cpu, self.exceptions
        start = clock.now
        due = clock.next_due()
        end = min(tick, start + LONGEST_SLICE_TICKS, tick if due is None else due)
        self._cost = cost = CYCLES_PER_INSTRUCTION * self.mck_ticks()
        self._slice_start, self._slice_end = start, end
        exceptions.attention = False
        try:
            stop = cpu.run(self._budget(-(-(end - start) // cost), single))
        finally:
            self.instructions += cpu.executed
        clock.advance(max(clock.now, start + cpu.executed * cost))
        if stop is not Stop.COUNT and not self.off:
            self._stopped(stop)

    def _budget(self, instructions: int, masked: bool) -> int:
        self._masked_steps = self._masked_steps + 1 if masked else 0
        if not masked:
            return max(1, instructions)
        return 1 if self._masked_steps < MASKED_STEPS else max(1, min(MASKED_SLICE, instructions))

    def _stopped(self, stop: Stop) -> None:
        if stop is Stop.SLEEP:
            self._fall_asleep()
        elif stop is Stop.BREAKPOINT and self._served_breakpoint():
            self.cpu.pc += _BREAKPOINT_BYTES
        elif stop is Stop.UNDEFINED and self._divided():
            return
        elif stop is Stop.PROTECTED_FETCH and self._bank_blocked(self.cpu.pc):
            raise BusViolation("code runs from a flash bank that is busy or shows the unique id")
        else:
            self.exceptions.handle(stop)
            if self.exceptions.exit_to_sleep:
                self.exceptions.exit_to_sleep = False
                self._fall_asleep()

    def _divided(self) -> bool:
        """Whether it was a division, done or trapped, that looked undefined."""
        if not self.exceptions.ccr & CCR_DIV_0_TRP:
            return False
        outcome = self.cpu.divide_here()
        if outcome is Division.BY_ZERO:
            self.exceptions.usage_fault(DIVBYZERO)
        return outcome is not Division.NONE

    def _served_breakpoint(self) -> bool:
        number = int.from_bytes(self.memory.read(self.cpu.pc, 2), "little") & 0xFF
        return self.on_breakpoint is not None and self.on_breakpoint(number)

    def _defer(self, action: Callable[[], None]) -> None:
        """Does it after the present instruction; Unicorn's memory map is fixed while it runs."""
        if action not in self._deferred:
            self._deferred.append(action)
        self.exceptions.attention = True

    def _mpu_changed(self) -> None:
        self._defer(self.mpu.apply)

    def _spend(self, cycles: int) -> None:
        self.clock.advance(self.clock.now + cycles * self.mck_ticks())

    # Sleep.

    def _fall_asleep(self) -> None:
        if not self.exceptions.wakes():
            self._sleeping = True
            self._tell_watchdog()

    def _awake(self) -> bool:
        if self.exceptions.wakes():
            self._sleeping = False
            self._tell_watchdog()
        return not self._sleeping

    def _sleep(self, tick: int, stop: Callable[[], bool] | None) -> None:
        """From event to event until one of them wants something."""
        clock, exceptions = self.clock, self.exceptions
        exceptions.attention = False
        self._asleep_since = begun = clock.now
        while clock.now < tick and not exceptions.attention:
            due = clock.next_due()
            clock.advance(tick if due is None else min(tick, due))
            if stop is not None and stop():
                break
        self._idle_ticks += clock.now - begun
        self._asleep_since = None

    def _tell_watchdog(self) -> None:
        if "WDT" in self.periph:
            self.periph["WDT"].idle(self._sleeping)

    # Reset.

    def _reset(self) -> None:
        cause, self._reset_cause = self._reset_cause, None
        assert cause is not None
        self.exceptions.reset()
        self.nvic.reset()
        self.cpu.trap_division(False)
        for peripheral in self.periph.values():
            peripheral.reset()
        self._start(cause)

    def _start(self, cause: int) -> None:
        if not self.flash.gpnvm & GPNVM_BOOT_FLASH:
            raise BusViolation("GPNVM1 is clear: the chip boots the SAM-BA ROM, not the image")
        if "RSTC" in self.periph:
            self.periph["RSTC"].cause = cause
        stack, vector = self.memory.word(FLASH_START), self.memory.word(FLASH_START + 4)
        if vector == 0xFFFFFFFF:
            raise Lockup("flash bank 0 holds no image")
        self._sleeping = False
        self.cpu.reset(stack, vector)

    # Memory and peripherals as the processor meets them.

    def _map_memory(self) -> list[tuple[int, int, int]]:
        spans = []
        for address, size, host, writable in self.memory.views():
            permissions = UC_PROT_ALL if writable else UC_PROT_READ | UC_PROT_EXEC
            self.cpu.map(address, size, host, permissions)
            spans.append((address, size, permissions))
        self.cpu.map_io(PERIPHERALS_START, PERIPHERALS_SIZE, self._load, self._store)
        self.cpu.map_io(PPB_START, PPB_SIZE, self._load_system, self._store_system)
        return spans

    def _wire(self) -> None:
        for peripheral in self.periph.values():
            self.bus.add(peripheral)
        self.flash.on_change.append(self._flash_changed)
        for name in ("EEFC0", "EEFC1"):
            if name in self.periph:
                self.periph[name].on_busy.append(self._busy_changed)
        if "PMC" in self.periph:
            pmc = self.periph["PMC"]
            pmc.before_mck.append(self.nvic.systick.before_clock_change)
            pmc.on_mck.append(self._mck_changed)

    def _mck_changed(self) -> None:
        self.nvic.systick.after_clock_change()
        self.exceptions.attention = True

    def _load(self, address: int, width: int) -> int:
        self._catch_up()
        value = self.bus.read(address, width)
        self._adjust_slice()
        return value

    def _store(self, address: int, width: int, value: int) -> None:
        self._catch_up()
        self.bus.write(address, width, value)
        self._adjust_slice()

    def _load_system(self, address: int, width: int) -> int:
        self._catch_up()
        return self.nvic.read(address, width)

    def _store_system(self, address: int, width: int, value: int) -> None:
        self._catch_up()
        self.nvic.write(address, width, value)
        self._adjust_slice()

    def _catch_up(self) -> None:
        """Brings the clock to the instruction that accesses a peripheral."""
        self.clock.advance(self._slice_start + self.cpu.begun() * self._cost)

    def _adjust_slice(self) -> None:
        """The access may have made something due earlier than it was."""
        if self.exceptions.attention:
            self.cpu.end_slice()
            return
        due = self.clock.next_due()
        if due is not None and due < self._slice_end:
            self._slice_end = due
            self.cpu.shorten_slice(-(-(due - self._slice_start) // self._cost))

    # Flash.

    def _on_protected(self, address: int, width: int, value: int | None) -> bool:
        """A load that is let through happens; a store does not, it is done here or in the latch."""
        if self.mpu.hides(address) or self._bank_blocked(address):
            self.cpu.end_slice()
            self._defer(self.cpu.forget_permissions)
        if not self._mpu_allows(address, value is not None):
            return False
        if is_flash(address):
            return self._on_flash(address, width, value)
        if value is not None:
            self.memory.write(address, value.to_bytes(width, "little"))
        return True

    def _on_flash(self, address: int, width: int, value: int | None) -> bool:
        address = _in_bank(address)
        controller: Eefc | None = self.periph.get(f"EEFC{self._bank_of(address)}")
        if controller is None:
            return value is None
        if value is not None:
            self._catch_up()
            controller.latch_store(address, width, value)
        elif not controller.readable(address):
            raise BusViolation(f"load from 0x{address:08x} while {controller.name} is busy")
        return True

    def _mpu_allows(self, address: int, write: bool) -> bool:
        if not self.mpu.control or not self.mpu.active(self.exceptions.execution_priority()):
            return True
        return self.mpu.allows(address, write, self.cpu.privileged())

    def _flash_changed(self, first: int, last: int) -> None:
        self.cpu.forget_code(first, last - first)
        if first < FLASH_START + BANK_SIZE:
            self.cpu.forget_code(first - FLASH_START, last - first)

    def _busy_changed(self, _busy: bool) -> None:
        """A bank that is busy can be neither read nor executed."""
        self._defer(self._block_banks)

    def _block_banks(self) -> None:
        for bank in (0, 1):
            controller: Eefc | None = self.periph.get(f"EEFC{bank}")
            if controller is None:
                continue
            blocked = controller.busy or controller.unique_id_shown
            if blocked == self._blocked[bank]:
                continue
            self._blocked[bank] = blocked
            permissions = UC_PROT_NONE if blocked else UC_PROT_READ | UC_PROT_EXEC
            for start in (FLASH_START, 0) if bank == 0 else (FLASH_START + BANK_SIZE,):
                self.cpu.protect(start, BANK_SIZE, permissions)
                if not blocked:
                    self.mpu.apply_again(start, BANK_SIZE)

    def _bank_of(self, address: int) -> int:
        return int(_in_bank(address) >= FLASH_START + BANK_SIZE)

    def _bank_blocked(self, address: int) -> bool:
        return is_flash(address) and self._blocked[self._bank_of(address)]

    def _located(self, error: BusViolation | Lockup) -> BusViolation | Lockup:
        where, seconds = self._where(self.cpu.pc), self.clock.now / TICKS_PER_S
        return type(error)(f"{error} (pc {where}, at {seconds:.6f} s)")


def _in_bank(address: int) -> int:
    """An address in the mirror at zero as one in bank 0 itself."""
    return address if address >= FLASH_START else address + FLASH_START
