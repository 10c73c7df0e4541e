"""PWM channels and what they make of a pin."""

from __future__ import annotations

import pytest

from vboard.core.bus import BusViolation
from vboard.core.clock import TICKS_PER_US
from vboard.periph.bench import Bench
from vboard.periph.pins import PinTrace
from vboard.periph.pio import Pio
from vboard.periph.pwm import Pwm

pytestmark = pytest.mark.usefixtures("both_models")

COUNT = 28  # clock ticks of 1/3 us
FRAME = 60_000 * COUNT
PIN = 1 << 21
LOW4 = 1 << (16 + 4)


def _bench(duty: int = 4500, cmr: int = 0xB) -> tuple[Bench, PinTrace, list[tuple[int, ...]]]:
    """Channel 4 at 50 Hz and 3 MHz, as the servo has it, before it is enabled."""
    bench = Bench()
    pwm, pio = bench.periph["PWM"], bench.periph["PIOC"]
    assert isinstance(pwm, Pwm) and isinstance(pio, Pio)
    trace = PinTrace(bench.clock, 21, 4)
    trace.connect(pio, pwm)
    periods: list[tuple[int, ...]] = []
    pwm.on_period.append(lambda *period: periods.append(period))
    bench.full_speed()
    bench.enable(13, 36)
    for register, value in (
        ("PWM.CLK", 0x1C),
        ("PWM.CMR4", cmr),
        ("PWM.CPRD4", 60_000),
        ("PWM.CDTY4", duty),
    ):
        bench.write(register, value)
    return bench, trace, periods


def _drive_low(bench: Bench) -> None:
    for register in ("CODR", "OER", "PER", "PUDR"):
        bench.write(f"PIOC.{register}", PIN)
    bench.run_us(1)


def _hand_over(bench: Bench) -> None:
    bench.write("PIOC.ABSR", PIN)
    bench.write("PIOC.PDR", PIN)


def test_pulses_at_the_pin() -> None:
    bench, trace, periods = _bench()
    _drive_low(bench)
    start = bench.clock.now
    bench.write("PWM.ENA", 1 << 4)
    bench.run_us(5000)
    _hand_over(bench)
    bench.run_us(15_000)
    bench.write("PWM.CDTYUPD4", 2700)
    bench.write("PWM.CDTYUPD4", 6300)
    bench.run_us(60_000)
    assert periods[:3] == [
        (4, start, 60_000, 4500),
        (4, start + FRAME, 60_000, 4500),
        (4, start + 2 * FRAME, 60_000, 6300),
    ]
    pulses = trace.pulses()[1:]  # the first is the pull-up at reset
    assert [(p.start, p.ticks) for p in pulses] == [
        (start + FRAME, 4500 * COUNT),
        (start + 2 * FRAME, 6300 * COUNT),
        (start + 3 * FRAME, 6300 * COUNT),
    ]


def test_pin_is_high_by_its_pull_up_until_it_is_driven() -> None:
    bench, trace, _ = _bench()
    bench.run_us(100)
    at = bench.clock.now
    assert trace.level()
    _drive_low(bench)
    assert not trace.level()
    assert [(p.start, p.ticks) for p in trace.pulses()] == [(0, at)]
    assert trace.longest_high() == at
    bench.periph["PIOC"].reset()
    assert trace.level()
    bench.run_us(1)
    bench.periph["PIOC"].power_off()
    assert not trace.level()


def test_channel_that_does_not_run_leaves_pwml_high() -> None:
    bench, trace, _ = _bench()
    _drive_low(bench)
    _hand_over(bench)
    assert trace.level()


def test_hand_over_within_a_pulse_shows_the_rest_of_it() -> None:
    bench, trace, _ = _bench()
    _drive_low(bench)
    start = bench.clock.now
    bench.write("PWM.ENA", 1 << 4)
    bench.run_us(1000)
    _hand_over(bench)
    bench.run_us(1000)
    pulse = trace.pulses()[-1]
    assert (pulse.start, pulse.ticks) == (start + 1000 * TICKS_PER_US, 500 * TICKS_PER_US)


def test_override_by_update_leaves_pulses_whole() -> None:
    bench, trace, periods = _bench()
    _drive_low(bench)
    bench.write("PWM.OOV", 0)
    bench.write("PWM.OSS", LOW4)
    _hand_over(bench)
    start = bench.clock.now
    bench.write("PWM.ENA", 1 << 4)
    bench.run_us(5000)
    bench.write("PWM.OSCUPD", LOW4)
    bench.run_us(15_500)
    bench.write("PWM.OSSUPD", LOW4)  # half a millisecond into the pulse
    bench.run_us(40_000)
    assert [high for *_, high in periods] == [0, 4500, 0, 0]
    assert [(p.start, p.ticks) for p in trace.pulses()[1:]] == [(start + FRAME, 4500 * COUNT)]
    assert bench.read("PWM.OS") == LOW4


def test_override_at_once_cuts_the_pulse() -> None:
    bench, trace, _ = _bench()
    _drive_low(bench)
    bench.write("PWM.ENA", 1 << 4)
    _hand_over(bench)
    bench.run_us(500)
    bench.write("PWM.OSS", LOW4)
    bench.run_us(5000)
    assert trace.pulses()[-1].ticks == 500 * TICKS_PER_US


def test_listener_at_the_pin_hears_no_pulse_while_the_pin_is_held() -> None:
    bench, trace, _ = _bench()
    seen: list[int] = []
    trace.on_pulse.append(lambda start, period, high: seen.append(high))
    _drive_low(bench)
    bench.write("PWM.ENA", 1 << 4)
    bench.run_us(20_100)
    _hand_over(bench)
    bench.run_us(20_000)
    assert seen == [0, 0, 4500]


@pytest.mark.parametrize(("cmr", "high"), [(0xB, 4500), (0x20B, 55_500)])
def test_polarity(cmr: int, high: int) -> None:
    bench, _, periods = _bench(cmr=cmr)
    bench.write("PWM.ENA", 1 << 4)
    pwm = bench.periph["PWM"]
    assert isinstance(pwm, Pwm)
    assert periods[0][3] == high
    assert pwm.high_counts(4, "H") == 60_000 - high
    low, turn = pwm.waveform(4)
    assert low == (cmr == 0xB)
    assert turn == bench.clock.now + 4500 * COUNT
    assert pwm.waveform(4, "H")[0] != low


def test_period_interrupt_count_and_stop() -> None:
    bench, _, periods = _bench()
    bench.write("PWM.IER1", 1 << 4)
    start = bench.clock.now
    bench.write("PWM.ENA", 1 << 4)
    bench.run_us(10_000)
    assert bench.read("PWM.CCNT4") == 30_000
    assert not bench.irq[36]
    bench.run_us(10_001)
    assert bench.irq[36]
    assert bench.irq_rises[36] == [start + FRAME]
    assert bench.read("PWM.ISR1") == 1 << 4
    assert not bench.irq[36]
    assert bench.read("PWM.ISR1") == 0
    bench.write("PWM.DIS", 1 << 4)
    assert bench.read("PWM.SR") == 1 << 4
    bench.run_us(20_000)
    assert bench.read("PWM.SR") == 0
    assert len(periods) == 2
    assert bench.clock.next_due() is None or bench.clock.next_due() > bench.clock.now + FRAME


def test_new_period_comes_with_the_frame() -> None:
    bench, _, periods = _bench()
    bench.write("PWM.ENA", 1 << 4)
    bench.write("PWM.CPRDUPD4", 30_000)
    bench.write("PWM.CDTYUPD4", 3000)
    bench.run_us(39_000)
    assert [p[2:] for p in periods] == [(60_000, 4500), (30_000, 3000), (30_000, 3000)]


@pytest.mark.parametrize(
    ("register", "value", "told"),
    [
        ("CDTY4", 1, "CDTY4 written while the channel runs"),
        ("CPRD4", 1, "CPRD4 written while the channel runs"),
        ("CMR4", 0, "CMR4 written while the channel runs"),
        ("CLK", 1, "CLK written while PWM channel 4 runs"),
        ("CDTYUPD4", 0x10000, "does not fit in 16 bits"),
        ("CDTYUPD5", 1, "while the channel is off"),
        ("ENA", 1 << 5, "duty 0 of a period of 0"),
        ("SCM", 1, "are unknown"),
    ],
)
def test_what_no_correct_image_does(register: str, value: int, told: str) -> None:
    bench, _, _ = _bench()
    bench.write("PWM.ENA", 1 << 4)
    with pytest.raises(BusViolation, match=told):
        bench.write(f"PWM.{register}", value)


def test_pulse_longer_than_its_period_is_told_when_it_is_taken_over() -> None:
    bench, _, _ = _bench()
    bench.write("PWM.ENA", 1 << 4)
    bench.write("PWM.CDTYUPD4", 60_001)
    with pytest.raises(BusViolation, match="duty 60001"):
        bench.run_us(20_001)


def test_crystal_failure_stretches_the_period_under_way() -> None:
    bench, _, periods = _bench()
    bench.write("PMC.CKGR_MOR", 0x03370809)
    start = bench.clock.now
    bench.write("PWM.ENA", 1 << 4)
    pmc = bench.periph["PMC"]
    pmc.fail_crystal()  # type: ignore[attr-defined]
    bench.run_us(100_000)
    assert len(periods) == 1
    bench.run_us(800_000)  # 84 MHz became 2 MHz
    assert 800 * 1000 < (periods[1][1] - start) / TICKS_PER_US < 841 * 1000


def test_port_rules() -> None:
    bench = Bench()
    with pytest.raises(BusViolation, match="PDSR while its clock is off"):
        bench.read("PIOC.PDSR")
    bench.enable(13)
    assert bench.read("PIOC.PDSR") == 0x7FFFFFFF
    pio = bench.periph["PIOC"]
    assert isinstance(pio, Pio)
    bench.write("PIOC.IER", 1 << 7)
    pio.set_input(7, False)
    assert bench.irq[13]
    assert bench.read("PIOC.ISR") == 1 << 7
    assert not bench.irq[13]
    assert bench.read("PIOC.PDSR") == 0x7FFFFFFF & ~(1 << 7)
    bench.write("PIOC.OWER", 0xF0)
    bench.write("PIOC.ODSR", 0xFFFF)
    assert bench.read("PIOC.ODSR") == 0xF0
    with pytest.raises(BusViolation, match="are unknown"):
        bench.write("PIOC.SODR", 1 << 31)
    bench.write("PIOC.WPMR", 0x50494F01)
    with pytest.raises(BusViolation, match="write protected"):
        bench.write("PIOC.PDR", 1)
    pio.power_off()
    assert not pio.level(5)
