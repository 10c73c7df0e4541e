"""Exceptions of the Cortex-M3: what is pending, what is active, entry, return and faults.

ARMv7-M Architecture Reference Manual, B1.5. Not modelled: late arrival (an exception that comes
during entry waits for its first instruction), imprecise faults, faults of unaligned LDM and LDRD,
the exclusive monitor's clearing at entry, debug.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from vboard.core.cpu import CONTROL_SPSEL, XPSR_EXCEPTION, Cpu, Stop
from vboard.core.memory import Memory
from vboard.core.mpu import Mpu

NMI, HARD_FAULT, MEM_MANAGE, BUS_FAULT, USAGE_FAULT = 2, 3, 4, 5, 6
SVCALL, DEBUG_MONITOR, PENDSV, SYSTICK = 11, 12, 14, 15
FIRST_IRQ, IRQ_COUNT = 16, 45
EXCEPTION_COUNT = FIRST_IRQ + IRQ_COUNT

IACCVIOL, DACCVIOL, MUNSTKERR, MSTKERR, MMARVALID = 1 << 0, 1 << 1, 1 << 3, 1 << 4, 1 << 7
IBUSERR, PRECISERR, UNSTKERR, STKERR, BFARVALID = 1 << 8, 1 << 9, 1 << 11, 1 << 12, 1 << 15
UNDEFINSTR, INVSTATE, INVPC, NOCP = 1 << 16, 1 << 17, 1 << 18, 1 << 19
DIVBYZERO = 1 << 25
HFSR_VECTTBL, HFSR_FORCED, HFSR_DEBUGEVT = 1 << 1, 1 << 30, 1 << 31

CCR_NONBASETHRDENA, CCR_DIV_0_TRP, CCR_STKALIGN = 1 << 0, 1 << 4, 1 << 9
NO_PRIORITY = 256

# Cortex-M3 Technical Reference Manual, zero wait states; the flash adds to them on the chip.
ENTRY_CYCLES, RETURN_CYCLES, CHAIN_CYCLES = 12, 10, 6

_FRAME = struct.Struct("<8I")
_FAULT_OF_STOP = {
    Stop.UNDEFINED: UNDEFINSTR,
    Stop.INVALID_STATE: INVSTATE,
    Stop.NO_COPROCESSOR: NOCP,
}


class Lockup(Exception):
    """A fault where no handler can run any more; the chip would stand still until a reset."""


class Exceptions:
    """State and rules; nvic.py gives it registers. Numbers are exception numbers, IRQ n = 16 + n.

    ``attention`` is set whenever it may have become time to do something; the run loop clears it.
    ``spend(cycles)`` is called for the time that entry and return take.
    """

    def __init__(self, cpu: Cpu, memory: Memory, mpu: Mpu, spend: Callable[[int], None]) -> None:
        self.cpu, self.memory, self.mpu, self._spend = cpu, memory, mpu, spend
        self.taken = 0
        self.reset()

    def reset(self) -> None:
        """Nothing pending, nothing active, all interrupts off; lines keep their level."""
        self.pending = self.active = 0
        self.enabled = ~(1 << MEM_MANAGE | 1 << BUS_FAULT | 1 << USAGE_FAULT)
        self.enabled &= (1 << FIRST_IRQ) - 1
        self.lines = getattr(self, "lines", 0)
        self.priority = [0] * EXCEPTION_COUNT
        self.priority[NMI], self.priority[HARD_FAULT] = -2, -1
        self.group_mask = 0xFE
        self.vector_table = 0
        self.ccr = CCR_STKALIGN
        self.sleep_on_exit = False
        self.debug_monitor = False
        self.cfsr = self.hfsr = self.mmfar = self.bfar = 0
        self.attention = True
        self.exit_to_sleep = False

    # Pending and priorities.

    def set_line(self, irq: int, level: bool) -> None:
        """Drives an interrupt line: a rising one pends, a high one pends again after return."""
        bit = 1 << (FIRST_IRQ + irq)
        if level and not self.lines & bit:
            self.pend(FIRST_IRQ + irq)
        self.lines = self.lines | bit if level else self.lines & ~bit

    def pend(self, number: int) -> None:
        """Makes an exception pending."""
        self.pending |= 1 << number
        self.attention = True

    def unpend(self, number: int) -> None:
        """Takes it back; a line that is still high pends it again unless it is active."""
        bit = 1 << number
        if not self.lines & ~self.active & bit:
            self.pending &= ~bit

    def best_pending(self) -> int | None:
        """The pending and enabled exception that is to come next."""
        candidates = self.pending & self.enabled
        if not candidates:
            return None
        numbers = []
        while candidates:
            lowest = candidates & -candidates
            numbers.append(lowest.bit_length() - 1)
            candidates ^= lowest
        return min(numbers, key=lambda number: (self.priority[number], number))

    def group_priority(self, number: int) -> int:
        """Priority for preemption."""
        priority = self.priority[number]
        return priority if priority < 0 else priority & self.group_mask

    def active_priority(self) -> int:
        """Of what is active, masks left out."""
        best, active = NO_PRIORITY, self.active
        while active:
            lowest = active & -active
            best = min(best, self.group_priority(lowest.bit_length() - 1))
            active ^= lowest
        return best

    def execution_priority(self) -> int:
        """What a pending exception must beat to be taken."""
        primask, basepri, faultmask = self.cpu.masks()
        priority = self._above_basepri(basepri)
        if primask & 1:
            priority = min(priority, 0)
        return min(priority, -1) if faultmask & 1 else priority

    def _above_basepri(self, basepri: int) -> int:
        priority = self.active_priority()
        basepri &= 0xF0
        return min(priority, basepri & self.group_mask) if basepri else priority

    def wakes(self) -> bool:
        """Whether WFI would end now; PRIMASK does not count."""
        number = self.best_pending()
        if number is None:
            return False
        _, basepri, faultmask = self.cpu.masks()
        priority = -1 if faultmask & 1 else self._above_basepri(basepri)
        return self.group_priority(number) < priority

    def dispatch(self) -> bool:
        """Takes the best pending exception if its time has come.

        True: something is held back by PRIMASK, BASEPRI or FAULTMASK alone, so that it may become
        due at any instruction.
        """
        number = self.best_pending()
        if number is None:
            return False
        priority = self.group_priority(number)
        if priority >= self.active_priority():
            return False
        if priority >= self.execution_priority():
            return True
        self._enter()
        return False

    # Faults and calls out of the instructions.

    def handle(self, stop: Stop) -> None:
        """What ended a slice, as the exception that it is."""
        if stop is Stop.EXCEPTION_RETURN:
            self._return(self.cpu.pc | 1)
        elif stop is Stop.SVC:
            self._raise(SVCALL)
        elif stop is Stop.BREAKPOINT:
            self._breakpoint()
        elif stop in _FAULT_OF_STOP:
            self.usage_fault(_FAULT_OF_STOP[stop])
        elif stop in (Stop.BUS_DATA, Stop.BUS_FETCH):
            self._bus_fault(stop is Stop.BUS_DATA)
        elif stop in (Stop.PROTECTED_DATA, Stop.PROTECTED_FETCH):
            self._protection_fault(stop is Stop.PROTECTED_DATA)

    def usage_fault(self, cause: int) -> None:
        """UsageFault for the instruction at pc."""
        self.cfsr |= cause
        self._raise(USAGE_FAULT)

    def _bus_fault(self, data: bool) -> None:
        if data:
            self.cfsr |= PRECISERR | BFARVALID
            self.bfar = self.cpu.address_of_fault
        else:
            self.cfsr |= IBUSERR
        self._raise(BUS_FAULT)

    def _protection_fault(self, data: bool) -> None:
        address = self.cpu.address_of_fault
        if data and self.memory.find(address, 1) and not self.mpu.restricts(address):
            self._bus_fault(data)
            return
        if data:
            self.cfsr |= DACCVIOL | MMARVALID
            self.mmfar = address
        else:
            self.cfsr |= IACCVIOL
        self._raise(MEM_MANAGE)

    def _breakpoint(self) -> None:
        if self.debug_monitor and self.group_priority(DEBUG_MONITOR) < self.execution_priority():
            self._raise(DEBUG_MONITOR)
            return
        self.hfsr |= HFSR_DEBUGEVT
        self._pend_hard_fault("BKPT")
        self._enter()

    def _raise(self, number: int) -> None:
        """A synchronous exception: taken now, or HardFault in its place."""
        self._pend_synchronous(number, self.execution_priority())
        self._enter()

    def _pend_synchronous(self, number: int, running: int) -> None:
        if self.group_priority(number) < running and self.enabled & 1 << number:
            self.pend(number)
            return
        self.hfsr |= HFSR_FORCED
        self._pend_hard_fault(f"exception {number}", running)

    def _pend_hard_fault(self, what: str, running: int | None = None) -> None:
        priority = self.execution_priority() if running is None else running
        if priority <= -1:
            raise Lockup(
                f"{what} at HardFault priority (CFSR 0x{self.cfsr:08x}, HFSR 0x{self.hfsr:08x}, "
                f"BFAR 0x{self.bfar:08x}, MMFAR 0x{self.mmfar:08x})"
            )
        self.pend(HARD_FAULT)

    # Entry and return.

    def _enter(self, exc_return: int | None = None) -> None:
        """Stacks a frame, takes the best pending exception; ``exc_return``, if given, is its LR."""
        cpu = self.cpu
        before = cpu.registers()
        process = not before.xpsr & XPSR_EXCEPTION and bool(before.control & CONTROL_SPSEL)
        odd = before.sp & 4 if self.ccr & CCR_STKALIGN else 0
        frame = (before.sp - 32 - odd) & 0xFFFFFFFC
        if exc_return is None:
            exc_return = _exc_return(before.xpsr, process)
        stacked = before.xpsr & ~(1 << 9) | (1 << 9 if odd else 0)
        words = (before.r0, before.r1, before.r2, before.r3, before.r12, before.lr, cpu.pc, stacked)
        self._stack(frame, words)
        number, vector = self._take()
        cpu.enter_handler(before, frame, number, exc_return, vector)
        self._spend(ENTRY_CYCLES)

    def _stack(self, frame: int, words: tuple[int, ...]) -> None:
        place = self.memory.find(frame, 32)
        running = self.execution_priority()
        if place is None or place[0] is not self.memory.ram:
            self.cfsr |= STKERR
            self._pend_derived(BUS_FAULT, running)
        elif not self._may_stack(frame, running, write=True):
            self.cfsr |= MSTKERR
            self._pend_derived(MEM_MANAGE, running)
        else:
            _FRAME.pack_into(self.memory.ram, place[1], *words)

    def _pend_derived(self, number: int, running: int) -> None:
        """A fault of the stacking itself; entry goes on with whatever is then the best."""
        self._pend_synchronous(number, running)

    def _may_stack(self, frame: int, running: int, write: bool) -> bool:
        if not self.mpu.active(running):
            return True
        privileged = self.cpu.privileged()
        return all(
            self.mpu.allows(address, write, privileged) for address in range(frame, frame + 32, 4)
        )

    def _take(self) -> tuple[int, int]:
        """Makes the best pending exception the active one: (number, vector)."""
        number = self.best_pending()
        assert number is not None
        place = self.memory.find((self.vector_table + 4 * number) & 0xFFFFFFFC, 4)
        if place is None:
            self.hfsr |= HFSR_VECTTBL
            raise Lockup(f"no vector for exception {number}: VTOR 0x{self.vector_table:08x}")
        self.pending &= ~(1 << number)
        self.active |= 1 << number
        self.taken += 1
        return number, int.from_bytes(place[0][place[1] : place[1] + 4], "little")

    def _return(self, exc_return: int) -> None:
        cpu = self.cpu
        number = cpu.exception_number()
        if number == 0:
            cpu.pc &= ~1
            self._protection_fault(data=False)
            return
        if number != NMI:
            cpu.clear_faultmask()
        alone = self.active == 1 << number
        legal = bool(self.active & 1 << number) and exc_return & 0xF in (0x1, 0x9, 0xD)
        if exc_return & 8 and not alone and not self.ccr & CCR_NONBASETHRDENA:
            legal = False
        self.active &= ~(1 << number)
        self.pending |= self.lines & 1 << number
        self.attention = True
        if not legal:
            self.cfsr |= INVPC
            self._pend_synchronous(USAGE_FAULT, self.execution_priority())
            self._chain(exc_return)
            return
        if not self._chain_if_due(exc_return):
            self._unstack(exc_return)

    def _chain_if_due(self, exc_return: int) -> bool:
        number = self.best_pending()
        if number is None or self.group_priority(number) >= self.execution_priority():
            return False
        self._chain(exc_return)
        return True

    def _chain(self, exc_return: int) -> None:
        number, vector = self._take()
        self.cpu.chain_handler(number, exc_return, vector)
        self._spend(CHAIN_CYCLES)

    def _unstack(self, exc_return: int) -> None:
        cpu, process = self.cpu, exc_return & 0xF == 0xD
        stack = cpu.stack_pointer(process)
        place = self.memory.find(stack, 32)
        running = self.execution_priority()
        if place is None or not self._may_stack(stack, running, write=False):
            self.cfsr |= UNSTKERR if place is None else MUNSTKERR
            self._pend_synchronous(BUS_FAULT if place is None else MEM_MANAGE, running)
            self._chain(exc_return)
            return
        words = _FRAME.unpack_from(place[0], place[1])
        xpsr = words[7]
        after = stack + 32
        if xpsr & 1 << 9 and self.ccr & CCR_STKALIGN:
            after |= 4
        cpu.leave_handler(words, after, process)
        self._spend(RETURN_CYCLES)
        if bool(xpsr & XPSR_EXCEPTION) != (exc_return & 0xF == 0x1):
            self.cfsr |= INVPC
            self._pend_synchronous(USAGE_FAULT, self.execution_priority())
            self._enter(exc_return)
            return
        self.exit_to_sleep = self.sleep_on_exit and not xpsr & XPSR_EXCEPTION


def _exc_return(xpsr: int, process: bool) -> int:
    if xpsr & XPSR_EXCEPTION:
        return 0xFFFFFFF1
    return 0xFFFFFFFD if process else 0xFFFFFFF9
