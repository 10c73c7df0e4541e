"""The public names: what ``tailbeat`` and its packages export, and that each says what it takes."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import tailbeat

ROOT = Path(tailbeat.__file__).parent
_SECTIONS = ("Parameters", "Attributes", "Returns", "Yields", "Raises")


def packages() -> list[str]:
    """Every package whose face names what it exports."""
    found = []
    for face in sorted(ROOT.rglob("__init__.py")):
        tree = ast.parse(face.read_text(encoding="utf-8"))
        targets = [ast.unparse(n.targets[0]) for n in tree.body if isinstance(n, ast.Assign)]
        if "__all__" in targets:
            found.append(".".join(("tailbeat", *face.parent.relative_to(ROOT).parts)))
    return found


def exported() -> Iterator[tuple[str, Any]]:
    """Name and object of all that has a docstring of its own."""
    for package in packages():
        module = importlib.import_module(package)
        for name in module.__all__:
            found = getattr(module, name)
            if inspect.isclass(found) or inspect.isfunction(found):
                yield f"{package}.{name}", found
            if inspect.isclass(found):
                for method, function in inspect.getmembers(found, inspect.isroutine):
                    plain = getattr(function, "__func__", function)
                    ours = any(
                        method in vars(c) for c in found.__mro__ if "tailbeat" in c.__module__
                    )
                    if ours and not method.startswith("_"):
                        yield f"{package}.{name}.{method}", plain


def section(doc: str, title: str) -> dict[str, str]:
    """Entries of a section by name, several names of one entry apart; the text below each."""
    heading = re.search(rf"^{title}\n-{{{len(title)}}}\n((?:.|\n)*?)(?=\n\n\w+\n---|\Z)", doc, re.M)
    entries: dict[str, str] = {}
    names: list[str] = []
    for line in heading[1].splitlines() if heading else ():
        if line and not line.startswith(" "):
            names = [name.strip() for name in line.partition(" : ")[0].split(",")]
            entries |= dict.fromkeys(names, "")
        for name in names:
            entries[name] += line.strip() if line.startswith(" ") else ""
    return entries


NAMES = dict(exported())


def test_the_face_is_the_public_interface_and_nothing_else() -> None:
    assert sorted(tailbeat.__all__) == sorted(set(tailbeat.__all__))
    for name in tailbeat.__all__:
        assert getattr(tailbeat, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'Link'"):
        tailbeat.Link  # noqa: B018
    assert isinstance(tailbeat.reference, ModuleType)
    assert (ROOT / "py.typed").is_file()


@pytest.mark.parametrize("name", NAMES)
def test_docstring(name: str) -> None:
    doc = inspect.getdoc(NAMES[name]) or ""
    summary = doc.splitlines()[0] if doc else ""
    assert summary.endswith("."), f"{name}: the first line is a sentence"
    for title in _SECTIONS:
        for entry, text in section(doc, title).items():
            assert text.endswith("."), f"{name}: {title} does not say what {entry} is"


@pytest.mark.parametrize(
    "name", [name for name, found in NAMES.items() if inspect.isfunction(found)]
)
def test_parameters_and_result_are_told(name: str) -> None:
    function = NAMES[name]
    doc, signature = inspect.getdoc(function) or "", inspect.signature(function)
    stars = {inspect.Parameter.VAR_POSITIONAL: "*", inspect.Parameter.VAR_KEYWORD: "**"}
    taken = [
        f"{stars.get(one.kind, '')}{one.name}"
        for one in signature.parameters.values()
        if one.name not in ("self", "cls")
    ]
    assert list(section(doc, "Parameters")) == taken
    gives = signature.return_annotation not in (None, "None")
    if taken and gives:
        assert section(doc, "Returns") or section(doc, "Yields"), f"{name} does not say its result"


@pytest.mark.parametrize(
    "name", [n for n, found in NAMES.items() if dataclasses.is_dataclass(found)]
)
def test_fields_are_told(name: str) -> None:
    doc = inspect.getdoc(NAMES[name]) or ""
    fields = [one.name for one in dataclasses.fields(NAMES[name]) if not one.name.startswith("_")]
    assert list(section(doc, "Attributes")) == fields


def test_the_check_sees_what_is_missing() -> None:
    doc = (
        "Do it.\n\nParameters\n----------\na, b : int\n    Both.\n\nReturns\n-------\nint\n    One."
    )
    assert section(doc, "Parameters") == {"a": "Both.", "b": "Both."}
    assert section(doc, "Returns") == {"int": "One."}
    assert section(doc, "Raises") == {}
