"""The chip's registers as its vendor describes them, in one small table that tests compare with.

``tests/atsam3x8e.json`` holds, for the peripherals that the firmware or the emulator uses, every
register's place, access, value after reset, fields and their named values. Run this file to write
it again: it downloads the package cmsis-svd (35 MB), which brings the vendor's ATSAM3X8E.svd, and
installs nothing.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from fetch_deps import Dependency, download, unpack

TABLE = Path(__file__).resolve().parent.parent / "tests" / "atsam3x8e.json"
SVD = "ATSAM3X8E.svd"
SOURCE = Dependency(
    package="cmsis-svd",
    version="0.4",
    sha256="b5f439fc6bbc43c9b56dd822f1f764359d503c685a42f913a1cfc2a3c6c42b2c",
    folder="cmsis_svd/data/Atmel",
    variable="",
    files={SVD: "3b27e853322faa1946dcbb1664eb62346c0f76931d15ecaa9345c6afa07fb363"},
)
PERIPHERALS = (
    "ADC", "CHIPID", "EFC0", "EFC1", "GPBR", "MATRIX", "PIOA", "PIOB", "PIOC", "PIOD", "PMC", "PWM",
    "RSTC", "SUPC", "TC0", "UART", "USART0", "USART1", "USART2", "USART3", "WDT",
)  # fmt: skip
NOTICE = (
    "Facts from ATSAM3X8E.svd, version 20130131, Copyright (c) 2013, Atmel Corporation. All rights "
    "reserved. Redistribution and use in source and binary forms, with or without modification, "
    "are permitted provided that the following condition is met: Redistributions of source code "
    "must retain the above copyright notice, this list of conditions and the disclaimer below. "
    "Atmel's name may not be used to endorse or promote products derived from this software "
    "without specific prior written permission. DISCLAIMER: THIS SOFTWARE IS PROVIDED BY ATMEL "
    '"AS IS" AND ANY EXPRESS OR IMPLIED WARRANTIES, INCLUDING, BUT NOT LIMITED TO, THE IMPLIED '
    "WARRANTIES OF MERCHANTABILITY, FITNESS FOR A PARTICULAR PURPOSE AND NON-INFRINGEMENT ARE "
    "DISCLAIMED. IN NO EVENT SHALL ATMEL BE LIABLE FOR ANY DIRECT, INDIRECT, INCIDENTAL, SPECIAL, "
    "EXEMPLARY, OR CONSEQUENTIAL DAMAGES (INCLUDING, BUT NOT LIMITED TO, PROCUREMENT OF SUBSTITUTE "
    "GOODS OR SERVICES; LOSS OF USE, DATA, OR PROFITS; OR BUSINESS INTERRUPTION) HOWEVER CAUSED "
    "AND ON ANY THEORY OF LIABILITY, WHETHER IN CONTRACT, STRICT LIABILITY, OR TORT (INCLUDING "
    "NEGLIGENCE OR OTHERWISE) ARISING IN ANY WAY OUT OF THE USE OF THIS SOFTWARE, EVEN IF ADVISED "
    "OF THE POSSIBILITY OF SUCH DAMAGE."
)


@dataclass(frozen=True)
class Register:
    """One register, or ``count`` of them every ``step`` bytes.

    ``fields``: masks by name. ``values``: the named values of each field, at the field's place.
    """

    offset: int
    access: str
    reset: int | None
    count: int
    step: int
    fields: dict[str, int]
    values: dict[str, dict[str, int]]


@dataclass(frozen=True)
class Peripheral:
    base: int
    registers: dict[str, Register]


@cache
def peripherals() -> dict[str, Peripheral]:
    """The table's peripherals, by the vendor's names."""
    table = json.loads(TABLE.read_text(encoding="utf-8"))
    blocks = {
        name: {key: Register(**found) for key, found in block.items()}
        for name, block in table["registers"].items()
    }
    return {
        name: Peripheral(found["base"], blocks[found["registers"]])
        for name, found in table["peripherals"].items()
    }


@cache
def interrupts() -> dict[str, int]:
    """Number of every interrupt that the vendor's file names."""
    numbers: dict[str, int] = json.loads(TABLE.read_text(encoding="utf-8"))["interrupts"]
    return numbers


def number(text: str | None) -> int:
    return int((text or "0").rstrip("uUlL"), 0)


def read_register(node: Element) -> dict[str, object]:
    fields, values = {}, {}
    for field in node.iterfind("fields/field"):
        name = str(field.findtext("name"))
        unit = 1 << number(field.findtext("bitOffset"))
        fields[name] = ((1 << number(field.findtext("bitWidth"))) - 1) * unit
        values[name] = {
            str(value.findtext("name")): number(value.findtext("value")) * unit
            for value in field.iterfind("enumeratedValues/enumeratedValue")
        }
    reset = node.findtext("resetValue")
    return {
        "offset": number(node.findtext("addressOffset")),
        "access": node.findtext("access"),
        "reset": None if reset is None else number(reset),
        "count": number(node.findtext("dim") or "1"),
        "step": number(node.findtext("dimIncrement")),
        "fields": fields,
        "values": {name: named for name, named in values.items() if named},
    }


def table_of(svd: Path) -> dict[str, object]:
    """The table, with the registers of equal peripherals only once."""
    root = ElementTree.parse(svd).getroot()
    known: dict[str, dict[str, dict[str, object]]] = {}
    found: dict[str, dict[str, object]] = {}
    for node in root.iterfind("peripherals/peripheral"):
        name = str(node.findtext("name"))
        if name not in PERIPHERALS:
            continue
        block = {
            str(register.findtext("name")).removesuffix("[%s]"): read_register(register)
            for register in node.iterfind("registers/register")
        }
        same = next((other for other, those in known.items() if those == block), name)
        known.setdefault(same, block)
        found[name] = {"base": number(node.findtext("baseAddress")), "registers": same}
    numbers = {
        str(node.findtext("name")): number(node.findtext("value"))
        for node in root.iterfind("peripherals/peripheral/interrupt")
    }
    return {"notice": NOTICE, "peripherals": found, "interrupts": numbers, "registers": known}


def to_text(table: dict[str, object]) -> str:
    """JSON with a line for each register, so that a change is easy to read."""
    blocks = table["registers"]
    assert isinstance(blocks, dict)
    head = {key: value for key, value in table.items() if key != "registers"}
    lines = []
    for name, block in blocks.items():
        rows = ",\n".join(f"  {json.dumps(key)}: {json.dumps(row)}" for key, row in block.items())
        lines.append(f" {json.dumps(name)}: {{\n{rows}}}")
    return f'{json.dumps(head, indent=1)[:-2]},\n "registers": {{\n' + ",\n".join(lines) + "}}\n"


def main() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        unpack(SOURCE, download(SOURCE, Path(scratch)), Path(scratch))
        TABLE.write_text(to_text(table_of(Path(scratch) / SVD)), encoding="utf-8")


if __name__ == "__main__":
    main()
