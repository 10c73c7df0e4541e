"""The flash image, the programs that write it (bossac over the boot loader, OpenOCD over SWD), and
the one that names places in it.

OpenOCD erases only the pages of the image: stored data stays. Of bossac: setting the boot bit and
resetting in one call is a race that bossac 1.8 and 1.9 lose: the reset comes before the bit is
written and the board does not boot. Hence two calls.
"""

from __future__ import annotations

import re
import shutil
import struct
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tailbeat.board.flash.ports import BoardPort
from tailbeat.board.memory import CrashReport
from tailbeat.core.errors import InputError, TailbeatError, reason
from tailbeat.core.image import image_remedy
from tailbeat.core.platform.programs import install_program

BOSSAC, OPENOCD = "bossac", "openocd"
_ADDR2LINE, _BINUTILS = "arm-none-eabi-addr2line", "binutils-arm-none-eabi"
PACKAGES = {BOSSAC: "bossa-cli", OPENOCD: "openocd"}
TOOLS = tuple(PACKAGES)

# Flash bank 0, which alone holds code, and the RAM a stack can lie in.
_CODE = range(0x00080000, 0x000C0000)
_RAM_FIRST, _RAM_END = 0x20000000, 0x20088000

# As in firmware/link/build_id.c.
_BUILD_ID = re.compile(rb"tailbeat build id: ([0-9][\x21-\x7e]{0,48})\0")
# The board says its id in one STATUSTEXT behind "tailbeat ", which cuts a longer one.
_SENT_CHARS = 40


@dataclass(frozen=True)
class Image:
    """The bytes of flash bank 0 from its first on, and the id of the build they are."""

    path: Path
    size_bytes: int
    build_id: str

    @classmethod
    def load(cls, path: Path) -> Image:
        """Reads a .bin and checks that it can boot on the chip. Raises InputError."""
        data = _read(path)
        problem = _not_bootable(data)
        if problem:
            raise InputError(f"{path} is no image for the board: {problem}", image_remedy())
        return cls(path, len(data), _build_id(path, data))

    def elf(self) -> Path:
        """The .elf next to the .bin. Raises InputError when it is missing or of another build."""
        path = self.path.with_suffix(".elf")
        if build_id_of(path) != self.build_id:
            raise InputError(f"{path} and {self.path.name} are of different builds", image_remedy())
        return path

    def is_build(self, board_id: str) -> bool:
        """Whether a board that says ``board_id`` runs this image."""
        cut = len(board_id) == _SENT_CHARS and self.build_id.startswith(board_id)
        return cut or board_id == self.build_id


def build_id_of(path: Path) -> str:
    """The build that an .elf or .bin says it is of. Raises InputError."""
    return _build_id(path, _read(path))


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(
            f"cannot read the image {path} ({reason(error)})", image_remedy()
        ) from error


def _not_bootable(data: bytes) -> str:
    """What is wrong with the first two words, which the chip loads at reset; empty if nothing."""
    if data.startswith(b"\x7fELF"):
        return "it is an ELF file; give the .bin beside it"
    if len(data) < 8:
        return "it is too short"
    if len(data) > len(_CODE):
        return f"its {len(data)} bytes do not fit into the {len(_CODE)} of flash bank 0"
    stack, entry = struct.unpack_from("<II", data)
    if not _RAM_FIRST < stack <= _RAM_END or stack % 4:
        return f"its stack would begin at {stack:#x}, which is not RAM"
    if entry % 2 == 0 or entry not in _CODE[: len(data)]:
        return f"it would start at {entry:#x}, which is not in it"
    return ""


def _build_id(path: Path, data: bytes) -> str:
    found = {match[1] for match in _BUILD_ID.finditer(data)}
    if len(found) != 1:
        raise InputError(f"{path} does not say which build of tailbeat it is", image_remedy())
    return found.pop().decode()


_ENDED_BY_TIMEOUT = -1


@dataclass(frozen=True)
class ProgramResult:
    """How a program ended, and all it said."""

    status: int
    output: str

    @property
    def ok(self) -> bool:
        """Whether it reports success."""
        return self.status == 0

    @property
    def last_words(self) -> str:
        """The last line it printed: usually the reason."""
        lines = [line.strip() for line in re.split(r"[\r\n]+", self.output) if line.strip()]
        return lines[-1] if lines else f"exit status {self.status}"


Run = Callable[[Sequence[str], float], ProgramResult]


def run_program(command: Sequence[str], timeout_s: float) -> ProgramResult:
    """Runs ``command`` to its end; after ``timeout_s`` it is killed."""
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired as late:
        said = (late.stdout or b"").decode(errors="replace")
        return ProgramResult(_ENDED_BY_TIMEOUT, f"{said}\nit did not end within {timeout_s:g} s")
    return ProgramResult(done.returncode, done.stdout.decode(errors="replace"))


def require_program(name: str, package: str) -> None:
    """Raises InputError when ``name`` is not installed."""
    if shutil.which(name) is None:
        raise InputError(f"the program {name} is missing", install_program(package))


_ASK_TIMEOUT_S = 20.0
_BOSSAC_TIMEOUT_S = 180.0  # 256 KB over a UART at 115200 baud, written and read back, take 70 s


def loader_answers(run: Run, port: BoardPort) -> bool:
    """Whether the boot loader waits on ``port``, as it does on an erased chip."""
    return run([*_bossac(port), "-i"], _ASK_TIMEOUT_S).ok


def write_by_bossac(run: Run, port: BoardPort, image: Image) -> None:
    """Erases both banks, writes and verifies the image, and sets the boot bit."""
    outcome = run([*_bossac(port), "-e", "-w", "-v", "-b", str(image.path)], _BOSSAC_TIMEOUT_S)
    if not outcome.ok:
        raise TailbeatError(f"bossac could not write the image: {_why_bossac(outcome)}")


def start_by_bossac(run: Run, port: BoardPort) -> None:
    """Resets the chip into the image.

    Its success says nothing: on the programming port the mere opening of the port resets the chip,
    and then no boot loader is left to answer. Whether the image runs is for the caller to find out.
    """
    run([*_bossac(port), "-R"], _ASK_TIMEOUT_S)


def _why_bossac(outcome: ProgramResult) -> str:
    if "Verify failed" in outcome.output:
        return f"the flash holds something else than was written ({outcome.last_words})"
    return outcome.last_words


def _bossac(port: BoardPort) -> list[str]:
    name = port.device.removeprefix("/dev/")
    return [BOSSAC, f"--port={name}", f"-U{int(port.by_usb)}"]


ADAPTER = "cmsis-dap"
_TRANSPORTS = {"st-link": "dapdirect_swd"}  # OpenOCD's name for SWD by a chip of this probe

_OPENOCD_TIMEOUT_S = 120.0
_VERIFIED = "Verified OK"


def write_by_openocd(run: Run, elf: Path, adapter: str = ADAPTER) -> None:
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
            OPENOCD,
            *("-c", f"adapter driver {adapter}"),
            *("-c", f"transport select {_TRANSPORTS.get(adapter, 'swd')}"),
            *("-f", "target/at91sam3ax_8x.cfg"),
            *("-c", "; ".join(commands)),
        ],
        _OPENOCD_TIMEOUT_S,
    )
    if not outcome.ok or _VERIFIED not in outcome.output:
        raise TailbeatError(f"openocd could not write the image: {_why_openocd(outcome)}")


def _why_openocd(outcome: ProgramResult) -> str:
    """Behind the error OpenOCD prints where it came from, or a list of what there is instead."""
    errors = re.findall(r"Error: (.+)", outcome.output)
    return errors[-1].strip() if errors else outcome.last_words


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
    require_program(_ADDR2LINE, _BINUTILS)
    names = "pc", "lr"
    addresses = [f"0x{report.registers[name] & ~1:x}" for name in names]
    outcome = run_program([_ADDR2LINE, "-f", "-p", "-e", str(elf), *addresses], _ASK_TIMEOUT_S)
    if not outcome.ok:
        raise InputError(f"{elf} tells no places: {outcome.last_words}", "Leave --elf out.")
    lines = outcome.output.splitlines()
    return [f"{name}: {line}" for name, line in zip(names, lines, strict=False)]
