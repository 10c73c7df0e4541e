"""What the host tool does with the packages of its base installation alone."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import tailbeat
from tailbeat.core import extras
from tailbeat.core.errors import InputError

# Runs as a process of its own: refuses what is not listed, then does what the arguments say.
BLOCKER = """
import importlib, json, sys

blocked = set(json.loads(sys.argv[1]))

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in blocked:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Refuse())
"""
IMPORT_ALL = """
from tailbeat.core.errors import InputError

refused = []
for name in json.loads(sys.argv[2]):
    try:
        importlib.import_module(name)
    except (ModuleNotFoundError, InputError):
        refused.append(name)
print(json.dumps(refused))
"""
RUN_COMMANDS = """
from tailbeat.app.cli import main

for words in json.loads(sys.argv[2]):
    sys.argv = ["tailbeat", *words]
    try:
        status = main()
    except SystemExit as end:
        status = end.code
    print(f"# {words[0]} {status or 0}", flush=True)
"""


def base_packages() -> set[str]:
    """The packages that installing tailbeat without extras brings."""
    found, todo = set[str](), ["tailbeat"]
    while todo:
        name = canonicalize_name(todo.pop())
        if name in found:
            continue
        try:
            lines = requires(name) or []
        except PackageNotFoundError:
            continue
        found.add(name)
        needed = [Requirement(line) for line in lines]
        todo += [one.name for one in needed if not one.marker or one.marker.evaluate()]
    return found


@pytest.fixture(scope="module")
def blocked() -> str:
    """All other top-level modules that are installed here."""
    base = base_packages()
    assert {"numpy", "typer", "cffi"} <= base
    assert not {"pymavlink", "pyarrow", "lxml", "nicegui", "opencv-python-headless"} & base
    modules = [
        module
        for module, packages in packages_distributions().items()
        if not {canonicalize_name(package) for package in packages} & base
    ]
    assert {"pymavlink", "pyarrow", "cv2", "nicegui", "unicorn"} <= set(modules)
    return json.dumps(modules)


def run(script: str, *words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", BLOCKER + script, *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def modules() -> list[str]:
    """All Python modules of the installed package."""
    top = Path(tailbeat.__file__).parent
    files = [
        path.relative_to(top).with_suffix("")
        for path in sorted(top.rglob("*.py"))
        if "examples" not in path.parts
    ]
    return [".".join(("tailbeat", *file.parts)).removesuffix(".__init__") for file in files]


def test_modules_import_without_the_extras(blocked: str, tmp_path: Path) -> None:
    names = [name for name in modules() if not name.endswith("__main__")]
    done = run(IMPORT_ALL, blocked, json.dumps(names), folder=tmp_path)
    assert done.returncode == 0, done.stderr
    refused = json.loads(done.stdout)
    assert refused
    web = ("tailbeat.app.web.", "tailbeat.app.cli.web")
    assert all(name.startswith(web) for name in refused), refused


def test_commands_run_without_the_extras(blocked: str, tmp_path: Path) -> None:
    commands = [
        "sim demo --law p --trials 1 --out series",
        "report series --paper",
        "experiment export series --format parquet",
        "experiment export series --mcap",
        "sim montecarlo --list",
        "sim montecarlo designed-law",
        "session web",
        "camera print ruler",
    ]
    words = json.dumps([line.split() for line in commands])
    done = run(RUN_COMMANDS, blocked, words, folder=tmp_path)
    status = [line for line in done.stdout.splitlines() if line.startswith("# ")]
    assert status == [
        "# sim 0",
        "# report 0",
        "# experiment 1",
        "# experiment 1",
        "# sim 0",
        "# sim 1",
        "# session 1",
        "# camera 1",
    ]
    lines = done.stderr.splitlines()
    assert len(lines) == 6, done.stderr
    for line, extra in zip(lines, (*["export"] * 4, "web", "camera"), strict=True):
        assert line.startswith("tailbeat: ")
        assert line.endswith(f"tools/bootstrap {extra}")
    tables = {path.suffix for path in (tmp_path / "series" / "report" / "tables").iterdir()}
    assert tables == {".csv", ".mat"}


def test_remedy_outside_of_a_clone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "checkout", lambda: None)
    assert "-m pip install 'nicegui>=" in extras.remedy("web")
    assert "'av>=14' 'opencv-python-headless==" in extras.remedy("camera")
    assert "'tailbeat-vboard'" in extras.remedy("vboard")
    with pytest.raises(
        InputError, match=r"^It needs nonsense, which is not installed\. Install it: "
    ):
        extras.need("no_such_module", "web", "It needs nonsense")
