"""Streams of a VN-100: recordings against values that others computed, and what is told of them."""

from __future__ import annotations

import binascii
import csv
import json
import math
import os
import re
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.app.cli import run
from tailbeat.core.faults import all_problems, problem_info
from tailbeat.core.imu_fields import ASCII, BINARY
from tailbeat.core.native import ffi, lib
from tailbeat.sensors.vn100 import decode
from tailbeat.sensors.vn100.decode import AsciiLine, Binary, Message, Reader
from tailbeat.sensors.vn100.summary import StreamSummary

ROOT = Path(__file__).resolve().parents[4]
RECORDINGS = Path(os.environ.get("TAILBEAT_RECORDINGS", ROOT.parent / "shared/data/vn100"))

needs_recordings = pytest.mark.skipif(
    not (RECORDINGS / "expected.json").is_file(),
    reason=f"no recordings in {RECORDINGS}; name their folder in TAILBEAT_RECORDINGS",
)

FISH_HEADER = bytes.fromhex("FA1129014000")


FILES = ("F00294", "DataExportFromFile.bin", "chase520-log.bin")
EVERYTHING = 1 << 30

# What the expected values are called there.
NAMES = {
    "timeStartup_ns": ["time_startup_ns"],
    "uncompMag": ["uncomp_mag_x_gauss", "uncomp_mag_y_gauss", "uncomp_mag_z_gauss"],
    "uncompAccel": ["uncomp_accel_x_m_s2", "uncomp_accel_y_m_s2", "uncomp_accel_z_m_s2"],
    "uncompGyro": ["uncomp_rate_x_rad_s", "uncomp_rate_y_rad_s", "uncomp_rate_z_rad_s"],
    "temp": ["temp_c"],
    "pres": ["pres_kpa"],
    "ypr_deg": ["yaw_deg", "pitch_deg", "roll_deg"],
    "yprU": ["yaw_sigma_deg", "pitch_sigma_deg", "roll_sigma_deg"],
    "dcm": [f"dcm_{row}{column}" for column in "123" for row in "123"],
    "magNed": ["mag_north_gauss", "mag_east_gauss", "mag_down_gauss"],
    "accelNed": ["accel_north_m_s2", "accel_east_m_s2", "accel_down_m_s2"],
}


def sealed(frame: bytes) -> bytes:
    """A binary frame, from its sync byte on, with its CRC."""
    return frame + struct.pack(">H", binascii.crc_hqx(frame[1:], 0))


def line(body: str, end: str = "\r\n") -> bytes:
    """An ASCII line with its 8-bit check."""
    check = 0
    for byte in body.encode():
        check ^= byte
    return f"${body}*{check:02X}{end}".encode()


def fish_frame(time_ns: int, yaw_deg: float = 10.0) -> bytes:
    """The 64-byte frame the fish uses."""
    values = (yaw_deg, -2.5, 0.75, 0.01, -0.02, 0.5, -0.4, -0.4, -9.8, 0.016, -0.25, 0.004)
    return sealed(FISH_HEADER + struct.pack("<Q12f", time_ns, *values))


def timed_frames(times_ms: list[float]) -> bytes:
    """Frames with these sensor times."""
    return b"".join(fish_frame(round(t * 1e6)) for t in times_ms)


def expected(name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((RECORDINGS / "expected.json").read_text())[name]
    return found


def read(data: bytes, chunk: int = EVERYTHING) -> tuple[list[Message], Reader]:
    reader = Reader()
    chunks = (data[at : at + chunk] for at in range(0, len(data), chunk))
    return list(decode(chunks, reader)), reader


def document(data: bytes, chunk: int = EVERYTHING) -> dict[str, Any]:
    messages, reader = read(data, chunk)
    summary = StreamSummary()
    for message in messages:
        summary.add(message)
    return summary.document(reader.counters, reader.bytes)


@needs_recordings
@pytest.mark.parametrize("chunk", [1, 7, 64, EVERYTHING])
@pytest.mark.parametrize("name", FILES)
def test_counts_and_chains_of_recordings(name: str, chunk: int) -> None:
    want = expected(name)
    found = document((RECORDINGS / name).read_bytes(), chunk)
    assert found["bytes"] == want["bytes"]
    assert found["binary_valid"] == want["binary_ok"]
    assert found["ascii_valid"] == want["ascii_ok"]
    assert found["crc_failed"] == want["fa_candidates_crc_fail"]
    assert found["checksum_failed"] == want["ascii_bad_checksum"]
    assert found["skipped_bytes"] == want["skipped_bytes"]
    assert found["headers"] == want["headers"]
    assert found["ascii_types"] == want["ascii_types"]
    assert found["crc_chain"] == want.get("crc_chain")
    assert found["ascii_ck_chain"] == want.get("ascii_ck_chain")


@needs_recordings
@pytest.mark.parametrize("name", FILES)
def test_first_and_last_messages(name: str) -> None:
    want = expected(name)
    messages, _ = read((RECORDINGS / name).read_bytes(), 7)
    frames = [m for m in messages if isinstance(m, Binary)]
    lines = [m for m in messages if isinstance(m, AsciiLine)]
    for key, index in (("first_ascii", 0), ("last_ascii", -1)):
        if key in want:
            assert lines[index].offset == want[key]["offset"]
            assert lines[index].data.strip().decode() == want[key]["line"]
    for key, index in (("first_binary", 0), ("last_binary", -1)):
        if key in want:
            same_frame(frames[index], want[key])


def same_frame(frame: Binary, want: dict[str, Any]) -> None:
    assert (frame.offset, len(frame.data)) == (want["offset"], want["len"])
    assert f"{frame.check:04x}" == want["crc"]
    values = {k: v for k, v in want.items() if k not in ("offset", "len", "crc")}
    told = [name for key in values for name in NAMES[key]]
    assert sorted(told) == sorted(frame.values)
    for key, value in values.items():
        found = [frame.values[name] for name in NAMES[key]]
        np.testing.assert_array_equal(np.float32(found), np.float32(np.atleast_1d(value)))
        if key == "timeStartup_ns":
            assert found == [value]


@needs_recordings
def test_every_row_of_another_decoder() -> None:
    with (RECORDINGS / "F00294_B.parsed.csv").open() as file:
        rows = list(csv.reader(file, skipinitialspace=True))
    header = [name for name in rows[0] if name]
    order = ("uncompMag", "uncompAccel", "uncompGyro", "temp", "pres", "ypr_deg", "dcm", "magNed")
    names = [name for key in (*order, "accelNed") for name in NAMES[key]]
    assert (header[0], header[9:12], header[14], len(header)) == (
        "MagX", ["Temp", "Pres", "Yaw"], "DCM1", len(names),
    )  # fmt: skip
    messages, _ = read((RECORDINGS / "F00294").read_bytes())
    theirs = np.array([[float(cell) for cell in row if cell] for row in rows[1:]])
    ours = np.array([[message.values[name] for name in names] for message in messages])
    assert theirs.shape == (98, 29)
    # Theirs has lost the frame at byte 11754, which its logger wrote right behind the one before.
    assert [m.offset for m in messages].index(11754) == 78
    np.testing.assert_allclose(np.delete(ours, 78, axis=0), theirs, rtol=5.1e-7)  # seven digits


@needs_recordings
def test_the_matrix_is_that_of_the_angles() -> None:
    messages, _ = read((RECORDINGS / "F00294").read_bytes())
    for message in messages:
        yaw, pitch, roll = (math.radians(message.values[name]) for name in NAMES["ypr_deg"])
        first_row = [math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw)]
        found = [message.values[f"dcm_1{column}"] for column in "123"]
        np.testing.assert_allclose(found, [*first_row, -math.sin(pitch)], atol=1e-6)
        np.testing.assert_allclose(
            message.values["dcm_23"], math.cos(pitch) * math.sin(roll), atol=1e-6
        )


def vectors() -> list[dict[str, str]]:
    path = RECORDINGS / "vectors.tsv"
    if not path.is_file():
        return []
    with path.open() as file:
        return list(csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE))


@needs_recordings
def test_there_are_28_vectors() -> None:
    assert len(vectors()) == 28


@pytest.mark.parametrize("chunk", [1, EVERYTHING])
@pytest.mark.parametrize("vector", vectors(), ids=lambda v: v["id"])
def test_vectors(vector: dict[str, str], chunk: int) -> None:
    binary = vector["kind"] == "bin"
    content = vector["content"]
    data = bytes.fromhex(content) if binary else content.encode() + b"\r\n"
    messages, reader = read(data, chunk)
    if vector["valid"] == "no":
        assert messages == []
        assert reader.counters.skipped_bytes == len(data)
        return
    assert [m.data for m in messages] == [data]
    assert isinstance(messages[0], Binary if binary else AsciiLine)
    if binary:
        same_values(messages[0], vector["expected"])
    else:
        same_line(messages[0], content, vector)


# Labels of vectors.tsv; "as above" is syn-52's.
LABELS = {
    r"YPR": NAMES["ypr_deg"],
    r"YprU": NAMES["yprU"],
    r"rate": ["rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s"],
    r"[Aa]ccel": ["accel_x_m_s2", "accel_y_m_s2", "accel_z_m_s2"],
    r"mag": ["mag_x_gauss", "mag_y_gauss", "mag_z_gauss"],
    r"UncompMag": NAMES["uncompMag"],
    r"UncompAccel": NAMES["uncompAccel"],
    r"UncompGyro": NAMES["uncompGyro"],
    r"LinAccelBody": ["linear_accel_x_m_s2", "linear_accel_y_m_s2", "linear_accel_z_m_s2"],
    r"temp": ["temp_c"],
    r"pres": ["pres_kpa"],
    r"(?:Time\.)?(?:TimeStartup |t=|TimeStartup)": ["time_startup_ns"],
}


def same_values(frame: Message, text: str) -> None:
    if "as above plus Accel" in text:
        above = next(v for v in vectors() if v["id"] == "syn-52")["expected"]
        text = above.replace("52 B", "64 B") + "; Accel -0.4115 -0.3783 -9.7934"
    size = re.match(r"(\d+) B", text)
    assert size is None or int(size[1]) == len(frame.data)
    told = 0
    for label, names in LABELS.items():
        found = re.search(rf"(?<![A-Za-z]){label} ?=? ?((?:-?[.\d]+(?:e-?\d+)?,? ?)+)", text)
        if found is None:
            continue
        numbers = [float(n) for n in re.split(r"[ ,]+", found[1].strip(" ,"))]
        assert len(numbers) == len(names), label
        ours = [frame.values[name] for name in names]
        digits = 10 if names[0] == "time_startup_ns" else 4
        np.testing.assert_allclose(ours, numbers, rtol=0.51 * 10.0**-digits, err_msg=label)
        told += len(names)
    assert told >= 3
    assert told == len(frame.values)


def same_line(message: Message, content: str, vector: dict[str, str]) -> None:
    assert isinstance(message, AsciiLine)
    body, _, check = content[1:].partition("*")
    assert message.fields == tuple(body.split(","))
    assert message.check == int(check, 16)
    assert message.check_bits == (16 if vector["kind"] == "ascii16" else 8)
    numbers = [f for f in message.fields[1:] if f[0] not in "TS"]
    if message.type in ASCII:
        assert [*message.values.values()][: len(numbers)] == [float(f) for f in numbers]
        assert len(message.values) == len(message.fields) - 1
    suffixes = {f[0]: f[1:] for f in message.fields if re.fullmatch("[TS][0-9A-F]+", f)}
    assert message.values.get("serial_count") == (int(suffixes["T"]) if "T" in suffixes else None)
    assert message.values.get("vpe_status") == (int(suffixes["S"], 16) if "S" in suffixes else None)
    assert message.error == {"err-hex": 12, "err-dec": 12, "err-03": 3}.get(vector["id"], 0)


def test_names_fit_the_sizes_of_all_fields() -> None:
    total = ffi.new("uint16_t *")
    for group in range(8):
        for bit in range(16):
            header = bytes([0xFA, 1 << group, *(1 << bit).to_bytes(2, "little")])
            known = lib.imu_layout_header(header, len(header), total) == lib.IMU_HEADER_COMPLETE
            field = BINARY.get((group, bit))
            assert known == (field is not None), (group, bit)
            if field is not None:
                assert field.layout.size == total[0] - 6, (group, bit)
                values = len(field.layout.unpack(bytes(field.layout.size)))
                assert values == len(field.names) == len(set(field.names)), (group, bit)


def test_a_frame_of_all_fields() -> None:
    words = {group: sum(1 << bit for g, bit in BINARY if g == group) for group in (0, 1, 2, 4)}
    header = bytes([0xFA, 0x17]) + b"".join(w.to_bytes(2, "little") for w in words.values())
    payload = b""
    want: list[float | int] = []
    for number, (_, field) in enumerate(sorted(BINARY.items())):
        values = field.layout.unpack(struct.pack("<B", number + 1) * field.layout.size)
        want += values
        payload += field.layout.pack(*values)
    (message,), _ = read(sealed(header + payload))
    assert isinstance(message, Binary)
    assert [*message.values.values()] == want
    assert message.values["time_startup_ns"] == 0x0101010101010101
    assert message.values["time_time_startup_ns"] == 0x1010101010101010
    assert "imu_accel_x_m_s2" in message.values
    assert "attitude_yaw_deg" in message.values


@pytest.mark.parametrize("kind", ASCII)
def test_every_ascii_type(kind: str) -> None:
    names = ASCII[kind]
    numbers = [f"{(-1) ** i * (i + 0.125 * i):+08.3f}" for i in range(len(names))]
    body = ",".join([kind, *numbers])
    (plain, both, short, long, odd), _ = read(
        line(body)
        + line(f"{body},T0000000543,S00A1", end="\n")
        + line(body.rpartition(",")[0])
        + line(f"{body},+1.0")
        + line(body.replace(numbers[-1], "nan"))
    )
    assert plain.values == {n: float(t) for n, t in zip(names, numbers, strict=True)}
    assert both.values == plain.values | {"serial_count": 543, "vpe_status": 0xA1}
    assert (plain.kind, both.kind) == (kind, kind + "TS")
    assert short.values == long.values == odd.values == {}


@pytest.mark.parametrize(
    ("kind", "columns"),
    [
        ("VNQTN", "quat_x quat_y quat_z quat_w"),
        ("VNYMR", "yaw_deg pitch_deg roll_deg mag_x_gauss mag_y_gauss mag_z_gauss accel_x_m_s2"),
        ("VNQMR", "quat_x quat_y quat_z quat_w mag_x_gauss mag_y_gauss mag_z_gauss accel_x_m_s2"),
        ("VNMAR", "mag_x_gauss mag_y_gauss mag_z_gauss accel_x_m_s2 accel_y_m_s2 accel_z_m_s2"),
        ("VNYBA", "yaw_deg pitch_deg roll_deg linear_accel_x_m_s2 linear_accel_y_m_s2"),
        ("VNYIA", "yaw_deg pitch_deg roll_deg linear_accel_north_m_s2 linear_accel_east_m_s2"),
        ("VNIMU", "uncomp_mag_x_gauss uncomp_mag_y_gauss uncomp_mag_z_gauss uncomp_accel_x_m_s2"),
        ("VNDTV", "delta_time_s delta_theta_x_deg delta_theta_y_deg delta_theta_z_deg"),
        ("VNMAG", "mag_x_gauss"),
        ("VNACC", "accel_x_m_s2"),
        ("VNGYR", "rate_x_rad_s rate_y_rad_s rate_z_rad_s"),
    ],
)
def test_columns_of_ascii_types(kind: str, columns: str) -> None:
    assert " ".join(ASCII[kind]).startswith(columns)


def test_lines_that_are_no_measurement() -> None:
    (reply, error), _ = read(line("VNRRG,01,VN-100S-CR") + line("VNERR,0A"))
    assert isinstance(reply, AsciiLine)
    assert isinstance(error, AsciiLine)
    assert (reply.type, reply.values, reply.fields[2]) == ("VNRRG", {}, "VN-100S-CR")
    assert error.error == 10


def test_drop_outs_by_the_sensors_clock() -> None:
    times = [5000 + 10.0 * k + (0.03 if k % 2 else 0.0) for k in range(100)]
    whole = document(timed_frames(times))
    assert (whole["lost_frames"], whole["restarts"], whole["hints"]) == (0, 0, [])
    assert whole["rate_hz"] == pytest.approx(100, rel=0.005)
    assert whole["duration_s"] == pytest.approx(0.99, abs=1e-4)
    del times[60:67], times[20]
    found = document(timed_frames(times))
    assert found["lost_frames"] == 8
    first, second = found["dropouts"]
    assert (first.frames, first.at_byte) == (1, 20 * 64)
    assert (first.at_s, first.length_s) == pytest.approx((0.21, 0.02), abs=1e-4)
    assert (second.frames, second.at_byte) == (7, 59 * 64)
    assert second.length_s == pytest.approx(0.08, abs=1e-4)
    assert "8 frames (8.0%)" in found["hints"][0]
    assert "64000 baud" in found["hints"][0]


def test_a_restart_is_no_gap() -> None:
    found = document(timed_frames([9000 + 10 * k for k in range(20)] + [10 * k for k in range(20)]))
    assert (found["restarts"], found["lost_frames"], found["dropouts"]) == (1, 0, [])
    assert found["duration_s"] == pytest.approx(0.38)
    assert "began anew 1 times" in found["hints"][0]


def test_two_kinds_of_frames_are_judged_apart() -> None:
    slow = [sealed(struct.pack("<BBHQ", 0xFA, 2, 1, k * 40_000_000)) for k in range(10)]
    data = b"".join(timed_frames([40 * k + 10 * i for i in range(4)]) + slow[k] for k in range(10))
    found = document(data)
    assert (found["lost_frames"], found["rate_hz"]) == (0, pytest.approx(100))
    assert [s["rate_hz"] for s in found["streams"]] == pytest.approx([100, 25])


def test_damage_is_told() -> None:
    data = bytearray(timed_frames([10 * k for k in range(20)]))
    data[5 * 64 + 30] ^= 0x10
    found = document(bytes(data) + line("VNYPR,+010.071,+000.278,-002.026").replace(b"071", b"081"))
    assert (found["crc_failed"], found["checksum_failed"], found["lost_frames"]) == (1, 1, 1)
    assert "2 messages (9.5%) have a wrong checksum" in found["hints"][0]


def test_sensor_errors_are_told_in_words() -> None:
    found = document(line("VNERR,0C") + line("VNERR,12"))
    assert found["sensor_errors"] == {"the baud rate is too low for all it is to send": 2}
    assert "reported 2 times" in found["hints"][0]


def test_offsets_and_counts_behind_a_false_start() -> None:
    junk = b"\xfa\x14\x3e\x00\x3a\x00" + bytes(30)
    data = junk + fish_frame(10**9) + line("VNYPR,+1.0,+2.0,+3.0")
    messages, reader = read(data, 5)
    assert [m.offset for m in messages] == [36, 100]
    assert reader.counters.skipped_bytes == 36
    reader.count_anew()
    assert (reader.bytes, reader.counters.binary) == (0, 0)
    (again,) = reader.push(fish_frame(2 * 10**9))
    assert again.offset == 0


@needs_recordings
@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
def test_the_page_shows_a_program_that_works(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "reference" / "imu.md").read_text()
    source = tmp_path / "example.c"
    source.write_text(page.split("```c\n")[1].split("```")[0])
    firmware = ROOT / "firmware"
    files = [
        firmware / f"{name}.c" for name in ("imu/reader", "imu/layout", "imu/line", "base/crc")
    ]
    flags = ["-std=c11", "-Wall", "-Wextra", "-Werror", f"-I{firmware}"]
    program = tmp_path / "example"
    subprocess.run(["cc", *flags, source, *files, "-o", program], check=True)
    with (RECORDINGS / "F00294").open("rb") as stream:
        done = subprocess.run([program], stdin=stream, capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    assert len(lines) == 99
    assert lines[0] == "135.927 -7.078 14.229"
    assert lines[-1] == "135.893 -7.096 14.247"


def test_problems_have_words() -> None:
    problems = all_problems()
    assert [p.number for p in problems] == list(range(len(problems)))
    assert all(p.meaning and (p.remedy or p.well) for p in problems)
    assert problem_info(0).well
    assert "does not know" in problem_info(200).meaning


class Shell:
    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self.capsys = capsys

    def __call__(self, *words: object, status: int = 0) -> tuple[str, str]:
        assert run(["board", "imu", "decode", *map(str, words)]) == status
        captured = self.capsys.readouterr()
        return captured.out, captured.err


@pytest.fixture
def shell(capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(capsys)


@needs_recordings
@pytest.mark.parametrize("name", FILES)
def test_cli_json(shell: Shell, name: str) -> None:
    out, err = shell(RECORDINGS / name, "--json")
    found, want = json.loads(out), expected(name)
    assert err == ""
    assert (found["binary_valid"], found["ascii_valid"]) == (want["binary_ok"], want["ascii_ok"])
    assert (found["headers"], found["crc_chain"]) == (want["headers"], want.get("crc_chain"))
    assert found["ascii_ck_chain"] == want.get("ascii_ck_chain")


@needs_recordings
def test_cli_csv_of_one_kind(shell: Shell, tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    text, _ = shell(RECORDINGS / "F00294", "--csv", out)
    assert f"written: {out}" in text
    with out.open() as file:
        rows = list(csv.DictReader(file))
    messages, _ = read((RECORDINGS / "F00294").read_bytes())
    assert [p.name for p in tmp_path.iterdir()] == ["out.csv"]
    assert len(rows) == len(messages) == 99
    for row, message in zip(rows, messages, strict=True):
        assert int(row.pop("offset_byte")) == message.offset
        assert {k: np.float32(v) for k, v in row.items()} == message.values


@needs_recordings
def test_cli_csv_of_several_kinds(shell: Shell, tmp_path: Path) -> None:
    out, _ = shell(RECORDINGS / "DataExportFromFile.bin", "--csv", tmp_path / "o.csv", "--json")
    names = ["o_06_0001_000E.csv", "o_12_0001_0102.csv", "o_VNYMR.csv"]
    assert sorted(p.name for p in tmp_path.iterdir()) == names
    assert sorted(Path(p).name for p in json.loads(out)["csv_files"]) == names
    first = (tmp_path / "o_06_0001_000E.csv").read_text().splitlines()[1].split(",")
    assert first[1] == "340353403756000"
    with (tmp_path / "o_VNYMR.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 6


def test_cli_reads_standard_input(
    shell: Shell, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path = tmp_path / "stream"
    path.write_bytes(timed_frames([10 * k for k in range(30)]))
    with path.open() as file:
        monkeypatch.setattr("sys.stdin", file)
        out, _ = shell("-")
    assert "30 binary frames, 0 ASCII lines; 0 of 1920 bytes" in out
    assert "100 Hz" in out


def test_cli_text_tells_drop_outs(shell: Shell, tmp_path: Path) -> None:
    path = tmp_path / "stream"
    path.write_bytes(timed_frames([10 * k for k in range(30) if k not in (11, 12)]))
    out, _ = shell(path)
    assert "2 frames missing at 0.130 s, before byte 704 (30.0 ms without a frame)" in out


def test_cli_errors(shell: Shell, tmp_path: Path) -> None:
    empty, other = tmp_path / "empty", tmp_path / "other"
    empty.write_bytes(b"")
    other.write_bytes(b"$GPGGA,1,2,3*00\r\n" * 5)
    out, err = shell(tmp_path / "none", status=1)
    assert (out, err.count("\n")) == ("", 1)
    assert "No such file" in err
    out, err = shell(empty, status=1)
    assert out == ""
    assert "is empty" in err
    out, err = shell(other, status=1)
    assert out == ""
    assert "no message of a VN-100 in 85 bytes" in err
    assert "baud rate" in err
    out, err = shell(other, "--json", status=1)
    assert json.loads(out)["binary_valid"] == 0
    assert "no message" in err
    _, err = shell(other, "--config", status=1)
    assert "is no port" in err
    _, err = shell("tcp:127.0.0.1:1", "--config", status=1)
    assert "--baud" in err
    assert shell(tmp_path, status=1)[1].startswith("tailbeat: cannot use")
