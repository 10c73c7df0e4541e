"""session first, resume, status."""

from __future__ import annotations

import typer

app = typer.Typer(no_args_is_help=True, help="A day at the tank: first session, battery swap.")


@app.command()
def status() -> None:
    """Which experiment the fish is in, and where it stands.

    Example: tailbeat session status
    """
    raise NotImplementedError


@app.command()
def resume() -> None:
    """After a battery swap: give the board back what it knew, repeat the best, tell the shift.

    Example: tailbeat session resume
    """
    raise NotImplementedError
