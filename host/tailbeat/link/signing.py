"""Which frames of the board are believed, and how ours are signed.

MAVLink 2 signing with a board whose clock is the only one that counts: its newest rightly signed
frame says what time it is, and ours go on from there. So nothing is signed before the board was
heard, and this computer's own clock is never asked.

The check is not pymavlink's: that one takes what is up to a minute old from a sender it meets for
the first time, and lets a forged frame move the time it compares the next ones with.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tailbeat.core.errors import InputError
from tailbeat.core.extras import lazy
from tailbeat.link.keystore import KeyStore, StoredKey

if TYPE_CHECKING:
    import hashlib
    import hmac
else:  # 4 ms that only keys need
    hashlib = lazy("hashlib")
    hmac = lazy("hmac")

TICKS_PER_S = 100_000  # of 10 us
_SIGNED = 1  # of the incompatibility flags
_DIGEST_BYTES = 6
_RUN_AHEAD_MAX_S = 5.0  # of board time without a word from the board: it may stand still
_SAVE_TICKS = 60 * TICKS_PER_S


@dataclass
class RejectedFrames:
    """Frames of the board that were not believed, since the last one that was."""

    unsigned: int = 0
    wrong: int = 0
    stale: int = 0


def is_right(key: bytes, frame: bytes | bytearray) -> bool:
    """Whether a signed frame carries the signature of ``key``."""
    signed, digest = frame[:-_DIGEST_BYTES], frame[-_DIGEST_BYTES:]
    return hmac.compare_digest(hashlib.sha256(key + signed).digest()[:_DIGEST_BYTES], digest)


def signed_time(frame: bytes | bytearray) -> int:
    """The time in the signature of a signed frame."""
    return int.from_bytes(frame[-12:-_DIGEST_BYTES], "little")


class Signing:
    """The trust between one link and its board.

    ``key``: the one the board signs with, once a frame has shown it; from then on nothing else is
    believed. ``signs``: whether the last frame taken was signed; None before the first. A board
    that signs with a key this computer has not is read, but cannot be checked.
    """

    def __init__(self, store: KeyStore | None = None) -> None:
        self.store = KeyStore() if store is None else store
        self.key: StoredKey | None = None
        self.signs: bool | None = None
        self.refused = RejectedFrames()
        self._candidates: list[StoredKey] | None = None
        self._offered: StoredKey | None = None
        self._parting = False
        self._used = self._heard = self._saved = 0
        self._heard_s = 0.0

    @property
    def locked(self) -> bool:
        """The board has a key, and this computer has not got it."""
        return bool(self.signs) and self.key is None

    @property
    def newest(self) -> int:
        """The newest time signed or heard by this link."""
        return max(self._used, self._heard)

    def offer(self, key: StoredKey | None) -> None:
        """The board may have this key from now on; None: no more than the one it has."""
        self._offered = key

    def part(self, parting: bool) -> None:
        """While ``parting`` unsigned frames are believed too: the board gives its key up."""
        self._parting = parting

    def drop(self) -> None:
        """The board has no key any more."""
        self.save()
        self.key = self._candidates = None
        self._parting = False

    def admit(self, frame: bytes | bytearray, now_s: float) -> bool:
        """Judges a frame of the board whose CRC is right; counts it when it is not believed."""
        if not frame[2] & _SIGNED:
            return self._admit_unsigned()
        owner = self._owner(frame)
        if owner is None and self.key is not None:
            self.refused.wrong += 1
            return False
        if owner is not None and not self._admit_signed(owner, signed_time(frame), now_s):
            self.refused.stale += 1
            return False
        self.signs = True
        self.refused = RejectedFrames()
        return True

    def _admit_unsigned(self) -> bool:
        if self.key is not None and not self._parting:
            self.refused.unsigned += 1
            return False
        self.signs = False
        self.refused = RejectedFrames()
        return True

    def _owner(self, frame: bytes | bytearray) -> StoredKey | None:
        """Whose signature it is, of the keys that come into question."""
        for key in self._in_question():
            if is_right(key.key, frame):
                return key
        return None

    def _in_question(self) -> Iterable[StoredKey]:
        if self.key is not None:
            yield self.key
        if self._offered is not None:
            yield self._offered
        if self.key is None:
            if self._candidates is None:
                self._candidates = self.store.usable()
            yield from self._candidates

    def _admit_signed(self, owner: StoredKey, time: int, now_s: float) -> bool:
        known = self.key is not None and owner.key == self.key.key
        if time <= (self._heard if known else owner.heard):
            return False
        if not known:
            self._adopt(owner)
        self._heard, self._heard_s = time, now_s
        if not known or self._heard >= self._saved + _SAVE_TICKS:
            self.save()
        return True

    def _adopt(self, owner: StoredKey) -> None:
        self.save()
        self.key, self._used = owner, owner.used
        if self._offered is None:  # else a key is on its way to the board
            self.store.delete_unconfirmed(owner)

    def pack(self, message: Any, mav: Any, now_s: float, rate: float) -> bytes:
        """The bytes of a message from ``mav``, signed when the board has a key we know. ``rate``:
        how many seconds pass on the board in one of ``now_s``."""
        if self.key is None:
            return bytes(message.pack(mav))
        signing = mav.signing
        signing.secret_key, signing.link_id = self.key.key, self.key.link_id
        signing.timestamp = self._used = self._next(now_s, rate)
        signing.sign_outgoing = True
        try:
            return bytes(message.pack(mav))
        finally:
            signing.sign_outgoing, signing.secret_key = False, None

    def _next(self, now_s: float, rate: float) -> int:
        passed_s = min(max(0.0, now_s - self._heard_s) * rate, _RUN_AHEAD_MAX_S)
        return max(self._used + 1, self._heard + round(passed_s * TICKS_PER_S))

    def save(self) -> None:
        """Keeps how far time has come. A disk that does not take it is no reason to stop."""
        if self.key is None:
            return
        self._saved = self._heard
        try:
            self.store.note(self.key, self._used, self._heard)
        except InputError:
            return

    def why_silent(self) -> str:
        """Why frames came and were not believed; empty when none did."""
        if self.refused.unsigned:
            return "what comes from it is not signed any more: its key was erased, or it is another"
        if self.refused.wrong:
            return "what comes from it is signed with a key that this computer has not"
        if self.refused.stale:
            return (
                "its messages are old: another host replays a recording, or this computer's key"
                " has a wrong time. In that case: 'tailbeat board key delete', then import it again"
            )
        return ""
