"""Puts together what is known of a swim, and what speaks against keeping it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from tailbeat.day.person import Decision
from tailbeat.day.swum import Swum
from tailbeat.guards import BY_HAND

if TYPE_CHECKING:
    from tailbeat.day.logs import Log
    from tailbeat.day.ritual import Ready
    from tailbeat.results import TrialOutcome
    from tailbeat.trial_log import Trial

_WALL = "aborted:WALL"


def swum_of(outcome: TrialOutcome, log: Log, ready: Ready | None, stopped: str = "") -> Swum:
    """``stopped``: the reason of whoever stopped it from here; empty = nobody, or not known."""
    trial = log.trial
    measured = int(np.isfinite(trial.beats.speed_m_s).sum())
    volts = [volt for t_s, volt in trial.battery_v if t_s >= 0] or [
        volt for _, volt in trial.battery_v
    ]
    return Swum(
        outcome=outcome,
        file=log.path,
        ready=ready,
        straight=log.straight,
        max_abs_error_m_s=trial.max_abs_error_m_s(),
        rms_error_m_s=trial.rms_error_m_s(),
        measured_beats=measured,
        beats=len(trial.beats.samples),
        battery_start_v=ready.battery_v if ready else (volts[0] if volts else None),
        battery_end_v=volts[-1] if volts else None,
        problems=tuple(_problems(outcome, log, measured, stopped)),
    )


def _problems(outcome: TrialOutcome, log: Log, measured: int, stopped: str) -> list[str]:
    trial, problems = log.trial, []
    if outcome.end != "complete":
        by = f" ({stopped})" if stopped else ""
        problems.append(f"not complete: {outcome.end}{by}")
    problems += _unmeasured(trial, measured)
    if log.straight is not None and log.straight.crooked:
        off_deg = math.degrees(log.straight.worst_yaw_rad)
        problems.append(f"not straight: {off_deg:+.0f} degrees off ({log.straight.source})")
    return problems + list(trial.problems)


def _unmeasured(trial: Trial, measured: int) -> list[str]:
    if measured == 0:
        return ["no beat has a speed: there is nothing to learn from"]
    if (missing := trial.executed_beats - measured) > 0:
        return [f"{missing} of {trial.executed_beats} beats have no speed"]
    return []


def proposed(swum: Swum) -> Decision:
    """What a careful person would say; the one who is there decides."""
    if swum.outcome.end == _WALL:
        return Decision("discard", "too close to the wall")
    if swum.outcome.interrupted or any(BY_HAND in problem for problem in swum.problems):
        return Decision("discard", BY_HAND)
    if swum.measured_beats == 0:
        return Decision("discard", "no speeds")
    return Decision("keep")
