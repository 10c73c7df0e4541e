"""Limits for every test that do not depend on how busy the machine is.

A test may use CPU_LIMIT_S of CPU time. Wall time ends only a test that hangs, 20 times later
(faulthandler_timeout in pyproject.toml). Both print the stack. Soak tests have no limit, nor has
a run with ``-o faulthandler_timeout=0``.

What each test used, its fixtures and the processes it waited for included, goes to the file that
TEST_COSTS names (tools/run_all.py).
"""

from __future__ import annotations

import faulthandler
import gc
import os
import signal
from collections import Counter
from collections.abc import Generator
from pathlib import Path
from types import FrameType

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command does, before numpy is loaded
CPU_LIMIT_S = 120.0


class CpuLimit(Exception):
    """A test used more CPU time than it may."""


def _stop(_: int, __: FrameType | None) -> None:
    raise CpuLimit(f"more than {CPU_LIMIT_S:.0f} s of CPU time; the stack shows where it was")


def pytest_configure(config: pytest.Config) -> None:
    os.fsync = lambda fd: None  # no test's files need to outlast the machine; waiting took 8 %
    signal.signal(signal.SIGPROF, _stop)
    guard_s = float(config.getini("faulthandler_timeout"))
    if 0 < guard_s < 20 * CPU_LIMIT_S:
        raise pytest.UsageError(f"faulthandler_timeout must be at least {20 * CPU_LIMIT_S:.0f}")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Most of what is collected stays to the end: not looked through for garbage meanwhile, and
    seldom after."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.set_threshold(50_000, 20, 50)
        gc.enable()


def pytest_runtest_setup(item: pytest.Item) -> None:
    guard_s = float(item.config.getini("faulthandler_timeout"))
    if item.get_closest_marker("soak") is not None:
        faulthandler.cancel_dump_traceback_later()
    elif guard_s > 0:
        signal.setitimer(signal.ITIMER_PROF, CPU_LIMIT_S)


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown() -> None:
    signal.setitimer(signal.ITIMER_PROF, 0)


_COST = "cpu_s"
_BEGIN = pytest.StashKey[float]()
_costs: Counter[str] = Counter()


def _cpu_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    item.stash[_BEGIN] = _cpu_s()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    now_s = _cpu_s()
    report.user_properties = [(_COST, now_s - item.stash[_BEGIN])]
    item.stash[_BEGIN] = now_s
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    _costs[report.nodeid] += dict(report.user_properties).get(_COST, 0.0)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Where the reports of all workers come together."""
    path = os.environ.get("TEST_COSTS")
    if path and not hasattr(session.config, "workerinput"):
        with Path(path).open("a") as file:
            file.writelines(f"{cpu_s:.3f} {name}\n" for name, cpu_s in _costs.items())
