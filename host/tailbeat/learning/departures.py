"""How the trials of a series depart from what was known of the fish before them.

The speeds of all compared trials, less those expected, are weighed at once. An explanation says
how they vary together, which gives them a density; sizes that nobody knows beforehand are tried on
a grid. What comes again at the same amplitudes is the model's fault, what each trial has alone is
the water's, one gain and one flow from some trial on are the fish's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Literal

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.parallel import one_thread
from tailbeat.learning.belief import Belief
from tailbeat.learning.fish_model import NUMBERS, TrialSpeeds
from tailbeat.learning.prediction import (
    CHANGED_FLOW_M_S,
    CHANGED_GAIN,
    OTHER,
    SPOILT_FLOW_M_S,
    SPOILT_GAIN,
)
from tailbeat.learning.scatter import STD_ABS
from tailbeat.learning.slopes import speed_and_slopes

Kind = Literal["changed", "misfit", "disturbed"]

# How likely what each trial has alone, and what the model misses, is so many times the expected.
_OWN = {0.12: 0.1, 0.2: 0.12, 0.35: 0.18, 0.6: 0.2, 1.0: 0.15, 1.5: 0.1, 2.2: 0.07, 3.5: 0.05,
        6.0: 0.03}  # fmt: skip
_MISSED = {0.2: 0.1, 0.35: 0.1, 0.6: 0.3, 1.0: 0.3, 1.5: 0.08, 2.5: 0.06, 5.0: 0.06}
_DISTURBED, _MISFIT = 2.0, 1.5  # times the expected, from which on it is called so
# Likewise of everything else that may be so; of a change or a spoilt trial, any trial alike.
_USUAL, _OTHER, _MAP, _SPOILT, _CHANGED = 0.6, 0.05, 0.05, 0.08, 0.22
_AGREE = 2  # so many trials tell a change from a spoilt one
# Another map from amplitude to thrust: a smooth curve with this standard deviation and reach.
_MAP_PART, _MAP_REACH_RAD = 0.1, 0.15
_MAP_RAD = np.arange(0.1, 1.3, _MAP_REACH_RAD)

_COUNT = len(NUMBERS)
_FLOW, _GAIN = _COUNT + 1, _COUNT + 2  # columns of the slopes


@dataclass(frozen=True)
class Departure:
    """``chance``: its probability. ``effect_m_s``: the largest on a beat, with its sign: of a
    change in the last trial, of a misfit on average; of a disturbance the RMS over the trials.
    ``since``: index of the trial that a change begins with. ``best``: of the one whose error is
    smallest without what does not come again."""

    kind: Kind
    chance: float
    effect_m_s: float
    since: int
    best: int


def departures(
    before: Belief, trials: Sequence[TrialSpeeds], wanted_m_s: F64
) -> dict[Kind, Departure]:
    """How trials depart from a belief.

    Parameters
    ----------
    before : Belief
        Without these trials.
    trials : sequence of TrialSpeeds
        At least one, oldest first, of one reference, all with some speed.
    wanted_m_s : ndarray, shape (beats,)
        The reference.

    Returns
    -------
    dict
        Every kind with its probability; more than one may be so. Costs 30 ms for three trials of
        40 beats, 0.1 s for six.
    """
    with one_thread():  # more spend most of their time waiting for each other: 10 times as much
        stack = _Stack(before, trials)
        rows = list(_weighed(stack, list(_explanations(stack))))
        likely = np.exp(np.array([row.log_chance for row in rows]))
        likely /= likely.sum()
        return {kind: _departure(kind, stack, rows, likely, wanted_m_s) for kind in _SAYS}


def _departure(
    kind: Kind, stack: _Stack, rows: Sequence[_Row], likely: F64, wanted_m_s: F64
) -> Departure:
    chances = np.array([_SAYS[kind](row) for row in rows]) * likely
    row = rows[int(np.argmax(chances))]
    parts = _parts(stack, row)
    effect, best = _EFFECT[kind](stack, parts), _best(stack, parts, wanted_m_s)
    return Departure(kind, float(chances.sum()), effect, row.explanation.since, best)


class _Stack:
    """Trials on top of each other, the measured beats only."""

    def __init__(self, before: Belief, trials: Sequence[TrialSpeeds]) -> None:
        self.before, self.trials = before, trials
        rows = [speed_and_slopes(before.model, one, before.typical) for one in trials]
        self._seen = np.concatenate([one.measured for one in trials])
        miss = [one.speed_m_s - mean for one, (mean, _) in zip(trials, rows, strict=True)]
        self.miss_m_s = np.concatenate(miss)[self._seen]
        self.speed_m_s = np.concatenate([one.speed_m_s for one in trials])[self._seen]
        self.slopes = np.vstack([by for _, by in rows])[self._seen]
        self.trial = np.repeat(np.arange(len(trials)), [one.beats for one in trials])[self._seen]
        self.beat = np.concatenate([np.arange(one.beats) for one in trials])[self._seen]

    @cached_property
    def known(self) -> F64:
        """Covariance of what the numbers, the day and the measurement do."""
        numbers, gain = self.slopes[:, :_COUNT], self.slopes[:, _GAIN]
        sigma = np.concatenate([one.sigma_m_s for one in self.trials])[self._seen]
        found: F64 = numbers @ self.before.covariance @ numbers.T + np.diag(sigma**2)
        found += self.before.level()[1] * np.outer(gain, gain)
        return found

    @cached_property
    def own(self) -> F64:
        """Covariance of what each trial has alone."""
        scatter, one = self.before.scatter, self.trials[0]
        differ = [STD_ABS * scatter.start_m_s, scatter.flow_m_s, scatter.gain]
        shared = self.slopes[:, _COUNT:] * differ
        moving = scatter.moving(one.beats, one.beat_s)[np.ix_(self.beat, self.beat)]
        same = np.equal.outer(self.trial, self.trial)
        alone = np.diag(np.full(len(same), scatter.model_m_s**2))
        found: F64 = same * (shared @ shared.T + moving) + alone
        return found

    @cached_property
    def missed(self) -> F64:
        """Covariance of what the model leaves out and comes again."""
        every = self.before.left_out([one.amplitude_rad for one in self.trials])
        found: F64 = every[np.ix_(self._seen, self._seen)]
        return found

    @cached_property
    def map(self) -> F64:
        """What other thrusts around some amplitudes do, shape (beats, amplitudes)."""
        model, rows = self.before.model, []
        for one in self.trials:
            thrust = model.thrust(one.amplitude_rad)
            _, by_thrust, _ = model.distance(thrust, one.beat_s, slopes=True)
            assert by_thrust is not None
            by_part = np.diff(by_thrust, axis=0) / one.beat_s * 2 * thrust
            near = np.subtract.outer(one.amplitude_rad, _MAP_RAD) / _MAP_REACH_RAD
            rows.append(_MAP_PART * by_part @ np.exp(-0.5 * near**2))
        found: F64 = np.vstack(rows)[self._seen]
        return found

    def conditions(self, trials: Iterable[int], flow_m_s: float, gain: float) -> F64:
        """What one flow and one gain in some trials do, shape (beats, 2)."""
        found: F64 = self.slopes[:, [_FLOW, _GAIN]] * [flow_m_s, gain]
        return found * np.isin(self.trial, list(trials))[:, None]


@dataclass(frozen=True)
class _Explanation:
    """``directions``: what one standard deviation of each of its reasons does, shape (beats,
    reasons); they come beside what is usual."""

    what: Literal["usual", "misfit", "spoilt", "changed"]
    chance: float
    directions: F64
    since: int = 0


def _explanations(stack: _Stack) -> Iterator[_Explanation]:
    count = len(stack.trials)
    every = stack.conditions(range(count), CHANGED_FLOW_M_S, CHANGED_GAIN)
    other = np.hstack([every, stack.slopes[:, :_COUNT] * OTHER])
    yield _Explanation("usual", _USUAL, np.zeros((len(stack.miss_m_s), 0)))
    yield _Explanation("misfit", _OTHER, other)
    yield _Explanation("misfit", _MAP, stack.map)
    for at in range(count):
        spoilt = stack.conditions([at], SPOILT_FLOW_M_S, SPOILT_GAIN)
        yield _Explanation("spoilt", _SPOILT / count, spoilt, at)
    for since in range(1, count - _AGREE + 1):
        changed = stack.conditions(range(since, count), CHANGED_FLOW_M_S, CHANGED_GAIN)
        yield _Explanation("changed", _CHANGED / (count - _AGREE), changed, since)


@dataclass(frozen=True)
class _Row:
    """An explanation with sizes, as times the expected."""

    own: float
    missed: float
    explanation: _Explanation
    log_chance: float


def _weighed(stack: _Stack, explanations: Sequence[_Explanation]) -> Iterator[_Row]:
    """With the likeliest at 0."""
    found = []
    for own, missed in product(_OWN, _MISSED):
        prior = np.log(_OWN[own] * _MISSED[missed])
        logs = _log_densities(_covariance(stack, own, missed), stack.miss_m_s, explanations)
        rows = zip(explanations, logs, strict=True)
        found += [(own, missed, one, prior + np.log(one.chance) + log) for one, log in rows]
    most = max(row[-1] for row in found)
    return (_Row(own, missed, one, float(log - most)) for own, missed, one, log in found)


def _covariance(stack: _Stack, own: float, missed: float) -> F64:
    found: F64 = stack.known + own**2 * stack.own + missed**2 * stack.missed
    return found


def _log_densities(
    covariance: F64, miss_m_s: F64, explanations: Sequence[_Explanation]
) -> Iterator[float]:
    """Of each explanation, by one factorization of what is usual: directions are few."""
    from scipy.linalg import solve_triangular

    root = np.linalg.cholesky(covariance)
    target = np.column_stack([miss_m_s, *(one.directions for one in explanations)])
    white = solve_triangular(root, target, lower=True, check_finite=False)
    miss, at = white[:, 0], 1
    usual = -0.5 * float(miss @ miss) - float(np.log(np.diag(root)).sum())
    for one in explanations:
        width = one.directions.shape[1]
        part = white[:, at : at + width]
        at += width
        inner, seen = np.eye(width) + part.T @ part, part.T @ miss
        more = float(seen @ np.linalg.solve(inner, seen)) - float(np.linalg.slogdet(inner)[1])
        yield usual + 0.5 * more


def _says_changed(row: _Row) -> bool:
    return row.explanation.what == "changed"


def _says_misfit(row: _Row) -> bool:
    return row.missed >= _MISFIT or row.explanation.what == "misfit"


def _says_disturbed(row: _Row) -> bool:
    return row.own >= _DISTURBED


_SAYS: dict[Kind, Callable[[_Row], bool]] = {
    "changed": _says_changed,
    "misfit": _says_misfit,
    "disturbed": _says_disturbed,
}


@dataclass(frozen=True)
class _Parts:
    """What a row makes of the speeds less the expected, m/s, all beats: by a change, what comes
    again, what does not."""

    changed: F64
    again: F64
    own: F64


def _parts(stack: _Stack, row: _Row) -> _Parts:
    directions = row.explanation.directions
    covariance = _covariance(stack, row.own, row.missed) + directions @ directions.T
    weights = np.linalg.solve(covariance, stack.miss_m_s)
    along, what = directions @ (directions.T @ weights), row.explanation.what
    return _Parts(
        along * (what == "changed"),
        row.missed**2 * stack.missed @ weights + along * (what == "misfit"),
        row.own**2 * stack.own @ weights + along * (what == "spoilt"),
    )


def _best(stack: _Stack, parts: _Parts, wanted_m_s: F64) -> int:
    speeds = stack.speed_m_s - parts.own
    error = np.abs(wanted_m_s[stack.beat] - speeds)
    return int(np.argmin([error[stack.trial == at].max() for at in range(len(stack.trials))]))


def _by_beat(stack: _Stack, values: F64) -> F64:
    """Means over the trials."""
    total = np.bincount(stack.beat, values)
    found: F64 = total / np.maximum(np.bincount(stack.beat), 1)
    return found


def _largest(values: F64) -> float:
    return float(values[np.argmax(np.abs(values))])


def _effect_of_change(stack: _Stack, parts: _Parts) -> float:
    return _largest(parts.changed[stack.trial == stack.trial[-1]])


def _effect_of_misfit(stack: _Stack, parts: _Parts) -> float:
    return _largest(_by_beat(stack, parts.again))


def _effect_of_disturbance(stack: _Stack, parts: _Parts) -> float:
    return float(np.sqrt(_by_beat(stack, parts.own**2).max()))


_EFFECT: dict[Kind, Callable[[_Stack, _Parts], float]] = {
    "changed": _effect_of_change,
    "misfit": _effect_of_misfit,
    "disturbed": _effect_of_disturbance,
}
