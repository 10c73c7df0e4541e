#!/usr/bin/env python3
"""Writes the tables of docs/protocol.md, faults.md and vn100.md from the sources that define them.

Messages and commands come from wire/tailbeat.xml; parameters, faults and problems of the IMU from
the firmware's own tables. ``--check`` changes nothing and fails when a page is not up to date.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from pymavlink.generator import mavparse

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
DIALECT = ROOT / "wire" / "tailbeat.xml"


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table."""
    head = list(head)
    cells = [[cell.replace("|", "\\|") for cell in row] for row in rows]
    lines = [head, ["---"] * len(head), *cells]
    return "\n".join("| " + " | ".join(row) + " |" for row in lines)


def dialect() -> Any:
    """The dialect's own messages and enums, with wire offsets."""
    return mavparse.MAVXML(str(DIALECT), mavparse.PROTOCOL_2_0)


def message_tables() -> str:
    """One table per message, fields in the order of their bytes in the payload."""
    parts = []
    for message in dialect().message:
        rows = []
        for field in message.ordered_fields:
            length = f"[{field.array_length}]" if field.array_length else ""
            text = field.description + (f" ({field.units.strip('[]')})" if field.units else "")
            rows.append((str(field.wire_offset), f"{field.type}{length}", field.name, text))
        parts.append(
            f"#### {message.name} ({message.id})\n\n{message.description}\n"
            f"Payload {message.wire_length} bytes, CRC extra {message.crc_extra}.\n\n"
            + table(("offset", "type", "field", "meaning"), rows)
        )
    return "\n\n".join(parts)


def command_table() -> str:
    """The dialect's commands."""
    rows = []
    for entry in next(e for e in dialect().enum if e.name == "MAV_CMD").entry:
        if entry.name.endswith("ENUM_END"):
            continue
        params = [
            f"param{p.index} {p.label}: {p.description}" for p in entry.param if p.label.strip()
        ]
        rows.append((str(entry.value), entry.name, entry.description, "<br>".join(params)))
    return table(("id", "command", "what it does", "parameters"), rows)


def enum_tables() -> str:
    """The dialect's other enums."""
    parts = []
    for enum in dialect().enum:
        if enum.name == "MAV_CMD":
            continue
        entries = [e for e in enum.entry if not e.name.endswith("ENUM_END")]
        rows = [(str(e.value), e.name, e.description) for e in entries]
        parts.append(f"`{enum.name}`: {enum.description}\n\n" + table(("value", "name", ""), rows))
    return "\n\n".join(parts)


def macro_rows(path: Path, macro: str) -> list[list[str]]:
    """The arguments of every ``MACRO(...)`` line of a table file."""
    calls = re.findall(rf"^{macro}\((.*)\)$", path.read_text(), re.MULTILINE)
    split = re.compile(r'"((?:[^"\\]|\\.)*)"|([^,\s]+)')
    return [[quoted or bare for quoted, bare in split.findall(call)] for call in calls]


def number(text: str) -> str:
    """A C float literal as people write it."""
    return f"{float(text.rstrip('f')):g}"


STEPS = {"PARAM_REAL": "", "PARAM_WHOLE": ", whole", "PARAM_HALF": ", multiples of 0.5"}


def parameter_table() -> str:
    """Every board parameter; the row is its index."""
    rows = []
    for index, row in enumerate(macro_rows(ROOT / "firmware/params/params.def", "PARAM")):
        name, fallback, low, high, kind, unit, text = row
        bounds = f"{number(low)} … {number(high)}"
        step = STEPS[kind]
        rows.append((str(index), f"`{name}`", number(fallback), bounds + step, unit, text))
    return table(("index", "name", "default", "range", "unit", "meaning"), rows)


def renamed_table() -> str:
    """Every board parameter that had another name."""
    rows = macro_rows(ROOT / "firmware/params/renamed.def", "RENAMED")
    return table(("old name", "name"), ((f"`{old}`", f"`{name}`") for old, name in rows))


def fault_table() -> str:
    """Every reason for a stop or a refusal."""
    rows = [
        (code, name, kind.lower(), meaning, remedy)
        for code, name, kind, meaning, remedy in macro_rows(
            ROOT / "firmware/supervisor/faults.def", "FAULT"
        )
    ]
    return table(("number", "name", "kind", "meaning", "what to do"), rows)


def imu_problem_table() -> str:
    """Every reason why the IMU does not stream as wanted."""
    rows = [
        (code, name, meaning, remedy)
        for name, code, meaning, remedy in macro_rows(
            ROOT / "firmware/imu/problems.def", "IMU_PROBLEM"
        )
    ]
    return table(("number", "name", "meaning", "what to do"), rows)


PAGES: dict[str, dict[str, Callable[[], str]]] = {
    "protocol.md": {
        "messages": message_tables,
        "enums": enum_tables,
        "commands": command_table,
        "parameters": parameter_table,
        "renamed": renamed_table,
    },
    "faults.md": {"faults": fault_table},
    "vn100.md": {"problems": imu_problem_table},
}


def filled(name: str, page: str) -> str:
    """The page with every section between its markers written anew."""
    for section, make in PAGES[name].items():
        begin, end = f"<!-- {section} -->", f"<!-- end of {section} -->"
        if begin not in page or end not in page:
            raise SystemExit(f"docs/{name} has no section {section}: put {begin} and {end} in it")
        before, rest = page.split(begin, 1)
        page = f"{before}{begin}\n{make()}\n{end}{rest.split(end, 1)[1]}"
    return page


def main() -> int:
    """Writes or checks the pages."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="fail when a page is out of date")
    arguments = parser.parse_args()
    stale = 0
    for name in PAGES:
        page = (DOCS / name).read_text()
        fresh = filled(name, page)
        if not arguments.check:
            (DOCS / name).write_text(fresh)
        elif fresh != page:
            stale = 1
            print(f"docs/{name} is out of date. Run tools/protocol_tables.py.", file=sys.stderr)
    return stale


if __name__ == "__main__":
    sys.exit(main())
