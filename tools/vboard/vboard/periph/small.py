"""Peripherals of a few registers: bus matrix, backup registers, chip id."""

from __future__ import annotations

from vboard.core.bus import Peripheral, Reg
from vboard.periph.protect import WriteProtected, only_bits

CHIP_ID = 0x285E0A60


class Matrix(WriteProtected):
    """Bus matrix: slave configuration and system pins; only kept."""

    size = 0x200
    wp_key = 0x4D4154
    wp_register = "MATRIX_WPMR"
    protected = frozenset({f"MATRIX_SCFG{n}" for n in range(9)} | {"CCFG_SYSIO"})
    registers = (
        Reg("MATRIX_MCFG", 0x00, "rw", 0, 6),
        Reg("MATRIX_SCFG", 0x40, "rw", 0, 9),
        Reg("CCFG_SYSIO", 0x114),
        Reg("MATRIX_WPMR", 0x1E4),
    )

    @property
    def erase_pin_is_gpio(self) -> bool:
        """Whether PC0 no longer erases the chip."""
        return bool(self.values["CCFG_SYSIO"] & 1 << 12)

    def write_matrix_wpmr(self, value: int) -> None:
        """Takes the key."""
        self.write_wpmr(value)

    def write_ccfg_sysio(self, value: int) -> None:
        """PC0 as GPIO."""
        only_bits("CCFG_SYSIO", value, 1 << 12)
        self.values["CCFG_SYSIO"] = value


class Gpbr(Peripheral):
    """Eight words that survive every reset, but not the power."""

    size = 0x20
    registers = (Reg("GPBR", 0x00, "rw", 0, 8),)

    def reset(self) -> None:
        """Only the first time."""
        if not self.values:
            super().reset()

    def power_off(self) -> None:
        """Forgets."""
        self.values.clear()


class ChipId(Peripheral):
    """Which chip this is."""

    size = 0x8
    registers = (Reg("CIDR", 0x0, "r", CHIP_ID), Reg("EXID", 0x4, "r"))
