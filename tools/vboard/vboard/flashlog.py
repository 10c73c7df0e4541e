"""What was written into a bank of flash, and when: the bank as a power cut would have left it.

One run with a log stands for as many cut runs as one likes: the board is deterministic, so a run
that is cut is, up to the cut, the run that is not.
"""

from __future__ import annotations

import random
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from vboard.board import Board
from vboard.periph.eefc import EWP, EWPL
from vboard.periph.flash import BANK_BYTES, FLASH_BASE, PAGE_BYTES, tear


@dataclass(frozen=True)
class PageWrite:
    """A page that was written from tick ``start`` to ``end``; ``data`` is what the cells became."""

    page: int
    start: int
    end: int
    data: bytes
    erases: bool


class FlashLog:
    """The writes of a board's bank from now to its next power-off. The supply must not dip."""

    def __init__(self, board: Board, bank: int = 1) -> None:
        self.before = board.flash.bank(bank)
        self.writes: list[PageWrite] = []
        self._clock, self._flash, self._bank = board.clock, board.flash, bank
        self._controller = board.periph[f"EEFC{bank}"]
        self._controller.on_busy.append(self._busy)
        self._flash.on_change.append(self._changed)
        self._start = self._clock.now
        self._erasures, self._erases = self._erasures_now(), False

    def _erasures_now(self) -> int:
        commands = self._controller.commands
        return sum(commands.get(command, 0) for command in (EWP, EWPL))

    def _busy(self, busy: bool) -> None:
        if busy:
            self._start = self._clock.now
            self._erases = self._erasures_now() > self._erasures
            self._erasures = self._erasures_now()

    def _changed(self, first: int, last: int) -> None:
        offset = first - FLASH_BASE - self._bank * BANK_BYTES
        if 0 <= offset < BANK_BYTES and last - first == PAGE_BYTES:
            page = offset // PAGE_BYTES
            data = self._flash.page(self._bank, page)
            self.writes.append(PageWrite(page, self._start, self._clock.now, data, self._erases))

    def at(self, tick: int) -> bytes:
        """The bank when only writes that were complete at ``tick`` have happened."""
        cells = bytearray(self.before)
        for write in self.writes[: self._complete(tick)]:
            cells[_place(write)] = write.data
        return bytes(cells)

    def writing(self, tick: int) -> PageWrite | None:
        """The page that is being written at ``tick``."""
        index = self._complete(tick)
        found = self.writes[index] if index < len(self.writes) else None
        return found if found is not None and found.start <= tick else None

    def cut(self, tick: int, chance: random.Random) -> bytes:
        """The bank after a power cut at ``tick``; ``chance`` says how the page is torn."""
        cells = bytearray(self.at(tick))
        write = self.writing(tick)
        if write is not None:
            place = _place(write)
            progress = (tick - write.start) / (write.end - write.start)
            cells[place] = tear(bytes(cells[place]), write.data, write.erases, progress, chance)
        return bytes(cells)

    def _complete(self, tick: int) -> int:
        return bisect_right(self.writes, tick, key=lambda write: write.end)


class PowerLost(Exception):
    """The power of a board under test went off at the time that was asked for."""


@contextmanager
def power_lost_at(board: Board, tick: int) -> Iterator[None]:
    """Raises PowerLost out of the first run_until() that would go beyond ``tick``; the clock is
    then at the end of the instruction under way, and the power is still on: call power_cut()."""
    run_until = board.run_until

    def run_to_the_cut(until: int, stop: object = None) -> bool:
        stopped = run_until(min(until, tick), stop)  # type: ignore[arg-type]
        if board.clock.now >= tick:
            raise PowerLost
        return stopped

    board.run_until = run_to_the_cut  # type: ignore[assignment,method-assign]
    try:
        yield
    finally:
        board.run_until = run_until  # type: ignore[method-assign]


def _place(write: PageWrite) -> slice:
    return slice(write.page * PAGE_BYTES, (write.page + 1) * PAGE_BYTES)
