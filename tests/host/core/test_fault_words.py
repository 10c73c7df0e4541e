"""One table of faults and one of IMU problems: the same words in C, in the tool and in the docs,
and remedies that name only what exists."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer.main

import generate as pages  # docs/generate.py
from tailbeat.app.cli.app import app
from tailbeat.core import faults
from tailbeat.core.faults import FaultInfo, all_faults, all_problems, fault_info
from tailbeat.link.params import known_parameters

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs/reference/faults.md"
FAULTS = ROOT / "firmware/supervisor/faults.def"
PROBLEMS = ROOT / "firmware/imu/problems.def"
TEXT_MAX = 49  # of a STATUSTEXT
KINDS = {"none": range(1), "abort": range(1, 20), "fault": range(20, 40), "refusal": range(40, 256)}

# Whoever is told something must be told what to do: one of these, as a verb.
VERBS = re.findall(
    r"\w+",
    "add ask bring change charge check choose clear close compare connect correct disarm discard "
    "do fasten free hold keep learn list look lower make must needed pull raise reconnect "
    "report restore see set shorten slow start swim switch try update upload wait wire "
    "write",
)


QUOTED = re.compile(r"\*([^*]+)\*")  # in italics


def rows(path: Path, macro: str) -> list[list[str]]:
    """The arguments of each MACRO(...) line."""
    found = []
    for line in path.read_text().splitlines():
        if line.startswith(f"{macro}("):
            inside = line.removeprefix(f"{macro}(").removesuffix(")")
            found.append([cell.strip() for cell in next_cells(inside)])
    return found


def next_cells(text: str) -> Iterator[str]:
    for quoted, bare in re.findall(r'"([^"]*)"|([^,"\s]+)', text):
        yield quoted or bare if quoted or bare else ""


def page_rows(name: str) -> list[list[str]]:
    """The cells of the table of a generated page."""
    (text,) = pages.PAGES[name][2]()
    lines = [line.strip() for line in text.splitlines() if line.startswith("|")][2:]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


def remedies() -> list[tuple[str, str]]:
    return [(f.name, f.remedy) for f in all_faults()] + [
        (f"IMU {p.name}", p.remedy) for p in all_problems()
    ]


def test_the_tool_the_firmware_and_the_page_say_the_same() -> None:
    table = [
        (number, name, kind.lower(), meaning, remedy)
        for number, name, kind, meaning, remedy in rows(FAULTS, "FAULT")
    ]
    assert len(table) > 40
    assert [(str(f.number), f.name, f.kind, f.meaning, f.remedy) for f in all_faults()] == table
    assert [tuple(row) for row in page_rows("faults")] == table


def test_so_do_they_of_the_imu() -> None:
    table = [
        (number, name, meaning, remedy)
        for name, number, meaning, remedy in rows(PROBLEMS, "IMU_PROBLEM")
    ]
    assert len(table) > 10
    assert [(str(p.number), p.name, p.meaning, p.remedy) for p in all_problems()] == table
    assert [tuple(row) for row in page_rows("imu-problems")] == table


def test_numbers_and_names_are_unique_and_in_the_range_of_their_kind() -> None:
    for words in (all_faults(), all_problems()):
        assert max(Counter(row.number for row in words).values()) == 1
        assert max(Counter(row.name for row in words).values()) == 1
        assert max(Counter(row.meaning for row in words).values()) == 1
        assert [row.number for row in words] == sorted(row.number for row in words)
    for fault in all_faults():
        assert fault.number in KINDS[fault.kind], fault.name


def test_what_it_means_fits_into_one_line_of_text() -> None:
    for row in (*all_faults(), *all_problems()):
        assert 0 < len(row.meaning) <= TEXT_MAX, row.name
        assert row.meaning.isascii(), row.name
        assert row.meaning == row.meaning.strip(), row.name
        assert not row.meaning.endswith("."), row.name


@pytest.mark.parametrize(("name", "remedy"), remedies())
def test_every_remedy_says_what_to_do(name: str, remedy: str) -> None:
    if name in ("NONE", "IMU NONE"):
        assert remedy == ""
        return
    words = re.findall(r"[a-z]+", remedy.lower())
    assert set(words) & set(VERBS), f"{name}: nothing to do in '{remedy}'"
    assert remedy.isascii()


@pytest.mark.parametrize(("name", "remedy"), remedies())
def test_what_a_remedy_names_exists(name: str, remedy: str) -> None:
    for command in commands_named(remedy):
        assert known_command(command), f"{name}: there is no '{command}'"
    for word in re.findall(r"\b[A-Z]+(?:_[A-Z0-9]+)+\b", remedy):
        assert word in known_parameters(), f"{name}: there is no parameter {word}"
    for page in re.findall(r"docs/[\w.-]+\.md", remedy):
        assert (ROOT / page).exists(), f"{name}: there is no {page}"


def commands_named(text: str) -> list[str]:
    """Every 'tailbeat xyz' in a text, up to where the command's words end."""
    return [f"tailbeat{rest}" for rest in re.findall(r"tailbeat((?: [a-z0-9-]+)+)", text)]


@cache
def root() -> Any:
    return typer.main.get_command(app)


@cache
def known_command(text: str) -> bool:
    """Whether the words lead to a command under its present name: the rest may be arguments, or
    prose."""
    here = root()
    words = text.split()[1:]
    while words and hasattr(here, "commands"):
        below = here.commands.get(words[0])
        if below is None or below.hidden:
            break
        here, words = below, words[1:]
    return not hasattr(here, "commands") or bool(here.entry and here.entry.default)


def test_the_search_for_commands_finds_wrong_ones() -> None:
    assert commands_named("Look: tailbeat trial list") == ["tailbeat trial list"]
    assert known_command("tailbeat trial list")
    assert known_command("tailbeat reference upload thesis")
    assert known_command("tailbeat board imu") and known_command("tailbeat board imu save")
    assert known_command("tailbeat sim") and not known_command("tailbeat board")
    assert not known_command("tailbeat " + "imu") and not known_command("tailbeat " + "doctor")
    assert known_command("tailbeat trial learn")
    assert not known_command("tailbeat trail list")
    assert not known_command("tailbeat trial lust")
    assert not known_command("tailbeat trial")
    assert not known_command("tailbeat params show")


@cache
def strings(path: Path) -> tuple[str, ...]:
    return tuple(find_strings(path))


def find_strings(path: Path) -> Iterator[str]:
    """The texts a Python file may say: no docstrings; an f-string is one, with … for values."""
    tree = ast.parse(path.read_text())
    inside: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            inside.add(id(node.value))
        if isinstance(node, ast.JoinedStr):
            parts = [n for n in node.values if isinstance(n, ast.Constant)]
            inside |= {id(n) for n in parts}
            yield "…".join(str(n.value) for n in parts)
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and id(node) not in inside
        ):
            yield node.value


def test_commands_in_the_tools_own_messages_exist() -> None:
    found = 0
    for path in sorted((ROOT / "host/tailbeat").rglob("*.py")):
        for text in strings(path):
            quoted = re.findall(r"(?:'|: |\n  )(tailbeat [a-z][a-z0-9 -]*)", text)
            for command in (c for q in quoted for c in commands_named(q)):
                found += 1
                assert known_command(command), f"{path.name}: there is no '{command}'"
    assert found > 20


def test_commands_in_the_docs_exist() -> None:
    found = 0
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        text = path.read_text()
        blocks = "".join(re.findall(r"^```.*?^```", text, re.MULTILINE | re.DOTALL))
        quoted = re.findall(r"`(tailbeat [a-z][a-z0-9 -]*)", text)
        quoted += re.findall(r"^(tailbeat [a-z][a-z0-9 -]*)", blocks, re.MULTILINE)
        for command in (c for q in quoted for c in commands_named(q)):
            if "firmware" not in command:
                found += 1
                assert known_command(command), f"{path.name}: there is no '{command}'"
    assert found > 40


def test_what_the_page_quotes_the_tool_says() -> None:
    said = [t for path in (ROOT / "host/tailbeat").rglob("*.py") for t in strings(path)]
    section = PAGE.read_text().split("## When there is no connection")[1].split("\n## ")[0]
    quoted = [q for row in section.splitlines() if row[:2] == "| " for q in QUOTED.findall(row)]
    assert len(quoted) > 10
    for words in quoted:
        assert any(words in text for text in said), f"nothing says '{words}'"


def raised() -> dict[str, str]:
    """Every FAULT_X in the firmware's C, with a file that has it."""
    kinds = {"KIND_NONE", "KIND_ABORT", "KIND_FAULT", "KIND_REFUSAL"}
    found = {}
    for path in sorted((ROOT / "firmware").rglob("*.c")):
        for name in re.findall(r"(?<![A-Z_])FAULT_([A-Z_0-9]+)\b(?!#)", path.read_text()):
            if name not in kinds and not name.endswith("_"):
                found[name] = path.name
    return found


def test_what_the_firmware_may_say_is_on_the_page() -> None:
    listed = {row[1] for row in page_rows("faults")}
    for name, where in raised().items():
        assert name in listed, f"{where} has FAULT_{name}, the page of faults has not"
    assert len(raised()) > 30


def test_no_other_place_keeps_a_copy_of_the_words() -> None:
    meanings = [row.meaning for row in (*all_faults(), *all_problems()) if row.number]
    texts = [
        (path, text)
        for path in sorted((ROOT / "host/tailbeat").rglob("*.py"))
        for text in strings(path)
    ]
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        if path.parent.name != "generated":
            texts.append((path, path.read_text()))
    for path, text in texts:
        for meaning in meanings:
            assert meaning not in " ".join(text.split()), f"{path.name} has its own '{meaning}'"


def test_numbers_that_the_tool_knows_by_name_are_the_tables() -> None:
    table = {row.name: row.number for row in all_faults()}
    table |= {f"IMU_{row.name}": row.number for row in all_problems()}
    named = {n: v for n, v in vars(faults).items() if n.isupper() and isinstance(v, int)}
    assert len(named) >= 25
    assert named == {name: table.get(name) for name in named}


def test_a_number_from_a_newer_firmware_has_words_too() -> None:
    unknown = fault_info(199)
    assert isinstance(unknown, FaultInfo)
    assert "199" in unknown.meaning
    assert "version" in unknown.remedy
