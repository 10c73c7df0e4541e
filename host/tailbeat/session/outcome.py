"""What a session knows of one trial: that the fish is ready, how far it will travel, why the trial
was stopped, what was recorded, and what was decided."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Literal

from tailbeat.core.errors import InputError
from tailbeat.core.faults import ABORT_COMMAND, REBOOT, fault_info
from tailbeat.core.trial_checks import HeadingDrift
from tailbeat.link.messages import BoardStatus, TrialOutcome


class StopKind(Enum):
    """What stopped a trial from the host."""

    WALL = "wall"
    DISTANCE = "distance"
    CAMERA = "camera"
    OPERATOR = "operator"
    CALLER = "caller"


@dataclass(frozen=True)
class StopReason:
    """Why a guard stops the tail. A ``WALL`` leaves the last beats unmeasured."""

    kind: StopKind
    text: str

    def __str__(self) -> str:
        return self.text


BY_HAND = StopReason(StopKind.OPERATOR, "stopped by hand")

DecisionKind = Literal["keep", "repeat", "discard"]
KINDS: tuple[DecisionKind, ...] = ("keep", "repeat", "discard")


@dataclass(frozen=True)
class Decision:
    """What becomes of a trial. ``keep``: it is learned from. ``repeat``: its log counts as a
    repeat, nothing is learned, the same amplitudes are executed again. ``discard``: it counts for
    nothing, the same amplitudes are executed again. ``reason``: needed unless it is kept."""

    kind: DecisionKind
    reason: str = ""

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"'{self.kind}' is no decision.", f"Say {', '.join(KINDS)}.")
        if self.kind != "keep" and not self.reason.strip():
            raise InputError(
                f"a swim to {self.kind} needs a reason.", "Say it in a few words: bumped the wall."
            )


_ROUNDING = 1e-6


@dataclass(frozen=True)
class Travel:
    """Distance over ground until the coast after the last beat is over. ``worst_m``: by a fish and
    a day that are as far off as may be believed (2 sigmas). ``room_m``: the tank's length less the
    fish's, infinite when TANK_LEN_M is 0. ``by``: what it was computed with, in words."""

    expected_m: float
    worst_m: float
    room_m: float
    by: str

    @property
    def fits(self) -> bool:
        """Whether what is expected has room."""
        return self.expected_m <= self.room_m + _ROUNDING

    def text(self) -> str:
        """One line: ``about 2.21 m, at worst 2.40, of 2.64 m (by the identified fish)``."""
        room = f", of {self.room_m:.2f} m" if math.isfinite(self.room_m) else ""
        return f"about {self.expected_m:.2f} m, at worst {self.worst_m:.2f}{room} (by {self.by})"

    def require_room(self) -> None:
        """Raises InputError, with the figures and what to do, when it does not fit."""
        if self.fits:
            return
        raise InputError(
            f"the next trial would travel {self.expected_m:.2f} m (by {self.by}), and the tank "
            f"clearance is {max(self.room_m, 0.0):.2f} m.",
            "Lower AMP_MAX_RAD (or ILC_GAIN before the first trial), shorten the reference, or "
            "correct TANK_LEN_M (0 = not checked).",
        )


@dataclass(frozen=True)
class Pose:
    """Where the fish lies: mean over a second. ``source`` ``camera``: position and heading in the
    tank's frame, and ``yaw_deg`` (VN-100, as mounted) if there is an IMU; ``imu``: the yaw only.
    None = not known."""

    source: str
    x_m: float | None = None
    y_m: float | None = None
    heading_rad: float | None = None
    yaw_deg: float | None = None


@dataclass(frozen=True)
class Drift:
    """Speed of a fish that nobody touches: over ground by the camera, so that of the water too; by
    the IMU (``source`` ``imu``) only that nothing moves it, with no speed (NaN)."""

    source: str
    speed_m_s: float
    sigma_m_s: float
    over_s: float


@dataclass(frozen=True)
class Ready:
    """What the preflight checks found. ``rested_s``: at least; None = no trial since the board
    started."""

    travel: Travel
    rested_s: float | None
    pose: Pose | None
    drift: Drift | None
    battery_v: float


@dataclass(frozen=True)
class RecordedTrial:
    """A trial whose log is here.

    ``file``: its log in the experiment's raw files, or wherever it was pulled to. ``ready``: what
    the preflight checks found; None = there were none. ``measured_beats``: of ``beats`` of the
    reference. ``problems``: what speaks against keeping it, in words (few speeds, not straight).
    ``judged``: enough of its beats are measured (convergence.Score). ``stopped``: why this program
    stopped it; None = it did not.
    """

    outcome: TrialOutcome
    file: Path
    ready: Ready | None
    straight: HeadingDrift | None
    max_abs_error_m_s: float
    rms_error_m_s: float
    measured_beats: int
    beats: int
    battery_start_v: float | None
    battery_end_v: float | None
    problems: tuple[str, ...] = ()
    judged: bool = False
    stopped: StopReason | None = None

    @property
    def other_problems(self) -> tuple[str, ...]:
        """Without the first one of a trial that was not executed to its end: how it ended."""
        return self.problems if self.outcome.end == "complete" else self.problems[1:]


def end_of(status: BoardStatus, trial: int, has_restarted: bool) -> str:
    """How a trial ended, as a trial file's header has it."""
    fault = status.fault
    if fault.number:
        return f"{'aborted' if fault.kind == 'abort' else 'fault'}:{fault.name}"
    if status.pending_trial == trial and status.beat >= status.beats:
        return "complete"
    # Without a restart of the board somebody else has aborted and cleared it.
    return f"aborted:{fault_info(REBOOT if has_restarted else ABORT_COMMAND).name}"
