"""What chapter 6 claims of its example (section 6.6) and of its model, and what comes out."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from tailbeat.studies.thesis.chapter6 import plants
from tailbeat.studies.thesis.chapter6.plants import (
    LONG,
    Q_LEN,
    RHO,
    exact,
    law,
    with_filter,
    without_filter,
)
from tailbeat.studies.thesis.example import Claim, Study, verdict
from tailbeat.studies.thesis.heat import (
    CHAPTER6,
    HORIZON,
    STEP,
    heat_plant,
    times,
    undriven_as_printed,
)

_PRINTED_RHO_AT_ONE_FREQUENCY = 2.839
_BASE_FREQUENCY = 0.01  # 2 pi / T, rad/s in the text


def claims(study: Study) -> list[Claim]:
    """What section 6.6 says, and what its model says."""
    found = [_cut_off(), *_single_frequency(), *_band()]
    study.tick(0.3)
    found += _learning(study)
    study.tick(0.6)
    found += [_filter(), *_model()]
    study.tick(1.0)
    return found


def _near(value: float, wanted: float, part: float) -> bool:
    return abs(value - wanted) <= part * abs(wanted)


def _cut_off() -> Claim:
    cut = plants.cut_off(Q_LEN, STEP, passes=2)
    alone = plants.cut_off(Q_LEN, STEP, passes=1)
    return Claim(
        "Q with N0 = 20 at 0.6 s has its cut-off at 10 rad per unit of time",
        "sec. 6.6, (6.42)",
        verdict(_near(cut, 10, 0.01)),
        cut,
        f"-3 dB of Q, rad/min (the text mixes s and min); H alone: {alone:.2f}.",
    )


def _single_frequency() -> list[Claim]:
    printed = _PRINTED_RHO_AT_ONE_FREQUENCY
    by_model, _ = plants.best_rho(plants.modelled, _BASE_FREQUENCY)
    unrounded, _ = plants.best_rho(plants.modelled_unrounded, _BASE_FREQUENCY)
    by_rod, _ = plants.best_rho(plants.rod, _BASE_FREQUENCY)
    left = plants.left_over(plants.rod, printed, _BASE_FREQUENCY)
    model_at_rest = float(np.abs(plants.modelled(0.0))[0])
    diverging = exact(law(rho=printed), 7).max_abs_error
    per_trial = float((diverging[-1] / diverging[-3]) ** 0.5)
    return [
        Claim(
            "rho0 = 2.839 follows from A(z) for the reference's frequency, 0.01",
            "sec. 6.6, (6.40)",
            verdict(_near(by_model, printed, 0.001)),
            [by_model, unrounded],
            "A(z) rounded as in the text, and unrounded; it is Tustin's rule with Muir's "
            "recursion, not Oustaloup's.",
        ),
        Claim(
            "rho0 = 2.839 is the best gain there",
            "sec. 6.6, (6.40)",
            verdict(_near(by_rod, printed, 0.01)),
            by_rod,
            f"A(z) is wrong at low frequencies: abs(A/sinh A) at 0 is {model_at_rest:.3f}, of the "
            f"rod 1. On the rod 2.839 leaves {left:.3f} of an error per trial.",
        ),
        Claim(
            "the law with rho0 = 2.839 converges",
            "sec. 6.6",
            verdict(bool(diverging[-1] < diverging[0])),
            [float(e) for e in diverging],
            f"max|e| of iterations 0 to 7; the last ones grow by {per_trial:.2f} per trial.",
        ),
    ]


def _band() -> list[Claim]:
    omega = np.linspace(*plants.BAND, 10_001)
    wide = np.linspace(0.0, np.pi / STEP, 60_001)
    q = plants.zero_phase_frequency(wide, Q_LEN, STEP)
    by_model, model_left = plants.best_rho(plants.modelled, omega)
    unrounded, _ = plants.best_rho(plants.modelled_unrounded, omega)
    by_rod, rod_left = plants.best_rho(plants.rod, omega)
    with_q, q_left = plants.best_rho(plants.rod, wide, q)
    unfiltered = plants.left_over(plants.rod, RHO, omega)
    filtered = np.abs(q * (1 - RHO * plants.rod(wide)))
    found = [by_model, unrounded, by_rod, with_q]
    return [
        Claim(
            "rho0 = 0.7444 is the optimum (6.41) over [0, 10]",
            "sec. 6.6, (6.41)",
            verdict(any(_near(rho, RHO, 0.02) for rho in found)),
            found,
            f"By A(z) rounded as in the text, unrounded, by the rod, by the rod with Q; they leave "
            f"{model_left:.4f}, {rod_left:.4f} (rod), {q_left:.4f} (with Q) of an error.",
        ),
        Claim(
            "0.7444 meets (6.20): sup|1 - rho h| < 1 over [0, 10]",
            "theorem 6.1",
            verdict(unfiltered < 1),
            unfiltered,
            f"On the rod itself. Beyond {plants.widest_band(STEP):.2f} rad/min, where Re(s h) "
            "changes sign, no gain does.",
        ),
        Claim(
            "with Q it meets (6.32): sup|Q(1 - rho h)| < 1",
            "theorem 6.3",
            verdict(bool(filtered.max() < 1)),
            float(filtered.max()),
            f"Over all frequencies; the largest at {wide[filtered.argmax()]:.2f} rad/min.",
        ),
    ]


def _learning(study: Study) -> list[Claim]:
    thesis = study.run()
    errors = [float(e) for e in thesis.max_abs_error]
    first, second, last = errors[0], errors[1], errors[-1]
    ratios = [after / before for before, after in pairwise(errors[:6])]
    return [
        Claim(
            "the largest error is 13.20 at first",
            "sec. 6.6, fig. 6.1",
            verdict(_near(first, 13.20, 0.01), _near(second, 13.20, 0.05)),
            [first, second],
            "Iterations 0 and 1, which would be the reading. With u^0 = 0 the mean temperature is "
            f"t^2/2 + t/3, so that y^0(10) = {_undriven():.3f} by any solver.",
        ),
        Claim(
            "it is 0.0371 within 7 iterations",
            "sec. 6.6, fig. 6.1",
            verdict(_near(last, 0.0371, 0.02), last <= 0.0371),
            last,
            "Reading: 0.0371 or less. So small a figure hangs on the solver's own tolerance, so "
            "that its digits cannot be had again.",
        ),
        Claim(
            "each trial shrinks the error",
            "fig. 6.1",
            verdict(all(ratio < 1 for ratio in ratios)),
            ratios,
            "Ratios of iterations 1 to 5; then the floor of Q.",
        ),
        Claim(
            "y^7 cannot be told from y^d by eye",
            "fig. 6.2",
            verdict(last < 0.005 * float(thesis.traces["reference"].max())),
            last / float(thesis.traces["reference"].max()),
            "Largest error over the reference's largest value.",
        ),
    ]


def _filter() -> Claim:
    with_q = with_filter(LONG).max_abs_error
    without = without_filter(LONG).max_abs_error
    least = int(without.argmin())
    return Claim(
        "the filter makes the law robust",
        "sec. 6.5, theorem 6.3",
        verdict(bool(with_q[-1] <= 1.2 * with_q[10] and without[-1] > 10 * without[10])),
        [float(with_q[LONG]), float(without[LONG])],
        f"max|e| of iteration {LONG}, exact rod, with Q and without; without it noise grows from "
        f"iteration {least} ({without[least]:.3f}) on.",
    )


def _model() -> list[Claim]:
    omega = np.geomspace(1e-2, np.pi / STEP, 4001)
    across = float(plants.h12(0.0, omega).real.min())
    beside = float(plants.h12(1.0, omega).real.min())
    at, printed = 1.0 + 1.0j, plants.along_printed
    ends, sound = plants.off_at_the_ends(at, printed), plants.off_at_the_ends(at)
    inside = plants.off_inside(at, printed)
    as_printed, undriven = undriven_as_printed(HORIZON), _undriven()
    return [
        Claim(
            "h12(0, s) is positive real, with real zeros",
            "sec. 6.6",
            verdict(across >= 0),
            across,
            f"min Re over frequency; it has no zeros at all. True of the output beside the heater, "
            f"w(1): {beside:.3f}.",
        ),
        Claim(
            "h11, h21 as printed solve (6.35)",
            "sec. 6.6",
            verdict(max(ends) < 1e-3),
            list(ends),
            "At s = 1 + i: abs(dh11/dx) at x = 1, where the rod is insulated, and abs(h21 - 1) at "
            f"x = 0, where w_x is given; both are 0 (with cosh for sinh in exp(Fx) "
            f"{max(sound):.1e}). The law does not use them.",
        ),
        Claim(
            "G as printed solves (6.35)",
            "sec. 6.6, lemma 6.1",
            verdict(inside < 1e-3),
            inside,
            "By the printed exp(Fx), s = 1 + i, a source at x = 0.4: what is left of w_x at the "
            "insulated ends or of its jump at the source; with cosh for sinh "
            f"{plants.off_inside(at):.1e}. The law does not use it.",
        ),
        Claim(
            "(6.39), with its source term, gives the undriven output",
            "(6.39)",
            verdict(_near(as_printed, undriven, 1e-3)),
            [as_printed, undriven],
            "y^0(10) with the printed kernel, and exactly. sinh must be cosh there; the law does "
            "not use it.",
        ),
    ]


def _undriven() -> float:
    """y^0(T), exactly."""
    return float(heat_plant(CHAPTER6, scheme="modal").output(np.zeros(len(times(STEP))))[-1])
