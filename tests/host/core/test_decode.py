"""User files are decoded strictly, and errors say where, what is wrong and what to do."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import pytest

from tailbeat.core import decode
from tailbeat.core.arrays import F32, F64
from tailbeat.core.errors import InputError


class Law(decode.StrictTable):
    """One table in a list."""

    name: str
    gain: Annotated[float, msgspec.Meta(ge=0)] = 4.0
    beats: decode.Whole = decode.Whole(1)


class Recipe(decode.StrictTable):
    """The whole document."""

    law: tuple[Law, ...] = ()
    best: Law | None = None


@dataclass(frozen=True)
class Held:
    """A dataclass with what JSON does not know."""

    key: decode.Hex
    speeds: F64
    kind: Literal["a", "b"] = "a"
    more: dict[str, float] = field(default_factory=dict)
    single: F32 | None = None


def test_a_toml_file(tmp_path: Path) -> None:
    path = tmp_path / "recipe.toml"
    path.write_text("[[law]]\nname = 'p'\ngain = 2\nbeats = 3.0\n[best]\nname = 'q'\n")
    found = decode.read(path, Recipe, "Mend it.")
    assert found == Recipe(
        law=(Law(name="p", gain=2.0, beats=decode.Whole(3)),), best=Law(name="q")
    )


def test_a_json_file(tmp_path: Path) -> None:
    path = tmp_path / "held.json"
    path.write_text('{"key": "00ff", "speeds": [[1, null], [2.5, 3]], "single": [1], "extra": 1}')
    found = decode.read(path, Held, "Mend it.")
    assert (found.key, found.kind, found.more) == (b"\x00\xff", "a", {})
    assert found.speeds.dtype == np.float64
    assert found.single is not None
    assert found.single.dtype == np.float32
    np.testing.assert_array_equal(found.speeds, [[1, math.nan], [2.5, 3]])


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"law": [{"gain": 1}]}, "x: law[0]: no name"),
        ({"law": [{"name": 1}]}, "x: law[0].name: expected a text, got a whole number"),
        ({"law": [{"name": "p", "gain": "4"}]}, "x: law[0].gain: expected a number, got a text"),
        ({"law": [{"name": "p", "gain": -1}]}, "x: law[0].gain: expected a number >= 0.0"),
        ({"law": [{"name": "p", "beats": 1.5}]}, "x: law[0].beats: expected a whole number"),
        ({"law": [{"name": "p", "beats": True}]}, "x: law[0].beats: expected a whole number"),
        ({"law": 3}, "x: law: expected a list, got a whole number"),
    ],
)
def test_what_is_wrong_and_where(change: dict[str, Any], problem: str) -> None:
    with pytest.raises(InputError) as caught:
        decode.convert(change, Recipe, "x", "Mend it.")
    assert (caught.value.message, caught.value.remedy) == (problem, "Mend it.")


@pytest.mark.parametrize(
    ("document", "place", "known"),
    [
        ({"lwa": []}, "x: unknown key lwa", "Did you mean law? Known are law, best."),
        ({"law": [{"name": "p", "g": 1}]}, "x: law[0]: unknown key g", "Known are name, gain"),
        ({"best": {"name": "p", "g": 1}}, "x: best: unknown key g", "Known are name, gain"),
    ],
)
def test_an_unknown_key_names_the_known(document: dict[str, Any], place: str, known: str) -> None:
    with pytest.raises(InputError) as caught:
        decode.convert(document, Recipe, "x", "Mend it.")
    assert caught.value.message == place
    assert caught.value.remedy.startswith(known)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"key": "0g"}, "key: non-hexadecimal"),
        ({"key": 3}, "key: expected hexadecimal digits"),
        ({"speeds": ["1"]}, "speeds: expected a list of numbers"),
        ({"speeds": [[1], [1, 2]]}, "speeds: expected a list of numbers"),
        ({"speeds": [True]}, "speeds: expected a list of numbers"),
        ({"kind": "c"}, "kind: unknown value 'c'"),
        ({"more": {"gain": "4"}}, "more: expected a number, got a text"),
    ],
)
def test_types_that_json_does_not_know(change: dict[str, Any], problem: str) -> None:
    document = {"key": "", "speeds": []} | change
    with pytest.raises(InputError, match=problem):
        decode.convert(document, Held, "x", "Mend it.")


@pytest.mark.parametrize("content", [b"", b"{", b"\xff", b"[" * 100_000])
def test_content_that_is_no_document(content: bytes) -> None:
    with pytest.raises(InputError, match="x: ") as caught:
        decode.decode(content, dict, "x", "Mend it.")
    assert caught.value.remedy == "Mend it."


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot read .*none.json \(No such file"):
        decode.read(tmp_path / "none.json", dict, "Mend it.")
    with (tmp_path / "long.json").open("wb") as file:
        file.truncate(decode.BYTES_MAX + 1)
    with pytest.raises(InputError, match="too long"):
        decode.read(tmp_path / "long.json", dict, "Mend it.")


def test_keys_of_older_files() -> None:
    def prepare(document: dict[str, Any]) -> dict[str, Any]:
        return {"best" if key == "champion" else key: value for key, value in document.items()}

    old = {"champion": {"name": "p"}}
    assert decode.convert(old, Recipe, "x", "", prepare=prepare) == Recipe(best=Law(name="p"))
    with pytest.raises(InputError, match="x: "):
        decode.convert(3, Recipe, "x", "Mend it.", prepare=prepare)
