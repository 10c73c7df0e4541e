"""Flashing through the chip's boot loader with bossac.

Setting the boot bit and resetting in one call is a race that bossac 1.8 and 1.9 lose: the reset
comes before the bit is written and the board does not boot. Hence two calls.
"""

from __future__ import annotations

from tailbeat.board.flash.image import Image
from tailbeat.board.flash.ports import BoardPort
from tailbeat.board.flash.tools import Outcome, Run
from tailbeat.core.errors import TailbeatError

PROGRAM, PACKAGE = "bossac", "bossa-cli"

_ASK_TIMEOUT_S = 20.0
_WRITE_TIMEOUT_S = 180.0  # 256 KB over a UART at 115200 baud, written and read back, take 70 s


def loader_answers(run: Run, port: BoardPort) -> bool:
    """Whether the boot loader waits on ``port``, as it does on an erased chip."""
    return run([*_call(port), "-i"], _ASK_TIMEOUT_S).ok


def write(run: Run, port: BoardPort, image: Image) -> None:
    """Erases both banks, writes and verifies the image, and sets the boot bit."""
    outcome = run([*_call(port), "-e", "-w", "-v", "-b", str(image.path)], _WRITE_TIMEOUT_S)
    if not outcome.ok:
        raise TailbeatError(f"bossac could not write the image: {_why(outcome)}")


def start(run: Run, port: BoardPort) -> None:
    """Resets the chip into the image.

    Its success says nothing: on the programming port the mere opening of the port resets the chip,
    and then no boot loader is left to answer. Whether the image runs is for the caller to find out.
    """
    run([*_call(port), "-R"], _ASK_TIMEOUT_S)


def _why(outcome: Outcome) -> str:
    if "Verify failed" in outcome.output:
        return f"the flash holds something else than was written ({outcome.last_words})"
    return outcome.last_words


def _call(port: BoardPort) -> list[str]:
    name = port.device.removeprefix("/dev/")
    return [PROGRAM, f"--port={name}", f"-U{int(port.by_usb)}"]
