"""A serial wire that ends at a native port."""

from __future__ import annotations

import ctypes
from collections import deque
from typing import Any

from vboard.core.clock import Clock
from vboard.native.clock import NativeClock
from vboard.native.library import (
    CHUNK_BYTES_MAX,
    NEVER,
    Call,
    ChunkFields,
    LineFields,
    Run,
    handle_of,
    library,
)
from vboard.wires.serial_line import Losses, SerialLine
from vboard.wires.serial_line import Run as LineRun

_FIRST_CAPACITY, _CHUNKS = 64, 1024
_BYTES = 2 * CHUNK_BYTES_MAX


class NativeSerialLine(SerialLine):
    """What is under way stands in C; the host's side is the reference's."""

    def __init__(self, clock: Clock, baud: int, name: str = "line") -> None:
        assert isinstance(clock, NativeClock)
        self._time = clock.shared
        self._fields = LineFields(connected=1)
        self.handle = handle_of(self._fields)
        self._run_places: Any = (Run * _FIRST_CAPACITY)()
        self._chunk_places = (ChunkFields * _CHUNKS)()
        self._bytes = ctypes.create_string_buffer(_BYTES)
        self._kept: deque[tuple[bytes, bytes | None]] = deque()
        self._kept_done = 0
        self._take_chunks = Call(self._time.guard(self._drain))
        self._fields.runs, self._fields.capacity = self._run_places, _FIRST_CAPACITY
        self._fields.chunks, self._fields.chunk_capacity = self._chunk_places, _CHUNKS
        self._fields.bytes, self._fields.byte_capacity = handle_of(self._bytes).value, _BYTES
        self._fields.drain = self._take_chunks
        super().__init__(clock, baud, name)

    @property
    def lost(self) -> Losses:
        """Bytes that did not make it, by reason; of the moment."""
        self._drain()
        fields, own = self._fields, self._lost
        return Losses(
            cut_to_chip=int(fields.cut_to_chip),
            cut_from_chip=own.cut_from_chip,
            receiver_off=int(fields.receiver_off),
            overrun=int(fields.overrun),
            garbled_to_chip=int(fields.garbled_to_chip),
            garbled_from_chip=own.garbled_from_chip,
            in_flight_at_reset=int(fields.in_flight_at_reset),
        )

    @property
    def received_bytes(self) -> int:
        """Bytes from the chip so far."""
        self._drain()
        return self._received_bytes

    @received_bytes.setter
    def received_bytes(self, count: int) -> None:
        self._received_bytes = count

    @property
    def _plugged(self) -> bool:
        return bool(self._fields.connected)

    @_plugged.setter
    def _plugged(self, plugged: bool) -> None:
        self._fields.connected = plugged

    def queued(self) -> int:
        """Bytes on their way to the chip."""
        self._sync()
        return int(library.vb_line_queued(self.handle))

    def _end(self) -> int | None:
        end = library.vb_line_end(self.handle)
        return None if end == NEVER else int(end)

    def _push(self, run: LineRun) -> None:
        fields = self._fields
        while self._kept_done < fields.done:
            self._kept.popleft()
            self._kept_done += 1
        if fields.count == fields.capacity:
            self._grow()
        bad = bytes(index in run.framing for index in range(len(run.data))) if run.framing else None
        self._kept.append((run.data, bad))
        native = Run(run.start, run.baud, run.data, bad, len(run.data), 0)
        library.vb_line_push(self.handle, native)

    def _grow(self) -> None:
        capacity = 2 * self._fields.capacity
        runs = (Run * capacity)()
        library.vb_line_move(self.handle, handle_of(runs), capacity)
        self._run_places = runs

    def _sync(self) -> None:
        super()._sync()
        self._drain()

    def _drain(self) -> None:
        """Takes over what has come from the chip."""
        fields = self._fields
        if not fields.chunk_count:
            return
        places = [
            (place.first, place.char_ticks, place.length)
            for place in self._chunk_places[: fields.chunk_count]
        ]
        data = ctypes.string_at(fields.bytes, fields.byte_count)
        fields.chunk_count = fields.byte_count = 0
        start = 0
        for first, char_ticks, length in places:
            self.deliver(first, char_ticks, data[start : start + length])
            start += length


NativeClock.line_type = NativeSerialLine
