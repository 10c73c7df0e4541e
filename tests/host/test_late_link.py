"""Camera speeds over a radio that delays: their time stamps say when, not their arrival."""

from __future__ import annotations

from collections import deque
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat import reference
from tailbeat.fish import Fish
from tailbeat.recompute import recompute_beats
from tailbeat.transport.inprocess import SimTransport
from tailbeat.transport.simulated import SimBoard
from tailbeat.trial_log import read_trial

SEEDS = 6
RMS_MAX_M_S = 1.5e-3
Floats = NDArray[np.float64]


class LateTransport(SimTransport):
    """50 to 300 ms each way, another delay for each piece, order kept: a Bluetooth module's."""

    def __init__(self, board: SimBoard, seed: int) -> None:
        super().__init__(board)
        self._random = np.random.default_rng(seed)
        self._up: deque[tuple[float, bytes]] = deque()
        self._down: deque[tuple[float, bytes]] = deque()

    def _later(self, queue: deque[tuple[float, bytes]], data: bytes) -> None:
        due_s = self.now_s() + self._random.uniform(0.05, 0.3)
        queue.append((max(due_s, queue[-1][0] if queue else 0.0), data))

    def _due(self, queue: deque[tuple[float, bytes]]) -> bytes:
        taken = b""
        while queue and queue[0][0] <= self.now_s():
            taken += queue.popleft()[1]
        return taken

    def write(self, data: bytes) -> None:
        self._later(self._up, data)

    def read(self) -> bytes:
        return self._due(self._down)

    def wait(self, timeout_s: float) -> None:
        end_s = self.now_s() + timeout_s
        while self.now_s() < end_s and not (self._down and self._down[0][0] <= self.now_s()):
            self.board.run(min(0.01, end_s - self.now_s()))
            if data := self.board.read():
                self._later(self._down, data)
            if data := self._due(self._up):
                self.board.write(data)


def swim(seed: int, folder: Path) -> tuple[Floats, Floats]:
    """(error, sigma) of each beat, m/s."""
    board = SimBoard("tank", seed=seed, camera_lost=0.1, link_bytes_per_s=0)
    with Fish(LateTransport(board, seed)) as fish:
        fish.link.run(9.0)
        for name, value in {"SPD_SOURCE": 0, "DU_MAX_RAD": 0, "AMP_MAX_RAD": 0.785}.items():
            fish.params.set(name, value)
        wanted = reference.thesis()
        fish.upload_reference(wanted)
        fish.upload_amplitudes(np.clip(0.197 + wanted.speed_m_s / 0.219, 0, 0.785))
        outcome = fish.run_trial()
        trial = read_trial(fish.pull_trial(outcome.number, folder))
    assert outcome.end == "complete"
    assert np.array_equal(recompute_beats(trial)[0], trial.beats.speed_m_s)
    error = trial.beats.speed_m_s - board.true_beats()[: len(trial.beats.speed_m_s)]
    return error, trial.beats.sigma_m_s.astype(float)


def test_vision(tmp_path: Path) -> None:
    swims = [swim(seed, tmp_path) for seed in range(1, SEEDS + 1)]
    error = np.array([error for error, _ in swims])
    sigma = np.array([sigma for _, sigma in swims])
    rms = np.sqrt(np.mean(error**2, axis=1))
    print(f"RMS of each swim, mm/s: {np.round(1e3 * rms, 2)}")
    assert np.all(rms <= RMS_MAX_M_S)
    assert np.mean(np.abs(error) < 2 * sigma) >= 0.9
    assert 0.5 <= np.mean((error / sigma) ** 2) <= 1.5
