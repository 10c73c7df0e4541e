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
from tailbeat.records import record_crc

_BOARD = "board.json"
_REFERENCES = "references.txt"
_ASIDE_MAX = 999


def put_safe(safe: Path, now: Backup, note: Callable[[str], None]) -> Backup:
    """What is to be put back, with a copy of it in ``safe``: the copy that a broken-off
    identification left there while the board still has a run's reference, else ``now``, what the
    board holds. A copy is never overwritten. ``note``: told what a person should know."""
    left = _left(safe)
    if left is not None and left.unique_id == now.unique_id and _broken_off(safe, left, now):
        note(
            "an identification or a trim was broken off; "
            f"what the board held before it is in {safe}"
        )
        return left
    if (safe / _BOARD).exists():
        aside = _aside(safe)
        note(f"an older copy of what the board held is kept in {aside} (tailbeat flash --restore)")
    (safe / _REFERENCES).unlink(missing_ok=True)
    now.write(safe)
    return now


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


def _left(safe: Path) -> Backup | None:
    try:
        return Backup.read(safe)
    except InputError:
        return None


def _broken_off(safe: Path, left: Backup, now: Backup) -> bool:
    """Also between the two steps of putting back: the reference is there, the rest is not."""
    crc = record_crc(now.reference) if now.reference is not None else None
    halfway = left.reference == now.reference and now.learned is None and left.learned is not None
    return is_of_a_run(safe, crc) or halfway


def _aside(safe: Path) -> Path:
    for number in range(1, _ASIDE_MAX):
        aside = safe.with_name(f"{safe.name}-{number}")
        if not aside.exists():
            safe.rename(aside)
            sync_folder(safe.parent)
            return aside
    raise InputError(f"{safe.parent} is full of copies.", "Take the older ones away.")
