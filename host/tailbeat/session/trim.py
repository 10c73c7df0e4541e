"""Finds the servo pulse with the tail straight, from how the fish turns over two short trials."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from functools import partial

import numpy as np

from tailbeat.board.fish import Fish
from tailbeat.board.preserve import PreservedBoard, preserved
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.speed_source import Camera, Frame
from tailbeat.core.trial_checks import (
    HeadingTrace,
    heading_trace,
    heading_trace_of_frames,
    imu_drift_rad_s,
    with_way,
)
from tailbeat.core.trial_file import Trial
from tailbeat.experiment.current import current, set_and_save
from tailbeat.experiment.library import TrialLibrary, keep_run, library_of, preserve_folder
from tailbeat.learning.fish_model import TrialSpeeds, trial_speeds
from tailbeat.learning.scatter import Scatter
from tailbeat.link.messages import TrialOutcome
from tailbeat.session.events import Operator, StepProgress, notice_to
from tailbeat.session.guards import FrameRecorder, Guard, GuardedTrial, guards_of
from tailbeat.session.outcome import Travel
from tailbeat.session.preflight import prepare
from tailbeat.session.preflight_step import GivenUp, PreflightLimits, countdown
from tailbeat.session.travel import TravelModel, last_measured, travel_by, travel_model_of
from tailbeat.session.trial import run_trial
from tailbeat.session.trial_camera import board_time_s, camera_of

CENTRE = "SERVO_CENTRE_US"
OFFSET_RAD = 0.06  # to either side: turns a fish by some 25 degrees in such a trial, no more
SHOWN_M = 2.2  # the way of the thesis's reference, for which a turn is told in degrees

_AMPLITUDE_MAX_RAD = 0.5  # enough for a brisk swim of any fish
_RAMP_BEATS, _COAST_BEATS = 4, 2
_CRUISE_BEATS = (8, 7, 6, 5)
_SLOWER = 0.9
_MARGIN_M = 0.15  # of the tank's length, left free
_ALIKE_SIGMAS = 5.0  # two turns that differ by less tell no centre
_FAR_RAD = 0.35  # a tail mounted further askew is no matter of trim
_ASKEW_RAD, _HEADING_SIGMA_RAD = 0.5, 0.035  # a speed along the tank tells of less askew a fish
_BEATS_MIN = 8  # swum of both, to tell anything
_NOTHING = "Nothing was changed; tailbeat session trim"
_REST_S, _PATIENCE_S, _LOOK_S = 20.0, 90.0, 0.2  # of board time


@dataclass(frozen=True)
class TrimTrial:
    """One of the two: its centre, and how the fish turned per metre, clockwise from above."""

    centre_us: float
    turn_rad_m: float
    sigma_rad_m: float


@dataclass(frozen=True)
class Trim:
    """``centre_us``: where it would swim straight, by the line through the trials; with its
    standard deviation. ``source``: of the turns, ``imu`` or ``camera``. ``was_us``: what was
    set."""

    was_us: float
    centre_us: float
    sigma_us: float
    swims: tuple[TrimTrial, TrimTrial]
    source: str

    @property
    def turn_rad_m_us(self) -> float:
        """How much a microsecond turns it, per metre."""
        low, high = self.swims
        return (high.turn_rad_m - low.turn_rad_m) / (high.centre_us - low.centre_us)

    def turn_rad(self, centre_us: float, way_m: float = SHOWN_M) -> float:
        """How far it turns over a way with another centre, clockwise from above."""
        return self.turn_rad_m_us * (centre_us - self.centre_us) * way_m

    def text(self) -> str:
        """Before and after, in two lines."""
        before = math.degrees(self.turn_rad(self.was_us))
        left = abs(math.degrees(self.turn_rad_m_us * self.sigma_us * SHOWN_M))
        side = "right" if before > 0 else "left"
        return (
            f"centre {self.was_us:.1f} us: it turns {abs(before):.0f} degrees to the {side} over "
            f"{SHOWN_M} m\ncentre {self.centre_us:.1f} +- {self.sigma_us:.1f} us: straight, within "
            f"{left:.1f} degrees (by the {self.source.replace('imu', 'IMU')})"
        )


def centre_of(
    swims: tuple[TrimTrial, TrimTrial], was_us: float, source: str, params: Mapping[str, float]
) -> Trim:
    """The line through the two, where it turns by nothing. Raises InputError when that makes no
    sense."""
    low, high = swims
    apart = high.turn_rad_m - low.turn_rad_m
    sigma = math.hypot(low.sigma_rad_m, high.sigma_rad_m)
    if not abs(apart) > _ALIKE_SIGMAS * sigma:  # also when either is not known
        raise InputError(
            f"the two trials turned alike ({low.turn_rad_m:+.3f} and {high.turn_rad_m:+.3f} rad/m, "
            f"each +- {sigma:.3f}), though the tail beat about two centres.",
            "Nothing was changed. Check that tail and servo are firm and the fish is free on all "
            "sides, then trim again.",
        )
    width = high.centre_us - low.centre_us
    centre = low.centre_us - low.turn_rad_m * width / apart
    by_each = math.hypot(high.turn_rad_m * low.sigma_rad_m, low.turn_rad_m * high.sigma_rad_m)
    _check_reach(centre, was_us, params)
    return Trim(was_us, centre, abs(width) * by_each / apart**2, swims, source)


def _check_reach(centre_us: float, was_us: float, params: Mapping[str, float]) -> None:
    us_rad = params["SERVO_US_RAD"]
    low, high = params["SERVO_MIN_US"], params["SERVO_MAX_US"]
    swing_us = params["AMP_MAX_RAD"] * us_rad
    far = abs(centre_us - was_us) > _FAR_RAD * us_rad
    if not far and low + swing_us <= centre_us <= high - swing_us:
        return
    degrees = math.degrees((centre_us - was_us) / us_rad)
    raise InputError(
        f"the centre would be {centre_us:.0f} us, {abs(degrees):.0f} degrees from what is set: "
        + ("too far for a trim." if far else f"{low:.0f} to {high:.0f} us leave no full swing."),
        "Mount the tail straighter on the servo's horn (a tooth on or back), then trim again; "
        "nothing was changed.",
    )


@dataclass(frozen=True)
class TrimPlan:
    """A short trial: ``amplitude_rad`` per beat of 1 s, the speeds that are predicted."""

    amplitude_rad: F64
    predicted_m_s: F64
    travel: Travel


def plan(belief: TravelModel, params: Mapping[str, float]) -> TrimPlan:
    """As brisk as AMP_MAX_RAD, the servo and the tank allow, gently up to it. Raises InputError
    when the tank is too short or the fish would not move."""
    us_rad, centre = params["SERVO_US_RAD"], params[CENTRE]
    swing_us = min(centre - params["SERVO_MIN_US"], params["SERVO_MAX_US"] - centre)
    most = min(params["AMP_MAX_RAD"], _AMPLITUDE_MAX_RAD, swing_us / us_rad - OFFSET_RAD)
    foot = belief.model.dead_zone_rad
    if most <= foot + 0.02:
        raise InputError(
            f"at {max(most, 0.0):.2f} rad, the most that is allowed, the fish would hardly move.",
            f"Raise AMP_MAX_RAD above {foot + 0.1:.2f}, or look at SERVO_MIN_US and SERVO_MAX_US.",
        )
    travel = None
    for beats in _CRUISE_BEATS:
        cruise = most
        while cruise > foot + 0.02:
            amplitude = _profile(foot, cruise, beats)
            travel = travel_by(belief, amplitude, params, 1.0)
            if travel.worst_m <= travel.room_m - _MARGIN_M:
                return TrimPlan(amplitude, belief.speeds(amplitude, 1.0), travel)
            cruise = foot + _SLOWER * (cruise - foot)
            if cruise < foot + 0.5 * (most - foot):
                break  # fewer beats rather than slower ones
    assert travel is not None
    raise InputError(
        f"the tank is too short to trim: {max(travel.room_m, 0.0):.2f} m are left.",
        "Correct TANK_LEN_M and FISH_LEN_M, or identify the fish first (tailbeat session "
        "identify).",
    )


def _profile(foot_rad: float, cruise_rad: float, beats: int) -> F64:
    ramp = foot_rad + (cruise_rad - foot_rad) * np.arange(1, _RAMP_BEATS + 1) / (_RAMP_BEATS + 1)
    return np.concatenate([ramp, np.full(beats, cruise_rad), np.zeros(_COAST_BEATS)])


def find_centre(
    fish: Fish,
    operator: Operator,
    camera: Camera | None = None,
    guard: Guard | None = None,
    limits: PreflightLimits | None = None,
    on_trial: Callable[[TrialSpeeds], None] = lambda trial: None,
) -> Trim:
    """Swims twice, the tail centred a little to either side of what is set, and puts back what the
    board had learned, its reference and its centre. ``limits``: of the preflight checks before each
    trial; None = only the operator is asked. ``on_trial``: gets the fish's own speed in the
    trials. Sets nothing: see apply.

    Raises InputError when the turns do not tell a centre (none was felt, the two are alike, or the
    centre would lie beyond the servo's range), GivenUp when the operator wants no more."""
    book = library_of(fish)
    belief = _belief(fish, book)

    with ExitStack() as stack:
        camera = stack.enter_context(camera_of(fish, camera))
        board = stack.enter_context(
            preserved(fish, preserve_folder(book), notice_to(operator), "trim", (CENTRE,))
        )
        swimmer = _TrimRunner(board, operator, camera, guard, limits, book)
        planned = plan(belief, board.params)
        was_us = board.params[CENTRE]
        offset_us = OFFSET_RAD * board.params["SERVO_US_RAD"]
        logs = [
            swimmer.swim(number, was_us + side * offset_us, planned)
            for number, side in ((1, -1.0), (2, 1.0))
        ]
        one, two, source = _courses(logs, planned)
        for log, course in zip(logs, (one, two), strict=True):
            on_trial(_own_speed(log.trial, course))
        low, high = _turned(logs[0], one, source), _turned(logs[1], two, source)
        return centre_of((low, high), was_us, source, board.params)


def apply(fish: Fish, trim: Trim) -> float:
    """Sets the centre that was found, for good, and says so in the fish's experiment if it is in
    one; what is set now."""

    value = round(trim.centre_us, 1)
    held = set_and_save(fish, {CENTRE: value})[CENTRE]
    if (experiment := current(fish)) is not None:
        experiment.journal.add("trimmed", **(asdict(trim) | {"centre_us": held}))
    return held


def _belief(fish: Fish, book: TrialLibrary | None) -> TravelModel:
    params = fish.params.values()
    identified = book.identified() if book is not None else None
    return travel_model_of(params, identified, last_measured(fish, book))


@dataclass(frozen=True)
class _Log:
    """A trial that was executed: its file, and the frames with their time from its begin."""

    centre_us: float
    trial: Trial
    frames: list[Frame] = field(default_factory=list)


@dataclass
class _TrimRunner:
    board: PreservedBoard
    operator: Operator
    camera: Camera | None
    guard: Guard | None
    limits: PreflightLimits | None
    book: TrialLibrary | None

    def swim(self, number: int, centre_us: float, planned: TrimPlan) -> _Log:
        """Asks, swims, keeps."""
        fish = self.board.fish
        self.board.prepare(
            f"trim {number}", planned.amplitude_rad, _reference(planned), {CENTRE: centre_us}
        )
        self._ask(number, centre_us, planned)
        guarded = GuardedTrial(
            self.board.params, planned.predicted_m_s, self.operator.wants_abort, self.guard
        )
        seen = FrameRecorder()
        guards, name = guards_of(guarded, seen), f"trim run {number}"
        outcome = run_trial(fish, self.camera, self.operator.tell, guards, run_name=name)
        trial = self.board.collect(outcome, self._judge, partial(keep_run, self.book))
        return _Log(centre_us, trial, _since_begin(fish, self.camera, seen.frames, trial))

    def _ask(self, number: int, centre_us: float, planned: TrimPlan) -> None:
        side = "left" if centre_us < self.board.params[CENTRE] else "right"
        text = (
            f"trial {number} of 2, centre a little to the {side} ({centre_us:.0f} us): "
            f"{len(planned.amplitude_rad)} beats, up to {planned.amplitude_rad.max():.2f} rad; "
            f"{planned.travel.text()}"
        )
        self.operator.tell(StepProgress(f"trim {number}", text, ok=True))
        if not self.operator.confirm("Is the fish at rest at its start, free on both sides?"):
            raise GivenUp("the trim was not wanted", _NOTHING)
        if self.limits is not None:
            prepare(self.board.fish, self.limits, self.camera, self.operator, planned.travel)
            countdown(self.board.fish, self.limits, self.operator)
        else:
            self._wait_until_still()

    def _wait_until_still(self) -> None:
        """The IMU's zero is as good as the rest before the trial is long. Without an IMU, or if the
        fish does not come to rest, a camera has to do."""
        fish, left_s = self.board.fish, _PATIENCE_S
        if fish.imu_verdict().state != "streaming":
            return
        while fish.link.request("TAILBEAT_IMU_INFO").still_s < _REST_S and left_s > 0:
            if self.operator.wants_abort():
                raise GivenUp("the trim was stopped by hand", _NOTHING)
            fish.link.run(_LOOK_S / max(fish.clock.rate, 1.0))
            left_s -= _LOOK_S

    def _judge(self, outcome: TrialOutcome) -> None:
        if outcome.end == "complete":
            return
        self.board.fish.clear()
        if self.operator.wants_abort():
            raise GivenUp("the trim was stopped by hand", _NOTHING)
        if outcome.executed_beats < _BEATS_MIN:
            raise TailbeatError(
                f"swim {outcome.number} ended with {outcome.end} after "
                f"{outcome.executed_beats} beats.",
                "Put it right, then trim again; nothing was changed.",
            )


def _reference(planned: TrimPlan) -> F64:
    """What is predicted, without the coast after the last beat."""
    return planned.predicted_m_s[: len(planned.amplitude_rad)]


def _own_speed(trial: Trial, course: HeadingTrace) -> TrialSpeeds:
    """Along its heading, where the speed along the tank still tells it."""
    speeds = trial_speeds(trial)
    heading = np.full(speeds.beats, np.nan)
    heading[: len(course.heading_rad)] = course.heading_rad[: speeds.beats]
    with np.errstate(invalid="ignore"):
        own = np.where(np.abs(heading) < _ASKEW_RAD, speeds.speed_m_s / np.cos(heading), np.nan)
    by_heading = np.nan_to_num(own * np.tan(heading)) * _HEADING_SIGMA_RAD
    return replace(speeds, speed_m_s=own, sigma_m_s=np.hypot(speeds.sigma_m_s, by_heading))


def _since_begin(
    fish: Fish, camera: Camera | None, frames: list[Frame], trial: Trial
) -> list[Frame]:
    begin_s = trial.start_us * 1e-6
    return [replace(f, t_s=board_time_s(f, camera, fish.clock) - begin_s) for f in frames]


def _turned(log: _Log, course: HeadingTrace, source: str) -> TrimTrial:
    """With a sigma that holds what the scatter about the line does not show: a fish at rest that
    turned a little, and water that flowed (the tail turns it by the metre through the water)."""
    turn, sigma = course.turn_rad_m()
    way_m = float(np.nanmax(course.way_m) - np.nanmin(course.way_m)) if sigma > 0 else math.nan
    swim_s = float(np.count_nonzero(np.isfinite(course.way_m)))
    drift = imu_drift_rad_s(log.trial) / math.sqrt(3) if source == "imu" else 0.0
    flow = Scatter().flow_m_s * turn
    return TrimTrial(
        log.centre_us, turn, math.hypot(sigma, drift * swim_s / way_m, flow * swim_s / way_m)
    )


def _courses(logs: list[_Log], planned: TrimPlan) -> tuple[HeadingTrace, HeadingTrace, str]:
    """Of both swims by the same means; the IMU's first."""
    felt = [heading_trace(log.trial) for log in logs]
    known = [course for course in felt if course is not None and course.known]
    source = "imu"
    if len(known) < len(logs):
        source = "camera"
        known = [
            heading_trace_of_frames(log.frames, 0.0, log.trial.executed_beats, 1.0) for log in logs
        ]
        if not all(course.known for course in known):
            raise InputError(
                "nothing felt how the fish turned: the IMU did not, and no camera saw it.",
                "Look at the IMU (tailbeat board imu status), or give a --camera; nothing was "
                "changed.",
            )
    if not all(np.isfinite(course.way_m).any() for course in known):
        # A wrong length of way changes the turn per metre, and not where it is none.
        known = [with_way(course, planned.predicted_m_s, 1.0) for course in known]
    return known[0], known[1], source
