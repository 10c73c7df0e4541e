"""Computes the cells of a recipe on all cores of this computer, or on a Dask cluster.

Every finished cell is on disk at once, so that whatever stops a study, the same command goes on
from there. Who computes a cell, and when, changes no bit of the results.

``OUT/sweep.json`` and ``OUT/recipe.toml`` say of what the results are; ``OUT/parts/NNNNN-….part``
are the finished cells, each a SHA-256 and the Parquet file that it is of; ``OUT/results.parquet``
holds all of them in the order of the cells. Its bytes depend on the recipe and the tailbeat that
computed it, on nothing else.

On a Dask cluster every machine needs the extra ``cluster`` and the same tailbeat. Results travel
back and are kept here, so that the machines share nothing.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tailbeat.core.decode import read
from tailbeat.core.errors import InputError, TailbeatError, reason
from tailbeat.core.extras import LazyModule, need
from tailbeat.core.files import replace_file, replacing
from tailbeat.core.parallel import each_result, one_thread
from tailbeat.core.platform.programs import cores_here
from tailbeat.studies.montecarlo.cell import Cell, cells, run_cell
from tailbeat.studies.montecarlo.recipe import Recipe, parse
from tailbeat.studies.montecarlo.results import Table, identity, parquet, pyarrow, schema, to_bytes

_NEEDED = ("distributed", "cluster", "Computing on a cluster needs Dask (distributed)")
distributed = LazyModule("distributed", lambda: need(*_NEEDED))
Progress = Callable[[int, int], None]  # cells done, cells in all
Finished = Iterator[tuple[Cell, bytes]]


MANIFEST = "sweep.json"
RECIPE = "recipe.toml"
RESULTS = "results.parquet"
PARTS = "parts"
_DIGEST_BYTES = 32


class StudyFolder:
    """What a study leaves on disk: a Parquet part per cell while it runs, then one file."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @property
    def results(self) -> Path:
        """The file with everything; there only when the study is complete."""
        return self.folder / RESULTS

    def open(self, recipe: Recipe) -> None:
        """Makes the folder, or makes sure that what lies there is of this very sweep."""
        seeds = str(recipe.first_seed)
        wanted = {
            "recipe": recipe.name, "first_seed": seeds, "recipe_crc": recipe.crc, **identity(),
        }  # fmt: skip
        found = self.manifest()
        if found is None:
            if any((self.folder / PARTS).glob("*")) or self.results.exists():
                raise InputError(
                    f"{self.folder} holds results, but no {MANIFEST} says of what.",
                    "Give another folder with --out.",
                )
            (self.folder / PARTS).mkdir(parents=True, exist_ok=True)
            self._keep_source(recipe.source)
            replace_file(self.folder / MANIFEST, (json.dumps(wanted, indent=1) + "\n").encode())
            return
        if key := _difference(found, wanted):
            raise InputError(
                f"{self.folder} holds results of {_another(key)} (its {key} is {found.get(key)}, "
                f"now {wanted[key]}).",
                "Give another folder with --out, or delete that one.",
            )
        self._keep_source(recipe.source)

    def manifest(self) -> dict[str, Any] | None:
        """What the folder says it is of; None when it says nothing."""
        path = self.folder / MANIFEST
        remedy = "Give another folder with --out, or delete that one."
        return read(path, dict[str, Any], remedy) if path.exists() else None

    def first_seed(self) -> int | None:
        """Of the study that is here; None when there is none."""
        found = (self.manifest() or {}).get("first_seed")
        return None if found is None else int(found)

    def recipe(self) -> Recipe:
        """What the results are of."""
        manifest = self.manifest()
        source = self.folder / RECIPE
        if manifest is None or "recipe" not in manifest or not source.exists():
            raise InputError(f"{self.folder} holds no sweep.", "Give the folder of one.")
        return parse(source.read_text(encoding="utf-8"), str(manifest["recipe"]))

    def _keep_source(self, source: str) -> None:
        """Of results that are there only what judges them can differ: from now on it is this."""
        path = self.folder / RECIPE
        if not path.exists() or path.read_bytes() != source.encode():
            replace_file(path, source.encode())

    def part(self, cell: Cell) -> Path:
        """Where the results of a cell go."""
        return self.folder / PARTS / f"{cell.label}.part"

    def has(self, cell: Cell) -> bool:
        """Whether a cell is done; a damaged part is not."""
        try:
            return bool(_read_part(self.part(cell)).schema.equals(schema()))
        except InputError:
            return False

    def put(self, cell: Cell, data: bytes) -> None:
        """Keeps the results of a cell, whole or not at all."""
        replace_file(self.part(cell), hashlib.sha256(data).digest() + data)

    def finish(self, cells: list[Cell]) -> Path:
        """Puts all parts together in the order of the cells, a row group for each."""
        with (
            replacing(self.results) as file,
            parquet.ParquetWriter(
                file, schema(), compression="zstd", write_page_checksum=True
            ) as writer,
        ):
            for cell in cells:
                writer.write_table(_read_part(self.part(cell)))
        return self.results

    def read(self) -> Table:
        """The results; those of the finished cells when the sweep is not complete."""
        if self.results.exists():
            return _read(self.results)
        parts = sorted((self.folder / PARTS).glob("*.part"))
        if not parts:
            raise InputError(
                f"{self.folder} holds no results of a sweep.",
                "Run: tailbeat sim montecarlo RECIPE --out",
            )
        return pyarrow.concat_tables([_read_part(path) for path in parts])


def _difference(there: dict[str, Any], wanted: dict[str, str]) -> str:
    """The first key of ``wanted`` that has another value; "" = none has."""
    return next((key for key, value in wanted.items() if there.get(key) != value), "")


def _another(key: str) -> str:
    named = {"code": "build of tailbeat", "recipe_crc": "recipe"}
    return f"another {named.get(key, key)}"


def _read(path: Path) -> Table:
    """With every page checked. Raises InputError when it is damaged or not there."""
    try:
        return parquet.read_table(path, page_checksum_verification=True)
    except (OSError, pyarrow.ArrowException) as error:
        raise _damaged(path) from error


def _read_part(path: Path) -> Table:
    """Raises InputError when a byte of it is not as it was written, or it is not there."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise _damaged(path) from error
    digest, data = raw[:_DIGEST_BYTES], raw[_DIGEST_BYTES:]
    if hashlib.sha256(data).digest() != digest:
        raise _damaged(path)
    return parquet.read_table(pyarrow.BufferReader(data))


def _damaged(path: Path) -> InputError:
    return InputError(
        f"{path} is damaged or cannot be read.",
        "The command that computed it computes again what is missing.",
    )


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
    store = StudyFolder(out)
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
    if missing and scheduler is not None:
        yield from computed_by(scheduler, recipe, missing)
    elif missing:
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
    if key := _difference(there, wanted):
        raise InputError(
            f"{worker} has {_another(key)} ({there.get(key)}; here {wanted[key]}).",
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
