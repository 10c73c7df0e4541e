"""The port to another vendor's chip learns what the fish's image learns, bit for bit.

QEMU has no pins. The servo's pulses leave the port as bytes on its second UART; those of the fish's
image are measured at the emulated pin.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from elftools.elf.elffile import ELFFile

from tailbeat.app.demo import same_bits
from tailbeat.board.connect import hear_board
from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimTransport
from tailbeat.sim.emulated import EmulatedBoard
from vboard.core.clock import TICKS_PER_US

from .emcraft import QEMU, EmcraftBoard
from .test_pulses import probe

IMAGE = Path(__file__).resolve().parents[2] / "build" / "qemu" / "tailbeat_smartfusion2.elf"
BOOT_S = 30.0

TRIALS, SOAK_TRIALS = 2, 6
BEATS, BEAT_S = 5, 0.4
SPEED_M_S = (0.06 * np.sin(np.linspace(0.2, 2.9, BEATS))).astype(np.float32)
# Of each trial; any will do that are the same for both.
SPEEDS_M_S = np.random.default_rng(26).uniform(0, 0.06, (SOAK_TRIALS, BEATS)).astype(np.float32)
SPEEDS_M_S[1, 1] = np.nan
SIGMA_M_S = 0.001
UPLOAD = 1  # SPD_SOURCE
SERVO_TICKS_PER_US = 3

pytestmark = pytest.mark.skipif(
    shutil.which(QEMU) is None, reason=f"{QEMU} is not installed: apt-get install qemu-system-arm"
)


@dataclass
class Session:
    """The input after each trial, and every pulse."""

    learned: list[np.ndarray]
    pulses_ticks: list[int]


def prepare(fish: Fish) -> None:
    wanted = {
        "AMP_MAX_RAD": math.pi / 4, "DU_MAX_RAD": 0.0, "ILC_GAIN": 4.0, "ILC_LEAD": 1.0,
        "SPD_SOURCE": float(UPLOAD), "SETTLE_S": 2.0,
    }  # fmt: skip
    for name, value in wanted.items():
        fish.params.set(name, value)
    fish.upload_reference(records.encode_reference(BEAT_S, SPEED_M_S))


def learn_all(fish: Fish, trials: int) -> list[np.ndarray]:
    """The input after each trial."""
    learned = []
    for speed_m_s in SPEEDS_M_S[:trials]:
        outcome = run_trial(fish)  # waits until the port has erased what the trial will need
        assert outcome.end == "complete"
        fish.upload_speeds(outcome.number, speed_m_s, SIGMA_M_S)
        fish.learn(outcome.number)
        learned.append(fish.amplitudes().values)
    return learned


@pytest.fixture(scope="module", params=[TRIALS, pytest.param(SOAK_TRIALS, marks=pytest.mark.soak)])
def reference(image: Path, request: pytest.FixtureRequest) -> Session:
    """The session of the fish's image on the emulated board."""
    board = EmulatedBoard(image, seed=3)
    trace = probe(board)
    transport = SimTransport(board)
    assert hear_board(transport) is not None
    with Fish(transport) as fish:
        fish.clock.sync()
        prepare(fish)
        learned = learn_all(fish, request.param)
        board.run(1.0)
    pulses = trace.pulses()[1:]  # the pull-up before the first instruction
    assert all(pulse.ticks * SERVO_TICKS_PER_US % TICKS_PER_US == 0 for pulse in pulses)
    return Session(learned, [pulse.ticks * SERVO_TICKS_PER_US // TICKS_PER_US for pulse in pulses])


def symbols() -> dict[str, int]:
    """Addresses in the port's image."""
    with IMAGE.open("rb") as file:
        table = ELFFile(file).get_section_by_name(".symtab")
        return {symbol.name: symbol["st_value"] for symbol in table.iter_symbols()}


@pytest.fixture
def port(tmp_path: Path) -> Iterator[EmcraftBoard]:
    assert IMAGE.is_file(), "there is no image of the port to test: make smartfusion2"
    with EmcraftBoard(IMAGE, tmp_path) as board:
        yield board


def greet(board: EmcraftBoard) -> Fish:
    assert hear_board(board, BOOT_S) is not None, "no heartbeat"
    fish = Fish(board)
    fish.clock.sync()
    return fish


def learn_the_same(port: EmcraftBoard, reference: Session) -> None:
    trials = len(reference.learned)
    with greet(port) as fish:
        assert fish.info().board == "emulated"
        prepare(fish)
        learned = learn_all(fish, trials)
        health = fish.health()
    assert [same_bits(a, b) for a, b in zip(reference.learned, learned, strict=True)] == (
        [True] * trials
    )
    assert not same_bits(learned[-2], learned[-1])
    frames = port.pulses()
    assert [frame.number for frame in frames] == list(range(len(frames))), "a frame is missing"
    assert [frame.width_ticks for frame in frames if frame.width_ticks] == reference.pulses_ticks
    assert len(reference.pulses_ticks) > trials * BEATS * BEAT_S / 0.02
    print(f"{len(reference.pulses_ticks)} pulses; longest pause {health['longest_pause_us']} us")
    assert health["late_ticks"] == health["serial_overruns"] == health["store_failures"] == 0


def crash(port: EmcraftBoard) -> None:
    port.divert(symbols()["panic"], symbols()["register_names"])
    port.await_start()
    with greet(port) as fish:
        report = fish.crash_report()
        assert report is not None
        assert (report.kind, report.where, report.crashes) == ("assertion", "r0", 1)
        assert fish.health()["reset_cause"] == "software"
        fish.clear()


def test_trials_teach_the_port_what_they_teach_the_image(
    reference: Session, port: EmcraftBoard, tmp_path: Path
) -> None:
    """And it is still there after a crash and without power."""
    learn_the_same(port, reference)
    crash(port)
    port.__exit__(None, None, None)
    with EmcraftBoard(IMAGE, tmp_path) as again, greet(again) as fish:
        assert fish.health()["reset_cause"] == "power"
        assert same_bits(fish.amplitudes().values, reference.learned[-1])
