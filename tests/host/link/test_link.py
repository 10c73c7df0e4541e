"""Framing, heartbeats, commands with retries."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tailbeat.board.fish import Fish
from tailbeat.core.errors import LinkLostError, Refused
from tailbeat.link import _dialect as mavlink
from tailbeat.link.frames import Framer


def mav() -> mavlink.MAVLink:
    return mavlink.MAVLink(None, srcSystem=1, srcComponent=1)


def frames(count: int) -> list[bytes]:
    packer = mav()
    out = []
    for number in range(count):
        message = mavlink.MAVLink_tailbeat_live_message(number, 0.1, 0.2, 0.3, 0, 0, 0, 5, 4500)
        out.append(message.pack(packer))
        packer.seq = (packer.seq + 1) & 255
    return out


def times(messages: list) -> list[int]:
    return [m.time_boot_ms for m in messages if m.get_type() == "TAILBEAT_LIVE"]


@given(st.lists(st.integers(0, 400), max_size=12))
@settings(max_examples=50, deadline=None)
def test_any_chunking_gives_all_messages(cuts: list[int]) -> None:
    stream = b"".join(frames(10))
    framer = Framer(mav())
    got, at = [], 0
    for cut in sorted(cuts):
        got += framer.push(stream[at:cut])
        at = max(at, min(cut, len(stream)))
    got += framer.push(stream[at:])
    assert times(got) == list(range(10))


@given(st.binary(max_size=600))
@settings(max_examples=300, deadline=None)
def test_noise_never_raises_and_is_recovered_from(noise: bytes) -> None:
    framer = Framer(mav())
    got = framer.push(noise)
    # A false marker may hold back one frame's length of bytes until these come.
    for frame in frames(20):
        got += framer.push(frame)
    assert times(got)[-10:] == list(range(10, 20))


@pytest.mark.parametrize("at", range(0, 40, 3))
@pytest.mark.parametrize("kind", ["flip", "drop"])
def test_a_damaged_byte_costs_one_frame(at: int, kind: str) -> None:
    one, two, three = frames(3)
    at = at % len(two)
    if kind == "flip":
        two = two[:at] + bytes([two[at] ^ 0x10]) + two[at + 1 :]
    else:
        two = two[:at] + two[at + 1 :]
    framer = Framer(mav())
    got = framer.push(one + two + three + b"".join(frames(8)))
    assert times(got)[:2] == [0, 2]
    assert len(times(got)) == 10


def test_heartbeat_once_a_second_whatever_is_waited_for(fish: Fish, spoil) -> None:
    radio = spoil(fish)
    begin = fish.transport.now_s()
    assert fish.link.recv("NO_SUCH_THING", 5.0) is None
    fish.link.run(5.0)
    heartbeats = [m for m in Framer(mav()).push(b"".join(radio.sent)) if m.get_msgId() == 0]
    assert 9 <= len(heartbeats) <= 11
    assert fish.transport.now_s() - begin == pytest.approx(10.0, abs=0.1)


def test_heartbeats_follow_a_board_that_runs_faster(fish: Fish, spoil) -> None:
    radio = spoil(fish)
    fish.link.rate = 10.0
    fish.link.run(2.0)
    heartbeats = [m for m in Framer(mav()).push(b"".join(radio.sent)) if m.get_msgId() == 0]
    assert 18 <= len(heartbeats) <= 22


def test_command_is_repeated_with_the_same_content(fish: Fish, spoil) -> None:
    radio = spoil(fish)
    lost: list[bytes] = []

    def lose_two(data: bytes) -> bool:
        if data[7] == 76 and len(lost) < 2:  # COMMAND_LONG
            lost.append(data)
            return False
        return True

    radio.on_write = lose_two
    fish.link.command(mavlink.TAILBEAT_CMD_TRIAL_ABORT)
    sent = [
        m
        for m in Framer(mav()).push(b"".join(radio.sent))
        if m.get_type() == "COMMAND_LONG" and m.command == mavlink.TAILBEAT_CMD_TRIAL_ABORT
    ]
    assert [m.confirmation for m in sent] == [0, 1, 2]
    assert len({tuple(getattr(m, f"param{i}") for i in range(1, 8)) for m in sent}) == 1


def test_refusal_carries_the_boards_reason(fish: Fish) -> None:
    with pytest.raises(Refused) as refused:
        fish.arm()
    assert refused.value.number == 41
    assert refused.value.name == "NO_REFERENCE"
    assert "\n" not in str(refused.value)
    assert "reference" in str(refused.value)


def test_unknown_message_is_refused(fish: Fish) -> None:
    with pytest.raises(Refused) as refused:
        fish.link.request("ATTITUDE_QUATERNION")
    assert refused.value.name == "UNKNOWN_COMMAND"


def test_silence_ends_in_one_clear_line(fish: Fish) -> None:
    assert fish.sim is not None
    fish.sim.world.set_radio(False)
    begin = fish.transport.now_s()
    with pytest.raises(LinkLostError) as lost:
        fish.status()
    assert fish.transport.now_s() - begin < 15.0
    assert "does not answer" in str(lost.value)
    assert "\n" not in str(lost.value)


def test_messages_of_others_are_not_the_boards(fish: Fish) -> None:
    fish.link.flush()
    stranger = mavlink.MAVLink(None, srcSystem=7, srcComponent=1)
    text = mavlink.MAVLink_statustext_message(0, b"boo").pack(stranger)
    fish.link._dispatch(fish.link.framer.push(text), 0.0)
    assert not fish.link._inbox


@pytest.mark.parametrize("seed", range(3))
def test_requests_survive_a_bad_radio(fish: Fish, spoil, seed: int) -> None:
    spoil(fish, seed, lose=0.2, damage=0.1, twice=0.1)
    for _ in range(20):
        assert fish.status().state == "IDLE"
