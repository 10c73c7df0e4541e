#!/usr/bin/env python3
"""Writes the reference pages that are generated from code, into docs/reference/generated.

Messages and commands come from wire/tailbeat.xml; parameters, faults and problems of the IMU from
the firmware's tables; commands of the tool from its command line; the Python API and the C headers
are lists of directives, which Sphinx fills.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import click
import typer.main
from pymavlink.generator import mavparse

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from wire.param_metadata import macro_rows  # noqa: E402

PAGES_AT = ROOT / "docs" / "reference" / "generated"
HOST = ROOT / "host" / "tailbeat"
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
            f"### {message.name} ({message.id})\n\n{message.description}\n"
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
        rows.append((str(entry.value), entry.name, entry.description, "; ".join(params)))
    return table(("id", "command", "what it does", "parameters"), rows)


def enum_tables() -> str:
    """The dialect's other enums."""
    parts = []
    for enum in dialect().enum:
        if enum.name == "MAV_CMD":
            continue
        entries = [e for e in enum.entry if not e.name.endswith("ENUM_END")]
        rows = [(str(e.value), e.name, e.description) for e in entries]
        values = table(("value", "name", ""), rows)
        parts.append(f"### {enum.name}\n\n{enum.description}\n\n{values}")
    return "\n\n".join(parts)


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


def command_line() -> Iterator[str]:
    """A section for each command of the tool: its help text, its arguments and options."""
    from tailbeat.app.cli.app import app

    yield from command_sections(typer.main.get_command(app), ("tailbeat",))


def command_sections(command: Any, words: tuple[str, ...]) -> Iterator[str]:
    """The sections of a command and of those below it."""
    context = click.Context(command, info_name=words[-1])
    visible = [p for p in command.params if not getattr(p, "hidden", False) and p.name != "help"]
    if len(words) > 1:
        yield f"{'#' * min(len(words), 4)} {' '.join(words)}"
    yield inspect.cleandoc(command.help or "").split("\f")[0]
    if visible:
        yield table(("option", "meaning"), (option_row(p, context) for p in visible))
    if hasattr(command, "list_commands"):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            if not below.hidden:
                yield from command_sections(below, (*words, name))


def option_row(option: Any, context: click.Context) -> tuple[str, str]:
    """Names and meaning of an option or an argument."""
    if isinstance(option, click.Argument):
        return f"`{option.make_metavar(context)}`", getattr(option, "help", None) or ""
    record = option.get_help_record(context)
    return (f"`{' '.join(record[0].split())}`", " ".join(record[1].split())) if record else ("", "")


def python_api() -> Iterator[str]:
    """A section for each package that names what it exports."""
    for face in sorted(HOST.rglob("__init__.py")):
        targets = [
            ast.unparse(node.targets[0])
            for node in ast.parse(face.read_text(encoding="utf-8")).body
            if isinstance(node, ast.Assign)
        ]
        if "__all__" in targets:
            package = ".".join(("tailbeat", *face.parent.relative_to(HOST).parts))
            yield from package_section(package)


def package_section(package: str) -> Iterator[str]:
    """The directives for what a package exports."""
    module = importlib.import_module(package)
    yield f"## {package}"
    yield f"```{{eval-rst}}\n.. automodule:: {package}\n   :no-members:\n```"
    for name in module.__all__:
        found = getattr(module, name)
        if inspect.isclass(found):
            kind, options = "autoclass", "\n   :members:"
        elif inspect.isfunction(found):
            kind, options = "autofunction", ""
        elif inspect.ismodule(found):
            kind, options = "automodule", "\n   :members:"
        else:
            kind, options = "autodata", ""
        yield f"```{{eval-rst}}\n.. {kind}:: {package}.{name}{options}\n```"


def c_headers() -> Iterator[str]:
    """A section for each header of the firmware and of the HAL interface."""
    headers = sorted(path for path in (ROOT / "firmware").rglob("*.h") if is_public(path))
    for path in [*headers, *sorted((ROOT / "hal" / "include").rglob("*.h"))]:
        name = path.relative_to(ROOT).as_posix()
        yield f"## {name}\n\n```{{doxygenfile}} {name}\n```"


def is_public(header: Path) -> bool:
    """Whether a header is a contract for other folders."""
    return not header.stem.endswith("_internal") and header.stem != "lfs_defines"


def page(title: str, purpose: str, *parts: str) -> str:
    """A whole page."""
    return "\n\n".join((f"# {title}", purpose, *parts)) + "\n"


# Name of the page: title, what it is for, what fills it.
PAGES: dict[str, tuple[str, str, Callable[[], Iterable[str]]]] = {
    "parameters": (
        "Board parameters",
        "Every parameter of the board. `tailbeat params list` prints the present values, "
        "`tailbeat params set NAME VALUE` changes one.",
        lambda: (parameter_table(), "## Old names", renamed_table()),
    ),
    "messages": (
        "MAVLink messages",
        "The messages and enums of the tailbeat dialect. [Protocol](../protocol.md) says when they "
        "are sent.",
        lambda: ("## Messages", message_tables(), "## Enums", enum_tables()),
    ),
    "commands": (
        "MAVLink commands",
        "The commands of the tailbeat dialect, for COMMAND_LONG and COMMAND_INT.",
        lambda: (command_table(),),
    ),
    "faults": (
        "Faults and refusals",
        "Every reason for a stop or a refusal, with its remedy. [Faults](../faults.md) explains "
        "the kinds.",
        lambda: (fault_table(),),
    ),
    "imu-problems": (
        "IMU problems",
        "Every reason why the IMU does not deliver the expected stream, with its remedy.",
        lambda: (imu_problem_table(),),
    ),
    "cli": ("Command line", "Every command of `tailbeat` with its options.", command_line),
    "python": (
        "Python API",
        "The public names of the Python package. [Fish API](../fish-api.ipynb) shows them in use.",
        python_api,
    ),
    "c": (
        "C headers",
        "The interfaces of the firmware and of the HAL. Each header is a contract: units, ranges, "
        "errors, the owner of each buffer, and whether an interrupt may call.",
        c_headers,
    ),
}


def write_pages(folder: Path = PAGES_AT) -> None:
    """Writes all pages; a page whose text is the same is not touched."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, (title, purpose, fill) in PAGES.items():
        path, text = folder / f"{name}.md", page(title, purpose, *fill())
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write_pages()
