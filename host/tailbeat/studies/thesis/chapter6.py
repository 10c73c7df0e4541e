"""Chapter 6: a rod heated at one end and measured at the other; D-type law and zero-phase Q."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.studies.thesis.example import Example, Found, claim
from tailbeat.studies.thesis.plants import heat, rod
from tailbeat.studies.thesis.plants.rod import LONG, Q_LEN, RHO
from tailbeat.studies.thesis.study import Study

HEAT = Example(
    "ch6-heat", "Heat equation (6.35), driven at one end, measured at the other",
    "D-type with zero-phase Q (6.31), (6.42)", None, rod.prepare,
    knows=frozenset({"step", "iterations"}), weight=2.0,
)  # fmt: skip
EXAMPLES = (HEAT,)

_PRINTED_RHO_AT_ONE_FREQUENCY = 2.839
_BASE_FREQUENCY = 0.01  # 2 pi / T, rad/s in the text
FIRST_OF_TEXT, LAST_OF_TEXT = 13.20, 0.0371


def _near(value: float, printed: float, part: float) -> bool:
    return abs(value - printed) <= part * abs(printed)


@claim(HEAT, "6-cut-off")
def _cut_off(study: Study) -> Found:
    cut, alone = (rod.cut_off(Q_LEN, heat.STEP, passes) for passes in (2, 1))
    note = f"-3 dB of Q, rad/min (the text mixes s and min); H alone: {alone:.2f}."
    return Found(_near(cut, 10, 0.01), cut, note)


@claim(HEAT, "6-follows")
def _follows(study: Study) -> Found:
    by_model, unrounded = (
        rod.best_rho(gain, _BASE_FREQUENCY)[0] for gain in (rod.modelled, rod.modelled_unrounded)
    )
    note = """A(z) rounded as in the text, and unrounded; it is Tustin's rule with Muir's recursion,
    not Oustaloup's."""
    return Found(_near(by_model, _PRINTED_RHO_AT_ONE_FREQUENCY, 0.001), [by_model, unrounded], note)


@claim(HEAT, "6-best-there")
def _best_there(study: Study) -> Found:
    printed = _PRINTED_RHO_AT_ONE_FREQUENCY
    by_rod, _ = rod.best_rho(rod.rod, _BASE_FREQUENCY)
    at_rest = np.abs(rod.modelled(0.0))[0]
    left = rod.left_over(rod.rod, printed, _BASE_FREQUENCY)
    note = f"""A(z) is wrong at low frequencies: abs(A/sinh A) at 0 is {at_rest:.3f}, of the rod 1.
    On the rod 2.839 leaves {left:.3f} of an error per trial."""
    return Found(_near(by_rod, printed, 0.01), by_rod, note)


@claim(HEAT, "6-2.839")
def _diverges(study: Study) -> Found:
    found = rod.exact(rod.law(rho=_PRINTED_RHO_AT_ONE_FREQUENCY), 7)
    per_trial = (found[-1] / found[-3]) ** 0.5
    note = f"max|e| of iterations 0 to 7; the last ones grow by {per_trial:.2f} per trial."
    return Found(found[-1] < found[0], found, note)


_OMEGA: F64 = np.linspace(*rod.BAND, 10_001)
_WIDE: F64 = np.linspace(0.0, np.pi / heat.STEP, 60_001)


@claim(HEAT, "6-optimum")
def _optimum(study: Study) -> Found:
    q = rod.zero_phase_frequency(_WIDE, Q_LEN, heat.STEP)
    by_model, unrounded, by_rod, with_q = (
        rod.best_rho(rod.modelled, _OMEGA), rod.best_rho(rod.modelled_unrounded, _OMEGA),
        rod.best_rho(rod.rod, _OMEGA), rod.best_rho(rod.rod, _WIDE, q),
    )  # fmt: skip
    found = [rho for rho, _ in (by_model, unrounded, by_rod, with_q)]
    note = f"""By A(z) rounded as in the text, unrounded, by the rod, by the rod with Q; they leave
    {by_model[1]:.4f}, {by_rod[1]:.4f} (rod), {with_q[1]:.4f} (with Q) of an error."""
    return Found(any(_near(rho, RHO, 0.02) for rho in found), found, note)


@claim(HEAT, "6-theorem-6.1")
def _unfiltered(study: Study) -> Found:
    left = rod.left_over(rod.rod, RHO, _OMEGA)
    note = f"""On the rod itself. Beyond {rod.widest_band(heat.STEP):.2f} rad/min, where Re(s h)
    changes sign, no gain does."""
    return Found(left < 1, left, note)


@claim(HEAT, "6-theorem-6.3")
def _filtered(study: Study) -> Found:
    left = np.abs(rod.zero_phase_frequency(_WIDE, Q_LEN, heat.STEP) * (1 - RHO * rod.rod(_WIDE)))
    note = f"Over all frequencies; the largest at {_WIDE[left.argmax()]:.2f} rad/min."
    return Found(left.max() < 1, left.max(), note)


@claim(HEAT, "6-first-error")
def _first_error(study: Study) -> Found:
    first, second = study.run().max_abs_error[:2]
    note = f"""Iterations 0 and 1, which would be the reading. With u^0 = 0 the mean temperature is
    t^2/2 + t/3, so that y^0(10) = {_undriven():.3f} by any solver."""
    reading = _near(second, FIRST_OF_TEXT, 0.05)
    return Found(_near(first, FIRST_OF_TEXT, 0.01), [first, second], note, reading)


@claim(HEAT, "6-last-error")
def _last_error(study: Study) -> Found:
    last = study.run().max_abs_error[-1]
    note = """Reading: 0.0371 or less. So small a figure hangs on the solver's own tolerance, so
    that its digits cannot be reproduced."""
    return Found(_near(last, LAST_OF_TEXT, 0.02), last, note, last <= LAST_OF_TEXT)


@claim(HEAT, "6-shrinks")
def _shrinks(study: Study) -> Found:
    ratios = [after / before for before, after in pairwise(study.run().max_abs_error[:6])]
    return Found(max(ratios) < 1, ratios, "Ratios of iterations 1 to 5; then the bound by Q.")


@claim(HEAT, "6-invisible")
def _by_eye(study: Study) -> Found:
    run = study.run()
    last, largest = run.max_abs_error[-1], run.traces.problem.reference.max()
    note = "Largest error over the reference's largest value."
    return Found(last < 0.005 * largest, last / largest, note)


@claim(HEAT, "6-robust")
def _robust(study: Study) -> Found:
    with_q, without = rod.with_filter(), rod.without_filter()
    least = int(without.argmin())
    note = f"""max|e| of iteration {LONG}, exact rod, with Q and without; without it noise grows
    from iteration {least} ({without[least]:.3f}) on."""
    robust = with_q[-1] <= 1.2 * with_q[10] and without[-1] > 10 * without[10]
    return Found(robust, [with_q[LONG], without[LONG]], note)


@claim(HEAT, "6-positive-real")
def _positive_real(study: Study) -> Found:
    omega = np.geomspace(1e-2, np.pi / heat.STEP, 4001)
    across, beside = (rod.h12(x, omega).real.min() for x in (0.0, 1.0))
    note = f"""min Re over frequency; it has no zeros at all. True of the output beside the heater,
    w(1): {beside:.3f}."""
    return Found(across >= 0, across, note)


_AT = 1.0 + 1.0j  # s


@claim(HEAT, "6-kernel")
def _inside(study: Study) -> Found:
    ends, inside = (
        rod.off_at_the_ends(_AT, rod.along_printed),
        rod.off_inside(_AT, rod.along_printed),
    )
    printed, exactly = heat.undriven_as_printed(heat.HORIZON), _undriven()
    found = [*ends, inside, abs(printed / exactly - 1)]
    cured = max(*rod.off_at_the_ends(_AT), rod.off_inside(_AT))
    note = f"""One slip, sinh for cosh in exp(Fx), which the law does not use. At s = 1 + i:
    abs(dh11/dx) at x = 1, where the rod is insulated; abs(h21 - 1) at x = 0, where w_x is given.
    Then what a source at x = 0.4 leaves of w_x at the ends or of its jump. With cosh all are
    below {cured:.1e}. Last, how far y^0(10) by (6.39), {printed:.1f}, is from the exact
    {exactly:.1f}."""
    return Found(max(found) < 1e-3, found, note)


def _undriven() -> float:
    """y^0(T), exactly."""
    rod_exactly = heat.heat_plant(heat.CHAPTER6, scheme="modal")
    return float(rod_exactly.output(np.zeros(len(heat.times(heat.STEP))))[-1])
