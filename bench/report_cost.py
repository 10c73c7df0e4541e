"""What ``tailbeat report`` and the planning of the next input cost a laptop, at 30 trials.

Processor time of a process of its own, the least of some runs, from the start of Python on. Other
load of the machine makes it longer: a fixed loop is timed beside each run, and what it took against
the least is taken out. The limit of the report is to load what draws it; that of the plan, which
begins with the fit of every earlier trial, is its last step alone. Exits with 1 when a goal is
missed.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from startup import RUN

from tailbeat.board.fish import Fish
from tailbeat.core.reference import thesis
from tailbeat.core.trial_file import read_trial
from tailbeat.experiment.current import make
from tailbeat.experiment.folder import Experiment, copy_state
from tailbeat.learning.belief import Beliefs
from tailbeat.learning.fish_model import TrialSpeeds, trial_speeds
from tailbeat.learning.identification import any_fish
from tailbeat.learning.model_law import ModelStepSetting, propose_by
from tailbeat.session.next_input import next_step
from tailbeat.session.trial import run_trial

GOAL_S = 2.0
PLAN = "--plan"
LOADS = "import scipy.optimize, matplotlib.figure, matplotlib.backends.backend_svg"
AMPLITUDE_MAX_RAD = 0.785


@dataclass(frozen=True)
class Load:
    """How much is measured; ``judged``: goals count."""

    trials: int
    runs: int
    judged: bool


FULL, TINY = Load(30, 3, judged=True), Load(2, 1, judged=False)


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


def last_step_s(folder: Path) -> float:
    """Of the plan alone, all but the last trial known."""
    trials, beliefs = trials_of(folder), Beliefs(any_fish())
    beliefs.after(trials[:-1])
    begin_s = time.thread_time()
    propose_by(beliefs.after(trials), ModelStepSetting(thesis(), AMPLITUDE_MAX_RAD), trials)
    return time.thread_time() - begin_s


def loop_s() -> float:
    """A fixed piece of work."""
    begin_s = time.thread_time()
    for _ in range(2_000_000):
        pass
    return time.thread_time() - begin_s


def cpu_s(arguments: Sequence[str]) -> float:
    """Of one process of Python."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, *arguments]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measured(commands: dict[str, list[str]], runs: int) -> dict[str, tuple[float, float]]:
    """(as measured, with the other load taken out), s, the least of some runs."""
    rows = []
    for _ in range(runs):
        for name, arguments in commands.items():
            before_s = loop_s()
            taken_s = cpu_s(arguments)
            rows.append((name, taken_s, (before_s + loop_s()) / 2))
    idle_s = min(loop for _, _, loop in rows)
    return {
        name: (
            min(taken for one, taken, _ in rows if one == name),
            min(taken * idle_s / loop for one, taken, loop in rows if one == name),
        )
        for name in commands
    }


def main(load: Load = FULL) -> int:
    """Measures and prints."""
    missed = 0
    with TemporaryDirectory() as root:
        folder = experiment_of(load.trials, Path(root)).folder
        commands = {
            "report": ["-c", RUN, "report", str(folder)],
            "plan of the next input": [__file__, PLAN, str(folder)],
            "limit": ["-c", LOADS],
        }
        found = measured(commands, load.runs)
        limits = {"report": found.pop("limit")[1], "plan of the next input": last_step_s(folder)}
    print(
        f"processor time at {load.trials} trials, s (goal; as measured beside other load; limit):"
    )
    for name, (raw_s, alone_s) in found.items():
        missed += load.judged and alone_s > GOAL_S
        limit_s = limits[name]
        print(
            f"  {name:24} {alone_s:5.2f} ({GOAL_S:.0f}; {raw_s:.2f}; {limit_s:.2f},"
            f" {alone_s / max(limit_s, 1e-3):.1f} x)"
        )
    if missed:
        sys.exit(f"{missed} of {len(found)} goals missed")
    return 0


if __name__ == "__main__":
    if sys.argv[1:2] == [PLAN]:
        plan_next(Path(sys.argv[2]))
    else:
        raise SystemExit(main())
