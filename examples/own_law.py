"""An own learning law against a simulated fish: own_law.py [ADDRESS] (default: sim?seed=1).

The board executes the trials. The law below computes every input; the board's own law is not used.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from tailbeat import Fish, Reference, read_trial, reference, run_trial

TRIALS = 6
GAIN_RAD_S_M, LEAD_BEATS = 4.0, 1


def next_input(u_rad: np.ndarray, error_m_s: np.ndarray, u_max_rad: float) -> np.ndarray:
    """u_{j+1}(k) = Q[u_j(k) + gamma e_j(k + lead)], with a three-beat average as the filter Q."""
    e_m_s = np.nan_to_num(error_m_s)  # a beat that was not measured is not corrected
    ahead = np.append(e_m_s[LEAD_BEATS:], np.repeat(e_m_s[-1], LEAD_BEATS))
    u_rad = u_rad + GAIN_RAD_S_M * ahead
    smooth = np.convolve(np.pad(u_rad, 1, mode="edge"), [0.1, 0.8, 0.1], mode="valid")
    return np.clip(smooth, 0.0, u_max_rad)


def learn(fish: Fish, desired: Reference) -> list[float]:
    """Max |e| of each trial, m/s."""
    fish.params.apply({"AMP_MAX_RAD": 0.785, "ILC_LEAD": float(LEAD_BEATS)})
    fish.upload_reference(desired)
    u_rad = GAIN_RAD_S_M * desired.speed_m_s.astype(float)
    errors_m_s = []
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(TRIALS):
            fish.upload_amplitudes(u_rad)
            number = run_trial(fish).number
            trial = read_trial(fish.pull_trial(number, Path(folder)))
            fish.discard(number)  # the board does not learn from it
            errors_m_s.append(trial.max_abs_error_m_s())
            u_rad = next_input(u_rad, trial.beats.error_m_s, trial.params["AMP_MAX_RAD"])
    return errors_m_s


if __name__ == "__main__":
    with Fish.connect(*sys.argv[1:] or ["sim?seed=1"]) as connected:
        for j, error_m_s in enumerate(learn(connected, reference.thesis()), 1):
            print(f"trial {j}: max|e| {error_m_s * 1e3:.1f} mm/s")
