"""Builds the package with scikit-build-core; a source distribution carries what a build needs.

In the repository the C sources lie beside this folder, and a build generates the MAVLink dialect
and the types of the shared libraries and fetches littlefs. A source distribution has the sources in
``source/``, and there in ``carried/`` all that was generated and fetched, so that building it needs
neither those packages nor the network.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from contextlib import chdir
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scikit_build_core import build
from scikit_build_core.build import (
    build_editable,
    build_wheel,
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
CARRIED = "carried"
NEEDED = (
    "CMakeLists.txt", "cmake", "examples", "firmware", "hal", "host/native", "host/pyproject.toml",
    "sim", "tests/fuzz/lfs_image.h", "tests/unit", "tools/fetch_deps.py", "wire",
)  # fmt: skip
GENERATORS = ["cffi>=2.0", "pymavlink==2.4.50", "pip"]

Settings = dict[str, Any] | None


def get_requires_for_build_wheel(settings: Settings = None) -> list[str]:
    """What generates code, but for a source distribution."""
    found = list(build.get_requires_for_build_wheel(settings))
    return found if (HERE / SOURCE / CARRIED).exists() else found + GENERATORS


get_requires_for_build_editable = get_requires_for_build_wheel
get_requires_for_build_sdist = get_requires_for_build_wheel


def build_sdist(folder: str, settings: Settings = None) -> str:
    """Writes the source distribution into ``folder`` and returns its name."""
    target = str(Path(folder).resolve())
    with TemporaryDirectory() as scratch:
        tree = Path(scratch) / "tailbeat"
        copy(HERE, tree)
        if not (tree / SOURCE).exists():
            for name in NEEDED:
                copy(HERE.parent / name, tree / SOURCE / name)
            carry(HERE.parent, tree / SOURCE / CARRIED, Path(scratch) / "build")
        with chdir(tree):
            return build.build_sdist(target, settings)


def carry(root: Path, carried: Path, scratch: Path) -> None:
    """Puts everything into ``carried`` that a build in the repository generates or fetches."""
    cmake = ["cmake", "-S", str(root / "host"), "-B", str(scratch)]
    fetched = scratch / "fetched"
    copy(root / "build" / "deps", fetched / "deps")  # what is there is checked by its hash
    settings = {"Python_EXECUTABLE": sys.executable, "TAILBEAT_FETCHED_DIR": fetched}
    settings |= {"TAILBEAT_SELFTEST": "ON"}
    run(*cmake, *(f"-D{name}={value}" for name, value in settings.items()))
    targets = ("native", "plant", "thesis32", "thesis64")
    bindings = [f"binding_{name}" for name in targets]
    run("cmake", "--build", str(scratch), "--target", "dialect_generated", *bindings)
    copy(fetched / "deps", carried / "deps")
    for name in ("mavlink", "tailbeat_dialect.py"):
        copy(fetched / "generated" / name, carried / "dialect" / name)
    native = scratch / "tailbeat" / "host" / "native"
    for path in sorted([*native.rglob("_*_types.py"), *native.rglob("layout*.c")]):
        copy(path, carried / "binding" / path.name)
    image = root / "build" / "firmware"
    for name in ("tailbeat.bin", "NOTICE", "licenses"):
        if (image / name).exists():
            copy(image / name, carried / "firmware" / name)
    if build_id := described(root):
        (carried / "build_id.txt").write_text(build_id)


def described(root: Path) -> str:
    """The build id of the clone, as cmake/build_id.cmake writes it; empty without git."""
    with TemporaryDirectory() as scratch:
        header = Path(scratch) / "id.h"
        version = next(
            line.split('"')[1]
            for line in (HERE / "pyproject.toml").read_text().splitlines()
            if line.startswith("version = ")
        )
        values = {"SOURCE": root, "VERSION": version, "OUTPUT": header}
        words = [f"-D{name}={value}" for name, value in values.items()]
        run("cmake", *words, "-P", str(root / "cmake" / "build_id.cmake"))
        return header.read_text().split('"')[1]


def run(*command: str) -> None:
    """Runs a step; its output is shown when it fails."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} failed:\n{done.stdout}{done.stderr}")


def copy(there: Path, here: Path) -> None:
    """A file or a folder, without what Python has compiled; nothing when it is missing."""
    here.parent.mkdir(parents=True, exist_ok=True)
    if there.is_dir():
        shutil.copytree(
            there, here, ignore=shutil.ignore_patterns("__pycache__", ".lock", "*_cache")
        )
    elif there.exists():
        shutil.copyfile(there, here)
