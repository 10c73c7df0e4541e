"""The journal of an experiment: nothing written is lost, whatever ends the writing."""

from __future__ import annotations

import json
import math
import os
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tailbeat.core.errors import InputError
from tailbeat.experiment.store import Journal

NOON = datetime(2026, 5, 4, 12, 0, 0)
# also what no encoding knows (half of a pair) and what looks like a line end to somebody
anything = st.text(st.characters(exclude_categories=()), max_size=30) | st.sampled_from(
    ["\n", "\u2028", "}\n", " #torn", "\x00", "\udc80", '{"what": "decided"}']
)


@given(st.lists(anything, max_size=6))
@settings(max_examples=25, deadline=None)
def test_any_text_comes_back(texts: list[str]) -> None:
    with TemporaryDirectory() as folder:
        journal = Journal(Path(folder) / "journal.jsonl")
        written = [journal.add("note", text=text) for text in texts]
        assert journal.entries() == written
        assert [entry["text"] for entry in journal.entries("note")] == texts


@given(st.lists(anything, min_size=1, max_size=4), st.data())
@settings(max_examples=60, deadline=None)
def test_torn_at_any_byte_loses_the_last_line_at_most(texts: list[str], data: Any) -> None:
    with TemporaryDirectory() as folder:
        journal = Journal(Path(folder) / "journal.jsonl")
        written = [journal.add("note", text=text) for text in texts]
        content = journal.path.read_bytes()
        before = content[:-1].rfind(b"\n") + 1  # begin of the last line
        cut = data.draw(st.integers(before, len(content)))
        whole = written if cut >= len(content) - 1 else written[:-1]
        journal.path.write_bytes(content[:cut] + data.draw(st.sampled_from([b"", b"\0\0"])))
        if journal.path.read_bytes().endswith(b"\0"):
            whole = written if cut == len(content) else written[:-1]
        assert journal.entries() == whole
        torn = journal.path.read_bytes()
        added = [journal.add("note", text="again"), journal.add("note", text="and again")]
        assert journal.entries() == whole + added
        assert journal.path.read_bytes().startswith(torn)  # append-only


def test_a_line_is_on_the_disk_when_add_returns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    write, fsync = os.write, os.fsync
    monkeypatch.setattr(os, "write", lambda *given: (done.append("write"), write(*given))[1])
    monkeypatch.setattr(os, "fsync", lambda *given: (done.append("fsync"), fsync(*given))[1])
    Journal(tmp_path / "journal.jsonl").add("note", text="x")
    assert done[:2] == ["write", "fsync"]
    assert done.count("fsync") == 2  # of the new file's name, too


def test_numbers_that_are_none_become_null(tmp_path: Path) -> None:
    entry = Journal(tmp_path / "j").add("swum", NOON, drift={"speed_m_s": math.nan}, trial=3)
    assert entry["drift"] == {"speed_m_s": None}
    assert datetime.fromisoformat(entry["time"]) == NOON.astimezone()
    assert json.loads((tmp_path / "j").read_text()) == entry


def test_a_full_disk_is_told_and_leaves_no_half_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = Journal(tmp_path / "journal.jsonl")
    journal.add("note", text="first")
    before, write = journal.path.read_bytes(), os.write

    def full(descriptor: int, data: bytes) -> int:
        if len(data) > 10:
            return write(descriptor, data[:10])
        raise OSError(28, "No space left on device")

    calls = iter([full])
    monkeypatch.setattr(os, "write", lambda d, data: next(calls, _refuse)(d, data))
    with pytest.raises(InputError, match=r"No space left.*Make room"):
        journal.add("note", text="second")
    monkeypatch.undo()
    assert journal.path.read_bytes() == before
    journal.add("note", text="third")
    assert [entry["text"] for entry in journal.entries()] == ["first", "third"]


def _refuse(descriptor: int, data: bytes) -> int:
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("bad", ["{", "[]", '{"what": 3, "time": ""}', '{"what": "note"}', "x"])
def test_damage_in_the_middle_is_told(tmp_path: Path, bad: str) -> None:
    journal = Journal(tmp_path / "journal.jsonl")
    journal.add("note", text="first")
    with journal.path.open("a") as file:
        file.write(bad + "\n")
    journal.add("note", text="second")
    with pytest.raises(InputError, match=r"line 2 of .* is damaged"):
        journal.entries()


def test_the_last_decision_counts(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal.jsonl")
    journal.add("decided", trial=3, decision="keep")
    journal.add("decided", trial=4, decision="repeat", reason="noise")
    journal.add("decided", trial=3, decision="discard", reason="bumped")
    assert {n: e["decision"] for n, e in journal.decisions().items()} == {3: "discard", 4: "repeat"}


def test_no_file_is_an_empty_journal(tmp_path: Path) -> None:
    assert Journal(tmp_path / "journal.jsonl").entries() == []
