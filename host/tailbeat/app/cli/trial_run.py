"""trial run: once, or guided with questions and preflight checks."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import typer

from tailbeat.app.cli._camera import LiveCamera, TankCameraOptions, camera_report, live_camera
from tailbeat.app.cli._fish import Connect, Stream, connected
from tailbeat.app.cli._lazy import opt
from tailbeat.app.cli._operator import Rest, TerminalOperator, terminal
from tailbeat.app.cli._options import EXPERIMENTS, Into, verdict_lines
from tailbeat.app.cli._terminal import Output, command_typed, lines_of, pick, progress_bar, warn
from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.files import plain
from tailbeat.core.printable import mm
from tailbeat.experiment.current import (
    begin,
    current,
    require_expected_here,
    require_own,
    require_same,
    use,
)
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import known_fish_of, library_of
from tailbeat.learning.saturation import Saturation, saturation_next
from tailbeat.link.messages import BeatEvent, TrialOutcome
from tailbeat.session.events import Event, OnEvent
from tailbeat.session.guards import Guard, guards_of
from tailbeat.session.next_law import LawName
from tailbeat.session.options import Options, Until
from tailbeat.session.outcome import Decision, DecisionKind
from tailbeat.session.preflight_step import PreflightLimits
from tailbeat.session.presenter import alert
from tailbeat.session.proposals import Trials
from tailbeat.session.series import Round, SeriesEnd
from tailbeat.session.travel import guarded_trial, travel_next
from tailbeat.session.trial import run_trial

GOOD_ENDS = ("swims", "converged", "saturated")


@dataclass(frozen=True)
class GuideOptions:
    """How ``trial run`` guides. ``guide`` None: when somebody is there, or one of the others was
    given."""

    guide: bool | None = opt(
        "Rest, pose, still water, countdown, trial, keep or not; default: at a terminal.",
        name="--guide/--no-guide",
        show_default=False,
    )
    rest: Rest = None
    until: Until | None = opt(
        "Run trials until then; default: 1 kept trial.", "converged|battery|N", by=Until.parse
    )
    into: Into = None
    then: DecisionKind | None = opt(
        "Answer for every trial, given now; one you stop by a key is asked about.",
        "keep|repeat|discard",
    )
    reason: str | None = opt("Why --then repeat or discard.", "TEXT")
    learn: bool = opt("Learn from what is kept at once.", name="--learn/--no-learn", default=True)
    law: LawName = opt(
        "Of the inputs; auto: model-based once a model predicts the fish, else P.",
        "auto|model|p",
        default="auto",
    )

    def guided(self) -> bool:
        """Whether it is guided. Raises typer.BadParameter for what contradicts itself."""
        given = [self.rest, self.until, self.into, self.then]
        asked = any(value is not None for value in given) or not self.learn or self.law != "auto"
        if self.guide is False and (asked or self.reason is not None):
            raise typer.BadParameter(
                "--no-guide goes without --rest, --until, --into, --then, --reason, --law and"
                " --no-learn"
            )
        if self.reason is not None and self.then is None:
            raise typer.BadParameter("--reason belongs to --then repeat or --then discard")
        self.answer()
        at_terminal = sys.stdin.isatty() and sys.stderr.isatty()
        return asked or at_terminal if self.guide is None else self.guide

    def answer(self) -> Decision | None:
        """What was decided beforehand."""
        if self.then is None:
            return None
        try:
            return Decision(self.then, self.reason or "")
        except InputError as error:
            raise typer.BadParameter(f"--then {self.then} needs --reason WHY") from error

    def options(self) -> Options:
        """As the series takes them."""
        return Options(
            until=self.until or Until(),
            wanted=self.rest or PreflightLimits(),
            learn=self.learn,
            counts=(self.then or "keep",),
            typed=command_typed(),
            law=self.law,
        )


def run(
    *,
    camera: TankCameraOptions,
    video: Path | None = opt("Film what the camera sees.", "FILM.mkv"),
    given: GuideOptions,
    stream: Stream = None,
    connect: Connect = None,
) -> Output:
    """Arm if needed, run the next trial to its end, print how it went. Ctrl-C stops the tail.

    At a terminal it guides: rest, start pose, still water, countdown; any key stops the tail; then
    you keep, repeat or discard the trial, and the log goes into the experiment. Elsewhere it runs
    once and the trial stays pending, unless one of --guide, --rest, --until, --into and --then is
    given. With a camera and its calibration the tail stops before the fish meets a wall.

    Example: tailbeat trial run --until converged --rest 60 --camera 0 --calibration tank.json
    """
    camera.check(video)
    guided = given.guided()
    try:
        fish_here = connected(connect, stream=stream)
        with fish_here as fish, live_camera(fish, camera, video) as live:
            if guided:
                return _run_guided(fish, live, given)
            return _run_once(fish, live, camera.latency)
    except KeyboardInterrupt as interrupt:  # also before a trial begins, and when it comes twice
        warn(f"{str(interrupt) or 'stopped by Ctrl-C'}; nothing is lost")
        raise typer.Exit(130) from None


def _run_once(fish: Fish, live: LiveCamera, latency_s: float) -> Output:
    guard = _guarded(fish, live.guard)
    with progress_bar("swimming") as show:
        outcome = run_trial(fish, live.camera, _follower(fish, live, show), guard)
    saturation = _saturation(fish, outcome)
    document: dict[str, Any] = plain(outcome) | {"saturation": saturation}
    camera = ""
    if live.video is not None:
        report = camera_report(fish, live.video, outcome.number, latency_s)
        document["camera"], camera = report
    text = lines_of(_outcome_text(outcome), saturation and saturation.text, camera)
    status = 130 if outcome.interrupted else int(outcome.end != "complete")
    return Output(document, text, status)


def _guarded(fish: Fish, guard: Guard | None) -> Guard:
    """Refuses a trial along what is not the fish's own or with unexpected parameters, and one that
    the tank has no room for; ends one that comes farther."""
    require_own(fish)
    require_expected_here(fish)
    book = library_of(fish)
    travel_next(fish, book).require_room()
    return guards_of(guarded_trial(fish, book, guard))


def _follower(fish: Fish, live: LiveCamera, show: Callable[[float, str], None]) -> OnEvent:
    """Shows what happens while it happens."""
    beats = max(fish.status().beats, 1)

    def follow(event: Event) -> None:
        live.follow(event)
        if isinstance(event, BeatEvent):
            speed = mm(event.speed_m_s)
            show((event.beat + 1) / beats, f"beat {event.beat + 1}: {speed} mm/s")
        elif words := alert(event):
            warn(words)

    return follow


def _saturation(fish: Fish, outcome: TrialOutcome) -> Saturation | None:
    """None also when the board or the trial library cannot tell: the trial is over all the same."""
    try:
        return saturation_next(
            fish, outcome.executed_beats, lambda: known_fish_of(library_of(fish))
        )
    except TailbeatError:
        return None


def _outcome_text(outcome: TrialOutcome) -> str:
    errors = [
        abs(beat.reference_m_s - beat.speed_m_s)
        for beat in outcome.beats
        if beat.speed_m_s is not None
    ]
    worst = f"max|e| {mm(max(errors))} mm/s" if errors else "no speeds measured"
    unmeasured = outcome.executed_beats - len(errors)
    missing = f" ({unmeasured} without a speed)" if errors and unmeasured > 0 else ""
    learn = ", then tailbeat trial learn (the measured beats count) or tailbeat trial discard"
    return lines_of(
        f"trial {outcome.number}, iteration {outcome.iteration}: {outcome.end}, "
        f"{outcome.executed_beats} beats{missing}, {worst}",
        outcome.end != "complete" and f"next: tailbeat board clear{learn if errors else ''}",
    )


def _run_guided(fish: Fish, live: LiveCamera, given: GuideOptions) -> Output:
    """Runs the series. Exit status 0 when it ended as was asked for."""
    with terminal() as (display, keys):
        folder = partial(
            experiment_for, fish, given.into, lambda text: display.keep(text, loud=True)
        )
        idle = partial(keep_alive, fish)
        operator = TerminalOperator(display, keys, given.answer(), idle, on_event=live.follow)
        options = replace(given.options(), proposes=keys is not None and given.then is None)
        end, experiment = Trials(fish, operator, options, folder, live.camera, live.guard).run()
    until = options.until
    good = (*GOOD_ENDS, "battery") if until.trials is None and not until.converged else GOOD_ENDS
    status = 0 if end.why in good else 130 if end.why == "interrupted" else 1
    if status:
        warn(end.words)
    return Output(
        series_document(end) | {"experiment": experiment.folder},
        _text(end, good=not status),
        status,
    )


def experiment_for(fish: Fish, into: Experiment | None, tell: Callable[[str], None]) -> Experiment:
    """The folder that was named, else the one this fish is in, else a new one. Raises
    InputError."""
    require_own(fish)
    if into is not None:
        require_same(fish, into)
        use(fish, into)
        return into
    if (found := current(fish)) is not None:
        try:
            require_same(fish, found)
            return found
        except InputError:
            if fish.status().reference_crc is None:
                raise
            tell(f"{found.folder} is of another reference")
    made = begin(fish, EXPERIMENTS)
    tell(f"a new experiment begins: {made.folder}")
    return made


def keep_alive(fish: Fish) -> None:
    """While a question waits: heartbeats go out, what comes in is taken."""
    with contextlib.suppress(TailbeatError):
        fish.link.flush()


def series_document(end: SeriesEnd) -> dict[str, Any]:
    """How a series ended, for ``--json``."""
    return {
        "why": end.why,
        "words": end.words,
        "swims": [_trial_document(one) for one in end.rounds],
        "verdict": end.verdict,
    }


def _trial_document(one: Round) -> dict[str, Any]:
    recorded = one.recorded
    return {
        "trial": recorded.outcome.number,
        **pick(recorded.outcome, "iteration", "end", "executed_beats"),
        "decision": one.decision.kind,
        "reason": one.decision.reason,
        **pick(recorded, "file", "max_abs_error_m_s", "rms_error_m_s", "measured_beats", "beats"),
        **pick(recorded, "battery_start_v", "battery_end_v", "ready", "straight", "problems"),
        "report": one.learned,
        "causes": one.causes,
    }


def _text(end: SeriesEnd, good: bool) -> str:
    """``good``: with how it ended; otherwise that is an error. The trials only where nobody has
    seen the table of them."""
    verdict, seen = end.verdict, sys.stdout.isatty() and sys.stderr.isatty()
    lines = [
        f"trial {one.recorded.outcome.number}, iteration {one.recorded.outcome.iteration}: "
        f"{one.decision.kind}, max|e| {mm(one.recorded.max_abs_error_m_s)} mm/s"
        for one in end.rounds
        if not seen
    ]
    return lines_of(
        lines,
        verdict and [verdict.words, *([] if verdict.stop else verdict_lines(verdict))],
        good and end.text,
    )
