"""trial run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.cli.cameraoptions import (
    CalibrationOption,
    LatencyOption,
    MarkerIdOption,
    MarkerKindOption,
    MarkerSideOption,
    marker_of,
)
from tailbeat.cli.common import Connect, Json, connected, mm, plain, progress_bar, say
from tailbeat.cli.livecamera import (
    Live,
    LiveOptions,
    camera_report,
    camera_text,
    lateness_warning,
    live_camera,
)

if TYPE_CHECKING:
    from tailbeat.fish import Fish
    from tailbeat.results import TrialOutcome

SEVERITY_WARNING = 4  # MAV_SEVERITY_WARNING; lower is worse

_LINK_NEWS = {
    "link_lost": "the link broke; trying to get it back (without it the board stops by itself)",
    "link_back": "the link is back",
}


def run(
    camera: Annotated[
        str | None,
        typer.Option(
            "--camera",
            metavar="DEVICE|tcp:HOST:PORT|rendered",
            help="A camera (0, /dev/video0), a stream of positions, or the simulated fish drawn.",
        ),
    ] = None,
    calibration: CalibrationOption = None,
    marker: MarkerKindOption = "aruco",
    marker_id: MarkerIdOption = None,
    marker_side: MarkerSideOption = None,
    latency: LatencyOption = 0.0,
    video: Annotated[
        Path | None,
        typer.Option("--video", metavar="FILM.mkv", help="Film what the camera sees."),
    ] = None,
    wall: Annotated[
        float | None,
        typer.Option(
            "--wall",
            min=0.0,
            max=2.0,
            metavar="M",
            help="Stop a fish of 0.08 m/s so far from a wall, slower ones later; 0 = never.",
        ),
    ] = None,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Arm if needed, swim the next trial to its end, show how it went. Ctrl-C stops the tail.

    With a camera and its calibration the fish's speed goes to the board as it swims, and the tail
    stops before the fish meets a wall.

    Example: tailbeat trial run --camera 0 --calibration tank.json --video swim.mkv
    """
    on_fish = marker_of(marker, marker_id, marker_side)
    options = LiveOptions(camera, on_fish, calibration, latency, video, wall)
    with connected(connect) as fish, live_camera(fish, options) as live:
        with progress_bar(json, "swimming") as show:
            outcome = fish.run_trial(live.camera, _follower(fish, live, show), live.guard)
        report = camera_report(fish, live.video, outcome.number) if live.video else None
        document, text = _told(outcome, report)
        say(json, document, text)
    if report and (warning := lateness_warning(report, latency)):
        typer.echo(f"tailbeat: {warning}", err=True)
    if outcome.interrupted:
        raise typer.Exit(130)
    if outcome.end != "complete":
        raise typer.Exit(1)


def _follower(
    fish: Fish, live: Live, show: Callable[[float, str], None]
) -> Callable[[dict[str, Any]], None]:
    """Shows what happens while it happens."""
    beats = max(fish.status().beats, 1)

    def follow(event: dict[str, Any]) -> None:
        if event["event"] == "started" and live.recorder is not None:
            live.recorder.wanted = True
        if event["event"] == "beat":
            speed = mm(event.get("speed_m_s"))
            show((event["beat"] + 1) / beats, f"beat {event['beat'] + 1}: {speed} mm/s")
        elif event["event"] in ("warning", "hold") or _is_warning(event):
            typer.echo(f"tailbeat: {event['text']}", err=True)
        elif event["event"] == "guard":
            typer.echo(f"tailbeat: stopped: {event['reason']}", err=True)
        elif event["event"] in _LINK_NEWS:
            typer.echo(f"tailbeat: {_LINK_NEWS[event['event']]}", err=True)

    return follow


def _told(outcome: TrialOutcome, report: dict[str, float] | None) -> tuple[Any, str]:
    """A swim as a document and in words."""
    if report is None:
        return outcome, _outcome_text(outcome)
    return plain(outcome) | {"camera": report}, f"{_outcome_text(outcome)}\n{camera_text(report)}"


def _is_warning(event: dict[str, Any]) -> bool:
    return bool(event["event"] == "text" and event["severity"] <= SEVERITY_WARNING)


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
    return "tailbeat clear" + (learn if measured else "")
