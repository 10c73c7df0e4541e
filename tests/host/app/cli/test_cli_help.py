"""What --help and the shell's completion promise: an example for every command, one that parses."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main

from tailbeat.app.cli import run
from tailbeat.app.cli.app import COMMANDS as TABLE
from tailbeat.app.cli.app import GROUPS, aliases, app

ROOT: Any = typer.main.get_command(app)


def leaves(group: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command under its present name, with the words that call it."""
    for name, child in group.commands.items():
        if child.hidden:
            continue
        if hasattr(child, "commands"):
            yield from leaves(child, (*words, name))
        else:
            yield (*words, name), child.loaded


def groups(group: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Every group that is listed."""
    yield words
    for name, child in group.commands.items():
        if hasattr(child, "commands") and not child.hidden:
            yield from groups(child, (*words, name))


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


def test_the_table_is_the_command_line() -> None:
    assert {" ".join(words) for words in COMMANDS} == set(TABLE)
    for entry in (*GROUPS.values(), *TABLE.values()):
        assert not entry.help.endswith(".")
    assert len([one for one in ROOT.commands.values() if not one.hidden]) <= 12


@pytest.mark.parametrize("words", [*groups(ROOT)], ids=" ".join)
def test_each_list_of_commands_fits_80_columns(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert run([*words, "--help"]) == 0
    page = capsys.readouterr().out
    assert max(map(len, page.splitlines())) <= 80
    assert "..." not in page.replace("COMMAND [ARGS]...", "")
    listed = re.findall(r"^  ([a-z]\S*)  +\S.*$", page.partition("--help")[2], re.MULTILINE)
    here: Any = ROOT
    for word in words:
        here = here.commands[word]
    assert listed == [name for name, one in here.commands.items() if not one.hidden]


OLD = [*aliases()]


@pytest.mark.parametrize(("old", "new"), OLD, ids=[old for old, _ in OLD])
def test_every_old_name_calls_the_command(
    old: str, new: str, capsys: pytest.CaptureFixture[str]
) -> None:
    pages = []
    for words in (old, new):
        assert run([*words.split(), "--help"]) == 0
        pages.append(capsys.readouterr().out.partition("\n\n")[2])
    assert pages[0] == pages[1] != ""


def test_old_names_are_not_listed() -> None:
    renamed = {one.was: new for new, one in (GROUPS | TABLE).items() if one.was}
    assert len(renamed) == 27
    for old in renamed:
        *above, name = old.split()
        here: Any = ROOT
        for word in above:
            here = here.commands[word]
        assert here.commands[name].hidden, old
    assert not set(renamed.values()) & set(renamed)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("imu --json --connect sim?seed=1", "board imu --json --connect sim?seed=1"),
        ("imu --json --connect sim?seed=1", "board imu status --json --connect sim?seed=1"),
        ("key list --json", "board key list --json"),
        ("sweep --list", "sim montecarlo --list"),
        ("trial abort --json --connect sim?seed=1", "stop --json --connect sim?seed=1"),
        ("doctor --json --connect sim?seed=1", "board check --json --connect sim?seed=1"),
    ],
)
def test_an_old_name_gives_the_same_result(
    old: str, new: str, capsys: pytest.CaptureFixture[str]
) -> None:
    said = []
    for line in (old, new):
        status = run(line.split())
        said.append((status, *capsys.readouterr()))
    assert said[0] == said[1]
    assert said[0][1] != ""


def test_an_old_option_is_understood(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["reference", "upload", "thesis", "--connect", "sim?seed=1"]
    said = []
    for option in (["--like", "nothing"], ["--like=nothing"], ["--warm-start", "nothing"]):
        assert run([*words, *option]) == 1
        said.append(capsys.readouterr().err)
    assert said[0] == said[1] == said[2] != ""
    assert run(["reference", "upload", "--help"]) == 0
    assert "--like" not in capsys.readouterr().out


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_has_json_and_an_error_is_one_line(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert "json" in [parameter.name for parameter in COMMANDS[words].params]
    assert run([*words, "--json", "--no-such-option"]) == 2
    out, err = capsys.readouterr()
    error = json.loads(out)["error"]
    assert error["remedy"] == f"Try: tailbeat {' '.join(words)} --help"
    assert error["message"] in err
    assert err.startswith("tailbeat: ") and err.count("\n") == 1
    assert err.endswith(f"Try: tailbeat {' '.join(words)} --help\n")


CONNECTING = [
    words
    for words, command in COMMANDS.items()
    if "connect" in [one.name for one in command.params] and words[1:] != ("web",)
]


@pytest.mark.parametrize("words", CONNECTING, ids=" ".join)
def test_an_error_of_every_command_is_a_document(
    words: tuple[str, ...],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In an empty folder, without a board: what is missing first is the error."""
    monkeypatch.chdir(tmp_path)
    given = shlex.split(examples(COMMANDS[words])[0].partition("|")[0])[1:]
    status = run([*given, "--json", "--connect", "tcp:127.0.0.1:1"])
    out, err = capsys.readouterr()
    document = json.loads(out)
    if words == ("board", "check"):  # whose result it is
        assert status == 1 and document["ok"] is False
        return
    error = document["error"]
    assert status in (1, 2) and error["message"] and error["remedy"]
    assert err.startswith("tailbeat: ") and err.count("\n") == 1
    assert " ".join(error["remedy"].split()) in err


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
