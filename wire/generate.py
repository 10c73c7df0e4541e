"""Generates the MAVLink dialect, C headers and a Python module, from tailbeat.xml.

The XML files it includes come from the installed pymavlink. Nothing is done when no input changed;
the output is the same on every run for the same input.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

HERE = Path(__file__).resolve().parent


def pymavlink_dialects() -> Path:
    """Folder of the dialect definitions that come with pymavlink."""
    # The package writes to its environment on import, so it is found without importing it.
    from importlib.util import find_spec

    spec = find_spec("pymavlink")
    if spec is None or spec.origin is None:
        raise SystemExit("pymavlink is missing: pip install pymavlink==2.4.50")
    return Path(spec.origin).parent / "dialects" / "v20"


def with_includes(xml: Path, base: Path) -> dict[str, Path]:
    """|xml| and all files it includes, by name."""
    found: dict[str, Path] = {}
    todo = [xml]
    while todo:
        path = todo.pop()
        if path.name in found:
            continue
        found[path.name] = path
        todo += [
            base / (node.text or "").strip() for node in ElementTree.parse(path).iter("include")
        ]
    return found


def digest_of(inputs: dict[str, Path]) -> str:
    """One hash over everything that decides the output."""
    digest = hashlib.sha256(version("pymavlink").encode())
    for path in [Path(__file__), *(inputs[name] for name in sorted(inputs))]:
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def mavgen(language: str, output: Path, xml: Path) -> None:
    """Runs pymavlink's generator."""
    command = [sys.executable, "-m", "pymavlink.tools.mavgen", "--wire-protocol=2.0"]
    command += [f"--lang={language}", "--no-validate", "-o", str(output), str(xml)]
    # Without a fixed hash seed the generated headers differ from run to run.
    env = {**os.environ, "PYTHONHASHSEED": "0"}
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    if done.returncode != 0 or not output.exists():
        raise SystemExit(f"mavgen failed:\n{done.stdout}{done.stderr}")


def drop_build_dates(headers: Path) -> None:
    """Takes the date of generation out of the headers."""
    for path in headers.glob("*/version.h"):
        text = path.read_text()
        path.write_text(re.sub(r'(MAVLINK_BUILD_DATE) ".*"', r'\1 ""', text))


def generate(inputs: dict[str, Path], into: Path) -> None:
    """Writes xml/, mavlink/ and tailbeat_dialect.py below |into|."""
    work = into / "new"
    shutil.rmtree(work, ignore_errors=True)
    (work / "xml").mkdir(parents=True)
    for name, path in inputs.items():
        shutil.copyfile(path, work / "xml" / name)
    mavgen("C", work / "mavlink", work / "xml" / "tailbeat.xml")
    drop_build_dates(work / "mavlink")
    mavgen("Python3", work / "tailbeat_dialect.py", work / "xml" / "tailbeat.xml")
    for name in ("xml", "mavlink"):
        shutil.rmtree(into / name, ignore_errors=True)
    for path in work.iterdir():
        path.replace(into / path.name)
    work.rmdir()


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keeps two builds that share |folder| from generating at the same time."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--into", type=Path, required=True, help="folder to write to")
    parser.add_argument("--stamp", type=Path, help="file to touch when done")
    options = parser.parse_args()
    into: Path = options.into
    inputs = with_includes(HERE / "tailbeat.xml", pymavlink_dialects())
    digest = digest_of(inputs)
    with locked(into):
        done = into / "dialect.sha256"
        if not done.exists() or done.read_text() != digest:
            done.unlink(missing_ok=True)
            generate(inputs, into)
            done.write_text(digest)
    if options.stamp:
        options.stamp.touch()


if __name__ == "__main__":
    main()
