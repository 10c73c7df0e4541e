"""Checks who includes whom among the C files, by folder.

Prints one line per offence and exits with 1 when there is one.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator
from pathlib import Path

INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"', re.MULTILINE)

PURE = ("base", "blink", "params", "gait", "ilc", "imu", "speed", "supervisor")
GENERATED = ("tailbeat/mavlink.h", "checksum.h", "lfs.h", "build_id_generated.h")

# What the C files of a folder may include: prefixes of include paths. Files beside the including
# one, written without a folder, are always allowed.
PURE_ALLOWED = {
    "base": ("base/",),
    "blink": ("blink/",),
    "params": ("base/", "params/"),
    "gait": ("base/", "gait/"),
    "ilc": ("base/", "ilc/"),
    "imu": ("base/", "imu/"),
    "speed": ("base/", "imu/frame.h", "speed/"),
    "supervisor": ("base/", "supervisor/"),
}
PURE_PREFIXES = tuple(f"{name}/" for name in PURE)
# A chip's folder shares what all chips of its core have (hal/cortex_m3).
CHIP_ALLOWED = ("base/", "hal/", "registers/", "app/app.h", "crash.h", "memory_map.h")
ALLOWED: dict[str, tuple[str, ...]] = {
    **{f"firmware/{name}": allowed for name, allowed in PURE_ALLOWED.items()},
    "firmware/store": (*PURE_PREFIXES, "store/", "hal/flash.h", "hal/system.h", "lfs.h"),
    "firmware/link": (*PURE_PREFIXES, "store/", "link/", "hal/", *GENERATED),
    "firmware/settings": (*PURE_PREFIXES, "settings/"),
    "firmware/learn": (*PURE_PREFIXES, "settings/", "store/", "learn/"),
    "firmware/trial": (*PURE_PREFIXES, "settings/", "store/", "link/", "learn/", "trial/", "hal/"),
    "firmware/app": (*PURE_PREFIXES, "settings/", "store/", "link/", "learn/", "trial/", "app/", "hal/"),
    "hal/include/hal": ("hal/",),
    "hal/cortex_m3/registers": ("registers/",),
    "hal/cortex_m3": ("base/", "hal/", "registers/"),
    "hal/sam3x8e/registers": ("registers/",),
    "hal/sam3x8e": CHIP_ALLOWED,
    "hal/smartfusion2": CHIP_ALLOWED,
    "hal/template": ("base/", "hal/", "app/app.h"),
}


def c_offences(root: Path) -> Iterator[str]:
    """Forbidden includes in C files."""
    for folder, allowed in ALLOWED.items():
        for path in sorted((root / folder).rglob("*.[ch]")):
            for name in INCLUDE.findall(path.read_text(encoding="utf-8")):
                beside = "/" not in name and (path.parent / name).is_file()
                if not beside and not name.startswith(allowed):
                    yield f"{path.relative_to(root)}: {folder} must not include {name}"


def unknown_folders(root: Path) -> Iterator[str]:
    """Folders of the firmware for which no rule exists."""
    for path in sorted((root / "firmware").rglob("*.[ch]")):
        if str(path.parent.relative_to(root)) not in ALLOWED:
            yield f"{path.relative_to(root)}: its folder has no rule in tools/check_includes.py"


def offences(root: Path) -> list[str]:
    """Everything that is wrong below |root|."""
    return [*c_offences(root), *unknown_folders(root)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    default = Path(__file__).resolve().parent.parent
    parser.add_argument("root", type=Path, nargs="?", default=default)
    found = offences(parser.parse_args().root)
    print("\n".join(found) or "includes: all as the layers allow")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
