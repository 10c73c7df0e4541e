"""The image is the same, byte for byte, wherever it is built."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCES = ("CMakeLists.txt", "cmake", "firmware", "hal", "host", "tools", "wire")
FETCHED = ("deps", "generated")
# Both build ids are the bare version: the copy is in no repository.
WITHOUT_GIT = {**os.environ, "GIT_DIR": os.devnull}


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


def test_same_bytes_in_different_folders(tmp_path: Path) -> None:
    here = tmp_path / "here"
    there = tmp_path / "somewhere" / "else" / "build"
    configure(ROOT, here)
    configure(copy_sources(tmp_path / "somewhere" / "sources"), there)
    builds = [
        subprocess.Popen(
            ["cmake", "--build", build, "--target", "tailbeat_image", "--", "--quiet", "-j1"],
            env=WITHOUT_GIT,
        )
        for build in (here, there)
    ]
    assert [build.wait() for build in builds] == [0, 0]
    for name in ("tailbeat.bin", "tailbeat.elf"):
        assert (here / name).read_bytes() == (there / name).read_bytes(), name
    assert str(tmp_path).encode() not in (here / "tailbeat.elf").read_bytes()
    assert str(ROOT).encode() not in (here / "tailbeat.elf").read_bytes()
