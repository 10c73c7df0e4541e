"""Parallel I/O: pin direction, level, pull-up, and who drives the pin."""

from __future__ import annotations

from collections.abc import Callable

from vboard.core.bus import BusViolation, Reg, Soc
from vboard.periph.protect import WriteProtected, only_bits

ALL = 0xFFFFFFFF

# enable register, disable register, status register, level after reset
PAIRS = {
    "PSR": ("PER", "PDR", ALL),
    "OSR": ("OER", "ODR", 0),
    "IFSR": ("IFER", "IFDR", 0),
    "IMR": ("IER", "IDR", 0),
    "PUSR": ("PUER", "PUDR", 0),
    "OWSR": ("OWER", "OWDR", 0),
}


class Pio(WriteProtected):
    """One port of up to 32 pins.

    ``on_change`` is called after anything that may move a pin. ``function_level[(bit, "A")]`` tells
    the level that a peripheral drives; pins handed to one that has none read as low.
    """

    size = 0x200
    wp_key = 0x50494F
    protected = frozenset({"PER", "PDR", "OER", "ODR", "IFER", "IFDR", "PUDR", "PUER", "ABSR"})
    registers = (
        Reg("PER", 0x00, "w"),
        Reg("PDR", 0x04, "w"),
        Reg("PSR", 0x08, "r"),
        Reg("OER", 0x10, "w"),
        Reg("ODR", 0x14, "w"),
        Reg("OSR", 0x18, "r"),
        Reg("IFER", 0x20, "w"),
        Reg("IFDR", 0x24, "w"),
        Reg("IFSR", 0x28, "r"),
        Reg("SODR", 0x30, "w"),
        Reg("CODR", 0x34, "w"),
        Reg("ODSR", 0x38),
        Reg("PDSR", 0x3C, "r"),
        Reg("IER", 0x40, "w"),
        Reg("IDR", 0x44, "w"),
        Reg("IMR", 0x48, "r"),
        Reg("ISR", 0x4C, "r"),
        Reg("PUDR", 0x60, "w"),
        Reg("PUER", 0x64, "w"),
        Reg("PUSR", 0x68, "r"),
        Reg("ABSR", 0x70),
        Reg("OWER", 0xA0, "w"),
        Reg("OWDR", 0xA4, "w"),
        Reg("OWSR", 0xA8, "r"),
        Reg("WPMR", 0xE4),
    )

    def __init__(self, soc: Soc, name: str, base: int, pid: int, pins: int = ALL) -> None:
        self.pins = pins
        self.on_change: list[Callable[[], None]] = []
        self.function_level: dict[tuple[int, str], Callable[[], bool]] = {}
        self._outside: dict[int, bool] = {}
        self._powered = True
        for status, (enable, disable, _) in PAIRS.items():
            setattr(self, f"write_{enable.lower()}", self._pair_writer(enable, status, True))
            setattr(self, f"write_{disable.lower()}", self._pair_writer(disable, status, False))
        super().__init__(soc, name, base, pid)

    def reset(self) -> None:
        """All pins inputs with pull-up."""
        super().reset()
        self._powered = True
        for status, (_, _, level) in PAIRS.items():
            self.values[status] = level & self.pins if status != "PUSR" else 0
        self._changed = 0  # ISR
        self._seen = self._levels()
        self._drive()
        self._tell()

    def power_off(self) -> None:
        """Nothing is driven, nothing pulled."""
        self._powered = False
        self._tell()

    def clocked(self) -> bool:
        """Pins are configured and driven without the clock; only inputs need it."""
        return True

    def _sees_inputs(self) -> bool:
        assert self.pid is not None
        return self.soc.pid_clocked(self.pid)

    # The world outside.

    def set_input(self, bit: int, level: bool | None) -> None:
        """What is connected to the pin drives it; None: nothing does."""
        if level is None:
            self._outside.pop(bit, None)
        else:
            self._outside[bit] = level
        self._moved()

    def level(self, bit: int) -> bool:
        """The pin's level now. An open input is high with its pull-up, else low."""
        if not self._powered:
            return self._outside.get(bit, False)
        mask = 1 << bit
        if not self.values["PSR"] & mask:
            function = self.function_level.get((bit, self.owner(bit)))
            if function is not None:
                return function()
        elif self.values["OSR"] & mask:
            return bool(self.values["ODSR"] & mask)
        if bit in self._outside:
            return self._outside[bit]
        return not self.values["PUSR"] & mask

    def drives_high(self, bit: int) -> bool:
        """Whether the port itself, as a plain output, drives the pin high."""
        mask = 1 << bit
        outputs = self.values["PSR"] & self.values["OSR"] & self.values["ODSR"]
        return self._powered and bool(outputs & mask)

    def owner(self, bit: int) -> str:
        """Who drives the pin: "PIO", "A" or "B"; "" without power."""
        if not self._powered:
            return ""
        if self.values["PSR"] >> bit & 1:
            return "PIO"
        return "B" if self.values["ABSR"] >> bit & 1 else "A"

    # Registers.

    def _pair_writer(self, register: str, status: str, on: bool) -> Callable[[int], None]:
        def write(value: int) -> None:
            only_bits(f"{self.name} {register}", value, self.pins)
            # Pull-up status is inverted: 1 = off.
            set_bits = on != (status == "PUSR")
            old = self.values[status]
            self.values[status] = old | value if set_bits else old & ~value
            self._moved()

        return write

    def write_sodr(self, value: int) -> None:
        """Drive high."""
        self._drive_out(self.values["ODSR"] | value)

    def write_codr(self, value: int) -> None:
        """Drive low."""
        self._drive_out(self.values["ODSR"] & ~value)

    def write_odsr(self, value: int) -> None:
        """All pins enabled in OWSR at once."""
        mask = self.values["OWSR"]
        self._drive_out(self.values["ODSR"] & ~mask | value & mask)

    def _drive_out(self, value: int) -> None:
        only_bits(f"{self.name} output data", value, self.pins)
        self.values["ODSR"] = value
        self._moved()

    def write_absr(self, value: int) -> None:
        """Which peripheral gets the pins that are handed over."""
        only_bits(f"{self.name} ABSR", value, self.pins)
        self.values["ABSR"] = value
        self._moved()

    def read_pdsr(self) -> int:
        """Levels of all pins; needs the clock."""
        if not self._sees_inputs():
            raise BusViolation(f"read of {self.name} PDSR while its clock is off (PMC_PCER)")
        return self._levels()

    def read_isr(self) -> int:
        """Pins that changed since the last reading."""
        value, self._changed = self._changed, 0
        self._drive()
        return value

    def _levels(self) -> int:
        return sum(1 << bit for bit in range(32) if self.pins >> bit & 1 and self.level(bit))

    def _moved(self) -> None:
        if self.values["IMR"] and self._sees_inputs():
            levels = self._levels()
            self._changed |= levels ^ self._seen
            self._seen = levels
        self._drive()
        self._tell()

    def _drive(self) -> None:
        assert self.pid is not None
        self.soc.set_irq(self.pid, bool(self._changed & self.values["IMR"]))

    def _tell(self) -> None:
        for call in self.on_change:
            call()
