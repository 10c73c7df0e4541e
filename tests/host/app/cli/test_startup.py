"""What a command loads: little, and no numpy where the board needs none (bench/startup.py)."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys

import pytest

from tailbeat.board.fish import REST_CRC, rest

HEAVY = ("numpy", "scipy", "matplotlib", "rich", "pydantic", "msgspec", "importlib.metadata")
LOADED = """
import sys
from tailbeat.app.cli import run
status = run(sys.argv[1:])
print("loaded", *sys.modules, file=sys.stderr)
sys.exit(status)
"""
# As it was measured with Python 3.11, and a tenth more; each module takes 0.3 ms.
MODULES = {"--help": 183, "info": 271, "trial list": 271, "params list": 271, "stop": 271}


def loaded(*words: str) -> list[str]:
    """Modules at the end of a command."""
    command = [sys.executable, "-c", LOADED, *words]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "loaded " in run.stderr, run.stderr
    return run.stderr.rpartition("loaded ")[2].split()


@pytest.mark.parametrize("words", MODULES)
def test_a_command_loads_what_it_needs(words: str) -> None:
    connect = [] if words == "--help" else ["--connect", "sim"]
    modules = loaded(*words.split(), *connect)
    assert "tailbeat.app.cli.app" in modules
    assert not {name.partition(".")[0] for name in modules} & {*HEAVY} and not {*modules} & {*HEAVY}
    assert len(modules) <= MODULES[words], len(modules)


def test_a_command_that_computes_loads_numpy() -> None:
    """The look at the modules can tell."""
    assert "numpy" in loaded("reference", "check", "thesis")


RUN = "import sys; from tailbeat.app.cli import main; sys.exit(main())"
# Instructions over those of a bare ``python -c pass``: as measured, and a tenth more.
INSTRUCTIONS = {"--help": 7.5, "info --connect sim": 15.0}


def instructions(*arguments: str) -> int:
    """Of Python, counted by callgrind."""
    count = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null"]
    command = [*count, sys.executable, *arguments]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    found = re.search(r"Collected : (\d+)", run.stderr)
    assert found is not None, run.stderr
    return int(found[1])


@pytest.mark.soak
@pytest.mark.skipif(shutil.which("valgrind") is None, reason="valgrind counts the instructions")
def test_a_command_takes_few_instructions() -> None:
    bare = instructions("-c", "pass")
    for words, most in INSTRUCTIONS.items():
        times = instructions("-c", RUN, *words.split()) / bare
        print(f"tailbeat {words}: {times:.1f} x the instructions of bare Python")
        assert times <= most


def test_the_number_of_the_rest() -> None:
    assert rest().crc == REST_CRC
