"""Commissions a fish that nobody knows: looks at the board, finds the tail's centre, measures the
fish, offers the amplitude limit that its reference needs, and stores the law designed for it.

A step that fails leaves what the steps before it have set.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, LinkLostError, TailbeatError
from tailbeat.core.reference import Reference, ReferenceLimits
from tailbeat.core.speed_source import Camera
from tailbeat.experiment.current import set_and_save
from tailbeat.experiment.library import library_of, name_reference
from tailbeat.learning.fish_model import TrialSpeeds
from tailbeat.session.board_law import store_law
from tailbeat.session.events import Notice, Operator, StepEnded
from tailbeat.session.guards import Guard
from tailbeat.session.health import HEALTH, check_health
from tailbeat.session.identify import set_params
from tailbeat.session.limit import LimitIncrease, limit_offer
from tailbeat.session.measure import MeasuredFish, measure_fish
from tailbeat.session.preflight_step import GivenUp, PreflightLimits
from tailbeat.session.trial_camera import camera_of
from tailbeat.session.trim import apply, find_centre


@dataclass(frozen=True)
class CommissionStep(StepEnded):
    """One step that was taken: health, tank, trim, measure, limit, law. ``limit``: what was raised.
    ``found``: what was measured."""

    limit: LimitIncrease | None = None
    found: MeasuredFish | None = None

    @property
    def ends(self) -> bool:
        """Whether it failed and the steps after it cannot do without."""
        return not self.done and self.name not in _MAY_FAIL


_MAY_FAIL = ("trim", "limit", "law")


def commission_fish(
    fish: Fish,
    reference: Reference,
    operator: Operator,
    camera: Camera | None = None,
    guard: Guard | None = None,
    limits: PreflightLimits | None = None,
    known: MeasuredFish | None = None,
    command: str = "tailbeat session commission",
) -> Iterator[CommissionStep]:
    """Yields each step when it is done; of a fish that is ``known`` only limit and law are left.
    Asks (operator.confirm) before the fish swims and before anything is raised; ``limits``: of the
    preflight checks before each run. Saves what it sets. Uploads the reference of a fish that is
    not known. ``command``: what to repeat once something is put right. Ends early, with a step that
    is not done, when one fails that the next ones need (``ends``). Raises LinkLostError."""
    with camera_of(fish, camera) as used:
        wanted = limits or PreflightLimits()
        session = _Session(fish, reference, operator, used, guard, wanted, command, found=known)
        for name, take in session.steps():
            step = _taken(name, take)
            yield step
            if step.ends:
                return


def _taken(name: str, take: Callable[[], CommissionStep]) -> CommissionStep:
    """A step that fails is told, with what to do; the link must be there for the next one."""

    try:
        return take()
    except LinkLostError:
        raise
    except TailbeatError as error:
        return CommissionStep(name, False, str(error))


@dataclass
class _Session:
    """State of one commissioning. ``trials``: of the trim, as far as they tell the fish's speed."""

    fish: Fish
    reference: Reference
    operator: Operator
    camera: Camera | None
    guard: Guard | None
    limits: PreflightLimits
    command: str
    trials: list[TrialSpeeds] = field(default_factory=list, init=False)
    found: MeasuredFish | None = None

    def steps(self) -> list[tuple[str, Callable[[], CommissionStep]]]:
        """In order."""
        if self.found is not None:
            return [("limit", self.limit), ("law", self.law)]
        return [
            (HEALTH, self.health),
            ("tank", self.tank),
            ("trim", self.trim),
            ("measure", self.measure),
            ("limit", self.limit),
            ("law", self.law),
        ]

    def health(self) -> CommissionStep:
        """Whether it can swim at all."""
        found = check_health(self.fish, self.camera, self.operator, self.command)
        return CommissionStep(**vars(found))

    def tank(self) -> CommissionStep:
        """How much room there is, and for which reference."""
        question, answer = _tank_question(self.fish.params.values())
        self._ask(question, "The length was not confirmed (tailbeat params set TANK_LEN_M)")
        give_reference(self.fish, self.reference, self.operator)
        return CommissionStep(
            "tank", True, f"{answer}; the reference (the speed to learn) is {self.reference.name}"
        )

    def trim(self) -> CommissionStep:
        """Left out where nothing feels a turn."""
        fish = self.fish
        if self.camera is None and fish.sim is None and not fish.imu_verdict().problem.well:
            text = "left out: no IMU and no camera to feel a turn by"
            self._note(f"trim {text}")
            return CommissionStep("trim", False, text)
        found = find_centre(
            fish, self.operator, self.camera, self.guard, self.limits, self.trials.append
        )
        words = f"the tail is straight at {found.centre_us:.0f} +- {found.sigma_us:.0f} us"
        if abs(found.centre_us - found.was_us) <= found.sigma_us:
            return CommissionStep(
                "trim", True, f"{words} ({found.source}); {found.was_us:.0f} us stays"
            )
        self._ask(f"{words}, not at {found.was_us:.0f}. Set it?", "The centre stays")
        apply(fish, found)
        return CommissionStep(
            "trim", True, f"{words} ({found.source}), was {found.was_us:.0f}; set"
        )

    def measure(self) -> CommissionStep:
        """Up to the amplitude that the reference needs; the board's model follows."""
        self.found = found = measure_fish(
            self.fish,
            self.reference,
            self.operator,
            self.camera,
            self.guard,
            self.limits,
            tuple(self.trials),
        )
        store_measured(self.fish, found)
        model = found.identified.model
        runs = f"{found.runs} trial{'' if found.runs == 1 else 's'}"
        return CommissionStep(
            "measure",
            True,
            f"{runs}: {model.slope_m_s_rad * 1e3:.0f} mm/s per rad beyond "
            f"{model.dead_zone_rad:.2f} rad, drag over mass {model.kappa_per_m:.1f} 1/m, delay "
            f"{model.delay_s:.2f} s",
            found=found,
        )

    def limit(self) -> CommissionStep:
        """Offered only as far as a run went without a fault."""
        assert self.found is not None
        offer = limit_offer(
            self.fish.params.values(), self.reference, self.found.identified, self.found.straight
        )
        if isinstance(offer, str):
            return CommissionStep("limit", True, offer)
        if not offer.is_typed_by(self.operator):
            return CommissionStep("limit", True, f"{offer.name} stays {offer.was:.2f}, as answered")
        set_and_save(self.fish, {offer.name: offer.to})
        return CommissionStep("limit", True, offer.text, offer)

    def _note(self, text: str) -> None:
        self.operator.tell(Notice(text))

    def law(self) -> CommissionStep:
        """The P law that the board learns by where it is alone: for the limit that is allowed."""
        assert self.found is not None
        if why := store_law(self.fish, self.reference, self.found.identified):
            return CommissionStep("law", False, why)
        return CommissionStep(
            "law",
            True,
            "the board's own learning law is set for this fish: should this computer fail, the"
            " board goes on alone",
        )

    def _ask(self, question: str, otherwise: str) -> None:
        if not self.operator.confirm(question):
            raise GivenUp(
                f"{otherwise}: the answer was no.",
                "Begin again with the same command.",
            )


def store_measured(fish: Fish, found: MeasuredFish) -> None:
    """In the trial library, and the model's numbers on the board."""
    if (book := library_of(fish)) is not None:
        book.set_identified(found.identified)
    set_params(fish, found.identified)


def give_reference(fish: Fish, reference: Reference, operator: Operator) -> None:
    """The board's, from now on; asks when that costs what the board has learned. Raises GivenUp,
    InputError for a reference beyond the board's limits."""
    status = fish.status()
    if status.reference_crc == reference.crc:
        return
    if problems := reference.check(ReferenceLimits.from_params(fish.params.values())):
        raise InputError(problems[0].meaning, problems[0].remedy)
    text = "The board has learned along another reference; going on resets its learning. Go on?"
    if status.best_iteration is not None and not operator.confirm(text):
        raise GivenUp("What the board has learned is kept: the answer was no.", "")
    fish.upload_reference(reference)
    name_reference(fish, reference)


def _tank_question(params: dict[str, float]) -> tuple[str, str]:
    """(question, what is so when it was answered with yes)."""
    tank_m, fish_m = params["TANK_LEN_M"], params["FISH_LEN_M"]
    if tank_m <= 0:
        words = "The tank's length (TANK_LEN_M) is 0: nothing keeps the fish from the far wall"
        return f"{words}. Go on all the same?", words
    room = f"{tank_m - fish_m:.2f} m of room"
    return (
        f"The tank is {tank_m:.2f} m long and the fish {fish_m:.2f} m: {room}. Is that right?",
        room,
    )
