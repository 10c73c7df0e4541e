"""Licenses go where the code goes: into the wheel and beside the image; the bill of materials names
everything that is installed or built in."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from importlib.metadata import distribution
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
HOST = ROOT / "host"
TEXTS = ("NOTICE", "licenses/littlefs.txt", "licenses/mavlink.txt", "licenses/tailbeat.txt")


def test_the_wheel_carries_them() -> None:
    wheel = distribution("tailbeat")
    files = {str(path): path for path in wheel.files or ()}
    for name in TEXTS:
        (found,) = (path for path in files if path.endswith(f".dist-info/licenses/{name}"))
        assert wheel.locate_file(files[found]).read_bytes() == (HOST / name).read_bytes()
    assert wheel.metadata["License-Expression"] == "MIT AND BSD-3-Clause"


def test_they_are_the_originals() -> None:
    assert (HOST / "licenses/tailbeat.txt").read_bytes() == (ROOT / "LICENSE").read_bytes()
    fetched = ROOT / "build/deps/littlefs/LICENSE.md"
    if not fetched.is_file():
        pytest.skip("littlefs comes from another folder here")
    assert (HOST / "licenses/littlefs.txt").read_bytes() == fetched.read_bytes()


def test_the_notice_names_each_text() -> None:
    named = set(re.findall(r"licenses/\w+\.txt", (HOST / "NOTICE").read_text(encoding="utf-8")))
    assert named == {*TEXTS[1:], "licenses/newlib.txt"}  # the last is the toolchain's


def test_the_bill_of_materials_is_complete(tmp_path: Path) -> None:
    out = tmp_path / "sbom.json"
    for _ in range(2):
        before = out.read_bytes() if out.exists() else None
        subprocess.run([sys.executable, ROOT / "tools/sbom.py", "--out", out], check=True)
    assert out.read_bytes() == before  # no dates, no random numbers
    bill = json.loads(out.read_bytes())
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.6")
    assert re.fullmatch(r"urn:uuid:[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}", bill["serialNumber"])
    components = {one["bom-ref"]: one for one in bill["components"]}
    assert len(components) == len(bill["components"])
    assert set(components) == set(bill["dependencies"][0]["dependsOn"])
    pins = {
        f"pkg:pypi/{name.lower()}@{version}"
        for lock in (ROOT / "requirements").glob("*.txt")
        for name, version in re.findall(r"^([\w.-]+)==([^\s;\\]+)", lock.read_text(), re.MULTILINE)
    }
    assert len(pins) > 50
    assert set(components) == pins | {"c/littlefs", "c/mavlink-generated-headers", "c/newlib"}
    for ref in pins:
        hashes = [one["hashes"][0]["content"] for one in components[ref]["externalReferences"]]
        assert hashes and all(len(digest) == 64 for digest in hashes)
    numpy = next(one for ref, one in components.items() if ref.startswith("pkg:pypi/numpy@"))
    assert numpy["scope"] == "required"
    (pytest_,) = (one for one in components.values() if one["name"] == "pytest")
    assert pytest_["scope"] == "optional"
