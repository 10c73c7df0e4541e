"""How the firmware crashed: the record, the places in the source, the command."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import pytest

from tailbeat.app.cli import run
from tailbeat.board.fish import Fish
from tailbeat.board.flash.programs import places
from tailbeat.board.memory import decode_crash
from tailbeat.core import records
from tailbeat.core.errors import InputError
from tailbeat.core.native import ffi, lib
from tailbeat.sim.board import SimBoard, SimTransport

ADDR2LINE = """#!/bin/sh
[ "$4" = tailbeat.elf ] || { echo "what is $4?" >&2; exit 1; }
shift 4
for address; do echo "at_$address at main.c:7"; done
"""


OLD_WORDS = (
    "r0", "r1", "r2", "r3", "r12", "lr", "pc", "xpsr", "sp", "exc_return",
    "cfsr", "hfsr", "mmfar", "bfar", "icsr", "crashes",
)  # fmt: skip


def crash_record(named: dict[str, int] | None = None, **fields: object) -> bytes:
    report = ffi.new("crash_report_t *")
    report.build_id = b"0.1.0-abc"
    for i, (name, value) in enumerate((named or {}).items()):
        report.register_names[i] = name.encode()
        report.crash.registers[i] = value
    for name, value in fields.items():
        setattr(report.crash, name, value)
    out = ffi.new("uint8_t[1024]")
    return bytes(ffi.buffer(out, lib.record_encode_crash(report, out)))


def test_a_crash_says_what_happened() -> None:
    record = crash_record({"cfsr": 1 << 25}, kind=5, pc=0x80124, time_us=1500000, crashes=2)
    report = decode_crash(record)
    assert (report.kind, report.reasons) == ("usage fault", ["division by zero"])
    assert (report.build_id, report.time_s, report.crashes) == ("0.1.0-abc", 1.5, 2)
    assert report.registers == {"pc": 0x80124, "lr": 0, "sp": 0, "cfsr": 1 << 25}
    assert report.stack == []


def test_another_core_names_its_own_registers() -> None:
    report = decode_crash(crash_record({"mcause": 5, "mtval": 12}, kind=4, return_address=8))
    assert report.registers == {"pc": 0, "lr": 8, "sp": 0, "mcause": 5, "mtval": 12}
    assert report.reasons == []


def test_a_record_of_earlier_firmware_gets_the_names() -> None:
    body = struct.pack("<IQ50s48s", 5, 1_500_000, b"0.1.0-old", b"law.c:33")
    words = {name: 100 + i for i, name in enumerate(OLD_WORDS)} | {"cfsr": 1 << 25}
    body += struct.pack("<18I", *words.values(), 7, 8)
    begin = b"TBCR" + struct.pack("<HH", 1, 2)
    crc = records.crc32(body, records.crc32(begin))
    report = decode_crash(begin + struct.pack("<I", crc) + body)
    assert (report.kind, report.where, report.build_id) == ("usage fault", "law.c:33", "0.1.0-old")
    assert (report.crashes, report.reasons, report.stack) == (115, ["division by zero"], [7, 8])
    del words["crashes"]
    words["exc_ret"] = words.pop("exc_return")
    assert report.registers == words


def test_a_crash_record_has_the_documented_layout() -> None:
    record = crash_record(
        {"a0": 0x11}, kind=1, where=b"law.c:33", time_us=7, crashes=3, pc=4, return_address=8,
        sp=12, stack_words=2, stack=[5, 6],
    )  # fmt: skip
    assert record[:6] == b"TBCR\2\0"
    assert int.from_bytes(record[6:8], "little") == 2
    assert record[12:16] == b"\1\0\0\0"
    assert record[24:33] == b"0.1.0-abc"
    assert record[74:82] == b"law.c:33"
    assert record[122:150] == struct.pack("<4I8sI", 3, 4, 8, 12, b"a0", 0x11)
    assert record[150:282] == bytes(11 * 12)
    assert record[282:] == bytes([5, 0, 0, 0, 6, 0, 0, 0])


def test_a_damaged_crash_record_is_refused() -> None:
    record = bytearray(crash_record(kind=2))
    record[40] ^= 1
    with pytest.raises(InputError, match="not a sound crash record"):
        decode_crash(bytes(record))
    for at in (73, 121, 145):  # the ends of the build's id, of the place and of a name
        record = bytearray(crash_record(kind=2))
        record[at] = 65
        record[8:12] = struct.pack("<I", records.crc32(record[12:], records.crc32(record[:8])))
        with pytest.raises(InputError, match="not a sound crash record"):
            decode_crash(bytes(record))


@pytest.fixture
def elf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An image of the build that crashed, and a fake of the program that knows its places."""
    program = tmp_path / "bin" / "arm-none-eabi-addr2line"
    program.parent.mkdir()
    program.write_text(ADDR2LINE)
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:/usr/bin:/bin")
    monkeypatch.chdir(tmp_path)
    Path("tailbeat.elf").write_bytes(b"\x7fELF tailbeat build id: 0.1.0-abc\0")
    return Path("tailbeat.elf")


def test_places_in_the_source(elf: Path) -> None:
    report = decode_crash(crash_record(kind=2, pc=0x80124, return_address=0x80201))
    assert places(report, elf) == [
        "pc: at_0x80124 at main.c:7", "lr: at_0x80200 at main.c:7",
    ]  # fmt: skip


def test_places_that_cannot_be_told(elf: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    report = decode_crash(crash_record(kind=2))
    other = Path("other.elf")
    with pytest.raises(InputError, match=r"cannot read the image other\.elf"):
        places(report, other)
    other.write_bytes(elf.read_bytes().replace(b"abc", b"xyz"))
    with pytest.raises(InputError, match=r"is of build 0\.1\.0-xyz, but 0\.1\.0-abc crashed"):
        places(report, other)
    other.write_bytes(elf.read_bytes())
    with pytest.raises(InputError, match=r"tells no places: what is other\.elf\?"):
        places(report, other)
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(InputError, match="apt-get install binutils-arm-none-eabi"):
        places(report, elf)


def test_the_command(
    elf: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    board = SimBoard("tank")
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: SimTransport(board))
    words = ["board", "crash", "--connect", "the board"]
    assert run(words) == 0
    assert capsys.readouterr().out == "no crash on record\n"
    assert run([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"crash": None}

    record = crash_record(
        kind=1, where=b"law.c:33", time_us=2500, pc=0x80124, stack_words=9, stack=list(range(9))
    )
    monkeypatch.setattr(Fish, "crash_record", lambda self: record)
    assert run([*words, "--elf", str(elf)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:2] == [
        "assertion, law.c:33, 0.003 s after its start, firmware 0.1.0-abc",
        "pc: at_0x80124 at main.c:7",
    ]
    assert lines[3] == "pc         00080124  lr         00000000  sp         00000000"
    assert lines[-1] == "stack  00000008"
    assert run([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["crash"]
    assert (found["kind"], found["registers"]["pc"], found["places"]) == ("assertion", 0x80124, [])
