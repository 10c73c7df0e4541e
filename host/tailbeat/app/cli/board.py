"""The board: check, arm, disarm, clear, watch, crash, flash, bluetooth."""

from __future__ import annotations

import contextlib
import itertools
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path

import typer

from tailbeat.app.cli._fish import Connect, ConnectedFish, Stream, connected
from tailbeat.app.cli._lazy import arg, opt
from tailbeat.app.cli._terminal import Output, json_line, lines_of, progress_bar, warn
from tailbeat.board import bluetooth
from tailbeat.board.bluetooth import SetupReport
from tailbeat.board.diagnostics import examine
from tailbeat.board.diagnostics.evidence import PROBLEM, Finding, worst
from tailbeat.board.flash.dry_run import preview
from tailbeat.board.flash.procedure import FlashPlan, FlashReport
from tailbeat.board.flash.procedure import flash as write_image
from tailbeat.board.flash.programs import places
from tailbeat.board.memory import CrashReport
from tailbeat.board.snapshot import Snapshot
from tailbeat.board.snapshot import restore as restore_snapshot
from tailbeat.core.files import plain
from tailbeat.core.image import default_image
from tailbeat.core.printable import printable
from tailbeat.experiment.folder import backup_places
from tailbeat.link.serial import SerialTransport
from tailbeat.link.stream import streaming


def bluetooth_(
    port: str = arg("The USB-serial adapter that the module is wired to."),
    name: str | None = opt("Name that laptops see, 1 to 20 characters."),
    pin: str | None = opt("PIN for pairing, four digits."),
) -> Output:
    """Bring an HC-05 or HC-06 to 115200 baud.

    Take the module out of the fish and wire it to a 3.3 V USB-serial adapter. Power it up with
    its KEY (EN) pin high. Settings that are right already are not changed.

    Example: tailbeat board bluetooth /dev/ttyUSB0 --name fish --pin 4711
    """
    with contextlib.closing(SerialTransport(port, bluetooth.AT_BAUDS[0])) as line:
        report = bluetooth.setup(line, name, pin)
    return Output(report, lambda: _bluetooth_text(report))


def _bluetooth_text(report: SetupReport) -> str:
    firmware = f", firmware {report.firmware}" if report.firmware else ""
    head = f"{report.module}{firmware}, answered AT at {report.at_baud} baud"
    if not report.changed:
        return f"{head}: already at {report.now.baud} baud, nothing changed"
    words = {
        "baud": f"{report.found.baud} baud raised to {report.now.baud}",
        "name": f"name {report.now.name}",
        "pin": f"PIN {report.now.pin}",
    }
    done = [word for what, word in words.items() if what in report.changed]
    last = "Power it off, release KEY, put it back into the fish, and pair it anew."
    return f"{head}: {', '.join(done)}. {last}"


def arm(fish: ConnectedFish) -> Output:
    """Get ready for a trial. The tail stays off until the trial starts.

    Example: tailbeat board arm
    """
    fish.arm()
    status = fish.status()
    return Output(status, f"armed: iteration {status.iteration} is next")


def disarm(fish: ConnectedFish) -> Output:
    """Back to idle; a running trial is aborted.

    Example: tailbeat board disarm
    """
    fish.disarm()
    status = fish.status()
    return Output(status, f"disarmed: {status.state}")


def clear(fish: ConnectedFish) -> Output:
    """Leave a stop, after the cause of an abort or a fault has been looked at.

    Example: tailbeat board clear
    """
    fish.clear()
    status = fish.status()
    return Output(status, f"cleared: {status.state}")


def watch(
    fish: ConnectedFish,
    count: int | None = opt("Stop after this many lines.", min=1),
    stream: Stream = None,
) -> None:
    """Print the board's messages as JSON lines, until Ctrl-C.

    Example: tailbeat board watch | jq -c 'select(.event == "beat")'
    """
    with streaming(fish.link, stream):
        for event in itertools.islice(fish.watch(), count):
            json_line(event)


def crash(
    fish: ConnectedFish,
    elf: Path | None = opt("The .elf that crashed: names the places in the source."),
) -> Output:
    """Print how the firmware last crashed, from the board's /crash.bin.

    Example: tailbeat board crash --elf build/firmware/tailbeat.elf
    """
    report = fish.crash_report()
    found = places(report, elf) if report is not None and elf is not None else []
    document = {"crash": None if report is None else plain(report) | {"places": found}}
    return Output(document, lambda: _crash_text(report, found))


def _crash_text(report: CrashReport | None, found: list[str]) -> str:
    if report is None:
        return "no crash on record"
    what = ", ".join([report.kind, *report.reasons, *filter(None, [report.where])])
    registers = [f"{name:<10} {value:08x}" for name, value in report.registers.items()]
    columns = ["  ".join(registers[i : i + 3]) for i in range(0, len(registers), 3)]
    words = [f"{word:08x}" for word in report.stack]
    stack = ["stack  " + " ".join(words[i : i + 8]) for i in range(0, len(words), 8)]
    head = f"{what}, {report.time_s:.3f} s after its start, firmware {report.build_id}"
    return "\n".join([head, *found, *columns, *stack])


def check(connect: Connect = None) -> Output:
    """Check everything from the port to the battery, and print what to do. Changes nothing.

    Exit status 0 when nothing has to be done, 1 when there are problems; warnings are neither.

    Example: tailbeat board check --connect /dev/rfcomm0
    """
    findings = examine(connect)
    well = worst(findings) != PROBLEM
    document = {"ok": well, "checks": findings}
    return Output(document, lambda: _findings_text(findings), status=0 if well else 1)


def _findings_text(findings: list[Finding]) -> str:
    names = max(len(finding.name) for finding in findings)
    return "\n".join(f"{f.status:<7}  {f.name:<{names}}  {f.line}" for f in findings)


class Tool(StrEnum):
    """What writes the chip's flash."""

    bossac = "bossac"
    openocd = "openocd"


def flash(
    image: Path | None = arg("The .bin (OpenOCD: the .elf beside it); default: the packaged one."),
    port: str | None = opt("The board's USB port; default: the only one there is."),
    tool: Tool = opt("By USB with bossac, or over SWD with OpenOCD.", default=Tool.bossac),
    adapter: str = opt("OpenOCD's name for the SWD probe.", default="cmsis-dap"),
    keep: bool = opt(
        "Save what the board holds, and put it back after.", name="--keep/--no-keep", default=True
    ),
    out: Path = opt("Where it is saved; may be an experiment's folder.", default=Path("backups")),
    restore: Path | None = opt("Flash nothing; put a backup back.", "BACKUP"),
    connect: str | None = opt("Where to talk to the board, if not by --port.", "URL"),
    yes: bool = opt("Do not ask before a port of another make is touched."),
    dry_run: bool = opt("Check image, program and port, and print the steps; change nothing."),
) -> Output:
    """Write new firmware; parameters, reference and learned data are restored on the board.

    Trials that are not on this computer yet are pulled before anything is erased.

    Example: tailbeat board flash --port /dev/ttyACM0
    """
    if restore is not None:
        return _restore(restore, connect or port or None)
    image = image or default_image()
    plan = FlashPlan(image, port or None, tool.value, keep, backup_places(out), connect, adapter)
    if dry_run:
        return _dry_run(plan)
    with contextlib.closing(_Screen()) as screen:
        report = write_image(
            plan, screen.show, tell=screen.tell, confirm=lambda text: yes or screen.ask(text)
        )
    return Output(report, lambda: _flash_text(report))


def _dry_run(plan: FlashPlan) -> Output:
    found = preview(plan)
    head = f"{found.image}: {found.build_id}, {found.size_bytes} bytes, can boot"
    steps = [f"{number}. {step}" for number, step in enumerate(found.steps, 1)]
    missing = [f"missing: {text}" for text in found.missing]
    end = "nothing was changed; " + ("ready to flash" if found.ready else "not ready to flash")
    return Output(asdict(found) | {"ready": found.ready}, lines_of(head, steps, missing, [end]))


class _Screen:
    """A progress bar that is gone while something is said or asked."""

    def __init__(self) -> None:
        self._bar = ExitStack()
        self._show: Callable[[float, str], None] | None = None

    def show(self, fraction: float, text: str) -> None:
        """How far it is."""
        if self._show is None:
            self._show = self._bar.enter_context(progress_bar("flash"))
        self._show(fraction, text)

    def close(self) -> None:
        """Takes the bar off the screen."""
        self._bar.close()
        self._show = None

    def tell(self, line: str) -> None:
        """For the user to know or do."""
        self.close()
        warn(line)

    def ask(self, question: str) -> bool:
        """No, unless somebody is there to say yes."""
        self.close()
        return sys.stdin.isatty() and typer.confirm(f"tailbeat: {printable(question)}", err=True)


def _flash_text(report: FlashReport) -> str:
    line = f"the board runs {report.build_id}" if report.verified else f"wrote {report.build_id}"
    if report.restored:
        line += f" and has back: {', '.join(report.restored)}"
    if report.backup is not None:
        line += f"; saved in {report.backup}"
    return _with_notes(line, report.not_restored, report.notes)


def _with_notes(line: str, not_restored: Sequence[str], notes: Sequence[str]) -> str:
    missing = [f"not restored: {text}" for text in not_restored]
    return lines_of(line, missing, [f"note: {text}" for text in notes])


def _restore(folder: Path, url: str | None) -> Output:
    held = Snapshot.read(folder)
    with connected(url) as fish:
        result = restore_snapshot(fish, held)
    back, missing, notes = result.back, result.missing, result.notes
    document = {"backup": folder, "restored": back, "not_restored": missing, "notes": notes}
    return Output(document, _with_notes(f"the board has back: {', '.join(back)}", missing, notes))
