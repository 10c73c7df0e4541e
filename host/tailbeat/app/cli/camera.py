"""camera calibrate, print, track, render."""

from __future__ import annotations

import typer

from tailbeat.app.cli import camera_calibrate, camera_render, camera_track

app = typer.Typer(no_args_is_help=True, help="Speed from an overhead camera.")

app.command("print")(camera_calibrate.print_)
app.command()(camera_calibrate.calibrate)
app.command()(camera_track.track)
app.command()(camera_render.render)
