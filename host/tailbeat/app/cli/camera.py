"""camera print, calibrate, track, render."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import closing, nullcontext
from dataclasses import asdict, replace
from datetime import datetime
from itertools import count
from pathlib import Path
from typing import Any, Literal

import numpy as np
import typer

from tailbeat.app.cli._camera import MARKERS_METAVAR, MarkerOptions
from tailbeat.app.cli._lazy import arg, opt
from tailbeat.app.cli._terminal import Output, lines_of, numbers, pick, progress_bar, warn
from tailbeat.app.exercise import Exercise, ExerciseOptions, make_exercise
from tailbeat.core.errors import InputError
from tailbeat.core.printable import mm
from tailbeat.core.reference import Reference
from tailbeat.core.trial_file import read_trial
from tailbeat.experiment.current import named_reference
from tailbeat.report.figures.track import draw_track
from tailbeat.sensors.camera.calibration.calibrate import (
    Calibrated,
    Height,
    Ruler,
    RulerCheck,
    check_scale,
    ruler_in,
)
from tailbeat.sensors.camera.calibration.calibrate import calibrate as make
from tailbeat.sensors.camera.calibration.file import Calibration, load_calibration
from tailbeat.sensors.camera.calibration.points import read_points, rectangle
from tailbeat.sensors.camera.film_to_speed import (
    FilmAnalysis,
    Overlay,
    analyse,
    new_folder,
    write_analysis,
)
from tailbeat.sensors.camera.marker import sheets
from tailbeat.sensors.camera.marker.detector import MarkerKind
from tailbeat.sensors.camera.marker.sheets import Sheet, write_sheet
from tailbeat.sensors.camera.marker.tags import TagKind
from tailbeat.sensors.camera.render.scene import Scene
from tailbeat.sensors.camera.source.open import SourceOptions, open_source, read_all, read_grey
from tailbeat.sensors.camera.source.picture import PictureSource
from tailbeat.sensors.camera.tracking.positions import read_positions
from tailbeat.sensors.camera.tracking.track import Progress
from tailbeat.sim.config import PLANTS

_SIZE_MIN_PX, _SIZE_MAX_PX = 64, 8192


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise InputError(f"'{text}' is no size of a picture.", "Write it like --size 1280x720.")
    size = int(width), int(height)
    if min(size) < _SIZE_MIN_PX or max(size) > _SIZE_MAX_PX:
        limits = f"from {_SIZE_MIN_PX}x{_SIZE_MIN_PX} to {_SIZE_MAX_PX}x{_SIZE_MAX_PX}"
        raise InputError(f"no film is drawn of {text} pixels.", f"Give a --size {limits}.")
    return size


def render(
    film: Path = arg("To write: .mp4 or .mkv.", "FILM"),
    reference: Reference = opt(
        "The reference: thesis, trapezoid:V,RAMP_S,HOLD_S, … or a CSV.",
        default="thesis",
        by=named_reference,
    ),
    plant: str = opt("Model of the fish.", "|".join(PLANTS), default="tank"),
    seed: int = opt("Same seed, same film.", min=0, default=1),
    fps: float = opt("Pictures per second.", min=1, max=240, default=25),
    size: tuple[int, int] = opt("Of the picture, pixels.", "WxH", default="1280x720", by=_size),
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
    scene = Scene(size, marker=marker, glare=glare, hidden=hidden, fish=fish, seed=seed)
    options = ExerciseOptions(
        reference=reference,
        scene=scene,
        plant=plant,
        seed=seed,
        before_s=offset,
        overrides={"camera_fps": fps, "camera_lost": lost, "camera_noise_m": noise_mm * 1e-3},
    )
    with progress_bar("render") as show:
        exercise = make_exercise(film, options, show)
    return Output(exercise, lambda: _render_text(exercise))


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
    positions: Path | None = opt(
        "Positions that DeepLabCut, SLEAP, TRex, idtracker.ai or Tracker found in this film.", "CSV"
    ),
    point: str | None = opt("The point of --positions to follow.", "NAME"),
    head: str | None = opt("A point ahead of it, for the heading.", "NAME"),
    cm_per_pixel: float | None = opt("TRex's scale.", "X", min=1e-6),
) -> Output:
    """Find the fish in a film, and its speed with error bars.

    With --trial the film is synchronised with the trial, by the board's LED if it is in view,
    otherwise by the fish's yaw oscillation. A film of another trial is refused (by the yaw only
    when its amplitudes were others). The results are complete or not there at all. With
    --positions no marker is looked for: another program has tracked the fish in this film.

    Example: tailbeat camera track swim7.mp4 --trial 0007.ulg --plot
    """
    if not 0.1 <= beat <= 10:
        raise typer.BadParameter("--beat is in seconds, like 1")
    if seconds is not None and not seconds > 0:
        raise typer.BadParameter("--seconds is more than 0")
    on_fish = marker.on_fish()
    known = marker.calibration or _calibration()
    log = read_trial(trial) if trial is not None else None
    folder = out or _folder(source)
    if positions is None and (point, head, cm_per_pixel) != (None, None, None):
        raise typer.BadParameter("--point, --head and --cm-per-pixel go with --positions")
    table = read_positions(positions, point, head, cm_per_pixel) if positions is not None else None
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
        found = analyse(pictures, on_fish, known, log, start, beat, progress, film, table)
        if plot:
            draw_track(found.track, found.curve, part / "track.png", known)
        write_analysis(found, part)
    document = {"folder": folder, **found.summary()}
    if warning := _size_warning(found.track.marker_side_m, marker.marker_side):
        warn(warning)
    return Output(document, lambda: _track_text(found, document, folder))


def _calibration() -> Calibration:
    if not CALIBRATION.is_file():
        raise InputError(
            f"there is no {CALIBRATION} here, and pixels are no metres",
            "Give --calibration FILE; make one: tailbeat camera calibrate",
        )
    return load_calibration(CALIBRATION)


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
    measured, beats = document["measured_beats"], document["beats"]
    over = "" if measured == beats else f" over the {measured} measured beats of {beats}"
    sigma = document["sigma_median_m_s"]
    straight, trial = found.straight(), found.trial
    way = f"speeds are along its heading, {math.degrees(found.curve.direction_rad):+.1f} degrees"
    return lines_of(
        f"{found.track.name}: {document['pictures']} pictures, the fish seen in "
        f"{document['seen'] / document['pictures']:.1%}; "
        f"{document['bridged']} bridged, {document['lost']} lost",
        f"mean speed {mm(document['mean_speed_m_s'])} mm/s{over}, "
        f"sigma {'-' if sigma is None else f'{sigma * 1e3:.2f}'} mm/s (median)",
        _sync_text(found),
        f"{straight.text()}; {way}"
        if straight is not None
        else "straightness not known: too little was seen of it",
        f"written: {folder}/",
        document["scale_error"] is None and "note: this calibration was never checked with a ruler",
        trial is not None
        and beats != measured
        and f"note: {beats - measured} of {beats} beats have no speed: more than 5 pictures "
        "in a row without the fish, or 40 %",
        trial is not None and f"next: tailbeat trial speeds {trial.number} {folder / 'speed.csv'}",
    )


def _size_warning(seen_m: float | None, said_m: float | None) -> str:
    """A marker of another size than said, or a scale that is wrong, is a wrong speed."""
    if seen_m is None or said_m is None or abs(seen_m / said_m - 1) < _SIZE_OFF_MAX:
        return ""
    return (
        f"the marker measures {seen_m * 1e3:.1f} mm, said {said_m * 1e3:.1f}: "
        f"{seen_m / said_m - 1:+.1%}; a wrong side or scale is a wrong speed"
    )


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


Paper = Literal["a4", "a3", "letter"]
SheetKind = Literal["board", "marker", "anchors", "ruler"]
_NO_BOARD: dict[str, Any] = {"used": (), "dropped": {}, "unseen": (), "covered": None}
_SHEETS: dict[SheetKind, tuple[Callable[..., Sheet], dict[str, str]]] = {
    "board": (sheets.board_sheet, {}),
    "marker": (sheets.fish_sheet, {"--kind": "kind", "--id": "number", "--side": "side_mm"}),
    "anchors": (sheets.anchors_sheet, {"--id": "number", "--side": "side_mm"}),
    "ruler": (sheets.ruler_sheet, {"--side": "side_mm"}),
}


def print_(
    what: SheetKind = arg("board, marker (the fish's), anchors or ruler.", "WHAT"),
    kind: TagKind | None = opt("Of the fish's marker. Default: aruco."),
    number: int | None = opt(
        "Of the fish's marker (default 7), or this one anchor only.", name="--id"
    ),
    side: float | None = opt("Of a marker's black square.", "MM", min=1.0),
    paper: Paper = opt("Size of the sheet.", default="a4"),
    out: Path | None = opt("Default: WHAT.pdf here.", "PDF"),
) -> Output:
    """Write a sheet to print, exact to the millimetre.

    Print it at 100 % and measure the line of 100 mm on it.

    Example: tailbeat camera print marker --id 7 --side 60
    """
    make_sheet, names = _SHEETS[what]
    given = {"--kind": kind, "--id": number, "--side": side}
    for option, value in given.items():
        if value is not None and option not in names:
            raise typer.BadParameter(f"{option} does not apply to the sheet '{what}'")
    values = {names[option]: value for option, value in given.items() if value is not None}
    sheet, path = make_sheet(paper=paper, **values), out or Path(f"{what}.pdf")
    write_sheet(sheet, path)
    document = {"file": path, "sheet": sheet.name, "paper": sheet.paper, "text": sheet.text}
    return Output(document, f"{path}: {sheet.text}")


def calibrate(
    points: Path | None = opt("u_px,v_px,x_m,y_m or id,x_m,y_m.", "CSV"),
    picture: Path | None = opt("The tank with these points; or a film.", "FILE"),
    board: list[Path] | None = opt("Pictures of the board, a folder, a film.", "PATH"),
    area: str | None = opt(
        "The water, m, from 0,0 on; or X0,Y0,X1,Y1. Default: between the points.", "LENGTH,WIDTH"
    ),
    raise_m: float = opt(
        "The marker's plane is so far above the points.", "M", name="--raise", default=0.0
    ),
    depth_m: float = opt(
        "The marker is so far under water. The points lie on the surface; if not, --raise "
        "is the surface's height above them.",
        "M",
        name="--depth",
        default=0.0,
    ),
    ruler: list[Path] | None = opt("The ruler at the marker's height.", "FILE"),
    ruler_length_m: float | None = opt(
        "Between the middles of its markers.", "M", name="--ruler-length"
    ),
    ruler_points: str | None = opt("Its ends, in pixels, instead.", "U1,V1,U2,V2"),
    camera: str = opt("Which camera, in your words.", "TEXT", default=""),
    out: Path = opt("Write it there.", "FILE", default=Path("tank.json")),
    check: Path | None = opt("Check this one by a ruler; write nothing.", "FILE"),
) -> Output:
    """Calibrate a camera over a tank: pixels become metres.

    Example: tailbeat camera calibrate --board board/ --picture tank.png --points tank.csv
    --area 3.0,1.8 --ruler ruler.png --ruler-length 1.2
    """
    rulers = _rulers(ruler or [], ruler_length_m, ruler_points)
    if check is not None:
        if points is not None or picture is not None or board:
            raise typer.BadParameter("--check goes with --ruler only")
        return _check(check, rulers)
    if points is None or picture is None:
        raise typer.BadParameter("give --points CSV and --picture FILE (or --check FILE)")
    area_m = rectangle(numbers(area, "--area", float)) if area is not None else None
    named = str(picture), read_grey(picture)
    with progress_bar("looking") as show:
        made = make(
            read_points(points),
            named,
            read_all(board or []),
            Height(raise_m, depth_m),
            area_m,
            rulers,
            _look(show),
        )
    now = datetime.now().astimezone().isoformat(timespec="seconds")
    calibration = replace(made.calibration, camera=camera, made_at=now)
    calibration.save(out)
    return Output(_document(made, calibration, out), lambda: _text(made, out))


def _look(show: Callable[[float, str], None]) -> Callable[[str], None]:
    """Shows the pictures as they come; how many a film gives is not known."""
    done = count(1)

    def look(name: str) -> None:
        number = next(done)
        show(number / (number + 5), name)

    return look


def _rulers(pictures: list[Path], length_m: float | None, points: str | None) -> list[Ruler]:
    if not pictures and points is None:
        return []
    if length_m is None:
        raise typer.BadParameter("how long is the ruler? --ruler-length METRES")
    if points is None:
        return [ruler_in(read_grey(path), str(path), length_m) for path in pictures]
    if len(pictures) > 1:
        raise typer.BadParameter("--ruler-points are in one picture")
    ends = numbers(points, "--ruler-points", float)
    if len(ends) != 4:
        raise typer.BadParameter("--ruler-points are four numbers: U1,V1,U2,V2")
    name, size_px = "the ruler", None
    for path in pictures:
        height, width = read_grey(path).shape[:2]
        name, size_px = str(path), (width, height)
    return [Ruler(name, np.array(ends).reshape(2, 2), length_m, size_px)]


def _check(path: Path, rulers: list[Ruler]) -> Output:
    if not rulers:
        raise typer.BadParameter("what to check it by? --ruler FILE --ruler-length METRES")
    checks = check_scale(load_calibration(path), rulers)
    document = {"file": path, "rulers": [_ruler_document(check) for check in checks]}
    return Output(document, lambda: "\n".join(map(_ruler_text, checks)))


def _ruler_document(check: RulerCheck) -> dict[str, Any]:
    return asdict(check) | {"scale_error": check.scale_error}


def _ruler_text(check: RulerCheck) -> str:
    return (
        f"ruler      {check.true_m:g} m measures {check.measured_m:.4f} m: "
        f"{check.scale_error * 100:+.2f} %, sigma {check.sigma * 100:.2f} % ({check.name})"
    )


def _document(made: Calibrated, calibration: Calibration, out: Path) -> dict[str, Any]:
    found, plane = made.intrinsics, made.plane
    board = {f"board_{name}": getattr(found, name, none) for name, none in _NO_BOARD.items()}
    return {
        "file": out,
        **pick(calibration, "size_px", "rms_px", "plane", "area_m", "anchors", "scale_error"),
        "focal_sigma": found.focal_sigma if found else None,
        **board,
        "plane_rms_m": plane.rms_m,
        "plane_foretold_m": plane.predicted_m,
        "points_left_out": {made.points[i]: off for i, off in plane.left_out.items()},
        "camera_height_m": made.camera.height_m if made.camera else None,
        "rulers": [_ruler_document(check) for check in made.rulers],
        **pick(made, "mm_per_px", "notes"),
    }


def _text(made: Calibrated, out: Path) -> str:
    plane, predicted = made.plane, made.plane.predicted_m
    each = f"; each is predicted by the others within {predicted * 1e3:.1f} mm" if predicted else ""
    return lines_of(
        f"camera     {_camera_text(made)}",
        f"points     {len(plane.off_m)}, {plane.rms_m * 1e3:.1f} mm off (RMS){each}",
        f"plane      {made.calibration.plane}",
        f"middle     {made.mm_per_px:.2f} mm per pixel",
        map(_ruler_text, made.rulers),
        [f"note       {note}" for note in made.notes],
        f"written    {out}",
    )


def _camera_text(made: Calibrated) -> str:
    width, height = made.calibration.size_px
    found = made.intrinsics
    if found is None:
        return f"{width}x{height}, taken to be free of distortion"
    return (
        f"{width}x{height}; {len(found.used)} pictures of the board, {found.rms_px:.2f} px RMS, "
        f"corners in {found.covered * 100:.0f} % of the picture\nfocal length "
        f"{made.calibration.camera_matrix[0, 0]:.0f} px, sigma {found.focal_sigma * 100:.1f} %"
    )
