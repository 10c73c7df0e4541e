"""The compiled firmware and simulator, bound with cffi.

``from tailbeat.core.native import ffi, lib`` at the top of a module loads nothing: the first use of
either does. The declarations are the C headers themselves (host/native/bindings.h), so their
comments are the documentation. The build turns them into a module (host/native/make_binding.py),
so that no start parses them: 0.01 s instead of 0.23 s.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

from tailbeat.core.errors import TailbeatError
from tailbeat.core.extras import reinstall
from tailbeat.core.platform.programs import LIBRARY_FLAGS, library_name

HERE = Path(__file__).parent


class NativeLibraryError(TailbeatError):
    """The compiled part of the package is missing or does not load."""


@dataclass(frozen=True)
class Native:
    """The library and the cffi instance that knows its types."""

    ffi: Any
    lib: Any


@cache
def load(folder: Path = HERE) -> Native:
    """Loads the library out of ``folder``.

    Raises:
        NativeLibraryError: when it is not there or was built for another machine.
    """
    return load_library("native", folder)


def load_library(name: str, folder: Path = HERE) -> Native:
    """Loads the library tailbeat_NAME by the types in _NAME_types.py; raises as ``load``."""
    found, library = load_types(name, folder), _present(folder / library_name(f"tailbeat_{name}"))
    try:
        return Native(found, found.dlopen(str(library), LIBRARY_FLAGS))
    except OSError as error:
        raise NativeLibraryError(f"{library.name} does not load ({error})", reinstall()) from error


def load_types(name: str, folder: Path = HERE) -> Any:
    """The cffi instance of _NAME_types.py; raises as ``load``."""
    path = _present(folder / f"_{name}_types.py")
    spec = spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None, "it ends in .py"
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.ffi


def _present(path: Path) -> Path:
    if not path.exists():
        raise NativeLibraryError(
            f"{path.name} is missing: this is not the installed package",
            reinstall(),
        )
    return path


class _OnFirstUse:
    """Stands for one part of the loaded library and keeps what was looked up in it.

    A name that was used once is an ordinary attribute: a call costs what it does without this.
    """

    def __init__(self, part: str) -> None:
        self._part = part

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # inspection asks any object for these; that is no use of it
            raise AttributeError(name)
        value = getattr(getattr(load(), self._part), name)
        if name != "errno":  # the only name whose value changes
            setattr(self, name, value)
        return value

    def __dir__(self) -> list[str]:
        return dir(getattr(load(), self._part))


ffi: Any = _OnFirstUse("ffi")
lib: Any = _OnFirstUse("lib")


def c_text(pointer: object) -> str:
    """A string of the library."""
    return str(ffi.string(pointer).decode())
