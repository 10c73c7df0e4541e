"""What is known of one swim when somebody has to decide what becomes of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tailbeat.day.ritual import Ready
    from tailbeat.results import TrialOutcome
    from tailbeat.straight import Straightness


@dataclass(frozen=True)
class Swum:
    """``file``: its log in the experiment's raw files, or wherever it was pulled to. ``ready``:
    what the ritual found; None = there was none. ``measured_beats``: of ``beats`` of the reference.
    ``problems``: what speaks against keeping it, in words (few speeds, not straight). ``judged``:
    enough of its beats are measured (verdict.Score)."""

    outcome: TrialOutcome
    file: Path
    ready: Ready | None
    straight: Straightness | None
    max_abs_error_m_s: float
    rms_error_m_s: float
    measured_beats: int
    beats: int
    battery_start_v: float | None
    battery_end_v: float | None
    problems: tuple[str, ...] = ()
    judged: bool = False
