"""trial run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from tailbeat.app.cli._camera import (
    CAMERA,
    LiveCamera,
    TankCameraOptions,
    camera_report,
    camera_text,
    lateness_warning,
    live_camera,
)
from tailbeat.app.cli._connect import connected
from tailbeat.app.cli._options import Connect, Into, Json, Rest
from tailbeat.app.cli._terminal import echo, mm, progress_bar, say
from tailbeat.app.cli.guided import GuideOptions, run_guided
from tailbeat.board.fish import Fish
from tailbeat.core.errors import TailbeatError
from tailbeat.core.files import plain
from tailbeat.experiment.current import require_meant_here, require_own
from tailbeat.experiment.library import known_fish_of, logbook_of
from tailbeat.learning.saturation import Saturation, saturation_next
from tailbeat.link.messages import BeatEvent, TrialOutcome
from tailbeat.session.events import Event, OnEvent, TrialStarted
from tailbeat.session.guards import Guard, together
from tailbeat.session.presenter import alert
from tailbeat.session.travel import room_guard, travel_next
from tailbeat.session.trial import run_trial


def run(
    camera: TankCameraOptions = CAMERA,
    video: Annotated[
        Path | None,
        typer.Option("--video", metavar="FILM.mkv", help="Film what the camera sees."),
    ] = None,
    guide: Annotated[
        bool | None,
        typer.Option(
            "--guide/--no-guide",
            help="Rest, pose, still water, countdown, trial, keep or not; default: at a terminal.",
            show_default=False,
        ),
    ] = None,
    rest: Rest = None,
    until: Annotated[
        str | None,
        typer.Option(
            "--until",
            metavar="converged|battery|N",
            help="Run trials until then; default: 1 kept trial.",
        ),
    ] = None,
    into: Into = None,
    then: Annotated[
        str | None,
        typer.Option(
            "--then",
            metavar="keep|repeat|discard",
            help="Answer for every trial, given now; one you stop by a key is asked about.",
        ),
    ] = None,
    reason: Annotated[
        str | None,
        typer.Option("--reason", metavar="TEXT", help="Why --then repeat or discard."),
    ] = None,
    learn: Annotated[
        bool, typer.Option("--learn/--no-learn", help="Learn from what is kept at once.")
    ] = True,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Arm if needed, run the next trial to its end, print how it went. Ctrl-C stops the tail.

    At a terminal it guides: rest, start pose, still water, countdown; any key stops the tail; then
    you keep, repeat or discard the trial, and the log goes into the experiment. Elsewhere it runs
    once and the trial stays pending, unless one of --guide, --rest, --until, --into and --then is
    given. With a camera and its calibration the tail stops before the fish meets a wall.

    Example: tailbeat trial run --until converged --rest 60 --camera 0 --calibration tank.json
    """
    options = camera.live(video).check()
    given = GuideOptions(guide, rest, until, into, then, reason, learn)
    guided = given.wanted()
    with _interrupt_reported(), connected(connect) as fish, live_camera(fish, options) as live:
        if guided:
            run_guided(fish, live, given, json)
            return
        guard = _guarded(fish, live.guard)
        with progress_bar(json, "swimming") as show:
            outcome = run_trial(fish, live.camera, _follower(fish, live, show), guard)
        report = camera_report(fish, live.video, outcome.number) if live.video else None
        document, text = _document_and_text(outcome, report, _saturation(fish, outcome))
        say(json, document, text)
    if report and (warning := lateness_warning(report, camera.latency)):
        echo(f"tailbeat: {warning}", err=True)
    if outcome.interrupted:
        raise typer.Exit(130)
    if outcome.end != "complete":
        raise typer.Exit(1)


@contextmanager
def _interrupt_reported() -> Iterator[None]:
    """Also before a trial begins, and when Ctrl-C comes twice."""
    try:
        yield
    except KeyboardInterrupt as interrupt:
        why = str(interrupt) or "stopped by Ctrl-C"
        echo(f"tailbeat: {why}; nothing is lost", err=True)
        raise typer.Exit(130) from None


def _guarded(fish: Fish, guard: Guard | None) -> Guard:
    """Refuses a trial along what is not the fish's own or with unexpected parameters, and one that
    the tank has no room for; ends one that comes farther."""
    require_own(fish)
    require_meant_here(fish)
    book = logbook_of(fish)
    travel_next(fish, book).require_room()
    return together(guard, room_guard(fish, book))


def _follower(fish: Fish, live: LiveCamera, show: Callable[[float, str], None]) -> OnEvent:
    """Shows what happens while it happens."""
    beats = max(fish.status().beats, 1)

    def follow(event: Event) -> None:
        if isinstance(event, TrialStarted) and live.recorder is not None:
            live.recorder.wanted = True
        if isinstance(event, BeatEvent):
            speed = mm(event.speed_m_s)
            show((event.beat + 1) / beats, f"beat {event.beat + 1}: {speed} mm/s")
        elif words := alert(event):
            echo(f"tailbeat: {words}", err=True)

    return follow


def _document_and_text(
    outcome: TrialOutcome, report: dict[str, float] | None, saturation: Saturation | None
) -> tuple[Any, str]:
    """A trial as a document and in words."""
    document = plain(outcome) | {"saturation": saturation}
    lines = [_outcome_text(outcome)]
    if saturation is not None:
        lines.append(saturation.text)
    if report is not None:
        document["camera"] = report
        lines.append(camera_text(report))
    return document, "\n".join(lines)


def _saturation(fish: Fish, outcome: TrialOutcome) -> Saturation | None:
    """None also when the board or the trial library cannot tell: the trial is over all the same."""
    try:
        return saturation_next(
            fish, outcome.executed_beats, lambda: known_fish_of(logbook_of(fish))
        )
    except TailbeatError:
        return None


def _outcome_text(outcome: TrialOutcome) -> str:
    errors = [
        abs(beat.reference_m_s - beat.speed_m_s)
        for beat in outcome.beats
        if beat.speed_m_s is not None
    ]
    worst = f", max|e| {mm(max(errors))} mm/s" if errors else ", no speeds measured"
    line = f"trial {outcome.number}, iteration {outcome.iteration}: {outcome.end}, "
    unmeasured = outcome.executed_beats - len(errors)
    missing = f" ({unmeasured} without a speed)" if errors and unmeasured > 0 else ""
    line += f"{outcome.executed_beats} beats{missing}{worst}"
    return line + ("" if outcome.end == "complete" else f"\nnext: {_next_words(bool(errors))}")


def _next_words(measured: bool) -> str:
    """After a trial that did not end by itself."""
    learn = ", then tailbeat learn (the beats it swam count) or tailbeat trial discard"
    return "tailbeat board clear" + (learn if measured else "")
