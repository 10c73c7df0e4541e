"""The firmware's tables of faults and of IMU problems: numbers on the wire, words for people.

supervisor/faults.def and imu/problems.def; a row is added there and needs nothing here.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from tailbeat.core.errors import Refused
from tailbeat.core.native import c_text, ffi, lib

NONE = 0
ABORT_COMMAND = 1
TILT = 4
REBOOT = 5
WALL = 6
BATTERY_CRITICAL = 20
STORAGE = 22
WATCHDOG = 24
CRASH = 25
BATTERY_SENSE = 31
WRONG_STATE = 40
NO_REFERENCE = 41
BATTERY_LOW = 42
STALE_COMMAND = 44
TRIAL_PENDING = 45
NO_TRIAL = 46
BAD_DATA = 49
BAD_FILE = 50
BAD_FORMAT = 51
BAD_PARAM = 54
NO_BEST = 55
UNKNOWN_COMMAND = 57
NOT_STILL = 60
NOT_SIGNED = 62
NOT_FRESH = 63
LAW_FEEDBACK = 66
LAW_SIGN = 67
ERASING = 69

_KINDS = ("none", "abort", "fault", "refusal")


@dataclass(frozen=True)
class FaultInfo:
    """One row of the table. ``kind``: none, abort, fault or refusal."""

    number: int
    name: str
    kind: str
    meaning: str
    remedy: str


@cache
def all_faults() -> tuple[FaultInfo, ...]:
    """Every row, in rising order of number."""
    return tuple(_row(row) for row in range(lib.fault_count()))


@cache
def fault_info(number: int) -> FaultInfo:
    """The row of ``number``; a made-up row when the table has none (a newer firmware)."""
    unknown = FaultInfo(
        number,
        f"FAULT_{number}",
        "fault",
        f"the board gave fault {number}, which this tool does not know",
        "Tool and firmware differ in version; update the tool.",
    )
    return next((fault for fault in all_faults() if fault.number == number), unknown)


def refusal(number: int) -> Refused:
    """The exception for a request turned down with fault ``number``."""
    info = fault_info(number)
    return Refused(info.number, info.name, info.meaning, info.remedy)


def _row(row: int) -> FaultInfo:
    info = lib.fault_row(row)
    return FaultInfo(
        int(info.number),
        c_text(info.name),
        _KINDS[int(info.kind)],
        c_text(info.meaning),
        c_text(lib.fault_remedy(row)),
    )


IMU_NONE = 0
IMU_STARTING = 1
IMU_SILENT = 2
IMU_NOISY = 9
IMU_NEEDS_SAVE = 10

_IMU_PREFIX = "IMU_PROBLEM_"


@dataclass(frozen=True)
class ImuProblem:
    """One row of the table."""

    number: int
    name: str
    meaning: str
    remedy: str

    @property
    def well(self) -> bool:
        """Nothing is wrong."""
        return self.number == IMU_NONE


@cache
def all_problems() -> tuple[ImuProblem, ...]:
    """Every row, in rising order of number."""
    rows = ffi.typeof("imu_problem_t").elements
    return tuple(_row_imu_problems(number, rows[number]) for number in sorted(rows))


@cache
def problem_info(number: int) -> ImuProblem:
    """The row of ``number``; a made-up row when the table has none (a newer firmware)."""
    for problem in all_problems():
        if problem.number == number:
            return problem
    return ImuProblem(
        number,
        f"PROBLEM_{number}",
        f"the board gave IMU problem {number}, which this tool does not know",
        "Tool and firmware differ in version; update the tool.",
    )


def _row_imu_problems(number: int, name: str) -> ImuProblem:
    return ImuProblem(
        number,
        name.removeprefix(_IMU_PREFIX),
        c_text(lib.imu_problem_meaning(number)),
        c_text(lib.imu_problem_remedy(number)),
    )
