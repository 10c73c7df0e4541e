"""Watchdog, resets, supply monitor, what survives what, converter and timer."""

from __future__ import annotations

import pytest

from vboard.core.bus import BusViolation
from vboard.core.clock import TICKS_PER_S
from vboard.periph.adc import Adc
from vboard.periph.bench import Bench
from vboard.periph.rstc import Rstc
from vboard.periph.supply import SlowClock
from vboard.periph.wdt import Wdt

pytestmark = pytest.mark.usefixtures("both_models")

WDT_1S = 0x1FFF2100
FEED = 0xA5000001
DRDY, GOVRE = 1 << 24, 1 << 25


def _wdt(bench: Bench) -> Wdt:
    wdt = bench.periph["WDT"]
    assert isinstance(wdt, Wdt)
    return wdt


# Watchdog.


def test_watchdog_runs_from_reset_for_16_s() -> None:
    bench = Bench()
    bench.run_us(15.9e6)
    assert not bench.resets
    bench.run_us(0.2e6)
    assert [cause for _, cause in bench.resets] == [2]
    assert bench.read("WDT.SR") == 1
    assert bench.read("WDT.SR") == 0


@pytest.mark.parametrize(("rc_hz", "seconds"), [(20_000, 1.638), (32_768, 1.0), (44_000, 0.745)])
def test_watchdog_bites_by_the_slow_clock(rc_hz: int, seconds: float) -> None:
    bench = Bench(slow=SlowClock(rc_hz))
    bench.write("WDT.MR", WDT_1S)
    bench.run_us((seconds - 0.002) * 1e6)
    assert not bench.resets
    bench.write("WDT.CR", FEED)
    assert _wdt(bench).shortest_left_s < 0.01
    bench.run_us((seconds - 0.002) * 1e6)
    assert not bench.resets
    bench.run_us(4000)
    assert len(bench.resets) == 1


def test_watchdog_halts_in_sleep_only_if_told_so() -> None:
    for mode, bites in ((WDT_1S, 1), (WDT_1S | 1 << 29, 0)):
        bench = Bench()
        bench.write("WDT.MR", mode)
        bench.run_us(500_000)
        _wdt(bench).idle(True)
        bench.run_us(900_000)
        assert len(bench.resets) == bites
        _wdt(bench).idle(False)
        bench.run_us(510_000)
        assert len(bench.resets) == 1


def test_fed_outside_its_window_it_bites_at_once() -> None:
    bench = Bench()
    bench.write("WDT.MR", 0x10802100)  # WDD 0x80 of 0x100
    bench.run_us(400_000)
    bench.write("WDT.CR", FEED)
    assert len(bench.resets) == 1
    assert bench.read("WDT.SR") == 2


def test_watchdog_rules() -> None:
    for steps, told in (
        ([("MR", WDT_1S), ("MR", WDT_1S)], "second time"),
        ([("CR", FEED), ("MR", WDT_1S)], "within three slow clocks"),
        ([("MR", WDT_1S | 1 << 14)], "WDRPROC"),
        ([("CR", 1)], "without its key"),
    ):
        bench = Bench()
        with pytest.raises(BusViolation, match=told):
            for register, value in steps:
                bench.write(f"WDT.{register}", value)
    bench = Bench()
    bench.write("WDT.MR", WDT_1S)
    _wdt(bench).reset()
    bench.write("WDT.MR", WDT_1S)
    _wdt(bench).power_off()
    bench.run_us(20e6)
    assert not bench.resets


def test_watchdog_off() -> None:
    bench = Bench()
    bench.write("WDT.MR", 1 << 15)
    bench.run_us(20e6)
    assert not bench.resets


# Resets and what survives.


def test_software_reset_and_cause() -> None:
    bench = Bench()
    rstc = bench.periph["RSTC"]
    assert isinstance(rstc, Rstc)
    assert bench.read("RSTC.SR") == 1 << 16
    bench.write("RSTC.CR", 0xA5000005)
    assert bench.resets == [(0, 3)]
    rstc.cause = 2
    assert bench.read("RSTC.SR") == 1 << 16 | 2 << 8
    for value, told in ((0x5, "without its key"), (0xA5000001, "apart")):
        with pytest.raises(BusViolation, match=told):
            bench.write("RSTC.CR", value)


def test_reset_pin_can_be_switched_off() -> None:
    bench = Bench()
    rstc = bench.periph["RSTC"]
    assert isinstance(rstc, Rstc)
    bench.write("RSTC.MR", 0xA5000000)
    rstc.press()
    assert not bench.resets
    bench.write("RSTC.MR", 0xA5000001)
    rstc.press()
    assert bench.resets == [(0, 4)]


def test_backup_domain_survives_resets_but_not_the_power() -> None:
    bench = Bench()
    bench.write("GPBR.GPBR7", 0x1234)
    bench.write("SUPC.SMMR", 0x10A)
    bench.write("RSTC.MR", 0xA5000000)
    for peripheral in bench.periph.values():
        peripheral.reset()
    assert bench.read("GPBR.GPBR7") == 0x1234
    assert bench.read("SUPC.SMMR") == 0x10A
    assert bench.read("RSTC.MR") == 0
    for peripheral in bench.periph.values():
        peripheral.power_off()
    assert bench.clock.next_due() is None
    for peripheral in bench.periph.values():
        peripheral.reset()
    assert bench.read("GPBR.GPBR7") == 0
    assert bench.read("SUPC.SMMR") == 0
    assert bench.read("RSTC.MR") == 1


# Supply.


def test_supply_monitor() -> None:
    bench = Bench()
    bench.write("SUPC.SMMR", 0x210A)
    bench.run_us(100)
    assert bench.read("SUPC.SR") == 0
    bench.rail.set(2.8)
    assert not bench.irq[0]
    bench.run_us(31)
    assert bench.irq[0]
    assert bench.read("SUPC.SR") == 1 << 5 | 1 << 6
    assert not bench.irq[0]
    assert bench.read("SUPC.SR") == 1 << 6
    bench.rail.set(3.0)
    bench.run_us(31)
    assert bench.read("SUPC.SR") == 0


def test_supply_monitor_that_resets_or_is_off() -> None:
    bench = Bench()
    bench.rail.set(2.0)
    bench.run_us(100)
    assert bench.read("SUPC.SR") == 0
    bench.write("SUPC.SMMR", 0x110A)
    bench.run_us(31)
    assert [cause for _, cause in bench.resets] == [0]
    assert bench.read("SUPC.SR") & 1 << 4


def test_slow_crystal() -> None:
    bench = Bench(slow=SlowClock(20_000))
    bench.write("WDT.MR", WDT_1S)
    bench.write("SUPC.CR", 0xA5000008)
    bench.run_us(800_000)
    assert bench.read("SUPC.SR") == 0
    bench.write("WDT.CR", FEED)
    bench.run_us(200_000)
    assert bench.read("SUPC.SR") == 1 << 7
    bench.run_us(890_000)
    assert len(bench.resets) == 1


# Converter.

ADC_MR = 0x1F081400 | 1 << 28  # 84 MHz / 42, start-up 512 clocks, tracking 16


def _adc(mode: int = ADC_MR) -> tuple[Bench, Adc]:
    bench = Bench()
    bench.full_speed()
    bench.enable(37)
    adc = bench.periph["ADC"]
    assert isinstance(adc, Adc)
    bench.write("ADC.MR", mode)
    return bench, adc


def test_single_conversion() -> None:
    bench, adc = _adc()
    adc.volts[7] = 1.65
    bench.write("ADC.CHER", 1 << 7)
    bench.write("ADC.CR", 2)
    bench.run_us(270)
    assert bench.read("ADC.ISR") == 0
    bench.run_us(10)  # 512 + 36 clocks of 0.5 us
    assert bench.read("ADC.ISR") == DRDY | 1 << 7
    assert bench.read("ADC.CDR7") == 2048
    assert bench.read("ADC.ISR") == DRDY
    assert bench.read("ADC.LCDR") == 2048
    assert bench.read("ADC.ISR") == 0
    adc.volts[7] = lambda: 5.0
    bench.write("ADC.CR", 2)
    bench.run_us(19)  # warm now
    assert bench.read("ADC.CDR7") == 4095


def test_sequence_with_interrupt_and_overrun() -> None:
    bench, adc = _adc()
    adc.volts.update({1: 0.33, 2: 3.3})
    bench.write("ADC.IER", 1 << 2)
    bench.write("ADC.CHER", 0b110)
    bench.write("ADC.CR", 2)
    start = bench.clock.now
    bench.run_us(1000)
    assert bench.irq_rises[37] == [start + (512 + 72) * 42]
    assert bench.read("ADC.ISR") & GOVRE
    assert (bench.read("ADC.CDR1"), bench.read("ADC.CDR2")) == (410, 4095)
    assert not bench.irq[37]


def test_free_running() -> None:
    bench, adc = _adc(ADC_MR | 1 << 7)
    adc.volts[0] = 1.0
    bench.write("ADC.CHER", 1)
    bench.run_us(1e6)
    assert bench.read("ADC.CDR0") == 1241
    assert bench.read("ADC.OVER") == 1
    adc.volts[0] = 2.0
    bench.run_us(40)
    assert bench.read("ADC.CDR0") == 2482


def test_converter_rules() -> None:
    bench, _ = _adc()
    for steps, told in (
        ([("MR", 0x100)], "21000000 Hz is outside"),
        ([("CR", 2)], "without a channel"),
        ([("MR", ADC_MR | 1)], "are unknown"),
        ([("WPMR", 0x41444301), ("CHER", 1)], "write protected"),
    ):
        with pytest.raises(BusViolation, match=told):
            for register, value in steps:
                bench.write(f"ADC.{register}", value)


# Timer.


def _timer(mode: int, rc: int = 0) -> Bench:
    bench = Bench()
    bench.full_speed()
    bench.enable(27)
    bench.write("TC0_0.CMR", mode)
    bench.write("TC0_0.RC", rc)
    return bench


@pytest.mark.parametrize(("clock", "divider"), [(0, 2), (1, 8), (2, 32), (3, 128)])
def test_free_counter(clock: int, divider: int) -> None:
    bench = _timer(0x8000 | clock)
    bench.write("TC0_0.CCR", 5)
    bench.run_us(1000)
    assert bench.read("TC0_0.CV") == 84_000 // divider
    bench.clock.advance(bench.clock.now + divider * 2**32)
    assert bench.read("TC0_0.CV") == 84_000 // divider
    assert bench.read("TC0_0.SR") & 1
    bench.write("TC0_0.CCR", 2)
    bench.run_us(1000)
    assert bench.read("TC0_0.CV") == 84_000 // divider


def test_compare_c_interrupts_each_period() -> None:
    bench = _timer(0xC000 | 1, 10_500)
    bench.write("TC0_0.IER", 1 << 4)
    bench.write("TC0_0.CCR", 5)
    start = bench.clock.now
    for period in range(1, 4):
        bench.run_us(1000)
        assert bench.irq[27]
        assert bench.irq_rises[27][-1] == start + period * TICKS_PER_S // 1000
        assert bench.read("TC0_0.SR") & 1 << 4
        assert not bench.irq[27]
        assert bench.read("TC0_0.CV") == 0


def test_compare_a_once_in_a_free_run() -> None:
    bench = _timer(0x8000)
    bench.write("TC0_0.RA", 420)
    bench.write("TC0_0.IER", 1 << 2)
    bench.write("TC0_0.CCR", 5)
    start = bench.clock.now
    bench.clock.advance(start + 840)
    assert bench.read("TC0_0.SR") & 1 << 2
    bench.run_us(100)
    assert not bench.read("TC0_0.SR") & 1 << 2
    assert bench.irq_rises[27] == [start + 840]
    bench.write("TC0_0.RA", bench.read("TC0_0.CV") + 42)
    bench.run_us(2)
    assert bench.read("TC0_0.SR") & 1 << 2
    assert len(bench.irq_rises[27]) == 2


def test_timer_rules() -> None:
    bench = _timer(0x8000)
    with pytest.raises(BusViolation, match="clock not modelled"):
        bench.write("TC0_0.CMR", 5)
    bench.write("TC0_0.CCR", 5)
    with pytest.raises(BusViolation, match="while the channel counts"):
        bench.write("TC0_0.CMR", 0)
    with pytest.raises(BusViolation, match="clock is off"):
        bench.read("TC0_1.CV")


# The rest.


def test_identity_and_matrix() -> None:
    bench = Bench()
    assert bench.read("CHIPID.CIDR") == 0x285E0A60
    bench.write("MATRIX.MATRIX_SCFG0", 0x00010040)
    assert bench.read("MATRIX.MATRIX_SCFG0") == 0x00010040
    assert bench.periph["MATRIX"].erase_pin_is_gpio is False  # type: ignore[attr-defined]
    bench.write("MATRIX.CCFG_SYSIO", 1 << 12)
    assert bench.periph["MATRIX"].erase_pin_is_gpio is True  # type: ignore[attr-defined]
