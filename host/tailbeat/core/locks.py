"""Locks between processes, held by the operating system: they end with the process that holds them.

A file system that knows no locks (some network folders) is used without them.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from tailbeat.core.errors import InputError

WRITE_LOCK = ".write-lock"
WAIT_S = 10.0  # a change takes milliseconds: whoever holds a lock longer has been stopped
_LOOK_S = 0.005

if sys.platform == "win32":
    import msvcrt

    _BEHIND_ALL_BYTES = 1 << 30  # Windows keeps others from reading what is locked

    def try_lock(descriptor: int) -> bool:
        """Takes the lock of an open file if it is free."""
        os.lseek(descriptor, _BEHIND_ALL_BYTES, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

else:
    import fcntl

    def try_lock(descriptor: int) -> bool:
        """Takes the lock of an open file if it is free. Closing the file returns it."""
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:
            pass
        return True


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
