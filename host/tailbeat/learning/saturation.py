"""Saturation: a trial's beats at the amplitude limit, what the reference needs, what to do then.

The words for it are made here and shown everywhere. A few beats at the limit while learning
overshoots are no saturation: only a limit below the best input's largest amplitude is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.board.fish import Fish, board_reference
from tailbeat.core.reference import Reference, thesis
from tailbeat.core.trial_file import Trial
from tailbeat.learning.fish_model import TrialSpeeds, trial_speeds
from tailbeat.learning.identification import Identified
from tailbeat.learning.identification_runs import identify_trials
from tailbeat.learning.planner import plan

# What the law adds to the best amplitudes while it learns: in 60 simulated series of ten trials at
# each drag over mass from 2.5 to 20 1/m, gain 4 to 4.6, 95 of 100 stayed within 0.02 to 0.07.
OVERSHOOT_RAD = 0.07
SERVO_MOST_RAD = 1.0471976  # its mechanical range, and AMP_MAX_RAD's
GRAIN_RAD = 0.01  # limits are multiples of it
_DIGITS = 6  # so that a limit is the number that is read and typed: 69 * 0.01 is not 0.69
SLOWER_BOARD = (
    "tailbeat reference show --csv reference.csv, then tailbeat reference check reference.csv"
    " --suggest"
)
_WEAK_TAIL = 97.5  # of the models as likely
_AT_LIMIT = 1e-6  # of the limit: an amplitude in single precision
_SLOWEST_M_S = 0.005
_SERVO = ("SERVO_CENTRE_US", "SERVO_MIN_US", "SERVO_MAX_US", "SERVO_US_RAD")


@dataclass(frozen=True)
class Saturation:
    """``beats`` of ``trial_beats`` are at ``limit_rad``, or will be (``expected``). ``needed_rad``:
    the largest amplitude the reference needs, with what learning adds; None = not known.
    ``basis``: what that was computed from. ``words``: ``25 of 40 beats at the limit 0.50 rad; the
    reference needs about 0.68 (...)``. ``action``: what to do."""

    beats: int
    trial_beats: int
    limit_rad: float
    needed_rad: float | None
    basis: str
    words: str
    action: str
    expected: bool

    @property
    def text(self) -> str:
        """The words and what to do."""
        begin = "saturation expected" if self.expected else "saturated"
        return f"{begin}: {self.words}. {self.action}"


@dataclass(frozen=True)
class KnownFish:
    """The model that says what a reference needs. ``basis``: where it comes from, in words."""

    identified: Identified
    basis: str


def known_fish(identified: Identified | None, trials: Sequence[TrialSpeeds]) -> KnownFish | None:
    """The identified model, else one fitted to trials of any reference (some 10 ms). None when no
    beat of them has a speed."""
    if identified is not None:
        return KnownFish(identified, "by the identified model")

    used = [trial for trial in trials if trial.measured.any()]
    if not used:
        return None
    count = f"{len(used)} trial{'' if len(used) == 1 else 's'}"
    basis = f"by a model fitted to {count}, extrapolated beyond the limit"
    return KnownFish(identify_trials(used, quick=True), basis)


def saturation_of(
    trial: Trial, identified: Identified | None, trials: Sequence[Trial]
) -> Saturation | None:
    """Of an executed trial; None when no beat was at the limit, or the limit does not hold it back.
    ``trials``: of the same fish, from which a model is fitted when it was not ``identified``."""

    limit = trial.params.get("AMP_MAX_RAD")
    count = trial.executed_beats
    if limit is None or not (at := at_limit(trial.beats.applied_rad[:count], limit)):
        return None
    known = known_fish(identified, [trial_speeds(one) for one in trials])
    reference = Reference(trial.beat_s, trial.beats.reference_m_s, "")
    return _judged(at, count, reference, trial.params, known)


def saturation_next(
    fish: Fish, executed_beats: int, known: Callable[[], KnownFish | None]
) -> Saturation | None:
    """Of the trial that waits on the board to be learned from, without pulling its file. ``known``
    is called when beats are at the limit."""

    params = fish.params.values("AMP_MAX_RAD", *_SERVO)
    count = at_limit(fish.amplitudes().values[:executed_beats], params["AMP_MAX_RAD"])
    if not count or (reference := board_reference(fish)) is None:
        return None
    return _judged(count, executed_beats, reference, params, known())


def expected_saturation(
    known: KnownFish, reference: Reference, params: Mapping[str, float], slower: str = SLOWER_BOARD
) -> Saturation | None:
    """Before a trial of the reference: what its best input meets at the limit. None: it does not.
    ``params``: AMP_MAX_RAD, and the servo's where they are known. ``slower``: what makes a slower
    reference of this one; default: of the board's."""

    limit = params["AMP_MAX_RAD"]
    best = plan(known.identified.model, reference.speed_m_s, reference.beat_s, limit)
    count = at_limit(best.amplitude_rad.astype(np.float32), limit)
    return _judged(count, reference.beats, reference, params, known, slower, expected=True)


def at_limit(amplitude_rad: ArrayLike, limit_rad: float) -> int:
    """How many beats have the largest amplitude that is allowed."""
    amplitude = np.nan_to_num(np.asarray(amplitude_rad, dtype=np.float64))
    return int(np.count_nonzero(amplitude >= limit_rad * (1 - _AT_LIMIT)))


def needed_rad(identified: Identified, reference: Reference) -> float:
    """The largest amplitude of the best input by the model, for the weakest of the models as likely
    at the reference's top speed, and what learning adds to it."""
    top = float(np.max(reference.speed_m_s))
    weakest = np.percentile([float(m.amplitude_rad(top)) for m in identified.models], _WEAK_TAIL)
    weaker = max(float(weakest) - hold_rad(identified, reference), 0.0)
    return _best_rad(identified, reference) + weaker + OVERSHOOT_RAD


def hold_rad(identified: Identified, reference: Reference) -> float:
    """What holds the reference's top speed."""
    return float(identified.model.amplitude_rad(float(np.max(reference.speed_m_s))))


def servo_rad(params: Mapping[str, float]) -> float:
    """How far the servo turns to either side before its pulses end."""
    centre = params["SERVO_CENTRE_US"]
    pulse = min(centre - params["SERVO_MIN_US"], params["SERVO_MAX_US"] - centre)
    return min(max(pulse, 0.0) / params["SERVO_US_RAD"], SERVO_MOST_RAD)


def up_to_grain(value: float) -> float:
    """The next limit from ``value`` on."""
    return round(math.ceil(value / GRAIN_RAD - 1e-6) * GRAIN_RAD, _DIGITS)


def down_to_grain(value: float) -> float:
    """The next limit down from ``value``."""
    return round(math.floor(value / GRAIN_RAD + 1e-6) * GRAIN_RAD, _DIGITS)


def _best_rad(identified: Identified, reference: Reference) -> float:
    best = plan(identified.model, reference.speed_m_s, reference.beat_s, SERVO_MOST_RAD)
    return float(best.amplitude_rad.max())


def _judged(
    count: int,
    trial_beats: int,
    reference: Reference,
    params: Mapping[str, float],
    known: KnownFish | None,
    slower: str = SLOWER_BOARD,
    expected: bool = False,
) -> Saturation | None:
    limit = params["AMP_MAX_RAD"]
    need, basis = None, ""
    words = "how much the reference needs is not known"
    action = "To find out how much it needs: tailbeat session identify"
    if known is not None:
        if not count or _best_rad(known.identified, reference) <= limit + GRAIN_RAD:
            return None
        need, basis = needed_rad(known.identified, reference), known.basis
        words = f"the reference needs about {up_to_grain(need):.2f} ({basis})"
        slower = _slower(reference, limit, known, slower, learned=not expected)
        action = _action(params, need, slower)
    words = f"{count} of {trial_beats} beats at the limit {limit:.2f} rad; {words}"
    return Saturation(count, trial_beats, limit, need, basis, words, action, expected)


def _action(params: Mapping[str, float], need: float, slower: str) -> str:
    limit = params["AMP_MAX_RAD"]
    servo = servo_rad(params) if all(name in params for name in _SERVO) else SERVO_MOST_RAD
    to = min(up_to_grain(need), down_to_grain(servo))
    if to < limit + GRAIN_RAD / 2:
        return f"The servo turns {servo:.2f} rad at most. Use a slower reference: {slower}"
    return (
        "If the fish's commissioning allows more, raise the limit: tailbeat params set AMP_MAX_RAD"
        f" {to:.2f}. Otherwise use a slower reference: {slower}"
    )


def _slower(
    reference: Reference, limit: float, known: KnownFish, by_check: str, learned: bool
) -> str:
    """A command that gives the board one within the limit, else ``by_check``."""
    if reference.crc == thesis().crc:
        more = _best_rad(known.identified, reference) - hold_rad(known.identified, reference)
        speed = float(known.identified.model.steady_m_s(limit - GRAIN_RAD - max(more, 0.0)))
        speed = math.floor(speed * 1e3) / 1e3
        if speed >= _SLOWEST_M_S:
            like = " --warm-start board" if learned else ""
            return f"tailbeat reference upload thesis:{speed:g},{reference.duration_s:g}{like}"
    first = "" if known.identified.source == "runs" else "tailbeat session identify, then "
    return first + by_check
