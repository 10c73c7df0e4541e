"""The examples of --help, executed one after the other against one simulated fish, from ``start``
on. Those that need a camera, a film, another computer's files or a serial port only parse
(test_cli_help.py)."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from tailbeat.app.cli import run
from tailbeat.learning import fit
from tailbeat.sim.board import SimBoard, SimTransport

from .test_cli_help import COMMANDS, examples

EXECUTED = (
    "start", "info", "board arm", "board disarm", "board clear", "board crash", "board imu status",
    "board key status", "board key list", "params get", "params set", "params list", "params save",
    "params load", "params preset", "params reset", "reference show", "reference check",
    "trial list", "session status", "experiment list", "report", "stop",
)  # fmt: skip
CHANGES = {  # what makes it quick, or its files those of the test
    "start": ["--until", "1", "--rest", "1"],
}


def test_the_examples_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    board = SimBoard("tank", seed=3)
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda _: SimTransport(board))
    monkeypatch.setattr(fit, "bootstrap", lambda *_, **__: [])
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "library"))
    monkeypatch.setenv("TAILBEAT_KEYS", str(tmp_path / "keys"))
    monkeypatch.chdir(tmp_path)
    for name in EXECUTED:
        words = tuple(name.split())
        line = examples(COMMANDS[words])[0].partition("|")[0]
        given = shlex.split(line)[1:] + CHANGES.get(name, [])
        if "connect" in [one.name for one in COMMANDS[words].params]:
            given += ["--connect", "it"]
        assert run(given) == 0, f"{line}: {capsys.readouterr().err}"
