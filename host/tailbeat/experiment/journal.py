"""What happened in an experiment, in order: ``journal.jsonl``, one JSON object per line.

Every line has ``time`` (ISO 8601 with zone, local) and ``what``:

``made``, ``opened``; ``typed`` {command}: what makes the fish swim; ``set`` {params, conditions,
...}: what is new of them; ``begun`` and ``swum`` {trial, iteration, end, file, rested_s, pose,
drift, travel, battery_start_v, battery_end_v, board_s}; ``void`` {trial, end}: begun, but not
executed; ``decided`` {trial, decision, reason, file}, ``withdrawn`` {trial, file, reason};
``learned`` {trial, ..., rolled_back}; ``note`` {text}; ``resumed`` {..., board_s}; ``restarted``
{board_s}: the board was switched off, and somebody said to go on; ``trimmed`` {...}; ``identified``
{file}; ``restored`` {trial}

A line that the end of power has torn is never removed: it is ended with ``#torn`` and not read.

What the journal says of each trial.
"""

from __future__ import annotations

import contextlib
import json
import os
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from tailbeat.core.errors import InputError, reason
from tailbeat.core.files import plain, sync_folder
from tailbeat.core.locks import wait_lock
from tailbeat.core.param_names import of_document

_TORN = b" #torn"
_BINARY = getattr(os, "O_BINARY", 0)  # only Windows has, and needs, it


@dataclass(frozen=True)
class Journal:
    """The file; made by the first entry."""

    path: Path

    def add(self, what: str, now: datetime | None = None, **values: Any) -> dict[str, Any]:
        """Appends one line, lasting when it returns; what was written. NaN becomes null. A line
        that an earlier end of power has torn is ended first. Raises InputError (disk full)."""
        time = (now or datetime.now()).astimezone().isoformat(timespec="seconds")
        entry = {"time": time, "what": what, **plain(values)}
        # ASCII, so that a file torn at any byte is still text
        line = json.dumps(entry, allow_nan=False).encode("ascii") + b"\n"
        try:
            is_new = not self.path.exists()
            self._append(line)
            if is_new:
                sync_folder(self.path.parent)
        except OSError as error:
            raise InputError(
                f"cannot write into {self.path} ({reason(error)}).",
                "Make room on this computer, or make the folder writable; then do it again.",
            ) from error
        return entry

    def _append(self, line: bytes) -> None:
        """The line whole, or nothing of it."""
        descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | _BINARY, 0o644)
        try:
            wait_lock(descriptor, self.path)  # or another process's half line would count as torn
            size = os.fstat(descriptor).st_size
            content = _end_of(_last_line(self.path)) + line
            try:
                left = content
                while left:
                    left = left[os.write(descriptor, left) :]
                os.fsync(descriptor)
            except OSError:
                with contextlib.suppress(OSError):
                    os.ftruncate(descriptor, size)
                raise
        finally:
            os.close(descriptor)

    def entries(self, what: str | None = None) -> list[dict[str, Any]]:
        """All lines, or those of one kind, in order. A torn last line is left out; any other that
        cannot be read raises InputError."""
        lines = self._lines()
        found = []
        for number, line in enumerate(lines, 1):
            if not line.strip() or line.endswith(_TORN):
                continue
            entry = _entry(line)
            if entry is not None:
                found.append(entry)
            elif number < len(lines):
                raise InputError(
                    f"line {number} of {self.path} is damaged.",
                    "Mend it by hand (one JSON object with time and what), or put a copy back.",
                )
        return [entry for entry in found if what is None or entry["what"] == what]

    def decisions(self) -> dict[int, dict[str, Any]]:
        """The last decision on every trial, by number."""
        return {
            entry["trial"]: entry
            for entry in self.entries("decided")
            if isinstance(entry.get("trial"), int)
        }

    def _lines(self) -> list[bytes]:
        """The last is what comes after the last line end: torn, or empty."""
        try:
            return self.path.read_bytes().split(b"\n")
        except FileNotFoundError:
            return []
        except OSError as error:
            raise InputError(
                f"cannot read {self.path} ({reason(error)}).", "Make the file readable."
            ) from error


def _last_line(path: Path) -> bytes:
    return path.read_bytes().rpartition(b"\n")[2]


def _end_of(last: bytes) -> bytes:
    """What ends a line that was left without an end."""
    if not last:
        return b""
    return b"\n" if _entry(last) is not None else _TORN + b"\n"


def _entry(line: bytes) -> dict[str, Any] | None:
    """None when it is none: no beginning of an object is itself an object."""
    try:
        entry = json.loads(line.decode("utf-8"))
    except (ValueError, RecursionError):
        return None
    if isinstance(entry, dict) and isinstance(entry.get("what"), str) and "time" in entry:
        return of_document(entry)
    return None
