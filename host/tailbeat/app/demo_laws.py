"""One simulated fish, twice from unknown: by a P law, and as ``start`` leads.

Both execute the same number of runs; those that measure the fish count.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tailbeat.app.demo import DemoOptions, DemoResult, Progress, address_of, run_demo
from tailbeat.board.fish import Fish
from tailbeat.core.errors import TailbeatError
from tailbeat.experiment.analysis import analyse
from tailbeat.experiment.current import begin
from tailbeat.experiment.folder import Experiment
from tailbeat.report.figures.two_laws import LawRun, draw_two_laws
from tailbeat.report.paper import write_report
from tailbeat.session.events import Event, StepBegun, TrialStarted
from tailbeat.session.options import Options, Until
from tailbeat.session.outcome import Decision, RecordedTrial
from tailbeat.session.start import StartOptions, run_start

FOLDER = Path("experiments", "demo")
MEASURING_RUNS = 3
_P_LAW, _START = "p-law", "start"
_ROW = ("iteration", "trial", "max_abs_error_m_s", "rms_error_m_s", "saturated_beats", "end")


@dataclass(frozen=True)
class TwoLaws:
    """``p_law``: what ``run_demo`` gives. ``runs``: both, the P law first."""

    p_law: DemoResult
    runs: tuple[LawRun, LawRun]
    figure: Path
    reports: tuple[Path, Path]

    def as_dict(self, law: str = "both") -> dict[str, Any]:
        """SI units, JSON types. ``trials``: of the P law, with ``law`` ``model`` of the other."""
        laws = [
            {
                "law": one.name,
                "measuring_runs": one.measuring_runs,
                "max_abs_error_m_s": [row.max_abs_error_m_s for row in one.analysis.rows],
                "report": str(report),
            }
            for one, report in zip(self.runs, self.reports, strict=True)
        ]
        found = self.p_law.as_dict() | {"laws": laws, "figure": str(self.figure)}
        rows = [{name: getattr(row, name) for name in _ROW} for row in self.runs[1].analysis.rows]
        return found | ({"trials": rows} if law == "model" else {})


def run_both(options: DemoOptions, progress: Progress = lambda done, text: None) -> TwoLaws:
    """Runs both on simulated fish of the same address, and draws them in one figure,
    ``demo.png``."""
    folder = options.out or FOLDER
    p_options = replace(options, out=folder / _P_LAW)
    p_law = run_demo(p_options, lambda done, text: progress(done / 2, f"P law, {text}"))
    measuring_runs, started = _start(
        options, folder / _START, lambda done, text: progress(0.5 + done / 2, f"start, {text}")
    )
    p_name = f"P law, gain {p_law.gain:g}, lead {p_law.lead:g}"
    runs = (
        LawRun(p_name, 0, analyse(Experiment.open(folder / _P_LAW))),
        LawRun("model-based, as tailbeat start", measuring_runs, analyse(started)),
    )
    progress(1.0, "figure")
    figure = folder / "demo.png"
    draw_two_laws(runs, p_law.floor_m_s, figure)
    reports = p_law.report, write_report(started).page
    return TwoLaws(p_law, runs, figure, reports)


def _start(options: DemoOptions, folder: Path, progress: Progress) -> tuple[int, Experiment]:
    """(runs that measured the fish, the experiment of its trials)."""
    url, overrides = address_of(options), options.overrides
    with TemporaryDirectory() as library, Fish.connect(url, **overrides) as fish:
        fish.library_root = Path(library)  # unknown, whatever TAILBEAT_LOGBOOK has of it
        operator = _Agrees(progress, options.trials)
        series = Options(until=Until(max(1, options.trials - MEASURING_RUNS)), typed="demo")
        end = run_start(fish, operator, StartOptions(series=series), lambda: begin(fish, folder))
    if end.series is None or end.experiment is None:
        raise TailbeatError(end.steps[-1].words, "Look at what the step says.")
    return operator.measuring_runs, end.experiment


@dataclass
class _Agrees:
    """Says yes, for the fish is simulated."""

    progress: Progress
    runs: int
    executed: int = 0
    measuring_runs: int = 0

    def tell(self, event: Event) -> None:
        match event:
            case StepBegun(name="trials"):
                self.measuring_runs = self.executed
            case TrialStarted():
                self.executed += 1
                what = f"trial {self.executed} of {self.runs}"
                self.progress(min(1.0, (self.executed - 1) / self.runs), what)

    def wants_abort(self) -> bool:
        return False

    def decide(self, recorded: RecordedTrial) -> Decision:
        return Decision("keep")

    def confirm(self, question: str) -> bool:
        return True

    def number(self, question: str, value: float) -> float | None:
        return value
