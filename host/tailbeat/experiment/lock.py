"""One program at a time swims in an experiment; the system lets go when that program dies."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

from tailbeat.errors import InputError, reason
from tailbeat.lasting import MAKE_ROOM

if TYPE_CHECKING:
    from tailbeat.experiment.folder import Experiment

LOCK = ".lock"

if sys.platform == "win32":
    import msvcrt

    def _take(descriptor: int) -> bool:
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

else:
    import fcntl

    def _take(descriptor: int) -> bool:
        """A folder of a server that knows no locks goes without."""
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:
            pass
        return True


@contextlib.contextmanager
def alone(experiment: Experiment) -> Iterator[None]:
    """For the length of a block. Raises InputError when another program is in one."""
    path = experiment.folder / LOCK
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise InputError(f"cannot make {path} ({reason(error)}).", MAKE_ROOM) from error
    try:
        if not _take(descriptor):
            raise InputError(
                f"another program swims in {experiment.name}.",
                "Go on there, at its terminal or its page; or end it, then begin again.",
            )
        yield
    finally:
        os.close(descriptor)
