"""The board: info, check, arm, disarm, clear, watch, crash, flash, bluetooth."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import fields
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from tailbeat.app.cli._connect import connected
from tailbeat.app.cli._options import Connect, Json
from tailbeat.app.cli._terminal import echo, json_line, mm, progress_bar, say
from tailbeat.board import bluetooth
from tailbeat.board.bluetooth import SetupReport
from tailbeat.board.crash import CrashReport, places
from tailbeat.board.diagnostics import examine
from tailbeat.board.diagnostics.evidence import PROBLEM, Finding, worst
from tailbeat.board.fish import REST, Fish
from tailbeat.board.flash.procedure import FlashPlan, FlashReport
from tailbeat.board.flash.procedure import flash as write_image
from tailbeat.board.provision import MISSING, trust_of
from tailbeat.board.snapshot import RestoreReport, Snapshot
from tailbeat.board.snapshot import restore as restore_snapshot
from tailbeat.core.files import plain
from tailbeat.core.printable import printable
from tailbeat.core.trial_checks import never_corrected
from tailbeat.experiment.folder import backup_places
from tailbeat.link.messages import BoardInfo, BoardStatus, ImuInfo
from tailbeat.link.serial import SerialTransport


def _bluetooth() -> None:
    """The fish's Bluetooth module."""


def bluetooth_setup(
    port: Annotated[
        str, typer.Argument(help="The USB-serial adapter that the module is wired to.")
    ],
    name: Annotated[
        str | None, typer.Option("--name", help="Name that laptops see, 1 to 20 characters.")
    ] = None,
    pin: Annotated[str | None, typer.Option("--pin", help="PIN for pairing, four digits.")] = None,
    json: Json = False,
) -> None:
    """Bring an HC-05 or HC-06 to 115200 baud.

    Take the module out of the fish, wire it to a 3.3 V USB-serial adapter and power it up with its
    KEY (EN) pin high. Settings that are right already are not changed.

    Example: tailbeat board bluetooth /dev/ttyUSB0 --name fish --pin 4711
    """
    with contextlib.closing(SerialTransport(port, bluetooth.AT_BAUDS[0])) as line:
        report = bluetooth.setup(line, name, pin)
    say(json, report, lambda: _bluetooth_text(report))


def _bluetooth_text(report: SetupReport) -> str:
    firmware = f", firmware {report.firmware}" if report.firmware else ""
    head = f"{report.module}{firmware}, answered AT at {report.at_baud} baud"
    if not report.changed:
        return f"{head}: already at {report.now.baud} baud, nothing changed"
    done = []
    if "baud" in report.changed:
        done.append(f"{report.found.baud} baud raised to {report.now.baud}")
    if "name" in report.changed:
        done.append(f"name {report.now.name}")
    if "pin" in report.changed:
        done.append(f"PIN {report.now.pin}")
    last = "Power it off, release KEY, put it back into the fish, and pair it anew."
    return f"{head}: {', '.join(done)}. {last}"


def info(connect: Connect = None, json: Json = False) -> None:
    """Print what is connected and its state.

    Example: tailbeat info --connect tcp:127.0.0.1:5760
    """
    with connected(connect) as fish:
        if trust_of(fish) == MISSING:
            document, text = _info_unauthenticated(fish)
        else:
            document, text = _info(fish)
    say(json, document, text)


def _info(fish: Fish) -> tuple[dict[str, Any], str]:
    found, imu, health, visits = fish.info(), fish.imu_info(), fish.health(), fish.visits()
    who = f"{found.board} board on {found.connection}, firmware {found.build_id}"
    document = plain(found) | {"imu": imu, "health": health, "visits": visits}
    text = _info_text(who, found.status, imu_line(imu), health)
    missing = never_corrected(visits)
    return document, text + (f"\nlearned    {missing}" if missing else "")


def _info_unauthenticated(fish: Fish) -> tuple[dict[str, Any], str]:
    """Of a board whose key is not here: what it sends without authentication."""
    status, health, name = fish.status(), fish.health(), fish.transport.name
    document: dict[str, Any] = dict.fromkeys(field.name for field in fields(BoardInfo))
    document |= {"connection": name, "status": status, "imu": None, "health": health}
    document["visits"] = None
    who = f"board on {name}; what it is, and its firmware: only for authenticated hosts"
    return document, _info_text(who, status, "only for authenticated hosts", health)


def imu_line(imu: ImuInfo) -> str:
    """The IMU in one line: what it is when all is well, otherwise what is wrong."""
    if not imu.problem.well:
        return f"{imu.problem.meaning}. {imu.problem.remedy}"
    where = f"{imu.baud} baud, port {imu.port or '?'}"
    return f"{imu.model}, firmware {imu.firmware}, {imu.rate_hz} Hz at {where}"


def _info_text(who: str, status: BoardStatus, imu: str, health: dict[str, int | str]) -> str:
    lines = [
        who,
        f"state      {status.state}, battery {status.battery_text}",
        f"reference  {_reference(status)}",
        f"iteration  {status.iteration} swims next, as trial {status.next_trial}",
        f"imu        {imu}",
    ]
    if status.fault.number:
        lines.insert(2, f"stopped    {status.fault.meaning}. {status.fault.remedy}")
    if status.best_max_abs_error_m_s is not None:
        best = mm(status.best_max_abs_error_m_s)
        lines.append(f"best       {best} mm/s at iteration {status.best_iteration}")
    if status.pending_trial is not None:
        lines.append(f"pending    trial {status.pending_trial}: learn from it or discard it")
    if health.get("reset_cause") != "power":
        lines.append(f"last start {health['reset_cause']}")
    counted = ("imu_crc_failed", "link_bad_frames", "late_ticks", "store_failures")
    bad = [f"{name} {health[name]}" for name in counted if health.get(name)]
    if bad:
        lines.append(f"counters   {', '.join(bad)}")
    return "\n".join(lines)


def _reference(status: BoardStatus) -> str:
    if status.reference_crc in (None, REST.crc):
        return "none; upload one: tailbeat reference upload thesis"
    return f"{status.beats} beats, {status.reference_crc:08x}"


def arm(connect: Connect = None, json: Json = False) -> None:
    """Get ready for a trial. The tail stays off until the trial starts.

    Example: tailbeat board arm
    """
    with connected(connect) as fish:
        fish.arm()
        status = fish.status()
    say(json, status, f"armed: iteration {status.iteration} swims next")


def disarm(connect: Connect = None, json: Json = False) -> None:
    """Back to idle; a running trial is aborted.

    Example: tailbeat board disarm
    """
    with connected(connect) as fish:
        fish.disarm()
        status = fish.status()
    say(json, status, f"disarmed: {status.state}")


def clear(connect: Connect = None, json: Json = False) -> None:
    """Leave a stop, after the cause of an abort or a fault has been looked at.

    Example: tailbeat board clear
    """
    with connected(connect) as fish:
        fish.clear()
        status = fish.status()
    say(json, status, f"cleared: {status.state}")


def watch(
    connect: Connect = None,
    count: Annotated[
        int | None, typer.Option("--count", min=1, help="Stop after this many lines.")
    ] = None,
    json: Json = False,
) -> None:
    """Print the board's messages as JSON lines, until Ctrl-C.

    Example: tailbeat board watch | jq -c 'select(.event == "beat")'
    """
    del json  # the stream is JSON lines anyway
    with connected(connect) as fish:
        for number, event in enumerate(fish.watch(), start=1):
            json_line(event)
            if number == count:
                return


def crash(
    connect: Connect = None,
    elf: Annotated[
        Path | None,
        typer.Option("--elf", help="The .elf that crashed: names the places in the source."),
    ] = None,
    json: Json = False,
) -> None:
    """Print how the firmware last crashed, from the board's /crash.bin.

    Example: tailbeat board crash --elf build/firmware/tailbeat.elf
    """
    with connected(connect) as fish:
        report = fish.crash_report()
    found = places(report, elf) if report is not None and elf is not None else []
    document = {"crash": None if report is None else report.as_dict() | {"places": found}}
    say(json, document, lambda: _crash_text(report, found))


def _crash_text(report: CrashReport | None, found: list[str]) -> str:
    if report is None:
        return "no crash on record"
    what = ", ".join([report.kind, *report.reasons, *filter(None, [report.where])])
    registers = [f"{name:<10} {value:08x}" for name, value in report.registers.items()]
    columns = ["  ".join(registers[i : i + 3]) for i in range(0, len(registers), 3)]
    words = [f"{word:08x}" for word in report.stack]
    stack = ["stack  " + " ".join(words[i : i + 8]) for i in range(0, len(words), 8)]
    return "\n".join(
        [
            f"{what}, {report.time_s:.3f} s after its start, firmware {report.build_id}",
            *found,
            *columns,
            *stack,
        ]
    )


def check(connect: Connect = None, json: Json = False) -> None:
    """Check everything from the port to the battery, and print what to do. Changes nothing.

    Exit status 0 when nothing has to be done, 1 when there are problems; warnings are neither.

    Example: tailbeat board check --connect /dev/rfcomm0
    """
    findings = examine(connect)
    well = worst(findings) != PROBLEM
    say(json, {"ok": well, "checks": findings}, lambda: _text_doctor(findings))
    if not well:
        raise typer.Exit(1)


def _text_doctor(findings: list[Finding]) -> str:
    names = max(len(finding.name) for finding in findings)
    return "\n".join(f"{f.status:<7}  {f.name:<{names}}  {f.line}" for f in findings)


class Tool(StrEnum):
    """What writes the chip's flash."""

    bossac = "bossac"
    openocd = "openocd"


def flash(
    image: Annotated[
        Path, typer.Argument(help="The .bin; OpenOCD takes the .elf next to it.")
    ] = Path("build/firmware/tailbeat.bin"),
    port: Annotated[
        str | None,
        typer.Option("--port", help="The board's USB port; default: the only one there is."),
    ] = None,
    tool: Annotated[
        Tool, typer.Option("--tool", help="By USB with bossac, or over SWD with OpenOCD.")
    ] = Tool.bossac,
    adapter: Annotated[
        str, typer.Option("--adapter", help="OpenOCD's name for the SWD probe.")
    ] = "cmsis-dap",
    keep: Annotated[
        bool,
        typer.Option("--keep/--no-keep", help="Save what the board holds, and put it back after."),
    ] = True,
    out: Annotated[
        Path, typer.Option("--out", help="Where it is saved; may be an experiment's folder.")
    ] = Path("backups"),
    restore: Annotated[
        Path | None,
        typer.Option("--restore", metavar="BACKUP", help="Flash nothing; put a backup back."),
    ] = None,
    connect: Annotated[
        str | None,
        typer.Option(
            "--connect", metavar="URL", help="Where to talk to the board, if not by --port."
        ),
    ] = None,
    yes: Annotated[
        bool, typer.Option("--yes", help="Do not ask before a port of another make is touched.")
    ] = False,
    json: Json = False,
) -> None:
    """Write new firmware; parameters, reference and learned data are restored on the board.

    Trials that are not on this computer yet are pulled before anything is erased.

    Example: tailbeat board flash --port /dev/ttyACM0
    """
    if restore is not None:
        _restore(restore, connect or port or None, json)
        return

    plan = FlashPlan(image, port or None, tool.value, keep, backup_places(out), connect, adapter)
    screen = _Screen(json)
    try:
        report = write_image(
            plan, screen.show, tell=screen.tell, confirm=lambda text: yes or screen.ask(text)
        )
    finally:
        screen.clear()
    say(json, report, lambda: _flash_text(report))


class _Screen:
    """A progress bar that is gone while something is said or asked."""

    def __init__(self, as_json: bool) -> None:
        self._as_json = as_json
        self._bar = ExitStack()
        self._show: Callable[[float, str], None] | None = None

    def show(self, fraction: float, text: str) -> None:
        """How far it is."""
        if self._show is None:
            self._show = self._bar.enter_context(progress_bar(self._as_json, "flash"))
        self._show(fraction, text)

    def clear(self) -> None:
        """Takes the bar off the screen."""
        self._bar.close()
        self._show = None

    def tell(self, line: str) -> None:
        """For the user to know or do."""
        self.clear()
        echo(f"tailbeat: {line}", err=True)

    def ask(self, question: str) -> bool:
        """No, unless somebody is there to say yes."""
        self.clear()
        return sys.stdin.isatty() and typer.confirm(f"tailbeat: {printable(question)}", err=True)


def _flash_text(report: FlashReport) -> str:
    line = f"the board runs {report.build_id}" if report.verified else f"wrote {report.build_id}"
    if report.restored:
        line += f" and has back: {', '.join(report.restored)}"
    if report.backup is not None:
        line += f"; saved in {report.backup}"
    lines = [line, *(f"not restored: {text}" for text in report.not_restored)]
    return "\n".join([*lines, *(f"note: {text}" for text in report.notes)])


def _restore(folder: Path, url: str | None, json: bool) -> None:
    held = Snapshot.read(folder)
    with connected(url) as fish:
        result = restore_snapshot(fish, held)
    document = {
        "backup": folder,
        "restored": result.back,
        "not_restored": result.missing,
        "notes": result.notes,
    }
    say(json, document, lambda: _restore_text(result))


def _restore_text(result: RestoreReport) -> str:
    lines = [f"the board has back: {', '.join(result.back)}"]
    lines += [f"not restored: {text}" for text in result.missing]
    return "\n".join([*lines, *(f"note: {text}" for text in result.notes)])
