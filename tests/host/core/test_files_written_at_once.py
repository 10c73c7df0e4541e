"""Several processes that write one file: none fails, none is half-written, nothing is lost."""

from __future__ import annotations

import os
import signal
import stat
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

from tailbeat.core.errors import InputError
from tailbeat.core.files import WRITE_LOCK, locked, replacing, replacing_text, write_whole
from tailbeat.core.records import crc32
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import TrialLibrary
from tailbeat.experiment.store import Journal
from tailbeat.link.ftp.download import PartFile
from tailbeat.link.keystore import KeyStore, new_key

WRITERS = 3
ROUNDS = 60
FISH = "00112233445566778899aabbccddeeff"
DATA = bytes(range(256)) * 200


def _together(work: Callable[[Path, int], None], folder: Path) -> None:
    """Each writer in a process of its own; an exception of any is raised."""
    with ProcessPoolExecutor(WRITERS) as pool:
        list(pool.map(work, [folder] * WRITERS, range(WRITERS)))


def _text_of(writer: int) -> str:
    return f"{writer}\n" * 5000


def _write_many(folder: Path, writer: int) -> None:
    for _ in range(ROUNDS):
        write_whole(folder / "file", _text_of(writer))
        assert (folder / "file").read_text() in map(_text_of, range(WRITERS))


def test_writers_of_one_file_do_not_meet(tmp_path: Path) -> None:
    _together(_write_many, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def _change_many(folder: Path, writer: int) -> None:
    experiment, book = Experiment.open(folder / "experiment"), TrialLibrary.of(FISH, folder)
    for count in range(ROUNDS // 3):
        experiment.write_settings({f"{writer}.{count}": count})
        experiment.note(f"note {writer}.{count}")
        experiment.add_raw(f"{writer}.{count}.bin", b"x")
        experiment.keep_raw("same.bin", f"{writer}.{count}".encode())
        book.name_reference(100 * writer + count, "x")


def test_whatever_is_read_changed_and_written_keeps_all_changes(tmp_path: Path) -> None:
    experiment = Experiment.at(tmp_path / "experiment", "f", "r", "l")
    _together(_change_many, tmp_path)
    done = [(writer, count) for writer in range(WRITERS) for count in range(ROUNDS // 3)]
    settings, notes, sums = experiment.settings(), experiment.notes(), experiment.sums()
    book = TrialLibrary.of(FISH, tmp_path)
    assert [settings.get(f"{w}.{c}") for w, c in done] == [c for _, c in done]
    assert [notes.count(f" note {w}.{c}\n") for w, c in done] == [1] * len(done)
    assert {f"{w}.{c}.bin" for w, c in done} <= set(sums)
    assert [book.reference_name(100 * w + c) for w, c in done] == ["x"] * len(done)
    kept = {path.read_text() for path in experiment.raw.glob("same*")}
    assert kept == {f"{w}.{c}" for w, c in done}
    assert len(experiment.journal.entries("note")) == len(done)
    assert experiment.raw_problems() == []


def _log_many(folder: Path, writer: int) -> None:
    for count in range(ROUNDS):
        Journal(folder / "journal.jsonl").add("note", text=f"{writer}.{count} " + "x" * 9000)


def test_lines_of_a_journal_do_not_mix(tmp_path: Path) -> None:
    _together(_log_many, tmp_path)
    path = tmp_path / "journal.jsonl"
    assert len(Journal(path).entries("note")) == WRITERS * ROUNDS
    assert b"#torn" not in path.read_bytes()


def _sign_many(folder: Path, writer: int) -> None:
    store = KeyStore(folder)
    (key,) = store.usable()
    for count in range(ROUNDS):
        store.note(key, WRITERS * count + writer, 1)
        assert store.usable()[0].used >= WRITERS * count + writer


def test_the_time_of_a_key_never_goes_back(tmp_path: Path) -> None:
    KeyStore(tmp_path).save(new_key(FISH))
    _together(_sign_many, tmp_path)
    (key,) = KeyStore(tmp_path).usable()
    assert key.used == WRITERS * ROUNDS - 1
    (path,) = tmp_path.glob("*.json")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


@pytest.mark.parametrize("content", [b"new", "new ä"])
def test_a_failure_leaves_what_was_there(tmp_path: Path, content: str | bytes) -> None:
    path = tmp_path / "file"
    write_whole(path, "old")
    with pytest.raises(RuntimeError), replacing(path) as file:
        file.write(b"new")
        raise RuntimeError
    with pytest.raises(ValueError, match="no"), replacing_text(path) as text:
        text.write("new")
        raise ValueError("no")
    assert path.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    write_whole(path, content)
    assert path.read_bytes() == (content.encode() if isinstance(content, str) else content)


def test_a_long_name_and_a_pipe_are_written(tmp_path: Path) -> None:
    longest = tmp_path / ("ä" * 125 + ".json")
    write_whole(longest, "x")
    assert longest.read_text() == "x"
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_whole(pipe, "x")
    assert os.read(reader, 9) == b"x"
    os.close(reader)
    assert stat.S_ISFIFO(pipe.stat().st_mode)  # as /dev/null: what it is must not change


def test_a_lock_that_is_never_returned_is_told(tmp_path: Path) -> None:
    """And one whose process was killed is free."""
    read, write = os.pipe()
    if (child := os.fork()) == 0:
        with locked(tmp_path):
            os.write(write, b"x")
            signal.pause()
    os.read(read, 1)
    told = pytest.raises(InputError, match=r"another program has held .* end it")
    try:
        with told, locked(tmp_path, wait_s=0.0):
            pass
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    with locked(tmp_path), locked(tmp_path, wait_s=0.0):
        assert [path.name for path in tmp_path.iterdir()] == [WRITE_LOCK]
    os.close(read)
    os.close(write)


def test_a_folder_without_locks_is_used_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_locks(descriptor: int, how: int) -> None:
        raise OSError(95, "not supported")

    monkeypatch.setattr("fcntl.flock", no_locks)
    with locked(tmp_path, wait_s=0.0):
        pass


def _fetch(local: Path, stop_at: int = len(DATA)) -> PartFile:
    part = PartFile(local, "/trials/0001.ulg", crc32(DATA))
    part.begin(len(DATA))
    while len(part.data) < stop_at:
        piece = DATA[len(part.data) :][:1000]
        part.data += piece
        part.append(piece)
    return part


def test_two_that_fetch_one_file_do_not_meet(tmp_path: Path) -> None:
    local = tmp_path / "0001.ulg"
    first, second = _fetch(local, 20_000), _fetch(local, 10_000)
    second.close()  # broken off; the first goes on
    third = _fetch(local)
    third.finish()
    assert local.read_bytes() == DATA
    first.close()
    again = _fetch(local)
    assert len(again.data) == len(DATA)
    again.finish()
    assert local.read_bytes() == DATA
    assert [path.name for path in tmp_path.iterdir()] == ["0001.ulg"]


def test_what_cannot_be_written_has_the_name_that_was_given(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as found, replacing(tmp_path / "none" / "x.csv"):
        pass
    assert found.value.filename == str(tmp_path / "none" / "x.csv")
