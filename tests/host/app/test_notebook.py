"""The notebook of the documentation comes out as it is stored."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]


def test_the_notebook_comes_out_as_it_is_stored() -> None:
    command = [sys.executable, str(ROOT / "tools" / "notebook.py")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
