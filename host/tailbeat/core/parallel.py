"""Processes that compute tasks on the cores of this computer, and one thread of linear algebra.

Who computes a task, and when, changes no bit of its result. The order in which threads add up would
be in the last bits; besides, more threads than processes would fight for the cores.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import threading
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.context import SpawnContext
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from tailbeat.core.errors import InputError


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


Result = TypeVar("Result")

CONTEXT: SpawnContext = multiprocessing.get_context("spawn")
_QUEUED_PER_CORE = 2  # what is queued has to be cancelled, so few tasks wait at a time


def each_result(
    work: Callable[..., Result],
    tasks: Iterable[tuple[int, tuple[Any, ...]]],
    cores: int,
    died: InputError,
    begin: Callable[..., None] | None = None,
    shared: tuple[Any, ...] = (),
    poll_s: float | None = None,
    polled: Callable[[], None] = lambda: None,
) -> Iterator[tuple[int, Result]]:
    """The results as they are finished, each with the index of its task; several that finish
    together come in the order of their indices. The processes end with the iterator.

    Parameters
    ----------
    work
        Computes a task: ``work(*arguments)``, in a process of ``cores``.
    tasks
        (index, arguments), in the order in which they begin.
    died
        Raised when a process dies.
    begin, shared
        Called as ``begin(*shared)`` when a process begins.
    poll_s, polled
        ``polled`` is called after every result, and at least every ``poll_s`` seconds.
    """
    before = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(cores, CONTEXT, _begin, (begin, shared))
    queue = iter(tasks)
    running: dict[Future[Result], int] = {}

    def fill() -> None:
        while len(running) < _QUEUED_PER_CORE * cores and (task := next(queue, None)) is not None:
            index, arguments = task
            running[pool.submit(work, *arguments)] = index

    finished = False
    try:
        with deaf_children():
            fill()
        while running:
            ready, _ = wait(running, timeout=poll_s, return_when=FIRST_COMPLETED)
            for future in sorted(ready, key=lambda one: running[one]):
                yield running.pop(future), future.result()
            fill()
            polled()
        finished = True
    except BrokenProcessPool as error:
        raise died from error
    finally:
        if not finished:
            terminate(pool, set(multiprocessing.active_children()) - before)
        pool.shutdown(wait=True, cancel_futures=True)


def _begin(begin: Callable[..., None] | None, shared: tuple[Any, ...]) -> None:
    """A process leaves Ctrl-C to the one that started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if begin is not None:
        begin(*shared)
