"""What chapter 5 claims of its example, and what came out."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis.chapter4.claims import grows, sampled_words
from tailbeat.studies.thesis.example import Claim, Study, verdict
from tailbeat.studies.thesis.feedback import Chapter5, LoopTrials, TimeGrid, run_trials, trials_of

ITERATIONS = 50
CASE1_SIGN = Chapter5(TimeGrid(5000, "held"))
CASE1_SMOOTH = Chapter5(TimeGrid(500, "rk4"), smooth=True)
CASE2 = Chapter5(TimeGrid(500, "rk4"), smooth=True, uncertain=True)

SAMPLED = ((250, 200), (500, 400), (1000, 600))  # steps of 0.5 s, trials
LATE = 1000
DEAD_ZONE, LEAK, SOFTNESS = 0.02, 1e-2, 0.01
_BOUND, _WITHIN = 0.1, 10  # of the text, case 2
_CHATTER = 10.0  # times the variation of the smooth input
_UNREAD = "rho of case 1 is never given; 2|f|, the alpha of case 2, is taken."


@cache
def other(setting: Chapter5) -> LoopTrials:
    """The law to compare with, with a trace of the last trial; figures draw it, too."""
    return run_trials(setting, ITERATIONS, traced={ITERATIONS})


def _pair(values: list[float]) -> str:
    return f"{values[0]:.4g} and {values[1]:.4g}"


def case1_sign(study: Study) -> list[Claim]:
    found = trials_of(study.run())
    against = other(CASE1_SMOOTH)
    study.tick(0.3)
    sampled = {
        n: run_trials(replace(CASE1_SIGN, grid=TimeGrid(n, "held")), last) for n, last in SAMPLED
    }
    study.tick(0.6)
    at = replace(CASE1_SIGN, grid=TimeGrid(1000, "held"))
    dead = run_trials(replace(at, dead_zone=DEAD_ZONE), LATE)
    leaky = run_trials(replace(at, leak=LEAK), LATE)
    return [
        _beats(found, against), _chatters(found, against), _theorem(sampled),
        _cured(f"with a dead zone of {DEAD_ZONE} in (5.6)", dead),
        _cured(f"with leakage mu = {LEAK} in (5.6)", leaky),
    ]  # fmt: skip


def _beats(found: LoopTrials, against: LoopTrials) -> Claim:
    mine, others = found.error(ITERATIONS), against.error(ITERATIONS)
    return Claim(
        "I_1 tracks better than I_2",
        "ch. 5, case 1",
        verdict(all(a < b for a, b in zip(mine, others, strict=True))),
        mine,
        f"max|e| at i = {ITERATIONS}; of I_2 {_pair(others)}. {_UNREAD}",
    )


def _chatters(found: LoopTrials, against: LoopTrials) -> Claim:
    ratio = np.array(found.variation(ITERATIONS)) / np.array(against.variation(ITERATIONS))
    return Claim(
        "I_1 chatters",
        "ch. 5, case 1, (5.5)",
        verdict(bool(np.all(ratio > _CHATTER))),
        found.variation(ITERATIONS),
        f"Total variation of both inputs in trial {ITERATIONS} with 5000 steps; of I_2 "
        f"{_pair(against.variation(ITERATIONS))}.",
    )


def _theorem(sampled: dict[int, LoopTrials]) -> Claim:
    words = [
        sampled_words(t, n, last) for (n, last), t in zip(SAMPLED, sampled.values(), strict=True)
    ]
    fine, (steps, _) = sampled[SAMPLED[-1][0]], SAMPLED[-1]
    worst = fine.max_abs_error.max(axis=1)
    return Claim(
        "The error of I_1 goes to 0 as i grows (Theorem 5.1)",
        "ch. 5, theorem 5.1",
        verdict(not any(grows(trials) for trials in sampled.values())),
        "; ".join(words),
        "Not when sampled: chatter of about step * theta * rho feeds (5.6), theta's estimate grows "
        "by a factor per trial, and the error passes a minimum and then grows exponentially in i. "
        f"With {steps} steps the minimum is {worst.min():.2g}, at trial {int(worst.argmin()) + 1}.",
    )


def _cured(how: str, trials: LoopTrials) -> Claim:
    middle, end = trials.settled(101, 200), trials.settled(LATE - 99, LATE)
    bounded = np.isfinite(end) and not grows(trials)
    return Claim(
        f"The error of I_1 stays bounded {how}",
        "ch. 5, theorem 5.1, another law",
        verdict(bool(bounded)),
        [middle, end],
        f"Largest error of trials 101-200 and {LATE - 99}-{LATE} with 1000 steps. Not the thesis's "
        "law: a cure for the claim above.",
        ours=True,
    )


def case1_smooth(study: Study) -> list[Claim]:
    found = trials_of(study.run())
    late = run_trials(CASE1_SMOOTH, LATE)
    study.tick(0.4)
    leaky = run_trials(replace(CASE1_SMOOTH, leak=LEAK), LATE)
    study.tick(0.8)
    against = other(CASE1_SIGN)
    less = run_trials(replace(CASE1_SMOOTH, bound=1.0), ITERATIONS)
    return [_smooth(found, against), _bounded(found, late, leaky), _rho(found, less)]


def _smooth(found: LoopTrials, against: LoopTrials) -> Claim:
    ratio = np.array(against.variation(ITERATIONS)) / np.array(found.variation(ITERATIONS))
    return Claim(
        "I_2's input is smooth",
        "ch. 5, case 1, (5.8)-(5.9)",
        verdict(bool(np.all(ratio > _CHATTER))),
        found.variation(ITERATIONS),
        f"Total variation of both inputs in trial {ITERATIONS}; of I_1 "
        f"{_pair(against.variation(ITERATIONS))}.",
    )


def _bounded(found: LoopTrials, late: LoopTrials, leaky: LoopTrials) -> Claim:
    creep = late.max_estimate[:, 0]
    words = (
        f"{creep[ITERATIONS - 1]:.1f} at trial {ITERATIONS} and {creep[-1]:.1f} at trial {LATE}"
        if late.diverged is None
        else f"beyond bounds at trial {late.diverged}"
    )
    return Claim(
        "I_2's errors end within a bound",
        "ch. 5, (5.9)-(5.10)",
        verdict(not grows(late) and not grows(leaky)),
        found.error(ITERATIONS),
        f"max|e| at i = {ITERATIONS}. With mu = 0 theta's estimate keeps creeping up: {words}; "
        f"mu = {LEAK} ends at errors of {_pair(leaky.error(LATE))}. The first term of (5.10) lacks "
        "a factor T (0.5 here).",
    )


def _first_within(trials: LoopTrials, bound: float) -> int | None:
    """The trial from which on all errors are below ``bound``."""
    above = np.flatnonzero(trials.max_abs_error.max(axis=1) >= bound)
    first = int(above[-1]) + 2 if above.size else 1
    return first if first <= len(trials.max_abs_error) else None


def _rho(found: LoopTrials, less: LoopTrials) -> Claim:
    covers = CASE1_SMOOTH.bound
    trials = [float(_first_within(one, _BOUND) or np.nan) for one in (found, less)]
    return Claim(
        "rho bounds the uncertainty of case 1, |f| <= rho",
        "ch. 5, case 1",
        verdict(False, covers >= 1.0),  # there is no printed rho that could
        [covers, *trials],
        f"{_UNREAD} Measured: rho/|f|, and the trial from which both errors are below {_BOUND} "
        "with this rho and with |f| itself.",
    )


def case2(study: Study) -> list[Claim]:
    found = trials_of(study.run())
    study.tick(0.2)
    fitting = run_trials(replace(CASE2, beta_power=2), ITERATIONS)
    safe = run_trials(replace(CASE2, inverse_norm=True), ITERATIONS)
    study.tick(0.6)
    slow = run_trials(replace(CASE2, grid=TimeGrid(100, "held")), ITERATIONS)
    soft = run_trials(replace(CASE2, grid=TimeGrid(100, "held"), softness=SOFTNESS), ITERATIONS)
    return [
        _within(found), _continuous(found, slow, soft), _beta(found, fitting), _norm(found, safe),
    ]  # fmt: skip


def _within(found: LoopTrials) -> Claim:
    first = _first_within(found, _BOUND)
    return Claim(
        "Both errors are within 0.1 after 10 iterations",
        "ch. 5, case 2",
        verdict(first is not None and first <= _WITHIN),
        float(first or np.nan),
        f"The trial from which both are; {_pair(found.error(_WITHIN))} at i = {_WITHIN}.",
    )


def _continuous(found: LoopTrials, slow: LoopTrials, soft: LoopTrials) -> Claim:
    here, there = found.variation(ITERATIONS), slow.variation(ITERATIONS)
    smooth = all(np.isfinite(here)) and max(here) < _CHATTER * max(found.max_abs_input[-1])
    return Claim(
        "No discontinuity of the input with (5.19)",
        "ch. 5, case 2",
        verdict(smooth),
        here,
        f"Total variation of both inputs in trial {ITERATIONS}, continuous time. But the unit "
        "vectors B'e/|B'e| are not smoothed: with the input held for 5 ms it is "
        f"{_pair(there)}, and {_pair(soft.variation(ITERATIONS))} with {SOFTNESS} added to |B'e|.",
    )


def _beta(found: LoopTrials, fitting: LoopTrials) -> Claim:
    gap = float(np.max(np.abs(fitting.max_abs_error[1:10] / found.max_abs_error[1:10] - 1.0)))
    covered = _beta_covers(CASE2.beta_power)
    return Claim(
        "beta bounds |d|",
        "ch. 5, case 2",
        verdict(covered >= 1.0, _beta_covers(2) >= 1.0),
        covered,
        "Smallest beta/|d| along the reference. As printed beta has sin^4 x_2 though "
        f"d_2 = 0.2 sin x_2; with sin^2 the ratio is {_beta_covers(2):.3g} throughout, as with the "
        f"other two bounds. Errors of trials 2-10 change by {100 * gap:.0f} % at most.",
    )


def _beta_covers(power: int) -> float:
    t = np.linspace(0.0, Chapter5.DURATION, 2001)
    first, second = np.sin(_reference(t))
    beta = 0.2 * np.sqrt(first**2 + 4.0 * second**power)
    return float(np.min(beta / np.hypot(0.1 * first, 0.2 * second)))


def _norm(found: LoopTrials, safe: LoopTrials) -> Claim:
    largest = _inverse_by_norm()
    return Claim(
        "1/|B| holds enough in reserve against the uncertain gain: |B^-1| <= 1/|B|",
        "ch. 5, (5.13), (A.71)-(A.72)",
        verdict(largest <= 1.0 + 1e-12),
        [largest, found.error(ITERATIONS)[0], safe.error(ITERATIONS)[0]],
        "Largest |B^-1| |B| along the reference, which is 1 or more for any matrix; max|e_1| at "
        f"i = {ITERATIONS} as printed and with the safe |B^-1|. The example learns all the same; "
        "for a fish, whose plant is scalar, both are one.",
    )


def _reference(t: F64) -> F64:
    return np.array([0.5 * np.sin(8 * np.pi * t) + 1.0, -0.25 * np.cos(16 * np.pi * t) - 0.5])


def _input_gain(t: F64) -> F64:
    """The diagonal of B along the reference."""
    first, second = np.sin(_reference(t))
    return np.array(
        [2 + first + 0.1 * np.sin(2 * np.pi * t), 1 + second + 0.1 * np.sin(4 * np.pi * t)]
    )


def _inverse_by_norm() -> float:
    """The largest |B^-1| |B|, spectral norms."""
    gains = np.abs(_input_gain(np.linspace(0.0, Chapter5.DURATION, 2001)))
    return float(np.max(gains.max(axis=0) / gains.min(axis=0)))
