"""camera track, render."""

from __future__ import annotations

import math
from contextlib import closing, nullcontext
from pathlib import Path
from typing import Any

import typer

from tailbeat.app.cli._camera import MARKERS_METAVAR, MarkerOptions
from tailbeat.app.cli._lazy import arg, opt
from tailbeat.app.cli._terminal import Output, progress_bar, warn
from tailbeat.app.exercise import Exercise, ExerciseOptions, make_exercise
from tailbeat.core.errors import InputError
from tailbeat.core.printable import mm
from tailbeat.core.trial_file import read_trial
from tailbeat.experiment.current import named_reference
from tailbeat.report.figures.track import draw_track
from tailbeat.sensors.camera.calibration.file import Calibration, load_calibration
from tailbeat.sensors.camera.film_to_speed import (
    FilmAnalysis,
    Overlay,
    analyse,
    new_folder,
    write_analysis,
)
from tailbeat.sensors.camera.marker.detector import MarkerKind
from tailbeat.sensors.camera.render.scene import Scene
from tailbeat.sensors.camera.source.open import SourceOptions, open_source
from tailbeat.sensors.camera.source.picture import PictureSource
from tailbeat.sensors.camera.tracking.track import Progress

_SIZE_MIN_PX, _SIZE_MAX_PX = 64, 8192


def render(
    film: Path = arg("To write: .mp4 or .mkv.", "FILM"),
    reference: str = opt(
        "The reference: thesis, trapezoid:V,RAMP_S,HOLD_S, … or a CSV.", default="thesis"
    ),
    plant: str = opt("Model of the fish.", "tank|thesis", default="tank"),
    seed: int = opt("Same seed, same film.", min=0, default=1),
    fps: float = opt("Pictures per second.", min=1, max=240, default=25),
    size: str = opt("Of the picture, pixels.", "WxH", default="1280x720"),
    marker: MarkerKind = opt("What the fish carries.", MARKERS_METAVAR, default="aruco"),
    lost: float = opt("Part of the pictures never taken.", min=0, max=0.9, default=0.0),
    hidden: float = opt("Part with half of the marker covered.", min=0, max=1, default=0.0),
    glare: float = opt("Size of a bright spot that wanders.", min=0, max=1, default=0.0),
    noise_mm: float = opt("How far a drawn fish is off its place.", min=0, default=0.0),
    fish: int = opt("Number of fish.", min=1, max=2, default=1),
    offset: float = opt("Film before the trial begins, s.", min=0.1, max=60, default=2.0),
) -> Output:
    """Film a simulated trial: the film, its truth, its calibration and the trial's log.

    Example: tailbeat camera render swim.mp4 --lost 0.1 --glare 0.5
    """
    scene = Scene(
        size_px=_size(size), marker=marker, glare=glare, hidden=hidden, fish=fish, seed=seed
    )
    options = ExerciseOptions(
        reference=named_reference(reference),
        scene=scene,
        plant=plant,
        seed=seed,
        before_s=offset,
        overrides={"camera_fps": fps, "camera_lost": lost, "camera_noise_m": noise_mm * 1e-3},
    )
    with progress_bar("render") as show:
        exercise = make_exercise(film, options, show)
    return Output(exercise, lambda: _render_text(exercise))


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise InputError(f"'{text}' is no size of a picture.", "Write it like --size 1280x720.")
    size = int(width), int(height)
    if min(size) < _SIZE_MIN_PX or max(size) > _SIZE_MAX_PX:
        limits = f"from {_SIZE_MIN_PX}x{_SIZE_MIN_PX} to {_SIZE_MAX_PX}x{_SIZE_MAX_PX}"
        raise InputError(f"no film is drawn of {text} pixels.", f"Give a --size {limits}.")
    return size


def _render_text(exercise: Exercise) -> str:
    lost = f", {exercise.lost} lost" if exercise.lost else ""
    return (
        f"{exercise.film}: {exercise.pictures} pictures at {exercise.fps:g} per second{lost}; "
        f"trial {exercise.trial} begins at {exercise.swim_begin_s:.3f} s\n"
        f"{exercise.truth}: where the fish was drawn, and its speed\n"
        f"{exercise.calibration}: the camera's calibration\n"
        f"{exercise.trial_file}: the trial's log"
    )


CALIBRATION = Path("tank.json")
_SIZE_OFF_MAX = 0.02


def track(
    *,
    source: str = arg("A film, or a camera: 0, /dev/video0.", "VIDEO|DEVICE"),
    marker: MarkerOptions,
    trial: Path | None = opt("The trial's file: 'trial pull'.", "FILE.ulg"),
    start: float | None = opt("Second of the film at which the trial begins.", "S"),
    beat: float = opt("Length of a beat; with --trial its own.", "S", default=1.0),
    out: Path | None = opt("Folder for the results; default: as the film."),
    overlay: bool = opt("Film of what was seen, as overlay.mp4."),
    plot: bool = opt("Way and speed as track.png."),
    seconds: float | None = opt("So long, then end; a device: 60.", "N"),
) -> Output:
    """Find the fish in a film, and its speed with error bars.

    With --trial the film is synchronised with the trial, by the board's LED if it is in view,
    otherwise by the fish's yaw oscillation. A film of another trial is refused (by the yaw only
    when its amplitudes were others). The results are complete or not there at all.

    Example: tailbeat camera track swim7.mp4 --trial 0007.ulg --plot
    """
    if not 0.1 <= beat <= 10:
        raise typer.BadParameter("--beat is in seconds, like 1")
    if seconds is not None and not seconds > 0:
        raise typer.BadParameter("--seconds is more than 0")
    on_fish = marker.on_fish()
    known = _calibration(marker.calibration)
    log = read_trial(trial) if trial is not None else None
    folder = out or _folder(source)
    options = SourceOptions(known.size_px, marker.latency)
    with (
        closing(open_source(source, options, seconds)) as pictures,
        new_folder(folder) as part,
        Overlay(part / "overlay.mp4", pictures.size_px, pictures.fps)
        if overlay
        else nullcontext() as film,
        progress_bar("tracking") as show,
    ):
        progress = _progress(show, pictures, seconds)
        found = analyse(pictures, on_fish, known, log, start, beat, progress, film)
        if plot:
            draw_track(found.track, found.curve, part / "track.png", known)
        write_analysis(found, part)
    document = {"folder": folder, **found.summary()}
    if warning := _size_warning(found.track.marker_side_m, marker.marker_side):
        warn(warning)
    return Output(document, lambda: _track_text(found, document, folder))


def _calibration(path: Path | None) -> Calibration:
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
    """Pictures done, of those that come in so many seconds."""
    expected = seconds * pictures.fps if seconds is not None else math.nan

    def follow(done: int, part: float) -> None:
        part = min(1.0, done / expected) if math.isnan(part) and expected else part
        show(0.0 if math.isnan(part) else part, f"{done} pictures")

    return follow


def _track_text(found: FilmAnalysis, document: dict[str, Any], folder: Path) -> str:
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
        if missing := document["beats"] - document["measured_beats"]:
            lines.append(
                f"note: {missing} of {document['beats']} beats have no speed: more than 5 pictures "
                "in a row without the fish, or 40 %"
            )
        lines.append(f"next: tailbeat trial speeds {found.trial.number} {folder / 'speed.csv'}")
    return "\n".join(lines)


def _straight_text(found: FilmAnalysis) -> str:
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


def _sync_text(found: FilmAnalysis) -> str:
    sync = found.sync
    if sync is None:
        return "in time with no trial: give --trial FILE.ulg"
    at = f"the trial begins at {sync.start_s:.3f} s"
    if sync.how == "given":
        return f"{at}, as given"
    by = "by the LED" if sync.how == "led" else "by the fish's yaw oscillation"
    line = f"{at} +-{sync.sigma_s * 1e3:.0f} ms, {by}"
    if found.trial is None:
        line += f", which shows trial {sync.trial} (or one 256 away): give its file, --trial"
    elif sync.how == "yaw":
        line += (
            "; trials with nearly equal amplitudes look alike: "
            f"is it trial {found.trial.number}'s film?"
        )
    return line
