"""Builds and runs the firmware's unit tests on this computer and reports each one.

The tests live in a source tree, not in the installed package; the tree is looked for
upward from the working folder and from the Python environment.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from tailbeat.core.errors import TailbeatError

TEST_TIMEOUT_S = 120.0
UNITY_LINE = re.compile(r"^[^:\n]+:\d+:(\w+):(PASS|FAIL|IGNORE)(?::\s?(.*))?$")


class SelftestError(TailbeatError):
    """The tests could not be built or found."""


@dataclass(frozen=True)
class SelftestResult:
    """One test; ``suite`` is the executable it belongs to."""

    name: str
    suite: str
    ok: bool
    message: str = ""


@dataclass(frozen=True)
class SelftestReport:
    """All tests, in the order they ran."""

    tests: list[SelftestResult] = field(default_factory=list)

    @property
    def passed(self) -> int:
        return sum(test.ok for test in self.tests)

    @property
    def failed(self) -> int:
        return len(self.tests) - self.passed

    def as_dict(self) -> dict[str, object]:
        """The JSON document of ``tailbeat sim selftest --json``."""
        return {"passed": self.passed, "failed": self.failed, "tests": self.tests}


def is_source_tree(folder: Path) -> bool:
    return (folder / "CMakeLists.txt").is_file() and (folder / "tests" / "unit").is_dir()


def find_source(starts: Iterable[Path] | None = None) -> Path:
    """The source tree at or above one of ``starts``.

    Raises:
        SelftestError: when there is none.
    """
    for start in starts if starts is not None else (Path.cwd(), Path(sys.prefix)):
        for folder in (start, *start.parents):
            if is_source_tree(folder) and (folder / "firmware").is_dir():
                return folder
    raise SelftestError(
        "no source tree found: the unit tests are not part of the installed package",
        "Run this inside a clone of tailbeat, or name its folder with --source.",
    )


def build_step(command: list[str]) -> None:
    """Runs one step of the build; its output is shown only when it fails."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError as error:
        raise SelftestError(
            f"{command[0]} is not installed", "apt-get install build-essential cmake ninja-build"
        ) from error
    if done.returncode != 0:
        lines = (done.stdout + done.stderr).strip().splitlines()
        wrong = next((line for line in lines if "error" in line.lower()), "see the build's output")
        raise SelftestError(
            f"the unit tests do not build: {wrong.strip()}", "Run 'make test' to see all of it."
        )


def build_tests(source: Path, build: Path) -> list[Path]:
    """Builds tests/unit, sanitized, in ``build``; returns the executables."""
    configure = ["cmake", "-S", str(source), "-B", str(build), "-DTAILBEAT_SANITIZE=ON"]
    configure += ["-DTAILBEAT_COVERAGE=ON", "-DTAILBEAT_NATIVE=OFF", "-DTAILBEAT_TESTS=ON"]
    configure += [f"-DPython_EXECUTABLE={sys.executable}"]
    if shutil.which("ninja") and not (build / "Makefile").exists():
        configure += ["-G", "Ninja"]
    build_step(configure)
    build_step(["cmake", "--build", str(build), "--parallel"])
    wanted = sorted(path.stem for path in (source / "tests" / "unit").glob("test_*.c"))
    return [build / "tests" / name for name in wanted]


def parse_unity(suite: str, output: str) -> list[SelftestResult]:
    """The tests in a Unity executable's output."""
    tests = []
    for line in output.splitlines():
        if found := UNITY_LINE.match(line.strip()):
            name, verdict, message = found.groups()
            text = message or ("ignored" if verdict == "IGNORE" else "")
            tests.append(SelftestResult(name, suite, verdict != "FAIL", text))
    return tests


def crash(suite: str, returncode: int, stderr: str) -> SelftestResult:
    """What stands in the report for an executable that did not come to its end."""
    how = f"killed by signal {-returncode}" if returncode < 0 else f"exit status {returncode}"
    lines = [line.strip() for line in stderr.splitlines() if line.strip(" =")]
    wrong = next((line for line in lines if "ERROR" in line or "error" in line), None)
    return SelftestResult(suite, suite, False, f"{how}: {wrong or (lines or ['no output'])[-1]}")


def run_suite(executable: Path) -> list[SelftestResult]:
    """Runs one executable. A crash, a hang or an unexplained status is a failed test."""
    suite = executable.name
    try:
        done = subprocess.run(
            [str(executable)],
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
            timeout=TEST_TIMEOUT_S,
            cwd=executable.parent,
            env={**os.environ, "UBSAN_OPTIONS": "print_stacktrace=0"},
        )
    except subprocess.TimeoutExpired:
        text = f"still running after {TEST_TIMEOUT_S:.0f} s"
        return [SelftestResult(suite, suite, False, text)]
    except OSError as error:
        return [SelftestResult(suite, suite, False, f"cannot be started: {error}")]
    tests = parse_unity(suite, done.stdout)
    failures = sum(not test.ok for test in tests)
    finished = re.search(r"^\d+ Tests \d+ Failures \d+ Ignored", done.stdout, re.MULTILINE)
    if not finished or done.returncode != failures or not tests:
        tests.append(crash(suite, done.returncode, done.stderr))
    return tests


def run_selftest(source: Path | None = None, build: Path | None = None) -> SelftestReport:
    """Builds and runs every unit test.

    Args:
        source: the source tree; None = find it.
        build: the folder to build in; None = build/unit in the source tree.

    Raises:
        SelftestError: when there is no source tree or the tests do not build.
    """
    if source is None:
        source = find_source()
    elif not is_source_tree(source):
        raise SelftestError(f"{source} has no tests/unit", "Name the folder of a tailbeat clone.")
    executables = build_tests(source, build or source / "build" / "unit")
    if not executables:
        raise SelftestError(f"{source / 'tests' / 'unit'} holds no tests", "Get a whole clone.")
    return SelftestReport([test for path in executables for test in run_suite(path)])
