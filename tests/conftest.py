"""Limits for every test that do not depend on how busy the machine is.

A test may use CPU_LIMIT_S of CPU time. Wall time ends only a test that hangs, 20 times later
(faulthandler_timeout in pyproject.toml). Both print the stack. Soak tests have no limit, nor has
a run with ``-o faulthandler_timeout=0``.
"""

from __future__ import annotations

import faulthandler
import signal
from types import FrameType

import pytest

CPU_LIMIT_S = 120.0


class CpuLimit(Exception):
    """A test used more CPU time than it may."""


def _stop(_: int, __: FrameType | None) -> None:
    raise CpuLimit(f"more than {CPU_LIMIT_S:.0f} s of CPU time; the stack shows where it was")


def pytest_configure(config: pytest.Config) -> None:
    signal.signal(signal.SIGPROF, _stop)
    guard_s = float(config.getini("faulthandler_timeout"))
    if 0 < guard_s < 20 * CPU_LIMIT_S:
        raise pytest.UsageError(f"faulthandler_timeout must be at least {20 * CPU_LIMIT_S:.0f}")


def pytest_runtest_setup(item: pytest.Item) -> None:
    guard_s = float(item.config.getini("faulthandler_timeout"))
    if item.get_closest_marker("soak") is not None:
        faulthandler.cancel_dump_traceback_later()
    elif guard_s > 0:
        signal.setitimer(signal.ITIMER_PROF, CPU_LIMIT_S)


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown() -> None:
    signal.setitimer(signal.ITIMER_PROF, 0)
