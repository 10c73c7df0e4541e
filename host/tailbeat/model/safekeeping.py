"""The copy of what a board held before an identification: on the disk until the board has it back.

Beside the records of a backup lies ``references.txt``, the CRC of every reference that the runs
gave the board: by it a later identification knows whether an earlier one was broken off.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

from tailbeat.errors import InputError
from tailbeat.flashing.backup import Backup
from tailbeat.lasting import sync_folder

_BOARD = "board.json"
_REFERENCES = "references.txt"
_ASIDE_MAX = 999


def put_safe(safe: Path, now: Backup, note: Callable[[str], None]) -> None:
    """Writes a copy of ``now``, what the board holds. One that is there already is set aside, never
    overwritten. ``note``: told what a person should know."""
    if (safe / _BOARD).exists():
        aside = _aside(safe)
        note(f"an older copy of what the board held is kept in {aside} (tailbeat flash --restore)")
    (safe / _REFERENCES).unlink(missing_ok=True)
    now.write(safe)


def left_in(safe: Path) -> Backup | None:
    """The copy in there; None = no whole one."""
    try:
        return Backup.read(safe)
    except InputError:
        return None


def note_reference(safe: Path, crc: int) -> None:
    """To be called before the board gets a reference of a run. Lasting when it returns."""
    with (safe / _REFERENCES).open("a", encoding="ascii") as file:
        file.write(f"{crc:#010x}\n")
        file.flush()
        os.fsync(file.fileno())
    sync_folder(safe)


def is_of_a_run(safe: Path | None, crc: int | None) -> bool:
    """Whether a broken-off identification gave the board the reference ``crc``."""
    if safe is None or crc is None or not (safe / _BOARD).is_file():
        return False
    try:
        return f"{crc:#010x}" in (safe / _REFERENCES).read_text(encoding="ascii").split()
    except (OSError, ValueError):
        return False


def forget(safe: Path) -> None:
    """The board has it back. ``board.json`` goes first: without it the rest is no copy."""
    (safe / _BOARD).unlink(missing_ok=True)
    shutil.rmtree(safe, ignore_errors=True)


def _aside(safe: Path) -> Path:
    for number in range(1, _ASIDE_MAX):
        aside = safe.with_name(f"{safe.name}-{number}")
        if not aside.exists():
            safe.rename(aside)
            sync_folder(safe.parent)
            return aside
    raise InputError(f"{safe.parent} is full of copies.", "Take the older ones away.")
