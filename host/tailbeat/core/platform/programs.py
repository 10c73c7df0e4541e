"""Programs and libraries by name, and what this process may do."""

from __future__ import annotations

import importlib
import os
import signal
import sys
from collections.abc import Mapping

# A library stays loaded to the very end: objects that outlive it are freed by its functions, when
# Python ends, in any order. Windows takes no flags.
LIBRARY_FLAGS = getattr(os, "RTLD_NOW", 0) | getattr(os, "RTLD_NODELETE", 0)

_LIBRARY = {"win32": ".dll", "darwin": ".dylib"}
_PROGRAM = {"win32": ".exe"}


def library_name(stem: str, system: str = sys.platform) -> str:
    """File name of a shared library of the package."""
    return f"lib{stem}{_LIBRARY.get(system, '.so')}"


def program_name(stem: str, system: str = sys.platform) -> str:
    """File name of a compiled program."""
    return f"{stem}{_PROGRAM.get(system, '')}"


def install_program(package: str, system: str = sys.platform) -> str:
    """How a program that is not Python is installed: of the same name for Debian and Homebrew."""
    if system == "darwin":
        return f"Install it: brew install {package}"
    if system == "win32":
        return f"Download {package} from its makers, and put its folder into PATH."
    return f"Install it: apt-get install {package}"


def cores_here() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def terminal_closed() -> list[signal.Signals]:
    """The signal of a terminal that was closed; Windows has none."""
    return [signal.SIGHUP] if hasattr(signal, "SIGHUP") else []


def has_windows(system: str = sys.platform, environment: Mapping[str, str] = os.environ) -> bool:
    """Whether a browser would open a window rather than take over the terminal."""
    shown = environment.get("DISPLAY") or environment.get("WAYLAND_DISPLAY")
    return system in ("darwin", "win32") or bool(shown)


def open_files_max() -> int | None:
    """How many files this process may have open at a time; None = no limit that matters."""
    try:
        resource = importlib.import_module("resource")
    except ImportError:  # Windows
        return None
    soft = int(resource.getrlimit(resource.RLIMIT_NOFILE)[0])
    return None if soft == resource.RLIM_INFINITY else soft
