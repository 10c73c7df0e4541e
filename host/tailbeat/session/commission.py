"""The first session with a fish nobody knows: its limits rise step by step, each with the reason.

From the defaults (0.5 rad at most, 0.15 rad per trial): look at the board, trim, identify with
gentle runs, design gain and lead, then allow as much amplitude as the reference needs and the tank
has room for. A step that fails leaves the limits where they were.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tailbeat.board.diagnostics import look_at
from tailbeat.board.diagnostics.evidence import PROBLEM
from tailbeat.board.fish import Fish
from tailbeat.board.preserve import require_idle, restore_interrupted
from tailbeat.core.errors import InputError, LinkLostError, TailbeatError
from tailbeat.core.reference import Reference, ReferenceLimits
from tailbeat.core.speed_source import Camera, SpeedSource, speed_source
from tailbeat.core.trial_checks import HeadingDrift, heading_drift
from tailbeat.core.trial_file import read_trial
from tailbeat.experiment.current import set_and_save
from tailbeat.experiment.library import (
    RUN,
    TrialLibrary,
    library_of,
    name_reference,
    preserve_folder,
)
from tailbeat.learning.design import design, law_words
from tailbeat.learning.identification import Identified
from tailbeat.learning.identification_runs import IdentificationRun
from tailbeat.learning.saturation import needed_rad, servo_rad
from tailbeat.session.commission_steps import LimitIncrease, next_limit_increase, try_limit
from tailbeat.session.events import Notice, Operator
from tailbeat.session.guards import Guard
from tailbeat.session.identify import IdentificationHooks, identify_fish, set_params
from tailbeat.session.preflight import prepare
from tailbeat.session.preflight_step import GivenUp, PreflightLimits, countdown
from tailbeat.session.trial_camera import camera_of
from tailbeat.session.trim import apply, find_centre

_CAMERA_LOOK_S = 1.5  # of board time
_RAISES_MAX = 8
_HANDS = "Put the fish at rest at its wall. Ready?"


@dataclass(frozen=True)
class CommissionStep:
    """One step that was taken. ``name``: look, trim, identify, design, limits. ``done`` False: it
    failed or was left out, as ``words`` say. ``raises``: what it raised."""

    name: str
    done: bool
    words: str
    raises: tuple[LimitIncrease, ...] = ()


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
        ("look", session.look, True),
        ("trim", session.trim, False),
        ("identify", session.identify, True),
        ("design", session.design, True),
    ]
    for name, take, must in needed:
        step = _taken(name, take)
        yield step
        if must and not step.done:
            return
    for _ in range(_RAISES_MAX):
        step = _taken("limits", session.raise_limit)
        yield step
        if not step.raises:
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
    """State of one first session. ``straight``: of the last trial that tells."""

    fish: Fish
    reference: Reference
    operator: Operator
    camera: Camera | None
    guard: Guard | None
    limits: PreflightLimits
    straight: HeadingDrift | None = field(default=None, init=False)
    identified: Identified | None = field(default=None, init=False)

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
            return CommissionStep("look", False, "; ".join(problems))
        self._ask(_tank_question(params), "The tank's length was not confirmed")
        self._give_reference()
        return CommissionStep("look", True, "; ".join(told))

    def _seen(self, source: SpeedSource) -> tuple[str, str]:
        """(what the camera sees, what is wrong)."""
        if source.uploaded:
            return "", (
                "speeds: SPD_SOURCE is upload, and the first session needs them while it swims;"
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
        found = find_centre(fish, self.operator, self.camera, self.guard, self.limits)
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

    def identify(self) -> CommissionStep:
        """Within the limits as they are."""

        book = library_of(self.fish)
        attendant = self._attendant(book)
        found = identify_fish(self.fish, attendant, preserve_folder(book), self.camera)
        self.identified = found
        if book is not None:
            book.set_identified(found)
        set_params(self.fish, found)
        model = found.model
        return CommissionStep(
            "identify",
            True,
            f"{len(found.trials)} runs: {model.slope_m_s_rad * 1e3:.0f} mm/s per rad beyond "
            f"{model.dead_zone_rad:.2f} rad, drag over mass {model.kappa_per_m:.1f} 1/m, delay "
            f"{model.delay_s:.2f} s",
        )

    def _attendant(self, book: TrialLibrary | None) -> IdentificationHooks:

        def before(run: IdentificationRun) -> None:
            text = f"Run {run.number}, {run.kind}, up to {run.cruise_rad:.2f} rad: about "
            text += f"{run.travel_m:.2f} m, at worst {run.travel_worst_m:.2f}. {_HANDS}"
            self._ask(text, "Not identified")
            prepare(self.fish, self.limits, self.camera, self.operator)
            countdown(self.fish, self.limits, self.operator)

        return IdentificationHooks(
            before=before,
            event=self.operator.tell,
            keep=lambda path: self._keep(path, book),
            note=self._note,
            guard=self.guard,
            wants_abort=self.operator.wants_abort,
        )

    def _note(self, text: str) -> None:
        self.operator.tell(Notice(text))

    def _keep(self, path: Path, book: TrialLibrary | None) -> None:
        self.straight = heading_drift(read_trial(path)) or self.straight
        if book is not None:
            book.keep(path, RUN)

    def design(self) -> CommissionStep:
        """For the limit that the reference will need."""

        assert self.identified is not None
        params = self.fish.params.values()
        most = min(needed_rad(self.identified, self.reference), servo_rad(params))
        found = design(self.identified, self.reference, most, step_max_rad=params["DU_MAX_RAD"])
        if found.refused:
            return CommissionStep("design", False, found.refused)
        # the certificate is for kd = 0, a constant gain and the last trial alone
        law = {name: value for name, value in found.law.params().items() if name in params}
        set_and_save(self.fish, law)
        return CommissionStep(
            "design",
            True,
            f"{law_words(found.law)}: errors shrink most surely, steady ones to "
            f"{found.ratio_dc:.2f} of themselves per trial, the worst to {found.ratio_max:.2f}; "
            f"gains from {found.static_gain_max:.2f} on would not learn",
        )

    def raise_limit(self) -> CommissionStep:
        """One step; a trial with it proves it before it is set."""
        found = next_limit_increase(
            self.fish.params.values(), self.reference, self.identified, self.straight
        )
        if isinstance(found, str):
            return CommissionStep("limits", True, found)
        assert self.identified is not None
        text = f"{found.text}. One short trial proves it. {_HANDS}"
        self._ask(text, f"{found.name} stays {found.was:.2f}")
        proof = try_limit(
            self.fish,
            found.to,
            self.identified,
            self.operator,
            self.camera,
            self.guard,
            self.limits,
        )
        self.straight = proof.straight or self.straight
        if proof.why_not:
            return CommissionStep(
                "limits", False, f"{found.name} stays {found.was:.2f}: {proof.why_not}"
            )
        set_and_save(self.fish, {found.name: found.to})
        return CommissionStep("limits", True, f"{found.text}; {proof.words}", (found,))

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
