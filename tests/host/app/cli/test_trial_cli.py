"""'trial show --recompute': a trial's speeds computed again from its file."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from tailbeat.app.cli import trial as trial_commands
from tailbeat.app.cli.app import app
from tailbeat.core.errors import TailbeatError
from tailbeat.core.speed_estimate import recomputed

RAW = next((Path(__file__).parents[3] / "data" / "written_by_0bf270a").rglob("raw/*.ulg"))


def show(*words: str) -> Result:
    return CliRunner().invoke(app, ["trial", "show", str(RAW), "--recompute", *words])


def test_the_same_speeds() -> None:
    assert show().output.rstrip().endswith("recomputed: the same speeds and sigmas, bit for bit")
    assert json.loads(show("--json").output)["recomputed"]["identical"] is True


def test_other_speeds_are_an_error_and_not_called_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        trial_commands, "recomputed", lambda trial: replace(recomputed(trial), identical=False)
    )
    result = show()
    assert result.exit_code == 1
    assert "the same speeds" not in result.output
    assert isinstance(result.exception, TailbeatError)
    assert "cannot be computed again from its file" in result.exception.message
    as_json = show("--json").exception
    assert isinstance(as_json, TailbeatError)
    assert as_json.document["recomputed"]["identical"] is False
