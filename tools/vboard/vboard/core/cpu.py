"""The Cortex-M3 as Unicorn runs it: instructions only, in slices of a known length.

Unicorn knows nothing of exceptions, SysTick or memory protection of the M profile; those are in
exceptions.py and its neighbours. A slice ends after its number of instructions or at whatever
needs them, and says which.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

from unicorn import (
    UC_ARCH_ARM,
    UC_CTL_IO_WRITE,
    UC_CTL_TLB_FLUSH,
    UC_ERR_FETCH_PROT,
    UC_ERR_FETCH_UNMAPPED,
    UC_ERR_INSN_INVALID,
    UC_ERR_OK,
    UC_ERR_READ_PROT,
    UC_ERR_READ_UNMAPPED,
    UC_ERR_WRITE_PROT,
    UC_ERR_WRITE_UNMAPPED,
    UC_HOOK_INSN_INVALID,
    UC_HOOK_INTR,
    UC_HOOK_MEM_INVALID,
    UC_MEM_READ_PROT,
    UC_MEM_WRITE_PROT,
    UC_MODE_THUMB,
    UC_PROT_ALL,
)
from unicorn import arm_const as arm

from vboard.core import division
from vboard.core.bus import BusViolation
from vboard.core.counter import COUNTER_OFFSET, engine_address
from vboard.core.division import Division
from vboard.core.engine import (
    InterruptHook,
    InvalidInstructionHook,
    InvalidMemoryHook,
    IoRead,
    IoWrite,
    Uc,
    UcError,
    library,
)

XPSR_THUMB = 1 << 24
XPSR_EXCEPTION = 0x1FF
CONTROL_SPSEL = 2
_XPSR_IT = 0x0600FC00

_NEVER = 0xFFFFFFFE
_EVERYWHERE = (1, 0)  # as Unicorn says it
_WFE, _YIELD = 0xBF20, 0xBF10
_INTR_SVC, _INTR_PREFETCH_ABORT, _INTR_BREAKPOINT = 2, 3, 7
_INTR_EXCEPTION_EXIT, _INTR_NO_COPROCESSOR, _INTR_INVALID_STATE = 8, 17, 18


class Stop(Enum):
    """Why a slice ended."""

    COUNT = auto()
    SLEEP = auto()
    EXCEPTION_RETURN = auto()
    SVC = auto()
    BREAKPOINT = auto()
    UNDEFINED = auto()
    NO_COPROCESSOR = auto()
    INVALID_STATE = auto()
    BUS_DATA = auto()
    BUS_FETCH = auto()
    PROTECTED_DATA = auto()
    PROTECTED_FETCH = auto()


_OF_INTR = {
    _INTR_SVC: Stop.SVC,
    _INTR_PREFETCH_ABORT: Stop.PROTECTED_FETCH,
    _INTR_BREAKPOINT: Stop.BREAKPOINT,
    _INTR_EXCEPTION_EXIT: Stop.EXCEPTION_RETURN,
    _INTR_NO_COPROCESSOR: Stop.NO_COPROCESSOR,
    _INTR_INVALID_STATE: Stop.INVALID_STATE,
}
_OF_ERROR = {
    UC_ERR_READ_UNMAPPED: Stop.BUS_DATA,
    UC_ERR_WRITE_UNMAPPED: Stop.BUS_DATA,
    UC_ERR_FETCH_UNMAPPED: Stop.BUS_FETCH,
    UC_ERR_READ_PROT: Stop.PROTECTED_DATA,
    UC_ERR_WRITE_PROT: Stop.PROTECTED_DATA,
    UC_ERR_FETCH_PROT: Stop.PROTECTED_FETCH,
    UC_ERR_INSN_INVALID: Stop.UNDEFINED,
}


@dataclass
class Registers:
    """What exception entry and return deal with. ``sp`` is the stack in use."""

    r0: int = 0
    r1: int = 0
    r2: int = 0
    r3: int = 0
    r12: int = 0
    lr: int = 0
    xpsr: int = 0
    sp: int = 0
    control: int = 0


ENTRY_IDS = (
    arm.UC_ARM_REG_R0,
    arm.UC_ARM_REG_R1,
    arm.UC_ARM_REG_R2,
    arm.UC_ARM_REG_R3,
    arm.UC_ARM_REG_R12,
    arm.UC_ARM_REG_LR,
    arm.UC_ARM_REG_XPSR,
    arm.UC_ARM_REG_SP,
    arm.UC_ARM_REG_CONTROL,
)
_GENERAL_IDS = (
    *(getattr(arm, f"UC_ARM_REG_R{number}") for number in range(13)),
    arm.UC_ARM_REG_SP,
    arm.UC_ARM_REG_LR,
)
_CALLER_SAVED_IDS = ENTRY_IDS[:6]
MASK_IDS = (arm.UC_ARM_REG_PRIMASK, arm.UC_ARM_REG_BASEPRI, arm.UC_ARM_REG_FAULTMASK)


class _Batch:
    """Several registers in one call; a tenth of the time of the package's own way."""

    def __init__(self, engine: Any, ids: tuple[int, ...]) -> None:
        self._handle = engine._uch
        self._ids = (ctypes.c_int32 * len(ids))(*ids)
        self._values = (ctypes.c_uint32 * len(ids))()
        base = ctypes.addressof(self._values)
        self._pointers = (ctypes.c_void_p * len(ids))(*(base + 4 * i for i in range(len(ids))))
        self._count = len(ids)

    def read(self) -> list[int]:
        library.uc_reg_read_batch(self._handle, self._ids, self._pointers, self._count)
        return self._values[:]

    def write(self, values: tuple[int, ...]) -> None:
        self._values[:] = list(values)
        library.uc_reg_write_batch(self._handle, self._ids, self._pointers, self._count)


ReadCallback = Callable[[int, int], int]
WriteCallback = Callable[[int, int, int], None]
FetchCallback = Callable[[int, int], bytes]
ProtectedCallback = Callable[[int, int, int | None], bool]


class Cpu:
    """Registers, memory map and slices.

    ``on_protected(address, width, value)`` is asked when the image touches a page that protect()
    restricts: False makes it a fault. True lets a load (value None) through and passes over a
    store, which then is the callee's to do. ``fetch(address, length)`` reads code or raises.
    ``address_of_fault`` belongs to the last BUS_DATA or
    PROTECTED_DATA.
    """

    def __init__(self, on_protected: ProtectedCallback, fetch: FetchCallback) -> None:
        self._engine = Uc(UC_ARCH_ARM, UC_MODE_THUMB)
        # UC_MODE_MCLASS would silently make it a Cortex-M33, whatever the model.
        self._engine.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M3)
        self._handle = self._engine._uch
        base = engine_address(self._engine) + COUNTER_OFFSET
        self._begun = ctypes.c_uint64.from_address(base)
        self._wanted = ctypes.c_uint64.from_address(base + 8)
        self._on_protected, self._fetch = on_protected, fetch
        self._keep: list[object] = []
        self._intr = 0
        self._failure: BaseException | None = None
        self._divides = False
        self._entry = _Batch(self._engine, ENTRY_IDS)
        self._caller_saved = _Batch(self._engine, _CALLER_SAVED_IDS)
        self._masks = _Batch(self._engine, MASK_IDS)
        self._word = ctypes.c_uint32()
        self._word_pointer = ctypes.byref(self._word)
        self.pc = 0
        self.thumb = True
        self.executed = 0
        self.address_of_fault = 0
        self._add_hooks()

    def map(self, address: int, size: int, host_address: int, permissions: int) -> None:
        """Shows memory of the host at ``address``; the caller keeps it alive.

        What is mapped as not writable would take a store that on_protected lets through; what is
        made so afterwards does not.
        """
        self._engine.mem_map_ptr(address, size, UC_PROT_ALL, host_address)
        if permissions != UC_PROT_ALL:
            self._engine.mem_protect(address, size, permissions)

    def map_io(self, address: int, size: int, read: ReadCallback, write: WriteCallback) -> None:
        """Peripherals: read(address, width), write(address, width, value).

        An exception out of them ends the slice on the very instruction and comes out of run().
        """

        def on_read(_engine: object, offset: int, width: int, _data: object) -> int:
            try:
                return read(address + offset, width)
            except BaseException as error:
                self._fail(error)
                return 0

        def on_write(_engine: object, offset: int, width: int, value: int, _data: object) -> None:
            try:
                write(address + offset, width, value)
            except BaseException as error:
                self._fail(error)

        callbacks = IoRead(on_read), IoWrite(on_write)
        self._keep.append(callbacks)
        status = library.uc_mmio_map(self._handle, address, size, callbacks[0], 0, callbacks[1], 0)
        if status != UC_ERR_OK:
            raise UcError(status)

    def close(self) -> None:
        """Gives the engine back, some megabytes; nothing may be asked of it afterwards."""
        self._engine._Uc__finalizer()
        self._keep.clear()

    def protect(self, address: int, size: int, permissions: int) -> None:
        """Restricts whole pages of 4096 bytes; what they then refuse goes to on_protected.

        Not during run().
        """
        self._engine.mem_protect(address, size, permissions)
        self.forget_permissions()

    def forget_permissions(self) -> None:
        """Once asked about, a page is open to all further loads, until this."""
        self._engine.ctl(UC_CTL_TLB_FLUSH, UC_CTL_IO_WRITE)

    def forget_code(self, address: int, size: int) -> None:
        """Memory was changed from outside: translations of it are no longer true."""
        self._engine.ctl_remove_cache(address, address + size)

    def run(self, count: int) -> Stop:
        """Runs up to ``count`` instructions from ``pc``; ``executed`` tells how many it was.

        An instruction that faults counts. Afterwards ``pc`` is on the instruction for faults and
        BREAKPOINT, behind it for SVC and SLEEP.
        """
        self._intr = 0
        start = self.pc | 1 if self.thumb else self.pc
        error = library.uc_emu_start(self._handle, start, _NEVER, 0, count)
        self.pc = self._read_register(arm.UC_ARM_REG_PC)
        self.executed = self._begun.value
        self._raise_failure()
        if error != UC_ERR_OK:
            return self._stop_of_error(error)
        if self._intr:
            return self._stop_of_intr(self._intr)
        if self.executed > self._wanted.value:
            self.executed -= 1
            return Stop.COUNT
        return Stop.SLEEP

    def begun(self) -> int:
        """During run(): instructions before the present one."""
        return self._begun.value - 1

    def end_slice(self) -> None:
        """During run(): this instruction is the last (an IT block is completed first)."""
        self._wanted.value = self._begun.value

    def shorten_slice(self, count: int) -> None:
        """During run(): at most ``count`` instructions in all, the present one included."""
        begun = self._begun.value
        self._wanted.value = max(begun, min(count, self._wanted.value))

    def registers(self) -> Registers:
        """Those of exception entry."""
        return Registers(*self._entry.read())

    def masks(self) -> list[int]:
        """PRIMASK, BASEPRI, FAULTMASK."""
        return self._masks.read()

    def clear_faultmask(self) -> None:
        """As each exception return but NMI's does."""
        self._write_register(arm.UC_ARM_REG_FAULTMASK, 0)

    def exception_number(self) -> int:
        """IPSR."""
        return self._read_register(arm.UC_ARM_REG_XPSR) & XPSR_EXCEPTION

    def stack_pointer(self, process: bool) -> int:
        """PSP or MSP, whichever is in use."""
        return self._read_register(arm.UC_ARM_REG_PSP if process else arm.UC_ARM_REG_MSP)

    def privileged(self) -> bool:
        """Handler mode, or thread mode with CONTROL.nPRIV = 0."""
        if self._read_register(arm.UC_ARM_REG_CONTROL) & 1 == 0:
            return True
        return self.exception_number() != 0

    def general_registers(self) -> list[int]:
        """R0 to R12, SP, LR, PC."""
        return [self._read_register(name) for name in _GENERAL_IDS] + [self.pc]

    def read_general(self, number: int) -> int:
        """R0 to R12, 13 SP, 14 LR."""
        return self._read_register(_GENERAL_IDS[number])

    def write_general(self, number: int, value: int) -> None:
        """R0 to R12, 13 SP, 14 LR."""
        self._write_register(_GENERAL_IDS[number], value & 0xFFFFFFFF)

    def skip(self, width: int) -> None:
        """Goes on behind an instruction of ``width`` bytes that was carried out from outside."""
        self.pc += width
        xpsr = self._read_register(arm.UC_ARM_REG_XPSR)
        state = xpsr >> 8 & 0xFC | xpsr >> 25 & 3
        if state:
            state = state & 0xE0 | state << 1 & 0x1F if state & 7 else 0
            self._write_xpsr(xpsr & ~_XPSR_IT | (state & 0xFC) << 8 | (state & 3) << 25)

    def trap_division(self, on: bool) -> None:
        """Divisions by zero end the slice as UNDEFINED, or not; not during run().

        Any division in an IT block does, too: divide_here() then.
        """
        self._divides = division.trap(self._engine, on) and on

    def divide_here(self) -> Division:
        """After UNDEFINED: does the division at pc, if it is one and not by zero."""
        outcome = division.divide(self, self._fetch(self.pc, division.INSTRUCTION_BYTES))
        if outcome is Division.DONE:
            self.skip(division.INSTRUCTION_BYTES)
        return outcome

    def reset(self, stack: int, vector: int) -> None:
        """Thread mode, privileged, nothing masked, LR = 0xFFFFFFFF."""
        self._write_xpsr(XPSR_THUMB)
        self._masks.write((0, 0, 0))
        self._write_register(arm.UC_ARM_REG_CONTROL, 0)
        self._write_register(arm.UC_ARM_REG_MSP, stack & ~3)
        self._write_register(arm.UC_ARM_REG_SP, stack & ~3)
        self._write_register(arm.UC_ARM_REG_LR, 0xFFFFFFFF)
        self._jump(vector)

    def enter_handler(
        self, before: Registers, frame: int, number: int, exc_return: int, vector: int
    ) -> None:
        """Leaves the interrupted stack at ``frame`` and goes to the vector in handler mode."""
        self._write_register(arm.UC_ARM_REG_SP, frame)
        if before.control & CONTROL_SPSEL:
            self._write_register(arm.UC_ARM_REG_CONTROL, before.control & ~CONTROL_SPSEL)
        self.chain_handler(number, exc_return, vector)

    def chain_handler(self, number: int, exc_return: int, vector: int) -> None:
        """From handler to handler without a new frame."""
        flags = self._read_register(arm.UC_ARM_REG_XPSR) & 0xF8000000
        self._write_xpsr(flags | (XPSR_THUMB if vector & 1 else 0) | number)
        self._write_register(arm.UC_ARM_REG_LR, exc_return)
        self._jump(vector)

    def leave_handler(self, frame: tuple[int, ...], stack: int, process: bool) -> None:
        """Restores the eight words of a frame; the stack it was on continues at ``stack``."""
        *caller_saved, address, xpsr = frame
        self._write_xpsr(xpsr & ~(1 << 9))
        if xpsr & XPSR_EXCEPTION == 0:
            control = self._read_register(arm.UC_ARM_REG_CONTROL) & ~CONTROL_SPSEL
            self._write_register(arm.UC_ARM_REG_CONTROL, control | (CONTROL_SPSEL * process))
        self._write_register(arm.UC_ARM_REG_SP, stack)
        self._caller_saved.write(tuple(caller_saved))
        self.pc, self.thumb = address & ~1, bool(xpsr & XPSR_THUMB)

    def _raise_failure(self) -> None:
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise failure

    def _jump(self, vector: int) -> None:
        self.pc, self.thumb = vector & ~1, bool(vector & 1)

    def _write_xpsr(self, value: int) -> None:
        """Writing the flags too makes the translator see the new mode."""
        self._write_register(arm.UC_ARM_REG_XPSR, value)
        self._write_register(arm.UC_ARM_REG_APSR_NZCV, value & 0xF0000000)

    def _read_register(self, name: int) -> int:
        library.uc_reg_read(self._handle, name, self._word_pointer)
        return self._word.value

    def _write_register(self, name: int, value: int) -> None:
        self._word.value = value
        library.uc_reg_write(self._handle, name, self._word_pointer)

    def _stop_of_intr(self, number: int) -> Stop:
        if self.pc & ~0xF == 0xFFFFFFF0:
            return Stop.EXCEPTION_RETURN
        if number not in _OF_INTR:
            raise RuntimeError(f"unicorn: interrupt {number} at 0x{self.pc:08x}")
        return _OF_INTR[number]

    def _stop_of_error(self, error: int) -> Stop:
        if error not in _OF_ERROR:
            raise UcError(error)
        if error == UC_ERR_INSN_INVALID:
            self.thumb = bool(self._read_register(arm.UC_ARM_REG_XPSR) & XPSR_THUMB)
            if not self.thumb:
                return Stop.INVALID_STATE
        return _OF_ERROR[error]

    def _try_to_carry_out(self) -> bool:
        try:
            return self._carry_out(self._read_register(arm.UC_ARM_REG_PC))
        except BusViolation:
            return False

    def _carry_out(self, pc: int) -> bool:
        """Whether what Unicorn does not know is known here. With a hint, pc is behind it."""
        code = self._fetch(pc - 2, 6)
        if int.from_bytes(code[:2], "little") in (_WFE, _YIELD):
            return True
        if not self._divides or self._read_register(arm.UC_ARM_REG_XPSR) & _XPSR_IT:
            return False
        if division.divide(self, code[2:]) is not Division.DONE:
            return False
        self._write_register(arm.UC_ARM_REG_PC, pc + division.INSTRUCTION_BYTES | 1)
        return True

    def _go_on(self) -> None:
        """After an access that is no fault after all. Unicorn has put the rest of the IT block into
        XPSR, where the code that goes on does not expect it."""
        xpsr = self._read_register(arm.UC_ARM_REG_XPSR)
        if xpsr & _XPSR_IT:
            self._write_register(arm.UC_ARM_REG_XPSR, xpsr & ~_XPSR_IT)

    def _fail(self, error: BaseException) -> None:
        """Here, and only here, stopping at once is right: the access is not to be repeated."""
        self._failure = self._failure or error
        library.uc_emu_stop(self._handle)

    def _add_hooks(self) -> None:
        def on_intr(_engine: object, number: int, _data: object) -> None:
            self._intr = number
            library.uc_emu_stop(self._handle)

        def on_invalid_instruction(_engine: object, _data: object) -> bool:
            return self._try_to_carry_out()

        def on_invalid_memory(
            _engine: object, kind: int, address: int, width: int, value: int, _data: object
        ) -> bool:
            address &= 0xFFFFFFFF
            self.address_of_fault = address
            if kind not in (UC_MEM_WRITE_PROT, UC_MEM_READ_PROT):
                return False
            stored = value & ((1 << 8 * width) - 1) if kind == UC_MEM_WRITE_PROT else None
            try:
                passes = self._on_protected(address, width, stored)
            except BaseException as error:
                self._fail(error)
                return False
            if passes:
                self._go_on()
            return passes

        self._hook(UC_HOOK_INTR, InterruptHook(on_intr))
        self._hook(UC_HOOK_INSN_INVALID, InvalidInstructionHook(on_invalid_instruction))
        self._hook(UC_HOOK_MEM_INVALID, InvalidMemoryHook(on_invalid_memory))

    def _hook(
        self, kind: int, callback: object, data: object = 0, span: tuple[int, int] = _EVERYWHERE
    ) -> None:
        """``span``: first and last address of the accesses in question."""
        handle = ctypes.c_size_t()
        self._keep.append(callback)
        begin, end = map(ctypes.c_uint64, span)
        status = library.uc_hook_add(
            self._handle, ctypes.byref(handle), kind, callback, data, begin, end
        )
        if status != UC_ERR_OK:
            raise UcError(status)
