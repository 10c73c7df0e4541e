"""Locks, lasting names and permissions of files."""

from __future__ import annotations

import importlib
import os
import stat
import sys
from pathlib import Path

BINARY = getattr(os, "O_BINARY", 0)
"""Flag of os.open without which Windows changes line ends; 0 elsewhere."""

_BEHIND_ALL_BYTES = 1 << 30  # Windows keeps others from reading what is locked
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


def sync_folder(folder: Path, system: str = sys.platform) -> None:
    """Makes the names in it last, as fsync does contents; Windows neither needs nor allows it."""
    if system != "win32":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def try_lock(descriptor: int, system: str = sys.platform) -> bool:
    """Takes the lock of an open file if it is free; closing the file returns it. On a file system
    without locks: True."""
    return (_try_windows if system == "win32" else _try_posix)(descriptor)


def _try_windows(descriptor: int) -> bool:
    msvcrt = importlib.import_module("msvcrt")
    os.lseek(descriptor, _BEHIND_ALL_BYTES, os.SEEK_SET)
    try:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
    except OSError:
        return False
    return True


def _try_posix(descriptor: int) -> bool:
    fcntl = importlib.import_module("fcntl")
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        pass
    return True


def renames_open_files(system: str = sys.platform) -> bool:
    """Whether a file may get another name while it is open."""
    return system != "win32"


def readable_by_others(path: Path, system: str = sys.platform) -> bool:
    """Whether other users of this computer can get at the file; unknown on Windows: False."""
    return system != "win32" and bool(path.stat().st_mode & _OTHERS)
