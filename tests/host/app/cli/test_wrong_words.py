"""What a slip of the finger is answered with: the word that was meant, whatever kind of word it is;
and lines that fit the terminal."""

from __future__ import annotations

import pytest

from tailbeat.app.cli import run
from tailbeat.app.cli._terminal import wrapped

SIM = ("--connect", "sim")


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("strat",), "start"),
        (("trial", "rnu"), "run"),
        (("board", "imu", "decdoe"), "decode"),
        (("trial", "run", "--untli", "3"), "--until"),
        (("--conect", "sim", "info"), "--connect"),
        (("start", "--law", "modle", *SIM), "model"),
        (("camera", "render", "--marker", "bolb", "out.avi"), "blob"),
        (("trial", "run", "--until", "convergd", *SIM), "converged"),
        (("params", "get", "ILC_GIAN", *SIM), "ILC_GAIN"),
        (("params", "preset", "thesi", *SIM), "thesis"),
        (("reference", "check", "thesys", *SIM), "thesis"),
        (("sim", "fish", "--plant", "tnak"), "tank"),
        (("sim", "fish", "--set", "kapa=3"), "kappa"),
        (("sim", "montecarlo", "designd-law"), "designed-law"),
        (("sim", "thesis", "ch2-ex3"), "ch2-ex1"),
        (("info", "--connect", "smi"), "sim"),
        (("sim", "demo", "--law", "modle"), "model"),
    ],
)
def test_the_word_that_was_meant(
    words: tuple[str, ...], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    status = run(list(words))
    error = capsys.readouterr().err
    assert status != 0 and error.count("\n") == 1
    said = error.partition("Did you mean ")[2] or error.partition("Possible options: ")[2]
    assert meant in said.partition("?")[0].partition(")")[0], error


def test_connect_and_json_stand_before_the_command_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--json", "--connect", "sim", "params", "get", "ILC_GAIN"]) == 0
    before = capsys.readouterr().out
    assert run(["params", "get", "ILC_GAIN", "--connect", "sim", "--json"]) == 0
    assert before == capsys.readouterr().out and before.startswith("{")


@pytest.mark.parametrize(
    "words",
    [
        ("--connect", "sim", "trial", "list"),
        ("trial", "--connect", "sim", "list"),
        ("trial", "list", "--connect=sim"),
        ("--connect", "sim", "--version"),
    ],
)
def test_connect_stands_anywhere(words: tuple[str, ...]) -> None:
    assert run(list(words)) == 0


@pytest.mark.parametrize("words", [(), ("trial",), ("--connect", "sim")])
def test_without_a_command_the_help_is_shown(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(list(words)) == 2
    assert capsys.readouterr().out.startswith("Usage: tailbeat")


def test_an_option_that_a_command_lacks_is_not_proposed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--connect", "sim", "report"]) == 2
    assert "Did you mean" not in capsys.readouterr().err


@pytest.mark.parametrize("columns", [40, 60, 80])
def test_long_lines_are_wrapped_between_words(columns: int) -> None:
    text = (
        "ok  limit: " + "AMP_MAX_RAD may rise as far as a run of the fish went." + " It went." * 30
    )
    lines = wrapped(text, columns).splitlines()
    assert max(map(len, lines)) <= columns
    assert " ".join(" ".join(lines).split()) == " ".join(text.split())
