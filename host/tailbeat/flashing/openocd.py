"""Flashing over SWD with OpenOCD. Only the pages of the image are erased: stored data stays."""

from __future__ import annotations

from pathlib import Path

from tailbeat.errors import TailbeatError
from tailbeat.flashing.programs import Run

PROGRAM, PACKAGE = "openocd", "openocd"
ADAPTER = "cmsis-dap"

_TIMEOUT_S = 120.0
_VERIFIED = "Verified OK"


def write(run: Run, elf: Path, adapter: str = ADAPTER) -> None:
    """Programs and verifies ``elf``, makes the chip boot from flash and starts it."""
    commands = [
        "init",
        "reset halt",
        f"program {{{elf}}} verify",
        "at91sam3 gpnvm set 1",
        "at91sam3 gpnvm show",
        "reset run",
        "shutdown",
    ]
    outcome = run(
        [
            PROGRAM,
            *("-c", f"adapter driver {adapter}"),
            *("-c", "transport select swd"),
            *("-f", "target/at91sam3ax_8x.cfg"),
            *("-c", "; ".join(commands)),
        ],
        _TIMEOUT_S,
    )
    if not outcome.ok or _VERIFIED not in outcome.output:
        raise TailbeatError(f"openocd could not write the image: {outcome.last_words}")
