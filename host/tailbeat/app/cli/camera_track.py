"""camera track."""

from __future__ import annotations

import math
import time
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.app.cli._options import (
    CalibrationOption,
    LatencyOption,
    MarkerIdOption,
    MarkerKindOption,
    MarkerSideOption,
    marker_of,
)
from tailbeat.app.cli._terminal import Json, echo, mm, progress_bar, say

if TYPE_CHECKING:
    from tailbeat.sensors.camera.calibration.file import Calibration
    from tailbeat.sensors.camera.film_to_speed import Analysis
    from tailbeat.sensors.camera.source.picture import PictureSource
    from tailbeat.sensors.camera.tracking.track import Progress

CALIBRATION = Path("tank.json")
_SIZE_OFF_MAX = 0.02


def track(
    source: Annotated[
        str, typer.Argument(metavar="VIDEO|DEVICE", help="A film, or a camera: 0, /dev/video0.")
    ],
    calibration: CalibrationOption = None,
    marker: MarkerKindOption = "aruco",
    marker_id: MarkerIdOption = None,
    marker_side: MarkerSideOption = None,
    trial: Annotated[
        Path | None,
        typer.Option("--trial", metavar="FILE.ulg", help="The swim's file: 'trial pull'."),
    ] = None,
    start: Annotated[
        float | None,
        typer.Option("--start", metavar="S", help="Second of the film at which the swim begins."),
    ] = None,
    beat: Annotated[
        float, typer.Option("--beat", metavar="S", help="Length of a beat; with --trial its own.")
    ] = 1.0,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for the results; default: as the film.")
    ] = None,
    overlay: Annotated[
        bool, typer.Option("--overlay", help="Film of what was seen, as overlay.mp4.")
    ] = False,
    plot: Annotated[bool, typer.Option("--plot", help="Way and speed as track.png.")] = False,
    seconds: Annotated[
        float | None,
        typer.Option("--seconds", metavar="N", help="So long, then end; a device: 60."),
    ] = None,
    latency: LatencyOption = 0.0,
    json: Json = False,
) -> None:
    """Find the fish in a film, and from that its speed with error bars.

    With --trial the film is put in time with the swim, by the board's LED if it is in view,
    otherwise by the fish's wobble; a film of another swim is refused (by the wobble only when its
    amplitudes were others). The results are complete or
    not there at all.

    Example: tailbeat camera track swim7.mp4 --trial 0007.ulg --plot
    """
    if not 0.1 <= beat <= 10:
        raise typer.BadParameter("--beat is in seconds, like 1")
    if seconds is not None and not seconds > 0:
        raise typer.BadParameter("--seconds is more than 0")
    wanted = marker_of(marker, marker_id, marker_side)
    from tailbeat.core.trial_file import read_trial
    from tailbeat.sensors.camera.film_to_speed import analyse, new_folder, write_analysis
    from tailbeat.sensors.camera.source.open import open_source

    known = _calibration(calibration)
    swim = read_trial(trial) if trial is not None else None
    folder = out or _folder(source)
    with ExitStack() as stack:
        pictures = stack.enter_context(
            closing(open_source(source, seconds, latency, known.size_px))
        )
        part = stack.enter_context(new_folder(folder))
        on_place = None
        if overlay:
            from tailbeat.sensors.camera.tracking.overlay import Overlay

            on_place = stack.enter_context(
                Overlay(part / "overlay.mp4", pictures.size_px, pictures.fps)
            )
        show = stack.enter_context(progress_bar(json, "tracking"))
        progress = _progress(show, pictures, seconds)
        found = analyse(pictures, wanted, known, swim, start, beat, progress, on_place)
        if plot:
            from tailbeat.report.figures.track import draw_track

            draw_track(found.track, found.curve, part / "track.png", known)
        write_analysis(found, part)
    document = {"folder": folder, **found.summary()}
    say(json, document, lambda: _text(found, document, folder))
    if warning := _size_warning(found.track.marker_side_m, marker_side):
        echo(f"tailbeat: {warning}", err=True)


def _calibration(path: Path | None) -> Calibration:
    from tailbeat.core.errors import InputError
    from tailbeat.sensors.camera.calibration.file import load_calibration

    if path is None and not CALIBRATION.is_file():
        raise InputError(
            f"there is no {CALIBRATION} here, and pixels are no metres",
            "Give --calibration FILE; make one: tailbeat camera calibrate",
        )
    return load_calibration(path or CALIBRATION)


def _folder(source: str) -> Path:
    """Beside the film, with its name; for a device here."""
    path = Path(source)
    if path.is_file():
        return path.with_suffix("") if path.suffix else path.with_name(f"{path.name}-track")
    return Path("camera-" + path.name)


def _progress(show: Any, pictures: PictureSource, seconds: float | None) -> Progress:
    """Pictures done, and how long it still takes."""
    begin = time.monotonic()
    expected = seconds * pictures.fps if seconds is not None else math.nan

    def follow(done: int, part: float) -> None:
        part = min(1.0, done / expected) if math.isnan(part) and expected else part
        if math.isnan(part):
            show(0.0, f"{done} pictures")
            return
        left_s = (time.monotonic() - begin) * (1 - part) / max(part, 1e-9)
        show(part, f"{done} pictures, {left_s:.0f} s left")

    return follow


def _text(found: Analysis, document: dict[str, Any], folder: Path) -> str:
    lines = [
        f"{found.track.name}: {document['pictures']} pictures, the fish seen in "
        f"{document['seen'] / document['pictures']:.1%}; "
        f"{document['bridged']} bridged, {document['lost']} lost",
        f"mean speed {mm(document['mean_speed_m_s'])} mm/s{_of_beats(document)}, "
        f"sigma {_fine_mm(document['sigma_median_m_s'])} mm/s (median)",
        _sync_text(found),
        _straight_text(found),
        f"written: {folder}/",
    ]
    if document["scale_error"] is None:
        lines.append("note: this calibration was never checked with a ruler")
    if found.trial is not None:
        measured, beats = document["measured_beats"], document["beats"]
        if measured < beats:
            lines.append(
                f"note: {beats - measured} of {beats} beats have no speed: more than 5 pictures "
                "in a row without the fish, or 40 %"
            )
        lines.append(f"next: tailbeat speed upload {found.trial.number} {folder / 'speed.csv'}")
    return "\n".join(lines)


def _straight_text(found: Analysis) -> str:
    straight = found.straight()
    if straight is None:
        return "straightness not known: too little was seen of it"
    way = f"speeds are along its way, {math.degrees(found.curve.direction_rad):+.1f} degrees"
    return f"{straight.text()}; {way}"


def _of_beats(document: dict[str, Any]) -> str:
    measured, beats = document["measured_beats"], document["beats"]
    return "" if measured == beats else f" over the {measured} measured beats of {beats}"


def _size_warning(seen_m: float | None, said_m: float | None) -> str:
    """A marker of another size than said, or a scale that is wrong, is a wrong speed."""
    if seen_m is None or said_m is None or abs(seen_m / said_m - 1) < _SIZE_OFF_MAX:
        return ""
    return (
        f"the marker measures {seen_m * 1e3:.1f} mm, said {said_m * 1e3:.1f}: "
        f"{seen_m / said_m - 1:+.1%}; a wrong side or scale is a wrong speed"
    )


def _fine_mm(value_m_s: float | None) -> str:
    return "-" if value_m_s is None else f"{value_m_s * 1e3:.2f}"


def _sync_text(found: Analysis) -> str:
    sync = found.sync
    if sync is None:
        return "in time with no trial: give --trial FILE.ulg"
    at = f"the swim begins at {sync.start_s:.3f} s"
    if sync.how == "given":
        return f"{at}, as given"
    by = "by the LED" if sync.how == "led" else "by the fish's wobble"
    line = f"{at} +-{sync.sigma_s * 1e3:.0f} ms, {by}"
    if found.trial is None:
        line += f", which shows trial {sync.trial} (or one 256 away): give its file, --trial"
    elif sync.how == "yaw":
        line += (
            "; swims with nearly equal amplitudes look alike: "
            f"is it trial {found.trial.number}'s film?"
        )
    return line
