"""Turns bindings.h into the text cffi parses, and into a C table of the bound structs' sizes.

cffi lays structs out from that text alone; comparing with the table shows that it does it like the
compiler of the library.
"""

from __future__ import annotations

import argparse
import re
import subprocess
from pathlib import Path

from cffi import FFI


def preprocess(compiler: str, header: Path, includes: list[Path], defines: list[str]) -> str:
    """The declarations of |header| and all it includes, without any macro."""
    command = [compiler, "-std=c11", "-E", "-P", "-nostdinc", "-D_Static_assert(...)="]
    command += [f"-I{path}" for path in includes] + [f"-D{name}" for name in defines]
    done = subprocess.run([*command, str(header)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(done.stderr)
    return re.sub(r"^\s*;\s*$", "", done.stdout, flags=re.MULTILINE)


def struct_names(cdef: str) -> list[str]:
    """Names of the structs whose layout cffi knows; also proves that cffi can parse the text."""
    ffi = FFI()
    ffi.cdef(cdef)
    types = [(name, ffi.typeof(name)) for name in ffi.list_types()[0]]
    return sorted(name for name, kind in types if kind.kind == "struct" and kind.fields)


def layout_source(header: Path, names: list[str]) -> str:
    """C source of native_layout()."""
    rows = "".join(f'    {{"{name}", sizeof({name})}},\n' for name in names)
    return (
        f'#include "{header.name}"\n\n'
        f"static const native_layout_t layout[] = {{\n{rows}    {{NULL, 0}},\n}};\n\n"
        "const native_layout_t *native_layout(void) { return layout; }\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--compiler", required=True)
    parser.add_argument("--header", type=Path, required=True)
    parser.add_argument("--include", type=Path, action="append", default=[])
    parser.add_argument("--define", action="append", default=[])
    parser.add_argument("--cdef", type=Path, required=True, help="cffi text to write")
    parser.add_argument("--layout", type=Path, required=True, help="C source to write")
    options = parser.parse_args()
    cdef = preprocess(options.compiler, options.header, options.include, options.define)
    source = layout_source(options.header, struct_names(cdef))
    options.cdef.write_text(cdef)
    options.layout.write_text(source)


if __name__ == "__main__":
    main()
