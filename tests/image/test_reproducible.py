"""The image is the same, byte for byte, wherever it is built."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = ("CMakeLists.txt", "cmake", "firmware", "hal", "host", "sim", "tools", "wire")
FETCHED = ("deps", "generated")
IMAGE = ROOT / "build" / "firmware"
# The copy, which is in no repository, gets the same build id.
WITH_GIT = {**os.environ, "GIT_DIR": str(ROOT / ".git"), "GIT_WORK_TREE": str(ROOT)}


def copy_sources(to: Path) -> Path:
    for name in SOURCES:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, to / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            to.mkdir(parents=True)
            shutil.copy2(source, to / name)
    for name in FETCHED:
        shutil.copytree(ROOT / "build" / name, to / "build" / name)
    return to


def configure(source: Path, build: Path) -> None:
    command = ["cmake", "-S", source, "-B", build, "-G", "Ninja", "--log-level=WARNING"]
    options = {
        "CMAKE_TOOLCHAIN_FILE": source / "cmake" / "cortex-m3.cmake",
        "Python_EXECUTABLE": sys.executable,
        "TAILBEAT_TESTS": "OFF",
        "TAILBEAT_NATIVE": "OFF",
    }
    command += [f"-D{name}={value}" for name, value in options.items()]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def test_no_folder_of_this_machine_is_in_it() -> None:
    assert str(ROOT).encode() not in (IMAGE / "tailbeat.elf").read_bytes()


@pytest.mark.soak
def test_same_bytes_in_different_folders(tmp_path: Path) -> None:
    """The one that `make firmware` built just now, and a copy of its sources, built elsewhere."""
    there = tmp_path / "somewhere" / "else" / "build"
    configure(copy_sources(tmp_path / "somewhere" / "sources"), there)
    command = ["cmake", "--build", there, "--target", "tailbeat_image", "--", "--quiet", "-j1"]
    subprocess.run(command, check=True, env=WITH_GIT)
    for name in ("tailbeat.bin", "tailbeat.elf"):
        same = (IMAGE / name).read_bytes() == (there / name).read_bytes()
        assert same, f"{name} differs, unless sources changed since: make firmware"
    assert str(tmp_path).encode() not in (there / "tailbeat.elf").read_bytes()
