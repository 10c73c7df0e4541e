"""The template of a port, its guide, and the headers name the same functions."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
HEADERS = sorted((ROOT / "hal" / "include" / "hal").glob("*.h"))
PORTS = {"template": ["template"], "smartfusion2": ["smartfusion2", "cortex_m3"]}
LINES_MAX = 1000
FUNCTION = re.compile(r"^[a-z_][\w ]*[ *](hal_\w+)\(", re.MULTILINE)


def declared() -> set[str]:
    return {name for header in HEADERS for name in FUNCTION.findall(header.read_text("utf-8"))}


def test_each_port_and_the_guide_have_every_function() -> None:
    assert len(declared()) >= 18
    guide = (ROOT / "docs" / "how-to" / "port.md").read_text("utf-8")
    assert {name for name in declared() if f"`{name}`" not in guide} == set()
    for port, folders in PORTS.items():
        sources = [path for folder in folders for path in (ROOT / "hal" / folder).glob("*.c")]
        defined = {name for path in sources for name in FUNCTION.findall(path.read_text("utf-8"))}
        assert declared() - defined == set(), port


def test_a_port_is_small() -> None:
    files = [path for path in (ROOT / "hal" / "smartfusion2").iterdir() if path.is_file()]
    assert sum(len(path.read_text("utf-8").splitlines()) for path in files) <= LINES_MAX
