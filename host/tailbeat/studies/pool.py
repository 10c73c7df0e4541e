"""Processes that compute tasks on the cores of this computer.

Who computes a task, and when, changes no bit of its result.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.context import SpawnContext
from typing import Any, TypeVar

from tailbeat.core.errors import InputError
from tailbeat.core.parallel import deaf_children, terminate

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
