"""Packages that only some commands need, and how to install them.

The package's extras (camera, web, export, cluster) name them in host/pyproject.toml; the emulator
of the board (vboard) has a package of its own in the repository.

``lazy``: ``scipy``, ``matplotlib``, ``numpy`` and the packages of the extras take long to load, or
are not installed; a module that needs one names it at its top and loads it with its first
attribute.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from tailbeat.core.errors import InputError

_PACKAGE = "tailbeat"
_INSTALLER = Path("tools") / "bootstrap"


def need(module: str, extra: str, what: str) -> Any:
    """The module, which ``what`` ("Reading films needs PyAV") needs.

    Raises:
        InputError: when it is not installed; the remedy is the command that installs ``extra``.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise InputError(f"{what}, which is not installed", remedy(extra)) from error


def is_installed(module: str) -> bool:
    """Whether the module can be imported."""
    try:
        import_module(module)
    except ImportError:
        return False
    return True


def remedy(extra: str) -> str:
    """What to do about a missing extra: a command that works where this package is installed."""
    if (root := checkout()) is not None:
        script = root / _INSTALLER
        return f"Install it: {_shortest(script)} {extra}"
    if packages := _packages_of(extra):
        words = " ".join(f"'{package}'" for package in packages)
        return f"Install it: {_shortest(Path(sys.executable))} -m pip install {words}"
    return f"It comes with the repository: run '{_INSTALLER} {extra}' in a clone of it."


def reinstall() -> str:
    """What to do about an installation that is not whole."""
    if (root := checkout()) is not None:
        return f"Build it again: make -C {_shortest(root)} package"
    python = _shortest(Path(sys.executable))
    return f"Install it again: {python} -m pip install --force-reinstall tailbeat"


def checkout() -> Path | None:
    """The clone whose .venv runs this program; None when it was installed elsewhere."""
    prefix = Path(sys.prefix)
    if prefix.name == ".venv" and (prefix.parent / _INSTALLER).is_file():
        return prefix.parent
    return None


def _packages_of(extra: str) -> list[str]:
    """What the installed package's metadata lists for an extra."""
    from importlib.metadata import PackageNotFoundError, requires  # 15 ms

    try:
        listed = requires(_PACKAGE) or []
    except PackageNotFoundError:
        return []
    found = []
    for line in listed:
        package, _, marker = line.partition(";")
        if f"extra == '{extra}'" in marker.replace('"', "'"):
            found.append(package.strip())
    return found


def _shortest(path: Path) -> str:
    """Relative to the present folder where that is shorter."""
    relative = os.path.relpath(path)
    return min(str(path), relative, key=len)


class LazyModule(ModuleType):
    """Stands for a module: looks every name up in it, and loads it for the first one."""

    def __init__(self, name: str, load: Callable[[], ModuleType]) -> None:
        super().__init__(name)
        self._load = cache(load)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # inspection asks any module for these; that is no use of it
            raise AttributeError(name)
        return getattr(self._load(), name)


def lazy(name: str) -> Any:
    """The module ``name``, imported when it is first used."""
    return LazyModule(name, lambda: import_module(name))
