"""Writes the software bill of materials: CycloneDX 1.6 as JSON, from the pinned packages and the C
sources. The same sources give the same bytes.

Usage: tools/sbom.py --out build/sbom.json
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import uuid
from pathlib import Path
from typing import Any

from fetch_deps import DEPENDENCIES
from lock import LOCKS, ROOT

_PIN = re.compile(r"^([A-Za-z0-9._-]+)==([^\s;\\]+)")
_HASH = re.compile(r"--hash=sha256:([0-9a-f]{64})")
_NAMESPACE = uuid.UUID("8a4f1c6e-0d0f-5c55-9d6e-7a11bea7f15c")
_LFS_VERSION = re.compile(r"#define LFS_VERSION 0x([0-9a-f]{8})")
_SHIPPED = ("build", "run")  # sets without which nothing is built or runs

Component = dict[str, Any]


def pinned_packages() -> list[Component]:
    """Every package of the lock files; ``tailbeat:set``: the sets that name it."""
    found: dict[str, Component] = {}
    for lock in sorted(LOCKS.glob("*.txt")):
        package: Component | None = None
        for line in lock.read_text(encoding="utf-8").splitlines():
            if pin := _PIN.match(line):
                package = _package(found, pin[1], pin[2], lock.stem)
            if package is not None:
                for digest in _HASH.findall(line):
                    _add_archive(package, digest)
    return [found[ref] for ref in sorted(found)]


def _package(found: dict[str, Component], name: str, version: str, group: str) -> Component:
    ref = f"pkg:pypi/{name.lower()}@{version}"
    package = found.setdefault(
        ref,
        {
            "type": "library",
            "bom-ref": ref,
            "name": name,
            "version": version,
            "purl": ref,
            "scope": "optional",
            "properties": [],
            "externalReferences": [],
        },
    )
    if group in _SHIPPED:
        package["scope"] = "required"
    package["properties"].append({"name": "tailbeat:set", "value": group})
    return package


def _add_archive(package: Component, digest: str) -> None:
    """One of the files that pip may install."""
    archive = {
        "type": "distribution",
        "url": package["purl"],
        "hashes": [{"alg": "SHA-256", "content": digest}],
    }
    if archive not in package["externalReferences"]:
        package["externalReferences"].append(archive)


def c_sources() -> list[Component]:
    """What is compiled into the shared library and the flash image."""
    littlefs = DEPENDENCIES["littlefs"]
    source = f"pkg:pypi/{littlefs.package}@{littlefs.version}"
    mavlink = re.search(r"^pymavlink==(\S+)", (LOCKS / "build.txt").read_text(), re.MULTILINE)
    assert mavlink is not None
    return [
        _c_library("littlefs", _littlefs_version(), "BSD-3-Clause", source, "library and image"),
        _c_library(
            "mavlink-generated-headers",
            mavlink[1],
            "MIT",
            f"pkg:pypi/pymavlink@{mavlink[1]}",
            "library and image",
        ),
        _c_library("newlib", _newlib_version(), "", "", "image; of the toolchain"),
    ]


def _c_library(name: str, version: str, license_id: str, source: str, where: str) -> Component:
    component: Component = {
        "type": "library",
        "bom-ref": f"c/{name}",
        "name": name,
        "scope": "required",
        "properties": [{"name": "tailbeat:in", "value": where}],
    }
    if version:
        component["version"] = version
    if license_id:
        component["licenses"] = [{"license": {"id": license_id}}]
    if source:
        component["properties"].append({"name": "tailbeat:source", "value": source})
    return component


def _littlefs_version() -> str:
    """Of the sources that were fetched; empty before the first build."""
    header = ROOT / "build" / "deps" / "littlefs" / "lfs.h"
    found = _LFS_VERSION.search(header.read_text(encoding="utf-8")) if header.is_file() else None
    if found is None:
        return ""
    return f"{int(found[1][:4], 16)}.{int(found[1][4:], 16)}"


def _newlib_version() -> str:
    """Of the installed toolchain; empty without one."""
    command = ["arm-none-eabi-gcc", "-E", "-dM", "-include", "_newlib_version.h", "-xc", "-"]
    try:
        told = subprocess.run(command, input="", capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return ""
    found = re.search(r'_NEWLIB_VERSION "([^"]+)"', told)
    return found[1] if found else ""


def _own_version() -> str:
    text = (ROOT / "host" / "pyproject.toml").read_text(encoding="utf-8")
    found = re.search(r'^version = "([^"]+)"', text, re.MULTILINE)
    assert found is not None
    return found[1]


def document() -> dict[str, Any]:
    """The whole bill."""
    version = _own_version()
    own = {
        "type": "application",
        "bom-ref": "tailbeat",
        "name": "tailbeat",
        "version": version,
        "licenses": [{"license": {"id": "MIT"}}],
    }
    components = [*c_sources(), *pinned_packages()]
    content = json.dumps([own, components], sort_keys=True)
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{uuid.uuid5(_NAMESPACE, content)}",
        "version": 1,
        "metadata": {"component": own},
        "components": components,
        "dependencies": [{"ref": "tailbeat", "dependsOn": [one["bom-ref"] for one in components]}],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "sbom.json")
    out = parser.parse_args().out
    out.parent.mkdir(parents=True, exist_ok=True)
    bill = document()
    out.write_text(json.dumps(bill, indent=1) + "\n", encoding="utf-8")
    print(f"{out}: {len(bill['components'])} components")


if __name__ == "__main__":
    main()
