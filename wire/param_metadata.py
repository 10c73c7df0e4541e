"""Describes the board's parameters for ground stations, as a C source.

One file has all names, units, ranges, defaults and texts (MAVLink's parameter metadata, xz). The
general metadata names it. The board serves both over MAVLink FTP; COMPONENT_METADATA tells where.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

try:
    import lzma
except ImportError:
    sys.exit("building the firmware needs a Python with the lzma module (liblzma)")

TYPE_PARAMETER = 1  # COMP_METADATA_TYPE_PARAMETER
_POLYNOMIAL = 0xEDB88320
# The dictionary holds the whole text; pb 0 and no check save 28 bytes. Every reader knows them:
# liblzma (MAVSDK), libarchive and xz-embedded (QGroundControl). The image has its own checksum.
_FILTERS = [
    {"id": lzma.FILTER_LZMA2, "preset": 9 | lzma.PRESET_EXTREME, "pb": 0, "dict_size": 1 << 16}
]


def macro_rows(path: Path, macro: str) -> list[list[str]]:
    """The arguments of every ``MACRO(...)`` line of a table file."""
    calls = re.findall(rf"^{macro}\((.*)\)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    split = re.compile(r'"((?:[^"\\]|\\.)*)"|([^,\s]+)')
    return [[quoted or bare for quoted, bare in split.findall(call)] for call in calls]


def number(literal: str) -> float | int:
    """A C float literal; whole numbers without a point, which is shorter."""
    value = float(literal.rstrip("f"))
    return int(value) if value.is_integer() else value


def first_clause(text: str) -> str:
    """The text up to its first semicolon, colon or bracket."""
    return re.split(r"[;:(]", text)[0].strip()


def parameters(table: Path, short: Path) -> dict[str, Any]:
    """The parameter metadata of a table of parameters and of the table of their short texts."""
    short_texts = dict(macro_rows(short, "SHORT"))
    rows = []
    for name, default, low, high, _, unit, text in macro_rows(table, "PARAM"):
        # Keys in the order that packs best.
        row = {"shortDesc": short_texts.pop(name, first_clause(text)), "name": name}
        row |= {"type": "Float"} | ({"units": unit} if unit else {})
        rows.append(row | {"min": number(low), "max": number(high), "default": number(default)})
    if short_texts:
        sys.exit(f"{short}: no parameter is named {', '.join(short_texts)}")
    return {"version": 1, "parameters": rows}


def crc32(data: bytes) -> int:
    """As MAVLink FTP has it: from 0, not inverted at the end."""
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (_POLYNOMIAL if value & 1 else 0)
    return value


def dump(document: dict[str, Any]) -> bytes:
    """The shortest JSON."""
    return json.dumps(document, separators=(",", ":")).encode("ascii")


def general(packed: bytes) -> bytes:
    """The general metadata, which names the file of the parameters."""
    entry = {
        "type": TYPE_PARAMETER,
        "uri": "mftp:///parameter.json.xz",
        "fileCrc": crc32(packed),
    }
    return dump({"version": 1, "metadataTypes": [entry]})


def pack(document: dict[str, Any]) -> bytes:
    """The document as an xz file."""
    return lzma.compress(
        dump(document), format=lzma.FORMAT_XZ, check=lzma.CHECK_NONE, filters=_FILTERS
    )


def c_source(general_file: bytes, parameter_file: bytes) -> Iterator[str]:
    """Lines of a C source that defines link_metadata."""
    yield '#include "link/metadata.h"\n\n'
    for name, data in (("general", general_file), ("parameter", parameter_file)):
        yield f"static const uint8_t {name}[] = {{\n"
        for at in range(0, len(data), 16):
            yield "    " + " ".join(f"{byte}," for byte in data[at : at + 16]) + "\n"
        yield "};\n\n"
    yield f"const uint32_t link_metadata_crc = {crc32(general_file)}u;\n\n"
    yield "const link_file_bytes_t link_metadata[LINK_METADATA_FILES] = {\n"
    yield '    {"/general.json", general, sizeof general},\n'
    yield '    {"/parameter.json.xz", parameter, sizeof parameter},\n};\n'


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--table", type=Path, required=True, help="params.def")
    parser.add_argument("--short", type=Path, required=True, help="short_texts.def")
    parser.add_argument("--source", type=Path, required=True, help="C source to write")
    options = parser.parse_args()
    packed = pack(parameters(options.table, options.short))
    text = "".join(c_source(general(packed), packed))
    options.source.write_text(text, encoding="ascii")


if __name__ == "__main__":
    main()
