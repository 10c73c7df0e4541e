"""Owns the fish for the page: one thread that swims, and what the page may know and ask.

No web toolkit in here. Whatever the page wants goes through ``ask``; what there is to see is in
``now``, an unchanging snapshot.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from tailbeat.experiment.analysis import TrialRow
    from tailbeat.fish import Fish

Phase = Literal["connecting", "idle", "ritual", "countdown", "swimming", "deciding", "failed"]


@dataclass(frozen=True)
class Snapshot:
    """What the page shows. ``serial`` grows with every change. ``beats``: of the swim under way or
    the last one, shape-equal lists with None for what is not known. ``problem``: one line for a
    person, with what to do."""

    serial: int = 0
    phase: Phase = "connecting"
    connection: str = ""
    simulated: bool = False
    board: str = ""
    unique_id: str = ""
    state: str = ""
    silent_s: float | None = None
    battery_v: float | None = None
    imu: str = ""
    imu_well: bool | None = None
    experiment: str = ""
    iteration: int = 0
    trial: int | None = None
    step: str = ""
    left_s: float | None = None
    reference_m_s: tuple[float, ...] = ()
    speed_m_s: tuple[float | None, ...] = ()
    amplitude_rad: tuple[float | None, ...] = ()
    rows: tuple[TrialRow, ...] = ()
    floor_m_s: float | None = None
    verdict: str = ""
    problem: str = ""
    log: tuple[str, ...] = ()


@dataclass
class Conductor:
    """``connect`` makes the Fish, in the conductor's thread; a link that is lost is connected again,
    with what was wrong in ``now.problem`` meanwhile. ``root``: of new experiments."""

    connect: Callable[[], Fish]
    root: Path
    now: Snapshot = field(default_factory=Snapshot)

    def start(self) -> None:
        """Begins the thread."""
        raise NotImplementedError

    def ask(self, what: str, **values: Any) -> None:
        """``swim`` {until, ritual}, ``abort``, ``decide`` {decision, reason}, ``upload`` {reference},
        ``set`` {name, value}, ``note`` {text}, ``clear``. Never blocks; what came of it is in
        ``now``. ``abort`` overtakes everything. Raises InputError for what makes no sense now."""
        raise NotImplementedError

    def close(self) -> None:
        """Stops the tail if it beats, ends the thread and the connection."""
        raise NotImplementedError
