"""What differs between Linux, macOS and Windows, in one place.

Nothing here is decided when it is imported from ``sys.platform`` of a test: every function takes
the name of the system, so that each can be tested for all of them.
"""

from __future__ import annotations

import sys

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
