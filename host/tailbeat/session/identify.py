"""Identifies a connected fish: the runs of ``runs`` swum one by one on its board, which is lent for
that (``preserved``): it has everything back afterwards.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.board.fish import Fish
from tailbeat.board.preserve import PreservedBoard, preserved
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.speed_source import Camera, SpeedSource
from tailbeat.experiment.current import set_and_save
from tailbeat.learning.fish_model import FishModel, TrialSpeeds, trial_speeds
from tailbeat.learning.fit import Prior
from tailbeat.learning.identification import Identified
from tailbeat.learning.identification_runs import IdentificationRun, Limits, identify_runs
from tailbeat.link.messages import TrialOutcome
from tailbeat.session.events import Event
from tailbeat.session.guards import Guard, GuardedTrial, guards_of
from tailbeat.session.outcome import BY_HAND
from tailbeat.session.trial import run_trial

MODEL_PARAMS = {
    "MDL_KAPPA": "kappa_per_m",
    "MDL_SLOPE": "slope_m_s_rad",
    "MDL_DEAD_RAD": "dead_zone_rad",
    "MDL_DELAY_S": "delay_s",
}
_SPEED_SIGMA_M_S = 0.001  # of speeds that somebody uploads
NO_ROOM = ("aborted:ABORT_COMMAND", "aborted:WALL")
_LIKE_THE_BOARDS = {"slope": 0.3, "dead_zone_rad": 0.08, "bend_per_rad": 0.4}
_TRIED_RAD = 0.5  # where no trial tells the amplitudes
_COASTS_ON = 0.5  # of the drag that is believed: a fish nobody knows may coast twice as far


@dataclass(frozen=True)
class IdentificationHooks:
    """Who sees to an identification. ``before``: told of each run once the board has its
    amplitudes, returns when it may begin, raises to end it all. ``speeds``: (trial, beats, beat_s)
    to speeds measured after the trial, NaN = not measured, one per beat; None: nobody can give any.
    ``event``: what happens meanwhile. ``keep``: gets every trial's file. ``note``: told what else
    an operator should know. ``guard``: of the walls; what it stops has told enough once it has swum
    a little. ``wants_abort``: whether to stop the tail and end it all, asked some ten times a
    second."""

    before: Callable[[IdentificationRun], None] = lambda run: None
    speeds: Callable[[int, int, float], ArrayLike] | None = None
    event: Callable[[Event], None] = lambda event: None
    keep: Callable[[Path], object] = lambda path: None
    note: Callable[[str], None] = lambda text: None
    guard: Guard | None = None
    wants_abort: Callable[[], bool] = lambda: False


def identify_fish(
    fish: Fish,
    attendant: IdentificationHooks,
    safe: Path | None = None,
    camera: Camera | None = None,
    limits: Limits | None = None,
    quick: bool = False,
) -> Identified:
    """Swims the runs and fits the fish to them. ``safe``: folder for the copy of what the board
    held; a copy that is there already is put back when a run was broken off, and never overwritten.
    Raises InputError when the board cannot begin, TailbeatError when a run goes wrong."""
    source = fish.speed_source()
    if source.uploaded and attendant.speeds is None:
        raise InputError(
            "SPD_SOURCE is upload, and nobody is asked for the speeds.",
            "Leave out --yes and --json, or swim by hand and give the files with --trials.",
        )
    with preserved(fish, safe, attendant.note, "identify") as board:
        swimmer = _IdentificationRunner(board, attendant, source, camera)
        return identify_runs(
            swimmer.trial,
            limits or Limits.from_params(board.params),
            prior_of(board.params),
            on_run=swimmer.begin,
            quick=quick,
            unique_id=board.held.unique_id,
        )


def prior_of(params: dict[str, float]) -> Prior:
    """Around the model the board has: a fish like it, of any shape."""
    values = {field: params[name] for name, field in MODEL_PARAMS.items()}
    fits = values["kappa_per_m"] > 0 and values["slope_m_s_rad"] > 0
    return Prior(FishModel(**values), **_LIKE_THE_BOARDS) if fits else Prior()


def set_params(fish: Fish, identified: Identified) -> dict[str, float]:
    """The model becomes the board's, for good; what was assumed does not. Other parameters that
    were changed but not saved stay so."""
    tried = max((float(t.amplitude_rad.max()) for t in identified.trials), default=_TRIED_RAD)
    model = identified.model.straight(tried)
    wanted = {
        name: getattr(model, field)
        for name, field in MODEL_PARAMS.items()
        if field not in identified.assumed
    }
    return set_and_save(fish, wanted)


@dataclass
class _IdentificationRunner:
    """Swims runs on the board."""

    board: PreservedBoard
    attendant: IdentificationHooks
    source: SpeedSource
    camera: Camera | None
    run: IdentificationRun | None = field(default=None)
    stopped: bool = field(default=False, init=False)

    def begin(self, run: IdentificationRun) -> None:
        self.run = run

    def trial(self, amplitude: F64) -> TrialSpeeds:
        run = self.run
        assert run is not None
        self.board.prepare(f"identify {run.number}", amplitude, run.predicted_m_s)
        self.attendant.before(run)
        # A run ends in its coast-down: its predicted speeds are all there are.
        kappa = self.board.params["MDL_KAPPA"] * _COASTS_ON
        guarded = GuardedTrial(
            self.board.params,
            run.predicted_m_s,
            self._stop,
            self.attendant.guard,
            kappa_per_m=kappa,
        )
        guard = guards_of(guarded)
        outcome = run_trial(self.board.fish, self.camera, self.attendant.event, guard)
        recorded = self.board.collect(outcome, self._judge, self.attendant.keep)
        return trial_speeds(recorded)

    def _stop(self) -> bool:
        self.stopped = self.stopped or self.attendant.wants_abort()
        return self.stopped

    def _judge(self, outcome: TrialOutcome) -> None:
        assert self.run is not None
        if outcome.end != "complete":
            self._judge_end(self.run, outcome.end, outcome.executed_beats)
        if self.source.uploaded:
            self._upload_speeds(outcome.number)

    def _judge_end(self, run: IdentificationRun, end: str, beats: int) -> None:
        """A run that was stopped for lack of room has told enough."""
        self.board.fish.clear()
        if self.stopped:
            raise TailbeatError(
                f"identification trial {run.number} was {BY_HAND}.",
                "The board has back what it held; begin again when it is put right.",
            )
        if end in NO_ROOM and beats > 2:
            return
        raise TailbeatError(
            f"identification trial {run.number} ended with {end} after {beats} beats.",
            "Put it right, then identify again.",
        )

    def _upload_speeds(self, trial: int) -> None:
        assert self.run is not None and self.attendant.speeds is not None
        speeds = self.attendant.speeds(trial, self.run.beats, 1.0)
        self.board.fish.upload_speeds(trial, speeds, np.full(self.run.beats, _SPEED_SIGMA_M_S))
