"""What the board would learn from the pending trial, computed here: the same float32 numbers."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tailbeat import laws
from tailbeat.errors import InputError
from tailbeat.faults import NO_TRIAL, refusal
from tailbeat.records import decode_reference
from tailbeat.trial_log import Trial, read_trial

if TYPE_CHECKING:
    from tailbeat.fish import Fish
    from tailbeat.results import BoardStatus

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class DryRun:
    """The next amplitudes and what they follow from."""

    trial: int
    iteration: int  # that the trial swam
    report: laws.LawReport
    rolled_back: bool
    amplitude_rad: Floats

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
    params = {name: p.value for name, p in fish.params.list().items()}
    law = laws.Law.from_params(params, wanted.beat_s)
    held = fish.amplitudes()
    trial = _pulled(fish, pending)
    error, measured = laws.errors_of(wanted.speed_m_s, trial.beats.speed_m_s)
    following, report = laws.update(law, held.values, error, measured)
    best = _rolled_back(fish, status, params["ROLLBACK_RATIO"], report)
    return DryRun(
        trial=pending,
        iteration=trial.iteration,
        report=report,
        rolled_back=best is not None,
        amplitude_rad=following if best is None else best,
    )


def _pulled(fish: Fish, number: int) -> Trial:
    with TemporaryDirectory() as folder:
        return read_trial(fish.pull_trial(number, Path(folder)))


def _rolled_back(
    fish: Fish, status: BoardStatus, ratio: float, report: laws.LawReport
) -> Floats | None:
    """The best amplitudes, if this trial and the one learned before it were both too bad.

    The board counts such trials but does not tell the count; it follows from the logs.
    """
    best_m_s, last = status.best_max_abs_error_m_s, status.last_learned_trial
    if not ratio or best_m_s is None or last is None:
        return None
    limit = float(np.float32(ratio) * np.float32(best_m_s))
    if report.max_abs_error_m_s <= limit:
        return None
    numbers = [trial.number for trial in fish.trials()]
    if last not in numbers or _pulled(fish, last).max_abs_error_m_s() <= limit:
        return None
    for number in sorted(numbers, reverse=True):
        if number > last:
            continue
        trial = _pulled(fish, number)
        same = trial.reference_crc == status.reference_crc
        if same and trial.iteration == status.best_iteration and trial.end_fault == 0:
            return trial.beats.applied_rad
    return None
