"""`board flash --dry-run`: what it checks, what it prints, and that it changes nothing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.host.board.test_flash_files import image
from typer.testing import CliRunner

from tailbeat.app.cli.app import app
from tailbeat.board.flash import dry_run
from tailbeat.board.flash.procedure import FlashPlan, Surroundings
from tailbeat.core.errors import InputError


def world(**changes: object) -> Surroundings:
    """Programs and ports that are there; running or touching anything fails."""

    def never(*arguments: object) -> None:
        raise AssertionError(f"called with {arguments}")

    values = {
        "enumerate_ports": list,
        "require_program": lambda name, package: None,
        "require_free": lambda port: None,
        "touch": never,
        "restart": never,
        "run": never,
        "connect": never,
        "sleep": never,
    }
    return Surroundings(**(values | changes))  # type: ignore[arg-type]


def test_what_is_missing_is_listed_with_its_remedy(tmp_path: Path) -> None:
    def no_program(name: str, package: str) -> None:
        raise InputError(f"the program {name} is missing", f"Install {package}.")

    plan = FlashPlan(image(tmp_path / "a.bin"))
    found = dry_run.preview(plan, world(require_program=no_program))
    assert not found.ready
    program, port = found.missing
    assert "bossac is missing. Install bossa-cli." in program
    assert "no board is plugged in" in port and "USB cable" in port
    assert found.steps[0].startswith("save") and found.steps[-1] == "restore what was saved"


def test_without_keeping_nothing_is_saved(tmp_path: Path) -> None:
    found = dry_run.preview(FlashPlan(image(tmp_path / "a.bin"), keep=False), world())
    assert [step.split()[0] for step in found.steps] == ["erase", "restart"]


def test_an_image_that_cannot_boot_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(bytes(100))
    with pytest.raises(InputError, match="no image for the board"):
        dry_run.preview(FlashPlan(tmp_path / "a.bin"), world())


def test_the_command(tmp_path: Path) -> None:
    path = image(tmp_path / "a.bin")
    words = ["board", "flash", str(path), "--dry-run"]
    shown = CliRunner().invoke(app, words)
    assert shown.exit_code == 0 and "nothing was changed" in shown.output
    document = json.loads(CliRunner().invoke(app, [*words, "--json"]).stdout)
    assert document["size_bytes"] == path.stat().st_size and document["build_id"]
