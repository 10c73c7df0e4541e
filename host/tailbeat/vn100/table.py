"""Decoded values as CSV files: one per kind of message, units in the column names."""

from __future__ import annotations

import csv
import math
import re
from pathlib import Path
from typing import IO, Any

import numpy as np

from tailbeat.vn100.decode import Line, Message, Values


def plain_values(values: Values) -> dict[str, float | int | None]:
    """The values as the shortest decimals that single precision tells apart; None for NaN and
    infinities."""
    return {name: _plain(value) for name, value in values.items()}


def _plain(value: float | int) -> float | int | None:
    if isinstance(value, int):
        return value
    if not math.isfinite(value):
        return None
    single = np.float32(value)
    return float(str(single)) if float(single) == value else value


class CsvFiles:
    """Writes each message that has values as a row of the file of its kind.

    A single kind goes to ``path``; of several each goes to its own file, with the kind in its name.
    The first column is the message's place in the stream, or with ``live`` its arrival. Existing
    files are replaced. Use as a context manager.
    """

    def __init__(self, path: Path, live: bool = False) -> None:
        self.path = path
        self.paths: list[Path] = []
        self._first = "t_s" if live else "offset_byte"
        self._files: dict[str, tuple[IO[str], Any]] = {}

    def add(self, message: Message, arrival_s: float | None = None) -> None:
        """One message; of those without values nothing is written."""
        if not message.values:
            return
        file = self._files.get(message.kind) or self._open(message)
        where = message.offset if arrival_s is None else f"{arrival_s:.6f}"
        file[1].writerow([where, *map(_cell, plain_values(message.values).values())])

    def close(self) -> None:
        """Completes the files."""
        for file, _ in self._files.values():
            file.close()
        if len(self.paths) == 1 and self.paths[0] != self.path:
            self.paths = [self.paths[0].replace(self.path)]
        self._files.clear()

    def __enter__(self) -> CsvFiles:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open(self, message: Message) -> tuple[IO[str], Any]:
        suffix = self.path.suffix
        path = self.path.with_name(f"{self.path.stem}_{_word(message)}{suffix}")
        file = path.open("w", newline="")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([self._first, *message.values])
        self.paths.append(path)
        self._files[message.kind] = (file, writer)
        return self._files[message.kind]


def _word(message: Message) -> str:
    """The kind, as file names like it."""
    if isinstance(message, Line):
        return message.kind
    return "_".join(re.findall(r"\b[0-9A-F]{2,4}\b", message.kind))


def _cell(value: float | int | None) -> str:
    return "" if value is None else repr(value)
