"""Does an experiment again from its raw files, and tells whether every bit comes out the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from tailbeat.experiment.folder import Experiment


@dataclass(frozen=True)
class Replay:
    """``raw``: files checked against their sums; ``recomputed``: trials whose speeds the board's own
    code gave again bit for bit; ``not_recomputed``: number and why (speeds were uploaded);
    ``learned``: trials after which the law, applied again, gives the very amplitudes of the next;
    ``figures``: files of the report, drawn again; ``different``: what did not come out the same,
    one line each."""

    raw: int
    recomputed: list[int]
    not_recomputed: list[tuple[int, str]]
    learned: list[int]
    figures: list[str]
    different: list[str]

    @property
    def identical(self) -> bool:
        """Whether everything came out the same."""
        return not self.different


def replay(experiment: Experiment, scratch: Path) -> Replay:
    """Raw files against ``raw/SHA256SUMS``; speeds by recompute; learning by the C law; then
    ``analysis.json`` and the report's figures and tables, made anew in ``scratch`` and compared
    byte by byte with those in the folder. Raises InputError when there is nothing to compare."""
    raise NotImplementedError


def write_redo(experiment: Experiment) -> Path:
    """``redo.md``: one page that says how to do the experiment again: the commands in order with
    what was set, the conditions, versions, and the command that replays it. From journal and
    settings alone."""
    raise NotImplementedError
