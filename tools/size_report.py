#!/usr/bin/env python3
"""Size of the image: code, RAM, and the worst that its stack can need.

Exits with 1 when a budget is overrun, when the stack that the linker reserved is too small, or when
the worst case cannot be told (a call through a pointer that stack_facts.toml does not explain).
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

from elftools.elf.constants import SH_FLAGS
from elftools.elf.elffile import ELFFile

from stack_depth import (
    EXCEPTION_BYTES,
    Chain,
    Facts,
    StackError,
    StackReport,
    Symbol,
    measure,
    symbols,
)

# Of the 256 KB of flash bank 0. 3 KB of it are for ground stations: 2 KB describe the parameters
# (wire/param_metadata.py), 1 KB answers what they ask (firmware/link: discovery.c,
# identity.c, telemetry.c).
IMAGE_BUDGET_BYTES = 100 * 1024
RAM_BUDGET_BYTES = 64 * 1024  # of 96 KB
BIGGEST = 10

# A section's contribution in the linker's map: its name (a long one on a line of its own), address,
# size, and the file it comes from. A section is named for a function or a variable.
MAP_LINE = re.compile(
    r"^ \.\w+(?:\.([\w.]*?))?(?:\.str[\d.]+)?\s+0x([0-9a-f]+)\s+0x([0-9a-f]+) (\S.*)$", re.MULTILINE
)
MAP_START = "Linker script and memory map"
MAP_DEBUG = "\n.debug_"  # from here on addresses are places in the file
ARCHIVE_MEMBER = re.compile(r"lib(\w+)\.a\(")
ARCHIVES = {
    "c_nano": "libc",
    "gcc": "libgcc",
}
FOLDERS = {"firmware": "firmware", "littlefs": "littlefs", "build": "mavlink", "hal": "board"}


@dataclass(frozen=True)
class Sizes:
    """Bytes of the image. ``text`` is all that only lies in flash, constants included; ``data`` is
    copied from flash to RAM, code that runs there included."""

    text: int
    data: int
    bss: int

    @property
    def image(self) -> int:
        return self.text + self.data

    @property
    def static_ram(self) -> int:
        return self.data + self.bss


def sizes(elf: ELFFile) -> Sizes:
    text = data = bss = 0
    moved = [s for s in elf.iter_segments("PT_LOAD") if s["p_vaddr"] != s["p_paddr"]]
    for section in elf.iter_sections():
        if not section["sh_flags"] & SH_FLAGS.SHF_ALLOC:
            continue
        if section["sh_type"] == "SHT_NOBITS":
            bss += section["sh_size"]
        elif any(segment.section_in_segment(section) for segment in moved):
            data += section["sh_size"]
        else:
            text += section["sh_size"]
    return Sizes(text, data, bss)


def biggest_symbols(placed: list[Symbol]) -> list[tuple[str, int, str]]:
    """The largest in flash or RAM: name, bytes, source file."""
    found = {(s.address, s.size): s for s in placed if s.kind in ("STT_FUNC", "STT_OBJECT")}
    ranked = sorted(found.values(), key=lambda s: (-s.size, s.name))
    return [(s.name, s.size, s.file) for s in ranked[:BIGGEST]]


def part_of(origin: str, source: str) -> str:
    """The part of the image that a section belongs to: by the folder of its source, else by the
    archive that it comes from. The linker merges constants of all sources."""
    folder = FOLDERS.get(Path(source).parts[0]) if source else None
    archive = ARCHIVE_MEMBER.search(origin)
    return folder or (ARCHIVES.get(archive[1], archive[1]) if archive else "constants")


def parts(map_text: str, flash: range, placed: list[Symbol]) -> dict[str, int]:
    """Bytes of code and constants per part of the image, largest first."""
    total: Counter[str] = Counter()
    by_address = {symbol.address: symbol.file for symbol in placed}
    by_name = {symbol.name: symbol.file for symbol in placed}
    loaded = map_text[map_text.find(MAP_START) :].split(MAP_DEBUG, 1)[0]
    for name, address, size, origin in MAP_LINE.findall(loaded):
        if (at := int(address, 16)) in flash:
            source = by_address.get(at) or by_name.get(name, "")
            total[part_of(origin, source)] += int(size, 16)
    return dict(total.most_common())


@dataclass(frozen=True)
class Report:
    sizes: Sizes
    parts: dict[str, int]
    biggest: list[tuple[str, int, str]]
    stack: StackReport

    @property
    def ram(self) -> int:
        """What the RAM's budget counts: variables and worst stack."""
        return self.sizes.static_ram + self.stack.worst_bytes

    def problems(self) -> list[str]:
        """Everything that is over its budget."""
        checks = [
            (self.sizes.image, IMAGE_BUDGET_BYTES, "text and data", "the budget"),
            (self.ram, RAM_BUDGET_BYTES, "variables and worst stack", "the budget"),
            (
                self.stack.worst_bytes,
                self.stack.reserved_bytes,
                "worst stack",
                "the linker script reserves",
            ),
            (
                self.stack.largest.bytes,
                self.stack.guard_bytes,
                "largest frame",
                "the stack's guard",
            ),
        ]
        for own in self.stack.own:
            checks.append((own.deepest.bytes, own.size_bytes, f"stack {own.name}", "it holds"))
        return [
            f"{what}: {value} bytes, {value - limit} more than {of} ({limit})"
            for value, limit, what, of in checks
            if value > limit
        ]

    def as_json(self) -> str:
        return json.dumps(
            {
                **asdict(self.sizes),
                "image": self.sizes.image,
                "ram": self.ram,
                "parts": self.parts,
                "biggest": [{"name": n, "bytes": s, "file": f} for n, s, f in self.biggest],
                "stack": {**asdict(self.stack), "worst_bytes": self.stack.worst_bytes},
                "problems": self.problems(),
            },
            indent=2,
        )


def read(elf_path: Path, map_path: Path, su_folder: Path, facts: Facts) -> Report:
    with elf_path.open("rb") as stream:
        elf = ELFFile(stream)
        measured = sizes(elf)
        start = min(s["sh_addr"] for s in elf.iter_sections() if s.name == ".text")
    flash = range(start, start + measured.text)
    placed = symbols(elf_path)
    by_part = parts(map_path.read_text(), flash, placed) if map_path.is_file() else {}
    return Report(measured, by_part, biggest_symbols(placed), measure(elf_path, su_folder, facts))


def chain_line(chain: Chain, what: str) -> str:
    return f"  {chain.bytes:6} {what}: {' > '.join(chain.names)}"


def print_stack(stack: StackReport) -> None:
    print(f"worst stack {stack.worst_bytes} bytes of {stack.reserved_bytes}:")
    print(chain_line(stack.main, "main program"))
    for level in stack.levels:
        print(chain_line(level.deepest, f"interrupt of priority {level.priority}"))
    print(f"  {EXCEPTION_BYTES:6} a fault on top of all")
    print(chain_line(stack.largest, f"largest frame, of the {stack.guard_bytes} of the guard"))
    for own in stack.own:
        print(f"stack {own.name}: {own.deepest.bytes} bytes of {own.size_bytes}")


def print_report(report: Report) -> None:
    print("biggest symbols, bytes:")
    for name, size, file in report.biggest:
        print(f"  {size:6} {name}" + (f" ({file})" if file else ""))
    print_stack(report.stack)
    by_part = ", ".join(f"{name} {size}" for name, size in report.parts.items())
    print("text by part: " + (by_part or "no map"))
    print("text {text}, data {data}, bss {bss} bytes".format(**asdict(report.sizes)))
    print(f"image: {report.sizes.image} bytes of {IMAGE_BUDGET_BYTES}")
    print(f"RAM with the worst stack: {report.ram} bytes of {RAM_BUDGET_BYTES}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("elf", type=Path)
    parser.add_argument("--map", type=Path, help="default: beside the image")
    parser.add_argument("--su", type=Path, help="folder of .su files; default: the image's")
    table = Path(__file__).with_name("stack_facts.toml")
    parser.add_argument("--facts", type=Path, default=table, help="what machine code does not say")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    elf: Path = options.elf
    if not elf.is_file():
        sys.exit(f"size: there is no {elf}; build it with: make firmware")
    try:
        facts = Facts.read(options.facts)
        report = read(elf, options.map or elf.with_suffix(".map"), options.su or elf.parent, facts)
    except StackError as error:
        sys.exit(f"size: the worst stack cannot be told: {error} ({options.facts.name})")
    if options.json:
        print(report.as_json())
    else:
        print_report(report)
    for problem in report.problems():
        print(f"size: {problem}", file=sys.stderr)
    sys.exit(bool(report.problems()))


if __name__ == "__main__":
    main()
