"""Flash and RAM as the processor and the bus masters see them.

Addresses: data sheet 11057B, memory mapping. SRAM0 (64 KB) shows all through 0x20000000 to
0x2007FFFF, so that it lies right below SRAM1 (32 KB) once.
"""

from __future__ import annotations

import ctypes
import mmap
import random
from collections.abc import Iterator

from vboard.core.bus import BusViolation

FLASH_START, FLASH_SIZE, BANK_SIZE = 0x00080000, 0x80000, 0x40000
BANK1_START = FLASH_START + BANK_SIZE
RAM_START, RAM_SIZE = 0x20070000, 0x18000
MIRROR_START, MIRROR_SIZE = 0x20000000, 0x10000

Buffer = bytearray | mmap.mmap


class Memory:
    """``flash`` belongs to the caller, lies on a page boundary and outlives the power; RAM begins
    as anything (``seed``)."""

    def __init__(self, flash: Buffer, seed: int) -> None:
        self.flash = flash
        self.ram = private_memory(RAM_SIZE)
        self.ram[:] = random.Random(seed).randbytes(RAM_SIZE)
        self._hosts = [_host_address(buffer) for buffer in (self.flash, self.ram)]

    def views(self) -> Iterator[tuple[int, int, int, bool]]:
        """(address, size, host address, writable) of everything to be mapped."""
        flash, ram = self._hosts
        yield 0, BANK_SIZE, flash, False
        yield FLASH_START, FLASH_SIZE, flash, False
        for start in range(MIRROR_START, RAM_START, MIRROR_SIZE):
            yield start, MIRROR_SIZE, ram, True
        yield RAM_START, RAM_SIZE, ram, True

    def find(self, address: int, length: int) -> tuple[Buffer, int] | None:
        """The buffer and the place in it, or None if it is not all in one memory."""
        if address >= RAM_START and address + length <= RAM_START + RAM_SIZE:
            return self.ram, address - RAM_START
        if address >= FLASH_START and address + length <= FLASH_START + FLASH_SIZE:
            return self.flash, address - FLASH_START
        if address >= 0 and address + length <= BANK_SIZE:
            return self.flash, address
        offset = address % MIRROR_SIZE
        if MIRROR_START <= address < RAM_START and offset + length <= MIRROR_SIZE:
            return self.ram, offset
        return None

    def read(self, address: int, length: int) -> bytes:
        """As a bus master. Raises BusViolation outside flash and RAM."""
        place = self.find(address, length)
        if place is None:
            raise BusViolation(f"read of {length} bytes at 0x{address:08x}, which is no memory")
        return bytes(place[0][place[1] : place[1] + length])

    def write(self, address: int, data: bytes) -> None:
        """As a bus master. Raises BusViolation outside RAM."""
        place = self.find(address, len(data))
        if place is None or place[0] is not self.ram:
            raise BusViolation(f"write of {len(data)} bytes to 0x{address:08x}, which is no RAM")
        place[0][place[1] : place[1] + len(data)] = data

    def word(self, address: int) -> int:
        """A 32-bit word. Raises BusViolation outside flash and RAM."""
        return int.from_bytes(self.read(address, 4), "little")


def private_memory(size: int) -> mmap.mmap:
    """Zeros on a page boundary. After a fork both processes have their own: a run may be continued
    in many ways from one point on."""
    flags = {"flags": mmap.MAP_PRIVATE} if hasattr(mmap, "MAP_PRIVATE") else {}
    return mmap.mmap(-1, size, **flags)


def is_flash(address: int) -> bool:
    """Whether the address is in flash or in its mirror at zero."""
    return address < BANK_SIZE or FLASH_START <= address < FLASH_START + FLASH_SIZE


def _host_address(buffer: Buffer) -> int:
    return ctypes.addressof(ctypes.c_char.from_buffer(buffer))
