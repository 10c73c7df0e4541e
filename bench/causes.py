"""Planted causes: how often the diagnosis names them on random fish, and what its proposal does.

Each case is one fish, one reference and one or two causes, the first scaled so that the error of
the fish's input (on its noise-free plant) is about 1.75 times what it was, a second at 0.4 of its
own scale. Causes act from the first trial on; a fish changes after one healthy trial, and in rows
of their own after four. Named: within three trials of the cause; of a healthy fish in its first
three, and in rows of their own after four. Usage: causes.py [FISH FIRST_SEED [CAUSE[+CAUSE],...]]
"""

from __future__ import annotations

import os
import secrets
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import count, product

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.law import Law, errors_of, update
from tailbeat.core.law_memory import first_amplitudes
from tailbeat.core.reference import Reference, thesis
from tailbeat.learning.belief import Beliefs
from tailbeat.learning.design import design
from tailbeat.learning.diagnosis import Cause, CauseFound, Evidence, diagnose
from tailbeat.learning.error_bound import suggest
from tailbeat.learning.fish_model import TrialSpeeds
from tailbeat.learning.identification import Identified
from tailbeat.learning.identification_runs import identify_trials
from tailbeat.learning.model_law import ModelStepSetting, propose_by
from tailbeat.session.measure import rise
from tailbeat.studies.montecarlo.batch import FishBatch
from tailbeat.studies.montecarlo.learners import speeds_of
from tailbeat.studies.montecarlo.populations import draw, still

C = Cause
MOST_RAD, FEASIBLE_RAD = 1.0, 0.9
RAISED, RAISED_MIN = 1.75, 1.5  # times the healthy error: what is aimed at, what counts as reached
SECOND = 0.4  # of its own scale
DRAWS = 3  # of noise, for each error that is compared
WITHIN = 3  # trials
# Healthy trials before those in which causes are looked for.
BEFORE, BEFORE_NONE, BEFORE_CHANGE = (0,), (0, 4), (1, 4)
WORSE_MOST_M_S = 0.001
BY_P_LAW = (C.MISSING, C.GAIN)  # what the model-based law does not know
STEPS = 64  # of a scale
SCALES: dict[Cause, F64] = {
    C.SATURATION: np.linspace(0.99, 0.4, STEPS),  # the limit, of the healthy input's top
    C.INFEASIBLE: np.linspace(0.02, 1.0, STEPS),  # how deep the speed dips for some beats
    C.MISSING: np.linspace(0.05, 0.95, STEPS),  # of the beats
    C.DISTURBANCE: np.geomspace(1.2, 12, STEPS),  # times the fish's own
    C.MISFIT: np.geomspace(0.01, 0.5, STEPS),  # thrust lost around 75 % of the top amplitude
    C.CHANGED: np.geomspace(0.005, 0.4, STEPS),  # thrust lost
    C.GAIN: np.geomspace(1.1, 6, STEPS),  # times the designed gain
}
HEALTHY = {C.SATURATION: 1.0, C.DISTURBANCE: 1.0, C.GAIN: 1.0}  # the others: 0
PAIRS = (
    (C.SATURATION, C.DISTURBANCE), (C.INFEASIBLE, C.MISFIT), (C.CHANGED, C.SATURATION),
    (C.MISSING, C.GAIN), (C.DISTURBANCE, C.MISFIT),
)  # fmt: skip
CASES: tuple[tuple[Cause, ...], ...] = ((), *((one,) for one in Cause), *PAIRS)
Scales = dict[Cause, float]


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    fish: int
    cases: tuple[tuple[Cause, ...], ...] = CASES
    plants: tuple[str, ...] = ("tank", "mild", "realistic")
    references: tuple[str, ...] = ("thesis", "feasible")


FULL = Load(1)


def settings_of(plant: str, seed: int) -> dict[str, float]:
    """Of a fish. ``tank``: the first plant."""
    if plant != "tank":
        return draw(plant, "reactive", seed)
    rng = np.random.default_rng([seed, 99])
    return {
        "kappa_per_m": float(rng.choice([5.0, 10.0, 20.0])),
        "delay_s": float(rng.uniform(0.05, 0.35)),
        "place_sigma_m": 0.005,
        "place_sigma_rad": 0.0175,
    }


def noisier(fish: dict[str, float], times: float) -> dict[str, float]:
    usual = {"gain_sigma": 0.02, "flow_sigma_m_s": 0.0015, "flow_moves_m_s": 0.0}
    found = fish | {name: fish.get(name, value) * times for name, value in usual.items()}
    found["flow_moves_m_s"] = max(fish.get("flow_moves_m_s", 0.0), 0.001) * times
    return found


@dataclass
class Fish:
    """One fish with causes. ``top_rad``: of its healthy input; ``trial`` 0: before the series;
    ``healthy``: trials of the series before it changes."""

    plant: str
    seed: int
    scales: Scales
    top_rad: float = MOST_RAD
    repeat: int = 0
    trial: int = 0
    healthy: int = BEFORE_CHANGE[0]
    _numbers: Iterator[int] = field(default_factory=lambda: count(1))

    def __post_init__(self) -> None:
        kind = "tank" if self.plant == "tank" else "reactive"
        fish = settings_of(self.plant, self.seed) | {"seed": self.seed + 100_000 * self.repeat}
        self.calm, self.judge = FishBatch(kind, [fish]), FishBatch(kind, [still(fish)])
        if C.DISTURBANCE in self.scales:
            fish = noisier(fish, self.scales[C.DISTURBANCE])
        if C.MISSING in self.scales:
            fish = fish | {"lost_beats": self.scales[C.MISSING]}
        self.troubled = FishBatch(kind, [fish])

    def cured(self, cause: Cause) -> None:
        """What an operator does about it by hand."""
        if cause is C.MISSING:
            self.troubled = self.calm

    def run(self, amplitude_rad: F64, crc: int = 0) -> TrialSpeeds:
        amplitude = np.clip(amplitude_rad, 0, MOST_RAD)
        executed = self._thrust(amplitude)[None]
        batch = self.troubled if self.trial else self.calm
        found = speeds_of(batch.run(executed, next(self._numbers)), executed, 1.0, crc)[0]
        return replace(found, amplitude_rad=amplitude, trial=self.trial)

    def error_m_s(self, amplitude_rad: F64, reference: Reference) -> float:
        """Of an input, max|e| on the noise-free plant."""
        speed = self.judge.run(self._thrust(amplitude_rad)[None], 1).true_m_s[0]
        return float(np.abs(reference.speed_m_s - speed).max())

    def measured(self, known: Sequence[TrialSpeeds] = ()) -> Identified:
        """As commissioning does: two trim runs, one rising run; later only the latter."""
        trim = np.concatenate([rise(0.5, 4)[:4], np.full(8, 0.5), np.zeros(2)])
        runs = list(known) or [self.run(trim), self.run(trim)]
        return identify_trials([*runs, self.run(rise(MOST_RAD, 12))], quick=True)

    def _thrust(self, amplitude_rad: F64) -> F64:
        amplitude = np.clip(amplitude_rad, 0, MOST_RAD)
        if C.MISFIT in self.scales:
            near = (amplitude - 0.75 * self.top_rad) / (0.12 * self.top_rad)
            amplitude = amplitude * (1 - self.scales[C.MISFIT] * np.exp(-(near**2)))
        if C.CHANGED in self.scales and self.trial > self.healthy:
            amplitude = amplitude * (1 - self.scales[C.CHANGED])
        return np.asarray(amplitude)


@dataclass
class Series:
    """Trials of one fish, and what is found after each."""

    fish: Fish
    identified: Identified
    reference: Reference
    limit_rad: float
    law: Law | None
    inputs: list[F64] = field(default_factory=list)
    trials: list[TrialSpeeds] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.beliefs = Beliefs(self.identified)

    def executed(self) -> float:
        """Runs one more trial; the error of its input."""
        input_rad = self.planned()
        self.fish.trial += 1
        self.inputs.append(input_rad)
        self.trials.append(self.fish.run(input_rad, self.reference.crc))
        return self.fish.error_m_s(input_rad, self.reference)

    def planned(self) -> F64:
        """The next input."""
        if self.law is None:
            law = Law(kp_rad_s_m=4.0, lead_beats=1)
            setting = ModelStepSetting(self.reference, self.limit_rad, law=law)
            known = self._telling()
            found = propose_by(self.beliefs.after(known), setting, known).amplitude_rad
            return np.clip(found, 0, self.limit_rad)
        law = replace(self.law, amplitude_max_rad=self.limit_rad)
        if not self.trials:
            return np.asarray(first_amplitudes(law, self.reference.speed_m_s), float)
        if not self.trials[-1].measured.any():
            return self.inputs[-1]
        error, measured = errors_of(self.reference.speed_m_s, self.trials[-1].speed_m_s)
        return np.asarray(update(law, np.float32(self.inputs[-1]), error, measured)[0], float)

    def found(self) -> list[CauseFound]:
        known = self._telling()
        if not known:
            return [CauseFound(C.MISSING, 1.0, "", "", "")]
        belief = self.beliefs.after(known)
        return diagnose(Evidence(self.reference, self.limit_rad, known, belief, self.law, MOST_RAD))

    def followed(self, found: CauseFound) -> float:
        """The error of the next input once the proposal was carried out."""
        if found.cause is C.DISTURBANCE and found.value is not None:
            return self.fish.error_m_s(self.inputs[int(found.value) - 1], self.reference)
        if found.cause is C.GAIN:
            worst = [float(np.nanmax(np.abs(self.reference.speed_m_s - one.speed_m_s)))
                     for one in self._telling()]  # fmt: skip
            return self.fish.error_m_s(self.inputs[int(np.argmin(worst))], self.reference)
        if found.cause is C.SATURATION:
            self.limit_rad = MOST_RAD
        elif found.cause is C.INFEASIBLE:
            known = self.beliefs.identified
            self.reference = suggest(known, self.reference, self.limit_rad).reference
            self.law, self.trials = None, []
        elif found.cause is C.MISFIT:  # its trials go on to correct the model
            self.beliefs = Beliefs(self.fish.measured(self.identified.trials))
        elif found.cause is C.CHANGED:
            runs = [one for one in self._telling() if one.trial >= int(found.value or 0)]
            self.beliefs, self.trials = Beliefs(self.fish.measured(runs)), []
        self.fish.cured(found.cause)
        return self.fish.error_m_s(self.planned(), self.reference)

    def _telling(self) -> list[TrialSpeeds]:
        return [one for one in self.trials if one.measured.any()]


def dipping(reference: Reference, depth: float) -> Reference:
    """Slower by that part for some beats in the middle."""
    beat = np.arange(reference.beats) - reference.beats // 2
    part = 1 - depth * np.exp(-((beat / 2.5) ** 8))
    return Reference(reference.beat_s, (reference.speed_m_s * part).astype(np.float32), "dips")


@dataclass
class Case:
    """A fish, a reference and causes, scaled. ``raised``: times the healthy error, by the first."""

    plant: str
    seed: int
    reference_name: str
    causes: tuple[Cause, ...]
    scales: Scales = field(default_factory=dict)
    raised: float = RAISED

    def __post_init__(self) -> None:
        fish = Fish(self.plant, self.seed, {})
        self.identified = fish.measured()
        self.reference = thesis()
        if self.reference_name == "feasible":
            self.reference = suggest(self.identified, thesis(), FEASIBLE_RAD).reference
        by_p = any(cause in BY_P_LAW for cause in self.causes)
        self.law = design(self.identified, self.reference, MOST_RAD).law if by_p else None
        healthy = Series(fish, self.identified, self.reference, MOST_RAD, None)
        self.top_rad = float(healthy.planned().max())
        for number, cause in enumerate(self.causes):
            scale, raised = self._scaled(cause)
            if number == 0:
                self.raised = raised
            else:
                usual = HEALTHY.get(cause, 0.0)
                scale = usual + SECOND * (scale - usual)
            self.scales[cause] = scale

    def series(self, scales: Scales, repeat: int = 0) -> Series:
        fish = Fish(self.plant, self.seed, scales, self.top_rad, repeat)
        identified = fish.measured() if repeat or C.MISFIT in scales else self.identified
        reference, law = self.reference, self.law
        if C.INFEASIBLE in scales:
            reference = dipping(reference, scales[C.INFEASIBLE])
        limit = scales[C.SATURATION] * self.top_rad if C.SATURATION in scales else MOST_RAD
        if law is not None:
            law = replace(law, kp_rad_s_m=law.kp_rad_s_m * scales.get(C.GAIN, 1.0))
        return Series(fish, identified, reference, limit, law)

    def _scaled(self, cause: Cause) -> tuple[float, float]:
        """The scale by which the error is raised as much as is aimed at, or the largest there is;
        and what it does. The error is the mean over several draws of noise, the same ones with the
        cause and without: in one draw, noise alone may raise it as much."""
        late = self.law is not None or cause is C.DISTURBANCE
        trials = slice(0, 1) if cause is C.MISFIT else slice(2, 4) if late else slice(1, 2)
        usual = self._error({}, trials)

        def raised_by(step: int) -> float:
            return self._error({cause: SCALES[cause][step]}, trials) / usual

        raised: dict[int, float] = {}
        low, high = 0, STEPS - 1
        while low < high:  # errors grow with the scale, by and large
            middle = (low + high) // 2
            raised[middle] = raised_by(middle)
            low, high = (low, middle) if raised[middle] >= RAISED else (middle + 1, high)
        if high not in raised:
            raised[high] = raised_by(high)
        nearest = min(raised, key=lambda step: abs(raised[step] - RAISED))
        return float(SCALES[cause][nearest]), raised[nearest]

    def _error(self, scales: Scales, trials: slice) -> float:
        """Mean over these trials of the first four, and over draws of noise."""
        rows = [self.series(scales, repeat) for repeat in range(DRAWS)]
        return float(np.mean([[one.executed() for _ in range(4)][trials] for one in rows]))


@dataclass(frozen=True)
class Outcome:
    """``named``: the dominant cause where it was named, else what was. ``worse_m_s``: by the first
    proposal, than the trial that it came after."""

    key: tuple[str, str, str]
    named: str
    raised: float
    worse_m_s: float | None


def name_of(causes: tuple[Cause, ...]) -> str:
    return " + ".join(causes) or "none"


def healthy_trials(causes: tuple[Cause, ...]) -> tuple[int, ...]:
    """Of the rows with these causes."""
    if not causes:
        return BEFORE_NONE
    return BEFORE_CHANGE if C.CHANGED in causes else BEFORE


def outcome_of(job: tuple[str, int, str, tuple[Cause, ...], int]) -> Outcome:
    plant, seed, reference_name, causes, healthy = job
    case = Case(plant, seed, reference_name, causes)
    series = case.series(case.scales)
    series.fish.healthy = healthy
    named: list[Cause] = []
    worse: float | None = None
    for _ in range(healthy):
        series.executed()
    for _ in range(WITHIN):
        error = series.executed()
        if found := series.found():
            named.append(found[0].cause)
            if worse is None:
                trials, inputs = list(series.trials), list(series.inputs)
                aside = replace(series, fish=series.fish, trials=trials, inputs=inputs)
                aside.beliefs = Beliefs(series.identified)
                cause, calm = found[0], series.fish.troubled
                worse = aside.followed(cause) - error
                series.fish.troubled = calm
    wanted = case.causes[0] if case.causes else None
    said = wanted if wanted in named else named[0] if named else None
    raised = case.raised if case.causes else 1.0
    late = f" after {healthy} trials" if healthy > BEFORE_CHANGE[0] else ""
    key = case.plant, case.reference_name, name_of(case.causes) + late
    return Outcome(key, said or "none", raised, worse)


def main(load: Load = FULL, arguments: Sequence[str] = ()) -> int:
    """A row for each plant, reference and cause."""
    first = int(arguments[1]) if len(arguments) > 1 else secrets.randbits(30)
    fish = int(arguments[0]) if arguments else load.fish
    cases = load.cases
    if len(arguments) > 2:
        asked = arguments[2].split(",")
        cases = tuple(one for one in CASES if name_of(one).replace(" ", "") in asked)
    seeds = range(first, first + fish)
    print(f"{fish} fish each, seeds from {first} on; reached: the error was raised by half or more")
    rows: defaultdict[tuple[str, str, str], list[Outcome]] = defaultdict(list)
    with ProcessPoolExecutor(2) as pool:
        jobs = [(p, s, r, c, n) for c in cases for n in healthy_trials(c)
                for p, r, s in product(load.plants, load.references, seeds)]  # fmt: skip
        for outcome in pool.map(outcome_of, jobs):
            row = rows[outcome.key]
            row.append(outcome)
            if len(row) == fish:
                print(row_text(outcome.key, row), flush=True)
    every = [one.worse_m_s for row in rows.values() for one in row if one.worse_m_s is not None]
    good = sum(one <= WORSE_MOST_M_S for one in every)
    print(f"{len(every)} proposals followed: {good} left the error lower or within 1 mm/s")
    return 0


def row_text(key: tuple[str, str, str], row: list[Outcome]) -> str:
    named = Counter(one.named for one in row)
    counts = ", ".join(f"{value} {what}" for what, value in named.most_common())
    reached = sum(one.raised >= RAISED_MIN for one in row)
    worse = [one.worse_m_s for one in row if one.worse_m_s is not None]
    good = sum(one <= WORSE_MOST_M_S for one in worse)
    plant, reference, causes = key
    return (
        f"{plant:9} {reference:8} {causes:50} {len(row)} fish, {reached} reached: {counts};"
        f" followed {good} of {len(worse)}"
    )


if __name__ == "__main__":
    raise SystemExit(main(FULL, sys.argv[1:]))
