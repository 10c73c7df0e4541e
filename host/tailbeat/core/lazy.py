"""Modules that are loaded when they are first used.

``scipy``, ``matplotlib``, ``numpy`` and the packages of the extras take long to load, or are not
installed; a module that needs one names it at its top and loads it with its first attribute.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any


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
