"""Puts together what is known of a swim, and what speaks against keeping it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from tailbeat.bump import bump_of
from tailbeat.day.person import Decision
from tailbeat.day.swum import Swum
from tailbeat.day.unmeasured import NO_SPEED, unmeasured
from tailbeat.faults import ABORT_COMMAND, WALL, fault_info
from tailbeat.guards import BY_HAND
from tailbeat.model.swim import swim_of
from tailbeat.verdict import score_of

if TYPE_CHECKING:
    from tailbeat.day.logs import Log
    from tailbeat.day.ritual import Ready
    from tailbeat.results import TrialOutcome
    from tailbeat.trial_log import Trial

NOT_COMPLETE = "not complete:"


def swum_of(outcome: TrialOutcome, log: Log, ready: Ready | None, stopped: str = "") -> Swum:
    """``stopped``: the reason of whoever stopped it from here; empty = nobody, or what the journal
    says."""
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
        problems=tuple(_problems(outcome, log, measured, stopped or log.stopped)),
        judged=score_of(trial).judged,
    )


def _problems(outcome: TrialOutcome, log: Log, measured: int, stopped: str) -> list[str]:
    trial, problems = log.trial, []
    if outcome.end != "complete":
        by = f" ({stopped})" if stopped else ""
        problems.append(f"{NOT_COMPLETE} {outcome.end}{by}")
    problems += _unmeasured(trial, measured)
    if log.straight is not None and log.straight.crooked:
        off_deg = math.degrees(log.straight.worst_yaw_rad)
        problems.append(f"not straight: {off_deg:+.0f} degrees off ({log.straight.source})")
    if (bump := bump_of(swim_of(trial))) is not None:
        problems.append(bump.words())
    return problems + list(trial.problems)


def _unmeasured(trial: Trial, measured: int) -> list[str]:
    if measured == 0:
        return ["no beat has a speed: there is nothing to learn from"]
    words = unmeasured(trial)
    return [words] if words else []


def is_good(swum: Swum) -> bool:
    """Whether nobody need be asked: it was executed to its end, and nothing speaks against it but
    a few missing beats."""
    others = [one for one in swum.problems if not (swum.judged and NO_SPEED in one)]
    return swum.outcome.end == "complete" and not others


def stopped_by(problems: Iterable[str]) -> str:
    """The reason of whoever stopped a swim from here, out of what was said of it; empty = nobody
    did, or nobody said."""
    for problem in problems:
        if problem.startswith(NOT_COMPLETE) and problem.endswith(")"):
            return problem.partition(" (")[2].removesuffix(")")
    return ""


def proposed(swum: Swum) -> Decision:
    """What a careful person would say; the one who is there decides. It follows from the swim's
    end and its problems, which are in its log and in the journal: asked again later it is the
    same."""
    stopped = stopped_by(swum.problems)
    if swum.outcome.end == _ended(WALL):
        return Decision("discard", "too close to the wall")
    if stopped == BY_HAND:
        return Decision("discard", BY_HAND)
    if swum.outcome.end == _ended(ABORT_COMMAND) and not stopped:  # no guard of this program's
        return Decision("discard", "stopped by a command")
    if swum.measured_beats == 0:
        return Decision("discard", "no speeds")
    return Decision("keep")


def _ended(fault: int) -> str:
    return f"aborted:{fault_info(fault).name}"
