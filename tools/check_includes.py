"""Checks who includes whom among the C files, by folder, that no folder has a circle inside,
and who moves the servo.

A module is a pair of x.c and x.h. It depends on another one of its folder when it includes its
header, and when its .c uses a function that the other's .c defines, wherever that is declared.

Prints one line per offence and exits with 1 when there is one.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import deque
from collections.abc import Collection, Iterator
from itertools import pairwise
from pathlib import Path

INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"', re.MULTILINE)

PURE = ("base", "blink", "params", "gait", "ilc", "imu", "monitor", "speed", "supervisor")
GENERATED = ("tailbeat/mavlink.h", "checksum.h", "lfs.h", "build_id_generated.h")

# What stands in for a board that the conformance suite is tried on.
CONFORMANCE = ("faults/", "sim.h", "board.h", "registers/")

# What the C files of a folder may include: prefixes of include paths. Files beside the including
# one, written without a folder, are always allowed.
PURE_ALLOWED = {
    "base": ("base/",),
    "blink": ("blink/",),
    "params": ("base/", "params/"),
    "gait": ("base/", "gait/"),
    "ilc": ("base/", "ilc/"),
    "imu": ("base/", "imu/"),
    # The supervisor of last resort relies on as little as possible.
    "monitor": ("base/", "params/params.h", "monitor/"),
    "speed": ("base/", "imu/frame.h", "speed/"),
    "supervisor": ("base/", "supervisor/"),
}
PURE_PREFIXES = tuple(f"{name}/" for name in PURE)
# The simulator from the bottom up: each folder knows only those above it in this table. It takes
# nothing of the firmware but REQUIRE and, to read the servo's pulses, their unit.
SIM_ALLOWED: dict[str, tuple[str, ...]] = {
    "sim/common": (),
    "sim/water": ("common/",),
    "sim/fish": ("common/", "water/", "hal/servo.h"),
    "sim/sensor": ("common/", "fish/"),
    "sim/camera": ("common/", "fish/", "base/panic.h"),
    # The world; and sim.c, which alone knows the board and its firmware.
    "sim": (
        *("common/", "water/", "fish/", "sensor/", "camera/"),
        *("base/panic.h", "app/app.h", "host/board.h"),
    ),
    "sim/batch": ("common/", "water/", "fish/tail.h", "config_valid.h"),
}

# A chip's folder shares what all chips of its core have (hal/cortex_m3).
CHIP_ALLOWED = ("base/", "hal/", "registers/", "app/app.h", "crash.h", "guard.h", "memory_map.h")
ALLOWED: dict[str, tuple[str, ...]] = {
    **{f"firmware/{name}": allowed for name, allowed in PURE_ALLOWED.items()},
    "firmware/store": (*PURE_PREFIXES, "store/", "hal/flash.h", "hal/system.h", "lfs.h"),
    "firmware/link": (*PURE_PREFIXES, "store/", "link/", "hal/", *GENERATED),
    "firmware/settings": (*PURE_PREFIXES, "settings/"),
    "firmware/learn": (*PURE_PREFIXES, "settings/", "store/", "learn/"),
    "firmware/trial": (*PURE_PREFIXES, "settings/", "store/", "link/", "learn/", "trial/", "hal/"),
    "firmware/app": (
        *PURE_PREFIXES,
        "settings/",
        "store/",
        "link/",
        "learn/",
        "trial/",
        "app/",
        "hal/",
    ),
    "hal/include/hal": ("hal/",),
    "hal/cortex_m3/registers": ("registers/",),
    "hal/cortex_m3": ("base/", "hal/", "registers/"),
    "hal/sam3x8e/registers": ("registers/",),
    "hal/sam3x8e": CHIP_ALLOWED,
    "hal/smartfusion2": CHIP_ALLOWED,
    "hal/template": ("base/", "hal/", "app/app.h"),
    "hal/host": ("base/panic.h", "hal/", "common/byte_ring.h"),
    "hal/mock": ("base/", "hal/"),
    **SIM_ALLOWED,
    "tests/conformance": ("base/panic.h", "hal/", "app/app.h", "suite.h", *CONFORMANCE),
}

# The tick alone reaches the servo and the memory of the monitor, so that no pulse goes past it.
TICK = "control.c"
OF_TICK = re.compile(r"\b(hal_servo_pulse_isr|hal_guard\w*|monitor_tick_isr)\(")

# Folders that still have circles. A folder without one does not belong here, which is checked.
CIRCLES_LEFT: tuple[str, ...] = ()

# Comments, strings and characters: nothing in them is a use.
NO_CODE = re.compile(r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])*\'', re.DOTALL)
ATTRIBUTE = re.compile(r"__attribute__\s*\(\(.*?\)\)\s*")
# A definition begins in the first column; its type may stand in a line of its own.
DEFINITION = re.compile(
    r"^(?P<type>\w[\w \t*]*\s[\s*]*)(?P<name>\w+)\([^;{}]*\)\s*\{", re.MULTILINE
)
USE = re.compile(r"(?<![\w.])(?<!->)[A-Za-z_]\w*")

# Module -> the modules it depends on, each with the reason.
Graph = dict[str, dict[str, str]]


def c_files(root: Path, folder: str) -> list[Path]:
    """The C files of a folder, not of the folders in it."""
    return sorted((root / folder).glob("*.[ch]"))


def c_offences(root: Path) -> Iterator[str]:
    """Forbidden includes in C files."""
    for folder, allowed in ALLOWED.items():
        for path in c_files(root, folder):
            for name in INCLUDE.findall(path.read_text(encoding="utf-8")):
                beside = "/" not in name and (path.parent / name).is_file()
                if not beside and not name.startswith(allowed):
                    yield f"{path.relative_to(root)}: {folder} must not include {name}"


def unknown_folders(root: Path) -> Iterator[str]:
    """Folders of C files for which no rule exists."""
    for top in ("firmware", "hal", "sim"):
        for path in sorted((root / top).rglob("*.[ch]")):
            if str(path.parent.relative_to(root)) not in ALLOWED:
                yield f"{path.relative_to(root)}: its folder has no rule in tools/check_includes.py"


def functions(code: str) -> tuple[set[str], set[str]]:
    """The functions that a C file defines: for others, and for itself only."""
    public, private = set[str](), set[str]()
    for found in DEFINITION.finditer(code):
        (private if "static" in found["type"].split() else public).add(found["name"])
    return public, private


def included(path: Path, text: str) -> Iterator[tuple[str, str]]:
    """The modules of its own folder whose headers a file includes, and how it writes them."""
    for name in INCLUDE.findall(text):
        header = path.parent / Path(name).name
        if name.endswith(".h") and header.is_file() and f"/{header}".endswith(f"/{name}"):
            yield header.stem, name


def dependencies(root: Path, folder: str) -> Graph:
    """Which module of a folder depends on which, and by what."""
    graph: Graph = {}
    defined: dict[str, str] = {}
    used: dict[str, set[str]] = {}
    for path in c_files(root, folder):
        text = path.read_text(encoding="utf-8")
        edges = graph.setdefault(path.stem, {})
        for module, name in included(path, text):
            edges.setdefault(module, f"by including {name}")
        if path.suffix == ".c":
            code = ATTRIBUTE.sub("", NO_CODE.sub(" ", text))
            public, private = functions(code)
            defined |= dict.fromkeys(public, path.stem)
            used[path.stem] = set(USE.findall(code)) - private
    for module, names in used.items():
        for name in sorted(names & defined.keys()):
            graph[module].setdefault(defined[name], f"by function {name}")
    for module, edges in graph.items():
        edges.pop(module, None)
    return graph


def way(graph: Graph, start: str, goal: str) -> list[str]:
    """The shortest way from one module to another, both included; empty when there is none."""
    came: dict[str, str] = {start: start}
    waiting = deque([start])
    while waiting and goal not in came:
        here = waiting.popleft()
        for there in sorted(graph.get(here, {})):
            if there not in came:
                came[there] = here
                waiting.append(there)
    if goal not in came:
        return []
    path = [goal]
    while path[-1] != start:
        path.append(came[path[-1]])
    return path[::-1]


def circles(graph: Graph) -> Iterator[list[str]]:
    """Circles, each from one of its modules back to it: enough to show each step of any circle."""
    shown: set[tuple[str, str]] = set()
    for module in sorted(graph):
        for other in sorted(graph[module]):
            back = way(graph, other, module)
            circle = [module, *back]
            if back and (module, other) not in shown:
                shown |= set(pairwise(circle))
                yield circle


def written(root: Path, folder: str, graph: Graph, circle: list[str]) -> str:
    """A circle as a line of text."""

    def file(module: str) -> str:
        source = root / folder / f"{module}.c"
        return source.name if source.is_file() else f"{module}.h"

    line = file(circle[0])
    for here, there in pairwise(circle):
        line += f" -> {file(there)} ({graph[here][there]})"
    return f"{folder}: circle {line}"


def circle_offences(root: Path, left: Collection[str]) -> Iterator[str]:
    """Circles inside folders, but for the folders in |left|, which must have one."""
    for folder in dict.fromkeys([*ALLOWED, *left]):
        graph = dependencies(root, folder)
        found = [written(root, folder, graph, circle) for circle in circles(graph)]
        if folder not in left:
            yield from found
        elif not found:
            yield f"{folder}: has no circle; take it out of CIRCLES_LEFT in tools/check_includes.py"


def past_monitor(root: Path) -> Iterator[str]:
    """Calls outside the tick that would move the servo, or the state of the monitor."""
    for path in sorted((root / "firmware").rglob("*.c")):
        if path.name != TICK and path.parent.name != "monitor":
            for name in OF_TICK.findall(path.read_text(encoding="utf-8")):
                yield f"{path.relative_to(root)}: only {TICK} may call {name}()"


def offences(root: Path, left: Collection[str]) -> list[str]:
    """Everything that is wrong below |root|. |left|: folders that may have circles."""
    return [
        *c_offences(root),
        *unknown_folders(root),
        *circle_offences(root, left),
        *past_monitor(root),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    default = Path(__file__).resolve().parent.parent
    parser.add_argument("root", type=Path, nargs="?", default=default)
    parser.add_argument(
        "--circles-left",
        metavar="FOLDER",
        nargs="*",
        default=CIRCLES_LEFT,
        help="folders that may have circles; none shows all circles (default: CIRCLES_LEFT)",
    )
    options = parser.parse_args()
    found = offences(options.root, options.circles_left)
    print("\n".join(found) or "includes: all as the layers allow, and no circles")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
