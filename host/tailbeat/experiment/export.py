"""An experiment for other programs: tables, MCAP, ULog. Each format is a row of ``FORMATS``."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tailbeat.core.csv import spreadsheet_text
from tailbeat.core.errors import InputError, reason
from tailbeat.core.extras import is_installed, lazy, need, remedy
from tailbeat.core.files import write_whole
from tailbeat.experiment.analysis import Analysis, analyse
from tailbeat.experiment.annotated_ulog import annotate
from tailbeat.experiment.export_tables import Table, tables_of
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.mat_file import mat_file
from tailbeat.experiment.units import unit_of
from tailbeat.experiment.wall_clock import starts_of

if TYPE_CHECKING:
    from tailbeat.experiment import mcap_file
else:  # with all that films take
    mcap_file = lazy("tailbeat.experiment.mcap_file")

_ARROW = "pyarrow"
_NEEDS_ARROW = "Writing Parquet files needs pyarrow"
_MAKE_ROOM = "Make room on this computer, or choose another folder."


@dataclass(frozen=True)
class Format:
    """One format.

    Attributes
    ----------
    write : callable
        Writes the files into a folder and gives their paths.
    package : str
        The package of the extra ``export`` that it needs; empty: none.
    by_default : bool
        Whether it is written when no format is named.
    """

    write: Callable[[Experiment, Analysis, Path], Iterator[Path]]
    package: str = ""
    by_default: bool = True


def export(
    experiment: Experiment, formats: Sequence[str] = (), folder: Path | None = None
) -> list[Path]:
    """Write every trial, discarded ones too, with its decision; the same bytes each time.

    Parameters
    ----------
    experiment : Experiment
        The experiment.
    formats : sequence of str
        Some of ``FORMATS``; none: those by default that can be written here (``missing_formats``).
    folder : Path, optional
        Default: ``export/`` in the experiment's folder.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    InputError
        A format is unknown or needs a package that is not installed, or the disk is full.
    """
    formats = formats or [name for name, one in FORMATS.items() if _is_usual(one)]
    for name in formats:
        if name not in FORMATS:
            raise InputError(f"there is no format {name}.", f"Use {', '.join(FORMATS)}.")
    analysis = analyse(experiment)
    if folder is None:
        folder = experiment.require_own(experiment.export_folder)
    _make(folder)
    return [path for name in formats for path in FORMATS[name].write(experiment, analysis, folder)]


def missing_formats() -> str:
    """Which of the usual formats cannot be written here, and what to do; empty: none."""
    if is_installed(_ARROW):
        return ""
    return f"Parquet files were left out: they need pyarrow. {remedy('export')}"


def _is_usual(one: Format) -> bool:
    return one.by_default and (not one.package or is_installed(one.package))


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"cannot make {folder} ({reason(error)}).", "Make the place writable."
        ) from error


def _csv(_: Experiment, analysis: Analysis, folder: Path) -> Iterator[Path]:
    for name, table in tables_of(analysis).items():
        text = io.StringIO()
        out = csv.writer(text, lineterminator="\n")
        out.writerow(table)
        out.writerows(map(_cells, zip(*table.values(), strict=True)))
        path = folder / f"{name}.csv"
        write_whole(path, text.getvalue(), _MAKE_ROOM)
        yield path


def _cells(row: tuple[Any, ...]) -> list[Any]:
    cells = []
    for value in row:
        if isinstance(value, float | np.floating):
            cells.append("" if np.isnan(value) else repr(float(value)))
        else:
            cells.append(spreadsheet_text(value) if isinstance(value, str) else value)
    return cells


def _mat(_: Experiment, analysis: Analysis, folder: Path) -> Iterator[Path]:
    path = folder / "trials.mat"
    write_whole(path, mat_file(analysis), _MAKE_ROOM)
    yield path


def _parquet(_: Experiment, analysis: Analysis, folder: Path) -> Iterator[Path]:
    """The unit of a column is in its field's metadata, key ``unit``."""
    parquet = need("pyarrow.parquet", "export", _NEEDS_ARROW)
    for name, table in sorted(tables_of(analysis).items()):
        file = io.BytesIO()
        parquet.write_table(_arrow_table(table), file)
        path = folder / f"{name}.parquet"
        write_whole(path, file.getvalue(), _MAKE_ROOM)
        yield path


def _arrow_table(table: Table) -> Any:
    arrow = need(_ARROW, "export", _NEEDS_ARROW)
    plain = arrow.table(table)
    fields = [
        field.with_metadata({"unit": unit}) if (unit := unit_of(field.name)) else field
        for field in plain.schema
    ]
    return plain.cast(arrow.schema(fields))


def _mcap(experiment: Experiment, analysis: Analysis, folder: Path) -> Iterator[Path]:
    path = folder / "experiment.mcap"
    mcap_file.write_mcap(experiment, analysis, path)
    yield path


def _ulog(experiment: Experiment, analysis: Analysis, folder: Path) -> Iterator[Path]:
    """Each trial's log with units, defaults and wall-clock time, under its name."""
    _make(folder / "ulog")
    starts = starts_of(experiment, analysis)
    for row, trial, start in zip(analysis.rows, analysis.trials, starts, strict=True):
        path = folder / "ulog" / row.file
        log = (experiment.raw / row.file).read_bytes()
        write_whole(path, annotate(log, trial, start), _MAKE_ROOM)
        yield path


FORMATS: dict[str, Format] = {
    "csv": Format(_csv),
    "mat": Format(_mat),
    "parquet": Format(_parquet, _ARROW),
    "mcap": Format(_mcap, "mcap", by_default=False),
    "ulog": Format(_ulog, by_default=False),
}
