"""The laws of a Monte Carlo study, each for a chunk of fish at once.

The board's law learns in C for all of them (host/native/learn_batch.h); learning with the model is
one fish after the other, by the very functions that a real fish is taught with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from tailbeat.core import trial_checks as judging
from tailbeat.core.arrays import F32, F64
from tailbeat.core.errors import InputError
from tailbeat.core.law import Law
from tailbeat.core.native import ffi, lib
from tailbeat.core.reference import Reference
from tailbeat.learning.convergence import Score, assess, input_crc
from tailbeat.learning.design import design
from tailbeat.learning.fish_model import SIGMA_M_S, FishModel, TrialSpeeds
from tailbeat.learning.identification import Identified
from tailbeat.learning.identification_runs import Limits, identify_runs
from tailbeat.learning.law_prediction import next_ratio
from tailbeat.learning.model_law import Proposal, propose
from tailbeat.learning.planner import plan
from tailbeat.studies.montecarlo.batch import BatchTrials, FishBatch
from tailbeat.studies.montecarlo.recipe import PASTS, LawSpec

ROLLED_BACK = "rolled_back"  # what the board's law says when it brought the best back
FIRST_RUN = 1001  # noise of identification runs is keyed from here, that of trials from 1


@dataclass
class BatchReport:
    """What a law reports of one trial; arrays (fish,), NaN or "" where it says nothing."""

    predicted_m_s: F64  # max|e|: 5 %, median, 95 %; shape (3, fish)
    ratio: F64  # (2, fish): the predicted range of max|e| over that of the trial before
    gain_rad_s_m: F64
    lead_beats: F64
    law: str | list[str]
    verdict: str | list[str]

    @classmethod
    def nothing(cls, fish: int) -> BatchReport:
        """A law that just swims."""
        none = np.full(fish, np.nan)
        return cls(
            np.full((3, fish), np.nan), np.full((2, fish), np.nan), none, none.copy(),
            "", "",
        )  # fmt: skip


class BatchLearner(Protocol):
    """A law at work: ``begin``, then ``following`` and ``learn`` in turn. ``following``: the
    amplitudes of the next iteration, (fish, beats), rad, as the tail does them; ``learn`` takes the
    trial of them and returns what the law reports of it."""

    floor_m_s: F64  # (fish,): max|e| of the least-squares optimum by what is known of the fish

    def begin(self, reference: Reference) -> None: ...

    def following(self) -> F64: ...

    def learn(self, swims: BatchTrials) -> BatchReport: ...


@dataclass
class FixedInput:
    """The same input again and again. ``amplitude_rad``: shape (beats,)."""

    amplitude_rad: F64
    fish: int
    floor_m_s: F64 = field(init=False)

    def __post_init__(self) -> None:
        self.floor_m_s = np.full(self.fish, np.nan)

    def begin(self, reference: Reference) -> None:
        """Of a reference that has as many beats."""

    def following(self) -> F64:
        """Always the same."""
        return np.tile(self.amplitude_rad, (self.fish, 1))

    def learn(self, swims: BatchTrials) -> BatchReport:
        """Learns nothing."""
        said = BatchReport.nothing(self.fish)
        said.law = "fixed"
        return said


@dataclass(frozen=True)
class PastKind:
    """What the board's law learns from: ``last``, ``mean`` or ``window`` (ILC_KIND 0, 1, 2), the
    last ``window`` trials (ILC_WINDOW)."""

    kind: str = "last"
    window: int = 3


class BoardLaw:
    """The board's law and memory, one ``Law`` per fish."""

    def __init__(
        self, laws: Sequence[Law], rollback_ratio: float, past: PastKind | None = None
    ) -> None:
        self.laws = list(laws)
        self.rollback_ratio = rollback_ratio
        self.past = past or PastKind()
        self.floor_m_s = np.full(len(self.laws), np.nan)

    def begin(self, reference: Reference) -> None:
        """Empties the memory."""
        fish, beats = len(self.laws), reference.beats
        self._memories = ffi.new("memory_t[]", fish)
        self._pasts = ffi.NULL if self.past.kind == "last" else ffi.new("learn_past_t[]", fish)
        self._reports = ffi.new("memory_report_t[]", fish)
        self._laws = ffi.new("law_t[]", fish)
        for i, law in enumerate(self.laws):
            self._laws[i] = asdict(replace(law, beat_s=reference.beat_s))
            if self._pasts:
                kind = PASTS.index(self.past.kind)
                self._must(lib.learn_past_begin(self._pasts + i, kind, self.past.window))
        self._wanted = np.ascontiguousarray(reference.speed_m_s, dtype=np.float32)
        self._trial = 0
        self._applied = np.empty((fish, beats))
        self._must(
            lib.learn_batch_first(
                self._memories, self._laws, fish, beats, _floats(self._wanted),
                _doubles(self._applied),
            )
        )  # fmt: skip

    def following(self) -> F64:
        """As the board executes it."""
        return self._applied

    def learn(self, swims: BatchTrials) -> BatchReport:
        """One trial of every fish."""
        speed = np.ascontiguousarray(swims.speed_m_s, dtype=np.float64)
        self._applied = np.empty_like(speed)
        self._trial += 1
        self._must(
            lib.learn_batch_learn(
                self._memories, self._pasts, self._laws, len(self.laws), _floats(self._wanted),
                _doubles(speed), self._trial, self.rollback_ratio, self._reports,
                _doubles(self._applied),
            )
        )  # fmt: skip
        said = BatchReport.nothing(len(self.laws))
        said.gain_rad_s_m = np.array([law.kp_rad_s_m for law in self.laws])
        said.lead_beats = np.array([float(law.lead_beats) for law in self.laws])
        said.law = "p" if self.past.kind == "last" else self.past.kind
        if self.rollback_ratio > 0:
            back = [report.rolled_back for report in self._reports]
            said.verdict = [ROLLED_BACK if rolled else "" for rolled in back]
        return said

    def _must(self, fine: bool) -> None:
        if not fine:
            raise InputError(
                "a law does not fit the reference.", "Look at gain, lead, q_len and limits."
            )


class DesignedLaw:
    """The board's law as ``tailbeat session design`` makes it for each fish, with the ratio of each
    step predicted before it is swum."""

    def __init__(
        self,
        identified: Sequence[Identified],
        spec: LawSpec,
        amplitude_max_rad: float,
    ) -> None:
        self.identified = list(identified)
        self.spec = spec
        self.amplitude_max_rad = amplitude_max_rad
        self.floor_m_s = np.full(len(self.identified), np.nan)

    def begin(self, reference: Reference) -> None:
        """Designs."""

        self._reference = reference
        laws = []
        for one in self.identified:
            law = design(
                one, reference, self.amplitude_max_rad, step_max_rad=self.spec.step_max_rad
            ).law
            if self.spec.fade > 0:
                law = replace(law, fade=self.spec.fade, fade_from=self.spec.fade_from)
            laws.append(law)
        self._board = BoardLaw(laws, self.spec.rollback_ratio)
        self._board.begin(reference)
        self._judges = [ConvergenceJudge(reference) for _ in laws]
        self._swum: list[TrialSpeeds] = []
        models = [one.model for one in self.identified]
        self.floor_m_s = predicted_floors(models, reference, self.amplitude_max_rad)

    def following(self) -> F64:
        """As the board executes it; predicts what that will change."""

        self._amplitude = self._board.following()
        ranges = [
            next_ratio(one, self._reference, swim, row)
            for one, swim, row in zip(self.identified, self._swum, self._amplitude)  # noqa: B905
        ]
        self._ratio = np.array(ranges).T if ranges else np.full((2, len(self.identified)), np.nan)
        return self._amplitude

    def learn(self, swims: BatchTrials) -> BatchReport:
        """One trial of every fish."""
        self._swum = swims_of(swims, self._amplitude, self._reference.beat_s, self._reference.crc)
        said = self._board.learn(swims)
        said.ratio = self._ratio
        said.verdict = verdicts(self._judges, self._swum)
        return said


class ModelBasedLaw:
    """Learning with the model, from identification on."""

    def __init__(
        self, identified: Sequence[Identified], fallback: Law, amplitude_max_rad: float
    ) -> None:
        self.identified = list(identified)
        self.fallback = fallback
        self.amplitude_max_rad = amplitude_max_rad
        self.floor_m_s = np.full(len(self.identified), np.nan)
        self._swims: list[list[TrialSpeeds]] = [[] for _ in self.identified]

    def begin(self, reference: Reference) -> None:
        """From the identification, and all that was swum along other references."""
        self._reference = reference
        self._judges = [ConvergenceJudge(reference) for _ in self.identified]
        models = [one.model for one in self.identified]
        self.floor_m_s = predicted_floors(models, reference, self.amplitude_max_rad)

    def following(self) -> F64:
        """Proposes."""

        self._proposals: list[Proposal] = [
            propose(one, self._reference, self.amplitude_max_rad, kept, self.fallback)
            for one, kept in zip(self.identified, self._swims, strict=True)
        ]
        models = [one.model for one in self._proposals]
        self.floor_m_s = predicted_floors(models, self._reference, self.amplitude_max_rad)
        rows = [np.asarray(one.amplitude_rad, dtype=np.float64) for one in self._proposals]
        self._amplitude = np.clip(np.array(rows), 0, self.amplitude_max_rad)
        return self._amplitude

    def learn(self, swims: BatchTrials) -> BatchReport:
        """One trial of every fish."""
        recorded = swims_of(swims, self._amplitude, self._reference.beat_s, self._reference.crc)
        for kept, swim in zip(self._swims, recorded, strict=True):
            kept.append(swim)
        said = BatchReport.nothing(len(recorded))
        said.predicted_m_s = np.array(
            [one.predicted_max_abs_error_m_s for one in self._proposals]
        ).T
        said.law = [one.law for one in self._proposals]
        said.verdict = verdicts(self._judges, recorded)
        return said


@dataclass
class ConvergenceJudge:
    """Passes the trials of one fish on to the verdict."""

    reference: Reference
    scores: list[Score] = field(default_factory=list)

    def verdict(self, swim: TrialSpeeds) -> str:
        """The kind of assessment of a trial."""
        error = self.reference.speed_m_s - swim.speed_m_s
        largest = float(np.nanmax(np.abs(error))) if swim.measured.any() else float("nan")
        number = len(self.scores) + 1
        self.scores.append(
            Score(
                trial=number,
                iteration=number,
                input_crc=input_crc(swim.amplitude_rad.astype(np.float32)),
                max_abs_error_m_s=largest,
                judged=judging.counts(error.astype(np.float32), bool(swim.measured[-1])),
                error_m_s=error.astype(np.float32),
            )
        )
        return assess(self.scores).kind


def verdicts(judges: Sequence[ConvergenceJudge], swims: Sequence[TrialSpeeds]) -> list[str]:
    """Of one trial of every fish."""
    return [one.verdict(swim) for one, swim in zip(judges, swims, strict=True)]


def swims_of(
    swims: BatchTrials, amplitude_rad: F64, beat_s: float, reference_crc: int = 0
) -> list[TrialSpeeds]:
    """One ``Swim`` per fish; the standard deviation of what was not measured is the usual one."""
    sigma = np.where(np.isfinite(swims.sigma_m_s), swims.sigma_m_s, SIGMA_M_S)
    return [
        TrialSpeeds(
            amplitude_rad=amplitude_rad[i],
            speed_m_s=swims.speed_m_s[i],
            sigma_m_s=sigma[i],
            beat_s=beat_s,
            reference_crc=reference_crc,
        )
        for i in range(len(amplitude_rad))
    ]


def identify(
    plant: str, settings: dict[str, float], amplitude_max_rad: float, beat_s: float
) -> Identified:
    """Identification runs of one simulated fish."""

    batch = FishBatch(plant, [settings])
    number = FIRST_RUN

    def swim(amplitude_rad: F64) -> TrialSpeeds:
        nonlocal number
        recorded = batch.run(amplitude_rad[None, :], number, beat_s)
        number += 1
        return swims_of(recorded, amplitude_rad[None, :], beat_s)[0]

    limits = Limits(amplitude_max_rad=amplitude_max_rad, beat_s=beat_s)
    return identify_runs(swim, limits, quick=True)


def predicted_floors(
    models: Sequence[FishModel], reference: Reference, amplitude_max_rad: float
) -> F64:
    """max|e| of the least-squares optimum by each fish's model, m/s, shape (fish,)."""

    return np.array(
        [
            plan(model, reference.speed_m_s, reference.beat_s, amplitude_max_rad)
            .max_abs_error_m_s
            for model in models
        ]
    )  # fmt: skip


def law_of(spec: LawSpec, amplitude_max_rad: float) -> Law:
    """The board's law with the values of a recipe."""
    return Law(
        kp_rad_s_m=spec.gain,
        lead_beats=spec.lead_beats,
        q_len=spec.q_len,
        fade=spec.fade,
        fade_from=spec.fade_from,
        step_max_rad=spec.step_max_rad,
        amplitude_max_rad=amplitude_max_rad,
    )


def _floats(array: F32) -> Any:
    return ffi.from_buffer("float[]", array)


def _doubles(array: F64) -> Any:
    return ffi.from_buffer("double[]", array)
