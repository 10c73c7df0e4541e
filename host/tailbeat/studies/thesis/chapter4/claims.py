"""What chapter 4 claims of its examples, and what came out."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis.example import Claim, Study, verdict
from tailbeat.studies.thesis.feedback import Chapter4, LoopTrials, TimeGrid, run_trials, trials_of

ITERATIONS = 100
EXAMPLE1 = Chapter4(TimeGrid(20000, "rk4"))
EXAMPLE1_BLOCK = Chapter4(TimeGrid(5000, "rk4"), block=True)
EXAMPLE2_SIGN = Chapter4(TimeGrid(5000, "held"), varying=True)
EXAMPLE2_SMOOTH = Chapter4(TimeGrid(5000, "rk4"), varying=True, smooth=True)

COARSE = (200, 500, 1000, 2000)  # steps of a held input; example 1
SAMPLED = ((500, 100), (1000, 200), (2000, 200))  # steps, trials; sign law of example 2
AROUND = (91, 110)  # trials about i = 100: their references differ, one alone may be the odd one
_LINE_WIDTH = 0.03  # of the peak: one or two lines' width in a printed figure
_CHATTER = 10.0  # times the variation of the smooth input
_GROWTH = 3.0  # times the smallest error so far, from where it is no scatter of the references


def sampled_words(trials: LoopTrials, steps: int, last: int) -> str:
    """How a series of ``last`` trials went with ``steps`` samples each."""
    if trials.diverged is not None:
        return f"{steps} steps: not computable from trial {trials.diverged} on"
    return f"{steps} steps: {trials.largest(last):.3g} at trial {last}"


def grows(trials: LoopTrials) -> bool:
    """Whether the errors have passed a minimum and risen well above it, or diverged."""
    if trials.diverged is not None:
        return True
    worst = np.convolve(trials.max_abs_error.max(axis=1), np.full(10, 0.1), "valid")
    return bool(worst[-1] > _GROWTH * worst.min())


def example1(study: Study) -> list[Claim]:
    found = trials_of(study.run(iterations=AROUND[1]))
    study.tick(0.5)
    coarse = {
        n: run_trials(replace(EXAMPLE1, grid=TimeGrid(n, "held")), ITERATIONS) for n in COARSE
    }
    study.tick(0.6)
    block = run_trials(EXAMPLE1_BLOCK, ITERATIONS)
    return [_indistinguishable(found), _converges(found, coarse), _full(found, block)]


def _peaks(trial: int) -> F64:
    """Of both references (4.22)."""
    rate = abs(np.sin(trial)) + 0.5
    t = np.linspace(0.0, 2.0 * np.pi / rate, 20_001)
    first = (np.cos(t) + 1.5) * np.sin(rate * t)
    second = (np.sin(t) + 1.5) * (1.0 - np.cos(rate * t))
    return np.asarray(np.abs([first, second]).max(axis=1))


def _apart(found: LoopTrials) -> F64:
    """Median over the trials ``AROUND`` of each state's largest error by its reference's peak."""
    first, last = AROUND
    if len(found.max_abs_error) < last:
        return np.full(2, np.inf)
    peaks = np.array([_peaks(trial) for trial in range(first, last + 1)])
    shares: F64 = np.median(found.max_abs_error[first - 1 : last] / peaks, axis=0)
    return shares


def _indistinguishable(found: LoopTrials) -> Claim:
    error, peaks, apart = found.error(ITERATIONS), _peaks(ITERATIONS), _apart(found)
    return Claim(
        "x and its reference are almost indistinguishable at i = 100",
        "ch. 4, example 1",
        verdict(bool(np.all(apart < _LINE_WIDTH))),
        error,
        f"max|e| of both states; the references' peaks are {peaks[0]:.2f} and {peaks[1]:.2f}, "
        f"the errors of trial 1 {found.error(1)[0]:.3f} and {found.error(1)[1]:.3f}. Judged by the "
        f"median of trials {AROUND[0]}-{AROUND[1]}, {apart[0]:.1%} and {apart[1]:.1%} of the peak; "
        f"below {_LINE_WIDTH:.0%} is a line's width. Every trial has another reference, so errors "
        "do not fall in each.",
    )


def _converges(found: LoopTrials, coarse: dict[int, LoopTrials]) -> Claim:
    late, early = found.settled(91, 100), found.settled(1, 10)
    falls = late < 0.2 * early
    robust = all(trials.settled(91, 100) < 0.2 * early for trials in coarse.values())
    words = "; ".join(sampled_words(trials, n, ITERATIONS) for n, trials in coarse.items())
    return Claim(
        "The errors converge along the trials with (4.5)-(4.6)",
        "ch. 4, (4.5)-(4.6)",
        verdict(falls and robust, falls),
        [early, late],
        "Largest error of trials 1-10 and 91-100, in continuous time. (4.6) acts as a damper of "
        "rate (drho/dt)^2 |f|^2, up to 4 * 2.5^6 here, so a sampled law needs steps below 2 over "
        f"that, about 2 ms at worst. With a held input, {words}.",
    )


def _full(found: LoopTrials, block: LoopTrials) -> Claim:
    reads = block.largest(ITERATIONS) < 0.1 * block.largest(1)
    full = found.largest(ITERATIONS) < 0.1 * found.largest(1)
    return Claim(
        "(4.6) learns all of Theta, though Theta is block diagonal",
        "ch. 4, (4.6)",
        verdict(full),
        block.error(ITERATIONS),
        "max|e| at i = 100 when only the diagonal is learned, against "
        f"{found.error(ITERATIONS)[0]:.4f} and {found.error(ITERATIONS)[1]:.4f} with all of it; "
        f"{'both converge' if reads and full else 'they differ'}.",
        ours=True,
    )


@cache
def other(setting: Chapter4) -> LoopTrials:
    """The law to compare with, with a trace of the last trial; figures draw it, too."""
    return run_trials(setting, ITERATIONS, traced={ITERATIONS})


def sign(study: Study) -> list[Claim]:
    found = trials_of(study.run())
    study.tick(0.3)
    against = other(EXAMPLE2_SMOOTH)
    study.tick(0.6)
    sampled = {
        n: run_trials(replace(EXAMPLE2_SIGN, grid=TimeGrid(n, "held")), last) for n, last in SAMPLED
    }
    return [_chatters(found, against), _sampled(found, sampled), _expansion(), _bounding()]


def _chatters(found: LoopTrials, against: LoopTrials) -> Claim:
    variation = np.array(found.variation(ITERATIONS))
    ratio = variation / np.array(against.variation(ITERATIONS))
    return Claim(
        "The sign law chatters",
        "ch. 4, example 2, (4.15)-(4.17)",
        verdict(bool(np.all(ratio > _CHATTER))),
        found.variation(ITERATIONS),
        "Total variation of both inputs in trial 100 with 5000 steps, "
        f"{ratio[0]:.0f} and {ratio[1]:.0f} times that of the smooth law.",
    )


def _sampled(found: LoopTrials, sampled: dict[int, LoopTrials]) -> Claim:
    words = [
        sampled_words(t, n, last) for (n, last), t in zip(SAMPLED, sampled.values(), strict=True)
    ]
    well = not grows(found) and not any(grows(trials) for trials in sampled.values())
    return Claim(
        "The errors converge along the trials with the sign law",
        "ch. 4, (4.15)-(4.17)",
        verdict(well),
        "; ".join(words),
        "Sampled, chatter keeps |e| above zero, lambda's estimate never falls, and the loop "
        "diverges along the trials, later with shorter steps. A dead zone in lambda's update only "
        "delays it. Tanh and leakage, (4.18)-(4.20), cure it.",
    )


def _expansion() -> Claim:
    t = np.linspace(0.0, 2.0 * np.pi, 4001)
    basis = np.stack([np.ones_like(t), np.sin(t), np.cos(t), np.sin(2 * t), np.cos(2 * t)], axis=1)
    rests = []
    for theta in (np.exp(np.sin(t)) + 2.0 * np.sin(np.cos(t)), np.sin(t) ** 2):
        fitted = basis @ np.linalg.lstsq(basis, theta, rcond=None)[0]
        rests.append(float(np.max(np.abs(theta - fitted))))
    return Claim(
        "theta expands in the basis 1, sin t, cos t, sin 2t, cos 2t with a bounded rest",
        "ch. 4, example 2",
        verdict(max(rests) < 0.1),
        rests,
        "Largest rest of a least-squares fit over a period, of theta_1 and theta_2. The basis is "
        "called orthonormal but is not normalised; harmless.",
    )


def _bounding() -> Claim:
    """g and f are homogeneous: the smallest ratio over all f is that over a circle."""
    angle = np.linspace(0.0, 2.0 * np.pi, 3601)
    ratio = 0.5 * (np.abs(np.cos(angle)) + 2.0 * np.abs(np.sin(angle)))
    smallest, at = float(ratio.min()), angle[int(ratio.argmin())]
    return Claim(
        "g = 0.5(|f_1| + 2|f_2|) bounds |f|",
        "ch. 4, example 2",
        verdict(smallest >= 1.0),
        smallest,
        f"Smallest g/|f|, at f/|f| = ({np.cos(at):.2g}, {np.sin(at):.2g}). Harmless: lambda's "
        "estimate grows to that much more.",
    )


def smooth(study: Study) -> list[Claim]:
    found = trials_of(study.run())
    study.tick(0.5)
    against = other(EXAMPLE2_SIGN)
    study.tick(0.8)
    return [_smooth_input(found, against), _slower(found, against), _bounded(found)]


def _smooth_input(found: LoopTrials, against: LoopTrials) -> Claim:
    ratio = np.array(against.variation(ITERATIONS)) / np.array(found.variation(ITERATIONS))
    return Claim(
        "The tanh law's input is smooth",
        "ch. 4, example 2, (4.18)-(4.20)",
        verdict(bool(np.all(ratio > _CHATTER))),
        found.variation(ITERATIONS),
        "Total variation of both inputs in trial 100; of the sign law "
        f"{against.variation(ITERATIONS)[0]:.0f} and {against.variation(ITERATIONS)[1]:.0f}.",
    )


def _slower(found: LoopTrials, against: LoopTrials) -> Claim:
    mine, others = found.error(ITERATIONS), against.error(ITERATIONS)
    return Claim(
        "The tanh law converges more slowly than the sign law",
        "ch. 4, example 2",
        verdict(all(a > b for a, b in zip(mine, others, strict=True))),
        mine,
        f"max|e| at i = 100; of the sign law {others[0]:.4f} and {others[1]:.4f} "
        "(its second one is the chatter's, in proportion to the step).",
    )


def _bounded(found: LoopTrials) -> Claim:
    early, late = found.settled(1, 50), found.settled(51, ITERATIONS)
    return Claim(
        "With leakage the errors end within a bound",
        "ch. 4, (4.21)",
        verdict(late <= early),
        [early, late],
        "Largest error of trials 1-50 and 51-100. The bound (4.21) itself lacks a factor T: (A.33) "
        "holds at each moment and is integrated over the trial.",
    )
