"""Commissions a fish that nobody knows: looks at the board, finds the tail's centre, measures the
fish, offers the amplitude limit that its reference needs, and stores the law designed for it.

A step that fails leaves what the steps before it have set.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from tailbeat.board.diagnostics import look_at
from tailbeat.board.diagnostics.evidence import PROBLEM
from tailbeat.board.fish import Fish
from tailbeat.board.preserve import require_idle, restore_interrupted
from tailbeat.core.errors import InputError, LinkLostError, TailbeatError
from tailbeat.core.reference import Reference, ReferenceLimits
from tailbeat.core.speed_source import Camera, SpeedSource, speed_source
from tailbeat.experiment.current import set_and_save
from tailbeat.experiment.library import library_of, name_reference, preserve_folder
from tailbeat.learning.design import design, law_words
from tailbeat.learning.fish_model import TrialSpeeds
from tailbeat.learning.saturation import needed_rad, servo_rad
from tailbeat.session.events import Notice, Operator
from tailbeat.session.guards import Guard
from tailbeat.session.identify import set_params
from tailbeat.session.limit import LimitIncrease, limit_offer
from tailbeat.session.measure import MeasuredFish, measure_fish
from tailbeat.session.preflight_step import GivenUp, PreflightLimits
from tailbeat.session.trial_camera import camera_of
from tailbeat.session.trim import apply, find_centre

_CAMERA_LOOK_S = 1.5  # of board time


@dataclass(frozen=True)
class CommissionStep:
    """One step that was taken. ``name``: health, trim, measure, limit, law. ``done`` False: it
    failed or was left out, as ``words`` say. ``limit``: what was raised."""

    name: str
    done: bool
    words: str
    limit: LimitIncrease | None = None


def commission_fish(
    fish: Fish,
    reference: Reference,
    operator: Operator,
    camera: Camera | None = None,
    guard: Guard | None = None,
    limits: PreflightLimits | None = None,
) -> Iterator[CommissionStep]:
    """Yields each step when it is done. Asks (operator.confirm) before the fish swims and before
    anything is raised; ``limits``: of the preflight checks before each trial. Saves what it sets.
    Uploads the reference. Ends early, with a step that is not done, when one fails that the next
    ones need. Raises LinkLostError."""
    with camera_of(fish, camera) as used:
        limits = limits or PreflightLimits()
        yield from _steps(_Session(fish, reference, operator, used, guard, limits))


def _steps(session: _Session) -> Iterator[CommissionStep]:
    needed: list[tuple[str, Callable[[], CommissionStep], bool]] = [
        ("health", session.look, True),
        ("trim", session.trim, False),
        ("measure", session.measure, True),
        ("limit", session.limit, False),
        ("law", session.law, True),
    ]
    for name, take, must in needed:
        step = _taken(name, take)
        yield step
        if must and not step.done:
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
    trials: list[TrialSpeeds] = field(default_factory=list, init=False)
    found: MeasuredFish | None = field(default=None, init=False)

    def look(self) -> CommissionStep:
        """Whether it can swim at all; then the reference."""
        fish = self.fish
        restore_interrupted(fish, preserve_folder(library_of(fish)), self._note)
        require_idle(fish, "tailbeat session commission")
        params = fish.params.values()
        findings = look_at(fish)
        problems = [f"{one.name}: {one.line}" for one in findings if one.status == PROBLEM]
        told = [f"{one.name}: {one.text}" for one in findings if one.status != PROBLEM]
        source = speed_source(params)
        if not source.sampled:
            told.append(f"speeds by {source.name}")
        seen, why = self._seen(source)
        told.append(seen) if not why else problems.append(why)
        if problems:
            return CommissionStep("health", False, "; ".join(problems))
        self._ask(_tank_question(params), "The tank's length was not confirmed")
        self._give_reference()
        return CommissionStep("health", True, "; ".join(told))

    def _seen(self, source: SpeedSource) -> tuple[str, str]:
        """(what the camera sees, what is wrong)."""
        if source.uploaded:
            return "", (
                "speeds: SPD_SOURCE is upload, and commissioning needs them while it swims;"
                " set another, or do it by hand: tailbeat session identify, tailbeat session design"
            )
        if self.camera is None:
            text = "camera: there is none, and SPD_SOURCE is vision. Give --camera"
            return ("no camera", "") if not source.sampled else ("", text)
        self.fish.link.run(_CAMERA_LOOK_S / max(self.fish.clock.rate, 1.0))
        frames = self.camera.frames()
        if not frames:
            return "", "camera: it does not see the fish. Look at light and marker: camera track"
        return f"camera: it sees the fish ({len(frames)} pictures)", ""

    def _give_reference(self) -> None:

        problems = self.reference.check(ReferenceLimits.from_params(self.fish.params.values()))
        if problems:
            raise InputError(problems[0].meaning, problems[0].remedy)
        status = self.fish.status()
        another = status.reference_crc not in (None, self.reference.crc)
        if another and status.best_iteration is not None:
            text = "The board has learned along another reference and will forget that. Go on?"
            self._ask(text, "What the board has learned is kept")
        self.fish.upload_reference(self.reference)
        name_reference(self.fish, self.reference)

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
        if (book := library_of(self.fish)) is not None:
            book.set_identified(found.identified)
        set_params(self.fish, found.identified)
        model = found.identified.model
        runs = f"{found.runs} run{'' if found.runs == 1 else 's'}"
        return CommissionStep(
            "measure",
            True,
            f"{runs}: {model.slope_m_s_rad * 1e3:.0f} mm/s per rad beyond "
            f"{model.dead_zone_rad:.2f} rad, drag over mass {model.kappa_per_m:.1f} 1/m, delay "
            f"{model.delay_s:.2f} s",
        )

    def limit(self) -> CommissionStep:
        """Offered only as far as a run went without a fault."""
        assert self.found is not None
        offer = limit_offer(
            self.fish.params.values(), self.reference, self.found.identified, self.found.straight
        )
        if isinstance(offer, str):
            return CommissionStep("limit", True, offer)
        if self.operator.number(f"{offer.text}. To allow it, type", offer.to) != offer.to:
            return CommissionStep("limit", True, f"{offer.name} stays {offer.was:.2f}, as answered")
        set_and_save(self.fish, {offer.name: offer.to})
        return CommissionStep("limit", True, offer.text, offer)

    def _note(self, text: str) -> None:
        self.operator.tell(Notice(text))

    def law(self) -> CommissionStep:
        """The P law that the board learns by where it is alone: for the limit that is allowed."""
        assert self.found is not None
        identified, params = self.found.identified, self.fish.params.values()
        most = min(needed_rad(identified, self.reference), servo_rad(params), params["AMP_MAX_RAD"])
        found = design(identified, self.reference, most, step_max_rad=params["DU_MAX_RAD"])
        if found.refused:
            return CommissionStep("law", False, found.refused)
        # the certificate is for kd = 0, a constant gain and the last trial alone
        law = {name: value for name, value in found.law.params().items() if name in params}
        set_and_save(self.fish, law)
        return CommissionStep(
            "law",
            True,
            f"{law_words(found.law)}: convergence rate {found.ratio_dc:.2f} at steady speed, "
            f"{found.ratio_max:.2f} at worst; does not learn from gain "
            f"{found.static_gain_max:.2f} on",
        )

    def _ask(self, question: str, otherwise: str) -> None:
        if not self.operator.confirm(question):
            raise GivenUp(
                f"{otherwise}: the answer was no.",
                "Begin again with 'tailbeat session commission'; --yes answers for a script.",
            )


def _tank_question(params: dict[str, float]) -> str:
    tank_m, fish_m = params["TANK_LEN_M"], params["FISH_LEN_M"]
    if tank_m <= 0:
        return "TANK_LEN_M is 0: nothing keeps the fish from the far wall. Go on all the same?"
    return (
        f"By TANK_LEN_M the tank is {tank_m:.2f} m long and by FISH_LEN_M the fish {fish_m:.2f} m: "
        f"it may swim {tank_m - fish_m:.2f} m. Is that right?"
    )
