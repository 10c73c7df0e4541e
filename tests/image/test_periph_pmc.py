"""Clock tree: the good way up, and every step that the chip would not forgive."""

from __future__ import annotations

import pytest

from vboard.core.bus import BusViolation
from vboard.core.clock import TICKS_PER_S
from vboard.periph.bench import Bench
from vboard.periph.supply import SlowClock

pytestmark = pytest.mark.usefixtures("both_models")

MOSCXTS, LOCKA, MCKRDY, MOSCSELS, MOSCRCS = 1, 2, 8, 1 << 16, 1 << 17
CFDEV, CFDS = 1 << 18, 1 << 19


def test_starts_on_the_4_mhz_rc() -> None:
    bench = Bench()
    assert (bench.mck_hz(), bench.mck_ticks()) == (4_000_000, 21)
    assert bench.read("PMC.PMC_SR") == 0x00010008
    bench.run_us(20)
    assert bench.read("PMC.PMC_SR") & MOSCRCS


def test_way_to_84_mhz_and_its_times() -> None:
    bench = Bench()
    bench.write("EEFC0.FMR", 0x400)
    bench.write("EEFC1.FMR", 0x400)
    bench.write("PMC.CKGR_MOR", 0x00370809)
    bench.run_us(1900)
    assert not bench.read("PMC.PMC_SR") & MOSCXTS
    bench.run_us(100)  # 64 slow clocks: 1953 us
    assert bench.read("PMC.PMC_SR") & MOSCXTS
    bench.write("PMC.CKGR_MOR", 0x01370809)
    assert not bench.read("PMC.PMC_SR") & MOSCSELS
    bench.run_us(5)
    assert bench.read("PMC.PMC_SR") & MOSCSELS
    assert bench.mck_hz() == 12_000_000
    bench.run_us(500)
    assert bench.read("PMC.CKGR_MCFR") == 1 << 16 | 12_000_000 * 16 // 32768
    bench.write("PMC.CKGR_PLLAR", 0x200D3F01)
    bench.run_us(1900)
    assert not bench.read("PMC.PMC_SR") & LOCKA
    bench.run_us(50)
    assert bench.read("PMC.PMC_SR") & LOCKA
    for value, hz in ((0x11, 6_000_000), (0x12, 84_000_000)):
        bench.write("PMC.PMC_MCKR", value)
        assert not bench.read("PMC.PMC_SR") & MCKRDY
        bench.run_us(5)
        assert bench.read("PMC.PMC_SR") & MCKRDY
        assert bench.mck_hz() == hz
        assert bench.mck_ticks() == TICKS_PER_S // hz


def test_dead_crystal_never_gets_ready_but_the_rc_serves_the_pll() -> None:
    bench = Bench(crystal=False)
    bench.run_us(20)
    bench.write("PMC.CKGR_MOR", 0x00370809)
    bench.run_us(1_000_000)
    assert not bench.read("PMC.PMC_SR") & MOSCXTS
    bench.write("PMC.CKGR_MOR", 0x00370028)
    bench.run_us(20)
    assert bench.read("PMC.PMC_SR") & MOSCRCS
    assert bench.mck_hz() == 12_000_000


def test_failure_detector_tells_a_dead_crystal_that_gets_ready_by_time() -> None:
    bench = Bench(crystal=False)
    bench.periph["PMC"].moscxts_by_time = True
    bench.run_us(20)
    bench.write("PMC.CKGR_MOR", 0x00370809)
    bench.run_us(2000)
    assert bench.read("PMC.PMC_SR") & (MOSCXTS | CFDS) == MOSCXTS
    bench.write("PMC.CKGR_MOR", 0x02370809)
    bench.run_us(70)
    assert bench.read("PMC.PMC_SR") & (CFDEV | CFDS) == CFDEV | CFDS
    assert bench.read("PMC.PMC_SR") & (CFDEV | CFDS) == CFDS


def test_selecting_a_dead_crystal_without_the_detector_stops_the_chip() -> None:
    bench = Bench(crystal=False)
    bench.periph["PMC"].moscxts_by_time = True
    bench.run_us(20)
    bench.write("PMC.CKGR_MOR", 0x00370809)
    bench.run_us(2000)
    with pytest.raises(BusViolation, match="dead crystal"):
        bench.write("PMC.CKGR_MOR", 0x01370809)


def test_crystal_that_dies_later_throws_the_chip_onto_the_rc() -> None:
    bench = Bench()
    bench.full_speed()
    bench.write("PMC.CKGR_MOR", 0x03370809)
    bench.write("PMC.PMC_IER", CFDEV)
    bench.periph["PMC"].fail_crystal()
    bench.run_us(70)
    assert bench.irq[5]
    assert bench.mck_hz() == 2_000_000  # 4 MHz, and the divider by two is still there


@pytest.mark.parametrize("rc_hz", [20_000, 44_000])
def test_slow_rc_stretches_the_waits(rc_hz: int) -> None:
    bench = Bench(slow=SlowClock(rc_hz))
    bench.write("PMC.CKGR_MOR", 0x00370809)
    bench.run_us(64e6 / rc_hz - 5)
    assert not bench.read("PMC.PMC_SR") & MOSCXTS
    bench.run_us(10)
    assert bench.read("PMC.PMC_SR") & MOSCXTS


def test_peripheral_clocks() -> None:
    bench = Bench()
    with pytest.raises(BusViolation, match="clock is off"):
        bench.write("PWM.ENA", 1)
    bench.enable(36, 17)
    assert (bench.read("PMC.PMC_PCSR0"), bench.read("PMC.PMC_PCSR1")) == (1 << 17, 1 << 4)
    bench.read("PWM.SR")
    bench.write("PMC.PMC_PCDR1", 1 << 4)
    with pytest.raises(BusViolation, match="clock is off"):
        bench.read("PWM.SR")


BAD_STEPS = {
    "without its key": [("CKGR_MOR", 0x00000809, 0)],
    "before it runs": [("CKGR_MOR", 0x00370809, 100), ("CKGR_MOR", 0x01370809, 0)],
    "before it is locked": [("PMC_MCKR", 0x11, 10), ("PMC_MCKR", 0x12, 0)],
    "source and prescaler": [("PMC_MCKR", 0x12, 0)],
    "before MCKRDY": [("PMC_MCKR", 0x11, 0), ("PMC_MCKR", 0x21, 0)],
    "PLL A input": [("CKGR_PLLAR", 0x200D3F01, 0)],
    "without bit 29": [("CKGR_PLLAR", 0x000D3F01, 0)],
    "does not run": [("CKGR_MOR", 0x00370801, 0)],
    "are unknown": [("PMC_MCKR", 0x80000001, 0)],
    "no whole number": [("CKGR_MOR", 0x00370018, 0)],
    "no clock to switch": [("PMC_PCER0", 1, 0)],
}


@pytest.mark.parametrize("told", BAD_STEPS)
def test_wrong_steps_are_told(told: str) -> None:
    bench = Bench()
    bench.run_us(20)
    with pytest.raises(BusViolation, match=told):
        for register, value, wait_us in BAD_STEPS[told]:
            bench.write(f"PMC.{register}", value)
            bench.run_us(wait_us)


def _pll_locked(bench: Bench) -> None:
    bench.write("PMC.CKGR_MOR", 0x00370809)
    bench.run_us(2100)
    bench.write("PMC.CKGR_MOR", 0x01370809)
    bench.run_us(10)
    bench.write("PMC.CKGR_PLLAR", 0x200D3F01)
    bench.run_us(2000)


def test_flash_too_slow_for_the_clock() -> None:
    bench = Bench()
    bench.write("EEFC0.FMR", 0x300)
    bench.write("EEFC1.FMR", 0x400)
    _pll_locked(bench)
    bench.write("PMC.PMC_MCKR", 0x11)
    bench.run_us(10)
    with pytest.raises(BusViolation, match="3 flash wait states is too fast"):
        bench.write("PMC.PMC_MCKR", 0x12)


def test_flash_made_too_slow_at_speed() -> None:
    bench = Bench()
    bench.full_speed()
    with pytest.raises(BusViolation, match="0 flash wait states is too fast"):
        bench.write("EEFC1.FMR", 0)


def test_above_84_mhz() -> None:
    bench = Bench()
    bench.write("EEFC0.FMR", 0x400)
    bench.write("EEFC1.FMR", 0x400)
    _pll_locked(bench)
    with pytest.raises(BusViolation, match="above 84000000"):
        bench.write("PMC.PMC_MCKR", 0x2)


def test_clock_change_under_a_running_pwm() -> None:
    bench = Bench()
    bench.full_speed()
    bench.enable(36)
    bench.write("PWM.CPRD0", 1000)
    bench.write("PWM.ENA", 1)
    with pytest.raises(BusViolation, match="while PWM channel 0 runs"):
        bench.write("PMC.PMC_MCKR", 0x22)


def test_write_protection() -> None:
    bench = Bench()
    with pytest.raises(BusViolation, match="without its key"):
        bench.write("PMC.PMC_WPMR", 1)
    bench.write("PMC.PMC_WPMR", 0x504D4301)
    with pytest.raises(BusViolation, match="write protected"):
        bench.write("PMC.PMC_PCER0", 1 << 17)


def test_reset_goes_back_to_the_rc() -> None:
    bench = Bench()
    bench.full_speed()
    bench.enable(17)
    for peripheral in bench.periph.values():
        peripheral.reset()
    assert bench.mck_hz() == 4_000_000
    assert bench.read("PMC.PMC_PCSR0") == 0
    assert bench.read("PMC.PMC_SR") == 0x00010008
