"""camera render."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tailbeat.app.cli._terminal import Json, progress_bar, say

if TYPE_CHECKING:
    from tailbeat.app.exercise import Exercise
    from tailbeat.sensors.camera.render.scene import Scene

_SIZE_MIN_PX, _SIZE_MAX_PX = 64, 8192


def render(
    film: Annotated[Path, typer.Argument(metavar="FILM", help="To write: .mp4 or .mkv.")],
    reference: Annotated[
        str,
        typer.Option(
            "--reference", help="What to swim: thesis, trapezoid:V,RAMP_S,HOLD_S, … or a CSV."
        ),
    ] = "thesis",
    plant: Annotated[
        str, typer.Option("--plant", metavar="tank|thesis", help="Model of the fish.")
    ] = "tank",
    seed: Annotated[int, typer.Option("--seed", min=0, help="Same seed, same film.")] = 1,
    fps: Annotated[float, typer.Option("--fps", min=1, max=240, help="Pictures per second.")] = 25,
    size: Annotated[
        str, typer.Option("--size", metavar="WxH", help="Of the picture, pixels.")
    ] = "1280x720",
    marker: Annotated[
        str, typer.Option("--marker", metavar="aruco|apriltag|blob", help="What the fish carries.")
    ] = "aruco",
    lost: Annotated[
        float, typer.Option("--lost", min=0, max=0.9, help="Part of the pictures never taken.")
    ] = 0.0,
    hidden: Annotated[
        float, typer.Option("--hidden", min=0, max=1, help="Part with half of the marker covered.")
    ] = 0.0,
    glare: Annotated[
        float, typer.Option("--glare", min=0, max=1, help="Size of a bright spot that wanders.")
    ] = 0.0,
    noise_mm: Annotated[
        float, typer.Option("--noise-mm", min=0, help="How far a drawn fish is off its place.")
    ] = 0.0,
    fish: Annotated[int, typer.Option("--fish", min=1, max=2, help="How many swim.")] = 1,
    offset: Annotated[
        float,
        typer.Option("--offset", min=0.1, max=60, help="Film before the swim begins, s."),
    ] = 2.0,
    json: Json = False,
) -> None:
    """Film a simulated trial: the film, its truth, its calibration and the trial's log.

    Example: tailbeat camera render swim.mp4 --lost 0.1 --glare 0.5
    """
    from tailbeat.app.exercise import ExerciseOptions, make_exercise
    from tailbeat.experiment.current import named_reference

    scene = _scene(size, marker, glare, hidden, fish, seed)
    options = ExerciseOptions(
        reference=named_reference(reference),
        scene=scene,
        plant=plant,
        seed=seed,
        before_s=offset,
        overrides={"camera_fps": fps, "camera_lost": lost, "camera_noise_m": noise_mm * 1e-3},
    )
    with progress_bar(json, "render") as show:
        exercise = make_exercise(film, options, show)
    say(json, exercise, lambda: _text(exercise))


def _scene(size: str, marker: str, glare: float, hidden: float, fish: int, seed: int) -> Scene:
    from tailbeat.core.errors import InputError
    from tailbeat.sensors.camera.marker.detector import KINDS
    from tailbeat.sensors.camera.render.scene import Scene

    kind = next((kind for kind in KINDS if kind == marker), None)
    if kind is None:
        raise InputError(f"there is no marker '{marker}'.", f"Use {', '.join(KINDS)}.")
    return Scene(size_px=_size(size), marker=kind, glare=glare, hidden=hidden, fish=fish, seed=seed)


def _size(text: str) -> tuple[int, int]:
    from tailbeat.core.errors import InputError

    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise InputError(f"'{text}' is no size of a picture.", "Write it like --size 1280x720.")
    size = int(width), int(height)
    if min(size) < _SIZE_MIN_PX or max(size) > _SIZE_MAX_PX:
        limits = f"from {_SIZE_MIN_PX}x{_SIZE_MIN_PX} to {_SIZE_MAX_PX}x{_SIZE_MAX_PX}"
        raise InputError(f"no film is drawn of {text} pixels.", f"Give a --size {limits}.")
    return size


def _text(exercise: Exercise) -> str:
    lost = f", {exercise.lost} lost" if exercise.lost else ""
    return "\n".join(
        [
            f"{exercise.film}: {exercise.pictures} pictures at {exercise.fps:g} per second{lost}; "
            f"trial {exercise.trial} begins at {exercise.swim_begin_s:.3f} s",
            f"{exercise.truth}: where the fish was drawn, and its speed",
            f"{exercise.calibration}: the camera's calibration",
            f"{exercise.trial_file}: the trial's log",
        ]
    )
