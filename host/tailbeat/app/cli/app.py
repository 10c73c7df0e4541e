"""Puts the commands together."""

from __future__ import annotations

from typing import Annotated

import typer

from tailbeat.app.cli import (
    bluetooth,
    board,
    camera,
    design,
    doctor,
    experiment,
    flash,
    identify,
    imu,
    key,
    learn,
    montecarlo,
    params,
    progress,
    reference,
    report,
    session,
    simulate,
    thesis,
    trials,
    trim,
    vn100,
    web,
)
from tailbeat.app.cli._terminal import echo

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="A robotic fish learns to swim along a speed profile.\n\n"
    "First steps: 'tailbeat demo' shows it in simulation; 'tailbeat sim' starts a simulated fish "
    "to play with; 'tailbeat info' says what is connected.",
)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        echo(f"tailbeat {version('tailbeat')}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    del version


app.command()(simulate.demo)
app.command()(simulate.sim)
app.command()(simulate.vboard)
app.command()(board.info)
app.command()(doctor.doctor)
app.add_typer(params.app, name="params")
app.add_typer(reference.app, name="reference")
app.command()(board.arm)
app.command()(board.disarm)
app.command()(board.clear)
app.add_typer(trials.app, name="trial")
app.add_typer(session.app, name="session")
app.command()(trim.trim)
app.add_typer(camera.app, name="camera")
app.add_typer(learn.speed_app, name="speed")
app.command()(learn.learn)
app.command()(identify.identify)
app.command()(design.design)
app.command()(learn.law)
app.command()(progress.progress)
app.command()(board.watch)
app.command()(board.crash)
app.add_typer(imu.app, name="imu")
app.command()(vn100.vn100)
app.add_typer(key.app, name="key")
app.add_typer(bluetooth.app, name="bluetooth")
app.command()(flash.flash)
app.command()(montecarlo.sweep)
app.command()(thesis.thesis)
app.command()(simulate.selftest)
app.add_typer(experiment.app, name="experiment")
app.command()(report.report)
app.command()(web.ui)
