"""How far AMP_MAX_RAD may rise, and the short trial with a larger amplitude before it does.

The model was fitted below the old limit. Beyond it the servo may be too slow, the tail may touch
something, the fish may roll or turn; a trial shows it while the old limit still holds on the board.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tailbeat.board.fish import Fish
from tailbeat.board.preserve import preserved
from tailbeat.core.arrays import F64
from tailbeat.core.errors import TailbeatError
from tailbeat.core.reference import Reference
from tailbeat.core.speed_source import Camera
from tailbeat.core.trial_checks import HeadingDrift, heading_drift
from tailbeat.core.trial_file import Trial
from tailbeat.experiment.library import RUN, library_of, preserve_folder
from tailbeat.learning.identification import Identified
from tailbeat.learning.planner import plan
from tailbeat.learning.saturation import (
    GRAIN_RAD,
    down_to_grain,
    hold_rad,
    needed_rad,
    servo_rad,
    up_to_grain,
)
from tailbeat.link.messages import TrialOutcome
from tailbeat.session.change import slope_of
from tailbeat.session.events import Operator, notice_to
from tailbeat.session.guards import Guard, GuardedTrial, guards_of
from tailbeat.session.outcome import Travel
from tailbeat.session.preflight import prepare
from tailbeat.session.preflight_step import PreflightLimits, countdown
from tailbeat.session.travel import travel_of
from tailbeat.session.trial import run_trial

AMP_MAX = "AMP_MAX_RAD"
INCREASE_MAX_RAD = 0.1


@dataclass(frozen=True)
class LimitIncrease:
    """A limit that may be raised. ``reason``: why that far and no farther, with its figures."""

    name: str
    was: float
    to: float
    reason: str

    @property
    def text(self) -> str:
        """``AMP_MAX_RAD from 0.50 to 0.60: ...``."""
        return f"{self.name} from {self.was:.2f} to {self.to:.2f}: {self.reason}"


def next_limit_increase(
    params: Mapping[str, float],
    reference: Reference,
    identified: Identified | None,
    straight: HeadingDrift | None,
    rolled_back: bool = False,
) -> LimitIncrease | str:
    """The next step for AMP_MAX_RAD (at most RAISE_MAX_RAD at once), or why there is none: enough
    for the reference with a margin, not identified, not straight, rolled back, no room in the tank,
    the servo's range. DU_MAX_RAD stays: it slows the way to an amplitude, and forbids none."""
    now = params[AMP_MAX]
    stays = f"{AMP_MAX} stays {now:.2f}"
    if identified is None:
        return (
            f"{stays}: nobody knows yet what amplitude the reference needs:"
            " tailbeat session identify"
        )
    need = needed_rad(identified, reference)
    if need <= now + GRAIN_RAD / 2:
        return f"{stays}: enough, the reference needs {need:.2f} with what learning adds"
    if (why := _not_now(straight, rolled_back)) is not None:
        return f"{stays}: {why}"
    servo = servo_rad(params)
    to = min(now + INCREASE_MAX_RAD, up_to_grain(need), down_to_grain(servo))
    if to < now + GRAIN_RAD / 2:
        return f"{stays}: {_servo_words(params, servo, need)}"
    travel = _travel(params, reference, identified, to)
    if not travel.fits:
        return f"{stays}: no room for more, the trial would come {travel.text()}"
    return LimitIncrease(AMP_MAX, now, to, _reason(params, reference, identified, need, to, travel))


def _not_now(straight: HeadingDrift | None, rolled_back: bool) -> str | None:
    if rolled_back:
        return (
            "the board has just rolled back to its best input, and what went wrong would have more"
            " room; swim until it learns again"
        )
    if straight is None:
        return (
            "nothing tells whether it swims straight (an IMU or a camera would); if you see that it"
            " does, raise it yourself: tailbeat params set"
        )
    if straight.crooked:
        off = abs(math.degrees(straight.worst_yaw_rad))
        return f"it does not swim straight ({off:.0f} degrees off): tailbeat session trim"
    return None


def _servo_words(params: Mapping[str, float], servo: float, need: float) -> str:
    low, high = params["SERVO_MIN_US"], params["SERVO_MAX_US"]
    return (
        f"the servo turns {servo:.2f} rad to the shorter side ({low:.0f} to {high:.0f} us around "
        f"{params['SERVO_CENTRE_US']:.0f}), and the reference needs {need:.2f}; use a slower one"
    )


def _travel(
    params: Mapping[str, float], reference: Reference, identified: Identified, to: float
) -> Travel:
    """Of what the law tends to with that limit: the best input of the model."""

    best = plan(identified.model, reference.speed_m_s, reference.beat_s, to)
    allowed = dict(params) | {AMP_MAX: to}
    return travel_of(best.amplitude_rad, allowed, reference.beat_s, identified)


def _reason(
    params: Mapping[str, float],
    reference: Reference,
    identified: Identified,
    need: float,
    to: float,
    travel: Travel,
) -> str:
    top = float(np.max(reference.speed_m_s)) * 1e3
    words = (
        f"{hold_rad(identified, reference):.2f} rad hold the {top:.0f} mm/s of the reference, and "
        f"it needs {need:.2f} with what learning adds"
    )
    if to < need - GRAIN_RAD / 2:
        at_once = to >= params[AMP_MAX] + INCREASE_MAX_RAD - GRAIN_RAD / 2
        limit = f"at most {INCREASE_MAX_RAD:g} at once" if at_once else "the servo turns no farther"
        words += f"; {limit}"
    step = params.get("DU_MAX_RAD", 0.0)
    if step > 0:
        words += f"; DU_MAX_RAD stays {step:.2f} per trial"
    return f"{words}; way {travel.text()}"


PREDICTION_ERROR_MAX = (
    0.15  # of the speed the model tells: beyond it the model is not this fish up there
)
_RAMP_BEATS, _CRUISE_BEATS, _CRUISE_LEAST, _COAST_BEATS = 4, 10, 4, 4
_MARGIN_M = 0.15  # of the tank, left free, as identify does


@dataclass(frozen=True)
class LimitTrial:
    """``why_not``: what speaks against the amplitude; empty = nothing. ``words``: what was seen."""

    words: str
    why_not: str
    straight: HeadingDrift | None


def try_limit(
    fish: Fish,
    amplitude_rad: float,
    identified: Identified,
    operator: Operator,
    camera: Camera | None = None,
    guard: Guard | None = None,
    limits: PreflightLimits | None = None,
) -> LimitTrial:
    """Swims up to ``amplitude_rad``; the board has its limit and all it had learned back
    afterwards, also when it fails. ``limits``: of the preflight checks before it; None = none.
    Raises TailbeatError when the trial ends early."""
    book = library_of(fish)

    def keep(path: Path) -> None:
        if book is not None:
            book.keep(path, RUN)

    note = notice_to(operator)
    with preserved(fish, preserve_folder(book), note, "session commission", (AMP_MAX,)) as board:
        allowed = board.params | {AMP_MAX: amplitude_rad}
        amplitude = profile(amplitude_rad, identified, allowed)
        if amplitude is None:
            return LimitTrial("", "the tank is too short even for the shortest swim with it", None)
        predicted = identified.model.beats(amplitude, 1.0)
        replace(board, params=allowed).prepare(
            "first session", amplitude, predicted, {AMP_MAX: amplitude_rad}
        )
        if limits is not None:
            prepare(fish, limits, camera, operator)
            countdown(fish, limits, operator)
        guarded = GuardedTrial(allowed, predicted, operator.wants_abort, guard)
        outcome = run_trial(fish, camera, operator.tell, guards_of(guarded))
        trial = board.collect(outcome, lambda o: _judge(fish, o), keep)
    return assess_limit_trial(trial, identified)


def profile(
    amplitude_rad: float, identified: Identified, params: Mapping[str, float]
) -> F64 | None:
    """Up in four steps, as long at the amplitude as fits, then a coast; None = nothing fits."""
    foot = min(identified.model.dead_zone_rad, amplitude_rad)
    steps = np.arange(1, _RAMP_BEATS + 1) / (_RAMP_BEATS + 1)
    ramp = foot + (amplitude_rad - foot) * steps
    for beats in range(_CRUISE_BEATS, _CRUISE_LEAST - 1, -1):
        trial = np.concatenate([ramp, np.full(beats, amplitude_rad), np.zeros(_COAST_BEATS)])
        travel = travel_of(trial, params, 1.0, identified)
        if travel.worst_m <= travel.room_m - _MARGIN_M:
            return trial
    return None


def assess_limit_trial(trial: Trial, identified: Identified) -> LimitTrial:
    """What the trial says of the amplitude."""
    straight = heading_drift(trial)
    part = slope_of(trial, identified.model)
    words = f"proved by a trial: {part:.2f} of the speed foretold"
    if straight is not None:
        words += f", {straight.text()}"
    if straight is not None and straight.crooked:
        return LimitTrial(words, straight.text(), straight)
    if np.isnan(part):
        return LimitTrial(words, "its trial has no speeds", straight)
    if abs(part - 1) > PREDICTION_ERROR_MAX:
        how = "slower" if part < 1 else "faster"
        why = f"it swam {abs(part - 1):.0%} {how} than foretold: look at servo and tail, identify"
        return LimitTrial(words, why, straight)
    return LimitTrial(words, "", straight)


def _judge(fish: Fish, outcome: TrialOutcome) -> None:
    if outcome.end == "complete":
        return
    raise TailbeatError(
        f"the trial that was to prove it ended with {outcome.end} after "
        f"{outcome.executed_beats} beats; the limit stays.",
        "Put it right, then: tailbeat session commission",
    )
