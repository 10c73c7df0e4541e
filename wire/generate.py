"""Generates the MAVLink dialect, C headers and a Python module, from tailbeat.xml.

The XML files it includes come from the installed pymavlink. Nothing is done when no input changed;
the output is the same on every run for the same input.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

# In place of the generated module's "import hashlib": only signed frames need it, in 4 ms.
_HEAD = """from __future__ import annotations

from tailbeat.core.extras import lazy
from tailbeat.core.native import ffi, lib

hashlib = lazy("hashlib")
"""
# In place of a package for the sum, which takes 7 ms to load.
_CRC = '''def mcrf4xx(data: bytes, crc: int = 0xFFFF) -> int:
    """CRC-16/MCRF4XX."""
    return int(lib.crc_mcrf4xx_update(crc, ffi.from_buffer(data), len(data)))
'''
# Left out: logging takes 3 ms to load, and few frames are complained of.
_LOGGER = "logger = logging.getLogger(__name__)\n"
# Messages of the common dialect that board or host send, take in or refuse by name.
KNOWN = frozenset(
    {
        "attitude",
        "attitude_quaternion",
        "autopilot_version",
        "available_modes",
        "battery_status",
        "command_ack",
        "command_int",
        "command_long",
        "component_metadata",
        "file_transfer_protocol",
        "gps_raw_int",
        "heartbeat",
        "mission_count",
        "mission_request_list",
        "param_error",
        "param_request_list",
        "param_request_read",
        "param_set",
        "param_value",
        "ping",
        "setup_signing",
        "statustext",
        "sys_status",
        "system_time",
        "timesync",
        "vision_position_estimate",
        "vision_speed_estimate",
    }
)
HERE = Path(__file__).resolve().parent


def pymavlink_dialects() -> Path:
    """Folder of the dialect definitions that come with pymavlink."""
    # The package writes to its environment on import, so it is found without importing it.
    from importlib.util import find_spec

    spec = find_spec("pymavlink")
    if spec is None or spec.origin is None:
        raise SystemExit("pymavlink is missing: pip install pymavlink==2.4.50")
    return Path(spec.origin).parent / "dialects" / "v20"


def with_includes(xml: Path, base: Path) -> dict[str, Path]:
    """|xml| and all files it includes, by name."""
    found: dict[str, Path] = {}
    todo = [xml]
    while todo:
        path = todo.pop()
        if path.name in found:
            continue
        found[path.name] = path
        todo += [
            base / (node.text or "").strip() for node in ElementTree.parse(path).iter("include")
        ]
    return found


def digest_of(inputs: dict[str, Path]) -> str:
    """One hash over everything that decides the output."""
    digest = hashlib.sha256(version("pymavlink").encode())
    for path in [Path(__file__), *(inputs[name] for name in sorted(inputs))]:
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def mavgen(language: str, output: Path, xml: Path) -> None:
    """Runs pymavlink's generator."""
    command = [sys.executable, "-m", "pymavlink.tools.mavgen", "--wire-protocol=2.0"]
    command += [f"--lang={language}", "--no-validate", "-o", str(output), str(xml)]
    # Without a fixed hash seed the generated headers differ from run to run.
    env = {**os.environ, "PYTHONHASHSEED": "0"}
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    if done.returncode != 0 or not output.exists():
        raise SystemExit(f"mavgen failed:\n{done.stdout}{done.stderr}")


def drop_build_dates(headers: Path) -> None:
    """Takes the date of generation out of the headers."""
    for path in headers.glob("*/version.h"):
        text = path.read_text()
        path.write_text(re.sub(r'(MAVLINK_BUILD_DATE) ".*"', r'\1 ""', text))


def leave_out_foreign(headers: Path) -> None:
    """Takes messages that neither board nor host know out of what the headers include, which was
    three quarters of it. Frames of any message are still checked and refused."""
    for path in headers.glob("*/*.h"):
        lines = path.read_text().splitlines(keepends=True)
        path.write_text("".join(line for line in lines if not _includes_foreign(line)))


def _includes_foreign(line: str) -> bool:
    found = re.fullmatch(r'#include "\./mavlink_msg_(\w+)\.h"\n', line)
    return found is not None and _is_foreign(f"MAVLink_{found[1]}_message")


def lighten(module: Path) -> None:
    """Takes out what every start of the host tool would make and nobody asks for: what the module
    says of the values of other dialects' enums (the values stay), and the messages that neither
    board nor host know, which are then noise on the line. Nor are annotations evaluated."""
    text = module.read_text()
    lines = text.splitlines(keepends=True)
    for statement in reversed(ast.parse(text).body):
        if isinstance(statement, ast.ClassDef) and statement.name == "MAVLink":
            dropped = [one for one in statement.body if _is_foreign(getattr(one, "name", ""))]
        else:
            dropped = [statement] if _is_foreign(_subject(statement)) else []
        for one in reversed(dropped):
            del lines[one.lineno - 1 : one.end_lineno]
    entries = [line for line in lines if not _is_foreign(line.rpartition(": ")[2].strip(" ,\n"))]
    module.write_text(_with_own_imports("".join(entries)))


def _with_own_imports(text: str) -> str:
    """What takes long to load is loaded when it is used, or not needed."""
    text = _replaced(text, "import hashlib\n", _HEAD)
    text = _replaced(text, "import logging\n", 'logging = lazy("logging")\n')
    text = _replaced(text, _LOGGER, "").replace("logger.", "logging.getLogger(__name__).")
    begin, end = text.index("# CRC calculation using fastcrc"), text.index("\n\nBytesLike = ")
    return text[:begin] + _CRC + text[end:]


def _replaced(text: str, old: str, new: str) -> str:
    if text.count(old) != 1:
        raise SystemExit(f"the generated module has {text.count(old)} times {old!r}, once expected")
    return text.replace(old, new)


def _subject(statement: ast.stmt) -> str:
    """What a statement defines or changes."""
    if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Call):
        arguments = statement.value.args
        return ast.unparse(arguments[0]) if arguments else ""
    if isinstance(statement, ast.Assign):
        return ast.unparse(statement.targets[0])
    return getattr(statement, "name", "")


def _is_foreign(name: str) -> bool:
    """Whether it is of a message or an enum that is taken out."""
    if name.startswith("enums['"):
        return not name.startswith("enums['TAILBEAT_")
    found = re.fullmatch(r"MAVLink_(\w+)_message|(\w+)_(?:encode|send)", name)
    message = (found[1] or found[2]) if found else "tailbeat_"
    return not message.startswith("tailbeat_") and message not in KNOWN


def generate(inputs: dict[str, Path], into: Path) -> None:
    """Writes xml/, mavlink/ and tailbeat_dialect.py below |into|."""
    work = into / "new"
    shutil.rmtree(work, ignore_errors=True)
    (work / "xml").mkdir(parents=True)
    for name, path in inputs.items():
        shutil.copyfile(path, work / "xml" / name)
    mavgen("C", work / "mavlink", work / "xml" / "tailbeat.xml")
    drop_build_dates(work / "mavlink")
    leave_out_foreign(work / "mavlink")
    mavgen("Python3", work / "tailbeat_dialect.py", work / "xml" / "tailbeat.xml")
    lighten(work / "tailbeat_dialect.py")
    for name in ("xml", "mavlink"):
        shutil.rmtree(into / name, ignore_errors=True)
    for path in work.iterdir():
        path.replace(into / path.name)
    work.rmdir()


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keeps two builds that share |folder| from generating at the same time."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("w") as handle:
        if sys.platform != "win32":
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--into", type=Path, required=True, help="folder to write to")
    parser.add_argument("--stamp", type=Path, help="file to touch when done")
    options = parser.parse_args()
    into: Path = options.into
    inputs = with_includes(HERE / "tailbeat.xml", pymavlink_dialects())
    digest = digest_of(inputs)
    with locked(into):
        done = into / "dialect.sha256"
        if not done.exists() or done.read_text() != digest:
            done.unlink(missing_ok=True)
            generate(inputs, into)
            done.write_text(digest)
    if options.stamp:
        options.stamp.touch()


if __name__ == "__main__":
    main()
