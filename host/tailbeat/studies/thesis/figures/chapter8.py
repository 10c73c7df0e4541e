"""Figures 8.3 to 8.9 and A.1. 8.1, 8.2 and 8.10 are drawings and a photograph, 8.11 and 8.12 come
from the tank."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tailbeat.core.reference import thesis_speed
from tailbeat.studies.thesis.chapter8 import FEEDBACK_GAINS, GAIN4, GAIN7, GAIN10, GAINS
from tailbeat.studies.thesis.example import figure
from tailbeat.studies.thesis.picture import LINES, REFERENCE, Curve, Panel, Panels, errors
from tailbeat.studies.thesis.plants import cruise
from tailbeat.studies.thesis.study import Study

_STEP_S = 0.1
_LAST = 10
_SHOWN = (1, 2, 4, 6)
_HALF_RHO_AREA = 1000 * 0.165**2 * np.pi / 4 / 2  # kg/m: (8.5)
_SECONDS = "$t$ (s)"


def _squares(amplitude_rad: Sequence[float], frequency_hz: Sequence[float]) -> tuple[Panel, Panel]:
    """(8.6) and (8.7), over whichever of both varies. At 1 Hz the firmware's simulator has them;
    dh/dt goes with the frequency, dh/dx does not depend on it."""
    amplitude, frequency = np.array(amplitude_rad), np.array(frequency_hz)
    h1, h2 = cruise.CruisePlant(1.0).thrust(amplitude)
    velocity, slope = h1 / _HALF_RHO_AREA * frequency**2, h2 / _HALF_RHO_AREA * frequency**0
    over_frequency = len(frequency) > 1
    x = frequency if over_frequency else amplitude
    label = "$f$ (Hz)" if over_frequency else r"$\theta_m$ (rad)"
    return (
        Panel(
            [Curve(x, velocity * np.ones_like(x))],
            {"xlabel": label, "ylabel": r"$\overline{(\partial h/\partial t)^2}$ (m$^2$/s$^2$)"},
        ),
        Panel(
            [Curve(x, slope * np.ones_like(x))],
            {"xlabel": label, "ylabel": r"$\overline{(\partial h/\partial x)^2}$"},
        ),
    )


@figure(GAIN4, "8.3", "squares of the tail's velocity and slope, means of a cycle, over amplitude.")
def _over_amplitude(study: Study) -> Panels:
    amplitudes = np.linspace(0, cruise.AMPLITUDE_MAX_RAD, 200)
    return Panels(_squares(amplitudes.tolist(), [1.0]))


@figure(GAIN4, "8.4", "squares of the tail's velocity and slope, means of a cycle, over frequency.")
def _over_frequency(study: Study) -> Panels:
    return Panels(_squares([np.pi / 6], np.linspace(0, 2, 101).tolist()))


@figure(GAIN4, "8.5", "reference speed (8.31).")
def _reference(study: Study) -> Panel:
    t = np.linspace(0, cruise.DURATION_S, 2001)
    return Panel([Curve(t, thesis_speed(t))], {"xlabel": _SECONDS, "ylabel": "$v_d$ (m/s)"})


@figure(GAIN7, "8.6", "largest error over the iterations for gains 4, 7 and 10.")
def _errors(study: Study) -> Panel:
    found = {
        rf"$\gamma = {gain:g}$": cruise.FishTask(gain, step_s=_STEP_S).problem().uncut(_LAST)
        for gain in GAINS
    }
    return errors(found, marker=6, columns=3, ylabel=r"$\max_t\,|e_i(t)|$ (m/s)")


def _speeds(gain: float) -> Panel:
    found = cruise.FishTask(gain, step_s=_STEP_S).problem().run(max(_SHOWN), keep=_SHOWN)
    times = found.problem.times
    curves = [Curve(times, found.problem.reference, "$v_d$", REFERENCE)]
    for i, style in zip(_SHOWN, LINES, strict=False):
        curves.append(Curve(times, found.trial(i)[1], f"$v_{i}$", style))
    return Panel(curves, {"xlabel": _SECONDS, "ylabel": "$v$ (m/s)"}, columns=5)


@figure(GAIN10, "8.7", "speeds of iterations 1, 2, 4 and 6, gain 10.")
@figure(GAIN4, "8.9", "speeds of iterations 1, 2, 4 and 6, gain 4.")
def _speeds_of(study: Study) -> Panel:
    return _speeds(study.setting)


@figure(GAIN10, "8.8", "inputs of iterations 1, 2, 4 and 6, gain 10, saturated at pi/4.")
def _inputs(study: Study) -> Panel:
    found = cruise.FishTask(study.setting, step_s=_STEP_S).problem().run(max(_SHOWN), keep=_SHOWN)
    curves = [
        Curve(found.problem.times, cruise.applied(found.trial(i)[0]), rf"$\theta_{{m,{i}}}$", style)
        for i, style in zip(_SHOWN, LINES, strict=False)
    ]
    labels = {"xlabel": _SECONDS, "ylabel": r"$\theta_m$ (rad)"}
    return Panel(curves, labels, [cruise.AMPLITUDE_MAX_RAD], columns=4)


@figure(
    GAIN4, "8-table", "Table 8.1 of the thesis, measured in its tank, and steady speed of (8.13)."
)
def _table(study: Study) -> Panel:
    angles, speeds = np.array(cruise.TABLE_8_1).T
    grid = np.linspace(0, cruise.AMPLITUDE_MAX_RAD, 200)
    curves = [
        Curve(grid, cruise.CruisePlant(1.0).steady_m_s(grid), "(8.13)"),
        Curve(angles, speeds, "Table 8.1", {"color": "0.15", "marker": "o", "ls": "none"}),
    ]
    return Panel(curves, {"xlabel": r"$\theta_m$ (rad)", "ylabel": "steady $v$ (m/s)"})


@figure(
    GAIN4, "8-first-input", "largest error, gain 4, from zero and from a PI controller's input."
)
def _first_input(study: Study) -> Panel:
    first = cruise.feedback_input(*FEEDBACK_GAINS)
    found = {
        "from zero": cruise.FishTask(4.0).problem().uncut(_LAST),
        "from a PI controller": cruise.FishTask(4.0, first_input=first).problem().uncut(_LAST),
    }
    return errors(found, marker=6, ylabel=r"$\max_t\,|e_i(t)|$ (m/s)")


@figure(GAIN4, "A.1", "gradient of the thrust over the amplitude, at three speeds.")
def _gradient(study: Study) -> Panel:
    angles = np.linspace(0, cruise.AMPLITUDE_MAX_RAD, 300)
    h1, h2 = cruise.CruisePlant(1.0).thrust(angles)
    curves = [
        Curve(angles, np.gradient(h1 - h2 * v**2, angles, edge_order=2), f"$v = {v:g}$ m/s", style)
        for v, style in zip((0.0, 0.1, 0.2), LINES, strict=False)
    ]
    labels = {"xlabel": r"$\theta_m$ (rad)", "ylabel": r"$\partial F/\partial\theta_m$ (N/rad)"}
    return Panel(curves, labels)


@figure(GAIN4, "8-beats", "speeds and amplitudes by beats, as the board learns them, gain 4.")
def _by_beats(study: Study) -> Panels:
    found = cruise.FishTask(study.setting).problem().run(max(_SHOWN), keep=_SHOWN)
    edges = np.arange(cruise.BEATS + 1)
    last = np.append(cruise.reference_beats(), 0.0)
    speeds = [Curve(edges, last, "reference (8.31)", REFERENCE | {"drawstyle": "steps-post"})]
    amplitudes = []
    for i, look in zip(_SHOWN, LINES, strict=False):
        values, speed = found.trial(i)
        style = look | {"drawstyle": "steps-post"}
        speeds.append(Curve(edges, np.append(speed, speed[-1]), f"iteration {i}", style))
        held = cruise.applied(values)
        amplitudes.append(Curve(edges, np.append(held, held[-1]), "", style))
    above = {"ylabel": "speed, mean over a beat (m/s)"}
    below = {"ylabel": "amplitude (rad)", "xlabel": _SECONDS}
    return Panels([Panel(speeds, above, columns=3), Panel(amplitudes, below)], across=False)
