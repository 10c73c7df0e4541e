"""camera calibrate, print, track, render."""

from __future__ import annotations

import typer

from tailbeat.cli import cameracalibrate, camerarender, cameratrack

app = typer.Typer(no_args_is_help=True, help="Speed from an overhead camera.")

app.command("print")(cameracalibrate.print_)
app.command()(cameracalibrate.calibrate)
app.command()(cameratrack.track)
app.command()(camerarender.render)
