"""flash."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tailbeat.app.cli._terminal import Json, connected, echo, progress_bar, say
from tailbeat.core.printable import printable

if TYPE_CHECKING:
    from tailbeat.board.flash.procedure import FlashReport
    from tailbeat.board.snapshot import RestoreReport


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
    """Write new firmware; parameters, reference and what was learned go back onto the board.

    Trials that are not on this computer yet are pulled before anything is erased.

    Example: tailbeat flash --port /dev/ttyACM0
    """
    if restore is not None:
        _restore(restore, connect or port or None, json)
        return
    from tailbeat.board.flash.procedure import FlashPlan
    from tailbeat.board.flash.procedure import flash as write_image
    from tailbeat.experiment.folder import backup_places

    places = backup_places(out)
    plan = FlashPlan(image, port or None, tool.value, keep, places, connect, adapter)
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
    from tailbeat.board.snapshot import Snapshot, restore

    held = Snapshot.read(folder)
    with connected(url) as fish:
        result = restore(fish, held)
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
