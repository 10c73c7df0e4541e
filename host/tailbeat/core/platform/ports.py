"""Serial ports, pseudo-terminals and cameras as files."""

from __future__ import annotations

import importlib
import os
import select
import sys
import time
from pathlib import Path
from typing import Any

_LOOK_S = 0.002
_USUAL_GROUP = "dialout"


def is_serial_port(name: str, system: str = sys.platform) -> bool:
    """Whether this names a serial port rather than a file. Windows: COM3, \\\\.\\COM12."""
    if system == "win32":
        return name.upper().removeprefix("\\\\.\\").startswith("COM")
    return Path(name).is_char_device()


def is_unlisted_port(name: str, system: str = sys.platform) -> bool:
    """Whether a port exists that the system does not list (a pty, a link); never on Windows."""
    return system != "win32" and Path(name).exists()


def same_port(a: str, b: str, system: str = sys.platform) -> bool:
    """Whether both name one port."""
    if system == "win32":
        return a.upper() == b.upper()
    return os.path.realpath(a) == os.path.realpath(b)


def port_permission_remedy(port: str, system: str = sys.platform) -> str:
    """What to do when a port may not be opened."""
    if system == "win32":
        return "Close other programs that hold it."
    group = _group_of(port)
    return (
        f"Ask for the group {group} once, then log out and in again: sudo usermod -aG {group} $USER"
    )


def _group_of(port: str) -> str:
    """The group whose members may use a port."""
    try:
        group = Path(port).group()
    except (OSError, KeyError, NotImplementedError):
        return _USUAL_GROUP
    return _USUAL_GROUP if group == "root" else group  # a device of root's alone


def camera_node(address: str, system: str = sys.platform) -> Path | None:
    """The file of a camera, ``address`` = its number or path; None where cameras are no files."""
    if not system.startswith("linux"):
        return None
    return Path(f"/dev/video{address}" if address.isdecimal() else address)


def wait_for_bytes(port: Any, timeout_s: float, system: str = sys.platform) -> None:
    """Until a serial port (as of pyserial) has bytes, or the time is over. Windows cannot wait for
    a port: it is asked every 2 ms. Raises what the port raises."""
    if system != "win32":
        select.select([port.fileno()], [], [], timeout_s)
        return
    end_s = time.monotonic() + timeout_s
    while not port.in_waiting and (left_s := end_s - time.monotonic()) > 0:
        time.sleep(min(_LOOK_S, left_s))


def open_pty() -> tuple[int, int, str] | None:
    """Both ends of a raw pseudo-terminal, the first without blocking, and the path of the other;
    None where there are none. The caller closes both."""
    try:
        pty, tty = (importlib.import_module(name) for name in ("pty", "tty"))
    except ImportError:
        return None
    near, far = pty.openpty()
    tty.setraw(far)
    os.set_blocking(near, False)
    return near, far, os.ttyname(far)
