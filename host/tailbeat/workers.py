"""Processes that compute on the cores of this computer: how many, Ctrl-C, and how they end."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Collection, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.process import BaseProcess


def cores_here() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextlib.contextmanager
def deaf_children() -> Iterator[None]:
    """New processes inherit deafness to Ctrl-C, which is meant for this process."""
    main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN) if main else None
    try:
        yield
    finally:
        if main:
            signal.signal(signal.SIGINT, handler)


def terminate(pool: ProcessPoolExecutor, children: Collection[BaseProcess]) -> None:
    """Ends the pool's processes in the middle of their work.

    One that is sending its result leaves half of it in the pipe. The pool's thread would wait for
    the rest for ever, because this process holds a writing end, too: it is closed.
    """
    for child in children:
        child.terminate()
    for child in children:
        child.join()
    writer = getattr(getattr(pool, "_result_queue", None), "_writer", None)
    if writer is not None:
        writer.close()
