"""Fetches the C sources of Unity and littlefs out of pinned, hash-checked packages.

Does nothing, and needs no network, when they are there and right.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath


@dataclass(frozen=True)
class Dependency:
    """Some files of one folder of a source package."""

    package: str
    version: str
    sha256: str
    folder: str
    variable: str
    files: dict[str, str | None]


DEPENDENCIES = {
    "unity": Dependency(
        package="pytest-unity",
        version="0.1.0",
        sha256="cd3ceb4aeb4f7866f935957f91874999d8ae13ff014684464ade0b7071e28298",
        folder="vendor/unity/src",
        variable="UNITY_DIR",
        files={
            "unity.c": "a6cc4b143075a03317d72c760b5ed67a4a12eeda1242f575464ad23f34042275",
            "unity.h": "b30ba4db1e0be1a1f6c862d359d73c91025a114977e41d3dad17103363804334",
            "unity_internals.h": "35bffad23ebc533977291e7a848c646027513572268fbfa9bd03d5ec21ee818a",
        },
    ),
    "littlefs": Dependency(
        package="littlefs-python",
        version="0.19.0",
        sha256="4ce8c6eeeb2703abaf8cb60f2dab624b17af42b13df3dbc6c42d4142bad79a59",
        folder="littlefs",
        variable="LITTLEFS_DIR",
        files={
            "lfs.c": "a36d6a095785ddea9571d541d68d3e4ef01d5b255a99d17d3f07fb6ea60ea132",
            "lfs.h": "b1befd7288d08815accc8f9af744c55686c0b9e3ac0061c32ceee38a1b3eb96d",
            "lfs_util.c": "f2fbde533670560434bd9f5a547174cc7c5a4670a02c47b4bd85180dced8b2ec",
            "lfs_util.h": "548d46aa524dc7449e16739286c1a422a52f9de727ff0be0c2ffc5593f5ca981",
            "LICENSE.md": None,
        },
    ),
}


def is_right(content: bytes, sha256: str | None) -> bool:
    return sha256 is None or hashlib.sha256(content).hexdigest() == sha256


def is_present(dependency: Dependency, folder: Path) -> bool:
    """Whether every wanted file is in |folder| with the right content."""
    paths = ((folder / name, sha256) for name, sha256 in dependency.files.items())
    return all(path.is_file() and is_right(path.read_bytes(), sha256) for path, sha256 in paths)


def download(dependency: Dependency, into: Path) -> Path:
    """Downloads the source package; pip checks its hash."""
    wanted = into / "requirement.txt"
    pin = f"{dependency.package}=={dependency.version}"
    wanted.write_text(f"{pin} --hash=sha256:{dependency.sha256}\n")
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--require-hashes"]
    command += ["--no-binary", dependency.package, "--dest", str(into), "-r", str(wanted)]
    # Within a build, pip would look for this package's build system in that of the host tool.
    env = {key: value for key, value in os.environ.items() if not key.startswith("_PYPROJECT_")}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=env)
    archives = list(into.glob("*.tar.gz"))
    if done.returncode != 0 or len(archives) != 1:
        raise SystemExit(
            f"{pin} could not be downloaded:\n{done.stderr}\n"
            f"Check the network, or set {dependency.variable} to a folder with its sources."
        )
    return archives[0]


def unpack(dependency: Dependency, archive: Path, folder: Path) -> None:
    """Writes the wanted files, and only those, into |folder|."""
    folder.mkdir(parents=True, exist_ok=True)
    with tarfile.open(archive) as tar:
        for member in tar:
            inner = PurePosixPath(*PurePosixPath(member.name).parts[1:])
            if str(inner.parent) != dependency.folder or inner.name not in dependency.files:
                continue
            source = tar.extractfile(member)
            if source is None or not is_right(
                content := source.read(), dependency.files[inner.name]
            ):
                raise SystemExit(f"{member.name} is not the pinned file; nothing was installed")
            (folder / inner.name).write_bytes(content)


def fetch(name: str, into: Path) -> None:
    """Makes |into|/|name| hold the dependency."""
    dependency, folder = DEPENDENCIES[name], into / name
    if is_present(dependency, folder):
        return
    print(f"fetching {name} ({dependency.package} {dependency.version})", file=sys.stderr)
    with tempfile.TemporaryDirectory() as scratch:
        archive = download(dependency, Path(scratch))
        shutil.rmtree(folder, ignore_errors=True)
        unpack(dependency, archive, folder)
    if not is_present(dependency, folder):
        raise SystemExit(f"{dependency.package} lacks some of {', '.join(dependency.files)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--into", type=Path, required=True, help="folder to put them in")
    parser.add_argument("names", nargs="+", choices=sorted(DEPENDENCIES))
    options = parser.parse_args()
    options.into.mkdir(parents=True, exist_ok=True)
    with (options.into / ".lock").open("w") as lock:
        if sys.platform != "win32":
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX)
        for name in options.names:
            fetch(name, options.into)


if __name__ == "__main__":
    main()
