"""Gives a board its key, takes it away, and says how board and computer stand to each other."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from tailbeat.board.fish import Fish
from tailbeat.core.errors import LinkLostError, Refused, TailbeatError
from tailbeat.core.faults import NOT_FRESH, NOT_SIGNED, all_faults, refusal
from tailbeat.link import _dialect as mavlink
from tailbeat.link.keystore import KEY_BYTES, KeyStore, StoredKey, new_key
from tailbeat.link.mavlink import BOARD_COMPONENT, BOARD_SYSTEM, Message, text_of
from tailbeat.link.signing import TICKS_PER_S
from tailbeat.sim.board import in_process

_EPOCH_S = datetime(2015, 1, 1, tzinfo=UTC).timestamp()  # of signing time
_JUMP_MAX_TICKS = 40 * 366 * 86400 * TICKS_PER_S  # a clock that is further off is not believed
_NO_KEY = bytes(KEY_BYTES)
_ERASED = "key erased"
_TEXT_CHARS = 49  # of a board's line
_LOOK_S = 0.05
# How the unique ids of boards begin whose key ends with their process: simulated and emulated ones.
_SHORT_LIVED = (b"sim-fish".hex(), b"tailbeat".hex())
_COUNTERS = ("refused_unsigned", "refused_wrong", "refused_stale")

NO_KEY = (
    "no key: anyone in Bluetooth range can move this tail. Set one over USB serial:"
    " tailbeat board key set"
)
OPEN, HELD, MISSING = "open", "held", "missing"


@dataclass(frozen=True)
class KeyStatus:
    """How a board and this computer stand to each other.

    ``trust``: open (the board has no key: every host may command it), held (it has one, and so have
    we) or missing (it has one, and we have not). ``held``: the key it signs with. ``lost``: a key
    of ours that it does not sign with any more; never of a simulated board, whose key ends with its
    process. ``refused``: frames the board turned away since its boot.
    ``board``: its unique id; None when it does not tell an unauthenticated host.
    """

    trust: str
    board: str | None
    held: StoredKey | None
    lost: StoredKey | None
    refused: dict[str, int]

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``; without the key itself."""
        return {
            "trust": self.trust,
            "board": self.board,
            "held": self.held.public() if self.held else None,
            "lost": self.lost.public() if self.lost else None,
            "refused": self.refused,
        }


def key_status(fish: Fish, health: Mapping[str, int | str] | None = None) -> KeyStatus:
    """Asks the board. What it says is checked if we have its key. ``health``: what it said of that
    already."""
    board = _board_of(fish)
    if health is None:
        health = fish.health()
    return KeyStatus(
        trust_of(fish),
        board,
        fish.link.signing.key,
        _lost_key(fish, board),
        {name: int(health[name]) for name in _COUNTERS if name in health},
    )


def _board_of(fish: Fish) -> str | None:
    """Its unique id; None when it does not tell an unauthenticated host."""
    try:
        return fish.unique_id()
    except Refused as refused:
        if refused.number != NOT_SIGNED:
            raise
        return None


def trust_of(fish: Fish) -> str:
    """Open, held or missing; by the last frame that was heard."""
    signing = fish.link.signing
    if signing.key is not None:
        return HELD
    return MISSING if signing.locked else OPEN


def connect_notice(fish: Fish) -> str | None:
    """What a person who connects has to know about the board's key; None when all is well.

    That a simulated board has no key is well: no tail moves."""
    trust = trust_of(fish)
    if trust == HELD:
        return None
    if trust == MISSING:
        return _missing_words(fish.link.signing.store)
    board = fish.unique_id()
    lost = _lost_key(fish, board) if fish.link.signing.store else None
    if lost is not None:
        return (
            f"this board does not sign, but this computer has its key {lost.fingerprint}. The key"
            " was erased, or another device imitates this board. Set it again over USB serial:"
            " tailbeat board key set"
        )
    if in_process(fish.transport) is not None or board.startswith(_SHORT_LIVED):
        return None
    return NO_KEY


def _missing_words(store: KeyStore) -> str:
    problems = store.load()[1]
    why = f" ({problems[0]})" if problems else ""
    return (
        f"this board has a key that this computer does not have{why}. It can be read, unchecked,"
        " and rejects commands. Bring the key: 'tailbeat board key export' where it was set,"
        " 'tailbeat board key import' here"
    )


def _lost_key(fish: Fish, board: str | None = None) -> StoredKey | None:
    """Our key of a board that does not sign, and should: by its unique id alone, so that nobody
    gets out of it by saying that he is simulated."""
    if trust_of(fish) != OPEN:
        return None
    board = fish.unique_id() if board is None else board
    return None if board.startswith(_SHORT_LIVED) else fish.link.signing.store.newest_of(board)


def set_key(fish: Fish, name: str = "", now_s: Callable[[], float] = time.time) -> StoredKey:
    """Gives the board a new key, in place of the one it has; it is kept here before it is sent, so
    that no lost answer locks anybody out. Raises Refused: the port must be the wired one."""
    key = new_key(fish.unique_id(), name)
    fish.link.signing.store.save(key)
    return _give(fish, key, now_s)


def give_back(fish: Fish, board: str, now_s: Callable[[], float] = time.time) -> StoredKey | None:
    """Gives a board that lost its key the newest one this computer has for ``board``; None when it
    has none. Raises as set_key does."""
    key = fish.link.signing.store.newest_of(board)
    return None if key is None else _give(fish, key, now_s, anew=False)


def _give(fish: Fish, key: StoredKey, now_s: Callable[[], float], anew: bool = True) -> StoredKey:
    signing = fish.link.signing
    newest = max(key.newest, signing.newest)
    clock = signing_time(now_s())
    ticks = max(newest, clock if clock - newest < _JUMP_MAX_TICKS else 0) + 1
    signing.offer(key)
    try:
        _exchange(
            fish, key.key, ticks, lambda _: signing.key is not None and signing.key.key == key.key
        )
    except Refused:
        if anew:
            signing.store.delete(key)  # nobody has it
        raise
    finally:
        signing.offer(None)
    signing.store.delete_others(key)
    return key


def signing_time(now_s: float) -> int:
    """A time of the system's clock as signing time."""
    return max(0, round((now_s - _EPOCH_S) * TICKS_PER_S))


def erase_key(fish: Fish) -> StoredKey | None:
    """Takes the board's key away: from then on it obeys anybody. The key it had, which this
    computer forgets. Raises Refused."""
    signing = fish.link.signing
    held = signing.key
    if signing.locked:
        raise refusal(NOT_SIGNED)
    signing.part(True)
    try:
        _exchange(fish, _NO_KEY, 0, lambda text: text == _ERASED)
    except BaseException:
        signing.part(False)
        raise
    signing.drop()
    if held is not None:
        signing.store.delete(held)
    return held


def _exchange(fish: Fish, key: bytes, ticks: int, done: Callable[[str], bool]) -> None:
    """Sends the key until ``done``, which is given each line the board says, or refused."""
    link = fish.link
    lines: list[str] = []

    def hear(message: Message) -> None:
        if message.get_type() == "STATUSTEXT":
            lines.append(text_of(message.text))

    message = mavlink.MAVLink_setup_signing_message(BOARD_SYSTEM, BOARD_COMPONENT, list(key), ticks)
    link.begin()
    stop = link.subscribe(hear)
    stale: Refused | None = None
    try:
        for patience_s in link.attempts():
            lines.clear()
            link.send(message)
            end_s = link.transport.now_s() + patience_s
            while (left_s := end_s - link.transport.now_s()) > 0:
                link.idle(min(left_s, _LOOK_S))
                if any(map(done, ["", *lines])):
                    return
                refused = next(filter(None, map(_refused, lines)), None)
                if refused is not None and refused.number != NOT_FRESH:
                    raise refused
                if refused is not None:
                    stale = refused
                    break
    except LinkLostError as error:
        raise stale or _unanswered(error) from error
    finally:
        stop()


def _refused(line: str) -> Refused | None:
    """The reason of a refusal by its words."""
    for fault in all_faults():
        if fault.kind != "none" and line == fault.meaning[:_TEXT_CHARS]:
            return refusal(fault.number)
    return None


def _unanswered(error: LinkLostError) -> TailbeatError:
    return LinkLostError(
        f"the board did not say whether it took the key ({error.message})",
        "Look with 'tailbeat board key status', and try again. The key is kept until then.",
    )
