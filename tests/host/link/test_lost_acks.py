"""Commands over a line that loses or delays their acknowledgements: done once, and known to be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import pytest

from tailbeat.board.fish import Fish
from tailbeat.core import faults, records
from tailbeat.core.errors import Refused
from tailbeat.link import _dialect as mavlink
from tailbeat.link.frames import Framer
from tailbeat.link.impaired import Cut, Delay, Duplicate, ImpairedLine
from tailbeat.link.mavlink import BOARD_COMPONENT, BOARD_SYSTEM, Message
from tailbeat.session.events import Event, LinkLost, LinkRestored, TrialEnded, TrialWarning
from tailbeat.session.trial import run_trial


def message_of(frame: bytes) -> Message | None:
    got = Framer(mavlink.MAVLink(None)).push(frame)
    return got[0] if got else None


def is_command(frame: bytes, command: int) -> bool:
    """A command or its acknowledgement."""
    message = message_of(frame)
    kinds = ("COMMAND_LONG", "COMMAND_INT", "COMMAND_ACK")
    return message is not None and message.get_type() in kinds and message.command == command


@dataclass
class First:
    """Loses the first ``count`` frames of a kind."""

    count: int
    where: Callable[[bytes], bool]
    lost: list[bytes] = field(default_factory=list)

    def take(self, piece, dice):  # type: ignore[no-untyped-def]
        if len(self.lost) < self.count and self.where(piece.data):
            self.lost.append(piece.data)
            return ()
        return (piece,)


ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
START, LEARN = mavlink.TAILBEAT_CMD_TRIAL_START, mavlink.TAILBEAT_CMD_LEARN


def deaf_to(ready: Fish, command: int, count: int, up: int = 0) -> First:
    """Loses the first acknowledgements of a command, and the first commands themselves."""

    def meant(frame: bytes) -> bool:
        return is_command(frame, command)

    lost = First(count, meant)
    ready.link.transport = ImpairedLine(ready.transport, [First(up, meant)], [lost])
    return lost


@pytest.mark.parametrize(
    ("command", "prepare", "do", "done"),
    [
        (ARM, lambda f: None, Fish.arm, lambda f: f.status().state == "ARMED"),
        (ARM, Fish.arm, Fish.disarm, lambda f: f.status().state == "IDLE"),
        (LEARN, run_trial, Fish.learn, lambda f: f.status().iteration == 2),
        (
            mavlink.TAILBEAT_CMD_DISCARD,
            run_trial,
            Fish.discard,
            lambda f: f.status().pending_trial is None,
        ),
        (
            mavlink.TAILBEAT_CMD_COMMIT,
            lambda f: None,
            lambda f: f.upload_reference(records.encode_reference(1.0, [0.01] * 5)),
            lambda f: f.reference_record() == records.encode_reference(1.0, [0.01] * 5),
        ),
        (
            mavlink.TAILBEAT_CMD_COMMIT,
            lambda f: None,
            lambda f: f.upload_amplitudes([0.25] * 8),
            lambda f: list(f.amplitudes().values) == [0.25] * 8,
        ),
        (
            mavlink.MAV_CMD_PREFLIGHT_STORAGE,
            lambda f: f.params.set("ILC_GAIN", 9),
            lambda f: f.params.reset(),
            lambda f: f.params.get("ILC_GAIN").value == 4.0,
        ),
    ],
    ids=["arm", "disarm", "learn", "discard", "reference", "amplitudes", "params"],
)
@pytest.mark.parametrize("count", [1, 3])
def test_a_command_whose_acknowledgement_is_lost_is_done_once(
    ready: Fish, command: int, prepare, do, done, count: int
) -> None:
    prepare(ready)
    lost = deaf_to(ready, command, count)
    do(ready)
    assert len(lost.lost) == count
    assert done(ready)


@pytest.mark.parametrize(
    ("command", "prepare", "do"),
    [
        (mavlink.TAILBEAT_CMD_DISCARD, run_trial, Fish.discard),
        (
            mavlink.TAILBEAT_CMD_COMMIT,
            lambda f: None,
            lambda f: f.upload_reference(records.encode_reference(1.0, [0.01] * 5)),
        ),
    ],
)
def test_a_command_that_the_line_brings_twice_is_done(
    ready: Fish, command: int, prepare, do
) -> None:  # type: ignore[no-untyped-def]
    """The answer to the first is lost; the second finds it done."""
    prepare(ready)
    lost = deaf_to(ready, command, 1)
    assert isinstance(ready.link.transport, ImpairedLine)
    ready.link.transport = ImpairedLine(ready.transport, [Duplicate(1.0)], [lost])
    do(ready)
    assert len(lost.lost) == 1


def test_what_is_refused_stays_refused(ready: Fish) -> None:
    deaf_to(ready, mavlink.TAILBEAT_CMD_DISCARD, 0)
    with pytest.raises(Refused) as refused:
        ready.discard(5)
    assert refused.value.name == "NO_TRIAL"


def test_a_swim_needs_no_acknowledgement(ready: Fish) -> None:
    """The board is seen to swim, and its beats are measured from the first on."""
    lost = deaf_to(ready, START, 10**9)
    outcome = run_trial(ready)
    assert outcome.end == "complete"
    assert 1 <= len(lost.lost) <= 3
    assert ready.learn().measured_beats == 8


def test_a_start_that_is_lost_does_not_grow_stale(ready: Fish) -> None:
    deaf_to(ready, START, 0, up=5)
    outcome = run_trial(ready)
    assert outcome.end == "complete"
    assert ready.learn().measured_beats == 8


def test_an_answer_to_arm_is_not_one_to_disarm(ready: Fish) -> None:
    """The first acknowledgement is late, so arm is said twice and answered twice."""
    line = ImpairedLine(ready.transport, down=[Delay(0.6, 0.6)])
    ready.link.transport = line
    ready.arm()
    down = First(1, lambda frame: is_command(frame, ARM))
    ready.link.transport = ImpairedLine(line, up=[down])
    ready.disarm()
    assert len(down.lost) == 1
    assert ready.status().state == "IDLE"


def test_a_trial_over_a_cut_goes_on(ready: Fish) -> None:
    begin_s = ready.transport.now_s()
    cut = Cut(at_s=begin_s + 5.0, closed_s=1.5)
    ready.link.transport = ImpairedLine(ready.transport, [cut])
    events: list[type] = []
    outcome = run_trial(ready, on_event=lambda event: events.append(type(event)))
    assert outcome.end == "complete"
    assert events.index(LinkLost) < events.index(LinkRestored) < events.index(TrialEnded)


@dataclass
class Erasing:
    """Refuses the first ``count`` STARTs that go up, by ``Refusals`` on the way down;
    ``also_heard``: the board gets them nevertheless."""

    count: int
    also_heard: bool
    due: int = 0

    def take(self, piece, dice):  # type: ignore[no-untyped-def]
        if self.count == 0 or not is_command(piece.data, START):
            return (piece,)
        self.count -= 1
        self.due += 1
        return (piece,) if self.also_heard else ()


@dataclass
class Refusals:
    """What comes down; ahead of it, the refusals that are due."""

    of: Erasing

    def take(self, piece, dice):  # type: ignore[no-untyped-def]
        refusal = mavlink.MAVLink_command_ack_message(
            START, mavlink.MAV_RESULT_TEMPORARILY_REJECTED, 0, faults.ERASING, 0, 0
        )
        board = mavlink.MAVLink(None, BOARD_SYSTEM, BOARD_COMPONENT)
        refusals = [replace(piece, data=refusal.pack(board))] * self.of.due
        self.of.due = 0
        return (*refusals, piece)


@pytest.mark.parametrize("also_heard", [False, True])
def test_a_start_refused_for_erases_is_repeated(ready: Fish, also_heard: bool) -> None:
    """Also when the refusal was of an earlier command, and the board swims by now."""
    erasing = Erasing(2, also_heard)
    ready.link.transport = ImpairedLine(ready.transport, [erasing], [Refusals(erasing)])
    warnings: list[str] = []

    def listen(event: Event) -> None:
        if isinstance(event, TrialWarning):
            warnings.append(event.text)

    outcome = run_trial(ready, on_event=listen)
    assert outcome.end == "complete"
    assert erasing.due == 0 and erasing.count == (1 if also_heard else 0)
    assert sum("erases" in text for text in warnings) == 1
    assert ready.learn().measured_beats == 8
