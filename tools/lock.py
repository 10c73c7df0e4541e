"""Pins the Python packages: one file of exact versions with hashes for each set of packages.

All sets are resolved together, so that a package has the same version in each of them. ``run`` and
``build`` are complete; every other file holds what its set adds to them.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LOCKS = ROOT / "requirements"
BASE = ("build", "run")
HOST = "host/pyproject.toml"


@dataclass(frozen=True)
class PackageSet:
    """What is installed together. ``source``: where its packages are named; ``extra``: of HOST."""

    name: str
    source: str
    extra: str = ""

    @property
    def lock(self) -> Path:
        return LOCKS / f"{self.name}.txt"


SETS = (
    PackageSet("build", "requirements/build.in"),
    PackageSet("run", HOST),
    PackageSet("camera", HOST, "camera"),
    PackageSet("web", HOST, "web"),
    PackageSet("export", HOST, "export"),
    PackageSet("cluster", HOST, "cluster"),
    PackageSet("vboard", "tools/vboard/pyproject.toml"),
    PackageSet("test", "requirements/test.in"),
    PackageSet("dist", "requirements/dist.in"),
    PackageSet("docs", "requirements/docs.in"),
    PackageSet("develop", "requirements/develop.in"),
)


def compile_pins(uv: str, output: Path, options: list[str]) -> None:
    """Resolves for every platform and Python from 3.11 on."""
    command = [uv, "pip", "compile", "--quiet", "--universal", "--python-version", "3.11"]
    command += ["--no-annotate", "--no-emit-index-url", "--custom-compile-command", "make lock"]
    subprocess.run([*command, *options, "-o", str(output)], cwd=ROOT, check=True)


def resolve_all(uv: str, output: Path, upgrade: bool) -> None:
    """Writes the pins of all sets; without ``upgrade`` the same as before where possible."""
    locks = [found.lock.read_text() for found in SETS if found.lock.exists()]
    output.write_text("" if upgrade else "".join(locks))
    sources = sorted({found.source for found in SETS})
    extras = [word for found in SETS if found.extra for word in ("--extra", found.extra)]
    compile_pins(uv, output, [*sources, *extras])


def names_in(lock: Path) -> list[str]:
    """Packages that a file pins."""
    return sorted(set(re.findall(r"^([a-z0-9.-]+)==", lock.read_text(), re.MULTILINE)))


def lock_set(uv: str, wanted: PackageSet, pins: Path) -> None:
    """Writes the file of one set."""
    options = [wanted.source, "--constraint", str(pins), "--generate-hashes", "--upgrade"]
    if wanted.extra:
        options += ["--extra", wanted.extra]
    if wanted.name not in BASE:
        base = {name for found in SETS if found.name in BASE for name in names_in(found.lock)}
        options += [word for name in sorted(base) for word in ("--no-emit-package", name)]
    compile_pins(uv, wanted.lock, options)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--uv", default="uv", help="the program uv")
    parser.add_argument("--upgrade", action="store_true", help="take the newest versions")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        pins = Path(scratch) / "pins.txt"
        resolve_all(options.uv, pins, options.upgrade)
        for wanted in SETS:
            lock_set(options.uv, wanted, pins)


if __name__ == "__main__":
    main()
