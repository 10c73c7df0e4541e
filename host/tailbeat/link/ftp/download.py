"""Reading a file from the board: bursts keep the line full, holes are asked for meanwhile.

The board sends a burst of packets on one request. Before it ends the next one is asked for. What is
missing in between, because a frame was lost, is asked for at once, by requests of their own that
the board answers between two packets of the burst, so that no time on the line is lost.

A local file that is still coming: its beginning on disk, and its name only when whole.

Beside the beginning lies a note: of which file of the board it is, what that must become, and the
length and CRC of what is held. The note is replaced in one step and never says more than is on the
disk, so that whatever ends the program leaves a beginning that can be trusted as far as it says.

The beginning is locked while it grows. A second process that fetches the same file meanwhile writes
under a temporary name and keeps no beginning; whichever ends last gives the file its content.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from tailbeat.core.errors import TailbeatError, TransferError
from tailbeat.core.files import replace_file, temporary_beside
from tailbeat.core.platform.files import renames_open_files, sync_folder, try_lock
from tailbeat.core.records import crc32
from tailbeat.link.ftp.wire import (
    BURST,
    DATA_BYTES,
    END_OF_FILE,
    INVALID_SESSION,
    NO_SESSION,
    OPEN_READ,
    READ,
    TERMINATE,
    FtpError,
    FtpReply,
    Progress,
    RequestWindow,
    StallTimer,
    is_for_us,
    parse,
)
from tailbeat.link.mavlink import Link

_BURST_PACKETS = 160  # of the board's bursts; others may end earlier, and say so
_LEAD_PACKETS = 6  # before its end the next one is asked for: what the board's sender holds
_READS_MAX = 4  # under way beside a burst
_READS_ALONE = 3  # under way otherwise: what the board's sender holds
_READ_MIN_BYTES = 30
_PAUSE_S = 0.5  # while a burst fills the line: to ask anew costs more than to wait so long
_QUEUE_S = 0.2  # what the board's sender holds before an answer
_PACKET_S = 0.025  # on the slowest line, 115200 baud
_LAST_FEW = 2
_END_PACKETS = 24  # before the end the line is about to be empty, and waiting costs
_JUDGED_PACKETS = 24
_LOSS_HIGH, _LOSS_LOW = 0.5, 0.3  # of the packets, where smaller or larger ones get more through


class FileChangedError(TransferError):
    """The file on the board is not the one that was being read."""


class Requests(Protocol):
    """What a download needs of the client."""

    link: Link

    def open(self, opcode: int, path: str) -> FtpReply:
        """A session for a file. Raises FtpError."""

    def send(self, opcode: int, session: int, offset: int = 0, size: int | None = None) -> None:
        """Sends a request and does not wait for its answer."""


class Download:
    """An open file on the board."""

    def __init__(self, client: Requests, path: str, opened: FtpReply | None = None) -> None:
        """``opened``: the answer to a request that has opened it already."""
        self._client = client
        self._link = client.link
        self._path = path
        self.size = -1
        self._opened(opened or client.open(OPEN_READ, path))

    def __enter__(self) -> Download:
        return self

    def __exit__(self, *_: object) -> None:
        """Closes it, and does not wait: who opens the next one takes a silent session over."""
        with contextlib.suppress(TailbeatError):
            self._client.send(TERMINATE, self._session)

    def fetch(
        self,
        held: bytearray,
        origin: int,
        progress: Progress | None,
        append: Callable[[bytes], None],
    ) -> None:
        """Extends ``held``, whose first byte is the file's ``origin``, to the end of the file."""
        pieces = _Pieces(origin + len(held))
        self._begin(pieces)
        stall = StallTimer(self._link, "pull again; it goes on where it stopped")
        while pieces.have < self.size:
            self._ask()
            reply = self._hear()
            useful = pieces.useful
            joined = self._take(reply) if reply is not None else b""
            if pieces.useful > useful:
                stall.moved()
            if joined:
                held += joined
                append(joined)
                if progress:
                    progress(pieces.have, self.size)
            stall.check(f"{self._path}: {pieces.have} of {self.size} bytes came")
        if progress:
            progress(self.size, self.size)

    def _begin(self, pieces: _Pieces) -> None:
        self._pieces = pieces
        self._window = RequestWindow(self._link)
        self._size = DATA_BYTES
        self._arrived = 0
        self._judged_from = pieces.frontier
        self._credit = _READS_ALONE
        self._burst_begin = self._burst_end = pieces.frontier
        self._burst_tries = 0
        self._burst_due_s = 0.0

    def _opened(self, reply: FtpReply) -> None:
        size = int.from_bytes(reply.data[:4], "little")
        if self.size not in (-1, size):
            raise FileChangedError(f"{self._path} changed while it was read", "Pull it again.")
        self._session, self.size = reply.session, size

    def _ask(self) -> None:
        """Asks for whatever is due."""
        now_s = self._link.transport.now_s()
        frontier = self._pieces.frontier
        lead = _LEAD_PACKETS * self._size
        if self._burst_end < self.size and frontier >= self._burst_end - lead:
            self._ask_burst(self._burst_end)
        elif frontier < self.size and now_s >= self._burst_due_s:
            if self._burst_tries % 2 == 0:
                self._size = max(self._size // 2, _READ_MIN_BYTES)
            self._ask_burst(frontier)
        if frontier < self.size:
            self._ask_beside_burst()
        else:
            self._ask_last()

    def _ask_beside_burst(self) -> None:
        for offset, length in self._pieces.missing(self._size):
            if self._credit <= 0 or self._window.under_way() >= _READS_MAX:
                return
            if not self._window.waits(offset):
                ends = self.size - self._pieces.frontier < _END_PACKETS * self._size
                self._ask_read(offset, length, _QUEUE_S if ends else _PAUSE_S)
                self._credit -= 1

    def _ask_last(self) -> None:
        """The line is free. The last few are asked twice: that costs less than to wait in vain."""
        missing = list(self._pieces.missing(self._size))
        for offset, length in missing:
            if self._credit <= 0 or self._window.under_way() >= _READS_ALONE:
                return
            if not self._window.waits(offset):
                self._ask_read(offset, length, 0.0, twice=len(missing) <= _LAST_FEW)

    def _ask_burst(self, offset: int) -> None:
        """The next burst, or, when no packet of the last one came, that one again."""
        again = offset < self._burst_end
        self._burst_tries = self._burst_tries + 1 if again else 1
        self._burst_begin = offset
        self._burst_end = min(offset + _BURST_PACKETS * self._size, self.size)
        self._client.send(BURST, self._session, offset, self._size)
        self._expect_burst(0.0)

    def _expect_burst(self, least_s: float) -> None:
        patience_s = max(self._link.round_trip.patience_s(self._burst_tries), least_s)
        self._burst_due_s = self._link.transport.now_s() + self._link.patient(patience_s)

    def _ask_read(self, offset: int, length: int, least_s: float, twice: bool = False) -> None:
        """A frame of full length is the likeliest to be hit, so every second try halves it."""
        tries = self._window.tries(offset)
        length = min(length, max(DATA_BYTES >> tries // 2, _READ_MIN_BYTES))
        self._window.say(offset, least_s)
        for _ in range(1 + twice):
            self._client.send(READ, self._session, offset, length)

    def _hear(self) -> FtpReply | None:
        """The next answer, at most until something is to be asked again."""
        now_s = self._link.transport.now_s()
        due_s = self._window.next_due_s()
        if self._pieces.frontier < self.size:
            due_s = min(due_s, self._burst_due_s)
        wait_s = min(max(due_s - now_s, 0.001), 1.0)
        message = self._link.recv("FILE_TRANSFER_PROTOCOL", wait_s, is_for_us)
        reply = parse(message) if message is not None else None
        ours = reply is not None and reply.session == self._session
        return reply if ours and reply is not None and reply.request in (READ, BURST) else None

    def _take(self, reply: FtpReply) -> bytes:
        """What now joins on to what is held."""
        if reply.error:
            self._refused(reply)
            return b""
        if reply.offset + len(reply.data) > self.size:
            return b""
        self._credit = min(self._credit + 1, _READS_ALONE)
        if reply.request == READ:
            self._window.answered(reply.offset)
        else:
            self._follow_burst(reply)
        return self._pieces.put(reply.offset, reply.data)

    def _follow_burst(self, reply: FtpReply) -> None:
        end = reply.offset + len(reply.data)
        self._credit = min(self._credit, 1)  # room for one answer beside the burst is kept
        self._burst_tries = 1
        self._expect_burst(self._pause_s(reply))
        self._arrived += 1
        self._pieces.pass_over(reply.offset)
        self._judge(end)
        if reply.complete and self._burst_begin < end < self._burst_end:
            self._burst_end = end

    def _pause_s(self, reply: FtpReply) -> float:
        """How long at least the next packet may take. Where a burst ends, the request for the next
        one may have been lost; elsewhere the line stands still."""
        end = reply.offset + len(reply.data)
        stop = self._burst_begin if end <= self._burst_begin else self._burst_end
        left = (stop - end) // self._size
        if reply.complete or left < 0:
            left = 0
        return (left + 1) * _PACKET_S if left < _LEAD_PACKETS else _PAUSE_S

    def _judge(self, end: int) -> None:
        """Packets of a length that gets through."""
        expected = (end - self._judged_from) // self._size
        if expected < _JUDGED_PACKETS:
            return
        loss = 1.0 - self._arrived / expected
        self._judged_from, self._arrived = end, 0
        if loss > _LOSS_HIGH and self._size > _READ_MIN_BYTES:
            self._size = max(self._size // 2, _READ_MIN_BYTES)
            self._burst_end = end  # the next one now
        elif loss < _LOSS_LOW:
            self._size = min(2 * self._size, DATA_BYTES)

    def _refused(self, reply: FtpReply) -> None:
        if reply.error == END_OF_FILE:
            return
        if reply.error not in (INVALID_SESSION, NO_SESSION):
            raise FtpError(reply.error, self._path)
        # the board has restarted, or ended a session that was silent too long
        self._opened(self._client.open(OPEN_READ, self._path))
        self._window.forget()
        self._burst_begin = self._burst_end = self._pieces.frontier


class _Pieces:
    """What came ahead of a hole is kept until the hole is filled."""

    def __init__(self, have: int) -> None:
        self.have = have  # without a hole
        self.frontier = have  # bytes from here on have not been sent yet
        self.useful = 0  # pieces that brought something new
        self._ahead: dict[int, bytes] = {}

    def pass_over(self, offset: int) -> None:
        """A burst has come to ``offset``: what is missing before it is a hole."""
        self.frontier = max(self.frontier, offset)

    def put(self, offset: int, data: bytes) -> bytes:
        """Bytes of the file; returns what of it all now joins on to what is held."""
        known = len(self._ahead.get(offset, b""))
        if offset + len(data) > self.have and offset <= self.frontier and len(data) > known:
            self.useful += 1
            self._ahead[offset] = data
            self.frontier = max(self.frontier, offset + len(data))
        joined = join(self._ahead, self.have)
        self.have += len(joined)
        return joined

    def missing(self, most: int) -> Iterator[tuple[int, int]]:
        """(offset, length) of the holes, in pieces of at most so many bytes."""
        at = self.have
        for offset in (*sorted(self._ahead), self.frontier):
            while at < offset:
                length = min(most, offset - at)
                yield at, length
                at += length
            at = max(at, offset + len(self._ahead.get(offset, b"")))


def join(ahead: dict[int, bytes], have: int) -> bytes:
    """Takes from ``ahead`` all that joins on to the first ``have`` bytes."""
    joined = bytearray()
    for offset in sorted(ahead):
        if offset > have + len(joined):
            break
        joined += ahead.pop(offset)[have + len(joined) - offset :]
    return bytes(joined)


_NOTE_BYTES = 16384  # a note at least so often


class PartFile:
    """The beginning of ``local``, a copy of the board's file ``path`` that has ``crc``."""

    def __init__(self, local: Path, path: str, crc: int) -> None:
        self.data = bytearray()
        self._local = local
        self._part = local.with_name(local.name + ".part")
        self._note = local.with_name(local.name + ".part.json")
        self._whole: dict[str, Any] = {"path": path, "crc32": crc}
        self._noted = 0
        self._file: BinaryIO | None = None
        self._keeps = True

    def begin(self, size: int) -> None:
        """Takes over what is there if it is of the same file and undamaged; else starts empty."""
        self._local.parent.mkdir(parents=True, exist_ok=True)
        self._whole["size_bytes"] = size
        self._file = self._open()
        self.data += self._held()
        self._file.truncate(len(self.data))
        self._write_note()

    def _open(self) -> BinaryIO:
        file = self._part.open("ab")
        if try_lock(file.fileno()) and _is_still_at(self._part, file):
            return file
        file.close()
        self._keeps = False
        self._part = temporary_beside(self._local)
        self._note = temporary_beside(self._local)
        return self._part.open("ab")

    def _held(self) -> bytes:
        with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
            note = json.loads(self._note.read_text())
            held = self._part.read_bytes()[: note["held_bytes"]]
            same_file = all(note[name] == value for name, value in self._whole.items())
            intact = (len(held), crc32(held)) == (note["held_bytes"], note["held_crc32"])
            if same_file and intact and len(held) <= self._whole["size_bytes"]:
                return held
        return b""

    def append(self, data: bytes) -> None:
        """Keeps ``data``, which ``self.data`` ends with already."""
        assert self._file is not None
        self._file.write(data)
        if len(self.data) - self._noted >= _NOTE_BYTES:
            self._write_note()

    def close(self) -> None:
        """Leaves the beginning on disk."""
        if self._file is None:
            return
        if self._keeps:
            self._write_note()
        else:
            self._remove()
        self._end()

    def _end(self) -> None:
        if self._file is not None:
            self._file.close()
        self._file = None

    def _write_note(self) -> None:
        assert self._file is not None
        self._file.flush()
        os.fsync(self._file.fileno())
        held = self._part.read_bytes() if self.data else b""
        note = {**self._whole, "held_bytes": len(held), "held_crc32": crc32(held)}
        replace_file(self._note, json.dumps(note))
        self._noted = len(self.data)

    def finish(self, unpack: Callable[[bytes], bytes] | None = None) -> None:
        """The file is whole: gives it, or what ``unpack`` makes of it, its name."""
        assert self._file is not None
        if unpack is not None:
            replace_file(self._local, unpack(bytes(self.data)))
            self.drop()
            return
        self._file.flush()
        os.fsync(self._file.fileno())
        if not renames_open_files():
            self._end()
        self._part.replace(self._local)
        self._note.unlink(missing_ok=True)
        self._end()
        sync_folder(self._local.parent)

    def drop(self) -> None:
        """What came is of no use."""
        self._remove()
        self._end()

    def _remove(self) -> None:
        self._part.unlink(missing_ok=True)
        self._note.unlink(missing_ok=True)


def _is_still_at(path: Path, file: BinaryIO) -> bool:
    """False: another process has given the file its final name since it was opened."""
    try:
        return os.path.samestat(path.stat(), os.fstat(file.fileno()))
    except FileNotFoundError:
        return False
