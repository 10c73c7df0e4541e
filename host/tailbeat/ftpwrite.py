"""Writing a file to the board: a few blocks under way at a time, in whatever order they arrive."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tailbeat.ftpwindow import Stall, Window
from tailbeat.ftpwire import CREATE, DATA_BYTES, WRITE, FtpError, Reply, is_for_us, parse

if TYPE_CHECKING:
    from tailbeat.ftp import FtpClient, Progress

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
        self._window = Window(self._link, client.round_trip)

    def send(self, progress: Progress | None) -> None:
        """All blocks, each until acknowledged, and the file's end. Raises FtpError."""
        stall = Stall(self._link, "upload again")
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

    def _hear(self) -> Reply | None:
        wait_s = self._window.next_due_s() - self._link.transport.now_s()
        message = self._link.recv("FILE_TRANSFER_PROTOCOL", min(max(wait_s, 0.001), 1.0), is_for_us)
        reply = parse(message) if message is not None else None
        ours = reply is not None and (reply.session, reply.request) == (self._session, WRITE)
        return reply if ours else None

    def _take(self, reply: Reply) -> bool:
        """Whether this acknowledges a block that was not yet."""
        if reply.error:
            raise FtpError(reply.error, self._path)
        self._window.answered(reply.offset)
        if reply.offset not in self._todo:
            return False
        self._todo.remove(reply.offset)
        return True
