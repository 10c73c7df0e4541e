"""Computes the cells of a recipe on all cores of this computer, or on a Dask cluster.

Every finished cell is on disk at once, so that whatever stops a sweep, the same command goes on
from there. Who computes a cell, and when, changes no bit of the results.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

from tailbeat.errors import InputError, TailbeatError
from tailbeat.onethread import one_thread
from tailbeat.sweep.cell import Cell, cells, run_cell
from tailbeat.sweep.recipe import Recipe
from tailbeat.sweep.results import Store, to_bytes
from tailbeat.workers import cores_here, deaf_children, terminate

Progress = Callable[[int, int], None]  # cells done, cells in all
Finished = Iterator[tuple[Cell, bytes]]


class Interrupted(TailbeatError):
    """Somebody pressed Ctrl-C; what was finished is kept."""


@dataclass(frozen=True)
class Outcome:
    """``computed`` of ``cells`` were missing and are there now."""

    results: Path
    cells: int
    computed: int


def sweep(
    recipe: Recipe,
    out: Path,
    cores: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Outcome:
    """Computes what is missing in ``out`` and puts everything together.

    ``cores``: processes; None = one per core that this process may use. ``scheduler``: address of a
    Dask scheduler, which has the work done instead. Raises InputError when ``out`` holds results of
    something else, Interrupted at Ctrl-C.
    """
    show = progress or (lambda done, total: None)
    store = Store(out)
    store.open(recipe)
    everything = cells(recipe)
    missing = [cell for cell in everything if not store.has(cell)]
    done = len(everything) - len(missing)
    show(done, len(everything))
    try:
        for cell, data in _computed(recipe, missing, cores, scheduler):
            store.put(cell, data)
            done += 1
            show(done, len(everything))
    except KeyboardInterrupt:
        raise Interrupted(
            f"stopped with {done} of {len(everything)} cells done.",
            "The same command goes on from there.",
        ) from None
    return Outcome(store.finish(everything), len(everything), len(missing))


def compute(recipe: Recipe, cell: Cell) -> bytes:
    """A cell as the bytes of its part; what workers run, whoever started them."""
    with one_thread():
        return to_bytes(run_cell(recipe, cell))


def _computed(
    recipe: Recipe, missing: list[Cell], cores: int | None, scheduler: str | None
) -> Finished:
    if not missing:
        return
    if scheduler is not None:
        from tailbeat.sweep.cluster import computed_by

        yield from computed_by(scheduler, recipe, missing)
        return
    yield from _computed_here(recipe, missing, cores or cores_here())


def _computed_here(recipe: Recipe, missing: list[Cell], cores: int) -> Finished:
    before = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        min(cores, len(missing)), multiprocessing.get_context("spawn"), _begin_worker
    )
    queue = iter(missing)
    running: dict[Future[bytes], Cell] = {}
    finished = False
    try:
        with deaf_children():
            _fill(pool, recipe, queue, running, 2 * cores)
        while running:
            ready, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in sorted(ready, key=lambda one: running[one].index):
                cell = running.pop(future)
                yield cell, future.result()
            _fill(pool, recipe, queue, running, 2 * cores)
        finished = True
    except BrokenProcessPool as error:
        raise InputError(
            "a process that computed cells has died.",
            "It may have run out of memory: give fewer --cores. The same command goes on.",
        ) from error
    finally:
        if not finished:
            terminate(pool, set(multiprocessing.active_children()) - before)
        pool.shutdown(wait=True, cancel_futures=True)


def _fill(
    pool: ProcessPoolExecutor,
    recipe: Recipe,
    queue: Iterator[Cell],
    running: dict[Future[bytes], Cell],
    most: int,
) -> None:
    """Keeps some cells waiting, and not all of them: what is queued has to be cancelled."""
    while len(running) < most and (cell := next(queue, None)) is not None:
        running[pool.submit(compute, recipe, cell)] = cell


def _begin_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
