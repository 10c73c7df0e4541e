"""Flashing over SWD with OpenOCD. Only the pages of the image are erased: stored data stays."""

from __future__ import annotations

import re
from pathlib import Path

from tailbeat.board.flash.tools import Outcome, Run
from tailbeat.core.errors import TailbeatError

PROGRAM, PACKAGE = "openocd", "openocd"
ADAPTER = "cmsis-dap"
_TRANSPORTS = {"st-link": "dapdirect_swd"}  # OpenOCD's name for SWD by a chip of this probe

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
            *("-c", f"transport select {_TRANSPORTS.get(adapter, 'swd')}"),
            *("-f", "target/at91sam3ax_8x.cfg"),
            *("-c", "; ".join(commands)),
        ],
        _TIMEOUT_S,
    )
    if not outcome.ok or _VERIFIED not in outcome.output:
        raise TailbeatError(f"openocd could not write the image: {_why(outcome)}")


def _why(outcome: Outcome) -> str:
    """Behind the error OpenOCD prints where it came from, or a list of what there is instead."""
    errors = re.findall(r"Error: (.+)", outcome.output)
    return errors[-1].strip() if errors else outcome.last_words
