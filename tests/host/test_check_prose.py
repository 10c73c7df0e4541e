"""The prose checker finds what it is there to find; the repository's messages pass it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from check_prose import Table, words
from prose_texts import firmware_texts, host_texts

ROOT = Path(__file__).resolve().parents[2]
CHECKER = ROOT / "tools" / "check_prose.py"

MODULE = '''"""A docstring about a swim that was swum is no message."""

from tailbeat.core.errors import TailbeatError

# a comment on the logbook
KEY = "journal"


class Late(TailbeatError):
    """The swim."""


def check(number: int) -> None:
    """The last swim."""
    if number == 0:
        raise Late("no trial", "Run one.")
'''
COMMAND = '''"""Commands."""


def show(number: int = opt("Number of the trial.", name="--logbook")) -> Output:
    """Print a trial.

    Example: tailbeat trial show --logbook day 3
    """
'''
PAGE = """# Trials

The command `tailbeat swim` and the file [`logbook`](logbook.md) are code.
floor(x) is a function, and a tank's floor is on the floor.

```
a swim, a verdict, the logbook
```
"""
FAULTS = 'FAULT(1, LATE, ABORT, "the tick was late", "Look with \'tailbeat info\', then clear.")\n'
LONG = " ".join(["word"] * 21)


def check(root: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(CHECKER), str(root), *options]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def write(root: Path, path: str, text: str) -> None:
    (root / path).parent.mkdir(parents=True, exist_ok=True)
    (root / path).write_text(text, encoding="utf-8")


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A small tree without a fault."""
    write(tmp_path, "docs/how-to/trials.md", PAGE)
    write(tmp_path, "host/tailbeat/core/late.py", MODULE)
    write(tmp_path, "host/tailbeat/app/cli/trial.py", COMMAND)
    write(tmp_path, "firmware/supervisor/faults.def", FAULTS)
    write(tmp_path, "firmware/app/swim.c", '/* the swim */\nlink_text(link, 4, "battery low");\n')
    return tmp_path


def test_accepts_a_right_tree(tree: Path) -> None:
    done = check(tree)
    assert done.returncode == 0, done.stdout


def test_the_messages_of_the_repository_are_right() -> None:
    table = Table.read(ROOT / "tools" / "prose_words.toml")
    found = [line for text in host_texts(ROOT) for line in words(text, table)]
    found += [line for text in firmware_texts(ROOT) for line in words(text, table)]
    assert found == []


@pytest.mark.parametrize(
    ("path", "old", "new", "line"),
    [
        ("docs/how-to/trials.md", "function, and", "function, teh", "4: teh -> the"),
        ("host/tailbeat/core/late.py", "# a comment", "# teh", "5: teh -> the"),
        ("docs/how-to/trials.md", "# Trials", "# A\n\nEvery swim\ncounts", "3: Every swim -> "),
        ("docs/how-to/trials.md", "tank's floor is", "lowest floor is", "4: floor -> error bound"),
        ("host/tailbeat/core/late.py", '"no trial"', '"no swim"', "16: no swim -> trial"),
        ("host/tailbeat/core/late.py", '"Run one."', 'f"{number} logbooks"', "16: logbooks -> "),
        ("host/tailbeat/core/late.py", "KEY = ", "KEY = 'so bad a verdict'  #", "6: verdict -> "),
        ("host/tailbeat/core/late.py", '"Run one."', f'"{LONG}."', "16: 21 words in 'word word"),
        ("host/tailbeat/app/cli/trial.py", "Number of the", "Verdict of the", "4: Verdict -> "),
        ("host/tailbeat/app/cli/trial.py", "Print a trial", "Print a swim", "5: a swim -> trial"),
        ("host/tailbeat/app/cli/trial.py", "Print a trial", LONG, "5: 21 words in 'word word"),
        ("firmware/supervisor/faults.def", "then clear", "then swim again", "1: swim again -> "),
        ("firmware/supervisor/faults.def", "the tick was late", LONG, "1: 21 words in 'word word"),
        ("firmware/app/swim.c", "battery low", "no such wired port", "2: wired port -> "),
    ],
)  # fmt: skip
def test_catches(tree: Path, path: str, old: str, new: str, line: str) -> None:
    content = (tree / path).read_text(encoding="utf-8")
    assert old in content
    write(tree, path, content.replace(old, new, 1))
    done = check(tree)
    assert done.returncode == 1, done.stdout + done.stderr
    assert f"{path}:{line}" in done.stdout


@pytest.mark.parametrize(
    "sentence",
    [
        "a fish swims at 0.05 m/s",
        "the noise floor of the camera",
        "Run it: tailbeat trial run --logbook",
        "see 'the logbook swum'",
        f"{' '.join(['word'] * 12)}. {' '.join(['word'] * 12)}.",
    ],
)
def test_a_right_context_passes(tree: Path, sentence: str) -> None:
    write(tree, "host/tailbeat/app/cli/app.py", 'COMMANDS = {"trial run": Entry("Run")}\n')
    write(tree, "host/tailbeat/core/right.py", f'TEXT = "{sentence}"\n')
    done = check(tree)
    assert done.returncode == 0, done.stdout
