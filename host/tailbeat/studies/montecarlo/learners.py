"""The laws of a Monte Carlo study, each for a chunk of simulated fish at once.

The fish are side by side: the simulator's water, tail and camera, without board and wire. Each
moves exactly as the simulated board's would with the same settings, seed and trial number; its
speeds are measured from its camera's noisy pictures by a line over each beat (sim/batch/batch.h).
They are taught with the very functions that a real fish is taught with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np

from tailbeat.core import trial_checks as judging
from tailbeat.core.arrays import F64
from tailbeat.core.law import PAST_KINDS, Averaging, Law, errors_of
from tailbeat.core.law_memory import LawMemories
from tailbeat.core.reference import Reference
from tailbeat.learning.belief import believe
from tailbeat.learning.convergence import Score, assess, input_crc
from tailbeat.learning.design import design
from tailbeat.learning.fish_model import SIGMA_M_S, FishModel, TrialSpeeds
from tailbeat.learning.identification import Identified
from tailbeat.learning.identification_runs import Limits, identify_runs
from tailbeat.learning.law_prediction import next_ratio
from tailbeat.learning.model_law import ModelStepSetting, propose_by
from tailbeat.learning.planner import plan
from tailbeat.studies.montecarlo.batch import BatchTrials, batch_of
from tailbeat.studies.montecarlo.recipe import LawSpec

ROLLED_BACK = "rolled_back"  # what the board's law reports when it brought the best back
FIRST_RUN = 1001  # noise of identification runs is keyed from here, that of trials from 1


Columns = dict[str, Any]
"""Columns of the results, each one value or shape (fish,)."""


class BatchLearner:
    """A law at work: ``begin``, then ``following`` and ``learn`` in turn. ``bound_m_s``: (fish,),
    max|e| of the least-squares optimum by what is known of the fish, NaN = nothing."""

    def __init__(self, fish: int) -> None:
        self.fish = fish
        self.bound_m_s: F64 = np.full(fish, np.nan)

    def begin(self, reference: Reference) -> None:
        """A reference; what was learned along another one before is kept if the law can use it."""

    def following(self) -> F64:
        """The amplitudes of the next iteration, (fish, beats), rad, as the tail executes them."""
        raise NotImplementedError

    def learn(self, trials: BatchTrials) -> Columns:
        """Learns from the trial of them; what it reports of it."""
        raise NotImplementedError


class FixedInput(BatchLearner):
    """The same input again and again. ``amplitude_rad``: shape (beats,), or (fish, beats)."""

    def __init__(self, amplitude_rad: F64, fish: int) -> None:
        super().__init__(fish)
        self.amplitude_rad = amplitude_rad

    def following(self) -> F64:
        return np.broadcast_to(self.amplitude_rad, (self.fish, self.amplitude_rad.shape[-1]))

    def learn(self, trials: BatchTrials) -> Columns:
        return {"swum_law": "fixed"}


class BoardLaw(BatchLearner):
    """The board's law and memory, one ``Law`` per fish. ``past``: what it learns from, a key of
    ``PAST_KINDS``, with a ``window`` of so many trials."""

    def __init__(
        self, laws: Sequence[Law], rollback_ratio: float, past: str = "last", window: int = 3
    ) -> None:
        super().__init__(len(laws))
        self.laws = list(laws)
        self.rollback_ratio = rollback_ratio
        self.past, self.window = past, window

    def begin(self, reference: Reference) -> None:
        """Empties the memory."""
        self._reference = reference
        self.laws = [replace(law, beat_s=reference.beat_s) for law in self.laws]
        averaging = Averaging(PAST_KINDS[self.past].number, self.window)
        self._memories = LawMemories(self.laws, reference.speed_m_s, averaging)
        self._most = np.array([[np.float32(law.amplitude_max_rad)] for law in self.laws])

    def following(self) -> F64:
        return np.clip(self._memories.amplitude_rad.astype(np.float64), 0.0, self._most)

    def learn(self, trials: BatchTrials) -> Columns:
        """A fish without any speed keeps its amplitudes; a trial without a speed in its last beat
        counts as cut short."""
        errors, measured = errors_of(self._reference.speed_m_s, trials.speed_m_s)
        back = self._memories.learn(errors, measured, measured[:, -1], self.rollback_ratio)
        return {
            "gain_rad_s_m": [law.kp_rad_s_m for law in self.laws],
            "lead_beats": [float(law.lead_beats) for law in self.laws],
            "swum_law": "p" if self.past == "last" else self.past,
            "verdict": np.where(back, ROLLED_BACK, "").tolist() if self.rollback_ratio > 0 else "",
        }


class _IdentifiedFish(BatchLearner):
    """Laws that rest on the identification of each fish; their trials are assessed."""

    def __init__(
        self, identified: Sequence[Identified], spec: LawSpec, amplitude_max_rad: float
    ) -> None:
        super().__init__(len(identified))
        self.identified = list(identified)
        self.spec = spec
        self.amplitude_max_rad = amplitude_max_rad
        self._trials: list[list[TrialSpeeds]] = [[] for _ in identified]

    def begin(self, reference: Reference) -> None:
        self._reference = reference
        self._scores: list[list[Score]] = [[] for _ in self.identified]
        self.bound_m_s = self._bounds([one.model for one in self.identified])

    def _bounds(self, models: Sequence[FishModel]) -> F64:
        """max|e| of the least-squares optimum by each fish's model, m/s."""
        wanted, most = self._reference, self.amplitude_max_rad
        plans = [plan(model, wanted.speed_m_s, wanted.beat_s, most) for model in models]
        return np.array([one.max_abs_error_m_s for one in plans])

    def _assessed(self, trials: BatchTrials) -> list[str]:
        """Keeps the trials of the last amplitudes; the kinds of their assessments."""
        reference = self._reference
        rows = speeds_of(trials, self._amplitude, reference.beat_s, reference.crc)
        for kept, scores, row in zip(self._trials, self._scores, rows, strict=True):
            kept.append(row)
            scores.append(_score(row, len(scores) + 1, reference))
        return [assess(scores).kind for scores in self._scores]

    _amplitude: F64


class DesignedLaw(_IdentifiedFish):
    """The board's law as ``tailbeat session design`` makes it for each fish, with the ratio of each
    step predicted before it is executed."""

    def begin(self, reference: Reference) -> None:
        """Designs."""
        super().begin(reference)
        spec, most = self.spec, self.amplitude_max_rad
        schedule: dict[str, Any] = (
            {"fade": spec.fade, "fade_from": spec.fade_from} if spec.fade > 0 else {}
        )
        designs = [
            design(one, reference, most, step_max_rad=spec.step_max_rad) for one in self.identified
        ]
        laws = [replace(one.law, **schedule) for one in designs]
        self._board = BoardLaw(laws, spec.rollback_ratio)
        self._board.begin(reference)
        self._trials = [[] for _ in self.identified]

    def following(self) -> F64:
        """Predicts what its amplitudes will change."""
        self._amplitude = self._board.following()
        self._ratio = np.full((2, self.fish), np.nan)
        for i, (one, kept) in enumerate(zip(self.identified, self._trials, strict=True)):
            if kept:
                ratio = next_ratio(one, self._reference, kept[-1], self._amplitude[i])
                self._ratio[:, i] = ratio
        return self._amplitude

    def learn(self, trials: BatchTrials) -> Columns:
        ratio = dict(zip(("ratio_low", "ratio_high"), self._ratio, strict=True))
        return self._board.learn(trials) | ratio | {"verdict": self._assessed(trials)}


class ModelBasedLaw(_IdentifiedFish):
    """Learning with the model, from the identification and all trials along any reference on."""

    def __init__(
        self, identified: Sequence[Identified], spec: LawSpec, amplitude_max_rad: float
    ) -> None:
        super().__init__(identified, spec, amplitude_max_rad)
        self._beliefs = [believe(one, []) for one in identified]

    def following(self) -> F64:
        """Proposes."""
        most = self.amplitude_max_rad
        setting = ModelStepSetting(self._reference, most, law=law_of(self.spec, most))
        self._proposals = [
            propose_by(one, setting, kept)
            for one, kept in zip(self._beliefs, self._trials, strict=True)
        ]
        self.bound_m_s = self._bounds([one.model for one in self._proposals])
        self._amplitude = np.clip([one.amplitude_rad for one in self._proposals], 0, most)
        return self._amplitude

    def learn(self, trials: BatchTrials) -> Columns:
        names = ("predicted_low_m_s", "predicted_max_abs_error_m_s", "predicted_high_m_s")
        quantiles = np.array([one.predicted_max_abs_error_m_s for one in self._proposals]).T
        report: Columns = dict(zip(names, quantiles, strict=True))
        laws = [one.law for one in self._proposals]
        verdicts = self._assessed(trials)
        for i, kept in enumerate(self._trials):
            if kept[-1].measured.any():
                self._beliefs[i] = self._beliefs[i].after(kept[-1])
        refuted = [float(one.refuted) for one in self._beliefs]
        return report | {"swum_law": laws, "verdict": verdicts, "refuted": refuted}


def _score(trial: TrialSpeeds, number: int, reference: Reference) -> Score:
    error = reference.speed_m_s - trial.speed_m_s
    return Score(
        trial=number,
        iteration=number,
        input_crc=input_crc(trial.amplitude_rad),
        max_abs_error_m_s=float(np.nanmax(np.abs(error))) if trial.measured.any() else np.nan,
        judged=judging.counts(error.astype(np.float32), bool(trial.measured[-1])),
        error_m_s=error.astype(np.float32),
    )


def speeds_of(
    trials: BatchTrials, amplitude_rad: F64, beat_s: float, reference_crc: int = 0
) -> list[TrialSpeeds]:
    """One per fish; the standard deviation of what was not measured is the usual one."""
    sigma = np.where(np.isfinite(trials.sigma_m_s), trials.sigma_m_s, SIGMA_M_S)
    rows = zip(amplitude_rad, trials.speed_m_s, sigma, strict=True)
    return [TrialSpeeds(*row, beat_s=beat_s, reference_crc=reference_crc) for row in rows]


def identify(
    plant: str,
    settings: dict[str, float],
    amplitude_max_rad: float,
    beat_s: float,
    first_run: int = FIRST_RUN,
) -> Identified:
    """Identification runs of one simulated fish. ``first_run``: keys the noise of the first."""
    batch = batch_of(plant, [settings])
    numbers = count(first_run)

    def execute(amplitude_rad: F64) -> TrialSpeeds:
        row = amplitude_rad[None, :]
        return speeds_of(batch.run(row, next(numbers), beat_s), row, beat_s)[0]

    limits = Limits(amplitude_max_rad=amplitude_max_rad, beat_s=beat_s)
    return identify_runs(execute, limits, quick=True)


def law_of(spec: LawSpec, amplitude_max_rad: float) -> Law:
    """The board's law with the values of a recipe."""
    names = ("lead_beats", "q_len", "fade", "fade_from", "step_max_rad")
    values = {name: getattr(spec, name) for name in names}
    return Law(kp_rad_s_m=spec.gain, amplitude_max_rad=amplitude_max_rad, **values)
