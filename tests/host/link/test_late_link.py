"""Camera speeds over a radio that delays: their time stamps say when, not their arrival."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tailbeat.board.fish import Fish
from tailbeat.core import reference
from tailbeat.core.arrays import F64
from tailbeat.core.speed_estimate import recompute_beats
from tailbeat.core.trial_file import read_trial
from tailbeat.link.impaired import Delay, ImpairedLine
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport

SEEDS = 6
RMS_MAX_M_S = 1.5e-3
Floats = F64


def trial(seed: int, folder: Path) -> tuple[Floats, Floats]:
    """(error, sigma) of each beat, m/s."""
    board = SimBoard("tank", seed=seed, camera_lost=0.1, link_bytes_per_s=0)
    late = ImpairedLine(SimTransport(board), [Delay(0.05, 0.3)], [Delay(0.05, 0.3)], seed)
    with Fish(late) as fish:
        fish.link.run(9.0)
        for name, value in {"SPD_SOURCE": 0, "DU_MAX_RAD": 0, "AMP_MAX_RAD": 0.785}.items():
            fish.params.set(name, value)
        wanted = reference.thesis()
        fish.upload_reference(wanted)
        fish.upload_amplitudes(np.clip(0.197 + wanted.speed_m_s / 0.219, 0, 0.785))
        outcome = run_trial(fish)
        trial = read_trial(fish.pull_trial(outcome.number, folder))
    assert outcome.end == "complete"
    assert np.array_equal(recompute_beats(trial)[0], trial.beats.speed_m_s)
    error = trial.beats.speed_m_s - board.world.true_beats()[: len(trial.beats.speed_m_s)]
    return error, trial.beats.sigma_m_s.astype(float)


def test_vision(tmp_path: Path) -> None:
    trials = [trial(seed, tmp_path) for seed in range(1, SEEDS + 1)]
    error = np.array([error for error, _ in trials])
    sigma = np.array([sigma for _, sigma in trials])
    rms = np.sqrt(np.mean(error**2, axis=1))
    print(f"RMS of each trial, mm/s: {np.round(1e3 * rms, 2)}")
    assert np.all(rms <= RMS_MAX_M_S)
    assert np.mean(np.abs(error) < 2 * sigma) >= 0.9
    assert 0.5 <= np.mean((error / sigma) ** 2) <= 1.5
