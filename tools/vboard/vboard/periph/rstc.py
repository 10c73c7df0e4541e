"""Reset controller."""

from __future__ import annotations

from vboard.core.bus import BusViolation, Peripheral, Reg, Soc
from vboard.periph.protect import need_key, only_bits

KEY = 0xA5
PROCRST, PERRST, EXTRST = 1 << 0, 1 << 2, 1 << 3
URSTEN = 1
URSTS, NRSTL = 1 << 0, 1 << 16
RESET_POWER, RESET_BACKUP, RESET_WATCHDOG, RESET_SOFTWARE, RESET_PIN = range(5)


class Rstc(Peripheral):
    """The board writes the cause of each reset to ``cause``."""

    size = 0x10
    registers = (
        Reg("CR", 0x00, "w"),
        Reg("SR", 0x04, "r"),
        Reg("MR", 0x08, "rw", URSTEN),
    )

    def __init__(self, soc: Soc, name: str, base: int) -> None:
        self.cause = RESET_POWER
        self._pin_seen = False
        super().__init__(soc, name, base)

    def reset(self) -> None:
        """The mode survives; it is in the backup domain."""
        if not self.values:
            super().reset()

    def power_off(self) -> None:
        """Forgets."""
        self.values.clear()
        self.cause, self._pin_seen = RESET_POWER, False

    def press(self) -> None:
        """Someone pulls NRST."""
        self._pin_seen = True
        if self.values["MR"] & URSTEN:
            self.soc.request_reset(RESET_PIN)

    def write_cr(self, value: int) -> None:
        """Processor and peripherals together; one without the other leaves a mess."""
        need_key("RSTC_CR", value, 24, 8, KEY)
        only_bits("RSTC_CR", value & 0xFFFFFF, PROCRST | PERRST | EXTRST)
        if value & (PROCRST | PERRST) != PROCRST | PERRST:
            raise BusViolation(f"RSTC_CR 0x{value:08x}: processor and peripherals reset apart")
        self.soc.request_reset(RESET_SOFTWARE)

    def write_mr(self, value: int) -> None:
        """What NRST does."""
        need_key("RSTC_MR", value, 24, 8, KEY)
        only_bits("RSTC_MR", value & 0xFFFFFF, 0xF11)
        self.values["MR"] = value & 0xF11

    def read_sr(self) -> int:
        """Cause of the last reset, level of NRST (high)."""
        seen, self._pin_seen = self._pin_seen, False
        return self.cause << 8 | NRSTL | (URSTS if seen else 0)
