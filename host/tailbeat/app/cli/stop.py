"""stop, and trial list."""

from __future__ import annotations

from tailbeat.app.cli._fish import ConnectedFish
from tailbeat.app.cli._terminal import Output, table


def stop(fish: ConnectedFish) -> Output:
    """Stop the tail now.

    Example: tailbeat stop
    """
    fish.abort()
    status = fish.status()
    return Output(status, f"stopped: {status.state}")


def list_(fish: ConnectedFish) -> Output:
    """Print the trials whose logs are on the board.

    Example: tailbeat trial list
    """
    found = fish.trials()
    pending = fish.status().pending_trial
    rows = [[t.number, t.size_bytes, "pending" if t.number == pending else ""] for t in found]
    text = table(["trial", "bytes", ""], rows) if rows else "no trials on the board"
    return Output({"trials": found, "pending_trial": pending}, text)
