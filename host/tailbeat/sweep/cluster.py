"""The cells of a sweep on a Dask cluster; every machine needs the extra ``cluster``.

Workers need this very tailbeat; results travel back and are kept here, so that nothing need be
shared between the machines.
"""

from __future__ import annotations

from typing import Any

from tailbeat.errors import InputError, reason
from tailbeat.extras import need
from tailbeat.sweep.cell import Cell
from tailbeat.sweep.recipe import Recipe
from tailbeat.sweep.results import identity
from tailbeat.sweep.runner import Finished, compute

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
    distributed = need("distributed", "cluster", "Computing on a cluster needs Dask (distributed)")
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
    import distributed

    as_completed: Any = distributed.as_completed
    by_key = {f"tailbeat-{recipe.crc}-{cell.index}": cell for cell in missing}
    here = identity()
    futures = [
        client.submit(compute_alike, recipe, cell, here, key=key, pure=False)
        for key, cell in by_key.items()
    ]
    try:
        for future in as_completed(futures, loop=client.loop):
            yield by_key[future.key], future.result()
            future.release()
    finally:
        client.cancel(futures)
