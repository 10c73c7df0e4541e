"""Files on the board, over MAVLink FTP."""

from __future__ import annotations

import contextlib
import secrets
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from tailbeat import _dialect as mavlink
from tailbeat.errors import LinkLostError, TailbeatError, TransferError
from tailbeat.link import BOARD_COMPONENT, BOARD_SYSTEM, HOST_COMPONENT, HOST_SYSTEM, Link, Message
from tailbeat.partfile import PartFile
from tailbeat.records import crc32

Progress = Callable[[int, int], None]

DATA_BYTES = 239
_HEADER = struct.Struct("<HBBBBBBI")
_PAYLOAD_BYTES = 251
_TERMINATE, _RESET = 1, 2
_LIST, _OPEN_READ, _READ, _CREATE, _WRITE, _REMOVE = 3, 4, 5, 6, 7, 8
_CRC32, _BURST = 14, 15
_ACK, _NACK = 128, 129
_EOF, _NO_SESSION, _INVALID_SESSION = 6, 5, 4
_BURST_SEQ_SPAN = 1024  # more than any burst has packets
_ENTRIES_MAX = 10_000  # far more than fit on any board
_TRIES = 10
_READ_MIN_BYTES = 30
_STALLS_MAX = 8  # rounds without a new byte before a transfer is given up
_ERRORS = {
    1: "it failed",
    2: "its file system failed",
    3: "the request had a bad size",
    4: "the transfer session ended",
    5: "another client holds the only transfer session",
    6: "end of file",
    7: "it does not know the request",
    8: "the file exists already",
    9: "the file is protected",
    10: "there is no such file",
}


class FtpError(TransferError):
    """The board's own refusal; ``code`` is that of MAVLink FTP."""

    def __init__(self, code: int, path: str) -> None:
        meaning = _ERRORS.get(code, f"error {code}")
        remedy = "Try again."
        if code in (9, 10):
            remedy = "See what is there: tailbeat trial list."
        super().__init__(f"the board refused {path}: {meaning}", remedy)
        self.code = code


@dataclass(frozen=True)
class RemoteFile:
    """One entry of a folder on the board."""

    name: str
    size: int
    is_dir: bool


@dataclass(frozen=True)
class _Reply:
    opcode: int
    request: int
    session: int
    complete: bool
    offset: int
    data: bytes


class FtpClient:
    """One transfer at a time. Every request is repeated until answered or given up."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._seq = secrets.randbelow(0x10000)

    def list(self, path: str) -> list[RemoteFile]:
        """Entries of a folder, as the board orders them."""
        found: list[RemoteFile] = []
        entries = 0
        while entries < _ENTRIES_MAX:
            try:
                reply = self._request(_LIST, path, offset=entries, data=path.encode())
            except FtpError as error:
                if error.code == _EOF:
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
        reply = self._request(_CRC32, path, data=path.encode())
        return int.from_bytes(reply.data[:4], "little")

    def read(self, path: str, offset: int = 0, progress: Progress | None = None) -> bytes:
        """The file's bytes from ``offset`` on, CRC not compared."""
        with _Download(self, path) as download:
            taken = bytearray()
            download.fetch(taken, offset, progress, lambda _: None)
            return bytes(taken)

    def pull(self, path: str, local: Path, progress: Progress | None = None) -> None:
        """Copies a file byte for byte, resuming what an earlier call left behind.

        While it runs, ``local`` + ``.part`` holds the beginning; ``local`` appears, whole and with
        its CRC verified, in one step at the end.
        """
        expected = self.crc32(path)
        for last in (False, True):
            part = PartFile(local, expected)
            with _Download(self, path) as download:
                part.begin(download.size)
                try:
                    download.fetch(part.data, 0, progress, part.append)
                finally:
                    part.close()
            if crc32(bytes(part.data)) == expected:
                part.finish()
                return
            part.drop()
            if not last:
                expected = self.crc32(path)
        raise TransferError(
            f"{path} arrived damaged twice", "Try again; a trial that is running still changes it."
        )

    def write(self, path: str, data: bytes, progress: Progress | None = None) -> None:
        """Makes a file below /in hold exactly ``data``; its CRC is compared at the end."""
        for last in (False, True):
            try:
                self._write_once(path, data, progress)
            except FtpError as error:
                if last or error.code != _INVALID_SESSION:
                    raise
                continue  # the board ended the session, for instance by a restart
            if self.crc32(path) == crc32(data):
                return
        raise TransferError(f"{path} reached the board damaged", "Upload it again.")

    def _write_once(self, path: str, data: bytes, progress: Progress | None) -> None:
        session = self._open(_CREATE, path).session
        for offset in range(0, len(data), DATA_BYTES):
            piece = data[offset : offset + DATA_BYTES]
            self._request(_WRITE, path, session, offset, piece)
            if progress:
                progress(offset + len(piece), len(data))
        self._request(_TERMINATE, path, session)

    def remove(self, path: str) -> None:
        """Deletes a file. A repeated request may find it gone already; that counts as done."""
        try:
            self._request(_REMOVE, path, data=path.encode())
        except FtpError as error:
            if error.code != 10 or not self._repeated:
                raise

    def reset(self) -> None:
        """Ends all transfer sessions on the board, whoever began them."""
        self._request(_RESET, "/")

    _repeated = False

    def _open(self, opcode: int, path: str) -> _Reply:
        try:
            return self._request(opcode, path, data=path.encode())
        except FtpError as error:
            if error.code != _NO_SESSION:
                raise
        self.reset()
        return self._request(opcode, path, data=path.encode())

    def _request(
        self,
        opcode: int,
        path: str,
        session: int = 0,
        offset: int = 0,
        data: bytes = b"",
        size: int | None = None,
    ) -> _Reply:
        self._seq = (self._seq + 1) & 0xFFFF
        expected = (self._seq + 1) & 0xFFFF
        self._repeated = False
        self._link.flush()

        def fits(answer: Message) -> bool:
            payload = bytes(answer.payload)
            seq, _, _, _, request = struct.unpack_from("<HBBBB", payload)
            return _for_us(answer) and seq == expected and request == opcode

        for attempt, patience_s in enumerate(self._link.attempts(_TRIES)):
            length = size if size is None else _shorter(size, attempt)
            self._link.send(self._packet(opcode, session, offset, data, length))
            answer = self._link.recv("FILE_TRANSFER_PROTOCOL", patience_s, fits)
            if answer is not None:
                self._seq = expected
                return _checked(_parse(answer), path)
            self._repeated = True
        raise AssertionError("attempts always raises at its end")

    def _packet(
        self,
        opcode: int,
        session: int,
        offset: int,
        data: bytes,
        size: int | None = None,
        seq: int | None = None,
    ) -> Message:
        length = len(data) if size is None else size
        number = self._seq if seq is None else seq
        payload = _HEADER.pack(number, session, opcode, length, 0, 0, 0, offset) + data
        return mavlink.MAVLink_file_transfer_protocol_message(
            0, BOARD_SYSTEM, BOARD_COMPONENT, payload.ljust(_PAYLOAD_BYTES, b"\0")
        )


class _Download:
    """An open file on the board. Keeps bytes that came ahead of a hole until it is filled."""

    def __init__(self, client: FtpClient, path: str) -> None:
        self._client = client
        self._link = client._link
        self._path = path
        reply = client._open(_OPEN_READ, path)
        self._session = reply.session
        self.size = int.from_bytes(reply.data[:4], "little")

    def __enter__(self) -> _Download:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with contextlib.suppress(TailbeatError):
            if kind is None:
                self._client._request(_TERMINATE, self._path, self._session)
            else:
                self._link.send(self._client._packet(_TERMINATE, self._session, 0, b""))

    def fetch(
        self,
        taken: bytearray,
        origin: int,
        progress: Progress | None,
        append: Callable[[bytes], None],
    ) -> None:
        """Extends ``taken``, whose first byte is the file's ``origin``, to the end of the file."""
        ahead: dict[int, bytes] = {}
        stalls = 0
        while (have := origin + len(taken)) < self.size:
            for offset, data in self._read_hole(have, ahead) if ahead else self._burst(have):
                ahead[offset] = data
                joined = _join(ahead, origin + len(taken))
                if joined:
                    taken += joined
                    append(joined)
                    if progress:
                        progress(origin + len(taken), self.size)
            stalls = 0 if origin + len(taken) > have else stalls + 1
            if stalls > _STALLS_MAX:
                raise LinkLostError(
                    f"{self._path} stopped coming after {have} of {self.size} bytes",
                    "Run the same command again; it goes on where it stopped.",
                )
        if progress and self.size == origin + len(taken):
            progress(self.size, self.size)

    def _read_hole(self, have: int, ahead: dict[int, bytes]) -> Iterator[tuple[int, bytes]]:
        size = min(DATA_BYTES, min(ahead) - have)
        try:
            reply = self._client._request(_READ, self._path, self._session, have, b"", size)
        except FtpError as error:
            self._reopen_after(error)
            return
        yield have, reply.data

    def _burst(self, have: int) -> Iterator[tuple[int, bytes]]:
        """One burst, as far as it comes through; pieces as they come."""
        client = self._client
        client._seq = (client._seq + 1) & 0xFFFF
        first = client._seq
        client._seq = (first + _BURST_SEQ_SPAN) & 0xFFFF
        self._link.flush()
        self._link.send(client._packet(_BURST, self._session, have, b"", DATA_BYTES, seq=first))

        def fits(answer: Message) -> bool:
            payload = bytes(answer.payload)
            seq, _, _, _, request = struct.unpack_from("<HBBBB", payload)
            behind = (seq - first) & 0xFFFF
            return _for_us(answer) and request == _BURST and 1 <= behind <= _BURST_SEQ_SPAN

        silence_s = self._link.patient(0.7)
        end = have
        while end < self.size:
            answer = self._link.recv("FILE_TRANSFER_PROTOCOL", silence_s, fits)
            if answer is None:
                break
            reply = _parse(answer)
            if reply.opcode == _NACK:
                self._reopen_after(FtpError(reply.data[0] if reply.data else 1, self._path))
                break
            yield reply.offset, reply.data
            end = max(end, reply.offset + len(reply.data))
            if reply.complete:
                break

    def _reopen_after(self, error: FtpError) -> None:
        if error.code == _EOF:
            return
        if error.code not in (_INVALID_SESSION, _NO_SESSION):
            raise error
        self._session = self._client._open(_OPEN_READ, self._path).session


def _shorter(size: int, attempt: int) -> int:
    """Bytes to ask for: a frame of full length is the likeliest to be hit, so every second try that
    fails halves it."""
    return min(size, max(size >> attempt // 2, _READ_MIN_BYTES))


def _join(ahead: dict[int, bytes], have: int) -> bytes:
    """Takes from ``ahead`` all that joins on to the first ``have`` bytes."""
    joined = bytearray()
    for offset in sorted(ahead):
        if offset > have + len(joined):
            break
        joined += ahead.pop(offset)[have + len(joined) - offset :]
    return bytes(joined)


def _for_us(message: Message) -> bool:
    system_ok = message.target_system in (0, HOST_SYSTEM)
    return system_ok and message.target_component in (0, HOST_COMPONENT)


def _parse(message: Message) -> _Reply:
    payload = bytes(message.payload)
    _, session, opcode, size, request, complete, _, offset = _HEADER.unpack_from(payload)
    data = payload[_HEADER.size : _HEADER.size + min(size, DATA_BYTES)]
    return _Reply(opcode, request, session, bool(complete), offset, data)


def _checked(reply: _Reply, path: str) -> _Reply:
    if reply.opcode == _ACK:
        return reply
    raise FtpError(reply.data[0] if reply.data else 1, path)


def _remote_file(row: bytes) -> RemoteFile | None:
    kind, text = row[:1], row[1:].decode("utf-8", "replace")
    if kind == b"D":
        return RemoteFile(text.split("\t", 1)[0], 0, True)
    if kind != b"F":
        return None
    name, _, size = text.partition("\t")
    return RemoteFile(name, int(size) if size.isdigit() else 0, False)
