"""Runs the firmware's unit tests on this computer and reports each one.

An installed package holds them as two programs. In a clone they are built from its sources, with
sanitizers, one program for each suite.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from tailbeat.core.errors import TailbeatError
from tailbeat.core.extras import checkout, reinstall
from tailbeat.core.platform.programs import program_name

PACKAGED = Path(__file__).parent.parent / "selftest"
_PROGRAMS = ("tailbeat_selftest_mock", "tailbeat_selftest_sim")
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


def find_source() -> Path | None:
    """The clone that runs this program; None when there is none."""
    root = checkout()
    return root if root is not None and is_source_tree(root) else None


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


def run_suite(executable: Path, suite: str = "") -> list[SelftestResult]:
    """Runs one suite: a program of its own, or the one called ``suite`` in a program of many. A
    crash, a hang or an unexplained status is a failed test."""
    arguments = [suite] if suite else []
    suite = suite or executable.name
    try:
        done = subprocess.run(
            [str(executable), *arguments],
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


def packaged_suites(folder: Path = PACKAGED) -> list[tuple[Path, str]]:
    """The suites in the programs of the installed package: program and name.

    Raises:
        SelftestError: when a program is missing or does not start.
    """
    found = []
    for stem in _PROGRAMS:
        program = folder / program_name(stem)
        try:
            listed = subprocess.run([str(program)], capture_output=True, text=True, check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            raise SelftestError(f"{program.name} does not start ({error})", reinstall()) from error
        found += [(program, suite) for suite in listed.stdout.split()]
    return found


def run_selftest(
    source: Path | None = None,
    build: Path | None = None,
    on_suite: Callable[[float, str], None] = lambda fraction, suite: None,
) -> SelftestReport:
    """Runs every unit test.

    Args:
        source: a clone to build them from; None = the clone that runs this, else the package.
        build: the folder to build in; None = build/unit in the clone.
        on_suite: told the part that is done (0 to 1) and what runs now.

    Raises:
        SelftestError: when the tests do not build or the package lacks them.
    """
    if source is None:
        source = find_source()
    elif not is_source_tree(source):
        raise SelftestError(f"{source} has no tests/unit", "Name the folder of a tailbeat clone.")
    if source is None:
        suites = packaged_suites()
    else:
        on_suite(0.0, "building")
        suites = [(program, "") for program in build_tests(source, build or source / "build/unit")]
        if not suites:
            raise SelftestError(f"{source}/tests/unit holds no tests", "Get a whole clone.")
    tests: list[SelftestResult] = []
    for number, (program, suite) in enumerate(suites):
        on_suite(number / len(suites), suite or program.name)
        tests += run_suite(program, suite)
    return SelftestReport(tests)
