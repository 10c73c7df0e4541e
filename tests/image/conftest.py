"""The flash image on the emulated board, and what one does to it."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest

from tailbeat.board.connect import hear_board
from tailbeat.board.fish import Fish
from tailbeat.sim.board import SimTransport
from tailbeat.sim.emulated import EmulatedBoard
from vboard.core.bench import COMPILER, compile_program
from vboard.periph.models import reference_models

IMAGE = Path(__file__).resolve().parents[2] / "build" / "firmware" / "tailbeat.elf"
BOOT_S = 3.0

NewBoard = Callable[..., EmulatedBoard]
Connect = Callable[[EmulatedBoard], Fish]


@pytest.fixture(scope="session")
def image() -> Path:
    """The image that `make firmware` built."""
    assert IMAGE.is_file(), "there is no flash image to test: make firmware"
    return IMAGE


@pytest.fixture
def new_board(image: Path) -> NewBoard:
    """A board with the image and a fish around it; keywords as for EmulatedBoard."""

    def make(plant: str = "tank", **options: float) -> EmulatedBoard:
        return EmulatedBoard(image, plant, **options)

    return make


@pytest.fixture
def connect() -> Iterator[Connect]:
    """Waits for the board's heartbeat on the radio and greets it."""
    fishes: list[Fish] = []

    def to(board: EmulatedBoard) -> Fish:
        transport = SimTransport(board)
        assert hear_board(transport, BOOT_S) is not None, "no heartbeat"
        fish = Fish(transport)
        fish.clock.sync()
        fishes.append(fish)
        return fish

    yield to
    for fish in fishes:
        fish.close()


@pytest.fixture(params=["native", "reference"])
def both_models(request: pytest.FixtureRequest) -> Iterator[None]:
    """The test runs with the models in C and with those in Python."""
    with nullcontext() if request.param == "native" else reference_models():
        yield


@pytest.fixture
def build(tmp_path: Path) -> Callable[[str], Path]:
    """Compiles a program for the emulated chip."""
    if shutil.which(COMPILER) is None:
        pytest.skip(f"{COMPILER} is not installed")
    return lambda code: compile_program(code, tmp_path)
