"""How the firmware died: the board's /crash.bin, and what its addresses mean."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tailbeat.board.flash.programs import build_id_of, require_program, run_program
from tailbeat.core.errors import InputError
from tailbeat.core.native import ffi, lib

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
_ADDR2LINE, _PACKAGE = "arm-none-eabi-addr2line", "binutils-arm-none-eabi"
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


def decode_crash(record: bytes) -> CrashReport:
    """Raises InputError when ``record`` is no sound /crash.bin."""
    report = ffi.new("crash_report_t *")
    if lib.record_decode_crash(ffi.from_buffer(record), len(record), report):
        raise InputError("not a sound crash record", "Pull it again: tailbeat board crash")
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
    """``pc: function at file:line`` and the same of lr, by the image that crashed.

    Raises InputError when ``elf`` is of another build or the program that looks it up is missing.
    """

    build_id = build_id_of(elf)
    if build_id != report.build_id:
        raise InputError(
            f"{elf} is of build {build_id}, but {report.build_id} crashed",
            "Name the .elf of that build, or leave --elf out.",
        )
    require_program(_ADDR2LINE, _PACKAGE)
    names = "pc", "lr"
    addresses = [f"0x{report.registers[name] & ~1:x}" for name in names]
    outcome = run_program([_ADDR2LINE, "-f", "-p", "-e", str(elf), *addresses], _TIMEOUT_S)
    if not outcome.ok:
        raise InputError(f"{elf} tells no places: {outcome.last_words}", "Leave --elf out.")
    lines = outcome.output.splitlines()
    return [f"{name}: {line}" for name, line in zip(names, lines, strict=False)]
