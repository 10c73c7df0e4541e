"""bluetooth setup."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Annotated

import typer

from tailbeat.app.cli._terminal import Json, say

if TYPE_CHECKING:
    from tailbeat.board.bluetooth import SetupReport

app = typer.Typer(no_args_is_help=True, help="The fish's Bluetooth module.")


@app.callback()
def _bluetooth() -> None:
    """The fish's Bluetooth module."""


@app.command()
def setup(
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

    Takes the module out of the fish: wire it to a 3.3 V USB-serial adapter and power it up with
    its KEY (EN) pin high. What is as wanted already is left alone.

    Example: tailbeat bluetooth setup /dev/ttyUSB0 --name fish --pin 4711
    """
    from tailbeat.board import bluetooth
    from tailbeat.link.serial import SerialTransport

    with contextlib.closing(SerialTransport(port, bluetooth.AT_BAUDS[0])) as line:
        report = bluetooth.setup(line, name, pin)
    say(json, report, lambda: _text(report))


def _text(report: SetupReport) -> str:
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
