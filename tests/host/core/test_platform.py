"""What differs between systems, each asked for on this one."""

from __future__ import annotations

import pytest

from tailbeat.core import platform


@pytest.mark.parametrize(
    ("system", "library", "program", "install"),
    [
        ("linux", "liba.so", "a", "apt-get install bossa-cli"),
        ("darwin", "liba.dylib", "a", "brew install bossa-cli"),
        ("win32", "liba.dll", "a.exe", "put its folder into PATH"),
    ],
)
def test_names_and_words(system: str, library: str, program: str, install: str) -> None:
    assert platform.library_name("a", system) == library
    assert platform.program_name("a", system) == program
    assert install in platform.install_program("bossa-cli", system)
