"""The runner behind `make test` and `make bench`, and what continuous integration calls."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def run_all(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "tools" / "run_all.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_a_failure_does_not_stop_the_next_command() -> None:
    run = run_all("one", "exit 3", "two", "echo second", "three", "kill -9 $$")
    assert run.returncode == 1
    assert "second" in run.stdout
    assert "FAILED (exit status 3)" in run.stdout
    assert "FAILED: 2 of 3: one, three" in run.stdout


def test_success_is_status_0() -> None:
    run = run_all("one", "true")
    assert run.returncode == 0
    assert "passed" in run.stdout and "FAILED" not in run.stdout


def test_the_largest_costs_are_listed(tmp_path: Path) -> None:
    costs = tmp_path / "costs.txt"
    costs.write_text("99.0 of the last run\n")
    tier = "".join(f"echo {number}.5 test {number} >>$TEST_COSTS;" for number in range(1, 25))
    run = run_all("--costs", str(costs), "--cpu-max", "60", "tier", tier)
    listed = [line.split(" s  ")[1] for line in run.stdout.splitlines() if " s  test " in line]
    assert listed == [f"test {number}" for number in range(24, 4, -1)]
    assert run.returncode == 0 and "of 60 s of CPU time" in run.stdout


@pytest.mark.parametrize(
    ("slow", "used_s", "over"),
    [(1.1, 59, False), (1.1, 61, True), (2.2, 79, False), (2.2, 81, True)],
)
def test_more_than_the_budget_of_60_s_fails(slow: float, used_s: float, over: bool) -> None:
    """A machine that is much slower may use 80."""
    code = (
        f"import run_all; run_all.fixed_work = lambda: {slow} * run_all.WORK_S;"
        f"run_all.run = lambda name, *_: run_all.Outcome(name, 0, 0.0, {used_s} * {slow});"
        "raise SystemExit(run_all.main(['--cpu-max', '60', 'tier', 'true']))"
    )
    command = [sys.executable, "-c", code]
    run = subprocess.run(command, cwd=ROOT / "tools", capture_output=True, text=True, check=False)
    assert run.returncode == over, run.stderr
    assert ("s of CPU time, at most" in run.stdout) == over


def test_what_runs_beside_the_last_begins_after_the_first(tmp_path: Path) -> None:
    met = tmp_path / "met"
    waits = f"until [ -e {met} ]; do sleep 0.01; done; echo last"
    run = run_all(
        "--beside", "aside", f"touch {met}; nice; echo asides >&2; exit 3",
        "--beside", "more", "echo more", "first", f"[ ! -e {met} ] && echo first", "last", waits,
    )  # fmt: skip
    assert run.returncode == 1 and "FAILED: 1 of 4: aside" in run.stdout
    assert run.stdout.split()[:5] == ["first", "last", str(os.nice(0) + 10), "asides", "more"]


@pytest.mark.parametrize(
    ("room", "forbidden", "there"), [(0, 0, True), (1 << 80, 0, False), (0, -1, False)]
)
def test_temporary_files_are_in_memory_where_there_is_room(
    tmp_path: Path, room: int, forbidden: int, there: bool
) -> None:
    """``forbidden``: the flag of a mount from which no program runs; some flag is always set."""
    command = f"echo $TMPDIR >{tmp_path}/where; touch $TMPDIR/file"
    code = (
        f"import pathlib, run_all; run_all.MEMORY = pathlib.Path({str(tmp_path)!r});"
        f"run_all.MEMORY_LEAST_BYTES = {room}; run_all.os.ST_NOEXEC = {forbidden};"
        f"raise SystemExit(run_all.main(['--in-memory', 'one', {command!r}]))"
    )
    environment = {**os.environ, "TMPDIR": "/elsewhere"}
    subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT / "tools", env=environment, capture_output=True, check=False,
    )  # fmt: skip
    where = Path((tmp_path / "where").read_text().strip())
    assert where.parent == (tmp_path if there else Path("/")) and not where.exists()


def test_integration_runs_both_and_fails_when_either_does(tmp_path: Path) -> None:
    ci = tmp_path / ".ci" / "run"
    ci.parent.mkdir()
    shutil.copy(ROOT / ".ci" / "run", ci)
    make = tmp_path / "make"
    make.write_text(f'#!/bin/sh\necho "$1" >>{tmp_path}/calls\n[ "$1" != "$FAILS" ]\n')
    make.chmod(0o755)
    for fails, status in (("check", 1), ("test", 1), ("none", 0)):
        (tmp_path / "calls").unlink(missing_ok=True)
        environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "FAILS": fails}
        run = subprocess.run([ci], env=environment, capture_output=True, check=False)
        assert run.returncode == status
        assert (tmp_path / "calls").read_text().split() == ["check", "test"]
