"""Other learning laws on the same random fish: how far their inputs are from the fish's bound.

Four peers, written for this comparison: norm-optimal ILC with an identified ARX model, a PD law
with a zero-phase Q filter, a gradient law with the ARX model's adjoint, and a one-step law with a
Gaussian process (as AI-MOLE does: a GP of the next speed, linearised, then a norm-optimal step).
Each gets the same identification runs as the model-based law; its settings are the best of a grid
on development fish. Usage: peers.py [tune|run POPULATION FISH FIRST_SEED]
"""

from __future__ import annotations

import json
import math
import os
import secrets
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, ClassVar, Protocol

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import lsq_linear
from scipy.signal import butter, filtfilt

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.reference import thesis
from tailbeat.learning.belief import believe
from tailbeat.learning.fish_model import TrialSpeeds
from tailbeat.learning.identification import Identified
from tailbeat.learning.model_law import ModelStepSetting, propose_by
from tailbeat.studies.montecarlo.batch import FishBatch
from tailbeat.studies.montecarlo.learners import identify, speeds_of
from tailbeat.studies.montecarlo.populations import POPULATIONS, draw, still

Grid = dict[str, list[float]]


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    populations: tuple[str, ...]
    fish: int


FULL, TINY = Load(tuple(POPULATIONS), 40), Load(("mild",), 1)
MOST_RAD, TRIALS, FIRST_TRIAL = math.pi / 4, 6, 9
WANTED = thesis().speed_m_s.astype(np.float64)
BEATS = len(WANTED)
LAGS = 4
SETTINGS = Path(__file__).with_name("peers.json")


@dataclass
class Arx:
    """y_k = a y_(k-1) + sum b_i u_(k-i) + c, by ridge regression."""

    a: float
    b: F64
    c: float

    @classmethod
    def of(cls, identified: Identified) -> Arx:
        rows, right = [], []
        for trial in identified.trials:
            y = trial.speed_m_s
            for k in range(trial.beats):
                before = y[k - 1] if k else 0.0
                if np.isfinite(y[k]) and np.isfinite(before):
                    past = [trial.amplitude_rad[k - i] if k >= i else 0.0 for i in range(LAGS)]
                    rows.append([before, *past, 1.0])
                    right.append(y[k])
        x, y = np.array(rows), np.array(right)
        found = np.linalg.solve(x.T @ x + 1e-4 * np.eye(x.shape[1]), x.T @ y)
        return cls(min(float(found[0]), 0.98), found[1:-1], float(found[-1]))

    def matrix(self) -> F64:
        impulse = np.zeros(BEATS)
        for k in range(BEATS):
            impulse[k] = (self.a * impulse[k - 1] if k else 0.0) + (self.b[k] if k < LAGS else 0.0)
        return np.array([[impulse[k - j] if k >= j else 0.0 for j in range(BEATS)]
                         for k in range(BEATS)])  # fmt: skip

    def offset(self) -> F64:
        free = np.zeros(BEATS)
        for k in range(BEATS):
            free[k] = (self.a * free[k - 1] if k else 0.0) + self.c
        return free


def box_step(matrix: F64, error: F64, amplitude: F64, weight: float) -> F64:
    """argmin |e - G d|^2 + weight |d|^2 within the limits."""
    wide = np.vstack([matrix, math.sqrt(weight) * np.eye(BEATS)])
    right = np.concatenate([error, np.zeros(BEATS)])
    low, high = -amplitude - 1e-9, MOST_RAD - amplitude + 1e-9
    step: F64 = lsq_linear(wide, right, (low, high)).x
    return np.clip(amplitude + step, 0, MOST_RAD)


def static_inverse(identified: Identified) -> F64:
    """The first input by the line through steady speeds, one beat early."""
    amplitude = np.array([trial.amplitude_rad.max() for trial in identified.trials])
    speed = np.array([np.nanmax(trial.speed_m_s) for trial in identified.trials])
    slope, offset = np.polyfit(speed, amplitude, 1)
    ahead = np.append(WANTED[1:], WANTED[-1])
    return np.clip(np.where(ahead > 0.004, offset + slope * ahead, 0), 0, MOST_RAD)


class Law(Protocol):
    """``first``: the first input. ``following``: the next, from the last input, its errors (filled
    in where nothing was measured) and its speeds."""

    first: F64

    def following(self, amplitude: F64, error: F64, speed: F64) -> F64: ...


class NormOptimal:
    grid: ClassVar[Grid] = {"weight": [1e-4, 3e-4, 1e-3, 3e-3, 1e-2]}

    def __init__(self, identified: Identified, weight: float) -> None:
        model = Arx.of(identified)
        self.matrix, self.weight = model.matrix(), weight
        self.first = box_step(self.matrix, WANTED - model.offset(), np.zeros(BEATS), 1e-5)

    def following(self, amplitude: F64, error: F64, speed: F64) -> F64:
        return box_step(self.matrix, error, amplitude, self.weight)


class PdFilter:
    grid: ClassVar[Grid] = {"kp": [2.0, 3.0, 4.0], "kd": [0.0, 1.0, 2.0], "cut": [0.2, 0.35, 0.5]}

    def __init__(self, identified: Identified, kp: float, kd: float, cut: float) -> None:
        self.first, self.kp, self.kd, self.cut = static_inverse(identified), kp, kd, cut

    def following(self, amplitude: F64, error: F64, speed: F64) -> F64:
        ahead = np.append(error[1:], error[-1])
        moved = amplitude + self.kp * ahead + self.kd * (ahead - error)
        if self.cut < 0.5:
            moved = filtfilt(*butter(2, 2 * self.cut), moved, padlen=9)
        return np.clip(moved, 0, MOST_RAD)


class Gradient:
    grid: ClassVar[Grid] = {"share": [0.2, 0.5, 0.8, 1.2, 1.6]}

    def __init__(self, identified: Identified, share: float) -> None:
        model = Arx.of(identified)
        self.matrix = model.matrix()
        self.step = share / np.linalg.norm(self.matrix, 2) ** 2
        self.first = box_step(self.matrix, WANTED - model.offset(), np.zeros(BEATS), 1e-5)

    def following(self, amplitude: F64, error: F64, speed: F64) -> F64:
        return np.clip(amplitude + self.step * self.matrix.T @ error, 0, MOST_RAD)


class GaussianProcess:
    """Of y_k by (y_(k-1), u_k, u_(k-1), u_(k-2)); all trials count."""

    grid: ClassVar[Grid] = {"length": [0.7, 1.2, 2.0], "weight": [1e-4, 1e-3]}
    scale = np.array([0.05, 0.3, 0.3, 0.3])
    noise_m_s, size_m_s = 0.0015, 0.05

    def __init__(self, identified: Identified, length: float, weight: float) -> None:
        self.length, self.weight = length, weight
        self.x: list[list[float]] = []
        self.y: list[float] = []
        for trial in identified.trials:
            self.learn(trial.amplitude_rad, trial.speed_m_s)
        self.fit()
        amplitude = static_inverse(identified)
        for _ in range(6):
            amplitude = self.step(amplitude, np.zeros(BEATS), 1e-4)
        self.first = amplitude

    def learn(self, amplitude: F64, speed: F64) -> None:
        for k in range(len(amplitude)):
            row = [speed[k - 1] if k else 0.0] + [amplitude[k - i] if k >= i else 0.0
                                                  for i in range(3)]  # fmt: skip
            if np.all(np.isfinite(row)) and np.isfinite(speed[k]):
                self.x.append(row)
                self.y.append(speed[k])

    def kernel(self, a: F64, b: F64) -> F64:
        """A linear and a squared-exponential part."""
        p, q = a / self.scale, b / self.scale
        apart = np.sum((p[:, None, :] - q[None, :, :]) ** 2, axis=2)
        both: F64 = self.size_m_s**2 * (np.exp(-apart / (2 * self.length**2)) + p @ q.T + 1)
        return both

    def fit(self) -> None:
        x = np.array(self.x)
        k = self.kernel(x, x) + self.noise_m_s**2 * np.eye(len(x))
        self.alpha, self.points = cho_solve(cho_factor(k), np.array(self.y)), x

    def speeds(self, rows: F64) -> F64:
        out = np.zeros_like(rows)
        for k in range(BEATS):
            state = np.column_stack(
                [out[:, k - 1] if k else np.zeros(len(rows))]
                + [rows[:, k - i] if k >= i else np.zeros(len(rows)) for i in range(3)]
            )
            out[:, k] = np.clip(self.kernel(state, self.points) @ self.alpha, 0, 0.3)
        return out

    def step(self, amplitude: F64, left: F64, weight: float) -> F64:
        """``left``: measured less modelled speed."""
        difference = 0.01 * np.where(amplitude < MOST_RAD - 0.02, 1, -1)
        all_of = self.speeds(np.vstack([amplitude, amplitude + np.diag(difference)]))
        matrix = ((all_of[1:] - all_of[0]) / difference[:, None]).T
        return box_step(matrix, WANTED - all_of[0] - left, amplitude, weight)

    def following(self, amplitude: F64, error: F64, speed: F64) -> F64:
        self.learn(amplitude, speed)
        self.fit()
        modelled = self.speeds(amplitude[None])[0]
        return self.step(amplitude, WANTED - error - modelled, self.weight)


class Ours:
    grid: ClassVar[Grid] = {}

    def __init__(self, identified: Identified) -> None:
        self.belief = believe(identified, [])
        self.kept: list[TrialSpeeds] = []
        self.setting = ModelStepSetting(thesis(), MOST_RAD)
        self.first = propose_by(self.belief, self.setting).amplitude_rad

    def take(self, trial: TrialSpeeds) -> None:
        self.kept.append(trial)
        self.belief = self.belief.after(trial)

    def following(self, amplitude: F64, error: F64, speed: F64) -> F64:
        return propose_by(self.belief, self.setting, self.kept).amplitude_rad


PEERS: dict[str, Any] = {
    "norm-optimal": NormOptimal, "PD + Q": PdFilter, "gradient": Gradient, "GP": GaussianProcess,
    "model-based": Ours,
}  # fmt: skip


def learned(job: tuple[str, int, str, dict[str, float]]) -> list[float]:
    """max|e| of the inputs of the trials, on the fish without noise as it has drifted; the number
    of identification runs at the end. NaN of a fish that cannot be identified: no law learns it."""
    population, seed, name, settings = job
    fish = draw(population, "reactive", seed) | {"seed": float(seed)}
    try:
        identified = identify("reactive", fish, MOST_RAD, 1.0, 1)
    except InputError:
        return [np.nan] * (TRIALS + 1)
    law: Law = PEERS[name](identified, **settings)
    batch, quiet = FishBatch("reactive", [fish]), FishBatch("reactive", [still(fish)])
    amplitude, errors = law.first, []
    for number in range(FIRST_TRIAL, FIRST_TRIAL + TRIALS):
        true = quiet.run(amplitude[None], number).true_m_s[0]
        errors.append(float(np.abs(WANTED - true).max()))
        (trial,) = speeds_of(batch.run(amplitude[None], number), amplitude[None], 1.0, thesis().crc)
        error = WANTED - trial.speed_m_s
        seen = np.isfinite(error)
        filled = np.interp(np.arange(BEATS), np.flatnonzero(seen), error[seen])
        if isinstance(law, Ours):
            law.take(trial)
        amplitude = law.following(amplitude, filled, trial.speed_m_s)
    return [*errors, float(len(identified.trials))]


def tune(population: str, fish: int, first: int, pool: ProcessPoolExecutor) -> None:
    """The setting with the smallest median over fish of the sum of errors of trials 1 to 6."""
    known = json.loads(SETTINGS.read_text()) if SETTINGS.exists() else {}
    for name, kind in PEERS.items():
        options = [dict(zip(kind.grid, one, strict=True)) for one in product(*kind.grid.values())]
        jobs = [(population, seed, name, option) for option in options
                for seed in range(first, first + fish)]  # fmt: skip
        rows = np.array(list(pool.map(learned, jobs)))[:, :TRIALS]
        score = np.nanmedian(rows.sum(axis=1).reshape(len(options), fish), axis=1)
        best = options[int(np.argmin(score))]
        known.setdefault(population, {})[name] = best
        print(f"{population}, {name}: {best}, {1e3 * score.min() / TRIALS:.1f} mm/s", flush=True)
    SETTINGS.write_text(json.dumps(known, indent=1) + "\n")


def run(population: str, fish: int, first: int, pool: ProcessPoolExecutor) -> None:
    known = json.loads(SETTINGS.read_text())[population]
    medians = {}
    for name in PEERS:
        jobs = [(population, seed, name, known[name]) for seed in range(first, first + fish)]
        rows = np.array(list(pool.map(learned, jobs)))
        medians[name] = 1e3 * np.nanmedian(rows[:, :TRIALS], axis=0)
        runs, unknown = np.nanmedian(rows[:, TRIALS]), np.isnan(rows[:, TRIALS]).sum()
        left = f", {unknown} fish not identified" if unknown else ""
        print(f"{population:12} {name:13}", " ".join(f"{one:5.1f}" for one in medians[name]),
              f"  after {runs:.0f} identification runs{left}", flush=True)  # fmt: skip
    best = np.min([row for name, row in medians.items() if name != "model-based"], axis=0)
    print(f"{population:12} ours - best peer:", np.round(medians["model-based"] - best, 1))


def main(load: Load = FULL, arguments: Sequence[str] = ()) -> int:
    """``tune`` or ``run`` as told; without arguments all populations, with fresh fish."""
    first = secrets.randbits(30)
    with ProcessPoolExecutor(2) as pool:
        if not arguments:
            print(f"max|e| of the inputs of trials 1 to {TRIALS}, mm/s, medians over")
            print(f"{load.fish} fish, seeds from {first} on:")
            for population in load.populations:
                run(population, load.fish, first, pool)
            return 0
        what, population, fish, first_seed = arguments
        {"tune": tune, "run": run}[what](population, int(fish), int(first_seed), pool)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(FULL, sys.argv[1:]))
