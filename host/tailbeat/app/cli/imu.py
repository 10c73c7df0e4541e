"""board imu status, save, record, decode."""

from __future__ import annotations

import contextlib
import csv
import itertools
import math
import sys
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from tailbeat.app.cli._connect import connected
from tailbeat.app.cli._options import Connect, Json
from tailbeat.app.cli._terminal import echo, json_line, progress_bar, say
from tailbeat.app.cli.board import imu_line
from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, LinkLostError, TransferError
from tailbeat.core.files import plain
from tailbeat.core.printable import printable
from tailbeat.link.messages import ImuFrame, ImuInfo, imu_health
from tailbeat.sensors.vn100 import decode
from tailbeat.sensors.vn100.decode import AsciiLine, Message, Reader
from tailbeat.sensors.vn100.live import (
    DEFAULT_BAUD,
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
    "sequence",
    "t_s",
    "accel_x_m_s2",
    "accel_y_m_s2",
    "accel_z_m_s2",
    "rate_x_rad_s",
    "rate_y_rad_s",
    "rate_z_rad_s",
    "yaw_deg",
    "pitch_deg",
    "roll_deg",
]


def status(connect: Connect = None, json: Json = False) -> None:
    """Print the IMU's state; of a problem, its cause and what to do.

    Example: tailbeat board imu status
    """
    with connected(connect) as fish:
        info = fish.imu_verdict()
        health = {k: v for k, v in fish.health().items() if k.startswith("imu_")}
    not_well = [words for words, _ in _not_well(health)]
    document = plain(info) | {"health": health, "not_well": not_well}
    say(json, document, lambda: _text(info, health))


def _not_well(health: dict[str, Any]) -> list[tuple[str, str]]:
    return imu_health(int(health["imu_health"]))


def _text(info: ImuInfo, health: dict[str, Any]) -> str:
    not_well = _not_well(health)
    line = imu_line(info)
    if info.problem.well and not not_well:
        return f"{line}; {health['imu_frames']} frames"
    lines = [line]
    if info.error:
        lines.append(f"the IMU said: {info.error}")
    if not info.problem.well and info.model:
        firmware = f", firmware {info.firmware}" if info.firmware else ""
        lines.append(f"it is a {info.model}{firmware}; the board is {info.state}")
    if not_well:
        lines.append(f"in the last seconds: {', '.join(words for words, _ in not_well)}")
    lines += [f"to do: {remedy}" for _, remedy in not_well if remedy]
    counters = [
        f"{key.removeprefix('imu_')} {count}"
        for key, count in health.items()
        if count and key not in ("imu_health", "imu_problem")
    ]
    if counters:
        lines.append(f"since boot: {', '.join(counters)}")
    return "\n".join(lines)


def save(connect: Connect = None, json: Json = False) -> None:
    """Write the IMU's settings into its own flash and restart it. IMU_MOUNT needs this.

    Example: tailbeat board imu save
    """
    with connected(connect) as fish:
        fish.imu_save()
    say(json, {"saved": True}, "saved; the IMU restarts with these settings")


def record(
    out: Annotated[Path, typer.Argument(metavar="OUT.csv", help="Replaced if it exists.")],
    seconds: Annotated[
        float | None,
        typer.Option("--seconds", min=0.0, help="Of board time; default: until Ctrl-C."),
    ] = None,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Write the IMU's raw frames to a CSV file as they arrive.

    Example: tailbeat board imu record rest.csv --seconds 30
    """
    with connected(connect) as fish, progress_bar(json, "recording") as show:
        tally = _Tally()
        frames = fish.imu_frames(math.inf if seconds is None else seconds)
        written = _rows_into(out, frames)
        with (
            contextlib.suppress(KeyboardInterrupt),
            contextlib.closing(frames),
            contextlib.closing(written),
        ):
            for frame in written:
                tally.add(frame)
                show(tally.duration_s / (seconds or math.inf), f"{tally.frames} frames")
        if not tally.frames:
            raise _silent(fish)
    say(json, {"file": out, **tally.document()}, lambda: tally.text(out))


def _rows_into(out: Path, frames: Iterator[ImuFrame]) -> Generator[ImuFrame, None, None]:
    """Writes each frame down before it hands it on. A file that is there is not touched before the
    first one comes."""
    first = next(frames, None)
    if first is None:
        return
    with out.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(_COLUMNS)
        for frame in itertools.chain([first], frames):
            writer.writerow(_row(frame))
            yield frame


class _Tally:
    """Counts frames and the numbers missing between them."""

    def __init__(self) -> None:
        self.frames = 0
        self.missing = 0
        self._first_s = self._last_s = 0.0
        self._next = 0

    @property
    def duration_s(self) -> float:
        """From the first frame to the last."""
        return self._last_s - self._first_s

    def add(self, frame: ImuFrame) -> None:
        """One more; a number below the last one's is a board that has restarted."""
        if not self.frames:
            self._first_s = frame.time_s
        elif frame.sequence > self._next:
            self.missing += frame.sequence - self._next
        self.frames += 1
        self._next = frame.sequence + 1
        self._last_s = frame.time_s

    def document(self) -> dict[str, Any]:
        """All of it."""
        return {
            "frames": self.frames,
            "missing_frames": self.missing,
            "duration_s": self.duration_s,
        }

    def text(self, out: Path) -> str:
        """One line."""
        return f"{out}: {self.frames} frames, {self.duration_s:.2f} s, {self.missing} missing"


def _row(frame: ImuFrame) -> list[str]:
    values = (*frame.accel_m_s2, *frame.rate_rad_s, *frame.ypr_deg)
    single = [str(np.float32(value)) for value in values]
    return [str(frame.sequence), f"{frame.time_s:.6f}", *single]


def _silent(fish: Fish) -> Exception:
    problem = fish.imu_info().problem
    if problem.well:
        return TransferError(
            "no frames came over the link", "Record longer, or check the Bluetooth link."
        )
    return TransferError(f"no frames came: {problem.meaning}", problem.remedy)


_DROPOUTS_SHOWN = 10
_LINE_EVERY_S = 0.2
_SILENT_S = 2.0


def decode_imu(
    source: Annotated[
        str,
        typer.Argument(
            metavar="FILE|PORT",
            help="A recording ('-' = standard input), a serial port, or tcp:HOST:PORT.",
        ),
    ],
    csv: Annotated[
        Path | None,
        typer.Option(
            "--csv",
            metavar="OUT",
            help="Write all values there; of several kinds of messages each gets its own file, "
            "OUT with the kind in its name.",
        ),
    ] = None,
    config: Annotated[
        bool,
        typer.Option("--config", help="Set the sensor up as the fish does, until it is reset."),
    ] = False,
    baud: Annotated[
        int | None,
        typer.Option(
            "--baud",
            min=9600,
            max=921600,
            help="Listen at this speed only; with --config: bring the line to it "
            "(default: 115200). Behind tcp: the bridge's speed.",
        ),
    ] = None,
    rate: Annotated[
        int, typer.Option("--rate", min=1, max=800, help="With --config: frames per second.")
    ] = 100,
    seconds: Annotated[
        float | None,
        typer.Option("--seconds", min=0.0, help="Listen so long; default: until Ctrl-C."),
    ] = None,
    json: Json = False,
) -> None:
    """Decode a VN-100's recording, or listen to one; --json prints JSON lines when live.

    Example: tailbeat board imu decode /dev/ttyUSB0 --config --csv imu.csv
    """
    if is_port(source):
        _listen(source, csv, ListenOptions(config, baud, rate, seconds), json)
    elif config:
        raise InputError(f"{source} is no port, so nothing can be set up", "Leave --config out.")
    else:
        _recording(source, csv, json)


@dataclass(frozen=True)
class ListenOptions:
    """How to listen to a live sensor."""

    config: bool
    baud: int | None
    rate: int
    seconds: float | None


def _recording(name: str, csv: Path | None, as_json: bool) -> None:
    reader, summary = Reader(), StreamSummary()
    with _csv_files(csv, live=False) as files:
        for message in decode(_chunks(name), reader):
            summary.add(message)
            if files is not None:
                files.add(message)
    document = {"source": name} | summary.document(reader.counters, reader.bytes)
    document["csv_files"] = files.paths if files is not None else []
    if summary.messages or as_json:
        say(as_json, document, lambda: _text_vn100(document))
    if not summary.messages:
        raise InputError(*_nothing(name, document))


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
        while chunk := file.read(1 << 16):
            yield chunk


def _csv_files(path: Path | None, live: bool) -> contextlib.AbstractContextManager[CsvFiles | None]:
    return contextlib.nullcontext() if path is None else CsvFiles(path, live)


def _listen(name: str, csv: Path | None, options: ListenOptions, as_json: bool) -> None:
    if options.config and options.baud is None and name.startswith("tcp:"):
        raise InputError(
            "the speed of the line behind TCP is not known",
            "Say it with --baud, so that the sensor is not brought to another one.",
        )
    baud = options.baud or DEFAULT_BAUD
    with contextlib.closing(open_source(name, baud)) as source:
        driver = Driver(baud, options.rate, source.now_s()) if options.config else None
        live = LiveSensor(source, driver)
        _begin(live, options, as_json)
        _follow(live, csv, options.seconds, as_json)


def _begin(live: LiveSensor, options: ListenOptions, as_json: bool) -> None:
    if live.driver is None:
        baud = find_baud(live, options.baud)
        if as_json:
            json_line({"event": "found", "source": live.source.name, "baud": baud})
        else:
            echo(f"{live.source.name}: messages at {baud} baud")
        return
    setup = configure(live)
    if as_json:
        json_line({"event": "configured", "source": live.source.name, **vars(setup)})
    else:
        echo(_setup_text(live.source.name, setup))


def _setup_text(name: str, setup: Setup) -> str:
    moved = "" if setup.found_baud == setup.baud else f" (found at {setup.found_baud})"
    lines = [
        f"{name}: {setup.model}, firmware {setup.firmware}, port {setup.port},"
        f" {setup.baud} baud{moved}, {setup.rate_hz} Hz",
        *(f"  register {r.register:<3} {r.values:<24} {r.name}" for r in setup.registers),
        "  lasts until the sensor is reset or loses power",
    ]
    return "\n".join(lines)


def _follow(live: LiveSensor, csv: Path | None, seconds: float | None, as_json: bool) -> None:
    lost: LinkLostError | None = None
    summary = StreamSummary()
    begin_s = live.source.now_s()
    show = _quiet_line(live, summary, as_json)
    with _csv_files(csv, live=True) as files:

        def take(message: Message, time_s: float) -> None:
            summary.add(message)
            if files is not None:
                files.add(message, time_s - begin_s)
            if as_json:
                json_line(_message_document(message, time_s - begin_s))

        try:
            for batch in live.batches(seconds):
                for arrival in batch:
                    take(arrival.message, arrival.time_s)
                show()
        except KeyboardInterrupt:
            pass  # the usual end
        except LinkLostError as error:
            lost = error
        for arrival in live.end():
            take(arrival.message, arrival.time_s)
    if not as_json and sys.stderr.isatty():
        sys.stderr.write("\r\x1b[K")
        sys.stderr.flush()
    document = {"source": live.source.name} | summary.document(
        live.reader.counters, live.reader.bytes
    )
    document["listened_s"] = live.source.now_s() - begin_s
    document["csv_files"] = files.paths if files is not None else []
    if as_json:
        json_line({"event": "summary", **document})
    else:
        echo(_text_vn100(document))
    if lost is not None:
        raise lost


def _message_document(message: Message, time_s: float) -> dict[str, Any]:
    document = {"event": "message", "t_s": round(time_s, 6), "kind": message.kind}
    if message.values or not isinstance(message, AsciiLine):
        return document | {"values": plain_values(message.values)}
    return document | {"line": ",".join(message.fields)}


def _quiet_line(live: LiveSensor, summary: StreamSummary, as_json: bool) -> Callable[[], None]:
    """Gives ``show()``: keeps one line up to date when a person watches."""
    if as_json or not sys.stderr.isatty():
        return lambda: None
    next_s, last_count, last_s = 0.0, 0, live.source.now_s()

    def show() -> None:
        nonlocal next_s, last_count, last_s
        now_s = live.source.now_s()
        if summary.messages != last_count:
            last_count, last_s = summary.messages, now_s
        if now_s >= next_s:
            next_s = now_s + _LINE_EVERY_S
            state = "" if now_s - last_s < _SILENT_S else f"; silent for {now_s - last_s:.0f} s"
            if live.driver is not None and not live.driver.problem.well:
                state = f"; {live.driver.problem.meaning}"
            counters = live.reader.counters
            damaged = counters.crc_failed + counters.checksum_failed
            text = f"{summary.messages} messages, {damaged} damaged{state}"
            sys.stderr.write(f"\r{printable(text)}\x1b[K")
            sys.stderr.flush()

    return show


def _text_vn100(document: dict[str, Any]) -> str:
    d = document
    lines = [
        f"{d['source']}: {d['binary_valid']} binary frames, {d['ascii_valid']} ASCII lines;"
        f" {d['skipped_bytes']} of {d['bytes']} bytes ({d['skipped_share']:.1%}) in no message,"
        f" {d['crc_failed'] + d['checksum_failed']} messages damaged"
    ]
    for stream in d["streams"]:
        rate = f", {stream['rate_hz']:.6g} Hz" if stream["rate_hz"] else ""
        lost = f", {stream['lost_frames']} missing" if stream["lost_frames"] else ""
        size = f"{stream['frame_bytes']} bytes"
        lines.append(f"  {stream['kind']}: {stream['frames']} frames of {size}{rate}{lost}")
    lines += [f"  ${kind}: {count} lines" for kind, count in d["ascii_types"].items()]
    if d["duration_s"] is not None:
        lines.append(f"  {d['duration_s']:.3f} s by the sensor's clock")
    lines += [f"  {_dropout_text(gap)}" for gap in _longest(d["dropouts"])]
    lines += [f"hint: {hint}" for hint in d["hints"]]
    lines += [f"written: {path}" for path in d["csv_files"]]
    return "\n".join(lines)


def _longest(dropouts: list[Any]) -> list[Any]:
    worst = sorted(dropouts, key=lambda gap: -gap.frames)[:_DROPOUTS_SHOWN]
    return sorted(worst, key=lambda gap: gap.at_byte)


def _dropout_text(gap: Any) -> str:
    return (
        f"{gap.frames} frames missing at {gap.at_s:.3f} s, before byte {gap.at_byte}"
        f" ({gap.length_s * 1e3:.1f} ms without a frame)"
    )
