"""The binding: cffi reads the headers as the C compiler does, and missing parts are explained."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tailbeat.core import native
from tailbeat.core.native import ffi, lib

TYPES = "_native_types.py"


def layout_mismatches(loaded: native.Native) -> list[str]:
    """Structs whose size differs between cffi's reading of the headers and the compiled library."""
    wrong = []
    row = loaded.lib.native_layout()
    while row.name != loaded.ffi.NULL:
        name = loaded.ffi.string(row.name).decode()
        size = loaded.ffi.sizeof(name)
        if size != row.size_bytes:
            wrong.append(f"{name}: {size} bytes here, {row.size_bytes} in the library")
        row += 1
    return wrong


def test_every_struct_has_the_compilers_size() -> None:
    assert layout_mismatches(native.load()) == []


def test_a_wrong_declaration_is_noticed(tmp_path: Path) -> None:
    for name in (TYPES, "libtailbeat_native.so"):
        shutil.copy(native.HERE / name, tmp_path / name)
    types = tmp_path / TYPES
    text = types.read_text()
    number, double = (_type_of(field, text) for field in ("kp_rad_s_m", "tremor_rad"))
    assert number != double
    types.write_text(text.replace(f"{number}kp_rad_s_m", f"{double}kp_rad_s_m"))
    assert any(line.startswith("law_t: ") for line in layout_mismatches(native.load(tmp_path)))


def test_all_declared_functions_are_exported() -> None:
    missing = [name for name in dir(lib) if not _resolves(name)]
    assert missing == []
    assert {"crc32_update", "law_update", "sim_new", "speed_beat"} <= set(dir(lib))


def test_an_import_loads_no_library() -> None:
    code = (
        "import sys; from tailbeat.core.native import ffi, lib, load; import tailbeat.core.law;"
        "assert not load.cache_info().currsize; lib.law_update; assert load.cache_info().currsize"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_functions_and_constants_work() -> None:
    assert lib.crc32_update(0, b"123456789", 9) == 0x2DFD2D88
    assert lib.NATIVE_BEATS_MAX == 512
    assert ffi.sizeof("reference_t") > 4 * lib.NATIVE_BEATS_MAX
    assert ffi.string(lib.link_build_id())


def test_missing_library_is_explained(tmp_path: Path) -> None:
    with pytest.raises(native.NativeLibraryError, match="again"):
        native.load(tmp_path)


def test_broken_library_is_explained(tmp_path: Path) -> None:
    shutil.copy(native.HERE / TYPES, tmp_path)
    (tmp_path / "libtailbeat_native.so").write_bytes(b"not a library")
    with pytest.raises(native.NativeLibraryError, match="does not load"):
        native.load(tmp_path)


def _type_of(field: str, text: str) -> str:
    """What stands before a field's name in a module of types: four escaped bytes."""
    (found,) = set(re.findall(rf"b'((?:\\x[0-9A-F]{{2}}){{4}}){field}'", text))
    return str(found)


def _resolves(name: str) -> bool:
    try:
        getattr(lib, name)
    except AttributeError:
        return False
    return True


_OUTLIVED = """
import gc
from tailbeat.core import native
loaded = native.load_library("native")
layout = loaded.lib.native_layout
del loaded
gc.collect()
assert layout().name
"""


def test_functions_outlive_the_library() -> None:
    """When Python ends, objects may be freed by C after the library itself was collected."""
    assert subprocess.run([sys.executable, "-c", _OUTLIVED], check=False).returncode == 0
