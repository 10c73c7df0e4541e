"""docs/how-to/programs/: what the pages show of Octave and R runs, where those are installed."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tailbeat.experiment.export import FORMATS, export
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.mcap_file import TOPICS

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs" / "how-to" / "programs"
WORDS_MAX = 170
OCTAVE = ["octave", "--no-gui", "--quiet", "--eval"]
PROGRAMS = {"matlab": OCTAVE, "r": ["Rscript", "-e"]}
DRAWING = ("plot", "hold", "ylabel")  # an Octave without screen may have nothing that draws


def block(page: str, language: str) -> str:
    """The first code block of a language."""
    text = (PAGES / f"{page}.md").read_text()
    found = re.search(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert found
    return found[1]


@pytest.mark.parametrize(("page", "folder"), [("matlab", "export"), ("r", ".")])
def test_the_code_of_the_page_runs(page: str, folder: str, tmp_path: Path) -> None:
    command = PROGRAMS[page]
    if shutil.which(command[0]) is None:
        pytest.skip(f"{command[0]} is not installed")
    shutil.copytree(ROOT / "examples" / "data" / "experiment", tmp_path / "e")
    export(Experiment(tmp_path / "e"), ["mat", "csv"])
    for name in DRAWING:
        (tmp_path / "e" / folder / f"{name}.m").write_text(f"function {name}(varargin)\nend\n")
    done = subprocess.run(
        [*command, block(page, page)],
        cwd=tmp_path / "e" / folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "64.8" in done.stdout  # mm/s of trial 1


def test_the_pages_are_short_and_name_what_there_is() -> None:
    for path in PAGES.glob("*.md"):
        text = path.read_text()
        assert len(text.split()) <= WORDS_MAX, path.name
        for name in re.findall(r"--format (\w+)", text):
            assert name in FORMATS
    foxglove = (PAGES / "foxglove.md").read_text()
    assert all(f"`{topic.name}`" in foxglove for topic in TOPICS)
