"""Measures a fish that nobody knows: in a run the amplitude rises beat by beat to the highest that
its reference needs, then the fish coasts.

One such run tells drag, thrust, dead zone and delay about as well as three cruises and a coast-down
and shows at the same time that servo, tail and fish stand the amplitude before
a limit is raised to it. Meanwhile the board has a limit of that height; it gets its own back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tailbeat.board.fish import Fish
from tailbeat.board.preserve import PreservedBoard, preserved
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.reference import Reference
from tailbeat.core.speed_source import Camera
from tailbeat.core.trial_checks import HeadingDrift, heading_drift
from tailbeat.experiment.library import (
    DISCARDED,
    TrialLibrary,
    identified_if_readable,
    keep_run,
    library_of,
    preserve_folder,
)
from tailbeat.learning.fish_model import TrialSpeeds, trial_speeds
from tailbeat.learning.identification import Identified
from tailbeat.learning.identification_runs import identify_trials
from tailbeat.learning.saturation import (
    GRAIN_RAD,
    down_to_grain,
    needed_rad,
    servo_rad,
    up_to_grain,
)
from tailbeat.link.messages import TrialOutcome
from tailbeat.session.events import Operator, notice_to
from tailbeat.session.guards import Guard, GuardedTrial, guards_of
from tailbeat.session.identify import NO_ROOM, prior_of
from tailbeat.session.limit import AMP_MAX, tried_rad
from tailbeat.session.outcome import Travel
from tailbeat.session.preflight import prepare
from tailbeat.session.preflight_step import GivenUp, PreflightLimits, countdown
from tailbeat.session.travel import TravelModel, travel_by, travel_model_of
from tailbeat.session.trial import run_trial
from tailbeat.session.trim import CENTRE

RUNS_MAX = 3
_LOWEST_RAD = 0.15  # where the rise begins: below most dead zones
_RISE_BEATS = (12, 10, 8, 6)  # as many as the tank has room for
_HOLD_BEATS, _COAST_BEATS = 3, 6
_SMALLER_RAD = 0.05  # steps of the highest amplitude where even the shortest rise has no room
_MARGIN_M = 0.15  # of the tank's length, left free
_ALIKE_US = 5.0  # centres that differ by no more: a turn of some 3 degrees over 2.2 m
_TELLING_BEATS = 8  # of a run that was stopped for lack of room
_HANDS = "Put the fish at rest at its start. Ready?"


@dataclass(frozen=True)
class MeasuredFish:
    """What the runs say. ``straight``: of the last run that tells; None: none does. ``runs``: how
    many there were."""

    identified: Identified
    straight: HeadingDrift | None
    runs: int


@dataclass(frozen=True)
class MeasuringRun:
    """One run, planned. ``top_rad``: its highest amplitude."""

    number: int
    top_rad: float
    amplitude_rad: F64
    travel: Travel

    def question(self, limit_rad: float) -> str:
        """Before it, for the operator."""
        beyond = self.top_rad > limit_rad + GRAIN_RAD / 2
        words = f", for this trial beyond its limit of {limit_rad:.2f}" if beyond else ""
        return (
            f"Trial {self.number} to measure the fish: in {len(self.amplitude_rad)} beats the tail"
            f" swings wider and wider, to {self.top_rad:.2f} rad{words}; {self.travel.text()}."
            f" {_HANDS}"
        )


def measure_fish(
    fish: Fish,
    reference: Reference,
    operator: Operator,
    camera: Camera | None = None,
    guard: Guard | None = None,
    limits: PreflightLimits | None = None,
    known: tuple[TrialSpeeds, ...] = (),
) -> MeasuredFish:
    """At most ``RUNS_MAX`` runs, each sized by what is known by then; without ``known`` (trials of
    this fish, executed before) the first one stays within AMP_MAX_RAD. The operator is asked before
    each. Raises GivenUp when the answer is no, TailbeatError when a run ends early."""
    book = library_of(fish)
    note = notice_to(operator)
    with preserved(fish, preserve_folder(book), note, "session commission", (AMP_MAX,)) as board:
        runs = _Runs(board, reference, operator, camera, guard, limits, book, list(known))
        while (run := runs.following()) is not None:
            runs.execute(run)
    return runs.found()


def measured_before(fish: Fish) -> MeasuredFish | None:
    """As the trial library has it; None: no run of this fish is known. Whether it swims straight is
    told by its last trial with about the present centre of the tail."""
    book = library_of(fish)
    identified = identified_if_readable(book)
    if book is None or identified is None or not identified.trials:
        return None
    centre = fish.params.get(CENTRE).value
    counting = (kept.trial for kept in reversed(book.kept()[0]) if kept.mark != DISCARDED)
    trials = (one for one in counting if abs(one.params.get(CENTRE, centre) - centre) <= _ALIKE_US)
    straight = next(filter(None, map(heading_drift, trials)), None)
    return MeasuredFish(identified, straight, len(identified.trials))


def rise(top_rad: float, beats: int) -> F64:
    """The amplitudes of a run, one per beat."""
    up = np.linspace(min(_LOWEST_RAD, top_rad), top_rad, beats)
    return np.concatenate([up, np.full(_HOLD_BEATS, top_rad), np.zeros(_COAST_BEATS)])


@dataclass
class _Runs:
    """State of one call of measure_fish."""

    board: PreservedBoard
    reference: Reference
    operator: Operator
    camera: Camera | None
    guard: Guard | None
    limits: PreflightLimits | None
    book: TrialLibrary | None
    trials: list[TrialSpeeds]
    straight: HeadingDrift | None = None
    count: int = 0
    identified: Identified | None = None

    def __post_init__(self) -> None:
        if self.trials:
            self.identified = self._fitted(quick=True)

    def _fitted(self, quick: bool) -> Identified:
        prior, unique_id = prior_of(self.board.params), self.board.held.unique_id
        return identify_trials(self.trials, prior, None, "runs", unique_id, quick)

    def found(self) -> MeasuredFish:
        return MeasuredFish(self._fitted(quick=False), self.straight, self.count)

    def following(self) -> MeasuringRun | None:
        """The next run; None: they have told enough. Raises InputError when the tank is too short
        for any."""
        if self.count == RUNS_MAX or (top := self._top_rad()) is None:
            return None
        belief = travel_model_of(self.board.params, self.identified)
        allowed = self.board.params
        while top > _LOWEST_RAD:
            for beats in _RISE_BEATS:
                amplitude = rise(top, beats)
                travel = travel_by(belief, amplitude, allowed | {AMP_MAX: top}, 1.0)
                if travel.worst_m <= travel.room_m - _MARGIN_M:
                    return self._planned(top, amplitude, travel)
            top -= _SMALLER_RAD
        raise InputError(
            "the tank is too short to measure the fish.", "Correct TANK_LEN_M and FISH_LEN_M."
        )

    def _planned(self, top_rad: float, amplitude_rad: F64, travel: Travel) -> MeasuringRun | None:
        """None: a run like it was executed before."""
        again = self.count > 0 and self.identified is not None
        if again and top_rad <= tried_rad(self.identified) + GRAIN_RAD / 2:  # type: ignore[arg-type]
            return None
        return MeasuringRun(self.count + 1, top_rad, amplitude_rad, travel)

    def _top_rad(self) -> float | None:
        """How high the next run is to rise."""
        now, servo = self.board.params[AMP_MAX], down_to_grain(servo_rad(self.board.params))
        if self.identified is None:
            return min(now, servo)
        need = up_to_grain(needed_rad(self.identified, self.reference))
        return min(max(need, now), servo)

    def execute(self, run: MeasuringRun) -> None:
        """Asks, executes, keeps."""
        board, operator = self.board, self.operator
        fish, limit_rad = board.fish, board.params[AMP_MAX]
        top = max(run.top_rad, limit_rad)
        allowed = board.params | {AMP_MAX: top}
        belief = travel_model_of(board.params, self.identified)
        predicted = belief.speeds(run.amplitude_rad, 1.0)[: len(run.amplitude_rad)]
        replace(board, params=allowed).prepare(
            f"measure {run.number}", run.amplitude_rad, predicted, {AMP_MAX: top}
        )
        if not operator.confirm(run.question(limit_rad)):
            raise GivenUp("not measured: the answer was no", "Begin again with the same command.")
        if self.limits is not None:
            prepare(fish, self.limits, self.camera, operator, run.travel)
            countdown(fish, self.limits, operator)
        guards = guards_of(self._guarded(allowed, predicted, belief))
        name = f"measuring run {run.number}"
        outcome = run_trial(fish, self.camera, operator.tell, guards, run_name=name)
        trial = board.collect(outcome, self._judge, partial(keep_run, self.book))
        self.count += 1
        self.straight = heading_drift(trial) or self.straight
        self.trials.append(trial_speeds(trial))
        self.identified = self._fitted(quick=True)

    def _guarded(
        self, allowed: dict[str, float], predicted: F64, belief: TravelModel
    ) -> GuardedTrial:
        return GuardedTrial(
            allowed,
            predicted,
            self.operator.wants_abort,
            self.guard,
            kappa_per_m=belief.coasts_by_per_m,
        )

    def _judge(self, outcome: TrialOutcome) -> None:
        """A run that was stopped for lack of room has told what it did until then."""
        if outcome.end == "complete":
            return
        self.board.fish.clear()
        if self.operator.wants_abort():
            raise GivenUp("the trial was stopped by hand", "Begin again with the same command.")
        if outcome.end in NO_ROOM and outcome.executed_beats >= _TELLING_BEATS:
            return
        raise TailbeatError(
            f"identification trial {self.count + 1} ended with {outcome.end} after"
            f" {outcome.executed_beats} beats; the limit stays.",
            "Put it right, then begin again with the same command.",
        )
