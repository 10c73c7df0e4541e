"""The diagrams of the docs: drawn anew they are the same, and they agree with the code."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "diagrams"


@pytest.fixture(scope="module")
def draw() -> ModuleType:
    spec = importlib.util.spec_from_file_location("draw", FOLDER / "draw.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["draw"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def test_the_files_are_what_is_drawn(draw: ModuleType) -> None:
    assert {path.stem for path in FOLDER.glob("*.svg")} == set(draw.DIAGRAMS)
    for name, make in draw.DIAGRAMS.items():
        stored = (FOLDER / f"{name}.svg").read_text(encoding="utf-8")
        assert stored == make().svg(), f"run docs/diagrams/draw.py {name}"


def test_every_state_is_drawn() -> None:
    header = (ROOT / "firmware" / "supervisor" / "supervisor.h").read_text(encoding="utf-8")
    states = set(re.findall(r"\bSTATE_(?!COUNT)([A-Z]+)\b", header))
    picture = (FOLDER / "supervisor.svg").read_text(encoding="utf-8")
    assert len(states) == 8 and all(f">{state}<" in picture for state in states)


def test_every_pin_is_drawn_with_its_place_on_the_due() -> None:
    page = (ROOT / "docs" / "how-to" / "wiring.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| [A-Z_]+ \| (P[A-D]\d+) \| . \| ([DA]\d+) \|", page, re.MULTILINE)
    picture = (FOLDER / "wiring.svg").read_text(encoding="utf-8")
    assert len(rows) == 9
    for pin, header in rows:
        assert re.search(rf"\b{pin}\b", picture) and re.search(rf"\b{header}\b", picture), pin


def test_the_layers_are_those_that_are_enforced(draw: ModuleType) -> None:
    settings = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    block = settings.split("layers = [")[1].split("]")[0]
    assert re.findall(r'"([^"]+)"', block) == [name for name, _ in draw.HOST_LAYERS]
