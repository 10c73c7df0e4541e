"""How the firmware died: the board's /crash.bin, and what its addresses mean."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tailbeat._native import ffi, lib
from tailbeat.errors import InputError

PATH = "/crash.bin"
KINDS = {
    1: "assertion",
    2: "hard fault",
    3: "memory fault",
    4: "bus fault",
    5: "usage fault",
    6: "unexpected interrupt",
}
# Configurable Fault Status Register (ARMv7-M, B3.2.15): bit, meaning.
_CFSR = {
    0: "instruction fetch not allowed",
    1: "access not allowed (stack guard)",
    4: "stacking ran into the stack guard",
    8: "instruction fetch failed",
    9: "no such address",
    10: "no such address (buffered write)",
    12: "stacking failed",
    16: "undefined instruction",
    17: "invalid state",
    18: "invalid return from an exception",
    24: "unaligned access",
    25: "division by zero",
}
_REGISTERS = (
    "r0", "r1", "r2", "r3", "r12", "lr", "pc", "xpsr", "sp", "exc_return",
    "cfsr", "hfsr", "mmfar", "bfar", "icsr",
)  # fmt: skip
_ADDR2LINE = "arm-none-eabi-addr2line"
_TIMEOUT_S = 20.0


@dataclass(frozen=True)
class CrashReport:
    """``registers``: those of the moment, with the fault status registers of ARMv7-M."""

    kind: str
    where: str  # "file:line" of a failed assertion, else ""
    reasons: list[str]  # what the fault status register says
    time_s: float  # since the boot that crashed
    crashes: int  # since power-on
    build_id: str
    registers: dict[str, int]
    stack: list[int]

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return asdict(self)


def decode_crash(record: bytes) -> CrashReport:
    """Raises InputError when ``record`` is no sound /crash.bin."""
    report = ffi.new("crash_report_t *")
    if lib.record_decode_crash(ffi.from_buffer(record), len(record), report):
        raise InputError("not a sound crash record", "Pull it again: tailbeat crash")
    crash = report.crash
    return CrashReport(
        kind=KINDS.get(crash.kind, f"kind {crash.kind}"),
        where=ffi.string(crash.where).decode("ascii", "replace"),
        reasons=[text for bit, text in _CFSR.items() if crash.cfsr >> bit & 1],
        time_s=crash.time_us * 1e-6,
        crashes=crash.crashes,
        build_id=ffi.string(report.build_id).decode("ascii", "replace"),
        registers={name: int(getattr(crash, name)) for name in _REGISTERS},
        stack=[int(word) for word in crash.stack[0 : crash.stack_words]],
    )


def places(report: CrashReport, elf: Path) -> list[str]:
    """``function at file:line`` of pc and lr, by the image that crashed. Empty without binutils."""
    if shutil.which(_ADDR2LINE) is None:
        return []
    if not elf.is_file():
        raise InputError(f"there is no image {elf}.", "Name the .elf of the build that crashed.")
    addresses = [f"0x{report.registers[name] & ~1:x}" for name in ("pc", "lr")]
    done = subprocess.run(
        [_ADDR2LINE, "-f", "-p", "-e", str(elf), *addresses],
        capture_output=True,
        text=True,
        timeout=_TIMEOUT_S,
        check=False,
    )
    return done.stdout.splitlines()
