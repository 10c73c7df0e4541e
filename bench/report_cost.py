"""What ``tailbeat report`` and the planning of the next input cost a laptop, at 30 trials.

Instructions of a process of its own, from the start of Python on, counted by callgrind, and the CPU
seconds that they are on the idle machine of the goals, where a report of 10.4 G instructions took
1.88 s. The limit is to load the libraries that each needs. Exits with 1 when a goal is missed.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from sim_cost import counted
from startup import RUN

from tailbeat.board.fish import Fish
from tailbeat.core.reference import thesis
from tailbeat.core.trial_file import read_trial
from tailbeat.experiment.current import make
from tailbeat.experiment.folder import Experiment, copy_state
from tailbeat.learning.belief import Beliefs
from tailbeat.learning.fish_model import TrialSpeeds, trial_speeds
from tailbeat.learning.identification import any_fish
from tailbeat.learning.model_law import ModelStepSetting
from tailbeat.session.next_input import next_step
from tailbeat.session.trial import run_trial

GOAL_S = 2.0
PLAN = "--plan"
PLAN_LOADS = "import scipy.optimize"
REPORT_LOADS = f"{PLAN_LOADS}, matplotlib.figure, matplotlib.backends.backend_svg"
PER_S = 10.4e9 / 1.88
AMPLITUDE_MAX_RAD = 0.785


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    trials: int


FULL = Load(30)


def experiment_of(trials: int, root: Path) -> Experiment:
    """Trials of a simulated fish, each kept and learned from by the P law."""
    with Fish.connect("sim:tank?seed=1") as fish:
        for name, value in {"ILC_LEAD": 1.0, "AMP_MAX_RAD": AMPLITUDE_MAX_RAD}.items():
            fish.params.set(name, value)
        fish.upload_reference(thesis())
        experiment = make(fish, root, thesis(), "bench", {})
        for _ in range(trials):
            fish.arm()
            outcome = run_trial(fish)
            with TemporaryDirectory() as folder:
                kept = experiment.keep_trial(fish.pull_trial(outcome.number, Path(folder)))
            number, name = outcome.number, kept.name
            journal = experiment.journal
            journal.add("swum", trial=number, iteration=outcome.iteration, file=name)
            journal.add("decided", trial=number, decision="keep", reason="", file=name)
            journal.add("learned", **vars(fish.learn(number)))
            copy_state(fish, experiment)
    return experiment


def trials_of(folder: Path) -> list[TrialSpeeds]:
    return [trial_speeds(read_trial(path)) for path in sorted((folder / "raw").glob("*.ulg"))]


def plan_next(folder: Path) -> None:
    """As ``trial learn --law model`` plans: from the files on, nothing kept of earlier plans."""
    setting = ModelStepSetting(thesis(), AMPLITUDE_MAX_RAD)
    next_step(setting, Beliefs(any_fish()), trials_of(folder))


def seconds(*arguments: str) -> float:
    """CPU seconds of one process of Python on the machine of the goals."""
    return counted([sys.executable, *arguments])[0] / PER_S


def main(load: Load = FULL) -> int:
    """Measures and prints."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    with TemporaryDirectory() as root:
        folder = str(experiment_of(load.trials, Path(root)).folder)
        commands = {  # what is measured, and its limit
            "report": (("-c", RUN, "report", folder), ("-c", REPORT_LOADS)),
            "plan of the next input": ((__file__, PLAN, folder), ("-c", PLAN_LOADS)),
        }
        found = {
            name: (seconds(*command), seconds(*limit))
            for name, (command, limit) in commands.items()
        }
    print(f"CPU time at {load.trials} trials, s (goal; limit), by instructions:")
    for name, (taken_s, limit_s) in found.items():
        times = taken_s / limit_s
        print(f"  {name:24} {taken_s:5.2f} ({GOAL_S:.0f}; {limit_s:.2f}, {times:.1f} x)")
    missed = [name for name, (taken_s, _) in found.items() if taken_s > GOAL_S]
    if missed:
        sys.exit(f"missed: {', '.join(missed)}")
    return 0


if __name__ == "__main__":
    if sys.argv[1:2] == [PLAN]:
        plan_next(Path(sys.argv[2]))
    else:
        raise SystemExit(main())
