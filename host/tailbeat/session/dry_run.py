"""What the board would learn from the pending trial, computed here: the same float32 numbers."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tailbeat.board.fish import Fish
from tailbeat.core import law as laws
from tailbeat.core.arrays import F32
from tailbeat.core.errors import InputError
from tailbeat.core.faults import NO_TRIAL, refusal
from tailbeat.core.law_memory import LawMemory, Memory, PastTrial
from tailbeat.core.records import decode_past, decode_reference, past_path, record_crc
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.link.messages import BoardStatus


@dataclass(frozen=True)
class DryRun:
    """The next amplitudes and what they follow from."""

    trial: int
    iteration: int  # that the trial swam
    report: laws.LawReport
    rolled_back: bool
    amplitude_rad: F32

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        document = {"trial": self.trial, "iteration": self.iteration, **asdict(self.report)}
        document["rolled_back"] = self.rolled_back
        return document | {"dry_run": True, "amplitude_rad": self.amplitude_rad}

    def text(self) -> str:
        """For people; the amplitudes in full precision."""
        head = (
            f"trial {self.trial}: max|e| {self.report.max_abs_error_m_s * 1e3:.1f} mm/s, "
            f"RMS {self.report.rms_error_m_s * 1e3:.1f}; nothing was changed"
        )
        if self.rolled_back:
            head += "; worse twice, the best amplitudes would come back"
        rows = [f"{beat},{float(value)!r}" for beat, value in enumerate(self.amplitude_rad)]
        return "\n".join([head, "beat,amplitude_rad", *rows])


def dry_run(fish: Fish, number: int | None = None) -> DryRun:
    """From the pending trial's file and the board's amplitudes and parameters."""
    status = fish.status()
    pending = status.pending_trial
    if pending is None or number not in (None, pending):
        raise refusal(NO_TRIAL)
    record = fish.reference_record()
    if record is None:
        raise InputError("the board has no reference.", "Upload one first.")
    wanted = decode_reference(record)
    params = fish.params.values()
    law = laws.Law.from_params(params, wanted.beat_s)
    trial = _pulled(fish, pending)
    error, measured = laws.errors_of(wanted.speed_m_s, trial.beats.speed_m_s)
    complete = trial.end_fault == 0 and trial.executed_beats == len(wanted.speed_m_s)
    memory = _memory(fish, status)
    if memory.peaks is None:  # older firmware judges no trial with missing beats
        complete = complete and bool(measured.all())
    past = laws.Averaging.from_params(params)
    learner = LawMemory.of(memory, past, _earlier(fish, past, status.iteration))
    extrapolation = int(params.get("ILC_EXTRAP", 0))
    report = learner.learn(law, error, measured, complete, params["ROLLBACK_RATIO"], extrapolation)
    return DryRun(
        trial=pending,
        iteration=trial.iteration,
        report=report,
        rolled_back=learner.rolled_back,
        amplitude_rad=learner.amplitude_rad,
    )


def _memory(fish: Fish, status: BoardStatus) -> Memory:
    held, best = fish.amplitudes(), fish.amplitudes(best=True)
    return Memory(
        iteration=held.iteration,
        amplitude_rad=held.values,
        best_iteration=best.iteration,
        best_rad=best.values,
        best_max_abs_error_m_s=status.best_max_abs_error_m_s or 0.0,
        worse_streak=status.worse_streak,
        visits=fish.visits(),
        peaks=fish.peaks(),
    )


def _earlier(fish: Fish, past: laws.Averaging, iteration: int) -> list[PastTrial]:
    """What the board looks back on, newest first: the chain that begins with what it has learned
    (docs/protocol.md). A file that is missing or not of the chain ends it."""
    most = past.earlier
    learned = fish.learned_record() if most else None
    earlier: list[PastTrial] = []
    wanted = record_crc(learned) if learned is not None else 0
    while len(earlier) < most and wanted:
        record = fish.past_record(past_path(iteration - 1 - len(earlier)))
        if record is None:
            break
        try:
            found = decode_past(record)
        except InputError:
            break
        if found.kind != past.kind or wanted != (found.crc if earlier else found.learned_crc):
            break
        trials = found.trials if past.traits.running else 1
        earlier.append(PastTrial(found.amplitude_rad, found.error_m_s, trials))
        wanted = found.previous_crc
    return earlier


def _pulled(fish: Fish, number: int) -> Trial:
    with TemporaryDirectory() as folder:
        return read_trial(fish.pull_trial(number, Path(folder)))
