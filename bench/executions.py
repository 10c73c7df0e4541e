"""How many trials an unknown fish executes until an input is at its error bound, three ways.

``P``: the board's law with its default gain and lead from the first trial on. ``measured``: one
measuring run, then the model-based law, as ``tailbeat start``. ``fitted``: P until a model fitted
to the trials promises less error than the first had, as ``tailbeat trial run`` alone. The measuring
run counts; the two trim runs, which come first whichever way is taken, do not. P and fitted are
allowed 1 rad from the start, as no operator of an unknown fish would. At the bound: max|e| of the
input on the noise-free fish is at most 1.10 times the smallest possible one and 0.5 mm/s.
Usage: executions.py [FISH FIRST_SEED]
"""

from __future__ import annotations

import os
import secrets
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from causes import MOST_RAD, Fish, Series, settings_of
from sessions import NEAR, NEAR_M_S, WANTED

from tailbeat.core.arrays import F64
from tailbeat.core.law import Law
from tailbeat.core.reference import thesis
from tailbeat.learning.belief import Beliefs
from tailbeat.learning.identification import any_fish
from tailbeat.learning.model_law import ModelStepSetting, propose_by
from tailbeat.studies.montecarlo.populations import still
from tailbeat.studies.montecarlo.smallest_error import smallest_errors

MOST = 15  # trials
P_LAW = Law(kp_rad_s_m=4.0, lead_beats=1)
MEASURING_RUNS = 1
WAYS = ("P", "measured", "fitted")


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    fish: int
    plants: tuple[str, ...] = ("tank", "mild", "realistic")


FULL, TINY = Load(5), Load(1, ("tank",))


@dataclass(frozen=True)
class Row:
    """Executions of each way in the order of ``WAYS``; None: not within ``MOST`` trials."""

    plant: str
    executions: tuple[int | None, ...]


def row_of(job: tuple[str, int]) -> Row:
    plant, seed = job
    limit = NEAR * bound_m_s(plant, seed) + NEAR_M_S
    ways = (by_p(plant, seed, limit), by_measuring(plant, seed, limit), by_fit(plant, seed, limit))
    return Row(plant, ways)


def bound_m_s(plant: str, seed: int) -> float:
    fish = Fish(plant, seed, {})
    start = Series(fish, fish.measured(), thesis(), MOST_RAD, None).planned()
    kind = "tank" if plant == "tank" else "reactive"
    settings = still(settings_of(plant, seed) | {"seed": seed})
    return float(smallest_errors(kind, settings, WANTED, 1.0, MOST_RAD, [start])[0][0])


def by_p(plant: str, seed: int, limit_m_s: float) -> int | None:
    fish = Fish(plant, seed, {})
    return first_near(Series(fish, any_fish(), thesis(), MOST_RAD, P_LAW), limit_m_s)


def by_measuring(plant: str, seed: int, limit_m_s: float) -> int | None:
    fish = Fish(plant, seed, {})
    found = first_near(Series(fish, fish.measured(), thesis(), MOST_RAD, None), limit_m_s)
    return None if found is None else MEASURING_RUNS + found


def by_fit(plant: str, seed: int, limit_m_s: float) -> int | None:
    fish = Fish(plant, seed, {})
    return first_near(Fitted(fish, any_fish(), thesis(), MOST_RAD, P_LAW), limit_m_s)


def first_near(series: Series, limit_m_s: float) -> int | None:
    """The number of the first trial whose input is at the bound."""
    return next((n for n in range(1, MOST + 1) if series.executed() <= limit_m_s), None)


class Fitted(Series):
    """The model's input as soon as it is expected, at 95 %, to do better than the first trial."""

    def __post_init__(self) -> None:
        self.beliefs = Beliefs(any_fish())

    def planned(self) -> F64:
        if self.trials:
            setting = ModelStepSetting(self.reference, self.limit_rad, law=P_LAW)
            found = propose_by(self.beliefs.after(self.trials), setting, self.trials)
            first = np.nanmax(np.abs(self.reference.speed_m_s - self.trials[0].speed_m_s))
            if found.law != "p" and found.predicted_max_abs_error_m_s[2] < first:
                return found.amplitude_rad
        return super().planned()


def main(load: Load = FULL, arguments: Sequence[str] = ()) -> int:
    """A row for each plant: median executions, and how many fish needed no more than five."""
    fish = int(arguments[0]) if arguments else load.fish
    first = int(arguments[1]) if len(arguments) > 1 else secrets.randbits(30)
    print(f"{fish} fish of each plant, seeds from {first} on")
    with ProcessPoolExecutor(2) as pool:
        jobs = list(product(load.plants, range(first, first + fish)))
        rows = list(pool.map(row_of, jobs))
    for plant in load.plants:
        of = [row.executions for row in rows if row.plant == plant]
        print(f"{plant:9} " + "; ".join(map(way_text, WAYS, zip(*of, strict=True))))
    return 0


def way_text(way: str, counts: Sequence[int | None]) -> str:
    never = sum(count is None for count in counts)
    low, median, high = np.quantile(
        [count or np.inf for count in counts], (0.1, 0.5, 0.9), method="higher"
    )
    lost = f", {never} never" if never else ""
    return f"{way}: {median:g} executions (10 to 90 %: {low:g} to {high:g}{lost})"


if __name__ == "__main__":
    raise SystemExit(main(FULL, sys.argv[1:]))
