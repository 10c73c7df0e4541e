"""Builds the package with scikit-build-core; a source distribution carries the C sources, too.

They lie beside this folder in the repository. A source distribution has them in ``source/``, where
CMakeLists.txt looks first.
"""

from __future__ import annotations

import shutil
from contextlib import chdir
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scikit_build_core import build
from scikit_build_core.build import (
    build_editable,
    build_wheel,
    get_requires_for_build_editable,
    get_requires_for_build_sdist,
    get_requires_for_build_wheel,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)

__all__ = [
    "build_editable",
    "build_sdist",
    "build_wheel",
    "get_requires_for_build_editable",
    "get_requires_for_build_sdist",
    "get_requires_for_build_wheel",
    "prepare_metadata_for_build_editable",
    "prepare_metadata_for_build_wheel",
]

HERE = Path(__file__).resolve().parent
SOURCE = "source"
NEEDED = (
    "CMakeLists.txt", "cmake", "firmware", "hal", "host/native", "host/pyproject.toml",
    "tools/fetch_deps.py", "wire",
)  # fmt: skip


def build_sdist(folder: str, config_settings: dict[str, Any] | None = None) -> str:
    """Writes the source distribution into ``folder`` and returns its name."""
    target = str(Path(folder).resolve())
    with TemporaryDirectory() as scratch:
        tree = Path(scratch) / "tailbeat"
        copy(HERE, tree)
        if not (tree / SOURCE).exists():
            for name in NEEDED:
                copy(HERE.parent / name, tree / SOURCE / name)
        with chdir(tree):
            return build.build_sdist(target, config_settings)


def copy(there: Path, here: Path) -> None:
    """A file or a folder, without what Python has compiled."""
    here.parent.mkdir(parents=True, exist_ok=True)
    if there.is_dir():
        shutil.copytree(there, here, ignore=shutil.ignore_patterns("__pycache__"))
    else:
        shutil.copyfile(there, here)
