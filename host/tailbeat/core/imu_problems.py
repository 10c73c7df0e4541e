"""Why a VN-100 does not stream as wanted: the firmware's table of problems (imu/problems.def)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from tailbeat.core.native import ffi, lib

NONE = 0
STARTING = 1
SILENT = 2
UNREADABLE = 3
NOISY = 9
NEEDS_SAVE = 10

_PREFIX = "IMU_PROBLEM_"


@dataclass(frozen=True)
class Problem:
    """One row of the table."""

    number: int
    name: str
    meaning: str
    remedy: str

    @property
    def well(self) -> bool:
        """Nothing is wrong."""
        return self.number == NONE


@cache
def all_problems() -> tuple[Problem, ...]:
    """Every row, in rising order of number."""
    rows = ffi.typeof("imu_problem_t").elements
    return tuple(_row(number, rows[number]) for number in sorted(rows))


@cache
def problem_info(number: int) -> Problem:
    """The row of ``number``; a made-up row when the table has none (a newer firmware)."""
    for problem in all_problems():
        if problem.number == number:
            return problem
    return Problem(
        number,
        f"PROBLEM_{number}",
        f"the board gave IMU problem {number}, which this tool does not know",
        "Tool and firmware differ in version; update the tool.",
    )


def _row(number: int, name: str) -> Problem:
    return Problem(
        number,
        name.removeprefix(_PREFIX),
        ffi.string(lib.imu_problem_meaning(number)).decode(),
        ffi.string(lib.imu_problem_remedy(number)).decode(),
    )
