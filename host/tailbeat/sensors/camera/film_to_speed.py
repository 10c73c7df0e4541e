"""From pictures to speeds: the whole way, and the files that come of it."""

from __future__ import annotations

import csv
import io
import json
import math
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError, reason
from tailbeat.core.files import replace_file
from tailbeat.core.frames import Frame
from tailbeat.core.trial_checks import HeadingDrift, heading_drift_of_frames
from tailbeat.core.trial_file import Trial
from tailbeat.sensors.camera.calibration.file import Calibration
from tailbeat.sensors.camera.marker.detector import Marker
from tailbeat.sensors.camera.source.picture import PictureSource
from tailbeat.sensors.camera.speed.smoother import SpeedCurve, swim_speed, write_speeds
from tailbeat.sensors.camera.sync.sync import Sync, sync, sync_by_led
from tailbeat.sensors.camera.tracking.track import (
    BRIDGED,
    LOST,
    SEEN,
    Progress,
    Track,
    track,
    write_track,
)

SUMMARY = "summary.json"
_FILES = {"track.csv", "speed.csv", "beats.csv", "track.png", "overlay.mp4", SUMMARY}
_FORMAT = "tailbeat camera track"


@dataclass(frozen=True)
class FilmAnalysis:
    """What came of a film. ``sync`` None = not known when the swim began. ``trial`` None = not
    paired with one; then ``sync.trial`` is the number the LED shows."""

    track: Track
    curve: SpeedCurve
    sync: Sync | None
    trial: Trial | None
    calibration: Calibration

    def beats(self) -> tuple[F64, F64]:
        """Mean speed and sigma of each beat swum, shape (beats,); NaN = not measured. Of a film
        without a trial: empty."""
        return self.curve.beats(self.trial.executed_beats if self.trial is not None else 0)

    def straight(self) -> HeadingDrift | None:
        """Whether it swam straight, from the begin of the swim (of the film, if that is not known)
        to its end; speeds are those along ``curve.direction_rad``."""
        beat_s, begin_s = self.curve.beat_s, self.curve.start_s
        if self.trial is not None:
            beats = self.trial.executed_beats
        else:
            beats = int((float(self.track.t_s[-1]) - begin_s) / beat_s)
        seen = self.track.seen()
        rows = zip(
            self.track.t_s[seen], self.track.x_m[seen], self.track.y_m[seen],
            self.track.heading_rad[seen], strict=True,
        )  # fmt: skip
        frames = [Frame(*map(float, row)) for row in rows]
        return heading_drift_of_frames(frames, begin_s, beats, beat_s)

    def summary(self) -> dict[str, Any]:
        """What summary.json holds: plain values, units in the names, None = not known."""
        state = self.track.state
        speed, sigma = self.beats()
        paired = self.trial is not None
        mean_of, sigma_of = (speed, sigma) if paired else (self.curve.v_m_s, self.curve.sigma_m_s)
        return {
            "made_by": _FORMAT,
            "film": self.track.name,
            "pictures": len(state),
            "seen": int(np.count_nonzero(state == SEEN)),
            "bridged": int(np.count_nonzero(state == BRIDGED)),
            "lost": int(np.count_nonzero(state == LOST)),
            "fps": round(self.track.fps, 3),
            "trial": self.trial.number if self.trial is not None else None,
            "sync": _sync_summary(self.sync),
            "beats": len(speed) if paired else None,
            "measured_beats": int(np.count_nonzero(np.isfinite(speed))) if paired else None,
            "mean_speed_m_s": _of_measured(np.mean, mean_of),
            "sigma_median_m_s": _of_measured(np.median, sigma_of),
            "direction_rad": _number(self.curve.direction_rad),
            "straight": _straight_summary(self.straight()),
            "position_noise_m": _number(self.curve.noise_m),
            "outliers": self.curve.outliers,
            "scale_error": _number(self.calibration.scale_error),
            "marker_side_m": _number(self.track.marker_side_m),
        }


def analyse(
    source: PictureSource,
    marker: Marker,
    calibration: Calibration,
    trial: Trial | None = None,
    start_s: float | None = None,
    beat_s: float = 1.0,
    progress: Progress | None = None,
    on_place: Callable[..., None] | None = None,
) -> FilmAnalysis:
    """All of ``source``: track, begin of the swim (``start_s`` if given, else by LED or wobble when
    there is a trial) and speed; with a trial its sigma holds that of the begin. ``beat_s`` counts
    without a trial only.

    Raises InputError: what track, sync (WrongPair) and swim_speed raise.
    """
    seen = track(source, marker, calibration, start_s is None, progress, on_place)
    found = begin_of(seen, trial, start_s)
    if trial is None:
        curve = swim_speed(seen, beat_s, start_s)
    else:
        assert found is not None
        curve = swim_speed(seen, trial.beat_s, found.start_s, beats=trial.executed_beats)
        curve = curve.with_begin_sigma(found.sigma_s)
    return FilmAnalysis(seen, curve, found, trial, calibration)


def begin_of(seen: Track, trial: Trial | None, start_s: float | None = None) -> Sync | None:
    """When the swim began; None = no trial to compare with and no LED. A given ``start_s`` is taken
    to be some picture's, right within half a period either way: its sigma is that over sqrt(3).
    Raises what sync raises, and InputError for a ``start_s`` outside the film."""
    if start_s is not None:
        if not seen.t_s[0] <= start_s <= seen.t_s[-1]:
            raise InputError(
                f"the film goes from {seen.t_s[0]:.1f} to {seen.t_s[-1]:.1f} s, "
                f"and the swim should begin at {start_s:g} s",
                "Count --start in seconds from the first picture.",
            )
        return Sync(start_s, 0.5 / seen.fps / math.sqrt(3), "given", None, 1.0)
    if trial is not None:
        if trial.executed_beats == 0:
            raise InputError(f"trial {trial.number} did not swim", "Give the film's own trial.")
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
        replace_file(folder / "beats.csv", _beats_csv(*found.beats()))
    text = json.dumps(found.summary(), indent=2, allow_nan=False) + "\n"
    replace_file(folder / SUMMARY, text)


def _beats_csv(speed: F64, sigma: F64) -> str:
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(("beat", "speed_m_s", "sigma_m_s"))
    for beat, (v, s) in enumerate(zip(speed, sigma, strict=True)):
        rows.writerow((beat, *(f"{value:.6f}" if math.isfinite(value) else "" for value in (v, s))))
    return out.getvalue()


def _straight_summary(found: HeadingDrift | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "mean_yaw_rad": _number(found.mean_yaw_rad),
        "worst_yaw_rad": _number(found.worst_yaw_rad),
        "curvature_1_m": _number(found.curvature_1_m),
        "crooked": found.crooked,
    }


def _sync_summary(found: Sync | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "how": found.how,
        "start_s": _number(found.start_s),
        "sigma_s": _number(found.sigma_s),
        "led_trial": found.trial,
        "score": _number(found.score),
    }


def _of_measured(what: Callable[[F64], Any], values: F64) -> float | None:
    measured = values[np.isfinite(values)]
    return float(what(measured)) if measured.size else None


def _number(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None
