"""board imu status, save, record, decode."""

from __future__ import annotations

import contextlib
import csv
import math
import sys
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.app.cli._fish import ConnectedFish
from tailbeat.app.cli._lazy import arg, opt
from tailbeat.app.cli._terminal import (
    Display,
    Output,
    json_asked,
    json_line,
    lines_of,
    print_line,
    progress_bar,
)
from tailbeat.app.cli.info import imu_line
from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, LinkLostError, TransferError
from tailbeat.core.files import plain
from tailbeat.link.messages import ImuFrame, ImuInfo, imu_health
from tailbeat.sensors.vn100.batch import BatchReader, decode_rows
from tailbeat.sensors.vn100.decode import AsciiLine, Message, Reader
from tailbeat.sensors.vn100.decode import decode as decode_chunks
from tailbeat.sensors.vn100.live import (
    DEFAULT_BAUD,
    Arrival,
    Driver,
    LiveSensor,
    Setup,
    configure,
    find_baud,
    is_port,
    open_source,
)
from tailbeat.sensors.vn100.summary import CsvFiles, StreamSummary, plain_values

_COLUMNS = [
    *("sequence", "t_s"),
    *(f"accel_{axis}_m_s2" for axis in "xyz"),
    *(f"rate_{axis}_rad_s" for axis in "xyz"),
    *("yaw_deg", "pitch_deg", "roll_deg"),
]


def status(fish: ConnectedFish) -> Output:
    """Print the IMU's state; of a problem, its cause and what to do.

    Example: tailbeat board imu status
    """
    info = fish.imu_verdict()
    health = {k: v for k, v in fish.health().items() if k.startswith("imu_")}
    wrong = imu_health(int(health["imu_health"]))
    document = plain(info) | {"health": health, "not_well": [words for words, _ in wrong]}
    return Output(document, lambda: _status_text(info, health, wrong))


def _status_text(info: ImuInfo, health: dict[str, Any], wrong: list[tuple[str, str]]) -> str:
    line = imu_line(info)
    if info.problem.well and not wrong:
        return f"{line}; {health['imu_frames']} frames"
    firmware = f", firmware {info.firmware}" if info.firmware else ""
    known = not info.problem.well and info.model
    counters = [
        f"{key.removeprefix('imu_')} {count}"
        for key, count in health.items()
        if count and key not in ("imu_health", "imu_problem")
    ]
    return lines_of(
        line,
        info.error and f"the IMU said: {info.error}",
        known and f"it is a {info.model}{firmware}; the board is {info.state}",
        wrong and f"in the last seconds: {', '.join(words for words, _ in wrong)}",
        [f"to do: {remedy}" for _, remedy in wrong if remedy],
        counters and f"since boot: {', '.join(counters)}",
    )


def save(fish: ConnectedFish) -> Output:
    """Write the IMU's settings into its own flash and restart it. IMU_MOUNT needs this.

    Example: tailbeat board imu save
    """
    fish.imu_save()
    return Output({"saved": True}, "saved; the IMU restarts with these settings")


def record(
    fish: ConnectedFish,
    out: Path = arg("Replaced if it exists.", "OUT.csv"),
    seconds: float | None = opt("Of board time; default: until Ctrl-C.", min=0.0),
) -> Output:
    """Write the IMU's raw frames to a CSV file as they arrive.

    Example: tailbeat board imu record rest.csv --seconds 30
    """
    rows, sequences, begin_s, duration_s = None, array("Q"), 0.0, 0.0
    frames = fish.imu_frames(math.inf if seconds is None else seconds)
    with (
        contextlib.suppress(KeyboardInterrupt),
        contextlib.closing(frames),
        progress_bar("recording") as show,
        contextlib.ExitStack() as stack,
    ):
        for frame in frames:
            if rows is None:  # a file that is there is not touched before the first one comes
                file = stack.enter_context(out.open("w", newline=""))
                rows, begin_s = csv.writer(file, lineterminator="\n"), frame.time_s
                rows.writerow(_COLUMNS)
            rows.writerow(_row(frame))
            sequences.append(frame.sequence)
            duration_s = frame.time_s - begin_s
            show(duration_s / (seconds or math.inf), f"{len(sequences)} frames")
    if not sequences:
        raise _silent(fish)
    # a number below the one before is a board that has restarted
    missing = sum(max(after - before - 1, 0) for before, after in pairwise(sequences))
    counts = {"frames": len(sequences), "missing_frames": missing, "duration_s": duration_s}
    text = f"{out}: {len(sequences)} frames, {duration_s:.2f} s, {missing} missing"
    return Output({"file": out} | counts, text)


def _row(frame: ImuFrame) -> list[str]:
    values = (*frame.accel_m_s2, *frame.rate_rad_s, *frame.ypr_deg)
    single = [str(np.float32(value)) for value in values]
    return [str(frame.sequence), f"{frame.time_s:.6f}", *single]


def _silent(fish: Fish) -> TransferError:
    problem = fish.imu_info().problem
    if not problem.well:
        return TransferError(f"no frames came: {problem.meaning}", problem.remedy)
    return TransferError(
        "no frames came over the link", "Record longer, or check the Bluetooth link."
    )


_CHUNK_BYTES = 1 << 20
_DROPOUTS_SHOWN = 10
_LINE_EVERY_S = 0.2
_SILENT_S = 2.0


@dataclass(frozen=True)
class ListenOptions:
    """How to listen to a live sensor."""

    config: bool = opt("Set the sensor up as the fish does, until it is reset.")
    baud: int | None = opt(
        "Listen at this speed only; with --config: bring the line to it "
        "(default: 115200). Behind tcp: the bridge's speed.",
        min=9600,
        max=921600,
    )
    rate: int = opt("With --config: frames per second.", min=1, max=800, default=100)
    seconds: float | None = opt("Listen so long; default: until Ctrl-C.", min=0.0)


def decode(
    *,
    source: str = arg(
        "A recording ('-' = standard input), a serial port, or tcp:HOST:PORT.",
        "FILE|PORT",
    ),
    csv: Path | None = opt(
        "Write all values there. Each kind of message gets its own file if there are several, "
        "OUT with the kind in its name.",
        "OUT",
    ),
    listen: ListenOptions,
) -> Output | None:
    """Decode a VN-100's recording, or listen to one; --json prints JSON lines when live.

    Example: tailbeat board imu decode /dev/ttyUSB0 --config --csv imu.csv
    """
    if is_port(source):
        _listen(source, csv, listen)
        return None
    if listen.config:
        raise InputError(f"{source} is no port, so nothing can be set up", "Leave --config out.")
    return _recording(source, csv)


def _recording(name: str, csv: Path | None) -> Output:
    document = _read_rows(name) if csv is None else _read_messages(name, csv)
    if document["binary_valid"] + document["ascii_valid"]:
        return Output(document, lambda: _summary_text(document))
    return Output(document, error=InputError(*_nothing(name, document)))


def _read_rows(name: str) -> dict[str, Any]:
    reader, summary = BatchReader(), StreamSummary()
    for rows in decode_rows(_chunks(name), reader):
        summary.add_rows(rows, reader)
    return _summary(name, summary, reader, None)


def _read_messages(name: str, csv: Path) -> dict[str, Any]:
    reader, summary = Reader(), StreamSummary()
    with CsvFiles(csv, live=False) as files:
        for message in decode_chunks(_chunks(name), reader):
            summary.add(message)
            files.add(message)
    return _summary(name, summary, reader, files)


def _summary(
    name: str, summary: StreamSummary, reader: Reader | BatchReader, files: CsvFiles | None
) -> dict[str, Any]:
    document = {"source": name} | summary.document(reader.counters, reader.bytes)
    return document | {"csv_files": files.paths if files is not None else []}


def _nothing(name: str, document: dict[str, Any]) -> tuple[str, str]:
    if not document["bytes"]:
        return f"{name} is empty", "Record again. Is there data? tailbeat board imu decode PORT"
    damaged = document["crc_failed"] + document["checksum_failed"]
    return (
        f"{name} holds no message of a VN-100 in {document['bytes']} bytes"
        f" ({damaged} with a wrong check)",
        "Is it the raw bytes of the sensor's line, recorded at its baud rate?",
    )


def _chunks(name: str) -> Iterator[bytes]:
    with contextlib.ExitStack() as stack:
        file = sys.stdin.buffer if name == "-" else stack.enter_context(Path(name).open("rb"))
        while chunk := file.read(_CHUNK_BYTES):
            yield chunk


def _csv_files(path: Path | None, live: bool) -> contextlib.AbstractContextManager[CsvFiles | None]:
    return contextlib.nullcontext() if path is None else CsvFiles(path, live)


def _listen(name: str, csv: Path | None, options: ListenOptions) -> None:
    if options.config and options.baud is None and name.startswith("tcp:"):
        raise InputError(
            "the speed of the line behind TCP is not known",
            "Say it with --baud, so that the sensor is not brought to another one.",
        )
    baud = options.baud or DEFAULT_BAUD
    with contextlib.closing(open_source(name, baud)) as source:
        driver = Driver(baud, options.rate, source.now_s()) if options.config else None
        live = LiveSensor(source, driver)
        if driver is None:
            found = find_baud(live, options.baud)
            document = {"event": "found", "source": source.name, "baud": found}
            print_line(document, f"{source.name}: messages at {found} baud")
        else:
            setup = configure(live)
            document = {"event": "configured", "source": source.name, **vars(setup)}
            print_line(document, _setup_text(source.name, setup))
        _follow(live, csv, options.seconds)


def _setup_text(name: str, setup: Setup) -> str:
    moved = "" if setup.found_baud == setup.baud else f" (found at {setup.found_baud})"
    lines = [
        f"{name}: {setup.model}, firmware {setup.firmware}, port {setup.port},"
        f" {setup.baud} baud{moved}, {setup.rate_hz} Hz",
        *(f"  register {r.register:<3} {r.values:<24} {r.name}" for r in setup.registers),
        "  lasts until the sensor is reset or loses power",
    ]
    return "\n".join(lines)


def _follow(live: LiveSensor, csv: Path | None, seconds: float | None) -> None:
    begin_s, summary, lost = live.source.now_s(), StreamSummary(), None
    with _csv_files(csv, live=True) as files, Display() as display:
        line = _LiveLine(live, summary, display, begin_s)

        def take(arrival: Arrival) -> None:
            message, time_s = arrival.message, arrival.time_s - begin_s
            summary.add(message)
            if files is not None:
                files.add(message, time_s)
            if json_asked.get():
                json_line(_message_document(message, time_s))

        with contextlib.suppress(KeyboardInterrupt):  # the usual end
            try:
                for batch in live.batches(seconds):
                    for arrival in batch:
                        take(arrival)
                    line.show()
            except LinkLostError as error:
                lost = error
        for arrival in live.end():
            take(arrival)
    document = _summary(live.source.name, summary, live.reader, files)
    document["listened_s"] = live.source.now_s() - begin_s
    print_line({"event": "summary"} | document, _summary_text(document))
    if lost is not None:
        raise lost


def _message_document(message: Message, time_s: float) -> dict[str, Any]:
    document = {"event": "message", "t_s": round(time_s, 6), "kind": message.kind}
    if message.values or not isinstance(message, AsciiLine):
        return document | {"values": plain_values(message.values)}
    return document | {"line": ",".join(message.fields)}


@dataclass
class _LiveLine:
    """One line that is kept up to date at a terminal."""

    live: LiveSensor
    summary: StreamSummary
    display: Display
    last_s: float  # when the last message came
    _last_count: int = 0
    _next_s: float = 0.0

    def show(self) -> None:
        """How many messages, and what is wrong."""
        now_s, messages = self.live.source.now_s(), self.summary.messages
        if messages != self._last_count:
            self._last_count, self.last_s = messages, now_s
        if now_s < self._next_s or json_asked.get():
            return
        self._next_s = now_s + _LINE_EVERY_S
        silent_s, driver = now_s - self.last_s, self.live.driver
        state = "" if silent_s < _SILENT_S else f"; silent for {silent_s:.0f} s"
        if driver is not None and not driver.problem.well:
            state = f"; {driver.problem.meaning}"
        counters = self.live.reader.counters
        damaged = counters.crc_failed + counters.checksum_failed
        self.display.show(f"{messages} messages, {damaged} damaged{state}")


def _summary_text(document: dict[str, Any]) -> str:
    d = document
    took_s = d["duration_s"]
    return lines_of(
        f"{d['source']}: {d['binary_valid']} binary frames, {d['ascii_valid']} ASCII lines;"
        f" {d['skipped_bytes']} of {d['bytes']} bytes ({d['skipped_share']:.1%}) in no message,"
        f" {d['crc_failed'] + d['checksum_failed']} messages damaged",
        map(_stream_text, d["streams"]),
        [f"  ${kind}: {count} lines" for kind, count in d["ascii_types"].items()],
        took_s is not None and f"  {took_s:.3f} s by the sensor's clock",
        map(_dropout_text, _longest(d["dropouts"])),
        [f"hint: {hint}" for hint in d["hints"]],
        [f"written: {path}" for path in d["csv_files"]],
    )


def _stream_text(stream: dict[str, Any]) -> str:
    rate = f", {stream['rate_hz']:.6g} Hz" if stream["rate_hz"] else ""
    lost = f", {stream['lost_frames']} missing" if stream["lost_frames"] else ""
    frames = f"{stream['frames']} frames of {stream['frame_bytes']} bytes"
    return f"  {stream['kind']}: {frames}{rate}{lost}"


def _longest(dropouts: list[Any]) -> list[Any]:
    worst = sorted(dropouts, key=lambda gap: -gap.frames)[:_DROPOUTS_SHOWN]
    return sorted(worst, key=lambda gap: gap.at_byte)


def _dropout_text(gap: Any) -> str:
    return (
        f"  {gap.frames} frames missing at {gap.at_s:.3f} s, before byte {gap.at_byte}"
        f" ({gap.length_s * 1e3:.1f} ms without a frame)"
    )
