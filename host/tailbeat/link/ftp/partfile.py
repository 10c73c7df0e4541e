"""A local file that is still coming: its beginning on disk, and its name only when whole.

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
from pathlib import Path
from typing import Any, BinaryIO

from tailbeat.core.files import replace_file, sync_folder, temporary_beside
from tailbeat.core.locks import try_lock
from tailbeat.core.records import crc32

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

    def finish(self) -> None:
        """The file is whole: gives it its name."""
        assert self._file is not None
        self._file.flush()
        os.fsync(self._file.fileno())
        if os.name == "nt":
            self._end()  # what is open has no other name there
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
