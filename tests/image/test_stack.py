"""What `make size` says of the stack, held against a session on the image."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tailbeat.board.connect import hear_board
from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimTransport
from tailbeat.sim.emulated import EmulatedBoard

TOOLS = Path(__file__).resolve().parents[2] / "tools"
PAINT = 0xA5
EXCEPTIONS, INTERRUPTS = 16, 45
NVIC_IPR = 0xE000E400

NewBoard = Callable[..., EmulatedBoard]


@pytest.fixture(scope="module")
def computed(image: Path) -> dict[str, Any]:
    """What the size tool computes."""
    command = [sys.executable, str(TOOLS / "size_report.py"), str(image), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    found: dict[str, Any] = json.loads(done.stdout)["stack"]
    return found


@pytest.fixture(scope="module")
def used(image: Path, tmp_path_factory: pytest.TempPathFactory) -> EmulatedBoard:
    """A board whose stack was painted before the first instruction, after a session."""
    board = EmulatedBoard(image)
    bottom = board.board.symbol("__stack_bottom")
    size = board.board.symbol("__stack_top") - bottom
    board.board.chip.memory.write(bottom, bytes([PAINT]) * size)
    transport = SimTransport(board)
    assert hear_board(transport) is not None
    with Fish(transport) as fish:
        fish.clock.sync()
        fish.params.set("ILC_GAIN", 3.0)
        fish.params.save()
        fish.upload_reference(records.encode_reference(1.0, [0.04] * 5))
        fish.arm()
        outcome = run_trial(fish)
        assert outcome.end == "complete"
        fish.pull_trial(outcome.number, tmp_path_factory.mktemp("trials"))
        fish.learn(outcome.number)
        fish.health()
    return board


def deepest(board: EmulatedBoard) -> int:
    """Bytes of the stack that were written to."""
    bottom = board.board.symbol("__stack_bottom")
    stack = board.board.read(bottom, board.board.symbol("__stack_top") - bottom)
    return len(stack) - next(i for i, byte in enumerate(stack) if byte != PAINT)


def test_no_session_goes_deeper_than_computed(
    used: EmulatedBoard, computed: dict[str, Any]
) -> None:
    depth, worst = deepest(used), computed["worst_bytes"]
    print(f"stack: {depth} bytes used in a session, {worst} computed as the worst")
    assert worst / 2 < depth <= worst


def test_interrupts_have_the_priorities_that_the_computation_takes(used: EmulatedBoard) -> None:
    """Those of all that have been switched on; the flash's is during the session."""
    table = tomllib.loads((TOOLS / "stack_facts.toml").read_text(encoding="utf-8"))["priority"]
    handlers = {used.board.symbol(name) | 1: name for name in table}
    vectors = used.board.symbol("vectors") + 4 * EXCEPTIONS
    found = {
        handlers[vector]: used.board.nvic.read(NVIC_IPR + number, 1) >> 4
        for number in range(INTERRUPTS)
        if (vector := used.board.word(vectors + 4 * number)) in handlers
    }
    assert found == table
