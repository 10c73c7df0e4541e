"""Where the trial library of a fish is."""

from __future__ import annotations

import os
from pathlib import Path

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError

FOLDER_VARIABLE = "TAILBEAT_LOGBOOK"


def has_library(fish: Fish) -> bool:
    """Whether there is one of a connected board, without asking it: not of a simulated one in this
    process, which is a new fish every time, unless a folder is named."""
    return fish.sim is None or fish.library_root is not None or FOLDER_VARIABLE in os.environ


def library_folder(fish: Fish, root: Path | None = None) -> Path | None:
    """Of a connected board. None where it has no library. Raises InputError."""
    if root is None and not has_library(fish):
        return None
    return folder_of(fish.unique_id(), root or fish.library_root)


def folder_of(unique_id: str, root: Path | None = None) -> Path:
    """``root``: the folder of all trial libraries, if not the usual one. Raises InputError."""
    if not (unique_id.isalnum() and unique_id.isascii() and len(unique_id) <= 64):
        raise InputError(
            f"'{unique_id}' names no fish", "Give the unique_id of 'tailbeat info --json'."
        )
    return (root or _default_root()) / unique_id.lower()


def _default_root() -> Path:
    if named := os.environ.get(FOLDER_VARIABLE):
        return Path(named).expanduser()
    base = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    return Path(base) / "tailbeat" / "fish"
