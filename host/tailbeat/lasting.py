"""What it takes that a new file is still there after a power cut."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from tailbeat.errors import InputError, reason

MAKE_ROOM = "Make room on this computer, then go on; nothing is lost."


def sync_folder(folder: Path) -> None:
    """Makes the names in it last, as fsync does contents; Windows neither needs nor allows it."""
    if os.name != "nt":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def write_whole(path: Path, content: str | bytes, remedy: str = "Choose another place.") -> None:
    """Writes the file whole or not at all, and so that it lasts. Raises InputError when that cannot
    be; ``remedy``: what to do then."""
    part = path.with_name(path.name + ".part")
    try:
        with part.open("wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        raise InputError(f"cannot write {path} ({reason(error)})", remedy) from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
