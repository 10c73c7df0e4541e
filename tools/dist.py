"""Builds what is published: the source distribution and a wheel for each kind of computer, for the
host tool and for the emulator. The same commit gives the same bytes.

The wheels are built from the source distribution, with the C compiler of the package ziglang, which
compiles for all of them. Usage: tools/dist.py [--out FOLDER] [PLATFORM ...]
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VBOARD = ROOT / "tools" / "vboard"


@dataclass(frozen=True)
class Platform:
    """``tag``: of the wheel. ``target``: of the compiler."""

    name: str
    tag: str
    target: str


PLATFORMS = (
    Platform("linux-x86_64", "manylinux_2_17_x86_64", "x86_64-linux-gnu.2.17"),
    Platform("linux-aarch64", "manylinux_2_17_aarch64", "aarch64-linux-gnu.2.17"),
    Platform("macos-arm64", "macosx_11_0_arm64", "aarch64-macos.11.0"),
    Platform("macos-x86_64", "macosx_11_0_x86_64", "x86_64-macos.11.0"),
    Platform("windows-x86_64", "win_amd64", "x86_64-windows-gnu"),
)


def commit_time() -> str:
    """Of the last commit: the time that every file of an archive gets."""
    words = ["git", "-C", str(ROOT), "log", "-1", "--format=%ct"]
    return subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()


def source_distribution(out: Path) -> Path:
    """Builds the host tool's source distribution; its path."""
    script = f"import build_backend; print(build_backend.build_sdist({str(out)!r}))"
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=ROOT / "host",
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return out / done.stdout.split()[-1]


def compilers(folder: Path, target: str) -> Path:
    """A folder with cc, ar and ranlib for ``target``."""
    folder.mkdir(parents=True, exist_ok=True)
    commands = {"cc": f"cc -target {target}", "ar": "ar", "ranlib": "ranlib"}
    for name, words in commands.items():
        script = folder / name
        script.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m ziglang {words} "$@"\n')
        script.chmod(0o755)
    return folder


def wheel(source: Path, platform: Platform, work: Path, out: Path, defines: dict[str, str]) -> None:
    """Builds one wheel of the package in ``source``."""
    build = work / "build"
    shutil.rmtree(build, ignore_errors=True)
    settings = {
        "wheel.tags": f"py3-none-{platform.tag}",
        "build-dir": str(build),
        "install.strip": "false",  # the linker does it, for every platform
        "cmake.args": f"--toolchain={ROOT / 'cmake' / 'zig.cmake'}",
        **{f"cmake.define.{name}": value for name, value in defines.items()},
    }
    words = [f"--config-settings={name}={value}" for name, value in settings.items()]
    tools = compilers(work / "tools", platform.target)
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check"]
    pip += ["--no-deps", "--no-build-isolation", "--wheel-dir", str(out)]
    environment = {"TAILBEAT_ZIG_TARGET": platform.target, "TAILBEAT_ZIG_TOOLS": str(tools)}
    subprocess.run([*pip, *words, str(source)], check=True, env=os.environ | environment)


def build_all(platforms: list[Platform], out: Path) -> None:
    """Everything into ``out``, with its check sums in SHA256SUMS."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    packed = source_distribution(out)
    work = out.parent / "dist_work"
    shutil.rmtree(work, ignore_errors=True)
    with tarfile.open(packed) as archive:
        archive.extractall(work / "source", filter="data")
    (source,) = (work / "source").iterdir()
    for platform in platforms:
        print(f"{platform.name}", file=sys.stderr)
        place = work / platform.name
        wheel(source, platform, place / "tailbeat", out, {"TAILBEAT_SELFTEST": "ON"})
        wheel(VBOARD, platform, place / "vboard", out, {})
    sums = [
        f"{hashlib.sha256(p.read_bytes()).hexdigest()}  {p.name}\n" for p in sorted(out.iterdir())
    ]
    (out / "SHA256SUMS").write_text("".join(sums))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "dist")
    names = [platform.name for platform in PLATFORMS]
    parser.add_argument("platforms", nargs="*", metavar="PLATFORM", help=", ".join(names))
    options = parser.parse_args()
    if unknown := set(options.platforms) - set(names):
        parser.error(f"no platform {', '.join(sorted(unknown))}; there are {', '.join(names)}")
    chosen = [p for p in PLATFORMS if not options.platforms or p.name in options.platforms]
    os.environ["SOURCE_DATE_EPOCH"] = commit_time()
    build_all(chosen, options.out.resolve())


if __name__ == "__main__":
    main()
