"""Criteria can fail: wrong results planted into laws and plants change verdicts (planted.py)."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from itertools import repeat
from pathlib import Path

import pytest
from tests.host.studies.thesis.planted import PLANTED

from tailbeat.studies.thesis.example import VERDICTS

SCRIPT = Path(__file__).parent / "planted.py"
# An epsilon of 5 for 0.1 leaves the errors within the bound (4.21) of 0.1, which is that loose.
# Without its source the rod starts at 15.6, the thesis at 13.20: not confirmed either way.
UNNOTICED = {"a_wide_tanh", "no_source"}


def judged(name: str, chapter: int) -> dict[str, str]:
    command = [sys.executable, SCRIPT, name, str(chapter)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found: dict[str, str] = json.loads(done.stdout)
    return found


def changed(before: Mapping[str, str], after: Mapping[str, str]) -> list[str]:
    """Verdicts and contradictions that differ; a check that cannot be computed counts for none."""
    said = {*VERDICTS, "True", "False"}
    return [id for id, now in after.items() if now in said and now != before[id]]


@pytest.mark.soak
def test_planted_results_change_verdicts() -> None:
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        chapters = range(2, 10)
        plain = dict(zip(chapters, pool.map(judged, repeat("none"), chapters), strict=True))
        planted = pool.map(lambda one: judged(one, PLANTED[one][0]), PLANTED)
        found = {
            name: changed(plain[PLANTED[name][0]], after)
            for name, after in zip(PLANTED, planted, strict=True)
        }
    for name, ids in found.items():
        print(f"{name}: {', '.join(ids) or 'no change'}")
    unnoticed = {name for name, ids in found.items() if not ids}
    assert len(PLANTED) >= 30 and len(unnoticed) <= len(PLANTED) // 10
    assert unnoticed <= UNNOTICED
