"""What a sweep leaves on disk: a Parquet part per cell while it runs, one file when it is done.

``OUT/sweep.json`` and ``OUT/recipe.toml`` say of what they are; ``OUT/parts/NNNNN-….part`` are
the finished cells, each a SHA-256 and the Parquet file that it is of; ``OUT/results.parquet`` holds
all of them in the order of the cells. Its bytes depend on the recipe and the tailbeat that computed
it, on nothing else.
"""

from __future__ import annotations

import hashlib
import io
import json
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tailbeat.core.errors import InputError, reason
from tailbeat.core.extras import need
from tailbeat.core.files import replace_file, replacing

if TYPE_CHECKING:
    import pyarrow as pa

    from tailbeat.studies.montecarlo.cell import Cell
    from tailbeat.studies.montecarlo.recipe import Recipe

MANIFEST = "sweep.json"
RECIPE = "recipe.toml"
RESULTS = "results.parquet"
PARTS = "parts"
FAILED = "failed"  # the verdict on a fish that could not be identified or taught

_DIGEST_BYTES = 32
_TEXT = ("plant", "law", "noise", "corner", "reference", "swum_law", "verdict", "failure")
_WHOLE = ("seed", "iteration", "saturated_beats", "measured_beats", "executed_beats")
_NUMBER = (
    "kappa_per_m",
    "max_abs_error_m_s",
    "true_max_abs_error_m_s",
    "rms_error_m_s",
    "true_rms_error_m_s",
    "floor_minimax_m_s",
    "floor_lsq_m_s",
    "predicted_floor_m_s",
    "predicted_max_abs_error_m_s",
    "predicted_low_m_s",
    "predicted_high_m_s",
    "ratio",
    "ratio_low",
    "ratio_high",
    "gain_rad_s_m",
    "lead_beats",
    "amplitude_min_rad",
    "amplitude_max_rad",
    "step_rad",
    "true_min_m_s",
    "true_max_m_s",
    "travel_m",
)
DERIVED = ("ratio_inside", "prediction_inside", "floor_prediction_error")
NUMBER_COLUMNS = (*_NUMBER, *_WHOLE, *DERIVED)


def arrow(module: str = "pyarrow") -> Any:
    """The module of pyarrow. Raises InputError when it is not installed."""
    return need(module, "export", "A sweep writes Parquet files and needs pyarrow")


@cache
def schema() -> pa.Schema:
    """The columns of the results."""
    types = arrow()
    return types.schema(
        [(name, types.string()) for name in _TEXT]
        + [(name, types.int64()) for name in _WHOLE]
        + [(name, types.float64()) for name in _NUMBER]
    )


@cache
def identity() -> dict[str, str]:
    """What must be the same wherever cells of one sweep are computed."""
    import numpy
    import scipy

    package = Path(__file__).parent.parent
    code = hashlib.sha256()
    for path in sorted(package.rglob("*")):
        if path.suffix in (".py", ".so", ".cdef"):
            code.update(path.relative_to(package).as_posix().encode())
            code.update(path.read_bytes())
    return {
        "tailbeat": version("tailbeat"),
        "code": code.hexdigest()[:16],
        "numpy": numpy.__version__,
        "scipy": scipy.__version__,
        "pyarrow": arrow().__version__,
    }


def to_bytes(table: pa.Table) -> bytes:
    """A table of ``schema()`` as the bytes of a Parquet file."""
    out = io.BytesIO()
    arrow("pyarrow.parquet").write_table(table, out, compression="zstd")
    return out.getvalue()


class Store:
    """The folder of one sweep."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @property
    def results(self) -> Path:
        """The file with everything; there only when the sweep is complete."""
        return self.folder / RESULTS

    def open(self, recipe: Recipe) -> None:
        """Makes the folder, or makes sure that what lies there is of this very sweep."""
        wanted = {"recipe": recipe.name, "recipe_crc": recipe.crc, **identity()}
        found = self.manifest()
        if found is None:
            if any((self.folder / PARTS).glob("*")) or self.results.exists():
                raise InputError(
                    f"{self.folder} holds results, but no {MANIFEST} says of what.",
                    "Give another folder with --out.",
                )
            self._make(wanted, recipe.source)
            return
        different = [key for key, value in wanted.items() if found.get(key) != value]
        if not different:
            self._rejudge(recipe.source)
            return
        what = "another recipe" if different[0].startswith("recipe") else f"another {different[0]}"
        what = "another build of tailbeat" if different[0] == "code" else what
        raise InputError(
            f"{self.folder} holds results of {what} (its {different[0]} is "
            f"{found.get(different[0])}, now {wanted[different[0]]}).",
            "Give another folder with --out, or delete that one.",
        )

    def manifest(self) -> dict[str, Any] | None:
        """What the folder says it is of; None when it says nothing."""
        try:
            raw = json.loads((self.folder / MANIFEST).read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            raise InputError(
                f"{self.folder / MANIFEST} cannot be read ({reason(error)}).",
                "Give another folder with --out, or delete that one.",
            ) from error
        return raw if isinstance(raw, dict) else {}

    def recipe(self) -> Recipe:
        """What the results are of."""
        from tailbeat.studies.montecarlo.recipe import parse

        manifest = self.manifest()
        source = self.folder / RECIPE
        if manifest is None or "recipe" not in manifest or not source.exists():
            raise InputError(f"{self.folder} holds no sweep.", "Give the folder of one.")
        return parse(source.read_text(encoding="utf-8"), str(manifest["recipe"]))

    def _make(self, wanted: dict[str, str], source: str) -> None:
        (self.folder / PARTS).mkdir(parents=True, exist_ok=True)
        replace_file(self.folder / RECIPE, source.encode())
        replace_file(self.folder / MANIFEST, (json.dumps(wanted, indent=1) + "\n").encode())

    def _rejudge(self, source: str) -> None:
        """Only what judges the results can differ: from now on it is what is given now."""
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
        parquet = arrow("pyarrow.parquet")
        with (
            replacing(self.results) as file,
            parquet.ParquetWriter(
                file, schema(), compression="zstd", write_page_checksum=True
            ) as writer,
        ):
            for cell in cells:
                writer.write_table(_read_part(self.part(cell)))
        return self.results

    def read(self) -> pa.Table:
        """The results; those of the finished cells when the sweep is not complete."""
        if self.results.exists():
            return _read(self.results)
        parts = sorted((self.folder / PARTS).glob("*.part"))
        if not parts:
            raise InputError(
                f"{self.folder} holds no results of a sweep.",
                "Run: tailbeat sim montecarlo RECIPE --out",
            )
        return arrow().concat_tables([_read_part(path) for path in parts])


def _read(path: Path) -> pa.Table:
    """With every page checked. Raises InputError when it is damaged or not there."""
    parquet = arrow("pyarrow.parquet")
    try:
        return parquet.read_table(path, page_checksum_verification=True)
    except (OSError, arrow().ArrowException) as error:
        raise _damaged(path) from error


def _read_part(path: Path) -> pa.Table:
    """Raises InputError when a byte of it is not as it was written, or it is not there."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise _damaged(path) from error
    digest, data = raw[:_DIGEST_BYTES], raw[_DIGEST_BYTES:]
    if hashlib.sha256(data).digest() != digest:
        raise _damaged(path)
    return arrow("pyarrow.parquet").read_table(arrow().BufferReader(data))


def _damaged(path: Path) -> InputError:
    return InputError(
        f"{path} is damaged or cannot be read.",
        "The command that computed it computes again what is missing.",
    )
