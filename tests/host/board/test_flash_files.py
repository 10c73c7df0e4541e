"""Flashing: the image and the backup on disk."""

from __future__ import annotations

import json
import struct
from datetime import datetime
from pathlib import Path

import pytest

from tailbeat.board.flash.programs import Image
from tailbeat.board.snapshot import Snapshot, new_folder
from tailbeat.core import native
from tailbeat.core.errors import InputError
from tailbeat.core.image import image_remedy
from tailbeat.core.native import ffi, lib

BUILD_ID = b"0.1.0-v3-14-ge16d899-dirty"
MARKED = b"tailbeat build id: " + BUILD_ID + b"\0"


def image(path: Path, stack: int = 0x20088000, entry: int = 0x80011, rest: bytes = MARKED) -> Path:
    path.write_bytes(struct.pack("<II", stack, entry) + bytes(64) + rest)
    return path


def test_an_image(tmp_path: Path) -> None:
    found = Image.load(image(tmp_path / "a.bin"))
    assert found.build_id == BUILD_ID.decode()
    assert found.size_bytes == 72 + len(MARKED)
    assert found.is_build(BUILD_ID.decode())
    assert not found.is_build(BUILD_ID.decode().removesuffix("-dirty"))
    assert not found.is_build("")


def test_a_long_id_is_cut_on_the_wire(tmp_path: Path) -> None:
    long = "0.1.0-" + "x" * 43
    found = Image.load(image(tmp_path / "a.bin", rest=MARKED.replace(BUILD_ID, long.encode())))
    assert found.build_id == long
    assert found.is_build(long[:40])  # a STATUSTEXT of 49 characters begins with "tailbeat "
    assert not found.is_build(long[:39])


def test_the_firmware_carries_its_id_as_the_tool_looks_for_it(tmp_path: Path) -> None:
    library = next(native.HERE.glob("*tailbeat_native*.so"), None)
    if library is None:
        pytest.skip("the native library has another name here")
    content = library.read_bytes()
    at = content.index(b"tailbeat build id: ")
    path = image(tmp_path / "a.bin", rest=content[at - 100 : at + 100])
    assert Image.load(path).build_id == ffi.string(lib.link_build_id()).decode()


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ({"stack": 0}, "its stack would begin at 0x0, which is not RAM"),
        ({"stack": 0x20088004}, "its stack would begin at 0x20088004, which is not RAM"),
        ({"entry": 0x80010}, "it would start at 0x80010, which is not in it"),
        ({"entry": 0x81001}, "it would start at 0x81001, which is not in it"),
        ({"rest": bytes(262144)}, "its 262216 bytes do not fit into the 262144 of flash bank 0"),
    ],
)
def test_what_is_no_image(tmp_path: Path, values: dict[str, int], problem: str) -> None:
    path = image(tmp_path / "a.bin", **values)  # type: ignore[arg-type]
    with pytest.raises(InputError) as refused:
        Image.load(path)
    assert str(refused.value) == (f"{path} is no image for the board: {problem}. {image_remedy()}")


def test_an_elf_by_mistake(tmp_path: Path) -> None:
    path = tmp_path / "tailbeat.elf"
    path.write_bytes(b"\x7fELF" + bytes(60) + MARKED)
    with pytest.raises(InputError, match=r"it is an ELF file; give the \.bin beside it"):
        Image.load(path)


@pytest.mark.parametrize("rest", [b"", MARKED + MARKED.replace(b"v3", b"v4"), MARKED[:-1]])
def test_an_image_without_one_id(tmp_path: Path, rest: bytes) -> None:
    with pytest.raises(InputError, match="does not say which build"):
        Image.load(image(tmp_path / "a.bin", rest=rest))


def test_debug_information_does_not_confuse(tmp_path: Path) -> None:
    macro = b'MARKER "tailbeat build id: "\0'
    path = image(tmp_path / "a.bin", rest=MARKED + MARKED + macro)
    assert Image.load(path).build_id == BUILD_ID.decode()


def backup(**changes: object) -> Snapshot:
    values: dict[str, object] = {
        "unique_id": "73696d2d66697368",
        "build_id": "0.1.0",
        "params": {"ILC_GAIN": 4.599999904632568, "SERVO_DIR": -1.0},
        "next_trial": 3,
        "reference": b"r" * 40,
        "learned": b"a",
    }
    return Snapshot(**(values | changes))  # type: ignore[arg-type]


def test_a_backup_comes_back_as_it_was(tmp_path: Path) -> None:
    for number, kept in enumerate((backup(), backup(crash=b"c", reference=None))):
        kept.write(tmp_path / str(number))
        assert Snapshot.read(tmp_path / str(number)) == kept
    assert {path.name for path in (tmp_path / "0").iterdir()} == {
        "board.json", "learned.bin", "reference.bin",
    }  # fmt: skip


def test_a_disk_that_forgets_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tailbeat.board.snapshot.replace_file", lambda path, _: path.touch())
    with pytest.raises(InputError):
        backup().write(tmp_path)


def test_backups_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot read .*board.json \(No such file"):
        Snapshot.read(tmp_path)
    backup().write(tmp_path)
    document = json.loads((tmp_path / "board.json").read_text())
    for damage in ({"format": "tailbeat backup 9"}, {"params": 3}, {"next_trial": None}):
        (tmp_path / "board.json").write_text(json.dumps(document | damage))
        with pytest.raises(InputError, match="is damaged"):
            Snapshot.read(tmp_path)
    (tmp_path / "board.json").write_text("{")
    with pytest.raises(InputError, match="is damaged"):
        Snapshot.read(tmp_path)
    backup().write(tmp_path)
    (tmp_path / "learned.bin").unlink()
    with pytest.raises(InputError, match=r"cannot read .*learned.bin"):
        Snapshot.read(tmp_path)


def test_a_new_folder_for_every_backup(tmp_path: Path) -> None:
    now = datetime(2026, 5, 4, 15, 30, 12)
    names = [new_folder(tmp_path / "b", "0123456789", now).name for _ in range(3)]
    stem = "2026-05-04_153012_01234567"
    assert names == [stem, f"{stem}_2", f"{stem}_3"]
