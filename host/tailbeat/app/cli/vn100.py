"""board imu decode."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from tailbeat.app.cli._options import Json
from tailbeat.app.cli._terminal import echo, json_line, say
from tailbeat.core.errors import InputError, LinkLostError
from tailbeat.core.printable import printable
from tailbeat.sensors.vn100 import decode
from tailbeat.sensors.vn100.decode import Line, Message, Reader
from tailbeat.sensors.vn100.driver import Driver, Setup
from tailbeat.sensors.vn100.live import (
    DEFAULT_BAUD,
    Live,
    configure,
    find_baud,
    is_port,
    open_source,
)
from tailbeat.sensors.vn100.summary import CsvFiles, Summary, plain_values

_DROPOUTS_SHOWN = 10
_LINE_EVERY_S = 0.2
_SILENT_S = 2.0


def imu_decode(
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
        _listen(source, csv, _Wishes(config, baud, rate, seconds), json)
    elif config:
        raise InputError(f"{source} is no port, so nothing can be set up", "Leave --config out.")
    else:
        _recording(source, csv, json)


@dataclass(frozen=True)
class _Wishes:
    """What is asked of a live sensor."""

    config: bool
    baud: int | None
    rate: int
    seconds: float | None


def _recording(name: str, csv: Path | None, as_json: bool) -> None:
    reader, summary = Reader(), Summary()
    with _csv_files(csv, live=False) as files:
        for message in decode(_chunks(name), reader):
            summary.add(message)
            if files is not None:
                files.add(message)
    document = {"source": name} | summary.document(reader.counters, reader.bytes)
    document["csv_files"] = files.paths if files is not None else []
    if summary.messages or as_json:
        say(as_json, document, lambda: _text(document))
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
    size = 1 << 16
    with contextlib.ExitStack() as stack:
        file = sys.stdin.buffer if name == "-" else stack.enter_context(Path(name).open("rb"))
        while chunk := file.read(size):
            yield chunk


def _csv_files(path: Path | None, live: bool) -> contextlib.AbstractContextManager[CsvFiles | None]:
    return contextlib.nullcontext() if path is None else CsvFiles(path, live)


def _listen(name: str, csv: Path | None, wishes: _Wishes, as_json: bool) -> None:
    if wishes.config and wishes.baud is None and name.startswith("tcp:"):
        raise InputError(
            "the speed of the line behind TCP is not known",
            "Say it with --baud, so that the sensor is not brought to another one.",
        )
    baud = wishes.baud or DEFAULT_BAUD
    with contextlib.closing(open_source(name, baud)) as source:
        driver = Driver(baud, wishes.rate, source.now_s()) if wishes.config else None
        live = Live(source, driver)
        _begin(live, wishes, as_json)
        _follow(live, csv, wishes.seconds, as_json)


def _begin(live: Live, wishes: _Wishes, as_json: bool) -> None:
    if live.driver is None:
        baud = find_baud(live, wishes.baud)
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


def _follow(live: Live, csv: Path | None, seconds: float | None, as_json: bool) -> None:
    lost: LinkLostError | None = None
    summary = Summary()
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
    if not as_json:
        _erase_line()
    document = {"source": live.source.name} | summary.document(
        live.reader.counters, live.reader.bytes
    )
    document["listened_s"] = live.source.now_s() - begin_s
    document["csv_files"] = files.paths if files is not None else []
    if as_json:
        json_line({"event": "summary", **document})
    else:
        echo(_text(document))
    if lost is not None:
        raise lost


def _message_document(message: Message, time_s: float) -> dict[str, Any]:
    document = {"event": "message", "t_s": round(time_s, 6), "kind": message.kind}
    if message.values or not isinstance(message, Line):
        return document | {"values": plain_values(message.values)}
    return document | {"line": ",".join(message.fields)}


def _quiet_line(live: Live, summary: Summary, as_json: bool) -> Callable[[], None]:
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


def _erase_line() -> None:
    if sys.stderr.isatty():
        sys.stderr.write("\r\x1b[K")
        sys.stderr.flush()


def _text(document: dict[str, Any]) -> str:
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
