"""After the hull was open: the board gets back what it knew, and one repeat of the best tells how
far the fish has shifted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tailbeat.camera.base import Camera
    from tailbeat.day.person import Person
    from tailbeat.day.series import Options
    from tailbeat.day.swum import Swum
    from tailbeat.experiment.folder import Experiment
    from tailbeat.fish import Fish, Guard


@dataclass(frozen=True)
class Restored:
    """What the board got back. ``params``: names that differed; ``reference``, ``learned``: whether
    it had to be given again. ``iteration`` swims next."""

    params: dict[str, float]
    reference: bool
    learned: bool
    iteration: int
    battery_v: float


@dataclass(frozen=True)
class Shift:
    """One repeat of the best against what it was. ``speed_shift_m_s``: mean over beats of the
    repeat's speed less the best's, with its standard error. ``low_m_s`` to ``high_m_s``: max|e|
    that a repeat has in 95 of 100 cases. ``within``: the repeat is there. ``words``: what it means
    and what to do: go on, trim again, or identify again."""

    best_trial: int
    best_max_abs_error_m_s: float
    repeat_trial: int
    repeat_max_abs_error_m_s: float
    low_m_s: float
    high_m_s: float
    speed_shift_m_s: float
    speed_shift_sigma_m_s: float
    within: bool
    words: str


def restore(fish: Fish, experiment: Experiment) -> Restored:
    """Compares the board with ``experiment.board`` and gives it back what it lacks: parameters,
    reference, all that was learned. A trial that waits on the board is left alone. Raises
    InputError: another fish, nothing held."""
    raise NotImplementedError


def repeat_best(
    fish: Fish,
    experiment: Experiment,
    person: Person,
    options: Options,
    camera: Camera | None = None,
    guard: Guard | None = None,
) -> tuple[Swum, Shift]:
    """Swims the best amplitudes once (through the ritual, journalled as a repeat, not learned),
    then puts back the amplitudes and the iteration that were to swim next, also when it fails."""
    raise NotImplementedError
