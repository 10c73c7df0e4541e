"""Modules that are loaded when they are first used.

``scipy``, ``matplotlib``, ``numpy`` and the packages of the extras take long to load, or are not
installed; a module that needs one names it at its top and loads it with its first attribute.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import Any


class LazyModule(ModuleType):
    """Stands for a module and takes over its contents at the first look-up of a name."""

    def __init__(self, name: str, load: Callable[[], ModuleType]) -> None:
        super().__init__(name)
        self._load = load

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # what inspection asks of any module is no use of it
            raise AttributeError(name)
        module = self._load()
        self.__dict__.update(module.__dict__)
        return getattr(module, name)


def lazy(name: str) -> Any:
    """The module ``name``, imported when it is first used."""
    return LazyModule(name, lambda: import_module(name))
