"""Every script of bench/ runs, with a load so small that its figures mean nothing."""

from __future__ import annotations

import importlib
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted(path.stem for path in (ROOT / "bench").glob("*.py"))
LEARNING = ROOT / "build" / "bench" / "tailbeat_bench"


@pytest.mark.parametrize("script", SCRIPTS)
def test_every_script_runs(
    script: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.syspath_prepend(ROOT / "bench")
    bench = importlib.import_module(script)
    assert bench.main(bench.TINY) == 0
    assert capsys.readouterr().out


def test_the_program_without_python_learns() -> None:
    run = subprocess.run([LEARNING, "2"], capture_output=True, text=True, check=True)
    errors_mm_s = [float(line.split()[-3]) for line in run.stdout.splitlines()[:2]]
    assert errors_mm_s[1] < errors_mm_s[0]
    assert "x real time" in run.stdout
