"""From pictures to speeds, and the files that are written: tables, a summary, the overlay film."""

from __future__ import annotations

import json
import math
import shutil
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.csv import table_text
from tailbeat.core.errors import InputError, reason
from tailbeat.core.files import plain, replace_file
from tailbeat.core.speed_source import Frame
from tailbeat.core.trial_checks import HeadingDrift, heading_drift_of_frames
from tailbeat.core.trial_file import Trial
from tailbeat.sensors.camera import cv2, require_cv2
from tailbeat.sensors.camera.calibration.file import Calibration
from tailbeat.sensors.camera.marker.detector import Marker
from tailbeat.sensors.camera.marker.tags import Detection
from tailbeat.sensors.camera.source.film import FilmWriter
from tailbeat.sensors.camera.source.picture import Image, PictureSource, TimedImage
from tailbeat.sensors.camera.speed import (
    SpeedCurve,
    check_times,
    swim_direction_rad,
    swim_speed,
    write_speeds,
)
from tailbeat.sensors.camera.sync import Sync, sync, sync_by_led
from tailbeat.sensors.camera.tracking.positions import Positions
from tailbeat.sensors.camera.tracking.track import (
    BRIDGED,
    LOST,
    SEEN,
    Progress,
    Track,
    track,
    write_track,
)
from tailbeat.sensors.camera.tracking.tracker import TrackedImage

SUMMARY = "summary.json"
_FILES = {"track.csv", "speed.csv", "beats.csv", "track.png", "overlay.mp4", SUMMARY}
_FORMAT = "tailbeat camera track"


@dataclass(frozen=True)
class FilmAnalysis:
    """What came of a film. ``sync`` None = not known when the trial began. ``trial`` None = not
    paired with one; then ``sync.trial`` is the number the LED shows."""

    track: Track
    curve: SpeedCurve
    sync: Sync | None
    trial: Trial | None
    calibration: Calibration

    def beats(self) -> tuple[F64, F64]:
        """Mean speed and sigma of each executed beat, shape (beats,); NaN = not measured. Of a film
        without a trial: empty."""
        return self.curve.beats(self.trial.executed_beats if self.trial is not None else 0)

    def straight(self) -> HeadingDrift | None:
        """Whether it swam straight, from the begin of the trial (of the film, if that is not known)
        to its end; speeds are those along ``curve.direction_rad``."""
        beat_s, begin_s = self.curve.beat_s, self.curve.start_s
        if self.trial is not None:
            beats = self.trial.executed_beats
        else:
            beats = int((float(self.track.t_s[-1]) - begin_s) / beat_s)
        seen = self.track.seen() & np.isfinite(self.track.heading_rad)
        if not seen.any():
            return None
        rows = zip(
            self.track.t_s[seen], self.track.x_m[seen], self.track.y_m[seen],
            self.track.heading_rad[seen], strict=True,
        )  # fmt: skip
        frames = [Frame(*map(float, row)) for row in rows]
        return heading_drift_of_frames(frames, begin_s, beats, beat_s)

    def summary(self) -> dict[str, Any]:
        """What summary.json holds: plain values, units in the names, None = not known."""
        state, straight, sync = self.track.state, self.straight(), self.sync
        speed, sigma = self.beats()
        paired = self.trial is not None
        mean_of, sigma_of = (speed, sigma) if paired else (self.curve.v_m_s, self.curve.sigma_m_s)
        document = {
            "made_by": _FORMAT,
            "film": self.track.name,
            "pictures": len(state),
            "seen": np.count_nonzero(state == SEEN),
            "bridged": np.count_nonzero(state == BRIDGED),
            "lost": np.count_nonzero(state == LOST),
            "fps": round(self.track.fps, 3),
            "trial": self.trial.number if self.trial is not None else None,
            "sync": sync
            and {
                "how": sync.how,
                "start_s": sync.start_s,
                "sigma_s": sync.sigma_s,
                "led_trial": sync.trial,
                "score": sync.score,
            },
            "beats": len(speed) if paired else None,
            "measured_beats": np.count_nonzero(np.isfinite(speed)) if paired else None,
            "mean_speed_m_s": _of_measured(np.mean, mean_of),
            "sigma_median_m_s": _of_measured(np.median, sigma_of),
            "direction_rad": self.curve.direction_rad,
            "straight": straight
            and {
                "mean_yaw_rad": straight.mean_yaw_rad,
                "worst_yaw_rad": straight.worst_yaw_rad,
                "curvature_1_m": straight.curvature_1_m,
                "crooked": straight.crooked,
            },
            "position_noise_m": self.curve.noise_m,
            "outliers": self.curve.outliers,
            "scale_error": self.calibration.scale_error,
            "marker_side_m": self.track.marker_side_m,
        }
        return {key: plain(value) for key, value in document.items()}


def analyse(
    source: PictureSource,
    marker: Marker,
    calibration: Calibration,
    trial: Trial | None = None,
    start_s: float | None = None,
    beat_s: float = 1.0,
    progress: Progress | None = None,
    on_place: Callable[..., None] | None = None,
    positions: Positions | None = None,
) -> FilmAnalysis:
    """All of ``source``: track, begin of the trial (``start_s`` if given, else by LED or yaw when
    there is a trial) and speed, whose sigma holds the calibration's and, with a trial, that of the
    begin. ``beat_s`` counts without a trial only. ``positions``: as track().

    Raises InputError: what track, sync (WrongPair) and swim_speed raise.
    """
    seen = track(source, marker, calibration, start_s is None, progress, on_place, positions)
    try:
        found = begin_of(seen, trial, start_s)
    except InputError:
        check_times(seen, swim_direction_rad(seen))  # with wrong times no LED can be read, either
        raise
    if trial is None:
        curve = swim_speed(seen, beat_s, start_s)
    else:
        assert found is not None
        curve = swim_speed(seen, trial.beat_s, found.start_s, beats=trial.executed_beats)
        curve = curve.with_begin_sigma(found.sigma_s)
    curve = curve.with_scale_sigma(calibration.scale_sigma)
    return FilmAnalysis(seen, curve, found, trial, calibration)


def begin_of(seen: Track, trial: Trial | None, start_s: float | None = None) -> Sync | None:
    """When the trial began; None = no trial to compare with and no LED. A given ``start_s`` is
    taken to be some picture's, right within half a period either way: its sigma is that over
    sqrt(3). Raises what sync raises, and InputError for a ``start_s`` outside the film."""
    if start_s is not None:
        if not seen.t_s[0] <= start_s <= seen.t_s[-1]:
            raise InputError(
                f"the film goes from {seen.t_s[0]:.1f} to {seen.t_s[-1]:.1f} s, "
                f"and the trial should begin at {start_s:g} s",
                "Count --start in seconds from the first picture.",
            )
        return Sync(start_s, 0.5 / seen.fps / math.sqrt(3), "given", None, 1.0)
    if trial is not None:
        if not np.isfinite(seen.heading_rad).any():
            raise InputError(
                f"the positions in {seen.name} have no heading, and the trial's begin is not known",
                "Name a point ahead of the fish's middle, --head NAME, or give the begin: --start.",
            )
        if trial.executed_beats == 0:
            raise InputError(
                f"trial {trial.number} has no executed beat", "Give the film's own trial."
            )
        return sync(seen, trial)
    try:
        return sync_by_led(seen)
    except InputError:
        return None


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """A temporary folder that becomes ``folder`` at the end, or nothing on any error. One that an
    earlier analysis made is replaced. Raises InputError when something else is there."""
    if folder.exists() and not _is_ours(folder):
        raise InputError(f"{folder} is there and is no film's analysis.", "Choose another --out.")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        part = Path(mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    except OSError as error:
        raise InputError(
            f"cannot write to {folder.parent} ({reason(error)}).", "Choose another --out."
        ) from error
    try:
        yield part
        part.chmod(0o755)
        if folder.exists():
            shutil.rmtree(folder)
        part.rename(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _is_ours(folder: Path) -> bool:
    """Empty, or an analysis to which nobody has added anything."""
    names = {path.name for path in folder.iterdir()} if folder.is_dir() else None
    if not names:
        return names is not None
    if not names <= _FILES:
        return False
    try:
        return bool(json.loads((folder / SUMMARY).read_bytes())["made_by"] == _FORMAT)
    except (OSError, ValueError, KeyError, TypeError):
        return False


def write_analysis(found: FilmAnalysis, folder: Path) -> None:
    """track.csv, speed.csv, summary.json and, with a trial, beats.csv into ``folder``."""
    write_track(found.track, folder / "track.csv")
    write_speeds(found.curve, folder / "speed.csv", found.trial.number if found.trial else None)
    if found.trial is not None:
        rows = (
            (beat, *(f"{v:.6f}" if math.isfinite(v) else None for v in values))
            for beat, values in enumerate(zip(*found.beats(), strict=True))
        )
        columns = ("beat", "speed_m_s", "sigma_m_s")
        replace_file(folder / "beats.csv", table_text(columns, rows))
    text = json.dumps(found.summary(), indent=2, allow_nan=False) + "\n"
    replace_file(folder / SUMMARY, text)


def _of_measured(what: Callable[[F64], Any], values: F64) -> float | None:
    measured = values[np.isfinite(values)]
    return float(what(measured)) if measured.size else None


_TRAIL_S = 2.0
_DARK, _LIGHT = (30, 30, 30), (255, 255, 255)
_OUTLINE, _TRAIL, _ARROW, _UNSEEN = (0, 220, 0), (0, 200, 255), (60, 60, 255), (60, 60, 255)
_AROUND = ((-1, 0), (1, 0), (0, -1), (0, 1))
_SHIFT = 4  # OpenCV draws at sixteenths of a pixel
_LINE_PX = 720  # height of a picture whose lines are two pixels wide


class Overlay(FilmWriter):
    """Writes ``path``: each picture with the marker's outline, an arrow along the heading, the way
    of the last 2 s, time and state. Call it with what track() gives to ``on_place``."""

    def __init__(self, path: Path, size_px: tuple[int, int], fps: float) -> None:
        require_cv2()
        super().__init__(path, size_px, fps)
        self._trail: deque[tuple[float, tuple[float, float]]] = deque()

    def __call__(self, picture: TimedImage, place: TrackedImage) -> None:
        """The next picture."""
        image: Image = cv2.cvtColor(picture.image, cv2.COLOR_GRAY2BGR)
        self._draw_trail(image, place)
        if place.detection is not None:
            self._draw_detection(image, place.detection)
        self._draw_text(image, place)
        self.add(image, picture.t_s)

    def _draw_trail(self, image: Image, place: TrackedImage) -> None:
        while self._trail and self._trail[0][0] < place.t_s - _TRAIL_S:
            self._trail.popleft()
        if place.detection is not None:
            self._trail.append((place.t_s, place.detection.centre_px))
        self._line(image, [point for _, point in self._trail], _TRAIL, closed=False)

    def _draw_detection(self, image: Image, detection: Detection) -> None:
        centre, front = np.array(detection.centre_px), np.array(detection.front_px)
        if detection.corners_px is not None:
            outline = detection.corners_px
        else:
            outline = _blob_box(centre, front, detection.side_px)
        self._line(image, outline, _OUTLINE, closed=True)
        ahead = front - centre
        length = max(3 * detection.side_px, 24.0)
        tip = centre + ahead * (length / max(float(np.linalg.norm(ahead)), 1e-6))
        cv2.arrowedLine(
            image, _fixed(centre), _fixed(tip), _ARROW, _width(image),
            cv2.LINE_AA, _SHIFT, 0.2,
        )  # fmt: skip

    def _draw_text(self, image: Image, place: TrackedImage) -> None:
        state = ("not seen", _UNSEEN)
        if place.detection is not None:
            state = (f"seen, quality {place.detection.quality:.2f}", _LIGHT)
        lines = [(f"{place.t_s:.3f} s", _LIGHT), state]
        scale = image.shape[0] / _LINE_PX
        for row, (text, colour) in enumerate(lines):
            left, base = round(16 * scale), round((34 + 32 * row) * scale)
            # Thicker letters are wider in OpenCV 5: a shadow all around is the same text, shifted.
            for dx, dy, ink in (*((*step, _DARK) for step in _AROUND), (0, 0, colour)):
                cv2.putText(
                    image, text, (left + dx, base + dy), cv2.FONT_HERSHEY_SIMPLEX, 0.9 * scale,
                    ink, 1, cv2.LINE_AA,
                )  # fmt: skip

    def _line(self, image: Image, points: Any, colour: tuple[int, int, int], closed: bool) -> None:
        if len(points) < 2:
            return
        fixed = np.rint(np.asarray(points, np.float64) * 2**_SHIFT).astype(np.int32)
        for ink, more in ((_DARK, 2), (colour, 0)):
            cv2.polylines(
                image, [fixed.reshape(-1, 1, 2)], closed, ink, _width(image) + more,
                cv2.LINE_AA, _SHIFT,
            )  # fmt: skip


def _blob_box(centre: F64, front: F64, side_px: float) -> F64:
    """Corners of a blob: as long as twice the way to its front end, as wide as its side."""
    ahead = front - centre
    aside = np.array([-ahead[1], ahead[0]]) / max(float(np.linalg.norm(ahead)), 1e-6) * side_px / 2
    return np.array([front - aside, front + aside, 2 * centre - front + aside,
                     2 * centre - front - aside])  # fmt: skip


def _fixed(point: F64) -> tuple[int, int]:
    return round(float(point[0]) * 2**_SHIFT), round(float(point[1]) * 2**_SHIFT)


def _width(image: Image) -> int:
    return max(1, round(2 * float(image.shape[0]) / _LINE_PX))
