"""Chapter 6's law on chapter 6's rod, with the thesis's numbers (section 6.6) and others."""

from __future__ import annotations

from tailbeat.thesis.arrays import Doubles
from tailbeat.thesis.example import Run
from tailbeat.thesis.heat import CHAPTER6, STEP, heat_plant, times
from tailbeat.thesis.heat_trials import asked, learn, slope, window, zero_phase
from tailbeat.thesis.learner import LearnerConfig
from tailbeat.thesis.options import Options

RHO = 0.7444
WINDOW = 0.2  # min; N0 = 20 samples of 0.6 s
Q_LEN = 20  # of the thesis's step
ITERATIONS = 7
LONG = 50  # iterations that show whether noise grows


def law(step: float = STEP, rho: float = RHO, q_len: int | None = None) -> LearnerConfig:
    """(6.31) with rho * s and (6.42): the filter acts on input plus correction."""
    return LearnerConfig(
        samples=len(times(step)),
        step=step,
        kd=rho,
        q_len=window(WINDOW, step) if q_len is None else q_len,
    )


def run(options: Options) -> Run:
    """The rod by backward Euler on 100 cells."""
    step, iterations = asked(options, ITERATIONS)
    return learn(heat_plant(CHAPTER6, step), law(step), iterations, options.precision)


def settings(options: Options) -> dict[str, int | float]:
    """What ``run`` uses."""
    step, iterations = asked(options, ITERATIONS)
    return {"iterations": iterations, "step": step}


def exact(config: LearnerConfig, iterations: int) -> Run:
    """Any law of the thesis's step on the exact rod."""
    return learn(heat_plant(CHAPTER6, scheme="modal"), config, iterations)


def with_filter(iterations: int) -> Run:
    """As the thesis has it."""
    return exact(law(), iterations)


def without_filter(iterations: int) -> Run:
    """(6.19)."""
    return exact(law(q_len=1), iterations)


def with_filter_on_the_correction(iterations: int) -> Run:
    """u + rho * Q(de/dt), as the words of section 6.5 may be read."""

    def filtered(error: Doubles) -> Doubles:
        return zero_phase(slope(error), Q_LEN)

    config = LearnerConfig(samples=len(times(STEP)), step=STEP, kp=RHO)
    return learn(heat_plant(CHAPTER6, scheme="modal"), config, iterations, prepare=filtered)


def with_filter_on_the_error(iterations: int) -> Run:
    """u + rho * d/dt Q(e), the other way to read them."""

    def filtered(error: Doubles) -> Doubles:
        return zero_phase(error, Q_LEN)

    plant = heat_plant(CHAPTER6, scheme="modal")
    return learn(plant, law(q_len=1), iterations, prepare=filtered)
