"""Power management controller: oscillators, PLL, master clock, clocks of the peripherals.

Steps that the data sheet forbids, or that would run the chip beyond its limits, are violations.
"""

from __future__ import annotations

from collections.abc import Callable

from vboard.core.bus import BusViolation, Reg, Soc
from vboard.core.clock import TICKS_PER_S, Event
from vboard.periph.protect import WriteProtected, need_key, only_bits
from vboard.periph.supply import SlowClock

MOSCXTS, LOCKA, MCKRDY = 1 << 0, 1 << 1, 1 << 3
OSCSELS, MOSCSELS, MOSCRCS = 1 << 7, 1 << 16, 1 << 17
CFDEV, CFDS = 1 << 18, 1 << 19
SR_OFFSET = 0x68
XTEN, RCEN, MOSCSEL, CFDEN = 1 << 0, 1 << 3, 1 << 24, 1 << 25
MOR_KEY = 0x37

CRYSTAL_HZ = 12_000_000
RC_HZ = {0: 4_000_000, 1: 8_000_000, 2: 12_000_000}
MAX_MCK_HZ = 84_000_000
PLL_IN_HZ = (8_000_000, 16_000_000)
PLL_OUT_HZ = (84_000_000, 192_000_000)
# Highest clock for 0, 1, ... wait states of the flash (data sheet, AC characteristics).
FLASH_LIMIT_HZ = (22_500_000, 34_000_000, 53_000_000, 78_000_000)

RC_START_US = 10
DETECTOR_SLOW_CLOCKS = 2
SWITCH_US = 1  # a few cycles of the slower clock; not in the data sheet
CSS_SLOW, CSS_MAIN, CSS_PLLA, CSS_UPLL = range(4)
PRESCALER = {0: 1, 1: 2, 2: 4, 3: 8, 4: 16, 5: 32, 6: 64, 7: 3}
# Peripheral ids with a clock of their own to switch.
GATED = frozenset({8, 9, *range(11, 15), *range(17, 25), 26, *range(27, 45)})


class Pmc(WriteProtected):
    """The clock tree. ``on_mck`` is called after each change of the master clock; ``before_mck``
    ahead of it, and may refuse with a BusViolation. ``on_gates`` is called after each change of the
    peripheral clocks, with those that are on.

    ``crystal``: whether the 12 MHz crystal swings. With a dead one MOSCXTS never comes, or, with
    ``moscxts_by_time``, comes like with a good one, as it does where it is only the end of a count
    of slow clocks; then the failure detector alone tells.
    """

    size = 0x110
    wp_key = 0x504D43
    wp_register = "PMC_WPMR"
    protected = frozenset(
        {"CKGR_MOR", "CKGR_PLLAR", "PMC_MCKR", "PMC_PCER0", "PMC_PCDR0", "PMC_PCER1", "PMC_PCDR1"}
    )
    registers = (
        Reg("PMC_SCSR", 0x08, "r", 0x1),
        Reg("PMC_PCER0", 0x10, "w"),
        Reg("PMC_PCDR0", 0x14, "w"),
        Reg("PMC_PCSR0", 0x18, "r"),
        Reg("CKGR_MOR", 0x20, "rw", 0x8),
        Reg("CKGR_MCFR", 0x24, "r"),
        Reg("CKGR_PLLAR", 0x28, "rw", 0x3F00),
        Reg("PMC_MCKR", 0x30, "rw", 0x1),
        Reg("PMC_IER", 0x60, "w"),
        Reg("PMC_IDR", 0x64, "w"),
        Reg("PMC_SR", SR_OFFSET, "r", 0x10008),
        Reg("PMC_IMR", 0x6C, "r"),
        Reg("PMC_WPMR", 0xE4),
        Reg("PMC_PCER1", 0x100, "w"),
        Reg("PMC_PCDR1", 0x104, "w"),
        Reg("PMC_PCSR1", 0x108, "r"),
    )

    def __init__(
        self, soc: Soc, name: str, base: int, slow: SlowClock, *, crystal: bool = True
    ) -> None:
        self.slow, self.crystal = slow, crystal
        self.moscxts_by_time = False
        self.before_mck: list[Callable[[], None]] = []
        self.on_mck: list[Callable[[], None]] = []
        self.on_gates: list[Callable[[int], None]] = []
        self.wait_states: Callable[[], int] = lambda: len(FLASH_LIMIT_HZ)
        self.mck_hz = 0
        self._events: dict[int, Event] = {}
        self._clocked = 0
        super().__init__(soc, name, base)

    def reset(self) -> None:
        """4 MHz RC, no peripheral clocks."""
        super().reset()
        for event in self._events.values():
            self.soc.clock.cancel(event)
        self._events = {}
        self._status = 0x10008
        self._main_since = self.soc.clock.now
        self._set_gates(0)
        self._run_at(self._frequency(self.values["PMC_MCKR"]))
        self._later(MOSCRCS, RC_START_US * 84)
        self._drive()

    def power_off(self) -> None:
        """Everything stands still."""
        for event in self._events.values():
            self.soc.clock.cancel(event)

    @property
    def mck_ticks(self) -> int:
        """Ticks of 1/84 us per cycle of the master clock."""
        return TICKS_PER_S // self.mck_hz

    @property
    def gates(self) -> int:
        """Peripherals with a switch whose clock is on, by id."""
        return self._clocked

    def pid_clocked(self, pid: int) -> bool:
        """Whether the clock of a peripheral is on; those without a switch always are."""
        return pid not in GATED or bool(self._clocked >> pid & 1)

    # Frequencies.

    def main_hz(self) -> int:
        """Main clock."""
        mor = self.values["CKGR_MOR"]
        return CRYSTAL_HZ if mor & MOSCSEL else RC_HZ[(mor >> 4) & 7]

    def plla_hz(self) -> int:
        """PLL A output when locked."""
        pllar = self.values["CKGR_PLLAR"]
        multiplier, divider = (pllar >> 16) & 0x7FF, pllar & 0xFF
        return self.main_hz() // divider * (multiplier + 1) if multiplier and divider else 0

    def _frequency(self, mckr: int) -> int:
        css, divider = mckr & 3, PRESCALER[(mckr >> 4) & 7]
        if css == CSS_PLLA:
            return self.plla_hz() // divider // (2 if mckr & 1 << 12 else 1)
        if css == CSS_MAIN:
            return self.main_hz() // divider
        raise BusViolation(f"PMC_MCKR 0x{mckr:08x}: slow clock and UPLL are not modelled")

    def check_flash(self, hz: int, wait_states: int) -> None:
        """Raises BusViolation when the flash is too slow for the clock."""
        if wait_states < len(FLASH_LIMIT_HZ) and hz > FLASH_LIMIT_HZ[wait_states]:
            raise BusViolation(f"MCK {hz} Hz with {wait_states} flash wait states is too fast")

    def _set_mck(self) -> None:
        hz = self._frequency(self.values["PMC_MCKR"])
        if hz == self.mck_hz:
            return
        if hz > MAX_MCK_HZ:
            raise BusViolation(f"MCK would be {hz} Hz, above {MAX_MCK_HZ}")
        if hz <= 0 or TICKS_PER_S % hz:
            raise BusViolation(f"MCK {hz} Hz is no whole number of ticks per cycle")
        self.check_flash(hz, self.wait_states())
        for call in self.before_mck:
            call()
        self._run_at(hz)

    def _run_at(self, hz: int) -> None:
        self.mck_hz = hz
        for call in self.on_mck:
            call()

    # Status bits that come with time.

    def _later(self, bit: int, ticks: int) -> None:
        self._status &= ~bit
        self.soc.clock.cancel(self._events.pop(bit, None))
        self._events[bit] = self.soc.clock.after(ticks, lambda: self._arrive(bit))

    def _arrive(self, bit: int) -> None:
        self._status |= bit
        self._drive()

    def _drop(self, bit: int) -> None:
        self._status &= ~bit
        self.soc.clock.cancel(self._events.pop(bit, None))

    def read_pmc_sr(self) -> int:
        """What is ready; the reading clears CFDEV."""
        value = self._status | (OSCSELS if self.slow.crystal else 0)
        self._status &= ~CFDEV
        self._drive()
        return value

    def steady(self, address: int, value: int) -> bool:
        """PMC_SR, while there is no failure that the reading would have cleared."""
        return address == self.base + SR_OFFSET and not value & CFDEV

    def read_ckgr_mcfr(self) -> int:
        """Main clock measured over 16 slow clocks."""
        if self.soc.clock.now < self._main_since + self.slow.ticks(16):
            return 0
        return 1 << 16 | (self.main_hz() * 16 // self.slow.hz) & 0xFFFF

    # Oscillators.

    def write_ckgr_mor(self, value: int) -> None:
        """Crystal and RC on, RC frequency, which of them is the main clock."""
        need_key("CKGR_MOR", value, 16, 8, MOR_KEY)
        only_bits("CKGR_MOR", value, 0x03FFFF79)
        value &= ~0xFF0000
        old = self.values["CKGR_MOR"]
        self._check_oscillators(old, value)
        self.values["CKGR_MOR"] = value
        if (value ^ old) & XTEN:
            self._drop(MOSCXTS)
            if value & XTEN and (self.crystal or self.moscxts_by_time):
                self._later(MOSCXTS, self.slow.ticks(8 * ((value >> 8) & 0xFF)))
        if (value ^ old) & (RCEN | 0x70):
            self._drop(MOSCRCS)
            if value & RCEN:
                self._later(MOSCRCS, RC_START_US * 84)
        if (value ^ old) & MOSCSEL:
            self._later(MOSCSELS, SWITCH_US * 84)
        if (value ^ old) & (MOSCSEL | 0x70):
            self._main_since = self.soc.clock.now
            self._set_mck()
        self._watch()

    def fail_crystal(self) -> None:
        """The crystal stops for good."""
        self.crystal = False
        self._watch()

    def _watch(self) -> None:
        """The failure detector, while it looks at a crystal that does not swing."""
        mor = self.values["CKGR_MOR"]
        if self.crystal or not mor & XTEN:
            self._status &= ~CFDS
            return
        if mor & CFDEN and self._status & MOSCXTS:
            ticks = self.slow.ticks(DETECTOR_SLOW_CLOCKS)
            self._events[CFDS] = self.soc.clock.after(ticks, self._crystal_failed)
        elif mor & MOSCSEL:
            raise BusViolation("the main clock comes from a dead crystal: the chip stands still")

    def _crystal_failed(self) -> None:
        """Onto the RC oscillator, whatever ran on the crystal."""
        self._status |= CFDEV | CFDS
        if self.values["CKGR_MOR"] & MOSCSEL:
            self.values["CKGR_MOR"] &= ~MOSCSEL
            self.values["PMC_MCKR"] = self.values["PMC_MCKR"] & ~3 | CSS_MAIN
            self._run_at(self._frequency(self.values["PMC_MCKR"]))
        self._drive()

    def _check_oscillators(self, old: int, new: int) -> None:
        if (new >> 4) & 7 not in RC_HZ:
            raise BusViolation("CKGR_MOR: reserved RC frequency")
        if (new ^ old) & 0x70 and (new | old) & MOSCSEL == 0 and not self._status & MOSCRCS:
            raise BusViolation("CKGR_MOR: RC frequency changed before MOSCRCS")
        if new & MOSCSEL:
            if not new & XTEN or not old & XTEN or not self._status & MOSCXTS:
                raise BusViolation("CKGR_MOR: crystal selected before it runs (MOSCXTS)")
        elif not new & RCEN or (old & MOSCSEL and not self._status & MOSCRCS):
            raise BusViolation("CKGR_MOR: RC oscillator selected while it does not run")
        if (new ^ old) & (MOSCSEL | 0x70) and self.values["PMC_MCKR"] & 3 == CSS_PLLA:
            raise BusViolation("CKGR_MOR: main clock changed under a running PLL")

    def write_ckgr_pllar(self, value: int) -> None:
        """PLL A; LOCKA after PLLACOUNT slow clocks."""
        only_bits("CKGR_PLLAR", value, 0x27FF3FFF)
        if not value & 1 << 29:
            raise BusViolation("CKGR_PLLAR without bit 29 (ONE)")
        if self.values["PMC_MCKR"] & 3 == CSS_PLLA:
            raise BusViolation("CKGR_PLLAR changed while the master clock comes from it")
        self.values["CKGR_PLLAR"] = value
        self._drop(LOCKA)
        if not self.plla_hz():
            return
        if not self._status & MOSCSELS:
            raise BusViolation("CKGR_PLLAR: started on a main clock that is not ready (MOSCSELS)")
        source = self.main_hz() // (value & 0xFF)
        _within("PLL A input", source, PLL_IN_HZ)
        _within("PLL A output", self.plla_hz(), PLL_OUT_HZ)
        self._later(LOCKA, self.slow.ticks((value >> 8) & 0x3F))

    # Master clock.

    def write_pmc_mckr(self, value: int) -> None:
        """Source and prescaler, one at a time, each only when the last one is through."""
        only_bits("PMC_MCKR", value, 0x1073)
        old = self.values["PMC_MCKR"]
        if not self._status & MCKRDY:
            raise BusViolation("PMC_MCKR written before MCKRDY")
        if (value ^ old) & 3 and (value ^ old) & 0x1070:
            raise BusViolation("PMC_MCKR: source and prescaler changed at once")
        if value & 3 == CSS_PLLA and not self._status & LOCKA:
            raise BusViolation("PMC_MCKR: PLL A selected before it is locked")
        if value & 3 == CSS_MAIN and not self._status & MOSCSELS:
            raise BusViolation("PMC_MCKR: main clock selected before MOSCSELS")
        if value == old:
            return
        self.values["PMC_MCKR"] = value
        self._later(MCKRDY, SWITCH_US * 84)
        self._set_mck()

    # Clocks of the peripherals.

    def write_pmc_pcer0(self, value: int) -> None:
        """On, ids 0 to 31."""
        self._gate(value, True)

    def write_pmc_pcdr0(self, value: int) -> None:
        """Off, ids 0 to 31."""
        self._gate(value, False)

    def write_pmc_pcer1(self, value: int) -> None:
        """On, ids 32 to 63."""
        self._gate(value << 32, True)

    def write_pmc_pcdr1(self, value: int) -> None:
        """Off, ids 32 to 63."""
        self._gate(value << 32, False)

    def read_pmc_pcsr0(self) -> int:
        """Which are on, ids 0 to 31."""
        return self._clocked & 0xFFFFFFFF

    def read_pmc_pcsr1(self) -> int:
        """Which are on, ids 32 to 63."""
        return self._clocked >> 32

    def _gate(self, mask: int, on: bool) -> None:
        wrong = [pid for pid in range(64) if mask >> pid & 1 and pid not in GATED]
        if wrong:
            raise BusViolation(f"PMC: no clock to switch for peripheral ids {wrong}")
        self._set_gates(self._clocked | mask if on else self._clocked & ~mask)

    def _set_gates(self, clocked: int) -> None:
        self._clocked = clocked
        for call in self.on_gates:
            call(clocked)

    def write_pmc_wpmr(self, value: int) -> None:
        """Takes the key."""
        self.write_wpmr(value)

    # Interrupt.

    def write_pmc_ier(self, value: int) -> None:
        """Interrupts on."""
        self.values["PMC_IMR"] |= value
        self._drive()

    def write_pmc_idr(self, value: int) -> None:
        """Interrupts off."""
        self.values["PMC_IMR"] &= ~value
        self._drive()

    def _drive(self) -> None:
        self.soc.set_irq(5, bool(self._status & self.values["PMC_IMR"]))


def _within(what: str, hz: int, limits: tuple[int, int]) -> None:
    if not limits[0] <= hz <= limits[1]:
        raise BusViolation(f"{what} of {hz} Hz is outside {limits[0]} to {limits[1]}")
