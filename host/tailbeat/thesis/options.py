"""What may be asked of an example beyond the thesis's own settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from tailbeat.thesis.native import Precision

if TYPE_CHECKING:
    from tailbeat.thesis.advection import Uptake


@dataclass(frozen=True)
class Options:
    """None = as the thesis has it. An example refuses those that it does not know
    (``Example.knows``) when it is asked for by name."""

    lengths: str | None = None  # how long the trials are: see tailbeat.thesis.lengths
    seed: int = 1  # of what is drawn
    step: float | None = None  # integration and control step, in the example's unit of time
    iterations: int | None = None  # the last iteration; the first is 0, in chapters 4 and 5 1
    m: int | None = None  # of the moving average (chapter 3): m + 1 trials
    beta: float | None = None  # gain of each of these trials; None: 1/(m + 1)
    delta: float | None = None  # lead (chapter 7), min
    uptake: Uptake | None = None  # phi below v = 0 (chapter 7): see AdvectionPlant
    precision: Precision = "double"  # of the laws; the plants always compute in double
