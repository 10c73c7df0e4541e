"""Where Unicorn keeps its instruction counter.

emu_start(count=N) counts exactly, but its interface does not tell how many instructions ran when
something else ended the run, nor how many have run while a peripheral is accessed. Both stand in
private fields of the engine. Their place is found by running known programs, so that another build
of the library is noticed at import and not by wrong times.
"""

from __future__ import annotations

import ctypes
import struct
from typing import Any

from unicorn import UC_ARCH_ARM, UC_MODE_THUMB
from unicorn.arm_const import UC_CPU_ARM_CORTEX_M3

from vboard.core.engine import Uc

_NOP = b"\x00\xbf"
_LOOKED_AT_BYTES = 2048
_LENGTHS = (37, 211)


def engine_address(engine: Any) -> int:
    """Address of the engine's own structure."""
    handle = engine._uch
    address = handle.value if isinstance(handle, ctypes.c_void_p) else handle
    if not address:
        raise RuntimeError("unicorn: the engine is closed")
    return int(address)


def find_counter() -> int:
    """Offset of the pair (instructions begun, instructions wanted), 64 bits each, in the engine.

    Raises RuntimeError when it is not there exactly once.
    """
    engine = Uc(UC_ARCH_ARM, UC_MODE_THUMB)
    engine.ctl_set_cpu_model(UC_CPU_ARM_CORTEX_M3)
    engine.mem_map(0x1000, 0x1000)
    engine.mem_write(0x1000, _NOP * 0x800)
    candidates = set(range(0, _LOOKED_AT_BYTES - 16, 8))
    for length in _LENGTHS:
        engine.emu_start(0x1001, 0xFFFFFFFE, count=length)
        seen = ctypes.string_at(engine_address(engine), _LOOKED_AT_BYTES)
        found = struct.pack("<QQ", length + 1, length)
        candidates = {offset for offset in candidates if seen[offset : offset + 16] == found}
    if len(candidates) != 1:
        raise RuntimeError(
            "vboard does not know this build of unicorn: its instruction counter is not where "
            "2.1.4 has it. Install unicorn==2.1.4"
        )
    return candidates.pop()


COUNTER_OFFSET = find_counter()
