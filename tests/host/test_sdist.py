"""The source distribution has all that building the wheel needs."""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
from pathlib import Path

HOST = Path(__file__).resolve().parents[2] / "host"
BUILD = "import sys, build_backend; build_backend.build_sdist(sys.argv[1])"


def test_the_source_distribution_carries_the_c_sources(tmp_path: Path) -> None:
    command = [sys.executable, "-c", BUILD, str(tmp_path)]
    subprocess.run(
        command,
        cwd=HOST,
        env={"PYTHONPATH": ".", "PATH": os.environ["PATH"]},
        capture_output=True,
        check=True,
    )
    (archive,) = tmp_path.glob("tailbeat-*.tar.gz")
    with tarfile.open(archive) as tar:
        names = {name.partition("/")[2] for name in tar.getnames()}
    root = HOST.parent
    c_files = [
        path.relative_to(root)
        for folder in ("firmware", "hal", "sim", "host/native", "wire", "cmake")
        for path in (root / folder).rglob("*")
        if path.suffix in (".c", ".h", ".def", ".cmake", ".xml") or path.name == "CMakeLists.txt"
    ]
    assert len(c_files) > 150
    assert {f"source/{path}" for path in c_files} <= names
    assert {"CMakeLists.txt", "pyproject.toml", "build_backend.py"} <= names
    assert {"source/CMakeLists.txt", "source/tools/fetch_deps.py"} <= names
    assert "tailbeat/app/cli/__init__.py" in names
    assert not (HOST / "source").exists()
