"""The flash image behind a bad line: what the simulated board bears, it bears too."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tailbeat.app.demo import same_bits
from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.link.impaired import Corrupt, Drop, Fault, ImpairedLine
from tailbeat.session.next_input import dry_run
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimTransport
from tailbeat.sim.emulated import EmulatedBoard

PATH = "/in/speeds.bin"
BYTES = 2000
BEATS, TRIALS = 5, 6
SPEEDS = 0.07 * np.sin(np.linspace(0.2, 2.9, BEATS))
NewBoard = Callable[..., EmulatedBoard]


def faults() -> list[Fault]:
    return [Drop(0.2), Corrupt(3e-4)]


def over_bad_line(board: EmulatedBoard) -> Fish:
    return Fish(ImpairedLine(SimTransport(board), faults(), faults(), seed=3))


def test_a_file_goes_up_and_comes_down(new_board: NewBoard, tmp_path: Path) -> None:
    data = np.random.default_rng(1).bytes(BYTES)
    with over_bad_line(new_board()) as fish:
        fish.ftp.write(PATH, data)
        fish.ftp.pull(PATH, tmp_path / "file")
        health = fish.health()
    assert (tmp_path / "file").read_bytes() == data
    assert health["serial_overruns"] == health["late_ticks"] == health["store_failures"] == 0


def learn_six(fish: Fish) -> list[np.ndarray]:
    for name, value in {"SPD_SOURCE": 1, "ILC_LEAD": 1, "DU_MAX_RAD": 0}.items():
        fish.params.set(name, value)
    fish.upload_reference(records.encode_reference(1.0, SPEEDS))
    learned = []
    for number in range(1, TRIALS + 1):
        assert run_trial(fish).end == "complete"
        assert fish.sim is not None
        fish.upload_speeds(number, fish.sim.world.true_beats()[:BEATS], np.full(BEATS, 1e-3))
        computed = dry_run(fish)
        fish.learn(number)
        learned.append(fish.amplitudes().values)
        assert same_bits(learned[-1], computed.amplitude_rad)
    return learned


@pytest.mark.soak
def test_a_session_learns_the_bits_that_the_simulated_board_learns(new_board: NewBoard) -> None:
    with Fish.connect("sim:tank", seed=1) as fish:
        simulated = learn_six(fish)
    with over_bad_line(new_board()) as fish:
        emulated = learn_six(fish)
    assert [same_bits(a, b) for a, b in zip(simulated, emulated, strict=True)] == [True] * TRIALS
