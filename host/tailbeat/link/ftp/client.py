"""Writing a file to the board: a few blocks under way at a time, in whatever order they arrive.

Files on the board, over MAVLink FTP.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tailbeat.core.errors import TransferError
from tailbeat.core.records import crc32
from tailbeat.link.ftp.download import Download, FileChangedError, PartFile
from tailbeat.link.ftp.wire import (
    CRC32,
    CREATE,
    DATA_BYTES,
    END_OF_FILE,
    INVALID_SESSION,
    LIST,
    NO_SESSION,
    NOT_FOUND,
    OPEN_READ,
    READ,
    REMOVE,
    RESET,
    TERMINATE,
    WRITE,
    FtpError,
    FtpReply,
    FtpRequest,
    Progress,
    RequestWindow,
    StallTimer,
    is_for_us,
    parse,
)
from tailbeat.link.mavlink import Link, Message

__all__ = ["FtpClient", "FtpError", "Progress", "RemoteFile"]

_WRITES_MAX = 4  # under way: fewer bytes than the board's receiver holds


class Upload:
    """A new file on the board, below /in."""

    def __init__(self, client: FtpClient, path: str, data: bytes) -> None:
        self._client = client
        self._link = client.link
        self._path = path
        self._data = data
        self._session = client.open(CREATE, path).session
        self._todo = list(range(0, len(data), DATA_BYTES))
        self._window = RequestWindow(self._link)

    def send(self, progress: Progress | None) -> None:
        """All blocks, each until acknowledged, and the file's end. Raises FtpError."""
        stall = StallTimer(self._link, "upload again")
        done, total = 0, len(self._data)
        while self._todo:
            self._fill()
            reply = self._hear()
            if reply is not None and self._take(reply):
                stall.moved()
                done = min(done + DATA_BYTES, total)
                if progress:
                    progress(done, total)
            stall.check(f"{self._path}: {done} of {total} bytes went up")
        self._client.end(self._session, self._path)

    def _fill(self) -> None:
        for offset in self._todo[:_WRITES_MAX]:
            if not self._window.waits(offset):
                self._window.say(offset)
                block = self._data[offset : offset + DATA_BYTES]
                self._client.send(WRITE, self._session, offset, data=block)

    def _hear(self) -> FtpReply | None:
        wait_s = self._window.next_due_s() - self._link.transport.now_s()
        message = self._link.recv("FILE_TRANSFER_PROTOCOL", min(max(wait_s, 0.001), 1.0), is_for_us)
        reply = parse(message) if message is not None else None
        ours = reply is not None and (reply.session, reply.request) == (self._session, WRITE)
        return reply if ours else None

    def _take(self, reply: FtpReply) -> bool:
        """Whether this acknowledges a block that was not yet."""
        if reply.error:
            raise FtpError(reply.error, self._path)
        self._window.answered(reply.offset)
        if reply.offset not in self._todo:
            return False
        self._todo.remove(reply.offset)
        return True


_ENTRIES_MAX = 10_000  # far more than fit on any board
_TRIES = 16
_LEAST_S = 0.12  # the CRC of a long file takes the board a while
_ROUNDS = 3  # of a whole transfer: a board that restarts, a file that changes


@dataclass(frozen=True)
class RemoteFile:
    """One entry of a folder on the board."""

    name: str
    size: int
    is_dir: bool


def _first_number() -> int:
    """Of a session: anything, so that no answer to another one is taken for its own."""
    return int.from_bytes(os.urandom(2), "little")


class FtpClient:
    """One transfer at a time. Every request is repeated until answered or given up."""

    def __init__(self, link: Link) -> None:
        self.link = link
        self._seq = _first_number()
        self._session = self._seq & 0xFF
        self._repeated = False

    def list(self, path: str) -> list[RemoteFile]:
        """Entries of a folder, as the board orders them."""
        found: list[RemoteFile] = []
        entries = 0
        while entries < _ENTRIES_MAX:
            try:
                reply = self._request(LIST, path, offset=entries, data=path.encode())
            except FtpError as error:
                if error.code == END_OF_FILE:
                    return found
                raise
            rows = [row for row in reply.data.split(b"\0") if row]
            if not rows:
                return found
            entries += len(rows)
            found += [f for f in map(_remote_file, rows) if f is not None]
        raise TransferError(f"{path} has no end", "Power the board off and on, and try again.")

    def crc32(self, path: str) -> int:
        """CRC-32 of a whole file, computed by the board."""
        reply = self._request(CRC32, path, data=path.encode())
        return int.from_bytes(reply.data[:4], "little")

    def read(self, path: str, offset: int = 0, progress: Progress | None = None) -> bytes:
        """The file's bytes from ``offset`` on, CRC not compared."""
        with Download(self, path) as download:
            taken = bytearray()
            download.fetch(taken, offset, progress, lambda _: None)
            return bytes(taken)

    def head(self, path: str, size: int) -> bytes:
        """The file's first ``size`` bytes, or all of a shorter one; one after the other, CRC not
        compared."""
        session = self.open(OPEN_READ, path).session
        taken = b""
        try:
            while len(taken) < size:
                wanted = min(size - len(taken), DATA_BYTES)
                data = self._request(READ, path, session, len(taken), size=wanted).data
                if not data:
                    break
                taken += data
        except FtpError as error:
            if error.code != END_OF_FILE:
                raise
        self.send(TERMINATE, session)
        return taken

    def pull(
        self,
        path: str,
        local: Path,
        progress: Progress | None = None,
        unpack: Callable[[bytes], bytes] | None = None,
    ) -> None:
        """Copies a file byte for byte, resuming what an earlier call left behind.

        While it runs, ``local`` + ``.part`` holds the beginning; ``local`` appears, whole and with
        its CRC verified, in one step at the end. It holds what ``unpack`` makes of the file.
        """
        for _ in range(_ROUNDS):
            expected, opened = self._crc32_and_open(path)
            with contextlib.closing(PartFile(local, path, expected)) as part:
                whole = self._fetch(path, opened, part, progress)
                if whole and crc32(bytes(part.data)) == expected:
                    part.finish(unpack)
                    return
                part.drop()
        raise TransferError(
            f"{path} arrived damaged {_ROUNDS} times",
            "Try again; a trial that is running still changes it.",
        )

    def _crc32_and_open(self, path: str) -> tuple[int, FtpReply]:
        """Both are asked at once: what is lost of them costs one wait."""
        name = path.encode()
        self._session = self._session % 255 + 1
        crc, opened = self._replies(
            path, self._make(CRC32, data=name), self._make(OPEN_READ, self._session, data=name)
        )
        crc_reply = _checked(crc, path)
        if opened.error == NO_SESSION:
            opened = self.open(OPEN_READ, path)
        return int.from_bytes(crc_reply.data[:4], "little"), _checked(opened, path)

    def _fetch(
        self, path: str, opened: FtpReply, part: PartFile, progress: Progress | None
    ) -> bool:
        """Whether all of it came; not when the file became another one meanwhile."""
        with Download(self, path, opened) as download:
            part.begin(download.size)
            try:
                download.fetch(part.data, 0, progress, part.append)
            except FileChangedError:
                return False
        return True

    def write(self, path: str, data: bytes, progress: Progress | None = None) -> None:
        """Makes a file below /in hold exactly ``data``; its CRC is compared at the end."""
        for last in (False,) * (_ROUNDS - 1) + (True,):
            try:
                Upload(self, path, data).send(progress)
                if self.crc32(path) == crc32(data):
                    return
            except FtpError as error:  # the board has restarted
                if last or error.code not in (INVALID_SESSION, NOT_FOUND):
                    raise
        raise TransferError(f"{path} reached the board damaged {_ROUNDS} times", "Upload it again.")

    def remove(self, path: str) -> None:
        """Deletes a file. A repeated request may find it gone already; that counts as done."""
        try:
            self._request(REMOVE, path, data=path.encode())
        except FtpError as error:
            if error.code != NOT_FOUND or not self._repeated:
                raise

    def reset(self) -> None:
        """Ends all transfer sessions on the board, whoever began them."""
        self._request(RESET, "/")

    def open(self, opcode: int, path: str) -> FtpReply:
        """A session of a number of its own, so that answers to an earlier one are known by it."""
        self._session = self._session % 255 + 1
        try:
            return self._request(opcode, path, self._session, data=path.encode())
        except FtpError as error:
            if error.code != NO_SESSION:
                raise
        self.reset()
        return self._request(opcode, path, self._session, data=path.encode())

    def end(self, session: int, path: str) -> None:
        """Closes a session. One that is not there any more counts as closed."""
        try:
            self._request(TERMINATE, path, session)
        except FtpError as error:
            if error.code != INVALID_SESSION:
                raise

    def send(
        self,
        opcode: int,
        session: int,
        offset: int = 0,
        size: int | None = None,
        data: bytes = b"",
    ) -> None:
        """Sends a request once, and waits for nothing."""
        self._seq = (self._seq + 1) & 0xFFFF
        self.link.send(FtpRequest(self._seq, session, opcode, offset, data, size).message())

    def _request(
        self,
        opcode: int,
        path: str,
        session: int = 0,
        offset: int = 0,
        data: bytes = b"",
        size: int | None = None,
    ) -> FtpReply:
        (reply,) = self._replies(path, self._make(opcode, session, offset, data, size))
        return _checked(reply, path)

    def _make(
        self,
        opcode: int,
        session: int = 0,
        offset: int = 0,
        data: bytes = b"",
        size: int | None = None,
    ) -> FtpRequest:
        """A request under a number of its own; the next one is that of its answer."""
        self._seq = (self._seq + 2) & 0xFFFF
        return FtpRequest(self._seq, session, opcode, offset, data, size)

    def _replies(self, path: str, *requests: FtpRequest) -> Sequence[FtpReply]:
        """The answers to all of them, refusals too; each is repeated until answered."""
        waiting = {((one.seq + 1) & 0xFFFF, one.opcode): one for one in requests}
        found: dict[FtpRequest, FtpReply] = {}

        def fits(message: Message) -> bool:
            answer = parse(message)
            return is_for_us(message) and (answer.seq, answer.request) in waiting

        self.link.flush()
        for attempt, _ in enumerate(self.link.attempts(_TRIES)):
            self._repeated = attempt > 0
            patience_s = max(self.link.round_trip.patience_s(attempt + 1), _LEAST_S)
            sent_s = self.link.transport.now_s()
            for one in waiting.values():
                self.link.send(one.message())
            due_s = sent_s + self.link.patient(patience_s)
            while waiting:
                left_s = due_s - self.link.transport.now_s()
                answer = self.link.recv("FILE_TRANSFER_PROTOCOL", left_s, fits)
                if answer is None:
                    break
                reply = parse(answer)
                found[waiting.pop((reply.seq, reply.request))] = reply
                self.link.round_trip.heard(self.link.transport.now_s() - sent_s, attempt + 1)
            if not waiting:
                return [found[one] for one in requests]
        raise AssertionError("attempts always raises at its end")


def _checked(reply: FtpReply, path: str) -> FtpReply:
    if reply.error:
        raise FtpError(reply.error, path)
    return reply


def _remote_file(row: bytes) -> RemoteFile | None:
    kind, text = row[:1], row[1:].decode("utf-8", "replace")
    if kind == b"D":
        return RemoteFile(text.split("\t", 1)[0], 0, True)
    if kind != b"F":
        return None
    name, _, size = text.partition("\t")
    return RemoteFile(name, int(size) if size.isascii() and size.isdigit() else 0, False)
