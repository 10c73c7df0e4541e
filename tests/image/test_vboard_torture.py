"""The exception model against QEMU's: one image, two machines, the same words."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from vboard.board import Board
from vboard.periph.models import reference_models

TORTURE = Path(__file__).parent / "torture"
EXPECTED = TORTURE / "expected.txt"
COMPILER, OBJCOPY, QEMU = "arm-none-eabi-gcc", "arm-none-eabi-objcopy", "qemu-system-arm"
VECTORS_BYTES = 8
QEMU_LIMIT_S = 600
WRITE0, EXIT = 0x04, 0x18


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The torture program."""
    if shutil.which(COMPILER) is None:
        pytest.skip(f"{COMPILER} is not installed")
    image = tmp_path_factory.mktemp("torture") / "torture.elf"
    command = [COMPILER, "-mcpu=cortex-m3", "-mthumb", "-O1", "-ffreestanding", "-nostdlib"]
    command += ["-Wall", "-Wextra", "-Werror", "-T", str(TORTURE / "torture.ld"), "-o", str(image)]
    subprocess.run([*command, *map(str, sorted(TORTURE.glob("*.c")))], check=True)
    return image


class Semihosting:
    """Serves the two calls that the program makes of a debugger."""

    def __init__(self, board: Board) -> None:
        self.board, self.output, self.finished = board, b"", False
        board.on_breakpoint = self.serve

    def serve(self, number: int) -> bool:
        operation, argument = self.board.cpu.read_general(0), self.board.cpu.read_general(1)
        if number != 0xAB or operation not in (WRITE0, EXIT):
            return False
        if operation == WRITE0:
            length = self.board.word(self.board.symbol("used"))
            self.output += self.board.read(argument, length)
        self.finished = operation == EXIT
        return True


def tortured(image: Path, disturb: Callable[[Board], None] | None = None) -> tuple[Board, str]:
    board = Board(image, peripherals=lambda soc: {})
    host = Semihosting(board)
    if disturb is not None:
        disturb(board)
    assert board.run_for(1.0, lambda: host.finished), f"stuck at {board.where()}"
    return board, host.output.decode()


def end_state(board: Board, output: str) -> list[object]:
    registers, ram = board.cpu.general_registers(), board.read(0x20070000, 0x18000)
    taken = board.chip.exceptions.taken
    return [board.clock.now, board.instructions, taken, output, registers, ram]


def test_vboard_says_what_qemu_said(image: Path) -> None:
    _, output = tortured(image)
    assert output.splitlines() == EXPECTED.read_text().splitlines()


def disturb(board: Board) -> None:
    for tick in range(0, 400_000, 61):
        board.clock.at(tick, lambda: None)


def test_slices_do_not_show(image: Path) -> None:
    """The same with an event every few instructions."""
    _, output = tortured(image, disturb)
    assert output.splitlines() == EXPECTED.read_text().splitlines()


def test_two_runs_are_the_same_bit_for_bit(image: Path) -> None:
    first, second = (tortured(image)[0] for _ in range(2))
    assert first.clock.now == second.clock.now
    assert first.instructions == second.instructions
    assert first.cpu.general_registers() == second.cpu.general_registers()
    assert first.read(0x20070000, 0x18000) == second.read(0x20070000, 0x18000)


def test_models_in_python_end_in_the_same_state(image: Path) -> None:
    """Also where an event comes every few instructions."""
    for disturbance in (None, disturb):
        native = end_state(*tortured(image, disturbance))
        with reference_models():
            assert end_state(*tortured(image, disturbance)) == native


def test_qemu_still_says_it(image: Path, tmp_path: Path) -> None:
    """If this fails, and rightly so, its output belongs into expected.txt."""
    if shutil.which(QEMU) is None:
        pytest.skip(f"{QEMU} is not installed")
    raw, vectors = tmp_path / "torture.bin", tmp_path / "vectors.bin"
    subprocess.run([OBJCOPY, "-O", "binary", image, raw], check=True)
    vectors.write_bytes(raw.read_bytes()[:VECTORS_BYTES])
    command = [QEMU, "-M", "mps2-an385", "-nographic", "-monitor", "none", "-serial", "none"]
    command += ["-icount", "shift=4", "-semihosting-config", "enable=on,target=native"]
    command += ["-kernel", str(image)]
    command += ["-device", f"loader,file={vectors},addr=0,force-raw=on"]
    done = subprocess.run(command, check=True, capture_output=True, timeout=QEMU_LIMIT_S)
    output = (done.stdout + done.stderr).decode()
    assert output.splitlines() == EXPECTED.read_text().splitlines()
