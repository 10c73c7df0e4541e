"""A program that is ended from outside stops the tail first, and leaves the terminal as it was."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_NAMES = ("SIGTERM", "SIGHUP")  # ended by the system; the terminal was closed

_came: list[str] = []


def ended() -> str:
    """Why the program is to end, in words; empty = it is not."""
    return _came[0] if _came else ""


@contextmanager
def ended_as_by_ctrl_c() -> Iterator[None]:
    """For the length of a block these signals raise KeyboardInterrupt with words; one that is
    ignored (nohup), or that somebody else handles, stays with them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]
    taken = [number for number in numbers if signal.getsignal(number) is signal.SIG_DFL]
    begun_by = os.getpid()

    def end(number: int, _: FrameType | None) -> None:
        if os.getpid() != begun_by:  # a worker that was forked ends at once
            os._exit(128 + number)
        _came.append(f"ended by {signal.Signals(number).name}")
        raise KeyboardInterrupt(_came[0])

    for number in taken:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)
        _came.clear()
