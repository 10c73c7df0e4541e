"""A board with a key, seen by stock pymavlink: nothing here knows more than the MAVLink guide."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

import pytest

from tailbeat.link import _dialect as mavlink
from tailbeat.sim.board import CONSOLE, RADIO, SimBoard

KEY = hashlib.sha256(b"a fish of ours").digest()
OTHER = hashlib.sha256(b"somebody else's").digest()
NO_KEY = bytes(32)
TODAY = int((1795305600 - 1420070400) * 1e5)  # 2026-11-22, in ticks since 2015
BOOT_S = 3.0  # making the filesystem takes most of it
DAY = 86400 * 100000
CLEAR = mavlink.TAILBEAT_CMD_CLEAR
DENIED, REJECTED = mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_TEMPORARILY_REJECTED


class Stock:
    """pymavlink as mavutil sets it up, on one port of a board."""

    def __init__(self, board: SimBoard, port: int = RADIO, system: int = 255) -> None:
        self.board, self.port = board, port
        self.mav = mavlink.MAVLink(self, srcSystem=system, srcComponent=190)
        self.mav.robust_parsing = True
        self.sent: list[bytes] = []
        self.inbox: list[mavlink.MAVLink_message] = []

    def write(self, data: bytes) -> None:
        self.sent.append(bytes(data))
        self.board.write(bytes(data), self.port)

    def sign(self, key: bytes, timestamp: int, link_id: int = 1) -> Stock:
        """What mavutil's setup_signing() does."""
        self.mav.signing.secret_key = key
        self.mav.signing.link_id = link_id
        self.mav.signing.timestamp = timestamp
        self.mav.signing.sign_outgoing = True
        return self

    def listen(self, duration_s: float = 0.3) -> list[mavlink.MAVLink_message]:
        """All that came in; the parser drops what is not rightly signed."""
        self.board.run(duration_s)
        got = self.mav.parse_buffer(self.board.read(self.port)) or []
        self.inbox = [m for m in got if m.get_type() != "BAD_DATA"]
        return self.inbox

    def command(self, number: int, param1: float = 0) -> tuple[int, int]:
        """Result and fault of the acknowledgement."""
        self.mav.command_long_send(1, 1, number, 0, param1, 0, 0, 0, 0, 0, 0)
        acks = [m for m in self.listen() if m.get_type() == "COMMAND_ACK"]
        assert len(acks) == 1
        return acks[0].result, acks[0].result_param2

    def setup(self, key: bytes, timestamp: int) -> str:
        """Sends a key; what the board says."""
        self.mav.setup_signing_send(1, 1, list(key), timestamp)
        texts = [m.text for m in self.listen() if m.get_type() == "STATUSTEXT"]
        return " | ".join(texts)


@pytest.fixture
def board() -> Iterator[SimBoard]:
    made = SimBoard("tank", seed=1)
    made.run(BOOT_S)
    made.read(RADIO)
    made.read(CONSOLE)
    yield made


@pytest.fixture
def keyed(board: SimBoard) -> SimBoard:
    """With KEY, set over the wire today."""
    wired = Stock(board, CONSOLE)
    assert "key set" in wired.setup(KEY, TODAY)
    return board


def test_the_key_comes_by_wire_only(board: SimBoard) -> None:
    stranger = Stock(board, RADIO)
    assert "USB serial" in stranger.setup(KEY, TODAY)
    assert stranger.command(CLEAR) == (mavlink.MAV_RESULT_ACCEPTED, 0)
    assert "key set" in Stock(board, CONSOLE).setup(KEY, TODAY)
    assert stranger.command(CLEAR) == (DENIED, 62)


def test_the_answer_is_signed_with_the_new_key(board: SimBoard) -> None:
    wired = Stock(board, CONSOLE)
    wired.mav.setup_signing_send(1, 1, list(KEY), TODAY)
    wired.sign(KEY, TODAY)
    assert "key set" in [m.text for m in wired.listen() if m.get_type() == "STATUSTEXT"]
    assert all(m.get_signed() for m in wired.inbox)
    assert wired.mav.signing.reject_count == 0


@pytest.mark.parametrize("port", [RADIO, CONSOLE])
def test_a_host_of_the_same_time_is_trusted_at_once(keyed: SimBoard, port: int) -> None:
    host = Stock(keyed, port).sign(KEY, TODAY + 100000)
    assert host.command(CLEAR) == (0, 0)
    assert host.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0) == (0, 0)


@pytest.mark.parametrize("port", [RADIO, CONSOLE])
@pytest.mark.parametrize("days", [1, 400, 3650])
def test_a_host_whose_clock_is_ahead(keyed: SimBoard, port: int, days: int) -> None:
    """It is refused once; the board's next frames tell it what time it is.

    The refusal itself is too old for it to believe, so somebody without a key listens.
    """
    reader = Stock(keyed, port)
    host = Stock(keyed, port).sign(KEY, TODAY + days * DAY)
    host.mav.command_long_send(1, 1, CLEAR, 0, 0, 0, 0, 0, 0, 0, 0)
    acks = [m for m in reader.listen() if m.get_type() == "COMMAND_ACK"]
    assert [(a.result, a.result_param2) for a in acks] == [(REJECTED, 63)]
    host.listen(1.5)
    assert host.mav.signing.timestamp > TODAY + days * DAY
    assert host.command(CLEAR) == (0, 0)
    host.mav.param_set_send(1, 1, b"ILC_LEAD", 1, mavlink.MAV_PARAM_TYPE_REAL32)
    values = [m.param_value for m in host.listen() if m.get_type() == "PARAM_VALUE"]
    assert values == [1.0]


def test_a_host_whose_clock_is_behind_adopts_the_boards(keyed: SimBoard) -> None:
    keyed.world.power_cycle()
    keyed.run(BOOT_S)
    host = Stock(keyed).sign(KEY, TODAY)
    host.listen(1.5)
    assert host.command(CLEAR) == (0, 0)


@pytest.mark.parametrize("port", [RADIO, CONSOLE])
def test_wrong_key_and_no_key(keyed: SimBoard, port: int) -> None:
    # The board's answers carry another key than the stranger's, so its parser would drop them.
    reader = Stock(keyed, port)
    stranger = Stock(keyed, port).sign(OTHER, TODAY + 100000)
    stranger.mav.command_long_send(1, 1, CLEAR, 0, 0, 0, 0, 0, 0, 0, 0)
    acks = [m for m in reader.listen() if m.get_type() == "COMMAND_ACK"]
    assert [(a.result, a.result_param2) for a in acks] == [(DENIED, 63)]
    stranger.mav.param_request_read_send(1, 1, b"ILC_LEAD", -1)
    assert not [m for m in reader.listen() if m.get_type() == "PARAM_VALUE"]
    assert reader.command(mavlink.TAILBEAT_CMD_TRIAL_ABORT) == (DENIED, 62)
    reader.mav.param_request_read_send(1, 1, b"ILC_LEAD", -1)
    assert len([m for m in reader.listen() if m.get_type() == "PARAM_VALUE"]) == 1


def test_a_recorded_session_is_worth_nothing(keyed: SimBoard) -> None:
    """Replayed at once, on the other port, and after the next boot: stock would take the last."""
    host = Stock(keyed).sign(KEY, TODAY + 100000)
    for _ in range(5):
        assert host.command(CLEAR) == (0, 0)
    recorded = list(host.sent)
    reader = Stock(keyed)
    for boots in range(3):
        for port in (RADIO, CONSOLE):
            reader.port = port
            for frame in recorded:
                keyed.write(frame, port)
                acks = [m for m in reader.listen(0.2) if m.get_type() == "COMMAND_ACK"]
                assert [(a.result, a.result_param2) for a in acks] == [(REJECTED, 63)], boots
        keyed.world.power_cycle()
        keyed.run(BOOT_S)
        keyed.read(RADIO)
        keyed.read(CONSOLE)


def test_a_stranger_does_not_erase_the_key(keyed: SimBoard) -> None:
    for port in (RADIO, CONSOLE):
        assert "key erased" not in Stock(keyed, port).setup(NO_KEY, TODAY)
        assert "key set" not in Stock(keyed, port).setup(OTHER, TODAY)
        forger = Stock(keyed, port).sign(OTHER, TODAY + 100000)
        forger.setup(NO_KEY, TODAY)
    assert Stock(keyed).command(CLEAR) == (DENIED, 62)
    owner = Stock(keyed, CONSOLE).sign(KEY, TODAY + 100000)
    owner.mav.setup_signing_send(1, 1, list(NO_KEY), TODAY)
    keyed.run(0.3)
    assert Stock(keyed).command(CLEAR) == (0, 0)


def test_health_counts_the_refused(keyed: SimBoard) -> None:
    host = Stock(keyed).sign(KEY, TODAY + 100000)
    assert host.command(CLEAR) == (0, 0)
    keyed.write(host.sent[-1])
    Stock(keyed).sign(OTHER, TODAY).mav.heartbeat_send(6, 8, 0, 0, 0)
    Stock(keyed).mav.command_long_send(1, 1, CLEAR, 0, 0, 0, 0, 0, 0, 0, 0)
    host.listen(0.5)
    host.mav.command_long_send(
        1,
        1,
        mavlink.MAV_CMD_REQUEST_MESSAGE,
        0,
        mavlink.MAVLINK_MSG_ID_TAILBEAT_HEALTH,
        0,
        0,
        0,
        0,
        0,
        0,
    )
    health = [m for m in host.listen() if m.get_type() == "TAILBEAT_HEALTH"][-1]
    assert (health.refused_unsigned, health.refused_wrong, health.refused_stale) == (1, 1, 1)


def test_the_flash_holds_the_key_but_no_file_shows_it(keyed: SimBoard) -> None:
    assert KEY in keyed.flash
    reader = Stock(keyed)
    told = b""
    for opcode, path in [
        (3, b"/"),
        (3, b"/in"),
        (3, b"/trials"),
        (4, b"/key.bin"),
        (14, b"/key.bin"),
    ]:
        payload = bytearray(251)
        payload[3], payload[4] = opcode, len(path)
        payload[12 : 12 + len(path)] = path
        reader.mav.file_transfer_protocol_send(0, 1, 1, list(payload))
        answers = [m for m in reader.listen() if m.get_type() == "FILE_TRANSFER_PROTOCOL"]
        assert len(answers) == 1
        told += bytes(answers[0].payload)
    assert b"key" not in told
    assert KEY[:4] not in told
