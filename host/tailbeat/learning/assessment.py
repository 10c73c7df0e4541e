"""How the gain should fall along the iterations: noise learned at full gain stays in the input.

A law that corrects a part a of each trial's error leaves, in the end, a variance of a*r/(2 - a)
where r is the variance of what does not repeat. The Kalman filter along the iterations has the best
sequence: K = P/(P + r), P := (1 - K)*P, so that 1/K grows by 1 with each trial (Saab's gain ~ 1/k).
The board approximates it: the gain is divided by 1 + ILC_DECR_RATE*max(0, visits - ILC_DECR_FROM).

A series of trials of one reference, judged: what each proved, when to stop, what to change.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.reference import Reference
from tailbeat.core.trial_checks import heading_drift
from tailbeat.core.trial_file import Trial
from tailbeat.learning.convergence import (
    Assessment,
    NoiseBand,
    Score,
    assess_all,
    best_of,
    comparable,
    expected_band,
    score_of,
)
from tailbeat.learning.fish_model import trial_speeds
from tailbeat.learning.identification import Identified
from tailbeat.learning.model_law import swim_crc
from tailbeat.learning.planner import plan
from tailbeat.learning.saturation import Saturation, saturation_of

FLUCTUATION_MAX = 1.3  # times the noise of repeats
_SETTLED_MIN = 4  # trials
_FADE_MAX = 10.0
_FROM_MAX = 255
_INTERVAL_SIGMAS = 2 * 1.96


@dataclass(frozen=True)
class GainSchedule:
    """``fade``, ``fade_from``: for ILC_DECR_RATE and ILC_DECR_FROM. ``kalman``, ``board``: shape
    (trials,), what the gain is multiplied by at each visit of a beat, by the Kalman filter and by
    the board."""

    fade: float
    fade_from: int
    kalman: F64
    board: F64


def gain_schedule(
    noise_variance: float,
    start_variance: float,
    step: float = 1.0,
    walk_variance: float = 0.0,
    settled_after: int = 0,
    trials: int = 20,
) -> GainSchedule:
    """ILC_DECR_RATE and ILC_DECR_FROM that come nearest to the Kalman filter's gains.

    Variances of a beat's error, (m/s)**2: ``noise_variance`` of what differs between repeats,
    ``start_variance`` of what is to be learned, ``walk_variance`` of how that wanders from trial to
    trial. ``step``: the part of the error that the law takes out at full gain, 0 to 1; the gain
    never rises. ``settled_after``: trials that the full gain is known to need, because of the dead
    zone or of limits. Raises InputError for variances below 0, or no noise.
    """
    if not (noise_variance > 0 and start_variance >= 0 and walk_variance >= 0 and 0 < step <= 1):
        raise InputError(
            "the variances for the gain's sequence make no sense.",
            "Give a noise above 0, nothing below 0, and a step in (0, 1].",
        )
    kalman = np.ones(trials)
    p = start_variance
    for k in range(trials):
        if k >= settled_after:
            kalman[k] = min(1.0, p / (p + noise_variance) / step)
        gain = kalman[k] * step
        p = (1 - gain) ** 2 * p + gain**2 * noise_variance + walk_variance
    falls = np.flatnonzero(kalman < 1.0)
    start = int(falls[0]) - 1 if falls.size else trials - 1
    fade_from = min(max(start, 0), _FROM_MAX)
    beyond = np.maximum(0, np.arange(trials) - fade_from)
    fade = _nearest(kalman, beyond)
    return GainSchedule(fade, fade_from, kalman, 1 / (1 + fade * beyond))


def fluctuation(scores: Sequence[Score], band: NoiseBand) -> float | None:
    """Scatter of max|e| since the series settled, over that of repeats; None before four trials
    have. Settled: from the first judged trial that noise does not tell from the best."""
    scores = comparable(scores)
    best = best_of(scores)
    at = settled_after(scores, band)
    if best is None or at is None:
        return None
    settled = [score.max_abs_error_m_s for score in scores[at:] if score.judged]
    if len(settled) < _SETTLED_MIN:
        return None
    noise = sum(band.widths(best.max_abs_error_m_s))
    return float(np.std(settled, ddof=1)) / (noise / _INTERVAL_SIGMAS)


def settled_after(scores: Sequence[Score], band: NoiseBand) -> int | None:
    """Index of the first judged trial within noise of the best; None = none is judged."""
    scores = comparable(scores)
    best = best_of(scores)
    if best is None:
        return None
    _, up = band.widths(best.max_abs_error_m_s)
    limit = best.max_abs_error_m_s + math.sqrt(2) * up
    return next(
        at for at, score in enumerate(scores) if score.judged and score.max_abs_error_m_s <= limit
    )


def repeat_variance(scores: Sequence[Score]) -> float | None:
    """Variance of a beat's error between repeats, mean over beats, (m/s)**2; None without any."""
    groups: dict[int, list[F64]] = {}
    for score in scores:
        if score.judged:
            groups.setdefault(score.input_crc, []).append(score.error_m_s.astype(np.float64))
    repeats = [np.array(group) for group in groups.values() if len(group) > 1]
    if not repeats:
        return None
    found = [_scatter(group) for group in repeats]
    freedom = sum(count for _, count in found)
    return sum(squares for squares, _ in found) / freedom if freedom else None


def _scatter(group: F64) -> tuple[float, int]:
    """(sum of squares about each beat's mean, degrees of freedom) of repeats; NaN = no speed."""
    known = np.isfinite(group)
    times = known.sum(axis=0)
    mean = np.where(known, group, 0.0).sum(axis=0) / np.maximum(times, 1)
    squares = np.where(known, group - mean, 0.0) ** 2
    return float(squares.sum()), int(np.maximum(times - 1, 0).sum())


def _nearest(kalman: F64, beyond: NDArray[np.int64]) -> float:
    from scipy.optimize import minimize_scalar

    if not beyond.any():
        return 0.0

    def misfit(fade: float) -> float:
        return float(np.sum((1 / (1 + fade * beyond) - kalman) ** 2))

    found = minimize_scalar(misfit, bounds=(0.0, _FADE_MAX), method="bounded")
    return round(float(found.x), 3)


REPEAT_SIGMA_M_S = 0.002  # of a beat's error between repeats, on the tank plant
_SLOPE_M_S_RAD = 0.219  # of the line through the thesis's Table 8.1
_WALK_PART = 0.05  # of the noise's variance: what is to be learned wanders by that much each trial
_STEP_MIN = 0.05
_BY_THE_LAW = ("law", "first", "restored", "")  # what made a trial's amplitudes; "" = not told


def rollback_words() -> str:
    """That the board went back to its best input by itself. Every place that shows what was learned
    says it with these words."""
    return "ROLLED BACK: worse twice in a row, so the best input is next"


@dataclass(frozen=True)
class Row:
    """One trial. ``repeat_of``: the first trial with the same amplitudes, 0 = this is the first."""

    trial: int
    iteration: int
    end: str
    max_abs_error_m_s: float
    rms_error_m_s: float
    repeat_of: int
    verdict: str
    words: str


@dataclass(frozen=True)
class Progress:
    """``verdict``: on the last trial. ``visits``: shape (beats,). ``floor_m_s``: max|e| of the best
    input by least squares, where the fish is identified. ``fluctuation``: of max|e| since the
    series settled, over the noise of repeats. ``fade``: given when that is too much, and not
    because of saturation."""

    reference_crc: int
    rows: list[Row]
    verdict: Assessment
    visits: NDArray[np.int64]
    floor_m_s: float | None = None
    fluctuation: float | None = None
    fade: GainSchedule | None = None
    problems: list[str] = field(default_factory=list)


def progress_of(
    trials: Sequence[Trial],
    reference_crc: int | None = None,
    identified: Identified | None = None,
    problems: Sequence[str] = (),
    rolled_back: bool = False,
) -> Progress:
    """``trials``, ``reference_crc``: as for ``series_of``.
    ``rolled_back``: the board said so of the last trial. Raises InputError when there is none."""
    series = series_of(trials, reference_crc, identified)
    scores = scores_of(series)
    scores[-1] = replace(scores[-1], rolled_back=rolled_back)
    expected, floor_m_s = _by_the_model(series, scores, identified)
    crc = series[-1].reference_crc
    rest_m_s = float(np.nanmax(series[-1].beats.reference_m_s))
    verdicts = assess_all(scores, expected, floor_m_s, rest_m_s)
    last = _with_saturation(verdicts[-1], saturation_of(series[-1], identified, trials))
    band = last.band
    found = fluctuation(scores, band)
    return Progress(
        reference_crc=crc,
        rows=_rows(series, scores, verdicts),
        verdict=last,
        visits=visits(series),
        floor_m_s=floor_m_s,
        fluctuation=found,
        fade=_fade(series, scores, last, found, identified) if last.saturation is None else None,
        problems=[*problems, *_crooked(series)],
    )


def visits(trials: Sequence[Trial]) -> NDArray[np.int64]:
    """How many trials swam and measured each beat; as long as the longest trial."""
    count = np.zeros(max((len(t.beats.samples) for t in trials), default=0), np.int64)
    for trial in trials:
        recorded = np.arange(len(trial.beats.samples)) < trial.executed_beats
        count[: len(recorded)] += recorded & np.isfinite(trial.beats.error_m_s)
    return count


def _with_saturation(verdict: Assessment, saturation: Saturation | None) -> Assessment:
    """A series that the amplitude limit holds back has not converged to the reference."""
    if saturation is None or not verdict.stop:
        return replace(verdict, saturation=saturation)
    reason = f"{verdict.stop_reason}, but saturated: {saturation.words}"
    return replace(verdict, saturation=saturation, stop_reason=reason, advice=saturation.action)


def _crooked(series: Sequence[Trial]) -> list[str]:
    """A line for each trial that was not executed straight: its errors are not of the wanted
    way."""
    found = [(trial.number, heading_drift(trial)) for trial in series]
    return [f"trial {number}: {one.text()}" for number, one in found if one and one.crooked]


def series_of(
    trials: Sequence[Trial], reference_crc: int | None = None, identified: Identified | None = None
) -> list[Trial]:
    """The last series of a reference (default: of the last trial's), without the runs that the fish
    was identified by. ``trials``: oldest first, of any references. Raises InputError when there is
    none.

    A series begins anew where the iteration falls back, or does not go on after a trial of another
    reference (the board began from nothing), and with another AMP_MAX_RAD (another largest
    amplitude is another task).
    """
    recorded = _without_runs(trials, identified)
    if not recorded:
        raise InputError("there are no trials to judge.", "Swim one: tailbeat trial run")
    crc = recorded[-1].reference_crc if reference_crc is None else reference_crc
    series: list[Trial] = []
    between = False
    for trial in recorded:
        if trial.reference_crc != crc:
            between = True
            continue
        if series and _begins_anew(series[-1], trial, between):
            series = []
        series.append(trial)
        between = False
    if not series:
        known = sorted({f"{trial.reference_crc:#010x}" for trial in recorded})
        raise InputError(
            f"there is no trial of the reference {crc:#010x}.", f"There are {', '.join(known)}."
        )
    return series


def _begins_anew(before: Trial, trial: Trial, between: bool) -> bool:
    limits = [one.params.get("AMP_MAX_RAD") for one in (before, trial)]
    back = trial.iteration <= before.iteration if between else trial.iteration < before.iteration
    return back or limits[0] != limits[1]


def _without_runs(trials: Sequence[Trial], identified: Identified | None) -> list[Trial]:
    """Earlier identifications are marked in the trial library; a folder's files are not."""
    if identified is None or identified.source != "runs":
        return list(trials)

    runs = {swim_crc(one) for one in identified.trials}
    return [trial for trial in trials if swim_crc(trial_speeds(trial)) not in runs]


def scores_of(series: Sequence[Trial]) -> list[Score]:
    """Of trials of one reference. A trial after which the best input so far was executed again, and
    which exceeded ROLLBACK_RATIO times the best, was rolled back."""
    scores: list[Score] = []
    for at, trial in enumerate(series):
        score = score_of(trial)
        best = best_of(scores)
        ratio = trial.params.get("ROLLBACK_RATIO", 0.0)
        if best is not None and ratio > 0 and at + 1 < len(series):
            worse = score.max_abs_error_m_s > ratio * best.max_abs_error_m_s
            restored = score_of(series[at + 1]).input_crc == best.input_crc
            if worse and restored and score.input_crc != best.input_crc:
                score = score_of(trial, rolled_back=True)
        scores.append(score)
    return scores


def _rows(series: Sequence[Trial], scores: list[Score], verdicts: list[Assessment]) -> list[Row]:
    first: dict[int, int] = {}
    rows = []
    for trial, score, verdict in zip(series, scores, verdicts, strict=True):
        original = first.setdefault(score.input_crc, trial.number)
        rows.append(
            Row(
                trial=trial.number,
                iteration=trial.iteration,
                end=trial.end,
                max_abs_error_m_s=score.max_abs_error_m_s,
                rms_error_m_s=trial.rms_error_m_s(),
                repeat_of=original if original != trial.number else 0,
                verdict=verdict.kind,
                words=verdict.words,
            )
        )
    return rows


def _by_the_model(
    series: Sequence[Trial], scores: list[Score], identified: Identified | None
) -> tuple[Callable[[Score], NoiseBand] | None, float | None]:
    """(noise band of a trial's input, least-squares error bound) of an identified fish."""
    best = best_of(scores)
    if identified is None or best is None:
        return None, None

    trial = next(t for t, s in zip(series, scores, strict=True) if s is best)
    wanted = Reference(trial.beat_s, trial.beats.reference_m_s, f"{trial.reference_crc:#010x}")
    limit = trial.params.get("AMP_MAX_RAD", math.pi / 4)
    bound_m_s = plan(identified.model, wanted.speed_m_s, wanted.beat_s, limit).max_abs_error_m_s

    def expected(score: Score) -> NoiseBand:
        recorded = next(t for t, s in zip(series, scores, strict=True) if s is score)
        return expected_band(identified, wanted, recorded.beats.applied_rad)

    return expected, bound_m_s


def _fade(
    series: Sequence[Trial],
    scores: list[Score],
    verdict: Assessment,
    found: float | None,
    identified: Identified | None,
) -> GainSchedule | None:
    """None also where the gain is not what made the trials fluctuate: amplitudes that the host
    uploaded, or a fish that just did worse than noise explains."""
    settled = settled_after(scores, verdict.band)
    last = series[-1]
    of_the_law = all(trial.input in _BY_THE_LAW for trial in series[settled or 0 :])
    if not of_the_law or verdict.kind in ("worse", "rolled_back"):
        return None
    if found is None or found <= FLUCTUATION_MAX or settled is None:
        return None
    if last.params.get("ILC_DECR_RATE", 0.0) > 0:
        return None
    first = next(score for score in scores if score.judged)
    noise = repeat_variance(scores) or REPEAT_SIGMA_M_S**2
    slope = identified.model.slope_m_s_rad if identified else _SLOPE_M_S_RAD
    step = min(max(last.params.get("ILC_GAIN", 4.0) * slope, _STEP_MIN), 1.0)
    start = float(np.nanmean(first.error_m_s.astype(np.float64) ** 2))
    return gain_schedule(noise, start, step, _WALK_PART * noise, settled)
