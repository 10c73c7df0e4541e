"""camera print, calibrate."""

from __future__ import annotations

from dataclasses import asdict, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np
import typer

from tailbeat.app.cli._lazy import arg, opt
from tailbeat.app.cli._terminal import Output, numbers, pick, progress_bar
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
from tailbeat.sensors.camera.marker import sheets
from tailbeat.sensors.camera.marker.sheets import Sheet, write_sheet
from tailbeat.sensors.camera.marker.tags import TagKind
from tailbeat.sensors.camera.source.open import read_all, read_grey

Paper = Literal["a4", "a3", "letter"]
SheetKind = Literal["board", "marker", "anchors", "ruler"]
_FISH_ID = 7
_NO_BOARD: dict[str, Any] = {"used": (), "dropped": {}, "unseen": (), "covered": None}
_OPTIONS: dict[SheetKind, tuple[str, ...]] = {
    "board": (),
    "marker": ("--kind", "--id", "--side"),
    "anchors": ("--id", "--side"),
    "ruler": ("--side",),
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
    given = {"--kind": kind, "--id": number, "--side": side}
    for option, value in given.items():
        if value is not None and option not in _OPTIONS[what]:
            raise typer.BadParameter(f"{option} does not apply to the sheet '{what}'")

    sheet = _sheet(what, kind, number, side, paper)
    path = out or Path(f"{what}.pdf")
    write_sheet(sheet, path)
    document = {"file": path, "sheet": sheet.name, "paper": sheet.paper, "text": sheet.text}
    return Output(document, f"{path}: {sheet.text}")


def _sheet(
    what: SheetKind, kind: TagKind | None, number: int | None, side: float | None, paper: Paper
) -> Sheet:
    if what == "board":
        return sheets.board_sheet(paper)
    if what == "marker":
        number = _FISH_ID if number is None else number
        return sheets.fish_sheet(kind or "aruco", number, side or sheets.FISH_SIDE_MM, paper)
    if what == "anchors":
        return sheets.anchors_sheet(side or sheets.TANK_SIDE_MM, paper, number)
    return sheets.ruler_sheet(side or sheets.TANK_SIDE_MM, paper)


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
    """Calibrate a camera over a tank: pixels become metres. See docs/camera-calibration.md.

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
    made = _made(points, picture, board or [], Height(raise_m, depth_m), area, rulers)
    now = datetime.now().astimezone().isoformat(timespec="seconds")
    calibration = replace(made.calibration, camera=camera, made_at=now)
    calibration.save(out)
    return Output(_document(made, calibration, out), lambda: _text(made, out))


def _made(
    points: Path,
    picture: Path,
    board: list[Path],
    height: Height,
    area: str | None,
    rulers: list[Ruler],
) -> Calibrated:
    places = read_points(points)
    area_m = rectangle(numbers(area, "--area", float)) if area is not None else None
    with progress_bar("looking") as show:
        done = [0]

        def look(name: str) -> None:
            done[0] += 1
            show(done[0] / (done[0] + 5), name)  # how many pictures a film gives is not known

        return make(
            places, (str(picture), read_grey(picture)), read_all(board), height,
            area_m, rulers, look,
        )  # fmt: skip


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
    size = read_grey(pictures[0]).shape[1::-1] if pictures else None
    name = str(pictures[0]) if pictures else "the ruler"
    size_px = (int(size[0]), int(size[1])) if size is not None else None
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
    plane, count = made.plane, len(made.plane.off_m)
    predicted = plane.predicted_m
    each = f"; each is predicted by the others within {predicted * 1e3:.1f} mm" if predicted else ""
    lines = [
        f"camera     {_camera_text(made)}",
        f"points     {count}, {plane.rms_m * 1e3:.1f} mm off (RMS){each}",
        f"plane      {made.calibration.plane}",
        f"middle     {made.mm_per_px:.2f} mm per pixel",
        *map(_ruler_text, made.rulers),
        *(f"note       {note}" for note in made.notes),
        f"written    {out}",
    ]
    return "\n".join(lines)


def _camera_text(made: Calibrated) -> str:
    width, height = made.calibration.size_px
    found = made.intrinsics
    if found is None:
        return f"{width}x{height}, taken to be free of distortion"
    return (
        f"{width}x{height}; {len(found.used)} pictures of the board, {found.rms_px:.2f} px RMS, "
        f"corners in {found.covered * 100:.0f} % of the picture; focal length "
        f"{made.calibration.camera_matrix[0, 0]:.0f} px, sigma {found.focal_sigma * 100:.1f} %"
    )
