"""One program at a time swims in an experiment; the system lets go when that program dies."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

from tailbeat.errors import InputError, reason
from tailbeat.filelock import try_lock
from tailbeat.lasting import MAKE_ROOM

if TYPE_CHECKING:
    from tailbeat.experiment.folder import Experiment

LOCK = ".lock"


@contextlib.contextmanager
def alone(experiment: Experiment) -> Iterator[None]:
    """For the length of a block. Raises InputError when another program is in one."""
    path = experiment.folder / LOCK
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise InputError(f"cannot make {path} ({reason(error)}).", MAKE_ROOM) from error
    try:
        if not try_lock(descriptor):
            raise InputError(
                f"another program swims in {experiment.name}.",
                "Go on there, at its terminal or its page; or end it, then begin again.",
            )
        yield
    finally:
        os.close(descriptor)
