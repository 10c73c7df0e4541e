"""A chip whose run loop, exceptions and most used peripherals are native."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import c_void_p
from typing import Any

import unicorn
from unicorn import arm_const as arm

from vboard.chip import Chip
from vboard.core.bus import Access, Bus
from vboard.core.cpu import (
    ENTRY_IDS,
    MASK_IDS,
    Cpu,
    FetchCallback,
    ProtectedCallback,
    ReadCallback,
    WriteCallback,
)
from vboard.core.engine import UcError
from vboard.core.engine import library as engine_library
from vboard.core.exceptions import Exceptions
from vboard.core.memory import RAM_SIZE, RAM_START
from vboard.core.mpu import Mpu
from vboard.native.clock import NativeClock
from vboard.native.core import Core
from vboard.native.library import (
    RUN_STOPPED,
    Ask,
    Engine,
    State,
    address_of,
    running,
)

_NONE = -1
_FUNCTIONS = (
    "emu_start",
    "emu_stop",
    "reg_read",
    "reg_write",
    "reg_read_batch",
    "reg_write_batch",
)


def _shared(name: str, kind: Callable[[Any], Any] = int) -> Any:
    """An attribute that stands in ``self._state``."""

    def get(owner: Any) -> Any:
        return kind(getattr(owner._state, name))

    def put(owner: Any, value: Any) -> None:
        setattr(owner._state, name, value)

    return property(get, put)


def _shared_or_none(name: str) -> Any:
    """The same for a number that may be missing."""

    def get(owner: Any) -> int | None:
        value = getattr(owner._state, name)
        return None if value == _NONE else value

    def put(owner: Any, value: int | None) -> None:
        setattr(owner._state, name, _NONE if value is None else value)

    return property(get, put)


def _shared_list(name: str) -> Any:
    """The same for a list of a fixed length."""

    def get(owner: Any) -> Any:
        return getattr(owner._state, name)

    def put(owner: Any, values: list[int]) -> None:
        getattr(owner._state, name)[:] = values

    return property(get, put)


class _NativeCpu(Cpu):
    """Slices are run by the native loop, which takes Unicorn's callbacks, too."""

    pc = _shared("pc")
    thumb = _shared("thumb", bool)
    executed = _shared("executed")
    address_of_fault = _shared("address_of_fault")

    def __init__(self, on_protected: ProtectedCallback, fetch: FetchCallback, core: Core) -> None:
        self._core, self._state = core, core.state
        self._watched: set[int] = set()
        super().__init__(on_protected, fetch)
        core.connect(self._table())

    def carry_out(self) -> bool:
        """Whether the instruction that Unicorn does not know is known here."""
        return self._try_to_carry_out()

    def allows(self, address: int, width: int, value: int, stores: int) -> bool:
        """An access to a page that is restricted."""
        return self._on_protected(address, width, value if stores else None)

    def map_io(self, address: int, size: int, read: ReadCallback, write: WriteCallback) -> None:
        """The peripherals, and after them the private bus; the callbacks are the native ones."""
        del read, write
        system = "system_" if address >= _PRIVATE_START else ""
        status = engine_library.uc_mmio_map(
            self._handle,
            address,
            size,
            address_of(f"vb_chip_on_{system}load"),
            self._core.handle,
            address_of(f"vb_chip_on_{system}store"),
            self._core.handle,
        )
        if status != unicorn.UC_ERR_OK:
            raise UcError(status)

    def _add_hooks(self) -> None:
        for kind, name in (
            (unicorn.UC_HOOK_INTR, "vb_chip_on_interrupt"),
            (unicorn.UC_HOOK_INSN_INVALID, "vb_chip_on_invalid_instruction"),
            (unicorn.UC_HOOK_TLB_FILL, "vb_chip_on_page"),
        ):
            self._hook(kind, address_of(name), self._core.handle)
        # A page that is watched is slow to store to, so that of RAM only what is restricted is.
        self._watch(0, RAM_START)
        self._watch(RAM_START + RAM_SIZE, 1 << 32)
        self._engine.ctl_set_tlb_mode(unicorn.UC_TLB_VIRTUAL)

    def protect(self, address: int, size: int, permissions: int) -> None:
        """As the reference; of RAM, a page is watched from the first time on."""
        in_ram = RAM_START <= address < RAM_START + RAM_SIZE
        if in_ram and address not in self._watched:
            self._watched.add(address)
            self._watch(address, address + size)
        super().protect(address, size, permissions)

    def _watch(self, start: int, end: int) -> None:
        """What is refused there is asked about."""
        asked = address_of("vb_chip_on_invalid_memory")
        self._hook(unicorn.UC_HOOK_MEM_INVALID, asked, self._core.handle, (start, end - 1))

    def _table(self) -> Engine:
        functions = {
            name: ctypes.cast(getattr(engine_library, f"uc_{name}"), c_void_p)
            for name in _FUNCTIONS
        }
        return Engine(
            **functions,
            handle=self._handle,
            begun=ctypes.addressof(self._begun),
            wanted=ctypes.addressof(self._wanted),
            entry=ENTRY_IDS,
            masks=MASK_IDS,
            pc=arm.UC_ARM_REG_PC,
            msp=arm.UC_ARM_REG_MSP,
            psp=arm.UC_ARM_REG_PSP,
            apsr=arm.UC_ARM_REG_APSR_NZCV,
            ok=unicorn.UC_ERR_OK,
            read_unmapped=unicorn.UC_ERR_READ_UNMAPPED,
            write_unmapped=unicorn.UC_ERR_WRITE_UNMAPPED,
            fetch_unmapped=unicorn.UC_ERR_FETCH_UNMAPPED,
            read_prot=unicorn.UC_ERR_READ_PROT,
            write_prot=unicorn.UC_ERR_WRITE_PROT,
            fetch_prot=unicorn.UC_ERR_FETCH_PROT,
            insn_invalid=unicorn.UC_ERR_INSN_INVALID,
            exception=unicorn.UC_ERR_EXCEPTION,
            mem_read_prot=unicorn.UC_MEM_READ_PROT,
            mem_write_prot=unicorn.UC_MEM_WRITE_PROT,
            mem_fetch=unicorn.UC_MEM_FETCH,
            prot_all=unicorn.UC_PROT_ALL,
            prot_exec=unicorn.UC_PROT_EXEC,
        )


_PRIVATE_START = 0xE0000000


class _NativeExceptions(Exceptions):
    """The reference's rules on the state that the native ones have."""

    pending = _shared("pending")
    active = _shared("active")
    enabled = _shared("enabled")
    lines = _shared("lines")
    priority = _shared_list("priority")
    group_mask = _shared("group_mask")
    vector_table = _shared("vector_table")
    ccr = _shared("ccr")
    sleep_on_exit = _shared("sleep_on_exit", bool)
    debug_monitor = _shared("debug_monitor", bool)
    cfsr = _shared("cfsr")
    hfsr = _shared("hfsr")
    mmfar = _shared("mmfar")
    bfar = _shared("bfar")
    attention = _shared("attention", bool)
    exit_to_sleep = _shared("exit_to_sleep", bool)
    taken = _shared("taken")

    def __init__(self, state: State, *others: Any) -> None:
        self._state = state
        super().__init__(*others)


class _NativeMpu(Mpu):
    """Its regions are known to the native exceptions."""

    control = _shared("mpu_control")
    base = _shared_list("mpu_base")
    attributes = _shared_list("mpu_attributes")

    def __init__(self, state: State, *others: Any) -> None:
        self._state = state
        super().__init__(*others)


class _NativeBus(Bus):
    """While there is a trace, all accesses come here."""

    def __init__(self, state: State, clock: NativeClock) -> None:
        self._state, self._time = state, clock.shared.fields
        self._trace: list[Access] | None = None
        super().__init__(clock)

    def read(self, address: int, width: int) -> int:
        """A load by the processor, which C answers itself as long as nothing happens."""
        value = super().read(address, width)
        if self._trace is None and self._find(address, width, "load from").steady(address, value):
            self._time.steady_value, self._time.steady_at = value, address
        return value

    @property
    def trace(self) -> list[Access] | None:
        """Accesses are collected here."""
        return self._trace

    @trace.setter
    def trace(self, trace: list[Access] | None) -> None:
        self._trace = trace
        self._state.tracing = trace is not None


class NativeChip(Chip):
    """``core``: what it shares with C."""

    core: Core
    off = _shared("off", bool)
    instructions = _shared("instructions")
    _idle_ticks = _shared("idle_ticks")
    _asleep_since = _shared_or_none("asleep_since")
    _sleeping = _shared("sleeping", bool)
    _masked_steps = _shared("masked_steps")
    _reset_cause = _shared_or_none("reset_cause")
    _cost = _shared("cost")
    _slice_start = _shared("slice_start")
    _slice_end = _shared("slice_end")
    _blocked = _shared_list("blocked")

    def power_off(self) -> None:
        """The supply is gone at this very instant."""
        super().power_off()
        self.core.drop()

    def _prepare(self) -> None:
        assert isinstance(self.clock, NativeClock)
        self.core = Core(self.clock, self.memory.flash, self.memory.ram, self._calls())
        self._state = self.core.state

    def _calls(self) -> dict[str, Callable[..., Any]]:
        """What C calls; by name, since most of it comes to be later."""
        return {
            "load": lambda address, width: self.bus.read(address, width),
            "store": lambda address, width, value: self.bus.write(address, width, value),
            "load_system": lambda address, width: self.nvic.read(address, width),
            "store_system": lambda address, width, value: self.nvic.write(address, width, value),
            "protected_page": lambda *access: self._native_cpu.allows(*access),
            "invalid_instruction": lambda: self._native_cpu.carry_out(),
            "served_breakpoint": self._served_breakpoint,
            "divided": self._divided,
            "restricts": lambda address: self.mpu.restricts(address),
            "run_deferred": self._run_deferred,
            "reset": self._reset,
        }

    def _new_cpu(self) -> Cpu:
        self._native_cpu = _NativeCpu(self._on_protected, self.memory.read, self.core)
        return self._native_cpu

    def _new_mpu(self, spans: list[tuple[int, int, int]]) -> Mpu:
        return _NativeMpu(self._state, self.cpu.protect, spans, self._mpu_changed)

    def _new_exceptions(self) -> Exceptions:
        return _NativeExceptions(self._state, self.cpu, self.memory, self.mpu, self._spend)

    def _new_bus(self) -> Bus:
        assert isinstance(self.clock, NativeClock)
        return _NativeBus(self._state, self.clock)

    def _wire(self) -> None:
        super()._wire()
        if "PMC" in self.periph:
            self.core.follow(self.periph["PMC"])

    def _run(self, tick: int, stop: Callable[[], bool] | None) -> bool:
        asks = None if stop is None else Ask(self.core.time.guard(stop, True))
        asked = None if asks is None else ctypes.cast(asks, c_void_p)
        end = running.vb_chip_run(self.core.handle, tick, asked)
        self.core.time.check()
        return bool(end == RUN_STOPPED)

    def _defer(self, action: Callable[[], None]) -> None:
        super()._defer(action)
        self._state.deferred = 1

    def _run_deferred(self) -> None:
        while self._deferred:
            self._deferred.pop(0)()
        self._state.deferred = 0
