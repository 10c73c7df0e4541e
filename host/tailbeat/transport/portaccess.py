"""Why a serial port cannot be opened: it is not there, is somebody else's, or in use."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from pathlib import Path

from tailbeat.errors import ConnectError, reason

CLOSE_IT = "Close that program: bytes it takes from the port are missing here."
_BUSY = (errno.EBUSY, errno.EAGAIN)
_NO_RADIO = (errno.EHOSTDOWN, errno.EHOSTUNREACH, errno.ECONNREFUSED, errno.ETIMEDOUT)


def cannot_open(path: str, error: Exception) -> ConnectError:
    """The error for a port that ``error`` kept from being opened."""
    number = getattr(error, "errno", None)
    if number == errno.ENOENT:
        return ConnectError(
            f"cannot open {path}: there is no such port{_listing()}",
            "Check the cable (it must carry data); bind a paired radio with:"
            " sudo rfcomm bind 0 ADDRESS",
        )
    if number in (errno.EACCES, errno.EPERM):
        return ConnectError(f"cannot open {path}: you may not use it", _permission_remedy(path))
    if number in _BUSY:
        users = ", ".join(holders(path)) or "another program"
        return ConnectError(f"cannot open {path}: it is in use by {users}", CLOSE_IT)
    if number in _NO_RADIO:
        return ConnectError(
            f"cannot open {path}: the radio does not answer",
            "Switch the fish on, keep the antenna out of the water; if it stays, pair it anew.",
        )
    return ConnectError(
        f"cannot open {path} ({reason(error)})",
        "Check the cable, that no other program holds the port, and that you may use it"
        " (on Linux: group dialout).",
    )


def _permission_remedy(path: str) -> str:
    if sys.platform == "win32":
        return "Close other programs that hold it."
    group = _group_of(path)
    return (
        f"Ask for the group {group} once, then log out and in again: sudo usermod -aG {group} $USER"
    )


def _group_of(path: str) -> str:
    """The group whose members may use a port."""
    try:
        group = Path(path).group()
    except (OSError, KeyError, NotImplementedError):
        return "dialout"
    return "dialout" if group == "root" else group  # a device of root's alone: the usual group


def _listing() -> str:
    from serial.tools import list_ports

    names = sorted(port.device for port in list_ports.comports())
    return f" (there is: {', '.join(names)})" if names else " (there is none at all)"


def holders(device: str, proc: Path = Path("/proc")) -> list[str]:
    """Other programs that have ``device`` open, as "name (pid)". Linux; empty elsewhere."""
    target = os.path.realpath(device)
    found = []
    for process in sorted(proc.glob("[0-9]*"), key=lambda path: int(path.name)):
        if int(process.name) == os.getpid() or not _has_open(process, target):
            continue
        name = process.name
        with contextlib.suppress(OSError):
            name = (process / "comm").read_text(errors="replace").strip()
        found.append(f"{name} ({process.name})")
    return found


def _has_open(process: Path, target: str) -> bool:
    with contextlib.suppress(OSError):  # it ended, or belongs to somebody else
        for descriptor in (process / "fd").iterdir():
            with contextlib.suppress(OSError):
                if str(descriptor.readlink()) == target:
                    return True
    return False
