"""Computes the cells of a recipe on all cores of this computer, or on a Dask cluster.

Every finished cell is on disk at once, so that whatever stops a sweep, the same command goes on
from there. Who computes a cell, and when, changes no bit of the results.

The cells of a sweep on a Dask cluster; every machine needs the extra ``cluster``.

Workers need this very tailbeat; results travel back and are kept here, so that nothing need be
shared between the machines.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from tailbeat.core.errors import InputError, TailbeatError, reason
from tailbeat.core.extras import need
from tailbeat.core.lazy import LazyModule
from tailbeat.core.parallel import cores_here, one_thread
from tailbeat.studies.montecarlo.cell import Cell, cells, run_cell
from tailbeat.studies.montecarlo.recipe import Recipe
from tailbeat.studies.montecarlo.results import Store, identity, to_bytes
from tailbeat.studies.pool import each_result


def _dask() -> ModuleType:
    found: ModuleType = need(
        "distributed", "cluster", "Computing on a cluster needs Dask (distributed)"
    )
    return found


distributed = LazyModule("distributed", _dask)
Progress = Callable[[int, int], None]  # cells done, cells in all
Finished = Iterator[tuple[Cell, bytes]]


class Interrupted(TailbeatError):
    """Somebody pressed Ctrl-C; what was finished is kept."""


@dataclass(frozen=True)
class StudyOutcome:
    """``computed`` of ``cells`` were missing and are there now."""

    results: Path
    cells: int
    computed: int


def run_study(
    recipe: Recipe,
    out: Path,
    cores: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> StudyOutcome:
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
    return StudyOutcome(store.finish(everything), len(everything), len(missing))


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
        yield from computed_by(scheduler, recipe, missing)
        return
    yield from _computed_here(recipe, missing, cores or cores_here())


def _computed_here(recipe: Recipe, missing: list[Cell], cores: int) -> Finished:
    by_index = {cell.index: cell for cell in missing}
    died = InputError(
        "a process that computed cells has died.",
        "It may have run out of memory: give fewer --cores. The same command goes on.",
    )
    tasks = ((cell.index, (recipe, cell)) for cell in missing)
    for index, data in each_result(compute, tasks, min(cores, len(missing)), died):
        yield by_index[index], data


_ANSWER_S = 10
_ON_WORKERS = "Install the same tailbeat there, with the extras 'cluster' and 'export'."


def computed_by(scheduler: str, recipe: Recipe, missing: list[Cell]) -> Finished:
    """Raises InputError when there is no such cluster or it has another tailbeat."""
    client = _connect(scheduler)
    try:
        _check_workers(client, scheduler)
        yield from _gather(client, recipe, missing)
    finally:
        client.close()


def _connect(scheduler: str) -> Any:
    try:
        return distributed.Client(scheduler, timeout=_ANSWER_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"no Dask scheduler answers at {scheduler} ({reason(error) or 'no answer'}).",
            "Start one with 'dask scheduler', workers with 'dask worker'; give its address.",
        ) from error


def compute_alike(recipe: Recipe, cell: Cell, wanted: dict[str, str]) -> bytes:
    """What a worker runs: ``runner.compute``, if it is what the client is (``wanted``). Workers may
    join while a sweep runs. Raises InputError."""
    _check("a worker that joined later", identity(), wanted)
    return compute(recipe, cell)


def _check(worker: str, there: dict[str, str], wanted: dict[str, str]) -> None:
    for key, value in wanted.items():
        if there.get(key) != value:
            what = "another build of tailbeat" if key == "code" else f"another {key}"
            raise InputError(
                f"{worker} has {what} ({there.get(key)}; here {value}).",
                "Install the same on all machines: the results would differ.",
            )


def _check_workers(client: Any, scheduler: str) -> None:
    """Asks every worker for what must be the same everywhere."""
    try:
        answers = client.run(identity)
    except Exception as error:  # whatever a worker without tailbeat makes of it
        raise InputError(
            f"a worker of {scheduler} cannot run tailbeat ({type(error).__name__}).",
            _ON_WORKERS,
        ) from error
    if not answers:
        raise InputError(
            f"the scheduler at {scheduler} has no workers.", f"Start some: dask worker {scheduler}"
        )
    here = identity()
    for worker, there in sorted(answers.items()):
        _check(f"the worker {worker}", there, here)


def _gather(client: Any, recipe: Recipe, missing: list[Cell]) -> Finished:
    by_key = {f"tailbeat-{recipe.crc}-{cell.index}": cell for cell in missing}
    here = identity()
    futures = [
        client.submit(compute_alike, recipe, cell, here, key=key, pure=False)
        for key, cell in by_key.items()
    ]
    try:
        for future in distributed.as_completed(futures, loop=client.loop):
            yield by_key[future.key], future.result()
            future.release()
    finally:
        client.cancel(futures)
