"""The main job by the P law, end to end: a fish learns the speed profile of the thesis.

Connect, apply the preset of the thesis, set gain and lead, upload, arm, execute a trial, pull its
log over the wire, learn on the board; after every step the host recomputes its numbers with the
same C code and compares the bits. The folder is that of any session, with its event log and the
board's state. The loop is a short one, not `session.series`: a question more to the board would
begin a trial at another moment of the camera's pictures, and the printed numbers with it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np
from numpy.typing import NDArray

from tailbeat.board.connect import is_simulated
from tailbeat.board.fish import Fish
from tailbeat.core import law as laws
from tailbeat.core import reference
from tailbeat.core.arrays import F32
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.speed_estimate import recompute_beats
from tailbeat.core.trial_checks import heading_drift
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.experiment.folder import Experiment, copy_state
from tailbeat.experiment.redo import write_redo
from tailbeat.learning.error_bound import error_bound
from tailbeat.learning.error_bound_solve import plant_config
from tailbeat.link.messages import LearnReport
from tailbeat.link.presets import THESIS
from tailbeat.report.paper import write_report
from tailbeat.session.collect import TrialLog, record_of
from tailbeat.session.log import SessionLog
from tailbeat.session.outcome import Decision
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimulatedBoard
from tailbeat.sim.config import DEFAULT_SEED

AMPLITUDE_MAX_RAD = THESIS["AMP_MAX_RAD"]
LEAD_BEATS = {"thesis": THESIS["ILC_LEAD"]}  # the thesis's plant has no delay
_LEAD_BEATS = 1.0  # any other's
EXPERIMENTS = Path("experiments")
_SAMPLE_S = 0.04

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class DemoOptions:
    """``connect``: None = the simulated board. ``plant``, ``seed`` and ``overrides`` (fields of the
    simulator's configuration, SI) are refused for a board without a simulated fish in this process;
    None = as the address says, else tank and 1."""

    plant: str | None = None
    gain: float = 4.0
    lead: float | None = None
    trials: int = 8
    seed: int | None = None
    out: Path | None = None
    connect: str | None = None
    overrides: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class DemoTrial:
    """One row of the result; None where only a simulator in this process knows it."""

    iteration: int
    trial: int  # 0 = not executed
    max_abs_error_m_s: float
    rms_error_m_s: float
    true_max_abs_error_m_s: float | None
    max_abs_error_25hz_m_s: float | None
    saturated_beats: int
    distance_m: float
    duration_s: float
    end: str


@dataclass(frozen=True)
class DemoResult:
    """What ``tailbeat sim demo --json`` prints."""

    plant: str
    gain: float
    lead: float
    seed: int | None  # None: not simulated in this process
    floor_m_s: float | None
    floor_lsq_m_s: float | None
    trials: list[DemoTrial]
    report: Path

    def as_dict(self) -> dict[str, Any]:
        """SI units, JSON types."""
        return asdict(self) | {"report": str(self.report)}


class Mismatch(TailbeatError):
    """Host and board computed different numbers from the same trial."""


def run_demo(options: DemoOptions, progress: Progress = lambda done, text: None) -> DemoResult:
    """Runs the demo and writes the experiment folder with its report."""
    if options.trials < 1:
        raise InputError(f"{options.trials} trials are no demo.", "Give --trials 1 or more.")
    with Fish.connect(address_of(options), **options.overrides) as fish:
        return _Demo(fish, options).run(progress)


def address_of(options: DemoOptions) -> str:
    """Where to connect, with plant and seed if they are given. A demo is reproducible: without a
    seed the simulated board has the usual one."""
    url = options.connect or "sim"
    simulated, seed = is_simulated(url), options.seed
    if seed is None and simulated and "seed=" not in url:
        seed = DEFAULT_SEED
    asked = {"plant": options.plant, "seed": seed}
    given = {name: value for name, value in asked.items() if value is not None}
    if given and not simulated:
        raise InputError(
            f"{' and '.join(given)} given for a board that is not simulated here",
            "Leave them out, or connect to sim or vboard.",
        )
    return f"{url}{'&' if '?' in url else '?'}{urlencode(given)}" if given else url


class _Demo:
    def __init__(self, fish: Fish, options: DemoOptions) -> None:
        self.fish, self.options = fish, options
        self.sim: SimulatedBoard | None = fish.sim
        self.plant = self.sim.plant if self.sim else "unknown"
        lead = LEAD_BEATS.get(self.plant, _LEAD_BEATS)
        self.lead = lead if options.lead is None else options.lead
        self.reference = reference.thesis()
        self.rows = [_zero_row(self.reference)]
        self.trials: list[Trial] = []

    def run(self, progress: Progress) -> DemoResult:
        self._prepare()
        experiment = self._experiment()
        count = self.options.trials
        self.fish.upload_reference(self.reference.record())
        for i in range(1, count + 1):
            progress((i - 1) / count, f"trial {i} of {count}")
            self._one_trial(experiment)
        progress(1.0, "report")
        experiment.note(f"demo: {count} trials")
        copy_state(self.fish, experiment)
        write_redo(experiment)
        return DemoResult(
            self.plant,
            self.options.gain,
            self.lead,
            self.sim.seed if self.sim else None,
            *self._floor(),
            self.rows,
            write_report(experiment).page,
        )

    def _prepare(self) -> None:
        fish = self.fish
        if fish.status().pending_trial is not None:
            raise InputError(
                "the board still holds a trial that is neither learned nor discarded.",
                "tailbeat trial learn, or tailbeat trial discard.",
            )
        law = {"ILC_GAIN": self.options.gain, "ILC_LEAD": float(self.lead)}
        fish.params.apply({**THESIS, **law})
        self.params = fish.params.values()
        self.law = laws.Law.from_params(self.params, self.reference.beat_s)
        for problem in self.reference.check(reference.ReferenceLimits.from_params(self.params)):
            raise InputError(problem.meaning, problem.remedy)
        self.info = fish.info()

    def _experiment(self) -> Experiment:
        kind = "vboard" if self.info.board == "emulated" else "sim"
        fish = f"{kind}-{self.plant}" if self.sim else self.info.board
        names = fish, self.reference.name, self.law.label()
        out = self.options.out
        if out is not None and (out / "settings.json").exists():
            make_room(Experiment.open(out))
        new = Experiment.at if out is not None else Experiment.new
        experiment = new(out or EXPERIMENTS, *names)
        experiment.write_settings(
            {
                "made_by": "demo",
                "simulated": self.info.simulated,
                "plant": self.plant,
                "seed": self.sim.seed if self.sim else None,
                "simulator": self.sim.config if self.sim else None,
                "params": self.params,
                "firmware": self.info.build_id,
                "board": self.info.board,
                "unique_id": self.info.unique_id,
            }
        )
        experiment.add_raw("reference.bin", self.reference.record())
        self.reference.to_csv(experiment.folder / "reference.csv")
        return experiment

    def _one_trial(self, experiment: Experiment) -> None:
        fish = self.fish
        fish.arm()
        outcome = run_trial(fish)
        with tempfile.TemporaryDirectory() as folder:
            pulled = fish.pull_trial(outcome.number, Path(folder))
            path = experiment.add_raw(pulled.name, pulled.read_bytes())
        if outcome.interrupted:
            raise KeyboardInterrupt
        trial = read_trial(path)
        if trial.problems:
            raise TailbeatError(f"{path.name}: {trial.problems[0]}.", "Look at the file.")
        if outcome.end != "complete":
            raise TailbeatError(
                f"trial {outcome.number} ended with {outcome.end} after "
                f"{outcome.executed_beats} beats.",
                f"Its file is {path}; clear the board and start again.",
            )
        log = SessionLog(experiment)
        recorded = record_of(outcome, TrialLog(path, trial, heading_drift(trial)), None)
        log.recorded(recorded)
        log.decided(recorded, Decision("keep"))
        visits = fish.visits() if self.law.fade else None
        report = fish.learn(outcome.number)
        log.journal.add("learned", **asdict(report))
        compare(trial, self.law, fish.amplitudes().values, report.rolled_back, visits)
        self.trials.append(trial)
        self.rows.append(self._row(trial, report))

    def _row(self, trial: Trial, report: LearnReport) -> DemoTrial:
        true, fine = self._truth()
        return DemoTrial(
            iteration=trial.iteration,
            trial=trial.number,
            max_abs_error_m_s=report.max_abs_error_m_s,
            rms_error_m_s=report.rms_error_m_s,
            true_max_abs_error_m_s=true,
            max_abs_error_25hz_m_s=fine,
            saturated_beats=report.saturated_beats,
            distance_m=float(np.nansum(trial.beats.speed_m_s.astype(np.float64))) * trial.beat_s,
            duration_s=trial.executed_beats * self.reference.beat_s,
            end=trial.end,
        )

    def _truth(self) -> tuple[float | None, float | None]:
        """max|e| of the last trial by the simulator's own state: over beats, and at 25 Hz."""
        if self.sim is None:
            return None, None
        beats = self.sim.world.true_beats()[: self.reference.beats]
        true = np.abs(self.reference.speed_m_s[: len(beats)] - beats)
        speeds = self.sim.world.true_speeds_25hz()[: round(self.reference.duration_s / _SAMPLE_S)]
        desired = reference.thesis_speed(np.arange(len(speeds), dtype=np.float64) * _SAMPLE_S)
        return float(true.max()), float(np.abs(desired - speeds).max())

    def _floor(self) -> tuple[float | None, float | None]:
        if self.sim is None:
            return None, None
        fixed = ("seed", "plant")
        values = {name: v for name, v in self.sim.config.items() if name not in fixed}
        config = plant_config(self.plant, values)
        found = error_bound(config, self.reference, AMPLITUDE_MAX_RAD)
        return found.minimax_m_s, found.lsq_max_abs_m_s


def compare(
    trial: Trial,
    law: laws.Law,
    learned: F32,
    rolled_back: bool = False,
    visits: NDArray[np.uint8] | None = None,
) -> None:
    """Raises Mismatch unless the host gets the board's beat means and next amplitudes, bit for bit,
    from the trial's file and the board's ``visits`` before it learned."""
    beats = trial.beats
    speed, _ = recompute_beats(trial)
    what = "the beat means recomputed from its file differ"
    if same_bits(speed, beats.speed_m_s):
        if rolled_back:
            return
        error, measured = laws.errors_of(beats.reference_m_s, beats.speed_m_s)
        expected, _ = laws.update(law, beats.amplitude_rad, error, measured, visits)
        if same_bits(expected, learned):
            return
        what = "the amplitudes the board learned are not what the law gives"
    raise Mismatch(f"trial {trial.number}: {what}.", "Tool and firmware may differ in version.")


def same_bits(a: F32, b: F32) -> bool:
    """Equal as bit patterns; NaNs count as equal."""
    if a.shape != b.shape:
        return False
    same = a.view(np.uint32) == b.view(np.uint32)
    return bool(np.all(same | (np.isnan(a) & np.isnan(b))))


def _zero_row(profile: reference.Reference) -> DemoTrial:
    """Iteration 0, the zero input: its error is the reference."""
    speed = profile.speed_m_s.astype(np.float64)
    time = np.arange(round(profile.duration_s / _SAMPLE_S), dtype=np.float64) * _SAMPLE_S
    top, rms = float(speed.max()), float(np.sqrt(np.mean(speed**2)))
    fine = float(reference.thesis_speed(time).max())
    return DemoTrial(0, 0, top, rms, top, fine, 0, 0.0, 0.0, "complete")


def make_room(old: Experiment) -> None:
    """A simulated demo can be made again; anything else is somebody's data."""
    settings = old.settings()
    if settings.get("made_by") != "demo" or not settings.get("simulated"):
        words = f"{old.folder} holds an experiment that no demo made."
        raise InputError(words, "Choose another --out.")
    old.clear()
