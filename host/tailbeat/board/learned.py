"""What a board has learned, as it tells it over the link: amplitudes, update counts, peaks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F32
from tailbeat.core.errors import Refused, TransferError
from tailbeat.core.faults import BAD_DATA
from tailbeat.core.records import Amplitudes
from tailbeat.link import _dialect as mavlink
from tailbeat.link.mavlink import Link, Message

_PER_PIECE = 32
_NEXT = mavlink.TAILBEAT_AMPLITUDE_SET_NEXT
_BEST = mavlink.TAILBEAT_AMPLITUDE_SET_BEST
_VISITS = mavlink.TAILBEAT_AMPLITUDE_SET_VISITS
_PEAKS = mavlink.TAILBEAT_AMPLITUDE_SET_PEAKS
_VISITS_MAX = 255
_STEADY_TRIES = 5


class LearnedMemory:
    """Reads the memory of a board's learning law; see the methods of ``Fish``."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._counts_visits: bool | None = None  # None: not asked yet

    def amplitudes(self, best: bool) -> Amplitudes:
        """The next or the best input."""
        stored = self.stored(_BEST if best else _NEXT)
        # 0 is also what a board says that does not tell: one that counts no visits.
        told = stored.input != 0 or self._tells_input()
        return stored if told else replace(stored, input=None)

    def _tells_input(self) -> bool:
        if self._counts_visits is None:
            self.visits()
        return self._counts_visits is True

    def visits(self) -> NDArray[np.uint8] | None:
        """Update counts; None: the board does not count."""
        counts = self._known(_VISITS)
        self._counts_visits = counts is not None
        if counts is None:
            return None
        if not ((counts >= 0) & (counts <= _VISITS_MAX)).all():
            raise TransferError(
                "the board's update counts are no numbers from 0 to 255",
                "Its firmware or its storage is damaged: tailbeat board check",
            )
        return counts.astype(np.uint8)

    def peaks(self) -> F32 | None:
        """The best trial's largest errors; None: the board does not keep them."""
        return self._known(_PEAKS)

    def _known(self, kind: int) -> F32 | None:
        """None: older firmware does not know this kind."""
        try:
            return self.stored(kind).values
        except Refused as refused:
            if refused.number != BAD_DATA:
                raise
            return None

    def stored(self, kind: int) -> Amplitudes:
        """One value per beat, of one moment. Raises TransferError while they change."""
        for _ in range(_STEADY_TRIES):
            first = self.piece(0, kind)
            values = list(first.amplitude_rad[: first.count])
            steady = True
            while steady and len(values) < first.beats:
                piece = self.piece(len(values), kind)
                steady = piece.count > 0 and _same_series(piece, first)
                values += piece.amplitude_rad[: piece.count]
            if steady:
                array = np.array(values, dtype=np.float32)
                made_by = first.input
                return Amplitudes(first.iteration, first.beats, first.reference_crc, array, made_by)
        raise TransferError(
            "the board's amplitudes change while they are read", "Try again when it is idle."
        )

    def piece(self, first: int, kind: int) -> Message:
        """The values of some beats from ``first`` on."""
        return self._link.request(
            "TAILBEAT_AMPLITUDES",
            first,
            kind,
            where=lambda m: m.first == first and m.set == kind and m.count <= _PER_PIECE,
        )


def _same_series(piece: Message, first: Message) -> bool:
    return bool(
        piece.iteration == first.iteration
        and piece.beats == first.beats
        and piece.reference_crc == first.reference_crc
    )
