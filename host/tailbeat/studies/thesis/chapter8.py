"""Chapter 8: the robotic fish learns (8.31) by the law (8.16), gains 4, 7 and 10.

By default as the fish does it: one amplitude per beat, errors of beat means. With a step: sampled
control, the amplitude held for a step and paired with the error at its end.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.core.arrays import F64
from tailbeat.core.reference import thesis_speed
from tailbeat.studies.thesis.example import Example, Found, claim
from tailbeat.studies.thesis.ledger import SampledRun, in_continuous_time
from tailbeat.studies.thesis.plants import cruise
from tailbeat.studies.thesis.study import Study

GAINS = (4.0, 7.0, 10.0)
GAIN4, GAIN7, GAIN10 = EXAMPLES = tuple(
    Example(
        f"ch8-sim-{gain:g}", f"Robotic fish (8.13), gain {gain:g}, m/s",
        "P with saturation (8.16)", gain, cruise.prepare,
        knows=frozenset({"lengths", "seed", "step", "iterations"}), weight=2.0,
    )
    for gain in GAINS
)  # fmt: skip

_LONG = 40  # iterations that show whether a law stays where it got to
_DRAG_KG_M = 165.7056
_LENGTH_M, _TANK_M = 0.36, 3.0
_LINE_WIDTH = 0.03  # of the peak, in a figure
_FASTER = 1.9  # factor on a reference that nobody can follow
_PEAK_M_S = float(cruise.reference_beats().max())


def _settled(values: F64) -> bool:
    """Down by 90 % and, from the least error on, never up again by more than 5 %."""
    least = int(np.argmin(values))
    return bool(values[least] < 0.1 * values[0] and values[least:].max() <= 1.05 * values[least])


@claim(GAIN4, "8-80-percent")
def _eighty_percent(study: Study) -> Found:
    found = study.run(iterations=6).max_abs_error
    down = 1 - found.min() / found[0]
    note = """The reading: of the model (8.13), in beat means. The thesis tells it of its tank, one
    profile, one gain, no repeats."""
    return Found(False, down, note, down > 0.8)  # the tank's own record is not printed


FEEDBACK_GAINS = (2.0, 4.0)  # of a PI controller, rad/(m/s), the second per beat


@claim(GAIN4, "8-first-input")
def _first_input(study: Study) -> Found:
    feedback = cruise.FishTask(4.0, first_input=cruise.feedback_input(*FEEDBACK_GAINS))
    errors = feedback.problem().uncut(_LONG), _beats(4.0, _LONG)
    needed = [_reached(one) for one in errors]
    first = [float(one[0]) for one in errors]
    note = """Iterations to 2 mm/s, gain 4, from the input of a PI controller and from zero; then
    max|e| of iteration 0, m/s."""
    return Found(needed[0] < needed[1], [*needed, *first], note)


_FIGURE_LAST = 10  # iterations that figures 8.6 to 8.9 show
_PART_OF_PEAK = 0.2
_TRAP_STEPS_S = (0.2, 0.1, 0.05, 0.02)


@claim(GAIN4, "8-theorem-8.1")
def _converges(study: Study) -> Found:
    beats = [_beats(gain, _LONG) for gain in GAINS]
    runs = [_trap(gain, step) for gain in GAINS for step in _TRAP_STEPS_S]
    judged = [
        in_continuous_time(runs[i : i + len(_TRAP_STEPS_S)])
        for i in range(0, len(runs), len(_TRAP_STEPS_S))
    ]
    settled = all(_settled(one) for one in beats)
    departs = [float("nan") if run.departs_at is None else run.departs_at for run in runs]
    note = f"""max|e| in iteration {_LONG} by beats, m/s, gains 4, 7, 10; then, sampled with u(k)
    paired with e(k), the speed before it acts, the iteration from which the error grows, for steps
    of 0.2, 0.1, 0.05 and 0.02 s at each gain. In continuous time there is no such delay."""
    confirmed = settled and all(holds for holds, _ in judged)
    reading = settled and all(one for _, one in judged)
    return Found(confirmed, [*(one[_LONG] for one in beats), *departs], note, reading)


def _trap(gain: float, step_s: float) -> SampledRun:
    """Sampled, an error paired with the input that was given after it."""
    errors = cruise.FishTask(gain, step_s=step_s, pairing=0).problem().uncut(_LONG)
    return _sampled(errors, step_s)


def _sampled(errors: F64, step_s: float) -> SampledRun:
    """Promised is that it falls. It departs where it is twice the least so far and 10 % of the
    first."""
    least = np.minimum.accumulate(errors)
    grown = np.flatnonzero((errors > 2 * least) & (errors > 0.1 * errors[0]))
    falls = bool(errors[: _FIGURE_LAST + 1].min() < _PART_OF_PEAK * errors[0])
    return SampledRun(step_s, falls, int(grown[0]) if len(grown) else None)


def _beats(gain: float, last: int) -> F64:
    return cruise.FishTask(gain).problem().uncut(last)


def _first_at(gain: float) -> float:
    return _reached(_beats(gain, _LONG))


def _reached(errors: F64) -> float:
    """The iteration that first reaches 2 mm/s."""
    below = np.flatnonzero(errors < _REACHED_M_S)
    return float(below[0]) if len(below) else math.inf


_REACHED_M_S = 0.002


@claim(GAIN4, "8-small-gain")
def _small_gain(study: Study) -> Found:
    needed = [_first_at(gain) for gain in (1.0, 2.0, 4.0)]
    return Found(_falling(needed), needed, "Iterations to 2 mm/s, gains 1, 2 and 4.")


def _falling(values: ArrayLike) -> bool:
    return bool(np.all(np.diff(values) < 0))


@claim(GAIN10, "8-oscillates")
def _oscillates(study: Study) -> Found:
    beats = np.arange(cruise.BEATS)
    found = cruise.FishTask(study.setting).problem().run(5, keep=range(6))
    cruising = (beats >= 10) & (beats < 30)
    means = [
        float((found.problem.reference - found.trial(i)[1])[cruising].mean()) for i in range(6)
    ]
    changes = np.count_nonzero(np.diff(np.sign(means)))
    note = f"Mean error from 10 to 30 s, m/s, iterations 0 to 5: {changes} changes of sign."
    return Found(changes == 5, means, note)


@claim(GAIN7, "8-fastest")
def _fastest(study: Study) -> Found:
    needed = [_first_at(gain) for gain in GAINS]
    note = "Iterations to 2 mm/s, gains 4, 7 and 10."
    return Found(needed[1] < min(needed[0], needed[2]), needed, note)


@claim(GAIN4, "8-gain-4")
def _gain4_slower(study: Study) -> Found:
    needed = [_first_at(gain) for gain in (4.0, 7.0)]
    return Found(needed[0] > needed[1], needed, "Iterations to 2 mm/s, gains 4 and 7.")


@claim(GAIN10, "8-gain-10")
def _gain10_slow(study: Study) -> Found:
    needed = [_first_at(gain) for gain in (7.0, 10.0)]
    found = cruise.FishTask(study.setting).problem().run(1)
    over = float((found.trial()[1] - found.problem.reference).max()) / _PEAK_M_S
    note = """Iterations to 2 mm/s, gains 7 and 10; overshoot of iteration 1 over the peak of the
    reference."""
    return Found(needed[1] > needed[0] and over >= 0.1, [*needed, over], note)


@claim(GAIN10, "8-saturated-once")
def _saturated_once(study: Study) -> Found:
    shown = (1, 2, 4, 6)
    found = cruise.FishTask(study.setting).problem().run(6, keep=shown)
    largest = [float(cruise.applied(found.trial(i)[0]).max()) for i in shown]
    note = "Largest amplitude that is applied at iterations 1, 2, 4 and 6, rad; pi/4 is 0.7854."
    limit = cruise.AMPLITUDE_MAX_RAD - 1e-9
    return Found(largest[0] >= limit > max(largest[1:]), largest, note)


@claim(GAIN4, "8-gradual")
def _gradual(study: Study) -> Found:
    errors = study.run(iterations=6).max_abs_error[[1, 2, 4, 6]]
    return Found(_falling(errors), errors, "max|e| of iterations 1, 2, 4 and 6, m/s.")


@claim(GAIN4, "8-invisible")
def _invisible(study: Study) -> Found:
    share = study.run(iterations=6).max_abs_error[6] / _PEAK_M_S
    return Found(share < _LINE_WIDTH, share, "max|e| of iteration 6 over the peak of (8.31).")


@claim(GAIN4, "8-contracts")
def _contracts(study: Study) -> Found:
    angles, speeds = np.array(cruise.TABLE_8_1).T
    slopes = np.diff(speeds) / np.diff(angles)
    factors = [float(np.abs(1 - gain * slopes).max()) for gain in GAINS]
    note = f"""Largest |1 - gain * slope| between the rows of the table, {slopes.min():.3f} to
    {slopes.max():.3f} m/s/rad; above 1 an error grows from trial to trial. Hard limit: gain
    {2 / slopes.max():.1f}."""
    return Found(max(factors) < 1, factors, note)


@claim(GAIN4, "8-tank-length")
def _fits_the_tank(study: Study) -> Found:
    longest = []
    for gain in GAINS:
        found = cruise.FishTask(gain).problem().run(6, keep=range(6))
        longest.append(max(float(found.trial(i)[1].sum()) for i in range(7)))
    note = f"""The longest of six trials, m; (8.31) itself covers
    {cruise.reference_beats().sum():.2f} m, the fish is {_LENGTH_M:g} m long."""
    return Found(max(longest) + _LENGTH_M <= _TANK_M, longest, note)


@claim(GAIN4, "8-tank-oscillates")
def _speed_oscillates(study: Study) -> Found:
    found = cruise.FishTask(study.setting).problem().run(6)
    beats = found.problem.times
    error = (found.problem.reference - found.trial()[1])[(beats > 10) & (beats <= 30)]
    signs = np.count_nonzero(np.diff(np.sign(error)))
    note = f"""m/s from least to largest error there, {signs} changes of sign: the model has neither
    delay nor waves, so that it cannot refute what was seen in the tank."""
    return Found(False, np.ptp(error), note, decided=False)


@claim(GAIN4, "8-at-40-s")
def _speed_at_the_end(study: Study) -> Found:
    left = cruise.FishTask(study.setting, step_s=0.01).problem().run(6).trial()[1][-1]
    note = "m/s; without reverse thrust the drag alone cannot stop the fish in time."
    return Found(left > 1e-4, left, note)


@claim(GAIN4, "8-saturation-first")
def _saturation_first(study: Study) -> Found:
    needed = [_recovery(study.setting, remembered) for remembered in (True, False)]
    note = f"""Trials until max|e| is 80 % down again after six trials of a target {_FASTER:g} times
    too fast, sampled at 0.1 s: saturated, and not saturated in memory."""
    return Found(needed[0] < needed[1], needed, note)


def _recovery(gain: float, remembered_sat: bool) -> float:
    task = cruise.FishTask(
        gain, step_s=0.1, remembered_sat=remembered_sat,
        target=lambda i: _FASTER if i < 6 else 1.0,
    )  # fmt: skip
    below = np.flatnonzero(task.problem().uncut(30)[6:] < 0.2 * _PEAK_M_S)
    return float(below[0]) if len(below) else math.inf


@claim(GAIN4, "8-drag")
def _drag(study: Study) -> Found:
    angles, speeds = np.array(cruise.TABLE_8_1).T
    h1, h2 = cruise.CruisePlant(1.0).thrust(angles)
    force = h1 - h2 * speeds**2
    fitted = float(np.sum(force * speeds**2) / np.sum(speeds**4))
    off = abs(fitted / _DRAG_KG_M - 1)
    note = f"""Least squares of thrust over drag, {off:.1e} off; row by row
    {", ".join(f"{one:.1f}" for one in force / speeds**2)}."""
    return Found(off < 1e-3, f"{fitted:.4f}", note)


@claim(GAIN4, "8-table")
def _table(study: Study) -> Found:
    angles, speeds = np.array(cruise.TABLE_8_1).T
    model = cruise.CruisePlant(1.0).steady_m_s(angles)
    off = np.abs(model / speeds - 1)
    slope, speed_at_0 = np.polyfit(angles, speeds, 1)
    dead = np.rad2deg(-speed_at_0 / slope)
    note = f"""m/s, off by {", ".join(f"{one:.0%}" for one in off)}: the line through the measured
    rows is at rest below {dead:.0f} degrees, the model swims there."""
    return Found(off.max() < 0.05, model, note)


@claim(GAIN4, "8-reference-joins")
def _reference_joins(study: Study) -> Found:
    at_10, after = thesis_speed(np.array([10.0, 10.0 + 1e-9]))
    jump = abs(at_10 - after)
    return Found(jump < 1e-5, at_10, f"m/s, {1e6 * jump:.1f} um/s beside the printed 0.0791.")


@claim(GAIN4, "8-desired-input")
def _reference_is_realizable(study: Study) -> Found:
    t = np.linspace(0, cruise.DURATION_S, 40001)
    return realizable(t, thesis_speed(t))


def realizable(t: F64, v: F64) -> Found:
    """Whether the fish can swim at the speeds ``v`` without braking."""
    config = cruise.CruisePlant(1.0).config
    force = config.mass_kg * np.gradient(v, t) + config.drag_kg_m * v**2
    force[np.abs(np.gradient(v, t)) > 0.02] = 0  # the steps of a micrometre at 10 and 30 s
    braking = t[force < -1e-9]
    if len(braking) == 0:
        return Found(True, "everywhere")
    note = """From there on the fish would have to brake, and it can only coast: the error that is
    left is at the end."""
    return Found(False, f"until {braking[0]:.2f} s", note)


@claim(GAIN4, "8-lemma-8.1")
def _slope_is_positive(study: Study) -> Found:
    angles = np.linspace(0, cruise.AMPLITUDE_MAX_RAD, 500)
    small = np.array([0.0, 1e-7])
    (h1, h2), (near1, near2) = (cruise.CruisePlant(1.0).thrust(one) for one in (angles, small))
    speeds = (0.0, 0.05, 0.1)
    least = min(np.gradient(h1 - h2 * v**2, angles)[1:].min() for v in speeds)
    at_rest = max(abs(np.diff(near1)[0] - np.diff(near2)[0] * v**2) / small[1] for v in speeds)
    note = """N/rad at amplitude 0, and the least above it up to pi/4: true of amplitudes above 0;
    at 0, where every series begins, the slope is 0, and in a dead zone it stays so."""
    return Found(least > 0 and at_rest > 1e-6, [at_rest, least], note, least > 0)
