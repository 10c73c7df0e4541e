"""What a stream of a VN-100 held, what of it is missing, and what that tells.

Decoded values as CSV files: one per kind of message, units in the column names.
"""

from __future__ import annotations

import csv
import math
import re
from array import array
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.imu_fields import error_words
from tailbeat.sensors.vn100.batch import BatchReader, RowKind, Rows
from tailbeat.sensors.vn100.decode import AsciiLine, Binary, Counters, Message, Values

BITS_PER_BYTE = 10  # 8N1

_TIME = "time_startup_ns"
_CHAIN_FACTOR = 31
_CHAIN_MASK = 0xFFFFFFFF
_SKIPPED_WORTH_TELLING = 0.01
_STEPS_TO_JUDGE = 3  # of time, before a rate can be told from a gap


@dataclass(frozen=True)
class DropOut:
    """Frames missing by the sensor's own clock. ``at_byte``: of the first frame behind the gap;
    ``at_s``: since the stream's first frame; ``length_s``: between the frames around it."""

    kind: str
    at_byte: int
    at_s: float
    length_s: float
    frames: int


@dataclass(frozen=True)
class StreamReport:
    """One kind of binary frame. Rates and gaps are None, 0 when it carries no TimeStartup or is too
    short to tell; ``duration_s`` leaves restarts out."""

    kind: str
    frames: int
    frame_bytes: int
    duration_s: float | None = None
    rate_hz: float | None = None
    lost_frames: int = 0
    restarts: int = 0
    dropouts: tuple[DropOut, ...] = ()


@dataclass
class _Stream:
    frames: int = 0
    frame_bytes: int = 0
    times: array[int] = field(default_factory=lambda: array("Q"))
    offsets: array[int] = field(default_factory=lambda: array("Q"))

    def add(self, message: Binary) -> None:
        self.frames += 1
        self.frame_bytes = len(message.data)
        time_ns = message.values.get(_TIME)
        if time_ns is not None:
            self.times.append(int(time_ns))
            self.offsets.append(message.offset)

    def add_rows(self, rows: Rows, kind: RowKind) -> None:
        self.frames += len(rows)
        self.frame_bytes = kind.frame_bytes
        if kind.has_time:
            self.times.frombytes(rows["time_ns"].tobytes())
            self.offsets.frombytes(rows["offset"].tobytes())

    def report(self, kind: str) -> StreamReport:
        # Half the range of a uint64 is 292 years.
        steps = np.diff(np.array(self.times, dtype=np.uint64).view(np.int64))
        forward = steps[steps > 0]
        restarts = int(np.count_nonzero(steps <= 0))
        found = StreamReport(kind, self.frames, self.frame_bytes, restarts=restarts)
        if len(forward) < _STEPS_TO_JUDGE:
            return found
        nominal_ns = float(np.median(forward))
        counts = np.where(steps > 0, np.rint(steps / nominal_ns), 1).astype(np.int64)
        since_s = np.cumsum(np.where(steps > 0, steps, 0)) * 1e-9
        gaps = tuple(
            DropOut(
                kind,
                self.offsets[i + 1],
                float(since_s[i]),
                float(steps[i]) * 1e-9,
                int(counts[i]) - 1,
            )
            for i in np.flatnonzero(counts > 1)
        )
        return replace(
            found,
            duration_s=float(since_s[-1]),
            rate_hz=float(counts[steps > 0].sum() / since_s[-1]),
            lost_frames=sum(gap.frames for gap in gaps),
            dropouts=gaps,
        )


class StreamSummary:
    """Collects the messages of a stream; keeps 16 bytes per frame that has a time.

    Attributes
    ----------
    binary_valid, ascii_valid : int
        Frames and lines so far.
    ascii_types : dict of str to int
        Lines of each type.
    errors : dict of int to int
        How often the sensor reported each error code.
    end_of_last : int
        Offset behind the last message.
    """

    def __init__(self) -> None:
        self.binary_valid = 0
        self.ascii_valid = 0
        self.ascii_types: dict[str, int] = {}
        self.errors: dict[int, int] = {}
        self.end_of_last = 0
        self._crc_chain = 0
        self._check_chain = 0
        self._streams: dict[str, _Stream] = {}

    def add(self, message: Message) -> None:
        """Take one more message in, in order.

        Parameters
        ----------
        message : Message
            Of ``Reader`` or ``decode``.
        """
        self.end_of_last = message.offset + len(message.data)
        if isinstance(message, Binary):
            self.binary_valid += 1
            self._crc_chain = _chained(self._crc_chain, message.check)
            self._streams.setdefault(message.kind, _Stream()).add(message)
        else:
            self._add_line(message)

    def add_rows(self, rows: Rows, reader: BatchReader) -> None:
        """Take more messages in, in order.

        Parameters
        ----------
        rows : Rows
            Of ``decode_rows``.
        reader : BatchReader
            That they are from.
        """
        if not len(rows):
            return
        self.end_of_last = reader.end_of_last
        numbers, is_line = rows["kind"], np.array([not kind.frame_bytes for kind in reader.kinds])
        lines = is_line[numbers]
        self._crc_chain = _chained_all(self._crc_chain, rows["check"][~lines])
        self._check_chain = _chained_all(self._check_chain, rows["check"][lines])
        for number, count in enumerate(np.bincount(numbers, minlength=len(is_line)).tolist()):
            kind = reader.kinds[number]
            if count and kind.frame_bytes:
                self.binary_valid += count
                stream = self._streams.setdefault(kind.name, _Stream())
                stream.add_rows(rows[numbers == number], kind)
            elif count:
                self.ascii_valid += count
                self.ascii_types[kind.name] = self.ascii_types.get(kind.name, 0) + count
        for code in rows["error"][rows["error"] != 0].tolist():
            self.errors[code] = self.errors.get(code, 0) + 1

    def _add_line(self, line: AsciiLine) -> None:
        self.ascii_valid += 1
        self._check_chain = _chained(self._check_chain, line.check)
        self.ascii_types[line.type] = self.ascii_types.get(line.type, 0) + 1
        if line.error:
            self.errors[line.error] = self.errors.get(line.error, 0) + 1

    @property
    def messages(self) -> int:
        """How many there were."""
        return self.binary_valid + self.ascii_valid

    @property
    def headers(self) -> dict[str, int]:
        """Binary frames of each layout."""
        return {kind: stream.frames for kind, stream in self._streams.items()}

    def streams(self) -> list[StreamReport]:
        """A report for each layout."""
        return [stream.report(kind) for kind, stream in self._streams.items()]

    def document(self, counters: Counters, size_bytes: int) -> dict[str, Any]:
        """Put all that is known together, as JSON has it.

        Parameters
        ----------
        counters : Counters
            Of the reader.
        size_bytes : int
            Of the stream.

        Returns
        -------
        dict
            Counts, rates, losses and hints. Chains: x = x * 31 + check, modulo 2^32, over the
            checks as they were sent; None without any.
        """
        streams = self.streams()
        rates = [s.rate_hz for s in streams if s.rate_hz is not None]
        durations = [s.duration_s for s in streams if s.duration_s is not None]
        return {
            "bytes": size_bytes,
            "ascii_valid": self.ascii_valid,
            "binary_valid": self.binary_valid,
            "crc_failed": counters.crc_failed,
            "checksum_failed": counters.checksum_failed,
            "header_rejects": counters.header_rejects,
            "half_messages": counters.dropped,
            "skipped_bytes": counters.skipped_bytes,
            "skipped_share": counters.skipped_bytes / size_bytes if size_bytes else 0.0,
            "headers": self.headers,
            "ascii_types": dict(self.ascii_types),
            "crc_chain": f"{self._crc_chain:08X}" if self.binary_valid else None,
            "ascii_ck_chain": f"{self._check_chain:08X}" if self.ascii_valid else None,
            "duration_s": max(durations, default=None),
            "rate_hz": max(rates, default=None),
            "lost_frames": sum(s.lost_frames for s in streams),
            "restarts": max((s.restarts for s in streams), default=0),
            "dropouts": sorted((g for s in streams for g in s.dropouts), key=lambda g: g.at_byte),
            "streams": [
                {k: v for k, v in vars(stream).items() if k != "dropouts"} for stream in streams
            ],
            "sensor_errors": {error_words(code): n for code, n in self.errors.items()},
            "hints": hints(self, streams, counters, size_bytes),
        }


def hints(
    summary: StreamSummary, streams: list[StreamReport], counters: Counters, size_bytes: int
) -> list[str]:
    """What a person should know or do, one sentence or two each."""
    found = [
        *_damage(counters, summary.messages),
        *_strangers(summary, counters, size_bytes),
        *_losses(streams),
        *(f"The sensor reported {n} times: {error_words(c)}." for c, n in summary.errors.items()),
    ]
    restarts = max((s.restarts for s in streams), default=0)
    if restarts:
        found.append(
            f"The sensor's clock began anew {restarts} times: it was restarted, or its supply dips."
        )
    if summary.messages and all(s.duration_s is None for s in streams):
        found.append(
            "The messages have no time of their samples, so missing ones cannot be counted."
            " A binary output with TimeStartup has it (--config sets one up)."
        )
    return found


def _damage(counters: Counters, messages: int) -> list[str]:
    damaged = counters.crc_failed + counters.checksum_failed
    if not damaged:
        return []
    share = damaged / (damaged + messages)
    return [
        f"{damaged} messages ({share:.1%}) have a wrong checksum and were dropped. Look at ground,"
        " length and shielding of the line, or lower the baud rate."
    ]


def _strangers(summary: StreamSummary, counters: Counters, size_bytes: int) -> list[str]:
    tail = size_bytes - summary.end_of_last
    inside = counters.skipped_bytes - tail
    found = []
    if summary.messages and counters.dropped and tail:
        found.append("The stream ends in the middle of a message.")
    clean = not counters.crc_failed and not counters.checksum_failed
    if clean and summary.messages and inside > _SKIPPED_WORTH_TELLING * size_bytes:
        found.append(
            f"{inside} bytes between whole messages belong to none, though nothing is damaged."
            " Another format is written in between (a logger's own), or bytes were lost."
        )
    return found


def _losses(streams: list[StreamReport]) -> list[str]:
    found = []
    for stream in (s for s in streams if s.lost_frames and s.rate_hz is not None):
        assert stream.rate_hz is not None
        share = stream.lost_frames / (stream.lost_frames + stream.frames)
        need_baud = round(stream.rate_hz * stream.frame_bytes * BITS_PER_BYTE, -2)
        found.append(
            f"{stream.lost_frames} frames ({share:.1%}) of {stream.kind} are missing in"
            f" {len(stream.dropouts)} gaps. At {stream.rate_hz:.0f} Hz they need a line of"
            f" {need_baud:.0f} baud and a recorder that keeps up."
        )
    return found


def _chained(chain: int, check: int) -> int:
    return (chain * _CHAIN_FACTOR + check) & _CHAIN_MASK


def _chained_all(chain: int, checks: NDArray[np.uint16]) -> int:
    """As if each check was chained by itself: a polynomial in the factor, modulo 2^32."""
    powers = np.full(len(checks) + 1, _CHAIN_FACTOR, np.uint32)
    powers[0] = 1
    powers = np.cumprod(powers, dtype=np.uint32)
    added = int(np.sum(powers[-2::-1] * checks, dtype=np.uint32))
    return (chain * int(powers[-1]) + added) & _CHAIN_MASK


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
    if isinstance(message, AsciiLine):
        return message.kind
    return "_".join(re.findall(r"\b[0-9A-F]{2,4}\b", message.kind))


def _cell(value: float | int | None) -> str:
    return "" if value is None else repr(value)
