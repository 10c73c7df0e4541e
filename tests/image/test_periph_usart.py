"""USART, UART, their PDC and the wire."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest

from vboard.core.bus import BusViolation
from vboard.core.clock import TICKS_PER_S
from vboard.periph.bench import RAM_BASE, Bench
from vboard.periph.usart import SerialPort
from vboard.wires.serial_line import GARBLED, SerialLine

pytestmark = pytest.mark.usefixtures("both_models")

RXRDY, TXRDY, ENDRX, ENDTX, OVRE, FRAME = 0x1, 0x2, 0x8, 0x10, 0x20, 0x40
TIMEOUT, TXEMPTY, TXBUFE, RXBUFF = 0x100, 0x200, 0x800, 0x1000
RXTEN, TXTEN, RXTDIS, TXTDIS = 0x1, 0x100, 0x2, 0x200
STTTO, RETTO, RSTSTA = 0x800, 0x8000, 0x100
BRGR = {115200: 0x1005B, 460800: 0x60016, 921600: 0x3000B}
CHAR_TICKS = {115200: 7290, 460800: 1820, 921600: 910}  # of the chip
IRQ = 17


def _bench(baud: int = 115200, line_baud: int | None = None) -> tuple[Bench, SerialLine]:
    bench = Bench()
    bench.full_speed()
    bench.enable(IRQ)
    port = bench.periph["USART0"]
    assert isinstance(port, SerialPort)
    line = SerialLine(bench.clock, line_baud or baud)
    port.connect(line)
    bench.write("PIOA.PDR", 1 << 11)
    bench.write("USART0.MR", 0x808C0)
    bench.write("USART0.BRGR", BRGR[baud])
    bench.write("USART0.CR", 0x50)
    return bench, line


def _receive_into(bench: Bench, *buffers: tuple[int, int]) -> None:
    for (pointer, counter), (place, size) in zip(
        (("RPR", "RCR"), ("RNPR", "RNCR")), buffers, strict=False
    ):
        bench.write(f"USART0.{pointer}", RAM_BASE + place)
        bench.write(f"USART0.{counter}", size)
    bench.write("USART0.PTCR", RXTEN)


def _char_us(baud: int) -> float:
    return 10e6 / baud


def test_byte_by_byte() -> None:
    bench, line = _bench()
    bench.write("USART0.IER", RXRDY)
    line.send(b"ab")
    bench.run_us(86)
    assert not bench.read("USART0.CSR") & RXRDY
    bench.run_us(1)
    assert bench.irq[IRQ]
    assert bench.read("USART0.RHR") == ord("a")
    assert not bench.irq[IRQ]
    bench.run_us(87)
    assert bench.irq[IRQ]
    assert bench.read("USART0.RHR") == ord("b")


def test_overrun_keeps_the_last_byte_and_is_sticky() -> None:
    bench, line = _bench()
    bench.write("USART0.IER", OVRE)
    line.send(b"abc")
    bench.run_us(300)
    assert bench.irq_rises[IRQ] == [bench.irq_rises[IRQ][0]]
    assert bench.read("USART0.RHR") == ord("c")
    assert line.lost.overrun == 2
    assert bench.read("USART0.CSR") & (RXRDY | OVRE) == OVRE
    bench.write("USART0.CR", RSTSTA)
    assert not bench.read("USART0.CSR") & OVRE
    assert not bench.irq[IRQ]


def test_double_buffer_without_an_event_per_byte() -> None:
    bench, line = _bench(921600)
    data = random.Random(1).randbytes(1000)
    _receive_into(bench, (0, 400), (0x1000, 400))
    bench.write("USART0.IER", ENDRX)
    start = bench.clock.now
    line.send(data)
    bench.run_us(400 * _char_us(921600) - 1)
    assert bench.irq[IRQ] is False
    bench.run_us(2)
    assert bench.irq[IRQ]
    rise = bench.irq_rises[IRQ][-1]
    assert rise - start == -(-400 * 10 * TICKS_PER_S // 921600)
    assert (bench.read("USART0.RCR"), bench.read("USART0.RNCR")) == (400, 0)
    assert bytes(bench.ram[:400]) == data[:400]
    bench.write("USART0.RNPR", RAM_BASE)
    bench.write("USART0.RNCR", 400)
    assert not bench.irq[IRQ]
    bench.run_us(600 * _char_us(921600) + 1)
    assert bench.read("USART0.RPR") == RAM_BASE + 200
    assert bytes(bench.ram[0x1000:][:400]) == data[400:800]
    assert bytes(bench.ram[:200]) == data[800:]
    assert bench.read("USART0.CSR") & (RXBUFF | OVRE | RXRDY) == 0


def test_both_buffers_full() -> None:
    bench, line = _bench()
    _receive_into(bench, (0, 4), (0x100, 4))
    bench.write("USART0.IER", RXBUFF)
    line.send(bytes(range(12)))
    bench.run_us(8 * 86.9)
    assert bench.irq[IRQ]
    assert bench.read("USART0.CSR") & (RXBUFF | ENDRX | RXRDY) == RXBUFF | ENDRX
    bench.run_us(4 * 86.9)
    assert bench.read("USART0.CSR") & (RXRDY | OVRE) == RXRDY | OVRE
    assert line.lost.overrun == 3
    bench.write("USART0.RPR", RAM_BASE + 0x200)
    bench.write("USART0.RCR", 4)
    assert bench.ram[0x200] == 11  # the held byte goes first
    assert bench.read("USART0.RCR") == 3
    assert not bench.read("USART0.CSR") & (RXRDY | RXBUFF | ENDRX)


def test_time_out_after_a_message_and_again_after_the_next() -> None:
    bench, line = _bench()
    _receive_into(bench, (0, 4000))
    bench.write("USART0.RTOR", 40)
    bench.write("USART0.CR", STTTO)
    bench.write("USART0.IER", TIMEOUT)
    bench.run_us(100_000)
    assert not bench.irq.get(IRQ)
    silence = 4 * CHAR_TICKS[115200]
    for _ in range(3):
        line.send(b"hello")
        line.send(b"world")
        end = line.queue_end()
        bench.run_us(10_000)
        assert bench.irq_rises[IRQ][-1] == end + silence
        assert bench.irq[IRQ]
        bench.write("USART0.CR", STTTO)
        assert not bench.irq[IRQ]
    assert len(bench.irq_rises[IRQ]) == 3
    assert bench.read("USART0.RCR") == 4000 - 30


def test_time_out_between_messages_that_are_queued_together() -> None:
    bench, line = _bench()
    _receive_into(bench, (0, 4000))
    bench.write("USART0.RTOR", 40)
    bench.write("USART0.CR", STTTO)
    bench.write("USART0.IER", TIMEOUT)
    ends = [line.send(bytes(50), bench.clock.now + k * 840_000) for k in range(20)]
    for end in ends:
        bench.clock.advance(end + 10 * CHAR_TICKS[115200])
        assert bench.irq_rises[IRQ][-1] == end + 4 * CHAR_TICKS[115200]
        bench.write("USART0.CR", STTTO)
    assert len(bench.irq_rises[IRQ]) == 20


def test_time_out_restarted_at_once_comes_without_a_byte() -> None:
    bench, line = _bench()
    bench.write("USART0.RTOR", 1000)
    bench.write("USART0.CR", STTTO)
    bench.write("USART0.IER", TIMEOUT)
    bench.write("USART0.CR", RETTO)
    start = bench.clock.now
    bench.run_us(10_000)
    assert bench.irq_rises[IRQ] == [start + 100 * CHAR_TICKS[115200]]
    bench.write("USART0.CR", STTTO | RETTO)
    assert not bench.irq[IRQ]
    bench.run_us(10_000)
    assert bench.irq[IRQ]
    assert line.lost.overrun == 0


def test_sending_with_the_pdc() -> None:
    bench, line = _bench()
    char = CHAR_TICKS[115200]
    bench.ram[0:10] = b"0123456789"
    bench.ram[0x100:0x103] = b"abc"
    assert bench.read("USART0.CSR") & (ENDTX | TXBUFE | TXRDY | TXEMPTY) == 0xA12
    bench.write("USART0.TPR", RAM_BASE)
    bench.write("USART0.TCR", 10)
    bench.write("USART0.TNPR", RAM_BASE + 0x100)
    bench.write("USART0.TNCR", 3)
    bench.write("USART0.IER", ENDTX)
    start = bench.clock.now
    bench.write("USART0.PTCR", TXTEN)
    assert line.byte_due() == start + char
    assert line.message_due() == start + 13 * char
    for sent in range(8):
        bench.clock.advance(start + sent * char + 1)
        assert bench.read("USART0.TCR") == 8 - sent  # one in the shifter, one in THR
    bench.clock.advance(start + 8 * char)
    assert bench.irq_rises[IRQ] == [start + 8 * char]  # the tenth byte is in THR
    bench.write("USART0.IDR", ENDTX)
    bench.write("USART0.IER", TXBUFE)
    bench.run_us(5000)
    assert bench.irq_rises[IRQ][-1] == start + 11 * char
    bench.write("USART0.IDR", TXBUFE)
    chunks = line.take_timed()
    assert b"".join(chunk.data for chunk in chunks) == b"0123456789abc"
    times = [time for chunk in chunks for time in chunk.times()]
    assert times == [start + (i + 1) * char for i in range(13)]
    assert line.take() == b""
    assert line.byte_due() is None
    assert bench.read("USART0.CSR") & (TXEMPTY | TXRDY) == TXEMPTY | TXRDY


def test_sending_byte_by_byte() -> None:
    bench, line = _bench()
    char = CHAR_TICKS[115200]
    start = bench.clock.now
    bench.write("USART0.THR", 1)
    bench.write("USART0.THR", 2)
    assert not bench.read("USART0.CSR") & TXRDY
    with pytest.raises(BusViolation, match="without TXRDY"):
        bench.write("USART0.THR", 3)
    bench.write("USART0.IER", TXRDY)
    bench.run_us(1000)
    assert bench.irq_rises[IRQ] == [start + char]
    bench.write("USART0.IDR", TXRDY)
    assert line.take() == b"\1\2"
    bench.write("USART0.THR", 3)
    bench.write("USART0.IER", TXEMPTY)
    began = bench.clock.now
    bench.run_us(1000)
    assert bench.irq_rises[IRQ][-1] == began + char


@pytest.mark.parametrize("baud", [115200, 460800, 921600])
def test_echo_at_each_rate(baud: int) -> None:
    bench, line = _bench(baud)
    data = random.Random(baud).randbytes(300)
    _receive_into(bench, (0, 300))
    line.send(data)
    bench.run_us(301 * _char_us(baud))
    bench.write("USART0.TPR", RAM_BASE)
    bench.write("USART0.TCR", 300)
    bench.write("USART0.PTCR", TXTEN)
    bench.run_us(303 * _char_us(baud))
    assert line.take() == data


def test_wrong_rate_garbles_both_ways() -> None:
    bench, line = _bench(115200, line_baud=119500)
    bench.write("USART0.IER", FRAME)
    line.send(b"x")
    bench.run_us(100)
    assert bench.irq[IRQ]
    assert bench.read("USART0.RHR") == ord("x") ^ GARBLED
    bench.write("USART0.THR", ord("y"))
    bench.run_us(100)
    assert line.take() == bytes([ord("y") ^ GARBLED])
    assert (line.lost.garbled_to_chip, line.lost.garbled_from_chip) == (1, 1)
    line.set_baud(118000)
    bench.write("USART0.CR", RSTSTA)
    line.send(b"z")
    bench.run_us(100)
    assert bench.read("USART0.RHR") == ord("z")
    assert not bench.read("USART0.CSR") & FRAME


def test_damage_on_the_wire() -> None:
    bench, line = _bench()
    _receive_into(bench, (0, 100))
    bench.write("USART0.IER", FRAME)
    line.drop(1)
    line.flip(0x80, 2)
    line.break_stop_bit(3)
    start = bench.clock.now
    line.send(b"abcdef")
    bench.run_us(1000)
    assert bench.read("USART0.RCR") == 95
    assert bytes(bench.ram[:5]) == bytes([ord("a"), ord("c") ^ 0x80, *b"def"])
    late = bench.irq_rises[IRQ][0] - (start + 4 * 10 * TICKS_PER_S // 115200)
    assert 0 <= late <= 2  # each run's end is rounded up to a tick
    line.damage_received(0, None)
    line.damage_received(2, 1)
    for byte in b"1234":
        bench.write("USART0.THR", byte)
        bench.run_us(200)
    assert line.take() == b"224"


def test_unplugged_wire_loses_what_ends_meanwhile() -> None:
    bench, line = _bench()
    _receive_into(bench, (0, 100))
    line.send(b"abcdef")
    bench.run_us(2 * 86.9)
    line.cut()
    bench.write("USART0.THR", 7)
    bench.run_us(2 * 86.9)
    line.plug()
    bench.run_us(1000)
    assert bench.read("USART0.RCR") == 96
    assert bytes(bench.ram[:4]) == b"abef"
    assert (line.lost.cut_to_chip, line.lost.cut_from_chip) == (2, 1)


def test_bytes_before_the_receiver_is_on_are_lost() -> None:
    bench, line = _bench()
    bench.write("USART0.CR", 0x20)
    line.send(b"ab")
    bench.run_us(100)
    bench.write("USART0.CR", 0x10)
    bench.run_us(100)
    assert bench.read("USART0.RHR") == ord("b")
    assert line.lost.receiver_off == 1


def test_uart_is_the_same_without_time_out() -> None:
    bench = Bench()
    bench.full_speed()
    bench.enable(8)
    line = SerialLine(bench.clock, 115200)
    port = bench.periph["UART"]
    assert isinstance(port, SerialPort)
    port.connect(line)
    bench.write("PIOA.PDR", 1 << 9)
    bench.write("UART.MR", 0x800)
    bench.write("UART.BRGR", 46)
    bench.write("UART.CR", 0x50)
    line.send(b"q")
    bench.write("UART.THR", ord("a"))
    bench.run_us(100)
    assert (bench.read("UART.RHR"), line.take()) == (ord("q"), b"a")
    for register, value in (("CR", STTTO), ("IER", TIMEOUT), ("BRGR", 0x1005B)):
        with pytest.raises(BusViolation, match="unknown"):
            bench.write(f"UART.{register}", value)


def test_reset_loses_the_byte_in_flight_and_keeps_what_has_arrived() -> None:
    bench, line = _bench()
    _receive_into(bench, (0, 100))
    line.send(b"abc")
    bench.write("USART0.THR", 1)
    bench.run_us(86.9 / 2)
    bench.run_us(86.9)
    bench.write("USART0.THR", 2)
    bench.run_us(60)
    bench.periph["USART0"].reset()
    assert bytes(bench.ram[:3]) == b"ab\0"
    bench.run_us(1000)
    assert line.take() == b"\1"
    assert line.lost.in_flight_at_reset == 1
    assert line.lost.receiver_off == 1
    assert not bench.irq.get(IRQ)


WRONG = {
    "pin is not given": [("PIOA.PER", 1 << 11), ("USART0.THR", 1)],
    "BRGR written while": [("USART0.THR", 1), ("USART0.BRGR", 0x1005B)],
    "transmitter off": [("USART0.CR", 0x80), ("USART0.THR", 1)],
    "is not 8N1": [("USART0.MR", 0x80), ("USART0.CR", 0x10)],
    "without a baud rate": [("USART0.BRGR", 0), ("USART0.THR", 1)],
    "shorter than one byte": [("USART0.RTOR", 8)],
    "the counter changed": [("USART0.RCR", 4), ("USART0.PTCR", 1), ("USART0.RCR", 8)],
    "the pointer changed": [("USART0.RCR", 4), ("USART0.PTCR", 1), ("USART0.RPR", 8)],
    "next pointer changed": [
        ("USART0.RCR", 4),
        ("USART0.RNCR", 4),
        ("USART0.PTCR", 1),
        ("USART0.RNPR", 8),
    ],
    "does not fit in 16 bits": [("USART0.RCR", 0x10000)],
    "write protected": [("USART0.WPMR", 0x55534101), ("USART0.MR", 0x8C0)],
    "bits 0x00000400": [("USART0.IER", 0x400)],
    "is outside RAM|is no memory": [
        ("USART0.TPR", RAM_BASE + 0x18000),
        ("USART0.TCR", 1),
        ("USART0.PTCR", 0x100),
    ],
}


@pytest.mark.parametrize("told", WRONG)
def test_what_no_correct_image_does(told: str) -> None:
    bench, _ = _bench()
    with pytest.raises(BusViolation, match=told):
        for register, value in WRONG[told]:
            bench.write(register, value)


def _look(bench: Bench) -> list[int]:
    """All that shows; the interrupt must be what the flags say."""
    registers = ("CSR", "RPR", "RCR", "RNCR", "TPR", "TCR", "IMR")
    values = [bench.read(f"USART0.{register}") for register in registers]
    assert bool(values[0] & values[-1]) == bool(bench.irq.get(IRQ))
    return values


def _session(seed: int, looks: bool) -> tuple[object, ...]:
    """Random traffic both ways with all interrupts that do not need a byte-wise handler; whether
    somebody looks in between must not matter."""
    bench, line = _bench(460800)
    chance, looking = random.Random(seed), random.Random(seed + 1)
    seen: list[list[int]] = []
    _receive_into(bench, (0, 3000), (0x1000, 3000))
    bench.write("USART0.RTOR", 40)
    bench.write("USART0.CR", STTTO)
    bench.write("USART0.IER", ENDRX | RXBUFF | TIMEOUT | OVRE | FRAME)
    for _ in range(40):
        if chance.random() < 0.1:
            line.break_stop_bit(chance.randrange(50))
        at = bench.clock.now + chance.randrange(0, 40_000)
        line.send(chance.randbytes(chance.randrange(1, 400)), at)
        end = bench.clock.now + chance.randrange(1, 1_500_000)
        bench.ram[0x8000:0x8040] = bytes(range(64))
        if bench.read("USART0.TCR") == 0:
            bench.write("USART0.TPR", RAM_BASE + 0x8000)
            bench.write("USART0.TCR", chance.randrange(1, 64))
            bench.write("USART0.IER", ENDTX)
            bench.write("USART0.PTCR", TXTEN)
        while bench.clock.now < end:
            step = looking.randrange(1, 9000) if looks else end - bench.clock.now
            bench.clock.advance(min(end, bench.clock.now + step))
            if looks:
                _look(bench)
        seen.append(_look(bench))
        status = seen[-1][0]
        if status & TIMEOUT:
            bench.write("USART0.CR", STTTO)
        if status & (OVRE | FRAME):
            bench.write("USART0.CR", RSTSTA)
    sent = line.take()
    return seen, bench.irq_rises, bytes(bench.ram), sent, line.lost.overrun


@pytest.mark.parametrize("seed", range(8))
def test_looking_at_it_changes_nothing(seed: int) -> None:
    assert _session(seed, looks=True) == _session(seed, looks=False)


def test_a_long_stream_costs_an_event_per_buffer() -> None:
    bench, line = _bench(921600)
    _receive_into(bench, (0, 1000), (0x1000, 1000))
    bench.write("USART0.IER", ENDRX)
    line.send(bytes(20_000))
    events = 0
    while (due := bench.clock.next_due()) is not None and line.queued():
        bench.clock.advance(due)
        events += 1
        if bench.irq[IRQ]:
            bench.write("USART0.RNPR", RAM_BASE)
            bench.write("USART0.RNCR", 1000)
    assert events == 20
    gaps = {b - a for a, b in pairwise(bench.irq_rises[IRQ])}
    assert max(gaps) - min(gaps) <= 1
