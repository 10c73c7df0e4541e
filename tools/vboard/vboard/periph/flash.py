"""The flash cells: what outlives the power."""

from __future__ import annotations

import mmap
import random
from collections.abc import Callable
from dataclasses import dataclass, field

FLASH_BASE = 0x80000
BANK_BYTES = 256 * 1024
PAGE_BYTES = 256
PAGES = BANK_BYTES // PAGE_BYTES
UNIT_BYTES = 16  # written at once; may be programmed once per erase
REGION_PAGES = 64
REGIONS = PAGES // REGION_PAGES
WORDS = PAGE_BYTES // 4


@dataclass
class PageWear:
    """How often each page of a bank was erased and programmed."""

    erased: list[int] = field(default_factory=lambda: [0] * PAGES)
    programmed: list[int] = field(default_factory=lambda: [0] * PAGES)


class Flash:
    """512 KB in two banks: the bytes of ``memory`` (erased ones if None), whose size and place
    never change, so that the processor may map them. ``on_change`` is called with first and last+1
    address after the cells changed."""

    def __init__(self, memory: bytearray | mmap.mmap | None = None) -> None:
        self.memory = bytearray(b"\xff" * (2 * BANK_BYTES)) if memory is None else memory
        if len(self.memory) != 2 * BANK_BYTES:
            raise ValueError(f"flash has {2 * BANK_BYTES} bytes, not {len(self.memory)}")
        self.locked = [set[int](), set[int]()]  # lock regions per bank
        self.gpnvm = 0b010  # boot from flash
        self.wear = [PageWear(), PageWear()]
        self.torn: list[tuple[int, int]] = []  # (bank, page), in order
        self.on_change: list[Callable[[int, int], None]] = []

    def page(self, bank: int, page: int) -> bytes:
        """The 256 bytes of a page."""
        start = bank * BANK_BYTES + page * PAGE_BYTES
        return bytes(self.memory[start : start + PAGE_BYTES])

    def set(self, bank: int, offset: int, data: bytes) -> None:
        """Changes cells."""
        start = bank * BANK_BYTES + offset
        self.memory[start : start + len(data)] = data
        for call in self.on_change:
            call(FLASH_BASE + start, FLASH_BASE + start + len(data))

    def bank(self, bank: int) -> bytes:
        """All bytes of a bank."""
        return bytes(self.memory[bank * BANK_BYTES : (bank + 1) * BANK_BYTES])


def tear(old: bytes, new: bytes, erase: bool, progress: float, chance: random.Random) -> bytes:
    """A page whose writing ended at ``progress`` (0 to 1).

    An erase takes the first half of the time. Cells change word by word in no order, so each word
    is as before, as after, or has some of its bits changed.
    """
    blank = b"\xff" * 4
    erased = min(progress * 2, 1.0) if erase else 1.0
    written = max(progress * 2 - 1, 0.0) if erase else progress
    out = bytearray()
    for at in range(0, len(old), 4):
        before = old[at : at + 4]
        after = new[at : at + 4] if erase else _and(before, new[at : at + 4])
        middle = blank if erase else before
        word = _partly(before, middle, erased, chance)
        if erased >= 1.0:
            word = _partly(middle, after, written, chance)
        out += word
    return bytes(out)


def _partly(start: bytes, end: bytes, done: float, chance: random.Random) -> bytes:
    draw = chance.random()
    if draw < done * 0.8:
        return end
    if draw > 1 - (1 - done) * 0.8:
        return start
    mask = chance.getrandbits(32).to_bytes(4, "little")
    return bytes((s & ~m & 0xFF) | (e & m) for s, e, m in zip(start, end, mask, strict=True))


def _and(one: bytes, other: bytes) -> bytes:
    return bytes(a & b for a, b in zip(one, other, strict=True))
