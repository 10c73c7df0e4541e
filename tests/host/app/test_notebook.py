"""The notebook of the documentation comes out as it is stored."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


def test_the_notebook_comes_out_as_it_is_stored() -> None:
    command = [sys.executable, str(ROOT / "tools" / "notebook.py")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("was", "now", "right"),
    [
        ("RMS  4.2 mm/s", "RMS  4.1 mm/s", True),
        ("RMS 10.0 mm/s", "RMS  9.9 mm/s", True),
        ("RMS  4.2 mm/s", "RMS  4.0 mm/s", False),
        ("RMS  4.2 mm/s", "RMS  4.25 mm/s", False),
        ("40 beats", "40 speeds", False),
        ("[83., 84.]", "[83.]", False),
    ],
)
def test_a_last_digit_may_differ_by_one(was: str, now: str, right: bool) -> None:
    spec = importlib.util.spec_from_file_location("notebook", ROOT / "tools" / "notebook.py")
    assert spec is not None and spec.loader is not None
    notebook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(notebook)
    assert notebook.agree(was, now) is right
