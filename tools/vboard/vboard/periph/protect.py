"""Registers behind a key."""

from __future__ import annotations

from typing import ClassVar

from vboard.core.bus import BusViolation, Peripheral


class WriteProtected(Peripheral):
    """A peripheral with WPMR: a 24-bit key in [31:8], WPEN in bit 0."""

    wp_key: ClassVar[int]
    wp_register: ClassVar[str] = "WPMR"
    protected: ClassVar[frozenset[str]] = frozenset()

    def write(self, offset: int, value: int) -> str:
        """As the base class; raises BusViolation for a register that is locked."""
        known = self._writers.get(offset)
        if known and known[0] in self.protected and self.values[self.wp_register] & 1:
            raise BusViolation(f"write to {self.name} {known[0]} while write protected")
        return super().write(offset, value)

    def write_wpmr(self, value: int) -> None:
        """Takes the key; keeps WPEN."""
        if value >> 8 != self.wp_key:
            raise BusViolation(f"{self.name} {self.wp_register} written without its key")
        self.values[self.wp_register] = value & 1


def need_key(what: str, value: int, shift: int, width: int, key: int) -> None:
    """Raises BusViolation unless the field holds the key."""
    if (value >> shift) & ((1 << width) - 1) != key:
        raise BusViolation(f"{what} written without its key (0x{value:08x})")


def only_bits(what: str, value: int, allowed: int) -> None:
    """Raises BusViolation for a bit that does not exist or that the model does not know."""
    if value & ~allowed:
        raise BusViolation(f"{what}: bits 0x{value & ~allowed:08x} are unknown or not modelled")
