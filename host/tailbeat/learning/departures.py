"""How the trials of a series depart from what was known of the fish before them.

The speeds of all compared trials, less those expected, are weighed at once. An explanation says
how they vary together, which gives them a density; sizes that nobody knows beforehand are tried on
a grid. What comes again at the same amplitudes is the model's fault, what each trial has alone is
the water's, one gain from some trial on, at times with a flow, is the fish's. How much trials
differ as a whole and how much the water moves within them are two sizes: a fish that is placed with
care shows a change even where the water moves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

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
from tailbeat.learning.scatter import STD_ABS, WALK
from tailbeat.learning.slopes import speed_and_slopes

Kind = Literal["changed", "misfit", "disturbed"]

# Times the expected: what the model misses, what moves within a trial, what whole trials differ by.
_MISSED = np.array([0.2, 0.35, 0.6, 1.0, 1.5, 2.5, 5.0])
_MOVES = np.array([0.4, 0.7, 1.0, 1.4, 1.9, 2.6, 3.6, 6.0])
_DIFFER = np.array([0.2, 0.4, 0.7, 1.1, 1.7, 2.6, 4.2])
_MISSED_CHANCE = np.array([0.1, 0.1, 0.3, 0.3, 0.08, 0.06, 0.06])
_MOVES_CHANCE = np.exp(-0.5 * (np.log(_MOVES) / 0.7) ** 2)
_DIFFER_CHANCE = np.exp(-0.5 * (np.log(_DIFFER / 0.8) / 0.6) ** 2)
_MISFIT = 1.5  # times the expected, from which on it is called so
# Likewise of what a trial has alone: of both sizes, or of what whole trials differ by. Few trials
# tell little of that: together it counts less.
_DISTURBED, _DIFFER_POWER, _DIFFERENT = 1.9, 0.3, 2.5
_BOTH = np.multiply.outer(_MOVES, _DIFFER**_DIFFER_POWER)
_SHAKEN = (_BOTH >= _DISTURBED) | (_DIFFER >= _DIFFERENT)
# How likely everything else is, in parts; of a change or a spoilt trial, any trial alike.
_USUAL, _OTHER, _MAP, _SPOILT, _CHANGED = 0.6, 0.05, 0.05, 0.08, 0.4
_AGREE = 2  # so many trials tell a change from a spoilt one
# Part of the changes that bring another flow, too. Battery, fin and ballast change the thrust
# alone, and what is looked for in fewer ways is found by chance less often.
_FLOW_TOO = 0.2
# Another map from amplitude to thrust: a smooth curve with this standard deviation and reach.
_MAP_PART, _MAP_REACH_RAD = 0.1, 0.15
_MAP_RAD = np.arange(0.1, 1.3, _MAP_REACH_RAD)

_COUNT = len(NUMBERS)
_FLOW, _GAIN = _COUNT + 1, _COUNT + 2  # columns of the slopes


@dataclass(frozen=True)
class Departure:
    """``chance``: its probability. ``effect_m_s``: the largest on a beat, with its sign: of a
    change in the last trial, of a misfit on average; of a disturbance the RMS over the trials.
    ``since``: index of the first trial that shows it: the one that a change begins with, else 0.
    ``best``: of the one whose error is smallest without what does not come again."""

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
        Every kind with its probability; more than one may be so. Costs 25 ms for three trials of
        40 beats, 80 ms for six.
    """
    with one_thread():  # more spend most of their time waiting for each other: 10 times as much
        stack = _Stack(before, trials)
        explanations = list(_explanations(stack))
        likely = _weighed(stack, explanations)
        found: dict[Kind, Departure] = {}
        for kind, says in _SAYS.items():
            chances = likely * says(explanations)
            *sizes, which = np.unravel_index(int(np.argmax(chances)), chances.shape)
            one = explanations[int(which)]
            parts = _parts(stack, one, *map(int, sizes))
            effect, best = _EFFECT[kind](stack, parts), _best(stack, parts, wanted_m_s)
            since = one.since if kind == "changed" else 0
            found[kind] = Departure(kind, float(chances.sum()), effect, since, best)
        return found


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
        walk = self.before.level()[1] + WALK**2 * np.minimum.outer(self.trial, self.trial)
        day = walk * np.outer(gain, gain)
        return np.asarray(numbers @ self.before.covariance @ numbers.T + day + np.diag(sigma**2))

    @cached_property
    def differ(self) -> F64:
        """What one standard deviation of what whole trials differ by does, (beats, 3 x trials)."""
        scatter = self.before.scatter
        sigma = [STD_ABS * scatter.start_m_s, scatter.flow_m_s, scatter.gain]
        shared = self.slopes[:, _COUNT:] * sigma
        return np.hstack([shared * (self.trial == at)[:, None] for at in range(len(self.trials))])

    @cached_property
    def moving(self) -> F64:
        """Covariance of what moves within each trial, and of each beat alone."""
        scatter, one = self.before.scatter, self.trials[0]
        moving = scatter.moving(one.beats, one.beat_s)[np.ix_(self.beat, self.beat)]
        same = np.equal.outer(self.trial, self.trial)
        found: F64 = same * moving + np.diag(np.full(len(same), scatter.model_m_s**2))
        return found

    @cached_property
    def missed(self) -> F64:
        """Covariance of what the model leaves out and comes again."""
        every = self.before.left_out([one.amplitude_rad for one in self.trials])
        return np.asarray(every[np.ix_(self._seen, self._seen)])

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
        yield _Explanation("spoilt", _SPOILT / count, spoilt)
    for since in range(1, count - _AGREE + 1):
        both = stack.conditions(range(since, count), CHANGED_FLOW_M_S, CHANGED_GAIN)
        for part, directions in ((_FLOW_TOO, both), (1 - _FLOW_TOO, both[:, 1:])):
            yield _Explanation("changed", part * _CHANGED / (count - _AGREE), directions, since)


def _weighed(stack: _Stack, explanations: Sequence[_Explanation]) -> F64:
    """Probability of sizes and explanation, (missed, moves, differ, explanations)."""
    every = [stack.differ, stack.miss_m_s[:, None], *(one.directions for one in explanations)]
    target = np.hstack(every)
    white = [_whitened(stack, missed, moves, target) for missed in _MISSED for moves in _MOVES]
    products = np.reshape([one for one, _ in white], (len(_MISSED), -1, 1, *white[0][0].shape))
    log_det = np.reshape([one for _, one in white], (len(_MISSED), -1, 1, 1))
    left, more = _with_differing(products, stack.differ.shape[1])
    found = _log_densities(left, explanations) - 0.5 * (log_det + more[..., None])
    found += np.log([one.chance for one in explanations])
    sizes = np.multiply.outer(_MOVES_CHANCE, _DIFFER_CHANCE)
    found += np.log(np.multiply.outer(_MISSED_CHANCE, sizes))[..., None]
    likely = np.exp(found - found.max())
    return np.asarray(likely / likely.sum())


def _whitened(stack: _Stack, missed: float, moves: float, target: F64) -> tuple[F64, float]:
    """(products of the columns in units of the covariance, log of its determinant)."""
    from scipy.linalg import solve_triangular

    covariance = stack.known + moves**2 * stack.moving + missed**2 * stack.missed
    root = np.linalg.cholesky(covariance)
    white = solve_triangular(root, target, lower=True, check_finite=False)
    return white.T @ white, 2 * float(np.log(np.diag(root)).sum())


def _with_differing(products: F64, count: int) -> tuple[F64, F64]:
    """Products of the columns from ``count`` on, and what the determinant's log grows by, once the
    columns before them vary by each size: the matrix determinant lemma."""
    size = np.square(_DIFFER)[:, None, None]
    inner = np.eye(count) + size * products[..., :count, :count]
    across = products[..., :count, count:]
    known = np.swapaxes(across, -1, -2) @ np.linalg.solve(inner, across)
    return products[..., count:, count:] - size * known, np.linalg.slogdet(inner)[1]


def _log_densities(products: F64, explanations: Sequence[_Explanation]) -> F64:
    """Of each explanation, last; but for what is the same of all. ``products``: of the misses
    first."""
    found, at = [], 1
    for one in explanations:
        here = slice(at, at := at + one.directions.shape[1])
        inner = np.eye(here.stop - here.start) + products[..., here, here]
        seen = products[..., here, :1]
        by = (seen * np.linalg.solve(inner, seen)).sum(axis=(-1, -2))
        found.append(0.5 * (by - np.linalg.slogdet(inner)[1] - products[..., 0, 0]))
    return np.stack(found, axis=-1)


def _is(what: str, explanations: Sequence[_Explanation]) -> NDArray[np.bool_]:
    return np.array([one.what == what for one in explanations])


_SAYS: dict[Kind, Callable[[Sequence[_Explanation]], NDArray[np.bool_]]] = {
    "changed": lambda every: _is("changed", every),
    "misfit": lambda every: (_MISSED >= _MISFIT)[:, None, None, None] | _is("misfit", every),
    "disturbed": lambda _: _SHAKEN[..., None],
}


@dataclass(frozen=True)
class _Parts:
    """What a combination makes of the speeds less the expected, m/s, all beats: by a change, what
    comes again, what does not."""

    changed: F64
    again: F64
    own: F64


def _parts(stack: _Stack, one: _Explanation, missed: int, moves: int, differ: int) -> _Parts:
    """The sizes by their indices."""
    alike = stack.differ @ stack.differ.T
    own = _MOVES[moves] ** 2 * stack.moving + _DIFFER[differ] ** 2 * alike
    again = _MISSED[missed] ** 2 * stack.missed
    by = one.directions @ one.directions.T
    weights = np.linalg.solve(stack.known + own + again + by, stack.miss_m_s)
    along = by @ weights
    return _Parts(
        along * (one.what == "changed"),
        again @ weights + along * (one.what == "misfit"),
        own @ weights + along * (one.what == "spoilt"),
    )


def _best(stack: _Stack, parts: _Parts, wanted_m_s: F64) -> int:
    """Of the trials that are judged, if there are any."""
    error = np.abs(wanted_m_s[stack.beat] - (stack.speed_m_s - parts.own))
    judged = [at for at, one in enumerate(stack.trials) if one.judged(wanted_m_s)]
    return min(judged or range(len(stack.trials)), key=lambda at: error[stack.trial == at].max())


def _by_beat(stack: _Stack, values: F64) -> F64:
    """Means over the trials."""
    return np.bincount(stack.beat, values) / np.maximum(np.bincount(stack.beat), 1)


def _largest(values: F64) -> float:
    return float(values[np.argmax(np.abs(values))])


_EFFECT: dict[Kind, Callable[[_Stack, _Parts], float]] = {
    "changed": lambda stack, by: _largest(by.changed[stack.trial == stack.trial[-1]]),
    "misfit": lambda stack, by: _largest(_by_beat(stack, by.again)),
    "disturbed": lambda stack, by: float(np.sqrt(_by_beat(stack, by.own**2).max())),
}
