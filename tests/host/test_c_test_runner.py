"""The runner of the C tests ends what takes too long, and only that."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

RUNNER = Path(__file__).resolve().parents[1] / "unit" / "run.py"
TESTS = """
add_test(well "/bin/sh" "-c" "exit 0")
add_test(broken "/bin/sh" "-c" "echo what it said; exit 3")
add_test(spins "/bin/sh" "-c" "while :; do :; done")
add_test(sleeps "/bin/sh" "-c" "exec sleep 1000")
"""


@pytest.fixture
def runner(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    spec = importlib.util.spec_from_file_location("c_test_runner", RUNNER)
    assert spec is not None and spec.loader is not None
    monkeypatch.delenv("TEST_COSTS", raising=False)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def build(tmp_path: Path) -> Path:
    (tmp_path / "CTestTestfile.cmake").write_text(TESTS)
    return tmp_path


def test_a_failure_is_told_and_the_others_run(
    runner: ModuleType, build: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert runner.main([str(build), "broken", "well"]) == 1
    said = capsys.readouterr().out
    assert "broken FAILED: exit status 3\nwhat it said" in said
    assert "FAILED: 1 of 2: broken" in said
    assert runner.main([str(build), "well"]) == 0
    assert runner.main([str(build), "no_such_test"]) == 2


def test_too_much_cpu_time_ends_a_program(
    runner: ModuleType, build: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr(runner, "CPU_LIMIT_S", 0.6)
    assert runner.main([str(build), "spins"]) == 1
    assert "spins FAILED: used more than" in capsys.readouterr().out


def test_the_guard_ends_a_program_that_hangs(
    runner: ModuleType, build: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    assert runner.GUARD_S >= 20 * runner.CPU_LIMIT_S
    monkeypatch.setattr(runner, "GUARD_S", 0.3)
    assert runner.main([str(build), "sleeps"]) == 1
    assert "sleeps FAILED: hangs" in capsys.readouterr().out
