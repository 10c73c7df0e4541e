"""Chapter 8: the robotic fish learns (8.31) by the law (8.16), gains 4, 7 and 10.

By default as the fish does it: one amplitude per beat, errors of beat means. With a step: sampled
control, the amplitude held for a step and paired with the error at its end.

The thesis's text does not say which curves its figures show; these are what the text around them
is about.
"""

from __future__ import annotations

import math

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.reference import thesis_speed
from tailbeat.report.style import Axes
from tailbeat.studies.thesis.example import Example, Found, claim, figure
from tailbeat.studies.thesis.picture import LINES, REFERENCE, Curve, Panel, Panels, errors, level
from tailbeat.studies.thesis.plants import cruise
from tailbeat.studies.thesis.study import Study

GAIN4, GAIN7, GAIN10 = EXAMPLES = tuple(
    Example(
        f"ch8-sim-{gain:g}", f"Robotic fish (8.13), gain {gain:g}, m/s",
        "P with saturation (8.16)", gain, cruise.prepare,
        knows=frozenset({"lengths", "seed", "step", "iterations"}), weight=2.0,
    )
    for gain in (4.0, 7.0, 10.0)
)  # fmt: skip

_LONG = 40  # iterations that show whether a law stays where it got to
_TRAP_STEP_S = 0.1
_DRAG_KG_M = 165.7056
_LENGTH_M, _TANK_M = 0.36, 3.0
_FASTER = 1.9  # factor on a reference that nobody can follow
_PEAK_M_S = float(cruise.reference_beats().max())


def _settled(values: F64) -> bool:
    """Down by 90 % and, from the least error on, never up again by more than 5 %."""
    least = int(np.argmin(values))
    return bool(values[least] < 0.1 * values[0] and values[least:].max() <= 1.05 * values[least])


@claim(GAIN4, "max|e| falls by more than 80 % within 6 iterations at gain 4", "experiment, (8.16)")
def _eighty_percent(study: Study) -> Found:
    found = study.run(iterations=6).max_abs_error
    down = 1 - found.min() / found[0]
    note = """The reading: of the model (8.13), in beat means. The thesis tells it of its tank, one
    profile, one gain, no repeats."""
    return Found(False, down, note, down > 0.8)  # the tank's own record is not printed


@claim(EXAMPLES, "any gain above 0 converges: gain {:g}", "Theorem 8.1, (8.14)")
def _converges(study: Study) -> Found:
    beats = study.run(iterations=_LONG).max_abs_error
    trap = cruise.FishTask(study.setting, step_s=_TRAP_STEP_S, pairing=0).problem().uncut(_LONG)
    by_beats, sampled = _settled(beats), _settled(trap)
    note = f"""max|e| in iteration {_LONG}, m/s: when a beat's amplitude learns from the mean error
    of that beat; and sampled at {_TRAP_STEP_S:g} s when u(k) learns from e(k), the speed before it
    acts (least {trap.min():.4f} in iteration {trap.argmin()}, then it grows). The theorem is of
    continuous time and a weighted norm."""
    return Found(by_beats and sampled, [beats[_LONG], trap[_LONG]], note, by_beats)


@claim(
    EXAMPLES, "any gain above 0 converges: gain {:g} on the fish as it was measured",
    "(8.14), Table 8.1", ours=True,
)  # fmt: skip
def _contracts(study: Study) -> Found:
    angles, speeds = np.array(cruise.TABLE_8_1).T
    slopes = np.diff(speeds) / np.diff(angles)
    factors = np.abs(1 - study.setting * slopes)
    note = f"""|1 - gain * slope| between the rows of the table, {slopes.min():.3f} to
    {slopes.max():.3f} m/s/rad; above 1 an error grows from trial to trial. Hard limit: gain
    {2 / slopes.max():.1f}."""
    return Found(factors.max() < 1, np.sort(factors), note)


@claim(EXAMPLES, f"gain {{:g}} can be tried in the tank of {_TANK_M:g} m", "experiment", ours=True)
def _fits_the_tank(study: Study) -> Found:
    found = cruise.FishTask(study.setting).problem().run(6, keep=range(6))
    travel = [found.trial(i)[1].sum() for i in range(7)]
    note = f"""The longest of six trials, m, number {np.argmax(travel)}; (8.31) itself covers
    {cruise.reference_beats().sum():.2f} m, the fish is {_LENGTH_M:g} m long."""
    return Found(max(travel) + _LENGTH_M <= _TANK_M, max(travel), note)


@claim((GAIN7, GAIN10), "a larger gain learns faster: {:g} against 4", "simulation", ours=True)
def _learns_faster(study: Study) -> Found:
    gain = study.setting
    low = cruise.FishTask(GAIN4.setting).problem().uncut(_LONG)
    needed = [_first_below(one) for one in (low, study.run(iterations=_LONG).max_abs_error)]
    note = f"Iterations until max|e| is 80 % down, gain 4 and {gain:g}. {_after_first(gain)}"
    return Found(needed[1] < needed[0], needed, note)


def _after_first(gain: float) -> str:
    found = cruise.FishTask(gain).problem().run(1)
    overshoots = -(found.problem.reference - found.trial()[1]).min()
    largest = gain * _PEAK_M_S
    words = f"The first trial asks for {largest:.3f} rad"
    words += " (saturated)" if largest > cruise.AMPLITUDE_MAX_RAD else ""
    return f"{words} and swims up to {1e3 * max(overshoots, 0):.0f} mm/s too fast."


def _first_below(values: F64) -> float:
    """The iteration from which the error is 80 % down."""
    below = np.flatnonzero(values < 0.2 * values[0])
    return float(below[0]) if len(below) else math.inf


@claim(GAIN4, "after 6 iterations the speed still oscillates in [10, 30] s", "experiment")
def _speed_oscillates(study: Study) -> Found:
    found = cruise.FishTask(study.setting).problem().run(6)
    beats = found.problem.times
    error = (found.problem.reference - found.trial()[1])[(beats > 10) & (beats <= 30)]
    signs = np.count_nonzero(np.diff(np.sign(error)))
    note = f"""m/s from least to largest error there, {signs} changes of sign: the model has neither
    delay nor waves; what oscillated in the tank is not in (8.13)."""
    return Found(signs > 2 and np.ptp(error) > 1e-3, np.ptp(error), note)


@claim(GAIN4, "after 6 iterations the speed is not zero at 40 s", "experiment")
def _speed_at_the_end(study: Study) -> Found:
    left = cruise.FishTask(study.setting, step_s=0.01).problem().run(6).trial()[1][-1]
    note = "m/s; without reverse thrust the drag alone cannot stop the fish in time."
    return Found(left > 1e-4, left, note)


@claim(
    GAIN4, "saturating the stored input before it is corrected keeps it from winding up",
    "(8.16)", ours=True,
)  # fmt: skip
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


@claim(GAIN4, f"the drag fitted to Table 8.1 is {_DRAG_KG_M:g} kg/m", "(8.12), Table 8.1")
def _drag(study: Study) -> Found:
    angles, speeds = np.array(cruise.TABLE_8_1).T
    h1, h2 = cruise.CruisePlant(1.0).thrust(angles)
    force = h1 - h2 * speeds**2
    fitted = float(np.sum(force * speeds**2) / np.sum(speeds**4))
    off = abs(fitted / _DRAG_KG_M - 1)
    note = f"""Least squares of thrust over drag, {off:.1e} off; row by row
    {", ".join(f"{one:.1f}" for one in force / speeds**2)}."""
    return Found(off < 1e-3, f"{fitted:.4f}", note)


@claim(GAIN4, "(8.13) with this drag swims at the speeds of Table 8.1", "Table 8.1")
def _table(study: Study) -> Found:
    angles, speeds = np.array(cruise.TABLE_8_1).T
    model = cruise.CruisePlant(1.0).steady_m_s(angles)
    off = np.abs(model / speeds - 1)
    slope, speed_at_0 = np.polyfit(angles, speeds, 1)
    dead = np.rad2deg(-speed_at_0 / slope)
    note = f"""m/s, off by {", ".join(f"{one:.0%}" for one in off)}: the line through the measured
    rows is at rest below {dead:.0f} degrees, the model swims there."""
    return Found(off.max() < 0.05, model, note)


@claim(GAIN4, "the parts of (8.31) meet at 10 s", "(8.31)")
def _reference_joins(study: Study) -> Found:
    at_10, after = thesis_speed(np.array([10.0, 10.0 + 1e-9]))
    jump = abs(at_10 - after)
    return Found(jump < 1e-5, at_10, f"m/s, {1e6 * jump:.1f} um/s beside the printed 0.0791.")


@claim(GAIN4, "there is an input whose speed is (8.31)", "(8.14)")
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


@claim(GAIN4, "thrust rises with the amplitude: dF/d(amplitude) > 0", "Lemma 8.1")
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


_SHOWN = (1, 2, 3, 6)


@figure(
    GAIN4, "fig8-3.png", "Fig. 8.3",
    "speed and amplitude by beats, gain 4, with the reference",
)  # fmt: skip
def _speeds(study: Study) -> Panels:
    found = cruise.FishTask(study.setting).problem().run(max(_SHOWN), keep=_SHOWN)
    mid_s = np.arange(cruise.BEATS) + 0.5
    styles = [style | {"drawstyle": "steps-mid"} for style in LINES]
    speeds = [Curve(mid_s, 1e3 * cruise.reference_beats(), "reference (8.31)", REFERENCE)]
    amplitudes = []
    for i, style in zip(_SHOWN, styles, strict=False):
        values, speed = found.trial(i)
        speeds.append(Curve(mid_s, 1e3 * speed, f"iteration {i}", style))
        amplitudes.append(Curve(mid_s, cruise.applied(values), "", style))
    above = {"ylabel": "speed, mean over a beat, mm/s", "ylim": (0, 118)}
    below = {"ylabel": "amplitude, rad", "xlabel": "t, s"}
    return Panels([Panel(speeds, above, columns=3), Panel(amplitudes, below)], across=False)


@figure(GAIN4, "fig8-4.png", "Fig. 8.4", "largest error over the iterations, gains 4, 7 and 10")
def _errors(study: Study) -> Panel:
    found = {
        f"gain {one.setting:g}": 1e3 * cruise.FishTask(one.setting).problem().uncut(20)
        for one in EXAMPLES
    }

    def down(axes: Axes) -> None:
        level(axes, 0.2 * 79.1, "80 % down")

    name = "max|e| over the beats, mm/s"
    return errors(found, marker=6, columns=3, more=down, ylabel=name)


@figure(
    GAIN4, "figA-1.png", "Fig. A.1",
    "thrust (8.5)-(8.10) and its slope, which Lemma 8.1 needs above 0",
)  # fmt: skip
def _thrust(study: Study) -> Panels:
    angles = np.linspace(0, cruise.AMPLITUDE_MAX_RAD, 300)
    fish = cruise.CruisePlant(1.0)
    h1, h2 = fish.thrust(angles)
    forces, slopes = [], []
    for v, style in zip((0.0, 0.1, 0.2), LINES, strict=False):
        force = h1 - h2 * v**2
        forces.append(Curve(angles, force, f"v = {v:g} m/s", style))
        slopes.append(Curve(angles, np.gradient(force, angles, edge_order=2), "", style))
    measured, speeds = np.array(cruise.TABLE_8_1).T
    dots = {"marker": "o", "ls": "", "color": "0.15", "mfc": "white"}
    forces.append(Curve(measured, fish.config.drag_kg_m * speeds**2, "drag at Table 8.1", dots))
    limits = {"xlim": (0, 0.8), "ylim": (0, None)}
    above = {"ylabel": "thrust F, N", **limits}
    below = {"ylabel": "dF/d(amplitude), N/rad", "xlabel": "amplitude, rad", **limits}
    return Panels([Panel(forces, above), Panel(slopes, below)], across=False)
