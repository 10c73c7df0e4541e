"""Films in an experiment's folder as pictures for an MCAP file."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tailbeat.experiment.analysis import Analysis
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.wall_clock import TrialStart
from tailbeat.sensors.camera import av, cv2
from tailbeat.sensors.camera.film_to_speed import SUMMARY
from tailbeat.sensors.camera.source.film import DamagedError, open_film, whole_frames

VIDEO, IMAGE = "foxglove.CompressedVideo", "foxglove.CompressedImage"
SYNCHRONISED = "synchronised with the trial by 'tailbeat camera track'"
BY_NAME = "assumed to begin with the trial that its name ends with"
BY_FIRST = "assumed to begin with the first trial"
_FILMS = (".mp4", ".mkv", ".mov", ".avi")
_FOLDERS = (".", "films")
_SHOWN = ("yuv420p", "yuvj420p")
_TIME = {
    "type": "object",
    "title": "time",
    "properties": {
        "sec": {"type": "integer", "minimum": 0},
        "nsec": {"type": "integer", "minimum": 0, "maximum": 999999999},
    },
}
_STAMPED = {
    "timestamp": _TIME,
    "frame_id": {"type": "string"},
    "data": {"type": "string", "contentEncoding": "base64"},
    "format": {"type": "string"},
}
_LOG = {
    "timestamp": _TIME,
    "level": {"type": "integer"},
    "message": {"type": "string"},
    "name": {"type": "string"},
    "file": {"type": "string"},
    "line": {"type": "integer", "minimum": 0},
}
SCHEMAS: dict[str, dict[str, Any]] = {
    name: {"title": name, "type": "object", "properties": properties}
    for name, properties in ((VIDEO, _STAMPED), (IMAGE, _STAMPED), ("foxglove.Log", _LOG))
}
"""Those that Foxglove knows by name (https://docs.foxglove.dev/docs/sdk/schemas)."""


@dataclass(frozen=True)
class ExperimentFilm:
    """A film and when it begins.

    Attributes
    ----------
    path : Path
        The file.
    topic, schema : str
        Topic and schema of its pictures: ``VIDEO`` for H.264 without B-frames, which is copied,
        else ``IMAGE`` (JPEG).
    begin_ns : int
        Time of its first picture, nanoseconds since 1970, UTC.
    trial : int or None
        The trial it shows; None: not known.
    source : str
        How ``begin_ns`` was found: ``SYNCHRONISED``, ``BY_NAME`` or ``BY_FIRST``.
    """

    path: Path
    topic: str
    schema: str
    begin_ns: int
    trial: int | None
    source: str


def films_of(
    experiment: Experiment, analysis: Analysis, starts: list[TrialStart]
) -> list[ExperimentFilm]:
    """Find the films in an experiment's folder and in its folder ``films``.

    Parameters
    ----------
    experiment, analysis : Experiment, Analysis
        The experiment.
    starts : list of TrialStart
        When its trials began.

    Returns
    -------
    list of ExperimentFilm
        By name.

    Raises
    ------
    InputError
        A film cannot be read, or PyAV is not installed.
    """
    places = (experiment.folder / name for name in _FOLDERS)
    paths = [path for place in places if place.is_dir() for path in sorted(place.iterdir())]
    begins = {row.trial: one.utc_ns for row, one in zip(analysis.rows, starts, strict=True)}
    found = []
    for path in paths:
        if path.is_file() and path.suffix.lower() in _FILMS:
            begin_ns, trial, source = _begin(path, begins)
            topic = "/film/" + re.sub(r"[^A-Za-z0-9_]+", "_", path.stem)
            found.append(ExperimentFilm(path, topic, _schema(path), begin_ns, trial, source))
    return found


def _begin(path: Path, begins: dict[int, int]) -> tuple[int, int | None, str]:
    """(time of the first picture, trial, how that was found)."""
    trial, since_s = _synchronised(path)
    if trial in begins and since_s is not None:
        return begins[trial] - round(since_s * 1e9), trial, SYNCHRONISED
    number = re.search(r"(\d+)$", path.stem)
    if number and int(number[1]) in begins:
        return begins[int(number[1])], int(number[1]), BY_NAME
    return next(iter(begins.values())), None, BY_FIRST


def _synchronised(path: Path) -> tuple[int | None, float | None]:
    """The trial of a film and its begin in the film, s, as 'camera track' found them."""
    try:
        summary = json.loads((path.with_suffix("") / SUMMARY).read_bytes())
        return int(summary["trial"]), float(summary["sync"]["start_s"])
    except (OSError, ValueError, KeyError, TypeError):
        return None, None


def _schema(path: Path) -> str:
    """H.264 is copied if Foxglove shows it: usual colours, pictures stored in their order."""
    container, stream = open_film(path)
    with closing(container):
        context = stream.codec_context
        shown = context.name == "h264" and context.pix_fmt in _SHOWN and not context.has_b_frames
        return VIDEO if shown else IMAGE


def pictures(film: ExperimentFilm) -> Iterator[tuple[int, dict[str, str]]]:
    """Read a film's pictures.

    Parameters
    ----------
    film : ExperimentFilm
        The film; of a damaged one what comes before the damage.

    Yields
    ------
    tuple of (int, dict)
        Nanoseconds since the first picture, and ``data`` (Base64) and ``format``.
    """
    container, stream = open_film(film.path)
    with closing(container):
        first = None
        read = _packets if film.schema == VIDEO else _jpegs
        for pts, content, kind in read(container, stream):
            first = pts if first is None else first
            t_ns = round((pts - first) * stream.time_base * 1_000_000_000)
            yield t_ns, {"format": kind, "data": base64.b64encode(content).decode("ascii")}


def _packets(container: Any, stream: Any) -> Iterator[tuple[int, bytes, str]]:
    """H.264 as in the file, in the Annex B form: each key frame has the decoder's settings."""
    annex_b = av.BitStreamFilterContext("h264_mp4toannexb", stream)
    for packet in container.demux(stream):
        if packet.dts is None or packet.is_corrupt:
            return
        for part in annex_b.filter(packet):
            yield packet.dts if part.pts is None else part.pts, bytes(part), "h264"


def _jpegs(container: Any, stream: Any) -> Iterator[tuple[int, bytes, str]]:
    """Every picture, decoded and compressed by itself."""
    frames = whole_frames(container, stream)
    while True:
        try:
            frame = next(frames)
        except (StopIteration, DamagedError):
            return
        _, content = cv2.imencode(".jpg", frame.to_ndarray(format="bgr24"))
        yield frame.pts, content.tobytes(), "jpeg"
