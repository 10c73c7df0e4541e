"""What a bad line does, fault by fault, without a board behind it."""

from __future__ import annotations

import pytest

from tailbeat.board.fish import Fish
from tailbeat.core.errors import ConnectError, InputError, LinkLostError
from tailbeat.link import _dialect as mavlink
from tailbeat.link.frames import Framer
from tailbeat.link.impaired import (
    Corrupt,
    Cut,
    Delay,
    Drop,
    Duplicate,
    Fault,
    HalfOpen,
    ImpairedLine,
    Standstill,
    Truncate,
    faults_of,
    hc05,
)

COUNT = 2000


class Echo:
    """A transport in virtual time: what is written can be read at once."""

    def __init__(self) -> None:
        self.name = "echo"
        self.time_s = 0.0
        self.held = b""
        self.reopened = 0

    def read(self) -> bytes:
        data, self.held = self.held, b""
        return data

    def write(self, data: bytes) -> None:
        self.held += data

    def wait(self, timeout_s: float) -> None:
        self.time_s += 0.0 if self.held else timeout_s

    def now_s(self) -> float:
        return self.time_s

    def reopen(self) -> None:
        self.reopened += 1

    def close(self) -> None:
        pass


def frames(count: int = COUNT) -> list[bytes]:
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    out = []
    for number in range(count):
        message = mavlink.MAVLink_tailbeat_live_message(number, 0.1, 0.2, 0.3, 0, 0, 0, 5, 4500)
        out.append(message.pack(mav))
        mav.seq = (mav.seq + 1) & 255
    return out


def through(
    line: ImpairedLine, sent: list[bytes], step_s: float = 0.001
) -> list[tuple[float, bytes]]:
    """(when, bytes) that came back, the frames sent ``step_s`` apart."""
    got = []

    def listen(until_s: float) -> None:
        while line.now_s() < until_s:
            line.wait(until_s - line.now_s())
            if data := line.read():
                got.append((line.now_s(), data))

    for number, frame in enumerate(sent):
        line.write(frame)
        listen((number + 1) * step_s)
    listen(line.now_s() + 10.0)
    return got


def numbers(data: bytes) -> list[int]:
    framer = Framer(mavlink.MAVLink(None))
    return [message.time_boot_ms for message in framer.push(data)]


def come_through(faults: list[Fault], seed: int = 1, count: int = COUNT) -> list[int]:
    got = through(ImpairedLine(Echo(), up=faults, seed=seed), frames(count))
    return numbers(b"".join(data for _, data in got))


def test_a_line_without_faults_changes_nothing() -> None:
    sent = frames(50)
    junk = [b"junk", *sent[:10], b"\xfd\x00", *sent[10:], b"\xfd\xff\xff"]
    line = ImpairedLine(Echo())
    got = b"".join(data for _, data in through(line, junk))
    assert b"".join(junk).startswith(got)
    assert numbers(got) == list(range(50))


@pytest.mark.parametrize("cut", [1, 7, 33, 100])
def test_frames_are_frames_however_the_bytes_come(cut: int) -> None:
    stream = b"".join(frames(300))
    pieces = [stream[at : at + cut] for at in range(0, len(stream), cut)]
    got = through(ImpairedLine(Echo(), up=[Drop(0.5)]), pieces)
    whole = b"".join(data for _, data in got)
    assert len(numbers(whole)) * len(frames(1)[0]) == len(whole)
    assert 100 < len(numbers(whole)) < 200


def test_the_fraction_is_lost() -> None:
    kept = come_through([Drop(0.2)])
    assert len(kept) / COUNT == pytest.approx(0.8, abs=0.03)
    assert kept == sorted(kept)
    assert come_through([Drop(1.0, lambda frame: frame[10] == 7)]).count(7) == 0


def test_bytes_go_wrong_at_the_rate() -> None:
    sent = b"".join(frames())
    got = b"".join(d for _, d in through(ImpairedLine(Echo(), up=[Corrupt(1e-2)]), frames()))
    assert len(got) == len(sent)
    wrong = sum(a != b for a, b in zip(sent, got, strict=True))
    assert wrong / len(sent) == pytest.approx(1e-2, rel=0.1)


def test_twice_and_short() -> None:
    assert len(come_through([Duplicate(0.3)])) / COUNT == pytest.approx(1.3, abs=0.03)
    short = through(ImpairedLine(Echo(), up=[Truncate(1.0)]), frames(500))
    assert sum(len(data) for _, data in short) < 0.6 * len(b"".join(frames(500)))


def test_a_delay_keeps_the_order_and_its_limits() -> None:
    line = ImpairedLine(Echo(), up=[Delay(0.02, 0.05, tail=0.1, tail_s=(0.1, 0.4))])
    got = through(line, frames(200), step_s=1.0)
    late_s = [when - n for when, data in got for n in numbers(data)]
    assert [n for _, data in got for n in numbers(data)] == list(range(200))
    assert 0.02 <= min(late_s) < 0.025
    assert 0.35 < max(late_s) <= 0.4 + 1e-9
    assert 0.04 < sorted(late_s)[len(late_s) * 8 // 10] < 0.05


def test_when_the_wait_is_over() -> None:
    line = ImpairedLine(Echo(), up=[Delay(0.03, 0.03)])
    line.write(frames(1)[0])
    line.wait(1.0)
    assert line.now_s() == pytest.approx(0.03)
    assert numbers(line.read()) == [0]
    line.wait(0.5)
    assert line.now_s() == pytest.approx(0.53)


@pytest.mark.parametrize("shuffle", [False, True])
def test_a_stall_holds_and_then_lets_all_go(shuffle: bool) -> None:
    line = ImpairedLine(Echo(), up=[Standstill(1.0, 0.4, shuffle)])
    got = through(line, frames(100), step_s=0.01)
    order = [n for _, data in got for n in numbers(data)]
    assert sorted(order) == list(range(100))
    assert (order == sorted(order)) is not shuffle
    assert not [when for when, _ in got if 0.62 < when < 1.0]


def test_one_way_dies_and_comes_back() -> None:
    kept = through(ImpairedLine(Echo(), up=[HalfOpen(0.2, 0.5)]), frames(100), step_s=0.01)
    lost = set(range(100)) - {n for _, data in kept for n in numbers(data)}
    assert lost == set(range(20, 50))


def test_a_cut_is_a_cut_until_it_is_opened_again() -> None:
    line = ImpairedLine(Echo(), up=[Cut(at_bytes=500, closed_s=2.0)])
    with pytest.raises(LinkLostError):
        through(line, frames(100))
    for use in (line.read, lambda: line.write(b"x")):
        with pytest.raises(LinkLostError, match="broke"):
            use()
    line.wait(0.1)
    with pytest.raises(ConnectError):
        line.reopen()
    line.inner.time_s = 3.0
    line.reopen()
    for frame in frames(100):
        line.write(frame)
    assert len(numbers(line.read())) == 100


def test_an_address_with_a_line() -> None:
    with Fish.connect("sim:tank?line=drop=0.2,delay=hc05&seed=3") as fish:
        assert isinstance(fish.transport, ImpairedLine)
        assert fish.sim is not None and fish.sim.seed == 3
        assert fish.status().state == "IDLE"
    with pytest.raises(InputError, match="line"):
        Fish.connect("sim?line=noise")


def test_same_seed_same_faults() -> None:
    def run(seed: int) -> list[int]:
        return come_through([Drop(0.1), Corrupt(1e-3), Duplicate(0.1), hc05()], seed, 200)

    assert run(3) == run(3)
    assert run(3) != run(4)


def test_a_line_in_words() -> None:
    up, down = faults_of("drop=0.2,errors=1e-3,delay=hc05,twice=0.1,short=0.05,stall=5:1")
    assert [type(fault).__name__ for fault in up] == [
        "Drop", "Corrupt", "Delay", "Duplicate", "Truncate", "Standstill",
    ]  # fmt: skip
    assert len(down) == len(up)
    assert all(a is not b for a, b in zip(up, down, strict=True))
    assert faults_of("delay=0.1:0.2")[0] == [Delay(0.1, 0.2)]
    assert faults_of("") == ([], [])


@pytest.mark.parametrize(
    "text", ["drop", "drop=2", "drop=x", "delay=1", "noise=1", "stall=1:2", "delay=5:1"]
)
def test_words_that_are_none(text: str) -> None:
    with pytest.raises(InputError, match="line"):
        faults_of(text)
