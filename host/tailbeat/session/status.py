"""Where a session stands: the experiment, the fish, the battery, and the convergence assessment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tailbeat.board.fish import Fish, board_reference
from tailbeat.core.errors import TailbeatError
from tailbeat.core.trial_checks import heading_drift
from tailbeat.core.trial_file import Trial
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import identified_if_readable, identified_of, library_of
from tailbeat.learning.assessment import progress_of
from tailbeat.learning.convergence import Assessment
from tailbeat.session.events import Assessed, Notice, Operator
from tailbeat.session.limit import limit_offer
from tailbeat.session.log import Drain, SessionLog


@dataclass(frozen=True)
class SessionStatus:
    """``battery_start_v``: at rest before the first swim on this battery; ``fall_v``: per trial;
    ``trials_left``: until it no longer arms. All None before a trial. ``best_trial`` 0 = none.
    ``problem``: why there is no verdict."""

    experiment: Path
    unique_id: str
    simulated: bool
    state: str
    pending_trial: int | None
    iteration: int
    trials: int
    best_trial: int
    best_max_abs_error_m_s: float
    battery_v: float
    battery_start_v: float | None
    fall_v: float | None
    trials_left: int | None
    rolled_back: bool
    verdict: Assessment | None
    problem: str
    advice: list[str]


def status_of(fish: Fish, experiment: Experiment) -> SessionStatus:
    """Asks the board and reads the experiment; changes nothing."""
    account = SessionLog(experiment)
    info, trials = fish.info(), account.counting()
    status = info.status
    rolled_back = _has_rolled_back(experiment)
    verdict, problem = _assess(fish, trials, status.reference_crc, rolled_back)
    drains = account.drains()
    fall_v = fall_per_swim(drains, status.battery_v)
    low_v = fish.params.get("BATT_LOW_V").value
    return SessionStatus(
        experiment=experiment.folder,
        unique_id=info.unique_id,
        simulated=info.simulated,
        state=status.state,
        pending_trial=status.pending_trial,
        iteration=status.iteration,
        trials=len(account.executed()[0]),
        best_trial=verdict.best_trial if verdict else 0,
        best_max_abs_error_m_s=verdict.best_max_abs_error_m_s if verdict else math.nan,
        battery_v=status.battery_v,
        battery_start_v=drains[0].start_v if drains else None,
        fall_v=fall_v,
        trials_left=swims_left(status.battery_v, low_v, fall_v),
        rolled_back=rolled_back,
        verdict=verdict,
        problem=problem,
        advice=advice(fish, experiment),
    )


def _has_rolled_back(experiment: Experiment) -> bool:
    learned = experiment.journal.entries("learned")
    return bool(learned and learned[-1].get("rolled_back"))


def fall_per_swim(drains: Sequence[Drain], now_v: float) -> float | None:
    """How far the battery fell at rest, per trial; None before the first."""
    return (drains[0].start_v - now_v) / len(drains) if drains else None


def swims_left(now_v: float, low_v: float, fall_v: float | None) -> int | None:
    """Swims that may still begin; None = nobody knows (nothing was executed, it does not fall)."""
    if low_v <= 0 or fall_v is None or fall_v <= 0:
        return None
    if now_v < low_v:
        return 0
    return math.floor((now_v - low_v) / fall_v + 1e-9) + 1


def _assess(
    fish: Fish, trials: list[Trial], reference_crc: int | None, rolled_back: bool
) -> tuple[Assessment | None, str]:
    """The assessment, or why there is none."""
    try:
        identified = identified_of(library_of(fish))
        return progress_of(trials, reference_crc, identified, (), rolled_back).verdict, ""
    except TailbeatError as error:
        return None, str(error)


def words(found: SessionStatus) -> list[str]:
    """One line for each thing an operator asks."""
    simulated = " (simulated)" if found.simulated else ""
    pending = f"; trial {found.pending_trial} waits for a decision" if found.pending_trial else ""
    lines = [
        f"experiment  {found.experiment}",
        f"fish        {found.unique_id}{simulated}, {found.state}{pending}",
        f"learning    {found.trials} trial{'' if found.trials == 1 else 's'}, {_next(found)}",
        f"battery     {_battery(found)}",
    ]
    if found.verdict is not None:
        lines.append(f"assessment  {_judgement(found, found.verdict)}")
    elif found.problem:
        lines.append(f"assessment  none: {found.problem}")
    return lines + [f"limits      {line}" for line in found.advice]


def _next(found: SessionStatus) -> str:
    """A board counts from 1 once it was armed; 0 is no number to tell anybody."""
    if found.iteration == 0 and not found.best_trial:
        return "nothing learned yet"
    return f"iteration {found.iteration} is next{_best(found)}"


def _best(found: SessionStatus) -> str:
    if not found.best_trial:
        return ", no judged trial yet"
    return f", best trial {found.best_trial} ({found.best_max_abs_error_m_s * 1e3:.1f} mm/s)"


def _battery(found: SessionStatus) -> str:
    now = f"{found.battery_v:.2f} V"
    if found.battery_start_v is None or found.fall_v is None:
        return f"{now}; no trial on it yet"
    text = f"{found.battery_start_v:.2f} -> {now}, {found.fall_v * 1e3:.0f} mV per trial"
    if found.trials_left is None:
        return text
    return f"{text}, about {found.trials_left} trial{'' if found.trials_left == 1 else 's'} left"


def _judgement(found: SessionStatus, verdict: Assessment) -> str:
    if verdict.stop:
        return f"{verdict.words}; stop: {verdict.stop_reason}; {verdict.advice}"
    if verdict.saturation is not None:
        return f"{verdict.words}; {verdict.saturation.text}"
    return verdict.words


def assess_series(
    fish: Fish, operator: Operator, account: SessionLog, rolled_back: bool
) -> Assessment | None:
    """Reports the assessment after the last trial; when it fails a notice, and returns None: the
    board has learned anyway."""
    found, problem = _assess(fish, account.counting(), None, rolled_back)
    if found is None:
        operator.tell(Notice(f"no assessment: {problem}"))
        return None
    operator.tell(assessed(found))
    return found


def assessed(found: Assessment) -> Assessed:
    """The event that reports an assessment."""
    saturated = "" if found.saturation is None else found.saturation.text
    return Assessed(found.words, found.stop, found.stop_reason, found.advice, saturated)


def advice(fish: Fish, experiment: Experiment) -> list[str]:
    """What may be raised next, or why nothing may: one line each. Changes nothing."""

    reference = board_reference(fish)
    if reference is None:
        return []
    params = fish.params.values()
    trials = SessionLog(experiment).counting()
    if trials and trials[-1].params.get("AMP_MAX_RAD") != params["AMP_MAX_RAD"]:
        return [f"AMP_MAX_RAD stays {params['AMP_MAX_RAD']:.2f}: no trial was executed with it yet"]
    straight = heading_drift(trials[-1]) if trials else None
    rolled_back = _has_rolled_back(experiment)
    found = limit_offer(
        params, reference, identified_if_readable(library_of(fish)), straight, rolled_back
    )
    if isinstance(found, str):
        return [found]
    return [
        f"AMP_MAX_RAD may go {found.text.removeprefix('AMP_MAX_RAD ')}",
        f"to do that: tailbeat params set AMP_MAX_RAD {found.to:g}, tailbeat params save "
        "(trials with another limit are judged as a new series)",
    ]
