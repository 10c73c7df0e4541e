"""One thread of linear algebra, so that numbers do not depend on how many cores a computer has.

The order in which threads add up would be in the last bits; besides, more threads than processes
would fight for the cores.

Processes that compute on the cores of this computer: how many, Ctrl-C, and how they end.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Collection, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.process import BaseProcess
from typing import Any


class _Limit:
    """The limit is one of the whole process: the last of its threads to leave lifts it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._limits: Any = None

    def enter(self) -> None:
        import scipy.linalg  # noqa: F401  what is loaded later would not be limited
        from threadpoolctl import threadpool_limits

        with self._lock:
            if self._inside == 0:
                _take_control()
                self._limits = threadpool_limits(limits=1)
            self._inside += 1

    def leave(self) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                _take_control()
                self._limits.restore_original_limits()
                _take_control()


def _take_control() -> None:
    """threadpoolctl lets only one thread limit OpenBLAS: the next that does, from now on."""
    from threadpoolctl import OpenBLASController

    OpenBLASController.clear_controlling_thread(force=True)


_limit = _Limit()


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """As long as anybody is inside, BLAS and LAPACK of this process use one thread."""
    _limit.enter()
    try:
        yield
    finally:
        _limit.leave()


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
