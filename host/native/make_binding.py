"""Turns a C header into a Python module with its types, and into a C table of its structs' sizes.

The module is cffi's out-of-line form of its ABI mode: the declarations are parsed here, when the
package is built, and not at every start of it. It calls no compiler and depends on no version of
Python. cffi lays structs out from the declarations alone; comparing with the table shows that it
does it like the compiler of the library.
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


def write_module(declarations: str, path: Path) -> None:
    """The module, whose ``ffi`` knows the declared types, functions and constants."""
    ffi = FFI()
    ffi.cdef(declarations)
    ffi.set_source(path.stem, None)
    path.unlink(missing_ok=True)  # cffi leaves a file alone that would not change; ninja minds
    ffi.emit_python_code(str(path))


def struct_names(declarations: str) -> list[str]:
    """Names of the structs whose layout cffi knows."""
    ffi = FFI()
    ffi.cdef(declarations)
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
    parser.add_argument("--module", type=Path, required=True, help="Python module to write")
    parser.add_argument("--layout", type=Path, help="C source to write")
    options = parser.parse_args()
    declarations = preprocess(options.compiler, options.header, options.include, options.define)
    write_module(declarations, options.module)
    if options.layout is not None:
        options.layout.write_text(layout_source(options.header, struct_names(declarations)))


if __name__ == "__main__":
    main()
