"""The one way this package writes a file: complete or not at all, and lasting after a power cut;
locks between processes; values as JSON knows them.

Several processes may write the same file at once: each writes under a temporary name of its own,
and the last one to finish wins. Whoever reads a file, changes it and writes it again also needs
``locked``. Recordings that grow while they are made (IMU, bad line) are not written here.

Locks are held by the operating system: they end with the process that holds them. A file system
that knows no locks (some network folders) is used without them.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import math
import os
import threading
import time
from collections.abc import Iterator
from enum import Enum, StrEnum
from pathlib import Path
from typing import Any, BinaryIO, TextIO

from tailbeat.core.errors import InputError, reason
from tailbeat.core.platform.files import BINARY, sync_folder, try_lock

MAKE_ROOM = "Make room on this computer, then go on; nothing is lost."
TEMPORARY = ".tmp"
"""Ending of every temporary name. A power cut can leave such a file; it can be deleted."""

_NAME_SIGNS = 40  # of the file's name in its temporary one: file systems take 255 bytes in all


def temporary_beside(path: Path) -> Path:
    """A name in the same folder that no other process uses."""
    return path.with_name(f".{path.name[:_NAME_SIGNS]}.{os.urandom(6).hex()}{TEMPORARY}")


@contextlib.contextmanager
def replacing(path: Path, mode: int = 0o666) -> Iterator[BinaryIO]:
    """A file to write, which takes the place of ``path`` at the end of the block; after an
    exception ``path`` is what it was. A device or a pipe is written directly. ``mode``: permissions
    of the new file, less the umask. Raises OSError."""
    if path.exists() and not path.is_file():
        with path.open("wb") as file:
            yield file
        return
    part = temporary_beside(path)
    try:
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | BINARY, mode)
    except OSError as error:
        error.filename = str(path)  # the temporary name says nothing to anybody
        raise
    try:
        with os.fdopen(descriptor, "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


@contextlib.contextmanager
def replacing_text(path: Path) -> Iterator[TextIO]:
    """As ``replacing``, for text: UTF-8, line ends as they are written."""
    with replacing(path) as file:
        text = io.TextIOWrapper(file, encoding="utf-8", newline="")
        yield text
        text.flush()
        text.detach()


def replace_file(path: Path, content: str | bytes, mode: int = 0o666) -> None:
    """Writes the file complete or not at all. Raises OSError."""
    with replacing(path, mode) as file:
        file.write(content.encode() if isinstance(content, str) else content)


def write_whole(path: Path, content: str | bytes, remedy: str = "Choose another place.") -> None:
    """As ``replace_file``, but raises InputError; ``remedy``: what to do then."""
    try:
        replace_file(path, content)
    except OSError as error:
        raise InputError(f"cannot write {path} ({reason(error)})", remedy) from error


def plain(value: Any) -> Any:
    """The value as JSON knows it; NaN and infinities become null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, Enum):
        return value.value if isinstance(value, StrEnum) else value.name
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def canonical(document: Any) -> bytes:
    """JSON of which the same values always make the same bytes: keys sorted, ASCII, numbers in the
    fewest digits that give the same double again."""
    text = json.dumps(plain(document), sort_keys=True, indent=1, allow_nan=False)
    return text.encode("ascii") + b"\n"


WRITE_LOCK = ".write-lock"
WAIT_S = 10.0  # a change takes milliseconds: whoever holds a lock longer has been stopped
_LOOK_S = 0.005


def wait_lock(descriptor: int, path: Path, wait_s: float = WAIT_S) -> None:
    """Takes the lock of an open file; ``path`` is its name. Raises InputError after ``wait_s``."""
    end_s = time.monotonic() + wait_s
    while not try_lock(descriptor):
        if time.monotonic() > end_s:
            raise InputError(
                f"another program has held {path} for more than {wait_s:g} s.",
                "Look for a tailbeat that is stopped or hangs; end it, then do this again.",
            )
        time.sleep(_LOOK_S)


class _Held(threading.local):
    """The folders this thread has locked."""

    def __init__(self) -> None:
        self.folders: set[Path] = set()


_held = _Held()


@contextlib.contextmanager
def locked(folder: Path, wait_s: float = WAIT_S) -> Iterator[None]:
    """One process and thread at a time changes files of ``folder``, which must exist. A block
    within a block of the same folder does nothing. Raises InputError when the lock is not free
    within ``wait_s``, OSError when its file cannot be made."""
    key = folder.resolve()
    if key in _held.folders:
        yield
        return
    path = folder / WRITE_LOCK
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        wait_lock(descriptor, path, wait_s)
        _held.folders.add(key)
        try:
            yield
        finally:
            _held.folders.discard(key)
    finally:
        os.close(descriptor)
