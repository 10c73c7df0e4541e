"""board imu calibrate."""

from __future__ import annotations

import contextlib
import csv
import math
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.app.cli._fish import ConnectedFish
from tailbeat.app.cli._lazy import opt
from tailbeat.app.cli._terminal import Display, Output
from tailbeat.board.fish import Fish
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError, TailbeatError, reason
from tailbeat.link.messages import ImuFrame
from tailbeat.sensors.vn100 import calibration as turns
from tailbeat.sensors.vn100.calibration import ImuCalibration, Recording
from tailbeat.sim.hand import Hand

SCALE_PARAMETER, MOUNT_PARAMETER = "IMU_SCALE_SD", "IMU_MOUNT"
_UNKNOWN_SCALE_SD = 1e-3  # as the board comes


def calibrate(
    fish: ConnectedFish,
    undo: bool = opt("Back to what the IMU was made with; nothing is measured."),
    dry_run: bool = opt("Measure, and change nothing."),
    recording: Path | None = opt("Frames of 'board imu record' instead of live ones.", "FILE.csv"),
) -> Output:
    """Calibrate the IMU: turn the fish by hand in quarter turns, still for 3 s after each.

    It says what to do next until it knows enough, writes the result into the IMU and restarts it.

    Example: tailbeat board imu calibrate
    """
    mount, as_made = _ready(fish), np.vstack([np.eye(3), np.eye(3)])
    if undo:
        _write(fish, as_made, _UNKNOWN_SCALE_SD)
        return Output({"undone": True}, f"the IMU measures as it was made. {_save_words()}")
    calibrated = fish.params.get(SCALE_PARAMETER).value < np.float32(_UNKNOWN_SCALE_SD)
    if calibrated and recording is None and not dry_run:
        _write(fish, as_made, _UNKNOWN_SCALE_SD)  # what it tells now is corrected already
    found = turns.calibrate(_recording(recording) if recording else _live(fish))
    scale_sd = max(turns.SCALE_SD_MIN, float(found.scale_sd.max()))
    document = _document(found) | {"written": not dry_run, "imu_scale_sd": scale_sd}
    if dry_run:
        return Output(document, f"{_words(found)}; nothing was changed")
    _write(fish, found.rows(mount), scale_sd)
    return Output(document, f"{_words(found)}; written into the IMU. {_save_words()}")


def _save_words() -> str:
    return f"Keep {SCALE_PARAMETER} with it: tailbeat params save"


def _ready(fish: Fish) -> F64:
    """From the sensor's axes to the fish's. Raises TailbeatError when the IMU is not ready."""
    info = fish.imu_verdict()
    if not info.problem.well:
        raise TailbeatError(f"the IMU is not ready: {info.problem.meaning}", info.problem.remedy)
    return turns.MOUNTS[round(fish.params.get(MOUNT_PARAMETER).value)]


def _write(fish: Fish, rows: F64, scale_sd: float) -> None:
    fish.imu_calibrate(rows)
    fish.params.set(SCALE_PARAMETER, scale_sd)
    info = fish.imu_verdict()
    if not info.problem.well:
        raise TailbeatError(
            f"the IMU did not come back as it was: {info.problem.meaning}", info.problem.remedy
        )


def _live(fish: Fish) -> Recording:
    """Until enough is known; a simulated fish is turned by a simulated hand."""
    found, hand = Recording(), Hand(fish.sim.world) if fish.sim is not None else None
    frames = fish.imu_frames()
    with contextlib.closing(frames), Display(quiet=True) as display:
        display.keep(
            "turn the fish slowly, hold it still for 3 s, and so on; a sound says that it was"
        )
        todo = turns.missing(found)
        for frame in frames:
            if hand is not None:
                hand.follow(frame.time_s)
            if found.add(frame):
                display.bell()
                if not (todo := turns.missing(found)):
                    break
            state = "still" if found.is_still else "turning"
            display.show(f"{len(found.rests)} rests, {state}; next: {todo}")
    if hand is not None:
        hand.put_back()
        fish.link.run(5.0)
    return found


def _recording(path: Path) -> Recording:
    try:
        with path.open(newline="") as file:
            return turns.recorded(_frame(row) for row in csv.DictReader(file))
    except (OSError, KeyError, ValueError) as error:
        raise InputError(
            f"{path} holds no frames ({reason(error) if isinstance(error, OSError) else error}).",
            "Record some: tailbeat board imu record FILE.csv",
        ) from error


def _frame(row: dict[str, str]) -> ImuFrame:
    def three(name: str, unit: str, axes: str = "xyz") -> tuple[float, ...]:
        return tuple(float(row[f"{name}{axis}{unit}"]) for axis in axes)

    return ImuFrame(
        sequence=int(row["sequence"]),
        time_s=float(row["t_s"]),
        accel_m_s2=three("accel_", "_m_s2"),
        rate_rad_s=three("rate_", "_rad_s"),
        ypr_deg=tuple(float(row[f"{name}_deg"]) for name in ("yaw", "pitch", "roll")),
    )


def _document(found: ImuCalibration) -> dict[str, Any]:
    return {
        "rests": found.rests,
        "rate_matrix": found.rate.tolist(),
        "accel_matrix": found.accel.tolist(),
        "rate_bias_rad_s": found.rate_bias_rad_s.tolist(),
        "accel_bias_m_s2": found.accel_bias_m_s2.tolist(),
        "scale_error": found.scale_error.tolist(),
        "scale_sd": found.scale_sd.tolist(),
        "axes_error_rad": found.axes_error_rad,
        "axes_sd_rad": found.axes_sd_rad.tolist(),
        "oddness": found.oddness,
    }


def _words(found: ImuCalibration) -> str:
    off = 100 * found.scale_error[int(np.argmax(np.abs(found.scale_error)))]
    return (
        f"gyroscopes measured up to {abs(off):.2f} % too {'little' if off > 0 else 'much'}, axes up"
        f" to {math.degrees(found.axes_error_rad):.2f} degrees off\nknown to"
        f" {100 * found.scale_sd.max():.3f} % and {math.degrees(found.axes_sd_rad.max()):.3f}"
        f" degrees by {found.rests} rests"
    )
