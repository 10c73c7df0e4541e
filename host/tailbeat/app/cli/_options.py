"""What all commands that look through a camera ask for.

What the shell offers after TAB.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from tailbeat.sensors.camera.marker.detector import Marker

MarkerKindOption = Annotated[
    str, typer.Option("--marker", metavar="aruco|apriltag|blob", help="What is on the fish.")
]
MarkerIdOption = Annotated[
    int | None,
    typer.Option("--marker-id", min=0, help="Number of the fish's marker; default: any one."),
]
MarkerSideOption = Annotated[
    float | None,
    typer.Option("--marker-side", metavar="M", help="Side of its black square, to check it."),
]
CalibrationOption = Annotated[
    Path | None,
    typer.Option("--calibration", metavar="TANK.json", help="What 'camera calibrate' wrote."),
]
LatencyOption = Annotated[
    float,
    typer.Option("--latency", metavar="S", help="How late a picture of the device arrives."),
]

CameraOption = Annotated[
    str | None,
    typer.Option(
        "--camera",
        metavar="DEVICE|tcp:HOST:PORT|rendered",
        help="A camera (0, /dev/video0), a stream of positions, or the simulated fish drawn.",
    ),
]
WallOption = Annotated[
    float | None,
    typer.Option(
        "--wall",
        min=0.0,
        max=2.0,
        metavar="M",
        help="Stop a fish of 0.08 m/s so far from a wall, slower ones later; 0 = never;"
        " default: where it can just still stop, by its drag.",
    ),
]


def marker_of(kind: str, number: int | None = None, side_m: float | None = None) -> Marker:
    """What the options say. Raises typer.BadParameter."""
    from tailbeat.sensors.camera.marker.detector import KINDS, Marker

    known = next((k for k in KINDS if k == kind), None)
    if known is None:
        raise typer.BadParameter(f"--marker is {', '.join(KINDS[:-1])} or {KINDS[-1]}")
    if side_m is not None and not 0.001 <= side_m <= 1.0:
        raise typer.BadParameter("--marker-side is in metres, like 0.06")
    if kind == "blob" and (number is not None or side_m is not None):
        raise typer.BadParameter("a blob has neither --marker-id nor --marker-side")
    return Marker(known, number, side_m)


_KINDS = ("thesis", "thesis:", "trapezoid:", "cosine:")


def reference_names(incomplete: str) -> list[str]:
    """References that begin so: their names, CSV files, and folders that may hold some."""
    folder = Path(incomplete if incomplete.endswith("/") else Path(incomplete).parent)
    try:
        files = sorted(folder.iterdir())
    except OSError:
        files = []
    found = [str(path) for path in files if path.suffix.lower() == ".csv"]
    found += [f"{path}/" for path in files if path.is_dir() and not path.name.startswith(".")]
    return [name for name in (*_KINDS, *found) if name.startswith(incomplete)]
