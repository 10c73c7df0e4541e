"""Division by zero as a trap (CCR.DIV_0_TRP), which Unicorn does not have.

The engine is told that its Cortex-M3 has no divide instructions; it then reports each one as
undefined, and the division is done here. What tells it is the divide field of ID_ISAR0, a private
field that is found by the known values of its neighbours. Looking for it needs reads that may fail
without harm, which is /proc/self/mem: elsewhere than on Linux nothing is trapped.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import struct
from collections.abc import Iterator
from enum import Enum, auto
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unicorn import UC_ARCH_ARM, UC_MODE_THUMB
from unicorn.arm_const import UC_CPU_ARM_CORTEX_M3

from vboard.core.counter import engine_address
from vboard.core.engine import Uc

if TYPE_CHECKING:
    from vboard.core.cpu import Cpu

# ID_ISAR0 to 4 of the Cortex-M3 as QEMU has them.
_ISAR = struct.pack("<5I", 0x01141110, 0x02111000, 0x21112231, 0x01111110, 0x01310102)
_DIVIDE_FIELD = 0x0F000000
_ENGINE_BYTES, _CPU_BYTES, _WITNESSES = 2048, 0x10000, 4
_SDIV, _UDIV = 0xFB90, 0xFBB0
INSTRUCTION_BYTES = 4


class Division(Enum):
    """What an instruction turned out to be."""

    NONE = auto()
    DONE = auto()
    BY_ZERO = auto()


def find_isar() -> tuple[int, int] | None:
    """(offset of a pointer in the engine, offset of ID_ISAR0 from there); None if not found.

    A pointer may come near a neighbour's by chance, so it must do so in several engines at once.
    """
    engines = [_scratch_engine() for _ in range(_WITNESSES)]
    with contextlib.suppress(OSError), Path("/proc/self/mem").open("rb", buffering=0) as memory:
        found = [set(_places(memory.fileno(), engine)) for engine in engines]
        return min(set.intersection(*found), default=None)
    return None


def _scratch_engine() -> Any:
    engine = Uc(UC_ARCH_ARM, UC_MODE_THUMB)
    engine.ctl_set_cpu_model(UC_CPU_ARM_CORTEX_M3)
    engine.mem_map(0x1000, 0x1000)
    return engine


def _places(memory: int, engine: Any) -> Iterator[tuple[int, int]]:
    content = ctypes.string_at(engine_address(engine), _ENGINE_BYTES)
    for offset in range(0, _ENGINE_BYTES, 8):
        (pointer,) = struct.unpack_from("<Q", content, offset)
        if 0x10000 <= pointer < 1 << 47:
            with contextlib.suppress(OSError):
                place = os.pread(memory, _CPU_BYTES, pointer).find(_ISAR)
                if place >= 0:
                    yield offset, place


_PLACE = find_isar()


def trap(engine: Any, on: bool) -> bool:
    """Has divide instructions reported, or not; False where that cannot be done."""
    if _PLACE is None:
        return False
    pointer = ctypes.c_uint64.from_address(engine_address(engine) + _PLACE[0]).value
    field = ctypes.c_uint32.from_address(pointer + _PLACE[1])
    isar = int.from_bytes(_ISAR[:4], "little")
    if field.value | _DIVIDE_FIELD != isar | _DIVIDE_FIELD:
        raise RuntimeError("vboard does not know this build of unicorn. Install unicorn==2.1.4")
    field.value = isar & ~_DIVIDE_FIELD if on else isar
    engine.ctl_flush_tb()
    return True


def divide(cpu: Cpu, opcode: bytes) -> Division:
    """Carries out the instruction if it divides by anything but zero; pc stays."""
    first, second = struct.unpack("<HH", opcode)
    kind = first & 0xFFF0
    if kind not in (_SDIV, _UDIV) or second & 0xF0F0 != 0xF0F0:
        return Division.NONE
    dividend, divisor = cpu.read_general(first & 0xF), cpu.read_general(second & 0xF)
    if divisor == 0:
        return Division.BY_ZERO
    if kind == _SDIV:
        dividend, divisor = _signed(dividend), _signed(divisor)
    quotient = abs(dividend) // abs(divisor)
    negative = (dividend < 0) != (divisor < 0)
    cpu.write_general(second >> 8 & 0xF, -quotient if negative else quotient)
    return Division.DONE


def _signed(value: int) -> int:
    return value - (1 << 32) if value >> 31 else value
