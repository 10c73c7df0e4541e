"""Virtual time and the strict bus."""

from __future__ import annotations

import pytest

from vboard.core.bus import Bus, BusViolation, Peripheral, Reg
from vboard.core.clock import Clock


def test_events_come_in_order_of_time_then_of_scheduling() -> None:
    clock, seen = Clock(), []
    for name, due in (("late", 30), ("first", 10), ("second", 10), ("now", -5)):
        clock.at(due, lambda name=name: seen.append((name, clock.now)))
    clock.cancel(clock.at(20, lambda: seen.append(("cancelled", clock.now))))
    assert clock.next_due() == 0
    clock.advance(29)
    assert seen == [("now", 0), ("first", 10), ("second", 10)]
    assert (clock.now, clock.next_due()) == (29, 30)


def test_an_event_may_schedule_another_for_the_same_time() -> None:
    clock, seen = Clock(), []
    clock.at(5, lambda: clock.after(0, lambda: seen.append(clock.now)))
    clock.advance(5)
    assert seen == [5]


def test_dropping_a_part_leaves_the_rest() -> None:
    clock, seen = Clock(), []
    part = clock.part()
    for number in range(600):
        part.after(number, lambda: seen.append("part"))
    clock.at(7, lambda: seen.append("whole"))
    clock.advance(3)
    assert part.now == 3 and seen == ["part"] * 4
    part.drop()
    part.after(1, lambda: seen.append("after its end"))
    clock.advance(1000)
    assert seen == ["part"] * 4 + ["whole"]


class FakeSoc:
    """Enough for a peripheral without a processor."""

    def __init__(self) -> None:
        self.clock = Clock()

    def pid_clocked(self, pid: int) -> bool:
        return pid != 99


class Indexed(Peripheral):
    registers = (Reg("PLAIN", 0x0), Reg("MANY", 0x10, "rw", 5, 3, 8), Reg("SINK", 0x40, "w"))

    def write_many(self, index: int, value: int) -> None:
        self.values[f"MANY{index}"] = value + index


@pytest.fixture
def bus() -> Bus:
    soc = FakeSoc()
    bus = Bus(soc.clock)
    bus.add(Indexed(soc, "OPEN", 0x40000000, 1))  # type: ignore[arg-type]
    bus.add(Indexed(soc, "STOPPED", 0x40000200, 99))  # type: ignore[arg-type]
    return bus


def test_registers_keep_values_and_know_their_index(bus: Bus) -> None:
    bus.write(0x40000000, 4, 0xFFFFFFFF)
    bus.write(0x40000020, 4, 40)
    assert bus.read(0x40000000, 4) == 0xFFFFFFFF
    assert [bus.read(0x40000010 + 8 * n, 4) for n in range(3)] == [5, 5, 42]


@pytest.mark.parametrize(
    ("address", "width", "write", "words"),
    [
        (0x40000004, 4, False, "unknown register"),
        (0x40000004, 4, True, "unknown register"),
        (0x40000040, 4, False, "SINK, which cannot be"),
        (0x40000000, 1, True, "8 bits"),
        (0x40000002, 2, False, "16 bits"),
        (0x40000200, 4, False, "clock is off"),
        (0x40000200, 4, True, "clock is off"),
        (0x40000400, 4, False, "no peripheral"),
    ],
)
def test_what_no_image_does_is_a_violation(
    bus: Bus, address: int, width: int, write: bool, words: str
) -> None:
    with pytest.raises(BusViolation, match=words):
        if write:
            bus.write(address, width, 0)
        else:
            bus.read(address, width)


def test_trace_keeps_time_name_and_value(bus: Bus) -> None:
    bus.trace = []
    bus.clock.advance(12)
    bus.write(0x40000018, 4, 7)
    bus.read(0x40000018, 4)
    assert [(a.time, a.peripheral, a.register, a.value, a.write) for a in bus.trace] == [
        (12, "OPEN", "MANY1", 7, True),
        (12, "OPEN", "MANY1", 8, False),
    ]
