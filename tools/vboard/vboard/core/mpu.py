"""Memory protection unit: eight regions (ARMv7-M Architecture Reference Manual, B3.5).

Checked: data accesses to flash and RAM, exception stacking, and execution from pages that are
wholly execute-never. Not checked: peripherals, and what only unprivileged code may not do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from unicorn import UC_PROT_EXEC, UC_PROT_READ, UC_PROT_WRITE

from vboard.core.bus import BusViolation

REGION_COUNT = 8
PAGE = 4096
CTRL_ENABLE, CTRL_HFNMIENA, CTRL_PRIVDEFENA = 1, 2, 4
RASR_ENABLE, RASR_XN = 1, 1 << 28
# AP field: (privileged may read, write), (unprivileged may read, write).
_ACCESS = {
    0: ((False, False), (False, False)),
    1: ((True, True), (False, False)),
    2: ((True, True), (True, False)),
    3: ((True, True), (True, True)),
    5: ((True, False), (False, False)),
    6: ((True, False), (True, False)),
    7: ((True, False), (True, False)),
}


class Mpu:
    """Registers and checks.

    ``protect(address, size, permissions)`` restricts pages of the processor; ``spans`` lists the
    memories as (start, size, permissions without the MPU). ``changed()`` is called after a write
    that counts; apply() then restricts the pages, when the processor does not run.
    """

    def __init__(
        self,
        protect: Callable[[int, int, int], None],
        spans: list[tuple[int, int, int]],
        changed: Callable[[], None],
    ) -> None:
        self._protect, self._spans, self._changed = protect, spans, changed
        self._restricted: dict[int, tuple[int, int]] = {}
        # What is restricted, by all registers: the tick goes back and forth between two settings.
        self._known: dict[tuple[int, ...], dict[int, tuple[int, int]]] = {}
        self.control = 0
        self.reset()

    def reset(self) -> None:
        """Off."""
        self.control = 0
        self.number = 0
        self.base = [0] * REGION_COUNT
        self.attributes = [0] * REGION_COUNT
        self.apply()

    def active(self, priority: int) -> bool:
        """Whether it checks anything at this execution priority."""
        if not self.control & CTRL_ENABLE:
            return False
        return priority >= 0 or bool(self.control & CTRL_HFNMIENA)

    def allows(self, address: int, write: bool, privileged: bool) -> bool:
        """Whether a data access passes."""
        region = self._region(address)
        if region is None:
            return privileged and bool(self.control & CTRL_PRIVDEFENA)
        access = _ACCESS[(self.attributes[region] >> 24) & 7]
        return access[0 if privileged else 1][1 if write else 0]

    def restricts(self, address: int) -> bool:
        """Whether it is on and has a say about this address's page."""
        return address // PAGE * PAGE in self._restricted

    def hides(self, address: int) -> bool:
        """Whether loads from this address's page are checked one by one."""
        _, permissions = self._restricted.get(address // PAGE * PAGE, (0, UC_PROT_READ))
        return not permissions & UC_PROT_READ

    def apply_again(self, start: int, size: int) -> None:
        """After somebody else set the permissions of these pages to what they are without it."""
        for page, (_, permissions) in self._restricted.items():
            if start <= page < start + size:
                self._protect(page, PAGE, permissions)

    def write_control(self, value: int) -> None:
        """MPU_CTRL."""
        self.control = value & 7
        self._changed()

    def write_base(self, value: int) -> None:
        """MPU_RBAR; VALID selects the region too."""
        if value & 0x10:
            self.select(value & 0xF)
        base = value & ~0x1F
        if base != self.base[self.number]:  # the tick names its region at every turn
            self.base[self.number] = base
            self._changed()

    def read_base(self) -> int:
        """MPU_RBAR."""
        return self.base[self.number] | self.number

    def write_attributes(self, value: int) -> None:
        """MPU_RASR."""
        if value & RASR_ENABLE and (value >> 1) & 0x1F < 4:
            raise BusViolation(f"MPU_RASR 0x{value:08x}: a region is 32 bytes at least")
        if (value >> 24) & 7 not in _ACCESS:
            raise BusViolation(f"MPU_RASR 0x{value:08x}: reserved access permission")
        self.attributes[self.number] = value & 0x173FFF3F
        self._changed()

    def select(self, number: int) -> None:
        """MPU_RNR."""
        if number >= REGION_COUNT:
            raise BusViolation(f"MPU: there is no region {number}")
        self.number = number

    def _extent(self, region: int) -> tuple[int, int]:
        size = 2 << ((self.attributes[region] >> 1) & 0x1F)
        return self.base[region] & ~(size - 1), size

    def _region(self, address: int) -> int | None:
        """The highest enabled region that holds the address."""
        for region in reversed(range(REGION_COUNT)):
            if not self.attributes[region] & RASR_ENABLE:
                continue
            start, size = self._extent(region)
            if not start <= address < start + size:
                continue
            part = (address - start) * 8 // size
            if size >= 256 and self.attributes[region] >> (8 + part) & 1:
                continue
            return region
        return None

    def _edges(self) -> list[int]:
        """Where the answer may change."""
        edges = set()
        for region in range(REGION_COUNT):
            if self.attributes[region] & RASR_ENABLE:
                start, size = self._extent(region)
                parts = 8 if size >= 256 else 1
                edges |= {start + size * part // parts for part in range(parts + 1)}
        return sorted(edges)

    def apply(self) -> None:
        """Restricts the pages in which something may be refused; frees the others."""
        now = (self.control, *self.base, *self.attributes)
        if now not in self._known:
            self._known[now] = dict(self._wanted()) if self.control & CTRL_ENABLE else {}
        wanted = self._known[now]
        for page, (full, _) in self._restricted.items():
            if page not in wanted:
                self._protect(page, PAGE, full)
        for page, (full, permissions) in wanted.items():
            if self._restricted.get(page) != (full, permissions):
                self._protect(page, PAGE, permissions)
        self._restricted = wanted

    def _wanted(self) -> Iterator[tuple[int, tuple[int, int]]]:
        edges = self._edges()
        for page, full in self._concerned():
            points = [page, *(edge for edge in edges if page < edge < page + PAGE)]
            permissions = self._page_permissions(points, full)
            if permissions != full:
                yield page, (full, permissions)

    def _concerned(self) -> Iterator[tuple[int, int]]:
        """Pages about which a region, or the lack of one, says something."""
        extents = [(0, 1 << 32)]
        if self.control & CTRL_PRIVDEFENA:
            enabled = (r for r in range(REGION_COUNT) if self.attributes[r] & RASR_ENABLE)
            extents = [self._extent(region) for region in enabled]
        for start, size, full in self._spans:
            pages: set[int] = set()
            for base, length in extents:
                first = max(start, base // PAGE * PAGE)
                pages |= set(range(first, min(start + size, base + length), PAGE))
            yield from ((page, full) for page in sorted(pages))

    def _page_permissions(self, points: list[int], full: int) -> int:
        permissions = full
        for write, bit in ((False, UC_PROT_READ), (True, UC_PROT_WRITE)):
            if not all(self.allows(point, write, True) for point in points):
                permissions &= ~bit
        if all(self._never_executes(point) for point in points):
            permissions &= ~UC_PROT_EXEC
        return permissions

    def _never_executes(self, address: int) -> bool:
        region = self._region(address)
        if region is None:
            return not self.control & CTRL_PRIVDEFENA
        unreadable = not _ACCESS[(self.attributes[region] >> 24) & 7][0][0]
        return bool(self.attributes[region] & RASR_XN) or unreadable
