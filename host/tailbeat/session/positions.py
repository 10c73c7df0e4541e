"""What the camera saw of a swim: on disk as soon as the swim has ended, in the raw files once its
log is there.

The log alone knows when the swim began, so the positions wait in board time beside the log that is
being pulled; a program that ends in between loses none.
"""

from __future__ import annotations

import contextlib
import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tailbeat.core.files import MAKE_ROOM, write_whole
from tailbeat.core.frames import Frame

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tailbeat.core.frames import Camera
    from tailbeat.core.trial_file import Trial
    from tailbeat.experiment.folder import Experiment
    from tailbeat.link.timesync import BoardClock

HEADER = ("t_s", "x_m", "y_m", "heading_rad")
_BEFORE_S = 30.0  # frames so long before a swim's start may still belong to it
_AFTER_S = 120.0


@dataclass(frozen=True)
class Stash:
    """Where the positions of one trial wait."""

    path: Path

    def put(self, frames: Sequence[Frame], camera: Camera, clock: BoardClock) -> None:
        """Keeps them, in board time. Raises InputError (disk full)."""
        if not frames:
            return
        by_board = camera.clock == "board"
        rows = [
            Frame(
                frame.t_s if by_board else clock.board_s(frame.t_s),
                frame.x_m,
                frame.y_m,
                frame.heading_rad,
            )
            for frame in frames
        ]
        self.path.parent.mkdir(exist_ok=True)
        write_whole(self.path, as_csv(rows, 0.0), MAKE_ROOM)

    def take(self, trial: Trial) -> list[Frame]:
        """Those of this very swim, time from its start; none when they are of another one that had
        the same number (a board whose storage was made anew)."""
        start_s = trial.start_us * 1e-6
        end_s = start_s + trial.executed_beats * trial.beat_s
        frames = [
            Frame(frame.t_s - start_s, frame.x_m, frame.y_m, frame.heading_rad)
            for frame in self._read()
        ]
        if not frames or frames[-1].t_s < 0 or frames[-1].t_s > end_s - start_s + _AFTER_S:
            return []
        return [frame for frame in frames if frame.t_s > -_BEFORE_S]

    def drop(self) -> None:
        """They are in the raw files."""
        self.path.unlink(missing_ok=True)

    def _read(self) -> list[Frame]:
        with contextlib.suppress(OSError, ValueError, TypeError):
            header, *rows = csv.reader(io.StringIO(self.path.read_text(encoding="utf-8")))
            return [
                Frame(*(float(cell) for cell in row)) for row in rows if tuple(header) == HEADER
            ]
        return []


def stash_of(experiment: Experiment, trial: int) -> Stash:
    """That of one trial of an experiment."""
    return Stash(experiment.folder / ".pulling" / f"{trial:04d}_positions.csv")


def as_csv(frames: Sequence[Frame], start_s: float) -> str:
    """``t_s,x_m,y_m,heading_rad``, time from ``start_s``."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(HEADER)
    for frame in frames:
        row = (frame.t_s - start_s, frame.x_m, frame.y_m, frame.heading_rad)
        writer.writerow([f"{value:.6f}" for value in row])
    return out.getvalue()
