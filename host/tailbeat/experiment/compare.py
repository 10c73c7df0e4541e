"""Whether one experiment did better than another: effect with its confidence interval.

Means by Welch's t, which lets the two sides scatter differently; the effect size over the pooled
scatter with its interval by the noncentral t distribution (Hedges 1981; Cumming and Finch 2001),
which is exact for normal scatter also with few trials.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from statistics import fmean

import numpy as np

from tailbeat.core.errors import InputError
from tailbeat.experiment.analysis import Analysis
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.trial_rows import TrialRow
from tailbeat.learning.convergence import assess_all, best_of, student_t

WHAT = {"max": "max_abs_error_m_s", "rms": "rms_error_m_s"}
_SETTINGS = ("fish", "law", "configuration", "operator", "unique_id", "firmware", "simulated")
_LEVEL = 0.95
_POWER = 0.8
_SWIMS_MIN = 2
_REPEATS_MIN = 3
_REPEATS_MAX = 1000


@dataclass(frozen=True)
class Comparison:
    """Of ``what`` (``max``: max|e|, ``rms``) over the trials that count on each side.

    ``difference``: mean of B minus mean of A with its 95 % interval by Welch; ``g``: the same over
    the pooled standard deviation, Hedges's, with the interval of the true effect by the noncentral
    t distribution (infinite when nothing scatters). ``repeats``: trials needed on each side to see
    an effect of that size (power 80 %, two-sided 5 %); None = the effect is too small for 1000.
    ``worse``: how many of the trials were worse than noise explains, on each side (``count``).
    ``words``: one line for people, which does not claim more than the interval allows."""

    what: str
    a_m_s: tuple[float, ...]
    b_m_s: tuple[float, ...]
    difference_m_s: float
    difference_low_m_s: float
    difference_high_m_s: float
    g: float
    g_low: float
    g_high: float
    p: float
    repeats: int | None
    words: str
    worse: tuple[int, int] = (0, 0)


@dataclass(frozen=True)
class Counted:
    """``rows``: the trials that count; ``worse``: how many of those since progress ended had other
    amplitudes than the best and did worse than noise explains, or made the board roll back. They
    count: what was chosen by its result would flatter the law that fluctuates most."""

    rows: list[TrialRow]
    worse: int = 0


def counted(analysis: Analysis, iterations: Sequence[int] | None = None) -> list[float]:
    """max|e| of the trials of ``count``."""
    return [row.max_abs_error_m_s for row in count(analysis, iterations).rows]


def count(analysis: Analysis, iterations: Sequence[int] | None = None) -> Counted:
    """The trials that count, of the last epoch: those of ``iterations``, or by default the repeats
    of the best input, without the trial that made it the best (a lucky one more often than not),
    and where those are fewer than two all complete ones from the iteration on from which the
    assessment saw no more progress. Never discarded, undecided or incomplete ones."""
    pairs = analysis.judged
    if iterations is not None:
        return Counted([row for row, _ in pairs if row.iteration in iterations])
    scores = [score for _, score in pairs]
    best = best_of(scores)
    if best is None:
        return Counted([])
    repeats = [row for row, score in pairs if score.input_crc == best.input_crc]
    if len(repeats) >= _REPEATS_MIN:
        return Counted([row for row in repeats if row.trial != best.trial])
    kinds = [one.kind for one in assess_all(scores, None, None, analysis.start_error_m_s)]
    last = max(at for at, kind in enumerate(kinds) if kind in ("first", "progress"))
    since = [
        (row, (row.rolled_back or kind == "worse") and score.input_crc != best.input_crc)
        for (row, score), kind in zip(pairs, kinds, strict=True)
        if row.iteration >= pairs[last][0].iteration
    ]
    return Counted([row for row, _ in since], sum(worse for _, worse in since))


def compare(
    a: Analysis, b: Analysis, what: str = "max", iterations: Sequence[int] | None = None
) -> Comparison:
    """Raises InputError: another reference, or fewer than two trials on a side, with how many more
    are needed."""
    if what not in WHAT:
        raise InputError(f"there is no '{what}' to compare.", f"Use {' or '.join(WHAT)}.")
    if a.reference_crc != b.reference_crc or a.beat_s != b.beat_s:
        raise InputError(
            f"{a.name} and {b.name} have different references: their errors do not compare.",
            "Compare experiments of one reference.",
        )
    found = [count(one, iterations) for one in (a, b)]
    sides = [[float(getattr(row, WHAT[what])) for row in one.rows] for one in found]
    for one, values in zip((a, b), sides, strict=True):
        _require_enough(one, values, iterations)
    worse = found[0].worse, found[1].worse
    return _compared(what, sides[0], sides[1], (a.name, b.name), worse)


def _require_enough(
    analysis: Analysis, values: Sequence[float], iterations: Sequence[int] | None
) -> None:
    if len(values) >= _SWIMS_MIN:
        return
    of = f" of iterations {', '.join(map(str, iterations))}" if iterations is not None else ""
    more = _SWIMS_MIN - len(values)
    raise InputError(
        f"{analysis.name} has {len(values)} complete trial{'s' * (len(values) != 1)}{of} that "
        f"count{'s' * (len(values) == 1)}; their scatter needs {_SWIMS_MIN}.",
        f"Execute the same input {more} more time{'s' * (more > 1)} (decide: repeat), or name "
        "other iterations.",
    )


def _compared(
    what: str,
    a: Sequence[float],
    b: Sequence[float],
    names: tuple[str, str] = ("A", "B"),
    worse: tuple[int, int] = (0, 0),
) -> Comparison:
    """Of the values alone."""
    difference, low, high, p = welch(a, b)
    effect = hedges(a, b)
    repeats = repeats_needed(effect[0])
    trials = _trials((len(a), len(b)), worse)
    words = _words(what, (difference, low, high), repeats, names, trials)
    sides = tuple(a), tuple(b)
    return Comparison(what, *sides, difference, low, high, *effect, p, repeats, words, worse)


def welch(a: Sequence[float], b: Sequence[float]) -> tuple[float, float, float, float]:
    """(mean of b less mean of a, its 95 % interval, two-sided p); both of two values or more."""
    from scipy.special import stdtr

    difference = fmean(b) - fmean(a)
    parts = [_squares(side) / (len(side) - 1) / len(side) for side in (a, b)]
    error = math.sqrt(sum(parts))
    if error == 0:
        return difference, difference, difference, float(difference == 0)
    freedom = sum(parts) ** 2 / sum(
        part**2 / (len(side) - 1) for part, side in zip(parts, (a, b), strict=True)
    )
    half = error * student_t(freedom)
    p = 2 * float(stdtr(freedom, -abs(difference) / error))
    return difference, difference - half, difference + half, p


def _squares(values: Sequence[float]) -> float:
    """Of the deviations from their mean, added up."""
    mean = fmean(values)
    return math.fsum((value - mean) ** 2 for value in values)


def hedges(a: Sequence[float], b: Sequence[float]) -> tuple[float, float, float]:
    """(g, 95 % interval of the true effect): b less a over the pooled standard deviation."""
    freedom = len(a) + len(b) - 2
    squares = sum(_squares(side) for side in (a, b))
    difference = fmean(b) - fmean(a)
    if squares == 0:
        value = math.copysign(math.inf, difference) if difference else 0.0
        return value, value, value
    d = difference / math.sqrt(squares / freedom)
    scale = math.sqrt(len(a) * len(b) / (len(a) + len(b)))
    tail = (1 - _LEVEL) / 2
    low, high = (_noncentrality(d * scale, freedom, q) for q in (1 - tail, tail))
    return d * _unbiased(freedom), low / scale, high / scale


def _unbiased(freedom: int) -> float:
    """What takes the bias of few values out of d (Hedges 1981): J(m) of the gamma function."""
    return math.exp(
        math.lgamma(freedom / 2) - math.lgamma((freedom - 1) / 2) - math.log(freedom / 2) / 2
    )


def _noncentrality(t_seen: float, freedom: int, level: float) -> float:
    """Of the noncentral t distribution that has ``level`` of its mass below what was seen."""
    from scipy.optimize import brentq

    def above(shift: float) -> float:
        return noncentral_t(t_seen, freedom, shift) - level

    wide = 4 * math.sqrt(1 + t_seen**2 / (2 * freedom))  # about its standard deviation
    low, high = t_seen - wide, t_seen + wide
    while above(low) < 0:  # a small level with few values lies far out
        low -= wide
    while above(high) > 0:
        high += wide
    return float(brentq(above, low, high, xtol=1e-10))


def noncentral_t(limit: float, freedom: int, shift: float) -> float:
    """P(T <= limit) of T = (Z + shift) / S, S the root of chi-squared over ``freedom``."""
    from scipy.special import nctdtr

    found = float(nctdtr(freedom, shift, limit))
    return float(limit > shift) if math.isnan(found) else found  # far out scipy has no number


def repeats_needed(g: float) -> int | None:
    """Trials on each side that see a true effect ``g`` in 80 of 100 cases at 5 %, two-sided; None =
    more than 1000."""
    if math.isinf(g):
        return _SWIMS_MIN
    counts = range(_SWIMS_MIN, _REPEATS_MAX + 1)
    at = len(counts) if math.isnan(g) else bisect_left(counts, _POWER, key=partial(power, g))
    return counts[at] if at < len(counts) else None


def power(g: float, trials: int) -> float:
    """How often ``trials`` on each side show a true effect ``g``."""
    freedom = 2 * trials - 2
    limit = student_t(freedom)
    shift = abs(g) * math.sqrt(trials / 2)
    return 1 - noncentral_t(limit, freedom, shift) + noncentral_t(-limit, freedom, shift)


def _words(
    what: str,
    interval: tuple[float, float, float],
    repeats: int | None,
    names: tuple[str, str],
    trials: str,
) -> str:
    """Errors: less is better."""
    difference, low, high = (value * 1e3 for value in interval)
    name = {"max": "max|e|", "rms": "RMS"}[what]
    a, b = names
    if low > 0 or high < 0:
        side = "worse" if difference > 0 else "better"
        near, far = sorted((abs(low), abs(high)))
        return (
            f"{b} is {abs(difference):.1f} mm/s {side} than {a} in {name}"
            f" (95 %: {near:.1f} to {far:.1f} mm/s; {trials})"
        )
    need = (
        f"an effect of that size takes {repeats} trials on each side to see"
        if repeats is not None
        else f"an effect that small takes more than {_REPEATS_MAX} trials on each side to see"
    )
    middle = f"{abs(difference):.1f} mm/s {'worse' if difference > 0 else 'better'}"
    return (
        f"no difference in {name} is shown: {b} is {middle} than {a}"
        f" (95 %: {abs(low):.1f} better to {abs(high):.1f} worse; {trials}); {need}"
    )


def _trials(trials: tuple[int, int], worse: tuple[int, int]) -> str:
    """How many, and how many of them stand out."""
    of = f", {worse[1]} and {worse[0]} of them worse than noise explains" if any(worse) else ""
    return f"{trials[1]} trials against {trials[0]}{of}"


def other_differences(a: Experiment, b: Experiment) -> list[str]:
    """What else is not the same on both sides: conditions, law, fish, parameters."""
    settings = [one.settings() for one in (a, b)]
    sides: list[dict[str, object]] = []
    for one in settings:
        flat = {key: one.get(key) for key in _SETTINGS}
        sides.append({**flat, **one.get("conditions", {}), **one.get("params", {})})
    names = dict.fromkeys([*sides[0], *sides[1]])
    return [
        f"{name} {_text(sides[0].get(name))} against {_text(sides[1].get(name))}"
        for name in names
        if sides[0].get(name) != sides[1].get(name)
    ]


def _text(value: object) -> str:
    """A number with the digits that tell it from its neighbours as a board holds them."""
    if isinstance(value, float):
        return np.format_float_positional(np.float32(value), trim="-")
    return "unknown" if value is None else str(value)
