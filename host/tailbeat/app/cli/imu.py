"""board imu status, save, record."""

from __future__ import annotations

import contextlib
import csv
import itertools
import math
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from tailbeat.app.cli._connect import connected
from tailbeat.app.cli._options import Connect, Json
from tailbeat.app.cli._terminal import progress_bar, say
from tailbeat.app.cli.board import imu_line
from tailbeat.board.fish import Fish
from tailbeat.core.errors import TransferError
from tailbeat.core.files import plain
from tailbeat.link.messages import ImuFrame, ImuInfo, imu_health

_COLUMNS = [
    "sequence",
    "t_s",
    "accel_x_m_s2",
    "accel_y_m_s2",
    "accel_z_m_s2",
    "rate_x_rad_s",
    "rate_y_rad_s",
    "rate_z_rad_s",
    "yaw_deg",
    "pitch_deg",
    "roll_deg",
]


def status(connect: Connect = None, json: Json = False) -> None:
    """Print the IMU's state; of a problem, its cause and what to do.

    Example: tailbeat board imu status
    """
    with connected(connect) as fish:
        info = fish.imu_verdict()
        health = {k: v for k, v in fish.health().items() if k.startswith("imu_")}
    document = plain(info)
    document["health"] = health
    document["not_well"] = [words for words, _ in _not_well(health)]
    say(json, document, lambda: _text(info, health))


def _not_well(health: dict[str, Any]) -> list[tuple[str, str]]:
    return imu_health(int(health["imu_health"]))


def _text(info: ImuInfo, health: dict[str, Any]) -> str:
    not_well = _not_well(health)
    line = imu_line(info)
    if info.problem.well and not not_well:
        return f"{line}; {health['imu_frames']} frames"
    lines = [line]
    if info.error:
        lines.append(f"the IMU said: {info.error}")
    if not info.problem.well and info.model:
        firmware = f", firmware {info.firmware}" if info.firmware else ""
        lines.append(f"it is a {info.model}{firmware}; the board is {info.state}")
    if not_well:
        lines.append(f"in the last seconds: {', '.join(words for words, _ in not_well)}")
    lines += [f"to do: {remedy}" for _, remedy in not_well if remedy]
    counters = [f"{k.removeprefix('imu_')} {v}" for k, v in health.items() if _counts(k) and v]
    if counters:
        lines.append(f"since boot: {', '.join(counters)}")
    return "\n".join(lines)


def _counts(name: str) -> bool:
    return name not in ("imu_health", "imu_problem")


def save(connect: Connect = None, json: Json = False) -> None:
    """Write the IMU's settings into its own flash and restart it. IMU_MOUNT needs this.

    Example: tailbeat board imu save
    """
    with connected(connect) as fish:
        fish.imu_save()
    say(json, {"saved": True}, "saved; the IMU restarts with these settings")


def record(
    out: Annotated[Path, typer.Argument(metavar="OUT.csv", help="Replaced if it exists.")],
    seconds: Annotated[
        float | None,
        typer.Option("--seconds", min=0.0, help="Of board time; default: until Ctrl-C."),
    ] = None,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Write the IMU's raw frames to a CSV file as they arrive.

    Example: tailbeat board imu record rest.csv --seconds 30
    """
    with connected(connect) as fish, progress_bar(json, "recording") as show:
        tally = _Tally()
        frames = fish.imu_frames(math.inf if seconds is None else seconds)
        written = _rows_into(out, frames)
        with (
            contextlib.suppress(KeyboardInterrupt),
            contextlib.closing(frames),
            contextlib.closing(written),
        ):
            for frame in written:
                tally.add(frame)
                show(tally.duration_s / (seconds or math.inf), f"{tally.frames} frames")
        if not tally.frames:
            raise _silent(fish)
    say(json, {"file": out, **tally.document()}, lambda: tally.text(out))


def _rows_into(out: Path, frames: Iterator[ImuFrame]) -> Generator[ImuFrame, None, None]:
    """Writes each frame down before it hands it on. A file that is there is not touched before the
    first one comes."""
    first = next(frames, None)
    if first is None:
        return
    with out.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(_COLUMNS)
        for frame in itertools.chain([first], frames):
            writer.writerow(_row(frame))
            yield frame


class _Tally:
    """Counts frames and the numbers missing between them."""

    def __init__(self) -> None:
        self.frames = 0
        self.missing = 0
        self._first_s = self._last_s = 0.0
        self._next = 0

    @property
    def duration_s(self) -> float:
        """From the first frame to the last."""
        return self._last_s - self._first_s

    def add(self, frame: ImuFrame) -> None:
        """One more; a number below the last one's is a board that has restarted."""
        if not self.frames:
            self._first_s = frame.time_s
        elif frame.sequence > self._next:
            self.missing += frame.sequence - self._next
        self.frames += 1
        self._next = frame.sequence + 1
        self._last_s = frame.time_s

    def document(self) -> dict[str, Any]:
        """All of it."""
        return {
            "frames": self.frames,
            "missing_frames": self.missing,
            "duration_s": self.duration_s,
        }

    def text(self, out: Path) -> str:
        """One line."""
        return f"{out}: {self.frames} frames, {self.duration_s:.2f} s, {self.missing} missing"


def _row(frame: ImuFrame) -> list[str]:
    values = (*frame.accel_m_s2, *frame.rate_rad_s, *frame.ypr_deg)
    single = [str(np.float32(value)) for value in values]
    return [str(frame.sequence), f"{frame.time_s:.6f}", *single]


def _silent(fish: Fish) -> Exception:
    problem = fish.imu_info().problem
    if problem.well:
        return TransferError(
            "no frames came over the link", "Record longer, or check the Bluetooth link."
        )
    return TransferError(f"no frames came: {problem.meaning}", problem.remedy)
