"""A radio module at its factory speed is recognised by what comes through it, and nothing else is
taken for one."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest

from tailbeat.board import connect
from tailbeat.board.diagnostics import examine
from tailbeat.board.diagnostics.evidence import PROBLEM
from tailbeat.board.fish import Fish
from tailbeat.core.errors import ConnectError
from tailbeat.link import _dialect as mavlink
from tailbeat.link.transport import Hearing
from tailbeat.sim.board import SimBoard, SimTransport

from ..radio_model import FAST, SLOW, Burst, Recorded, board_bursts, flat, heartbeat, received


def kind_of(bursts: list[Burst]) -> str:
    hearing = Hearing("x")
    assert connect.hear_board(Recorded(bursts), connect.LISTEN_S, hearing) is None
    return hearing.kind


def test_the_sampler_reads_what_is_sent_at_its_own_speed() -> None:
    data = bytes(range(256))
    assert flat(received([(0.5, data)], FAST, FAST, False)) == data
    assert flat(received([(0.5, data)], SLOW, SLOW, False)) == data
    assert flat(received([(0.5, data)], FAST, SLOW, True)) != data


@pytest.mark.parametrize("keep_bad", [True, False])
def test_a_module_at_9600_baud_is_recognised(keep_bad: bool) -> None:
    bursts = board_bursts(24.0)
    garbage = received(bursts, FAST, SLOW, keep_bad)
    for tenth in range(210):  # whenever somebody begins to listen
        begin = tenth / 10
        part = [(t - begin, data) for t, data in garbage if begin <= t < begin + 3.0]
        assert kind_of(part) == "garbage", begin


@pytest.mark.parametrize("baud", [19200, 38400, 57600])
def test_so_is_one_at_another_low_speed(baud: int) -> None:
    assert kind_of(received(board_bursts(4.0), FAST, baud, True)) == "garbage"


@pytest.mark.parametrize("keep_bad", [True, False])
@pytest.mark.parametrize("signed", [False, True])
def test_three_heartbeats_are_enough(
    signed: bool, keep_bad: bool, record_property: Callable[[str, object], None]
) -> None:
    """Without bad bytes a signed heartbeat may be a single one that could be a letter: then it
    takes another look. It is never called anything that would mislead."""
    draw = random.Random(4711)
    kinds: dict[str, int] = {}
    for _ in range(100):
        first = draw.randrange(256)
        bursts = [(0.3 + i, heartbeat(draw, first + i, signed)) for i in range(3)]
        kind = kind_of(received(bursts, FAST, SLOW, keep_bad))
        kinds[kind] = kinds.get(kind, 0) + 1
    record_property("kinds", kinds)
    assert kinds["garbage"] >= (95 if signed and not keep_bad else 100)
    assert set(kinds) <= {"garbage", "noise"}


NMEA = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n"
BOOT_LOG = (
    b"\x1b[0;32mI (31) boot: ESP-IDF v5.1 2nd stage bootloader\x1b[0m\r\n"
    b"I (31) boot: compile time Oct  1 2024 12:00:00\r\n[    0.000000] Linux version 6.1.0\r\n"
)


@pytest.mark.parametrize(
    ("bursts", "kind"),
    [
        ([], "silence"),
        ([(i * 0.5, NMEA) for i in range(6)], "text"),
        ([(i * 0.5, BOOT_LOG) for i in range(6)], "text"),
        ([(0.0, b"\xff\x00")], "noise"),
        ([(0.01, b"\xfe")], "noise"),
        ([(0.2, b"OK\r\n"), (1.2, b"OK\r\n")], "text"),
        ([(0.2, b"ok"), (1.2, b"ok")], "noise"),
    ],
)
def test_what_is_not_a_module_at_another_speed(bursts: list[Burst], kind: str) -> None:
    assert kind_of(bursts) == kind


@pytest.mark.parametrize("seed", range(20))
def test_a_healthy_link_with_noise_is_not_mistaken(seed: int) -> None:
    """One byte in fifty is damaged: a board is heard, or MAVLink is seen to be damaged."""
    draw = random.Random(seed)
    noisy = [
        (t, bytes(b ^ draw.randrange(1, 256) if draw.random() < 0.02 else b for b in data))
        for t, data in board_bursts(3.5, seed + 1)
    ]
    hearing = Hearing("x")
    if connect.hear_board(Recorded(noisy), connect.LISTEN_S, hearing) is None:
        assert hearing.kind == "damaged"


def test_frames_that_are_all_damaged_are_not_mistaken() -> None:
    bursts = [(t, data[:-2] + bytes([data[-2] ^ 1, data[-1]])) for t, data in board_bursts(3.5)]
    assert kind_of([(t, data) for t, data in bursts if len(data) < 40]) == "damaged"


def test_another_vehicle_is_named() -> None:
    message = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_QUADROTOR, 3, 0, 0, 4, 3)
    data = bytes(message.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=1)))
    assert kind_of([(i * 1.0, data) for i in range(3)]) == "stranger"


def through_a_factory_module() -> Recorded:
    return Recorded(received(board_bursts(4.0), FAST, SLOW, True))


REMEDY = "Raise it with: tailbeat board bluetooth"
WORDS = (
    "bytes come on /dev/rfcomm0 but no MAVLink: the Bluetooth module is probably still at 9600 baud"
)


def test_whoever_connects_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    port = through_a_factory_module()
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: port)
    with pytest.raises(ConnectError) as told:
        Fish.connect("/dev/rfcomm0")
    assert (told.value.message, told.value.remedy) == (WORDS, REMEDY)
    assert port.closed


def test_whoever_looks_for_a_fish_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    port = through_a_factory_module()
    monkeypatch.setattr(connect, "likely_ports", lambda: iter([port.name]))
    monkeypatch.setattr(connect, "SerialTransport", lambda path: port)
    monkeypatch.setattr(connect, "DEFAULT_PORT", 1)
    with pytest.raises(ConnectError) as told:
        connect.find_board()
    assert (told.value.message, told.value.remedy) == (WORDS, REMEDY)


def test_the_doctor_says_it_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "tailbeat.board.diagnostics.evidence.open_transport", lambda _: through_a_factory_module()
    )
    found = examine("/dev/rfcomm0")[-1]
    assert (found.name, found.status, found.text, found.remedy) == ("board", PROBLEM, WORDS, REMEDY)
    assert found.measured["heard"] == "garbage"


def test_the_simulated_radio_is_none_of_this() -> None:
    hearing = Hearing("sim")
    assert connect.hear_board(SimTransport(SimBoard("tank")), connect.LISTEN_S, hearing) is not None
