"""The scripts of bench/: all are complete, and those with a tiny load run with it; the others take
seconds at least and are run by ``make bench``."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted(path.stem for path in (ROOT / "bench").glob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS)
def test_every_script_runs(
    script: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.syspath_prepend(ROOT / "bench")
    bench = importlib.import_module(script)
    assert bench.main.__defaults__[0] is bench.FULL
    if hasattr(bench, "TINY"):
        assert bench.main(bench.TINY) == 0
        assert capsys.readouterr().out
