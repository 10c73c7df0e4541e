"""Wrong results planted into laws and plants of the thesis, one at a time: which verdicts and which
figures' checks they change. A process of its own for each, for much is kept once it was computed.

Usage: planted.py NAME. Prints the verdicts and the contradictions of figures as JSON.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from tailbeat.studies.thesis import chapter3, chapter9, registry
from tailbeat.studies.thesis.example import Example
from tailbeat.studies.thesis.plants import advection, cruise, escaping, heat, linear, rod
from tailbeat.studies.thesis.series import LearningProblem
from tailbeat.studies.thesis.study import Study

PLANTED: dict[str, tuple[int, Callable[[], None]]] = {}
"""Name -> (chapter, what plants it)."""
_settings: dict[str, dict[str, Any]] = {}


def plant(chapter: int) -> Callable[[Callable[[], None]], Callable[[], None]]:
    def keep(plants: Callable[[], None]) -> Callable[[], None]:
        PLANTED[plants.__name__] = (chapter, plants)
        return plants

    return keep


def setting(example: str, **changes: Any) -> None:
    _settings[example] = changes


def settings(chapter: int, name: str, example: str, **changes: Any) -> None:
    PLANTED[name] = (chapter, lambda: setting(example, **changes))


def law(**changes: Any) -> None:
    """Of every problem that is made."""
    made = LearningProblem.run

    def run(self: LearningProblem, *args: Any, **named: Any) -> Any:
        fields = {name: change(self.law) for name, change in changes.items()}
        return made(replace(self, law=replace(self.law, **fields)), *args, **named)

    LearningProblem.run = run  # type: ignore[method-assign]


settings(2, "half_the_gain", "ch2-ex1", gain=0.25)
settings(2, "lengths_of_n5_for_n30", "ch2-ex1-n30", masses=linear.EXAMPLE1.masses)
settings(2, "a_gain_too_large", "ch2-ex1", gain=2.2)
settings(3, "half_the_beta", "ch3-ex1", beta=0.1)
settings(3, "one_trial_more", "ch3-ex1", m=5)
settings(3, "no_rate_of_the_error", "ch3-fish", beta=0.0)
settings(4, "a_wide_tanh", "ch4-ex2-smooth", epsilon=5.0)
settings(4, "much_leakage", "ch4-ex2-smooth", leak_eta=0.5)
settings(4, "tanh_for_sgn", "ch4-ex2-sign", smooth=True)
settings(4, "sgn_for_tanh", "ch4-ex2-smooth", smooth=False)
settings(5, "a_small_rho", "ch5-case1-smooth", bound=0.4)
settings(5, "nothing_learned_of_theta", "ch5-case2", gain_theta=0.0, gain_eta=0.0)
settings(5, "sgn_for_tanh_in_case_1", "ch5-case1-smooth", smooth=False)
settings(5, "tanh_for_sgn_in_case_1", "ch5-case1-sign", smooth=True)
settings(5, "a_wide_tanh_in_case_2", "ch5-case2", epsilon=10.0)


@plant(2)
def the_last_trial_for_the_average() -> None:
    law(past=lambda one: "last")


@plant(2)
def a_slow_plant() -> None:
    plant = linear.EXAMPLE1.plant
    setting("ch2-ex1", plant=replace(plant, a=plant.a * 1.6))


@plant(3)
def another_slope() -> None:
    setting("ch3-ex1", rate=lambda x, u: 0.5 * np.cos(x) + 0.4 * u)


@plant(3)
def wrong_bounds_of_the_slope() -> None:
    chapter3._SLOPES = (0.2, 1.5)


@plant(3)
def a_drag_that_pushes() -> None:
    setting("ch3-fish", rate=lambda v, u: 5.0 * v + u)


@plant(6)
def a_larger_gain() -> None:
    rod.RHO = 1.9
    wrong = rod.law
    rod.law = lambda step=heat.STEP, rho=1.9, q_len=None: wrong(step, rho, q_len)


@plant(6)
def no_source() -> None:
    heat.CHAPTER6 = replace(heat.CHAPTER6, source=(0.0,) * 5)
    rod.CHAPTER6 = heat.CHAPTER6


@plant(6)
def corrections_of_the_wrong_sign() -> None:
    law(kd=lambda one: -one.kd)


@plant(7)
def the_wrong_sign() -> None:
    law(kd=lambda one: -one.kd)


@plant(7)
def a_tenth_of_the_gain() -> None:
    advection.RHO = -0.12041


@plant(7)
def a_theta_without_images() -> None:
    whole = advection.theta
    advection.theta = lambda x, t, images=None: whole(x, t, 0)


@plant(7)
def no_lead() -> None:
    law(lead=lambda one: 0.0)


def fish(**factors: float) -> None:
    """On the numbers of the fish of chapter 8."""
    made = cruise.CruisePlant.__init__

    def init(self: Any, *args: Any, **named: Any) -> None:
        made(self, *args, **named)
        for name, factor in factors.items():
            setattr(self.config, name, getattr(self.config, name) * factor)

    cruise.CruisePlant.__init__ = init  # type: ignore[method-assign]


@plant(8)
def four_times_the_drag() -> None:
    fish(drag_kg_m=4.0)


@plant(8)
def one_beat_of_lead() -> None:
    law(lead=lambda one: one.lead + 1)


@plant(8)
def half_of_each_correction() -> None:
    law(kp=lambda one: one.kp / 2)


@plant(8)
def a_lower_limit() -> None:
    cruise.AMPLITUDE_MAX_RAD = 0.35


@plant(8)
def a_table_at_half_the_angle() -> None:
    cruise.TABLE_8_1 = tuple((angle / 2, speed) for angle, speed in cruise.TABLE_8_1)


@plant(8)
def a_heavy_fish() -> None:
    fish(mass_kg=25.0)


@plant(8)
def the_speed_of_a_beat_before() -> None:
    made = cruise.FishTask.problem
    cruise.FishTask.problem = lambda self: made(replace(self, pairing=0))  # type: ignore[method-assign]


@plant(9)
def nothing_learned_of_theta_of_a_locally_lipschitz_plant() -> None:
    escaping._LEARNING = 0.0


@plant(9)
def a_limit_that_is_never_reached() -> None:
    chapter9.TIGHT = 50.0


def examples(chapter: int) -> list[Example]:
    found = []
    for one in registry.EXAMPLES:
        if one.chapter == chapter:
            changes = _settings.get(one.id)
            same = one if changes is None else one.with_setting(replace(one.setting, **changes))
            found.append(same)
    return found


def main(name: str, chapter: int) -> None:
    if name in PLANTED:
        PLANTED[name][1]()
    seen: dict[str, str] = {}
    with np.errstate(all="ignore"):
        for example in examples(chapter):
            study = Study(example)
            for statement in example.claims:
                try:
                    seen[statement.entry.id] = statement.judge(study).verdict
                except Exception as error:  # a plant that cannot be computed is noticed, too
                    seen[statement.entry.id] = type(error).__name__
            for sketch in example.figures:
                try:
                    seen[sketch.number] = str(bool(sketch.compose(study).contradicts))
                except Exception as error:
                    seen[sketch.number] = type(error).__name__
    print(json.dumps(seen))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
