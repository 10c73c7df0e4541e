"""Runs examples, alone or many on all cores. Who computes one, and when, changes no bit of it."""

from __future__ import annotations

import importlib
import math
import multiprocessing
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.errors import InputError
from tailbeat.onethread import one_thread
from tailbeat.thesis.example import Claim, Example, Figure, Run
from tailbeat.thesis.options import Options
from tailbeat.thesis.progress import Show, heard
from tailbeat.workers import deaf_children, terminate

REGISTRY = "tailbeat.thesis.examples"  # the module whose EXAMPLES workers look in
_RUN_PART = 0.1  # of an example's time, about, where claims are judged
_FIGURES_PART = 0.1
_POLL_S = 0.2


@dataclass(frozen=True)
class Result:
    """What came of one example. Without traces, as it travels between processes."""

    example_id: str
    options: Options
    iterations: NDArray[np.int64]
    max_abs_error: NDArray[np.float64]
    executed: NDArray[np.float64] | None
    lengths: NDArray[np.float64] | None
    diverged: int | None
    claims: list[Claim] = field(default_factory=list)
    figures: list[Figure] = field(default_factory=list)


@dataclass(frozen=True)
class Order:
    """One example to compute. ``figures``: folder to draw into, None = draw nothing."""

    example_id: str
    options: Options
    claims: bool = True
    figures: Path | None = None
    registry: str = REGISTRY


class CachedStudy:
    """``Study`` of an example: the same run is computed once. Claims judge the thesis's own
    settings, so of the options only the precision of the laws is taken over."""

    def __init__(self, example: Example, options: Options, tick: Show | None = None) -> None:
        self._example = example
        self._options = Options(precision=options.precision)
        self._tick = tick or (lambda done: None)
        self._runs: dict[Options, Run] = {}

    def run(self, **changes: Any) -> Run:
        return self.run_with(replace(self._options, **changes))

    def run_with(self, options: Options) -> Run:
        """A run with exactly these options."""
        if options not in self._runs:
            self._runs[options] = self._example.run(options)
        return self._runs[options]

    def tick(self, done: float) -> None:
        self._tick(min(max(done, 0.0), 1.0))


def compute(order: Order, tick: Show | None = None) -> Result:
    """Runs the example, then judges its claims and draws its figures. Raises InputError, with the
    example's name, when its settings make no sense."""
    example = _find(order)
    show = tick or (lambda done: None)
    part = 1 - _FIGURES_PART if order.figures else 1.0
    begun = _RUN_PART if order.claims else part
    study = CachedStudy(example, order.options, lambda done: show(begun + (part - begun) * done))
    with one_thread(), np.errstate(all="ignore"):
        with heard(lambda done: show(begun * done)):
            run = _told(_run(example, study, order.options))
        claims = example.claims(study) if order.claims else []
        show(part)
        figures = example.figures(study, order.figures) if order.figures else []
    show(1.0)
    return Result(
        example_id=example.id,
        options=order.options,
        iterations=run.iterations,
        max_abs_error=run.max_abs_error,
        executed=run.executed,
        lengths=run.lengths,
        diverged=run.diverged,
        claims=claims,
        figures=figures,
    )


def _told(run: Run) -> Run:
    """With a row even when the very first iteration diverged: nothing finite is known of it."""
    if len(run.iterations) or run.diverged is None:
        return run

    def unknown(column: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.full((1, *column.shape[1:]), np.nan)

    return replace(
        run,
        iterations=np.array([run.diverged]),
        max_abs_error=unknown(run.max_abs_error),
        executed=None if run.executed is None else unknown(run.executed),
        lengths=None if run.lengths is None else unknown(run.lengths),
    )


def _find(order: Order) -> Example:
    examples: Sequence[Example] = importlib.import_module(order.registry).EXAMPLES
    return next(one for one in examples if one.id == order.example_id)


def _run(example: Example, study: CachedStudy, options: Options) -> Run:
    try:
        return study.run_with(options)
    except InputError as error:
        raise InputError(f"{example.id}: {error.message}", error.remedy) from error
    except (MemoryError, OverflowError) as error:
        raise InputError(
            f"{example.id}: these settings are more than this computer can compute.",
            "Take a longer step or fewer iterations.",
        ) from error


def run_many(
    orders: Sequence[Order],
    weights: Sequence[float],
    cores: int,
    progress: Show | None = None,
) -> list[Result]:
    """All orders' results in their order. ``weights``: how long each takes, about; the longest
    begins first. With one core or one order this process computes itself.

    Raises:
        InputError: when settings make no sense, or a process died.
        KeyboardInterrupt: at Ctrl-C, after its processes have ended.
    """
    show = progress or (lambda done: None)
    if cores <= 1 or len(orders) <= 1:
        return _here(orders, weights, show)
    found: dict[int, Result] = {}
    for index, result in _in_processes(orders, weights, min(cores, len(orders)), show):
        found[index] = result
    return [found[index] for index in range(len(orders))]


def _here(orders: Sequence[Order], weights: Sequence[float], show: Show) -> list[Result]:
    done, total = 0.0, math.fsum(weights)
    results = []
    for order, weight in zip(orders, weights, strict=True):
        begun = done / total

        def tick(part: float, begun: float = begun, share: float = weight / total) -> None:
            show(begun + share * part)

        results.append(compute(order, tick))
        done += weight
        show(done / total)
    return results


_shared_parts: Any = None  # of a worker: how much of each order is done


def _begin_worker(parts: Any) -> None:
    global _shared_parts
    _shared_parts = parts
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _work(index: int, order: Order) -> Result:
    def tick(part: float) -> None:
        _shared_parts[index] = part

    return compute(order, tick)


def _in_processes(
    orders: Sequence[Order], weights: Sequence[float], cores: int, show: Show
) -> Iterator[tuple[int, Result]]:
    before = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    parts = context.Array("d", len(orders), lock=False)
    pool = ProcessPoolExecutor(cores, context, _begin_worker, (parts,))
    running: dict[Future[Result], int] = {}
    total, finished = math.fsum(weights), False
    try:
        with deaf_children():
            for index in sorted(range(len(orders)), key=lambda one: (-weights[one], one)):
                running[pool.submit(_work, index, orders[index])] = index
        while running:
            ready, _ = wait(running, timeout=_POLL_S, return_when=FIRST_COMPLETED)
            for future in sorted(ready, key=lambda one: running[one]):
                index = running.pop(future)
                yield index, future.result()
            show(sum(w * p for w, p in zip(weights, parts, strict=True)) / total)
        finished = True
    except BrokenProcessPool as error:
        raise InputError(
            "a process that computed examples has died.",
            "It may have run out of memory: give fewer --cores.",
        ) from error
    finally:
        if not finished:
            terminate(pool, set(multiprocessing.active_children()) - before)
        pool.shutdown(wait=True, cancel_futures=True)
