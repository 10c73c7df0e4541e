"""The pinned packages: each set holds what its source names, with hashes, and all sets agree."""

from __future__ import annotations

import re
import subprocess
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from lock import BASE, SETS, PackageSet, names_in

ROOT = Path(__file__).resolve().parents[3]
PIN = re.compile(r"^([a-z0-9.-]+)==(\S+)(?: ; (.*?))? \\$", re.MULTILINE)


def named(source: PackageSet) -> list[Requirement]:
    """What the source of a set asks for."""
    text = (ROOT / source.source).read_text(encoding="utf-8")
    if source.source.endswith(".toml"):
        project = tomllib.loads(text)["project"]
        lines = project["optional-dependencies"][source.extra] if source.extra else None
        return [Requirement(line) for line in lines or project["dependencies"]]
    return [Requirement(line) for line in text.splitlines() if line and line[0] != "#"]


@pytest.mark.parametrize("found", SETS, ids=lambda found: found.name)
def test_a_set_holds_what_its_source_names(found: PackageSet) -> None:
    base = {name for one in SETS if one.name in BASE for name in names_in(one.lock)}
    pinned = {*names_in(found.lock), *(() if found.name in BASE else base)}
    wanted = {canonicalize_name(one.name) for one in named(found)}
    assert wanted and wanted <= pinned, "run: make lock KEEP=1"


@pytest.mark.parametrize("found", SETS, ids=lambda found: found.name)
def test_every_pin_has_hashes_and_no_place(found: PackageSet) -> None:
    text = found.lock.read_text(encoding="utf-8")
    entries = re.split(r"^(?=[a-z0-9])", text, flags=re.MULTILINE)[1:]
    assert len(entries) == len(PIN.findall(text))
    assert all("--hash=sha256:" in entry for entry in entries)
    assert "://" not in text and "--index" not in text


def test_a_package_has_one_version_in_all_sets() -> None:
    versions: dict[tuple[str, str], set[str]] = {}
    for found in SETS:
        for name, version, marker in PIN.findall(found.lock.read_text(encoding="utf-8")):
            versions.setdefault((name, marker), set()).add(version)
    assert len(versions) > 100
    assert {key: many for key, many in versions.items() if len(many) > 1} == {}


def test_bootstrap_names_a_set_that_it_does_not_know() -> None:
    done = subprocess.run(
        [ROOT / "tools" / "bootstrap", "nonsense"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "EXTRA:  camera, web, export, cluster, vboard" in done.stderr
