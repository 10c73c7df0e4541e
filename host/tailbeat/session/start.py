"""Leads from a connected fish to trials that have converged, step by step.

A step whose result is there already is skipped: a job that was interrupted goes on where it
stopped, with the same command. Everything is kept where single commands keep it too (board, trial
library, experiment).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from tailbeat.board.fish import Fish, board_reference
from tailbeat.board.preserve import restore_interrupted
from tailbeat.core.errors import InputError
from tailbeat.core.printable import mm
from tailbeat.core.reference import Reference, thesis
from tailbeat.core.speed_source import Camera
from tailbeat.experiment.current import current, has_lost, held_reference
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import library_of, preserve_folder, some_library
from tailbeat.learning.error_bound import error_bound_range
from tailbeat.learning.identification import Identified
from tailbeat.learning.saturation import KnownFish, expected_saturation
from tailbeat.session.collect import STOPPED, stop_words
from tailbeat.session.commission import commission_fish, give_reference
from tailbeat.session.events import Notice, Operator, StepBegun, StepEnded, notice_to
from tailbeat.session.guards import Guard
from tailbeat.session.health import HEALTH, check_health
from tailbeat.session.measure import MeasuredFish, measured_before
from tailbeat.session.options import Options, Until
from tailbeat.session.proposals import Trials
from tailbeat.session.resume import restore
from tailbeat.session.series import NOTHING_MORE, SeriesEnd, run_series
from tailbeat.session.travel import travel_of

_COMMAND = "tailbeat start"
_STEPS = (
    StepBegun(1, 5, HEALTH, "is the fish ready to swim?", "seconds", "no key"),
    StepBegun(
        2, 5, "commission", "get to know a new fish", "3 short trials (the fish moves), 6 min",
        "y or n",
    ),
    StepBegun(3, 5, "reference", "the speed to learn, beat by beat", "seconds", "y or n"),
    StepBegun(
        4, 5, "trials", "the fish follows the reference, then it learns", "2 min each",
        "any key stops the tail",
    ),
    StepBegun(5, 5, "report", "figures and tables of all trials", "seconds", "no key"),
)  # fmt: skip
_STEP = {step.name: step for step in _STEPS}
REPORT = _STEPS[-1]  # taken by the caller, when there is something to report


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


def give_back(fish: Fish, operator: Operator) -> None:
    """To a board that has lost its reference, what its experiment holds: as ``session resume``.
    Raises what that raises."""
    experiment = current(fish)
    if experiment is None or not has_lost(fish, experiment):
        return
    lost = "reference and all it had learned" if restore(fish, experiment).learned else "reference"
    operator.tell(Notice(f"the board had lost its {lost}: restored from {experiment.name}"))


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
        restore_interrupted(
            self.fish, preserve_folder(library_of(self.fish)), notice_to(self.operator)
        )
        if (left := self._settled()) is not None:
            return left
        give_back(self.fish, self.operator)
        if not self._ready():
            return StartEnd(self.steps)
        self._begin("trials")
        self._require_act("trials")
        series = self.options.series
        trials = Trials(
            self.fish, self.operator, series, self.experiment, self.camera, self.guard, self.steps
        )
        end, folder = trials.run()
        return StartEnd(self.steps, end, folder)

    def _settled(self) -> StartEnd | None:
        """A trial that waits on the board is decided on before anything else, and a stopped board
        is cleared. An end when one of them is not."""
        fish, status = self.fish, self.fish.status()
        if status.pending_trial is not None and board_reference(fish) is not None:
            series = replace(self.options.series, until=Until(0), proposes=False)
            folder = self.experiment()
            end = run_series(fish, folder, self.operator, series, self.camera, self.guard)
            if end.why != NOTHING_MORE:
                return StartEnd(self.steps, end, folder)
            status = fish.status()
        if status.state not in STOPPED:
            return None
        words = stop_words(status)
        if self.operator.confirm(f"{words} Clear it and go on?"):
            fish.clear()
            return None
        self._took(StepEnded(HEALTH, False, f"{words} Then: tailbeat board clear"))
        return StartEnd(self.steps)

    def _ready(self) -> bool:
        """Health, commissioning, reference, amplitude limit and the board's own law."""
        fish = self.fish
        self._begin(HEALTH)
        found = None if self.options.anew else measured_before(fish)
        reference = self.options.reference or held_reference(fish) or thesis()
        if found is None:
            return self._commissioned(reference, None) and self._given(reference)
        if not self._took(check_health(fish, self.camera, self.operator, _COMMAND, swims=False)):
            return False
        self._begin("commission")
        words = f"skipped, this fish was measured on {found.identified.made[:10]}"
        self._took(StepEnded("commission", True, words))
        self.identified = found.identified
        return self._given(reference, found)

    def _commissioned(self, reference: Reference, known: MeasuredFish | None) -> bool:
        """Of a ``known`` fish only the limit and the board's law, both for this reference."""
        limits = self.options.series.wanted
        for step in commission_fish(
            self.fish, reference, self.operator, self.camera, self.guard, limits, known, _COMMAND
        ):
            self._took(step)
            if step.ends:
                return False
            if step.name == HEALTH:
                self._begin("commission")
                self._require_act("commission")
            if step.found is not None:
                self.identified = step.found.identified
        return True

    def _given(self, reference: Reference, known: MeasuredFish | None = None) -> bool:
        """To the board, and checked; of a ``known`` fish with the limit that is allowed for it."""
        self._begin("reference")
        give_reference(self.fish, reference, self.operator)
        if known is not None and not self._commissioned(reference, known):
            return False
        return self._took(self._checked(reference))

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
            f" {travel.text()}. Error bound {mm(around.bound.minimax_m_s)} mm/s ({mm(low)} to"
            f" {mm(high)}): by the measured model no input has a smaller largest error"
        )
        fish = KnownFish(known, "measured")
        if (saturation := expected_saturation(fish, reference, params)) is not None:
            words += f"; {saturation.text}"
        return StepEnded("reference", True, words)

    def _begin(self, name: str) -> None:
        self.operator.tell(_STEP[name])

    def _took(self, step: StepEnded) -> bool:
        self.steps.append(step)
        self.operator.tell(step)
        return step.done

    def _require_act(self, name: str) -> None:
        if not self.options.acts:
            raise NobodyThere(name)
