"""A local file that is still coming: its beginning on disk, and its name only when whole."""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path
from typing import BinaryIO


class PartFile:
    """The beginning of a file that is still coming, and what it must become."""

    def __init__(self, local: Path, crc: int) -> None:
        self.data = bytearray()
        self._local = local
        self._part = local.with_name(local.name + ".part")
        self._note = local.with_name(local.name + ".part.json")
        self._crc = crc
        self._file: BinaryIO | None = None

    def begin(self, size: int) -> None:
        """Takes over what is there if it is of the same file; else starts empty."""
        self._local.parent.mkdir(parents=True, exist_ok=True)
        note = {"size_bytes": size, "crc32": self._crc}
        with contextlib.suppress(OSError, ValueError):
            if json.loads(self._note.read_text()) == note:
                self.data += self._part.read_bytes()[:size]
        if not self.data:
            self._note.write_text(json.dumps(note))
        self._file = self._part.open("ab")
        self._file.truncate(len(self.data))

    def append(self, data: bytes) -> None:
        """Keeps bytes that extend the beginning."""
        assert self._file is not None
        self._file.write(data)

    def close(self) -> None:
        """Leaves the beginning on disk."""
        if self._file is None:
            return
        with self._file as file:
            self._file = None
            file.flush()
            os.fsync(file.fileno())

    def finish(self) -> None:
        """The file is whole: gives it its name."""
        self._part.replace(self._local)
        self._note.unlink(missing_ok=True)

    def drop(self) -> None:
        """What came is of no use."""
        self._part.unlink(missing_ok=True)
        self._note.unlink(missing_ok=True)
