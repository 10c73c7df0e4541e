"""A recording of a VN-100 as a table, one row per message, by one native call per chunk.

For whole files. What comes in live is read message by message (``decode``), by the same reader.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.native import ffi, lib
from tailbeat.sensors.vn100.decode import Counters, counters_of, layout_of

# imu_batch_row_t
ROW = np.dtype(
    [("offset", "<u8"), ("time_ns", "<u8"), ("kind", "<u4"), ("check", "<u2"), ("error", "<u2")]
)
Rows = NDArray[np.void]

_ROWS = 1 << 15
_KINDS = 16


@dataclass(frozen=True)
class RowKind:
    """Messages of one binary layout, or lines of one type.

    Attributes
    ----------
    name : str
        The layout's header in words, or the line's type.
    frame_bytes : int
        Length of such a frame; 0 for lines.
    has_time : bool
        Whether the rows' ``time_ns`` is the sensor's clock.
    """

    name: str
    frame_bytes: int
    has_time: bool


class BatchReader:
    """Takes a recording in chunks and gives its messages as rows, each once.

    Attributes
    ----------
    bytes : int
        Taken in so far.
    kinds : list of RowKind
        A row's ``kind`` is an index of it; in the order of their first message.
    """

    def __init__(self) -> None:
        self.bytes = 0
        self.kinds: list[RowKind] = []
        self._batch = ffi.new("imu_batch_t *")
        self._table = ffi.new("imu_batch_kind_t[]", _KINDS)
        self._rows = np.empty(_ROWS, ROW)
        self._into = ffi.cast("imu_batch_row_t *", self._rows.ctypes.data)
        self._taken, self._count = ffi.new("size_t *"), ffi.new("size_t *")
        lib.imu_batch_init(self._batch, self._table, _KINDS)

    @property
    def counters(self) -> Counters:
        """What was read so far."""
        return counters_of(self._batch.reader)

    @property
    def end_of_last(self) -> int:
        """Offset behind the last message."""
        return int(self._batch.end_of_last)

    def push(self, data: bytes) -> Iterator[Rows]:
        """Take bytes in; all of what this yields must be taken, too.

        Parameters
        ----------
        data : bytes
            The next bytes of the stream, any number.

        Yields
        ------
        Rows
            Of the messages that they complete. Valid until the next rows come.
        """
        buffer, done = ffi.from_buffer("uint8_t[]", data), False
        begin = 0
        self.bytes += len(data)
        while not done:
            result = lib.imu_batch_push(
                self._batch, buffer + begin, len(data) - begin,
                self._taken, self._into, _ROWS, self._count,
            )  # fmt: skip
            begin += self._taken[0]
            done = self._went_on(result)
            yield self._rows[: self._count[0]]

    def end(self) -> Iterator[Rows]:
        """The stream is over: messages in what was held back, as ``push``."""
        done = False
        while not done:
            result = lib.imu_batch_end(self._batch, self._into, _ROWS, self._count)
            done = self._went_on(result)
            yield self._rows[: self._count[0]]

    def _went_on(self, result: int) -> bool:
        """Whether all was taken; what is new or missing of the kinds is seen to."""
        batch = self._batch
        known = range(len(self.kinds), batch.kind_count)
        self.kinds += [_kind(batch.kinds[number]) for number in known]
        if result == lib.IMU_BATCH_KINDS_FULL:
            table = ffi.new("imu_batch_kind_t[]", 2 * batch.kind_count)
            lib.imu_batch_move_kinds(batch, table, 2 * batch.kind_count)
            self._table = table
        return bool(result == lib.IMU_BATCH_DONE)


def _kind(kind: Any) -> RowKind:
    name = bytes(ffi.buffer(kind.name, kind.name_bytes))
    words = layout_of(name).header if kind.frame_bytes else name.decode("ascii")
    return RowKind(words, int(kind.frame_bytes), kind.time_offset != 0)


def decode_rows(chunks: Iterable[bytes], reader: BatchReader) -> Iterator[Rows]:
    """All messages of a recording as rows.

    Parameters
    ----------
    chunks : iterable of bytes
        The recording; large chunks are quicker.
    reader : BatchReader
        Counts what was read and knows the kinds.

    Yields
    ------
    Rows
        In the order of the stream. Valid until the next rows come.
    """
    for chunk in chunks:
        yield from reader.push(chunk)
    yield from reader.end()
