"""Leads from a connected fish to trials that have converged, step by step.

What a step is to reach is looked for first, and the step is skipped when it is there: a job that
was interrupted goes on where it stopped, with the same command. Everything is kept where single
commands keep it too (board, trial library, experiment).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from tailbeat.board.fish import Fish, board_reference
from tailbeat.core.errors import InputError
from tailbeat.core.printable import mm
from tailbeat.core.reference import Reference, thesis
from tailbeat.core.speed_source import Camera
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import identified_if_readable, library_of, some_library
from tailbeat.learning.error_bound import error_bound_range
from tailbeat.learning.identification import Identified
from tailbeat.learning.saturation import KnownFish, expected_saturation
from tailbeat.session.collect import STOPPED
from tailbeat.session.commission import commission_fish, give_reference
from tailbeat.session.events import Operator, StepBegun, StepEnded
from tailbeat.session.guards import Guard
from tailbeat.session.health import HEALTH, check_health
from tailbeat.session.options import Options
from tailbeat.session.proposals import Trials
from tailbeat.session.series import SeriesEnd
from tailbeat.session.travel import travel_of

_COMMAND = "tailbeat start"
_STEPS = 5


@dataclass(frozen=True)
class StartOptions:
    """``reference``: to learn; None: the board's own, else the thesis's. ``series``: of the
    trials. ``acts``: whether the tail may move; False on a board that is not simulated with nobody
    there. ``anew``: a known fish is measured again."""

    reference: Reference | None = None
    series: Options = field(default_factory=Options)
    acts: bool = True
    anew: bool = False


@dataclass(frozen=True)
class StartEnd:
    """``steps``: what became of each, in order. ``series``: how the trials ended; None: it did not
    come so far, as the last step says."""

    steps: list[StepEnded]
    series: SeriesEnd | None = None
    experiment: Experiment | None = None


class NobodyThere(InputError):
    """A step would move the tail, and nobody is there to stop it."""

    def __init__(self, step: str) -> None:
        super().__init__(
            f"the step '{step}' moves the tail, and nobody is there to stop it",
            "Run the same command at a terminal, without --yes.",
        )
        self.document = {"step": step}


def run_start(
    fish: Fish,
    operator: Operator,
    options: StartOptions,
    experiment: Callable[[], Experiment],
    camera: Camera | None = None,
    guard: Guard | None = None,
) -> StartEnd:
    """``experiment``: gives the folder once there is a reference. Raises what the steps raise; the
    tail is still then."""
    with some_library(fish):
        return _Guide(fish, operator, options, experiment, camera, guard).run()


@dataclass
class _Guide:
    """State of one call of run_start."""

    fish: Fish
    operator: Operator
    options: StartOptions
    experiment: Callable[[], Experiment]
    camera: Camera | None
    guard: Guard | None
    steps: list[StepEnded] = field(default_factory=list)
    identified: Identified | None = None

    def run(self) -> StartEnd:
        if not self._is_under_way() and not self._ready():
            return StartEnd(self.steps)
        self._begin(
            4, "trials", "each is one run along the reference, then it learns", "2 min each"
        )
        self._require_act("trials")
        series = self.options.series
        trials = Trials(
            self.fish, self.operator, series, self.experiment, self.camera, self.guard, self.steps
        )
        end, folder = trials.run()
        return StartEnd(self.steps, end, folder)

    def _is_under_way(self) -> bool:
        """A trial waits to be decided on, or the board is stopped: the series sees to that."""
        status = self.fish.status()
        under_way = status.pending_trial is not None or status.state in STOPPED
        return under_way and board_reference(self.fish) is not None

    def _ready(self) -> bool:
        """Health, commissioning, reference."""
        self._begin(1, HEALTH, "is the fish ready to swim?", "seconds")
        fish, operator = self.fish, self.operator
        self.identified = identified_if_readable(library_of(fish))
        is_known = self.identified is not None and bool(self.identified.trials)
        is_new = self.options.anew or not is_known
        if not self._took(check_health(fish, self.camera, operator, _COMMAND, swims=is_new)):
            return False
        reference = self.options.reference or board_reference(fish) or thesis()
        self._begin(2, "commission", "get to know a new fish", "3 short runs, 6 min")
        if not (self._commissioned(reference) if is_new else self._known()):
            return False
        self._begin(3, "reference", "the speed to learn, beat by beat", "seconds")
        give_reference(fish, reference, operator)
        return self._took(self._checked(reference))

    def _known(self) -> bool:
        assert self.identified is not None
        words = f"skipped, this fish was measured on {self.identified.made[:10]}"
        return self._took(StepEnded("commission", True, words))

    def _commissioned(self, reference: Reference) -> bool:
        self._require_act("commission")
        limits = self.options.series.wanted
        for step in commission_fish(
            self.fish, reference, self.operator, self.camera, self.guard, limits
        ):
            if step.name != HEALTH:
                self._took(step)
            if step.ends:
                return False
            if step.found is not None:
                self.identified = step.found.identified
        return True

    def _checked(self, reference: Reference) -> StepEnded:
        """What the fish can reach of the reference, and whether the tank has room."""
        known, params = self.identified, self.fish.params.values()
        assert known is not None
        around = error_bound_range(known, reference, params["AMP_MAX_RAD"])
        best = around.bound.lsq_input
        travel = travel_of(best, params, reference.beat_s, known)
        travel.require_room()
        low, high = around.minimax_m_s
        words = (
            f"{reference.name}, {reference.beats} tail beats (one a second); the fish travels"
            f" {travel.text()}; error bound {mm(around.bound.minimax_m_s)} mm/s ({mm(low)} to"
            f" {mm(high)}): by the measured model nothing gets a smaller largest error"
        )
        fish = KnownFish(known, "measured")
        if (saturation := expected_saturation(fish, reference, params)) is not None:
            words += f"; {saturation.text}"
        return StepEnded("reference", True, words)

    def _begin(self, number: int, name: str, why: str, takes: str) -> None:
        self.operator.tell(StepBegun(number, _STEPS, name, why, takes))

    def _took(self, step: StepEnded) -> bool:
        self.steps.append(step)
        self.operator.tell(step)
        return step.done

    def _require_act(self, name: str) -> None:
        if not self.options.acts:
            raise NobodyThere(name)
