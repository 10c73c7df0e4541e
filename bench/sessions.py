"""A new user's session on random fish: how near the second trial's input is to the fish's bound,
and what convergence is worth.

Each fish is a simulated board of its own, which ``tailbeat start --yes`` leads from unknown to
converged; then it runs four more trials. The error of an input is its max|e| on the noise-free
plant, as it has drifted at that trial; the bound is the smallest such error on the same plant
within the session's amplitude limit. Fish ``tank``: the first plant (drag/mass 5, 10 or 20, delay
0.05 to 0.35 s); ``mild``, ``realistic``: the second plant; the tail centre of all is off by up to
0.05 rad. Usage: sessions.py [FISH FIRST_SEED [KIND,...]]
"""

from __future__ import annotations

import contextlib
import os
import secrets
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from tailbeat.board.fish import Fish
from tailbeat.core.arrays import F64
from tailbeat.core.errors import TailbeatError
from tailbeat.core.reference import thesis
from tailbeat.experiment.current import begin
from tailbeat.experiment.library import FOLDER_VARIABLE
from tailbeat.session.events import Event, InputChosen
from tailbeat.session.options import Options, Until
from tailbeat.session.outcome import Decision, RecordedTrial
from tailbeat.session.series import run_series
from tailbeat.session.start import StartOptions, run_start
from tailbeat.sim.board import SimBoard, SimTransport
from tailbeat.studies.montecarlo.batch import FishBatch
from tailbeat.studies.montecarlo.populations import draw, still
from tailbeat.studies.montecarlo.smallest_error import smallest_errors

TANK = "tank"
CENTRE_RAD = 0.05
LATER = 4  # trials after it has converged
SECOND = 1  # index of the second trial
NEAR, NEAR_M_S = 1.10, 0.0005
OVER_MOST_M_S = 0.002
WANTED = thesis().speed_m_s.astype(np.float64)


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    fish: int
    kinds: tuple[str, ...] = (TANK, "mild", "realistic")


FULL = Load(4)


@dataclass
class Agrees:
    """Whoever typed --yes. ``inputs``: of the trials, by their numbers, as they were planned."""

    fish: Fish
    inputs: dict[int, F64] = field(default_factory=dict)

    def tell(self, event: Event) -> None:
        if isinstance(event, InputChosen):
            planned = self.fish.amplitudes().values.astype(np.float64)
            self.inputs[self.fish.status().next_trial] = planned

    def wants_abort(self) -> bool:
        return False

    def decide(self, recorded: RecordedTrial) -> Decision:
        return Decision("keep")

    def confirm(self, question: str) -> bool:
        return True

    def number(self, question: str, value: float) -> float | None:
        return value


def settings_of(kind: str, seed: int) -> tuple[str, dict[str, float]]:
    """(plant, settings) of a fish."""
    rng = np.random.default_rng([seed, 7])
    centre = {"tail_centre_rad": float(rng.uniform(-CENTRE_RAD, CENTRE_RAD))}
    if kind != TANK:
        return "reactive", draw(kind, "reactive", seed) | centre
    kappa = {"kappa_per_m": (5.0, 10.0, 20.0)[seed % 3], "delay_s": float(rng.uniform(0.05, 0.35))}
    return TANK, kappa | centre


@dataclass(frozen=True)
class Row:
    """``error_m_s``: of the second trial's input; ``over_m_s``: of the last input when it had
    converged, above the best of those after it. None: it did not come so far, as ``failed``
    says."""

    kind: str
    seed: int
    trials: int = 0
    error_m_s: float | None = None
    bound_m_s: float = 0.0
    over_m_s: float | None = None
    failed: str = ""

    @property
    def is_near(self) -> bool:
        limit = NEAR * self.bound_m_s + NEAR_M_S
        return self.error_m_s is not None and self.error_m_s <= limit

    @property
    def text(self) -> str:
        if self.error_m_s is None:
            return f"{self.kind} {self.seed} FAILED {self.failed}"
        over = "none" if self.over_m_s is None else f"{self.over_m_s * 1e3:.2f}"
        return (
            f"{self.kind} {self.seed} second {self.error_m_s * 1e3:.2f}"
            f" bound {self.bound_m_s * 1e3:.2f} near {self.is_near}"
            f" trials {self.trials} over {over} {self.failed}"
        )


def row_of(job: tuple[str, int]) -> Row:
    kind, seed = job
    with TemporaryDirectory() as folder, contextlib.chdir(folder):
        os.environ[FOLDER_VARIABLE] = str(Path(folder) / "library")
        return session(kind, seed)


def session(kind: str, seed: int) -> Row:
    """A fish that stops half-way, as where the room ends, is judged by the inputs it had."""
    plant, settings = settings_of(kind, seed)
    failed, ended = "", 0
    with Fish(SimTransport(SimBoard(plant, seed=seed, **settings))) as fish:
        operator = Agrees(fish)
        options = StartOptions(series=Options(until=Until(None, converged=True)))
        try:
            end = run_start(fish, operator, options, lambda: begin(fish, Path("experiments")))
            assert end.series is not None and end.experiment is not None, end.steps[-1].words
            failed = "" if end.series.why == "converged" else end.series.words
            ended = len(end.series.rounds)
            if not failed:
                run_series(fish, end.experiment, operator, Options(until=Until(LATER)))
        except TailbeatError as error:
            failed = str(error)
        limit_rad = fish.params.get("AMP_MAX_RAD").value
    if len(operator.inputs) <= SECOND:
        return Row(kind, seed, failed=failed)
    errors = errors_of(FishBatch(plant, [still(settings | {"seed": seed})]), operator.inputs)
    numbers, inputs = list(operator.inputs), list(operator.inputs.values())
    starts = [inputs[SECOND], inputs[-1]]
    own = settings | {"seed": seed}
    bound = smallest_errors(plant, own, WANTED, 1.0, limit_rad, starts, [numbers[SECOND]])[0][0]
    after = errors[ended : ended + LATER] if ended else []
    over = errors[ended - 1] - min(after) if len(after) == LATER else None
    return Row(kind, seed, ended, errors[SECOND], float(bound), over, failed)


def errors_of(judge: FishBatch, inputs: dict[int, F64]) -> list[float]:
    """Of the input of each trial."""
    speeds = [judge.run(one[None], number).true_m_s[0] for number, one in inputs.items()]
    return [float(np.abs(WANTED - one).max()) for one in speeds]


def main(load: Load = FULL, arguments: Sequence[str] = ()) -> int:
    """A line for each fish, then the rates of each kind."""
    fish = int(arguments[0]) if arguments else load.fish
    first = int(arguments[1]) if len(arguments) > 1 else secrets.randbits(30)
    kinds = tuple(arguments[2].split(",")) if len(arguments) > 2 else load.kinds
    print(f"{fish} fish of each kind, seeds from {first} on; errors in mm/s", flush=True)
    rows: list[Row] = []
    with ProcessPoolExecutor(2) as pool:
        jobs = [(kind, seed) for seed, kind in product(range(first, first + fish), kinds)]
        for row in pool.map(row_of, jobs):
            print(row.text, flush=True)
            rows.append(row)
    for kind in kinds:
        of = [row for row in rows if row.kind == kind]
        over = [row.over_m_s for row in of if row.over_m_s is not None]
        good = sum(one <= OVER_MOST_M_S for one in over)
        near = sum(row.is_near for row in of)
        print(
            f"{kind}: second trial at its bound {near} of {len(of)}; {len(over)} converged, of"
            f" these {good} at most 2 mm/s above what comes later, most"
            f" {max(over, default=0) * 1e3:.2f}"
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main(FULL, sys.argv[1:]))
