"""The walls on the page are those that the command was given a calibration of."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from tailbeat.app.cli.app import app
from tailbeat.app.web.worker import Worker
from tailbeat.sensors.camera.render.scene import Scene


def worker_of(monkeypatch: pytest.MonkeyPatch, *options: str) -> Worker:
    made: list[Worker] = []
    monkeypatch.setattr("tailbeat.app.cli.web.serve", lambda worker, *_: made.append(worker))
    command = ["session", "web", "--connect", "sim", "--port", "0", *options]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    return made[0]


def test_of_a_calibration(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    scene, path = Scene(), tmp_path / "tank.json"
    scene.calibration().save(path)
    walls = worker_of(monkeypatch, "--calibration", str(path)).now.walls
    assert list(walls) == scene.walls_m()


def test_without_one(monkeypatch: pytest.MonkeyPatch) -> None:
    assert worker_of(monkeypatch).now.walls == ()
