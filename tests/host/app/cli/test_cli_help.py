"""What --help and the shell's completion promise: an example for every command, one that parses."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
import typer.main

from tailbeat.app.cli.app import app

ROOT: Any = typer.main.get_command(app)


def leaves(command: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command that does something, with the words that call it."""
    children = getattr(command, "commands", None)
    if children is None:
        yield words, command
        return
    for name, child in children.items():
        yield from leaves(child, (*words, name))


COMMANDS = dict(leaves(ROOT))


def examples(command: Any) -> list[str]:
    """The lines after ``Example:``, of a help text as it is written."""
    return re.findall(r"Example: (tailbeat [^\n]*)", command.help or "")


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_has_an_example_that_parses(words: tuple[str, ...]) -> None:
    command = COMMANDS[words]
    found = examples(command)
    assert found, f"tailbeat {' '.join(words)} has no example"
    for line in found:
        given = shlex.split(line.partition("|")[0])[1:]
        assert tuple(given[: len(words)]) == words
        context = command.make_context(
            "tailbeat", given[len(words) :], resilient_parsing=False
        )  # an option that is not there, or an argument too many, raises here
        assert context.params is not None


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_option_says_what_it_is_for(words: tuple[str, ...]) -> None:
    for parameter in COMMANDS[words].params:
        if parameter.param_type_name == "option" and parameter.name != "help":
            assert parameter.help, f"tailbeat {' '.join(words)}: {parameter.opts}"


def complete(shell: str, line: str) -> str:
    words = line.split(" ")
    environment = {
        **os.environ,
        "_TAILBEAT_COMPLETE": f"complete_{shell}",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(words) - 1),
        "_TYPER_COMPLETE_ARGS": line,
        "_TYPER_COMPLETE_FISH_ACTION": "get-args",
    }
    code = "from tailbeat.app.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.stderr == ""
    return done.stdout


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_shell_completes_commands_and_options(shell: str) -> None:
    assert "trial" in complete(shell, "tailbeat tri")
    assert "discard" in complete(shell, "tailbeat trial dis")
    assert "--until" in complete(shell, "tailbeat trial run --un")
