"""Chapter 4: adaptive laws with time scaling, (4.5)-(4.20), on references that change from trial to
trial."""

from __future__ import annotations

from functools import partial
from typing import cast

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis.example import Example, Found, claim
from tailbeat.studies.thesis.ledger import in_continuous_time
from tailbeat.studies.thesis.plants import feedback as loop
from tailbeat.studies.thesis.study import Study

EXAMPLE1_BLOCK = loop.Chapter4(loop.TimeGrid(5000, "rk4"), block=True)
EXAMPLE2_SIGN = loop.Chapter4(loop.TimeGrid(5000, "held"), varying=True)
EXAMPLE2_SMOOTH = loop.Chapter4(loop.TimeGrid(5000, "rk4"), varying=True, smooth=True)

_example = partial(
    Example, prepare=loop.prepare, knows=frozenset({"step", "iterations"}), on_board=False
)
EX1 = _example(
    "ch4-ex1", "Constant parameters, a reference that changes (example 1)",
    "adaptive, (4.5)-(4.6)", loop.Chapter4(loop.TimeGrid(20000, "rk4")), weight=10.0,
)  # fmt: skip
SIGN = _example(
    "ch4-ex2-sign", "Time-varying parameters, sign law (example 2)",
    "adaptive with sgn, (4.15)-(4.17)", EXAMPLE2_SIGN, weight=8.0,
)  # fmt: skip
SMOOTH = _example(
    "ch4-ex2-smooth", "Time-varying parameters, smooth law (example 2)",
    "adaptive with tanh and leakage, (4.18)-(4.20)", EXAMPLE2_SMOOTH, weight=8.0,
)  # fmt: skip
EXAMPLES = (EX1, SIGN, SMOOTH)

LAST = loop.Chapter4.ITERATIONS
COARSE = dict.fromkeys((200, 500, 1000, 2000), LAST)  # steps of a held input: trials; example 1
SAMPLED = {500: 100, 1000: 200, 2000: 200}  # sign law of example 2
AROUND = (91, 110)  # trials about i = 100: their references differ, one alone may be the odd one
_LINE_WIDTH = 0.03  # of the peak: one or two lines' width in a printed figure


def _longer(study: Study) -> loop.LoopTrials:
    return cast(loop.LoopTrials, study.run(iterations=AROUND[1]).traces)


def peaks(trial: int) -> F64:
    """Of both references (4.22)."""
    rate = abs(np.sin(trial)) + 0.5
    t = np.linspace(0.0, 2.0 * np.pi / rate, 20_001)
    first = (np.cos(t) + 1.5) * np.sin(rate * t)
    second = (np.sin(t) + 1.5) * (1.0 - np.cos(rate * t))
    return np.asarray(np.abs([first, second]).max(axis=1))


def apart(found: loop.LoopTrials) -> F64:
    """Median over the trials ``AROUND`` of each state's largest error by its reference's peak."""
    first, last = AROUND
    if len(found.max_abs_error) < last:
        return np.full(2, np.inf)
    highest = np.array([peaks(trial) for trial in range(first, last + 1)])
    return np.asarray(np.median(found.max_abs_error[first - 1 : last] / highest, axis=0))


@claim(EX1, "4-invisible")
def _indistinguishable(study: Study) -> Found:
    found = _longer(study)
    begun, highest, share = found.error(1), peaks(LAST), apart(found)
    note = f"""max|e| of both states; the references' peaks are {highest[0]:.2f} and
    {highest[1]:.2f}, the errors of trial 1 {begun[0]:.3f} and {begun[1]:.3f}. Judged by the median
    of trials {AROUND[0]}-{AROUND[1]}, {share[0]:.1%} and {share[1]:.1%} of the peak; below
    {_LINE_WIDTH:.0%} is a line's width. Every trial has another reference, so errors do not fall in
    each."""
    return Found(np.all(share < _LINE_WIDTH), found.error(LAST), note)


@claim(EX1, "4-theorem-4.1")
def _converges(study: Study) -> Found:
    late, early = _longer(study).settled(91, 100), _longer(study).settled(1, 10)
    coarse, words = loop.sampled(study.setting, COARSE)
    runs = [trials.sampled(1 / steps, LAST) for steps, trials in coarse.items()]
    confirmed, reading = in_continuous_time(runs)
    falls = late < 0.2 * early
    note = f"""Largest error of trials 1-10 and 91-100, in continuous time. (4.6) acts as a damper
    of rate (drho/dt)^2 |f|^2, up to 4 * 2.5^6 here, so a sampled law needs steps below 2 over that,
    about 2 ms at worst. With a held input, {words}."""
    return Found(falls and confirmed, [early, late], note, falls and reading)


@claim(EX1, "4-full-theta")
def _full(study: Study) -> Found:
    found, block = _longer(study), loop.run_trials(EXAMPLE1_BLOCK, LAST)
    reads, full = (one.largest(LAST) < 0.1 * one.largest(1) for one in (block, found))
    note = f"""max|e| at i = 100 when only the diagonal is learned, against
    {loop.pair(found.error(LAST), ".4f")} with all of it;
    {"both converge" if reads and full else "they differ"}."""
    return Found(full, block.error(LAST), note)


@claim(SIGN, "4-sign-chatters")
def _chatters(study: Study) -> Found:
    variation = np.array(study.traces.variation(LAST))
    ratio = variation / loop.other(EXAMPLE2_SMOOTH).variation(LAST)
    note = f"""Total variation of both inputs in trial 100 with 5000 steps,
    {loop.pair(ratio, ".0f")} times that of the smooth law."""
    return Found(np.all(ratio > loop.CHATTER), variation, note)


@claim(SIGN, "4-theorem-4.2")
def _sampled(study: Study) -> Found:
    found, words = loop.sampled(study.setting, SAMPLED)
    runs = [trials.sampled(1 / steps, LAST) for steps, trials in found.items()]
    runs.append(study.traces.sampled(1 / 5000, LAST))
    confirmed, reading = in_continuous_time(runs)
    note = f"""The reading: in continuous time. With 5000 steps {study.traces.largest(LAST):.3f} at
    trial {LAST}. Sampled, chatter keeps |e| above zero, lambda's estimate never falls, and the loop
    diverges along the trials, later with shorter steps. Tanh and leakage, (4.18)-(4.20), cure
    it."""
    return Found(confirmed, words, note, reading)


@claim(SIGN, "4-expansion")
def _expansion(study: Study) -> Found:
    note = """Largest rest of a least-squares fit over a period, of theta_1 and theta_2. The basis
    is called orthonormal but is not normalised; harmless."""
    rests = [rest for _, rest in _fits()]
    return Found(max(rests) < 0.1, rests, note)


def _fits() -> list[tuple[F64, float]]:
    """eta and the largest rest, of theta_1 and theta_2."""
    t = np.linspace(0.0, 2.0 * np.pi, 4001)
    basis = np.stack([np.ones_like(t), np.sin(t), np.cos(t), np.sin(2 * t), np.cos(2 * t)], axis=1)
    found = []
    for theta in (np.exp(np.sin(t)) + 2.0 * np.sin(np.cos(t)), np.sin(t) ** 2):
        eta = np.linalg.lstsq(basis, theta, rcond=None)[0]
        found.append((eta, float(np.max(np.abs(theta - basis @ eta)))))
    return found


@claim(SIGN, "4-bounding")
def _bounding(study: Study) -> Found:
    """g and f are homogeneous: the smallest ratio over all f is that over a circle."""
    angle = np.linspace(0.0, 2.0 * np.pi, 3601)
    ratio = 0.5 * (np.abs(np.cos(angle)) + 2.0 * np.abs(np.sin(angle)))
    smallest, at = ratio.min(), angle[ratio.argmin()]
    note = f"""Smallest g/|f|, at f/|f| = ({np.cos(at):.2g}, {np.sin(at):.2g}). Harmless: lambda's
    estimate grows to that much more."""
    return Found(smallest >= 1.0, smallest, note)


@claim(SMOOTH, "4-tanh-smooth")
def _smooth(study: Study) -> Found:
    mine, others = (one.variation(LAST) for one in (study.traces, loop.other(EXAMPLE2_SIGN)))
    by_sign = loop.pair(others, ".0f")
    note = f"Total variation of both inputs in trial 100; of the sign law {by_sign}."
    return Found(np.all(np.array(others) / np.array(mine) > loop.CHATTER), mine, note)


@claim(SMOOTH, "4-tanh-slower")
def _slower(study: Study) -> Found:
    mine, others = (one.error(LAST) for one in (study.traces, loop.other(EXAMPLE2_SIGN)))
    note = f"""max|e| at i = 100; of the sign law {loop.pair(others, ".4f")} (its second one is the
    chatter's, in proportion to the step)."""
    return Found(np.all(np.array(mine) > others), mine, note)


@claim(SMOOTH, "4-theorem-4.3")
def _bounded(study: Study) -> Found:
    early, late = (study.traces.settled(*trials) for trials in ((1, 50), (51, LAST)))
    printed, with_time = _neighbourhood(1.0), _neighbourhood(2.0 * np.pi)
    note = """Largest error of trials 1-50 and 51-100; sqrt(2 zeta) by (4.21), and with the factor T
    that its first term lacks: (A.33) holds at each moment and is integrated over the trial. eta is
    the fit's, lambda its largest rest."""
    measured = [early, late, printed, with_time]
    return Found(late <= printed, measured, note, late <= with_time)


def _neighbourhood(first_factor: float) -> float:
    """sqrt(2 zeta) of (4.21) with m = 2, T = 2 pi, the example's epsilon, mu_1 and mu_2."""
    etas, rests = zip(*_fits(), strict=True)
    rest, squares = max(rests), sum(float(eta @ eta) for eta in etas)
    zeta = first_factor * rest * 0.1 + np.pi * (1e-3 * squares + 1e-2 * rest**2)
    return float(np.sqrt(2 * zeta))
