"""What a trial proves: progress, noise, or a turn for the worse; and when to stop.

Trials with the same amplitudes are repeats. Their scatter of max|e| is the noise; a difference
within it proves nothing. The scatter is about the same number of mm/s whatever max|e| is, so it is
reckoned in m/s and told as factors of the best.
"""

from __future__ import annotations

import math
import zlib
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.core import trial_checks as judging
from tailbeat.core.arrays import F32, F64
from tailbeat.core.reference import Reference
from tailbeat.core.trial_file import Trial
from tailbeat.learning.fish_model import SIGMA_M_S, Conditions
from tailbeat.learning.identification import Identified
from tailbeat.learning.saturation import Saturation

SCATTER_M_S = 0.0031  # half of the 95 % interval of repeats on the tank plant, kappa 5 to 20 1/m
WINDOW = 3  # trials without progress that end a series
BOUND_WINDOW = 2  # trials in a row within noise of the L2-optimal input's error that end it
MOVES = 0.9  # a fish whose max|e| is above this part of the one at rest hardly swims yet
_SLOPE_SIGMAS = 1.2  # a slope this far from none may well be one
_REPEATS_MIN = 3
_PRIOR_FREEDOM = 4  # what is expected counts as much as five repeats
_CONFIDENCE = 0.95
_DRAWS = 512  # a power of 2, as Sobol's points want it
# 95 % point of the range of 2, 3, ... 20 normal numbers, in sigmas (studentized range, infinitely
# many degrees of freedom).
_RANGE_SIGMAS = (
    *(2.77, 3.31, 3.63, 3.86, 4.03, 4.17, 4.29, 4.39, 4.47),
    *(4.55, 4.62, 4.68, 4.74, 4.80, 4.85, 4.89, 4.93, 4.97, 5.01),
)
_NARROWEST, _WIDEST = 0.05, 3.0


@dataclass(frozen=True)
class Score:
    """One trial as the verdict sees it. ``input_crc`` names the amplitudes: equal = a repeat.
    ``max_abs_error_m_s``: over its measured beats. ``judged``: it was executed to its end and
    enough of its beats are measured (firmware/ilc/judge.h). ``error_m_s``: per beat, NaN = not
    measured."""

    trial: int
    iteration: int
    input_crc: int
    max_abs_error_m_s: float
    judged: bool
    error_m_s: F32 = field(compare=False, repr=False)
    rolled_back: bool = False


@dataclass(frozen=True)
class NoiseBand:
    """How much max|e| of one input scatters: the 95 % interval of a trial's max|e| over the median
    of its repeats, as factors, for the best input. ``repeats`` = 0: expected from what is known of
    the fish, not seen. ``level_m_s``: that median; NaN = not known, the best's max|e| is taken."""

    low: float
    high: float
    repeats: int
    level_m_s: float = float("nan")

    def widths(self, best_m_s: float) -> tuple[float, float]:
        """The interval in m/s, (down, up) from the median."""
        level = self.level_m_s if math.isfinite(self.level_m_s) else best_m_s
        return (1 - self.low) * level, (self.high - 1) * level

    def text(self) -> str:
        """``repeats scatter by -12..+25 %``."""
        what = "repeats scatter by" if self.repeats else "repeats are expected to scatter by"
        return f"{what} {(self.low - 1) * 100:.0f}..{(self.high - 1) * 100:+.0f} %"


@dataclass(frozen=True)
class Assessment:
    """``kind``: ``first``, ``progress``, ``noise``, ``worse``, ``rolled_back``, ``incomplete``.
    ``words``: one line for people. ``best_trial``: ``best_of``, 0 = none was
    judged (``best_max_abs_error_m_s`` is NaN then). ``stop``: nothing more to gain;
    ``stop_reason`` says why, ``advice`` what to do then. ``saturation``: of the last trial, when
    the amplitude limit holds it back (``progress_of``)."""

    kind: str
    words: str
    best_trial: int
    best_max_abs_error_m_s: float
    band: NoiseBand
    stop: bool = False
    stop_reason: str = ""
    advice: str = ""
    saturation: Saturation | None = None


def assess(
    scores: Sequence[Score],
    expected: NoiseBand | None = None,
    floor_m_s: float | None = None,
    rest_m_s: float | None = None,
) -> Assessment:
    """The verdict on the last of ``scores`` (all of one reference, oldest first, at least one).
    ``floor_m_s``: max|e| of the best any input can do. ``rest_m_s``: max|e| of a fish that stays
    where it is; a series is not ended before the fish swims."""
    scores = comparable(scores)
    band = noise_band(scores, expected)
    best = best_of(scores)
    kind, words = _kind_and_words(scores, band)
    words += _common_words(scores)
    stop_reason = _stop_reason(scores, kind, band, floor_m_s, rest_m_s)
    return Assessment(
        kind=kind,
        words=words,
        best_trial=best.trial if best else 0,
        best_max_abs_error_m_s=best.max_abs_error_m_s if best else float("nan"),
        band=band,
        stop=bool(stop_reason),
        stop_reason=stop_reason,
        advice=_advice(scores, band) if stop_reason else "",
    )


def assess_all(
    scores: Sequence[Score],
    expected: Callable[[Score], NoiseBand] | None = None,
    floor_m_s: float | None = None,
    rest_m_s: float | None = None,
) -> list[Assessment]:
    """What ``judge`` said, or would have said, after each trial. ``expected``: the band for the
    best trial of those up to then."""
    bands: dict[int, NoiseBand] = {}
    assessments = []
    for end in range(1, len(scores) + 1):
        best = best_of(scores[:end])
        if expected is not None and best is not None and best.input_crc not in bands:
            bands[best.input_crc] = expected(best)
        band = bands.get(best.input_crc) if best else None
        assessments.append(assess(scores[:end], band, floor_m_s, rest_m_s))
    return assessments


def noise_band(scores: Sequence[Score], expected: NoiseBand | None = None) -> NoiseBand:
    """From repeats where there are at least three of an input, else what is expected.

    Deviations from the mean of their input's repeats are pooled over all inputs (variance s**2 with
    n degrees of freedom) and drawn towards what is expected, which counts as 4 degrees of freedom:
    the half width is t(0.975, 4 + n) * sqrt((4*s0**2 + n*s**2)/(4 + n)), s0 = expected half width /
    t(0.975, 4). ``expected`` (default: ``default_band``) is for the best input.
    """
    scores = comparable(scores)
    best = best_of(scores)
    if best is None:
        return expected or default_band(float("nan"))
    prior = expected or default_band(best.max_abs_error_m_s)
    groups = _repeats(scores)
    if not any(len(group) >= _REPEATS_MIN for group in groups):
        return NoiseBand(prior.low, prior.high, 0, prior.level_m_s)
    freedom = sum(len(group) - 1 for group in groups)
    squares = sum(float(np.sum((group - group.mean()) ** 2)) for group in groups)
    down, up = prior.widths(best.max_abs_error_m_s)
    before = (down + up) / 2 / student_t(_PRIOR_FREEDOM)
    together = _PRIOR_FREEDOM + freedom
    sigma = math.sqrt((_PRIOR_FREEDOM * before**2 + squares) / together)
    factor = student_t(together) * sigma / ((down + up) / 2)
    level = _best_level(scores, prior)
    repeats = sum(len(group) for group in groups)
    return _band(1 - factor * down / level, 1 + factor * up / level, repeats, level)


def default_band(max_abs_error_m_s: float) -> NoiseBand:
    """What is expected of a fish of which nothing is known, for an input with this max|e|."""
    if not (math.isfinite(max_abs_error_m_s) and max_abs_error_m_s > 0):
        return NoiseBand(0.75, 1.25, 0)
    part = SCATTER_M_S / max_abs_error_m_s
    return _band(1 - part, 1 + part, 0, max_abs_error_m_s)


def expected_band(
    identified: Identified, reference: Reference, amplitude_rad: ArrayLike
) -> NoiseBand:
    """What is expected of an identified fish: its model executes the input 512 times, with gain,
    flow, start and measurement scattering as they do. The same numbers every time."""
    from scipy.stats import norm, qmc

    random = np.random.default_rng(1)
    scatter = identified.scatter
    wanted = reference.speed_m_s.astype(np.float64)
    noise = random.normal(0.0, SIGMA_M_S, (_DRAWS, len(wanted)))
    draws = norm.ppf(qmc.Sobol(3, seed=1).random(_DRAWS))
    worst = np.empty(_DRAWS)
    for row, (gain, flow, start) in enumerate(draws):
        given = Conditions(
            abs(start) * scatter.start_m_s, flow * scatter.flow_m_s, 1 + gain * scatter.gain
        )
        speed = identified.model.beats(amplitude_rad, reference.beat_s, given)
        worst[row] = np.abs(wanted - speed - noise[row]).max()
    tail = (1 - _CONFIDENCE) / 2 * 100
    middle = float(np.median(worst))
    low, high = np.percentile(worst, [tail, 100 - tail]) / middle
    return _band(float(low), float(high), 0, middle)


def input_crc(amplitude_rad: ArrayLike) -> int:
    """Names amplitudes: CRC-32 of their float32 bytes, saturated as executed."""
    return zlib.crc32(np.asarray(amplitude_rad, dtype="<f4").tobytes())


def score_of(trial: Trial, rolled_back: bool = False) -> Score:
    """From a trial's file."""
    beats = trial.beats
    limit = trial.params.get("AMP_MAX_RAD", math.inf)
    wanted = np.clip(np.nan_to_num(beats.amplitude_rad), 0, np.float32(limit))
    recorded = np.where(np.isfinite(beats.applied_rad), beats.applied_rad, wanted)
    error = np.where(np.arange(len(recorded)) < trial.executed_beats, beats.error_m_s, np.nan)
    error = error.astype(np.float32)
    complete = trial.end_fault == 0 and trial.executed_beats >= len(recorded)
    return Score(
        trial=trial.number,
        iteration=trial.iteration,
        input_crc=input_crc(recorded),
        max_abs_error_m_s=judging.max_abs(error),
        judged=judging.counts(error, complete),
        rolled_back=rolled_back,
        error_m_s=error,
    )


def repeat_limits(before: Sequence[Score], input_crc: int, band: NoiseBand) -> tuple[float, float]:
    """(low, high) of max|e| that one more trial of an input has in 95 of 100 cases, m/s.
    ``before``: the series; judged trials of other inputs tell how lucky a single one was."""
    before = comparable(before)
    recorded = [score.max_abs_error_m_s for score in repeats_of(before, input_crc)]
    if len(recorded) > 1:
        level, trials = float(np.median(recorded)), len(recorded)
    else:
        judged = np.array([score.max_abs_error_m_s for score in before if score.judged])
        level, trials = _level(judged[judged >= min(recorded, default=0.0)], band)
    widen = math.sqrt(1 + 1 / trials)
    down, up = band.widths(level)
    return max(level - widen * down, 0.0), level + widen * up


def best_of(scores: Sequence[Score]) -> Score | None:
    """The judged trial that the board would have made its best; None = none is judged. It has the
    smallest max|e|, the first of equals, when no beat is missing; else see firmware/ilc/judge.h."""
    judged = [score for score in scores if score.judged]
    at = judging.best_at(score.error_m_s for score in judged)
    return None if at is None else judged[at]


def comparable(scores: Sequence[Score]) -> list[Score]:
    """Judged trials with the max|e| that they would have with the beats of the best: that of the
    best plus the difference on the beats that both measured. No change where no beat is missing."""
    best = best_of(scores)
    if best is None:
        return list(scores)
    return [_against(score, best) if score.judged else score for score in scores]


def _against(score: Score, best: Score) -> Score:
    mine, its = judging.on_common_beats(score.error_m_s, best.error_m_s)
    same = (mine, its) == (judging.max_abs(score.error_m_s), judging.max_abs(best.error_m_s))
    if same or not math.isfinite(mine):
        return score
    value = max(best.max_abs_error_m_s + mine - its, 0.0)
    return replace(score, max_abs_error_m_s=value)


def repeats_of(scores: Sequence[Score], input_crc: int) -> list[Score]:
    """The judged trials of one input."""
    return [score for score in scores if score.judged and score.input_crc == input_crc]


def _kind_and_words(scores: Sequence[Score], band: NoiseBand) -> tuple[str, str]:
    last, before = scores[-1], [score for score in scores[:-1] if score.judged]
    best = best_of(before)
    if not last.judged:
        return "incomplete", _incomplete_words(last, best)
    if best is None:
        return "first", f"the first trial: {_mm(last)} mm/s"
    if last.rolled_back:
        return "rolled_back", f"worse: rolled back to trial {best.trial}'s input"
    low, high = _limits(before, band)
    value = last.max_abs_error_m_s
    if value < min(low, best.max_abs_error_m_s):
        return "progress", f"progress: {_mm(best)} -> {_mm(last)} mm/s"
    if value > high:
        own = " with the best's own input; has the water, the battery or the camera changed?"
        own = own if last.input_crc == best.input_crc else ""
        words = f"worse than noise explains: {_mm(last)} mm/s{own}"
        return "worse", f"{words} (the best: {_about(best, band)})"
    if value < best.max_abs_error_m_s:
        return "noise", f"the best, but within noise of trial {best.trial} ({_about(best, band)})"
    return "noise", f"within noise of the best ({_about(best, band)})"


def _common_words(scores: Sequence[Score]) -> str:
    """Where the last trial or the best before it has missing beats."""
    last, best = scores[-1], best_of(scores[:-1])
    if not last.judged or best is None:
        return ""
    common = int(np.count_nonzero(np.isfinite(last.error_m_s) & np.isfinite(best.error_m_s)))
    beats = len(last.error_m_s)
    return "" if common == beats else f"; compared on the {common} of {beats} beats both measured"


def _incomplete_words(last: Score, best: Score | None) -> str:
    known = np.isfinite(last.error_m_s)
    if not known.any():
        return "incomplete: no beat has a speed"
    count = int(np.count_nonzero(known))
    which = f"the first {count} beats" if known[:count].all() else f"{count} beats"
    words = f"incomplete: {which} {_mm(last)} mm/s"
    if best is None or best.error_m_s.shape != known.shape:
        return words
    there = judging.max_abs(best.error_m_s[known])
    return f"{words}, the best had {there * 1e3:.1f} there"


def _stop_reason(
    scores: Sequence[Score],
    kind: str,
    band: NoiseBand,
    floor_m_s: float | None,
    rest_m_s: float | None,
) -> str:
    if kind == "progress":
        return ""
    judged = [score for score in scores if score.judged]
    best = best_of(judged)
    if best is None or not scores[-1].judged:
        return ""
    if rest_m_s is not None and best.max_abs_error_m_s > MOVES * rest_m_s:
        return ""
    latest = [score.max_abs_error_m_s for score in judged[-BOUND_WINDOW:]]
    enough = len(latest) == BOUND_WINDOW  # one trial near it may be chance
    if floor_m_s is not None and enough and max(latest) <= floor_m_s * band.high:
        what = f"the error of the L2-optimal input ({floor_m_s * 1e3:.1f} mm/s)"
        return f"the last {BOUND_WINDOW} trials are within noise of {what}"
    before, window = judged[:-WINDOW], judged[-WINDOW:]
    if not before:
        return ""
    luckier = _normal((1 - _CONFIDENCE) / WINDOW) / _normal(1 - _CONFIDENCE)
    low, _ = _limits(before, band, luckier)  # the best of the window is one of three
    _, high = _limits(before, band)
    if min(score.max_abs_error_m_s for score in window) < low or _falls(judged, band, high):
        return ""
    if all(score.max_abs_error_m_s > high for score in window):
        return f"the last {WINDOW} trials are worse than noise explains: this law does not learn on"
    if kind in ("worse", "rolled_back"):
        return f"the last {WINDOW} trials brought nothing better, and this one is worse"
    return f"the last {WINDOW} trials brought no progress beyond noise"


def _falls(judged: Sequence[Score], band: NoiseBand, high_m_s: float) -> bool:
    """Whether the last trials go down by their slope, each step lost in the noise. To come down
    from a trial that was worse than noise is no such fall."""
    latest = np.array([score.max_abs_error_m_s for score in judged[-WINDOW - 1 :]])
    latest = np.where(latest > high_m_s, _best_level(judged, band), latest)
    time = np.arange(len(latest)) - (len(latest) - 1) / 2
    sigma = (band.high - band.low) / 2 * _best_level(judged, band) / _normal((1 - _CONFIDENCE) / 2)
    slope = float(time @ latest / (time @ time))
    return slope < -_SLOPE_SIGMAS * sigma / math.sqrt(float(time @ time))


def _advice(scores: Sequence[Score], band: NoiseBand) -> str:
    best = best_of(scores)
    assert best is not None
    recorded = len(repeats_of(scores, best.input_crc))
    restore = "tailbeat trial learn --restore-best"
    if recorded >= _REPEATS_MIN:
        words = f"done: trial {best.trial}'s input was executed {recorded} times, {band.text()}"
        return f"{words}; keep it: {restore}"
    times = "twice" if recorded == 1 else "once more"
    return f"repeat the best {times} to be sure: {restore}, trial run, trial discard --repeat"


def _limits(before: Sequence[Score], band: NoiseBand, wider: float = 1.0) -> tuple[float, float]:
    """Between which max|e| the next trial proves nothing, m/s: the level of the best and the next
    trial both scatter. A law is made to improve: progress is tested one-sided, at 95 %."""
    errors = np.array([score.max_abs_error_m_s for score in before])
    level, trials = _level(errors, band)
    widen = wider * math.sqrt(1 + 1 / trials)
    down, up = band.widths(float(errors.min()))
    one_sided = _normal(1 - _CONFIDENCE) / _normal((1 - _CONFIDENCE) / 2)
    return level - one_sided * widen * down, level + widen * up


def _level(values: F64, band: NoiseBand) -> tuple[float, int]:
    """(max|e| that the best would have again, from how many trials). The best of several is lucky:
    the level is the median of all trials that may be repeats of it by the range they span."""
    ordered = np.sort(values)
    sigma = _sigma(band, float(ordered[0]))
    count = 1
    while count < len(ordered):
        span = _RANGE_SIGMAS[min(count, len(_RANGE_SIGMAS)) - 1] * sigma
        if ordered[count] > ordered[0] + span:
            break
        count += 1
    return float(np.median(ordered[:count])), count


def _sigma(band: NoiseBand, best_m_s: float) -> float:
    return sum(band.widths(best_m_s)) / 2 / _normal((1 - _CONFIDENCE) / 2)


def _best_level(scores: Sequence[Score], band: NoiseBand) -> float:
    judged = [score.max_abs_error_m_s for score in scores if score.judged]
    return _level(np.array(judged), band)[0]


def _repeats(scores: Sequence[Score]) -> list[F64]:
    groups: defaultdict[int, list[float]] = defaultdict(list)
    for score in scores:
        if score.judged:
            groups[score.input_crc].append(score.max_abs_error_m_s)
    return [np.array(values) for values in groups.values() if len(values) > 1]


def _band(low: float, high: float, repeats: int, level_m_s: float) -> NoiseBand:
    return NoiseBand(max(low, _NARROWEST), min(high, _WIDEST), repeats, level_m_s)


def student_t(freedom: float) -> float:
    """Student's t that 95 % stay within: 12.7 for one pair of repeats, 1.96 for many."""
    from scipy.special import stdtrit  # scipy.stats takes four times as long to load

    return float(stdtrit(freedom, (1 + _CONFIDENCE) / 2))


def _normal(tail: float) -> float:
    return -NormalDist().inv_cdf(tail)


def _about(best: Score, band: NoiseBand) -> str:
    return f"{_mm(best)} mm/s, {band.text()}"


def _mm(score: Score) -> str:
    return f"{score.max_abs_error_m_s * 1e3:.1f}"
