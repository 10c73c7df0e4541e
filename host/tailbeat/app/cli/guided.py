"""trial run with somebody to guide: the ritual, the questions, one swim after the other."""

from __future__ import annotations

import contextlib
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from tailbeat.app.cli._display import Display
from tailbeat.app.cli._keyboard import terminal_keys
from tailbeat.app.cli._operator import TerminalOperator
from tailbeat.app.cli._terminal import command_typed, echo, mm, say
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.experiment.current import begin, current, require_own, require_same, use
from tailbeat.experiment.folder import Experiment
from tailbeat.session.events import TrialRecorded, TrialStarted
from tailbeat.session.outcome import KINDS, Decision
from tailbeat.session.preflight.step import PreflightLimits
from tailbeat.session.series import Options, Until, swim_series

if TYPE_CHECKING:
    from collections.abc import Callable

    from tailbeat.app.cli._camera import LiveCamera
    from tailbeat.board.fish import Fish
    from tailbeat.experiment.folder import Experiment
    from tailbeat.session.events import Event
    from tailbeat.session.operator import Operator
    from tailbeat.session.outcome import Decision, RecordedTrial
    from tailbeat.session.series import Options, Round, SeriesEnd, Until

_ROOT = Path("experiments")
_GOOD_ENDS = ("swims", "converged", "saturated")


@dataclass(frozen=True)
class GuideOptions:
    """What ``trial run`` was told of the guiding. ``guide`` None: when somebody is there, or one of
    the others was given."""

    guide: bool | None
    rest_s: float | None
    until: str | None
    into: Path | None
    then: str | None
    reason: str | None
    learn: bool

    def wanted(self) -> bool:
        """Whether it is guided. Raises typer.BadParameter for what contradicts itself, InputError
        for what is none."""
        given = [self.rest_s, self.until, self.into, self.then]
        asked = any(value is not None for value in given)
        if self.guide is False and (asked or not self.learn or self.reason is not None):
            raise typer.BadParameter(
                "--no-guide goes without --rest, --until, --into, --then, --reason and --no-learn"
            )
        if self.reason is not None and self.then is None:
            raise typer.BadParameter("--reason belongs to --then repeat or --then discard")
        self.answer()
        self._until()
        if self.into is not None:
            _require_folder(self.into)
        if self.guide is not None:
            return self.guide
        return asked or not self.learn or (sys.stdin.isatty() and sys.stderr.isatty())

    def answer(self) -> Decision | None:
        """What was decided beforehand."""

        kind = next((kind for kind in KINDS if kind == self.then), None)
        if self.then is None:
            return None
        if kind is None:
            raise typer.BadParameter(f"--then is {', '.join(KINDS)}, not '{self.then}'")
        try:
            return Decision(kind, self.reason or "")
        except InputError as error:
            raise typer.BadParameter(f"--then {kind} needs --reason WHY") from error

    def _until(self) -> Until:

        return Until() if self.until is None else Until.parse(self.until)

    def options(self) -> Options:
        """As the series takes them."""

        answer = self.answer()
        return Options(
            until=self._until(),
            wanted=PreflightLimits()
            if self.rest_s is None
            else PreflightLimits(rest_s=self.rest_s),
            learn=self.learn,
            counts=("keep",) if answer is None else (answer.kind,),
            typed=command_typed(),
        )


def _require_folder(into: Path) -> None:

    Experiment.open(into)


def run_guided(fish: Fish, live: LiveCamera, given: GuideOptions, json: bool) -> None:
    """Swims the series, tells how it ended. Raises typer.Exit unless it ended as was asked for."""

    options = given.options()
    with Display(quiet=json) as display, terminal_keys() as keys:
        experiment = experiment_for(fish, given.into, lambda text: display.keep(text, loud=True))
        there = keys if display.moves else None
        person: Operator = TerminalOperator(display, there, given.answer(), _keep_alive(fish))
        if live.recorder is not None:
            person = _Filming(person, live)
        end = swim_series(fish, experiment, person, options, live.camera, live.guard)
    until = options.until
    good = (*_GOOD_ENDS, "battery") if until.swims is None and not until.converged else _GOOD_ENDS
    say(json, _document(end, experiment), _text(end, told=end.why in good))
    if end.why not in good:
        echo(f"tailbeat: {end.words}", err=True)
        raise typer.Exit(130 if end.why == "interrupted" else 1)


def experiment_for(fish: Fish, into: Path | None, tell: Callable[[str], None]) -> Experiment:
    """The folder that was named, else the one this fish is in, else a new one, told. Raises
    InputError."""

    require_own(fish)
    if into is not None:
        named = Experiment.open(into)
        require_same(fish, named)
        use(fish, named)
        return named
    if (found := current(fish)) is not None:
        try:
            require_same(fish, found)
            return found
        except InputError:
            if fish.status().reference_crc is None:
                raise
            tell(f"{found.folder} is of another reference")
    made = begin(fish, _ROOT)
    tell(f"a new experiment begins: {made.folder}")
    return made


def _keep_alive(fish: Fish) -> Callable[[], None]:
    """While a question waits: heartbeats go out, what comes in is taken."""

    def pump() -> None:
        with contextlib.suppress(TailbeatError):
            fish.link.flush()

    return pump


@dataclass(frozen=True)
class _Filming:
    """Somebody, and the film that is wanted while it swims."""

    person: Operator
    live: LiveCamera

    def tell(self, event: Event) -> None:
        """Passes it on."""
        if isinstance(event, TrialStarted | TrialRecorded) and self.live.recorder is not None:
            self.live.recorder.wanted = isinstance(event, TrialStarted)
        self.person.tell(event)

    def wants_abort(self) -> bool:
        """As the person does."""
        return self.person.wants_abort()

    def decide(self, swum: RecordedTrial) -> Decision:
        """As the person does."""
        return self.person.decide(swum)

    def confirm(self, question: str) -> bool:
        """As the person does."""
        return self.person.confirm(question)


def _document(end: SeriesEnd, experiment: Experiment) -> dict[str, Any]:
    return {
        "why": end.why,
        "words": end.words,
        "experiment": experiment.folder,
        "swims": [_swim_document(one) for one in end.rounds],
        "verdict": end.verdict,
    }


def _swim_document(one: Round) -> dict[str, Any]:
    swum = one.swum
    return {
        "trial": swum.outcome.number,
        "iteration": swum.outcome.iteration,
        "end": swum.outcome.end,
        "executed_beats": swum.outcome.executed_beats,
        "decision": one.decision.kind,
        "reason": one.decision.reason,
        "file": swum.file,
        "max_abs_error_m_s": swum.max_abs_error_m_s,
        "rms_error_m_s": swum.rms_error_m_s,
        "measured_beats": swum.measured_beats,
        "beats": swum.beats,
        "battery_start_v": swum.battery_start_v,
        "battery_end_v": swum.battery_end_v,
        "ready": swum.ready,
        "straight": swum.straight,
        "problems": swum.problems,
        "report": one.learned,
    }


def _text(end: SeriesEnd, told: bool) -> str:
    """``told``: with how it ended; otherwise that is said as an error."""
    lines = [
        f"trial {one.swum.outcome.number}, iteration {one.swum.outcome.iteration}: "
        f"{one.decision.kind}, max|e| {mm(one.swum.max_abs_error_m_s)} mm/s"
        for one in end.rounds
    ]
    if end.verdict is not None:
        lines.append(end.verdict.words)
        if end.verdict.saturation is not None and not end.verdict.stop:
            lines.append(end.verdict.saturation.text)
    if told:
        lines.append(f"ended ({end.why}): {end.words}")
    return "\n".join(lines)
