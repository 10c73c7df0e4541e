"""The next input, computed on the host: a dry run of the board's own law, and the model-based law.

After a model-based step the board learns from the trial, too: its iteration, its best input and its
rollback go on, and its own step stands should the computer fail before the upload.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from tailbeat.board.fish import Fish, board_reference
from tailbeat.core import law as laws
from tailbeat.core.arrays import F32
from tailbeat.core.errors import InputError
from tailbeat.core.faults import NO_TRIAL, refusal
from tailbeat.core.law import Law
from tailbeat.core.law_memory import LawMemory, Memory, PastTrial
from tailbeat.core.printable import amplitude_rows
from tailbeat.core.records import decode_past, decode_reference, past_path, record_crc
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.learning.belief import Beliefs
from tailbeat.learning.fish_model import TrialSpeeds
from tailbeat.learning.identification import Identified
from tailbeat.learning.model_law import (
    ModelStepSetting,
    Proposal,
    document_of,
    predicted_by,
    propose_by,
    swim_crc,
)
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
        return f"{head}\n{amplitude_rows(self.amplitude_rad)}"


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
    learner = LawMemory.of(memory, past, _past_trials(fish, past, status.iteration))
    extrapolation = int(params.get("ILC_EXTRAP", 0))
    learner.learn(law, error, measured, complete, params["ROLLBACK_RATIO"], extrapolation)
    return DryRun(
        trial=pending,
        iteration=trial.iteration,
        report=learner.report,
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


def _past_trials(fish: Fish, past: laws.Averaging, iteration: int) -> list[PastTrial]:
    """What the board looks back on, newest first: the chain that begins with what it has learned
    (docs/reference/protocol.md). A file that is missing or not of the chain ends it."""
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


@dataclass(frozen=True)
class ModelStep:
    """``foretold_m_s``: 5 %, 50 % and 95 % of max|e| of the last trial, by what was known before
    it; None without one. ``document``: the proposal's provenance."""

    proposal: Proposal
    foretold_m_s: tuple[float, float, float] | None
    document: dict[str, Any]


def setting_of(fish: Fish) -> ModelStepSetting:
    """Raises InputError when the board has no reference."""
    wanted = board_reference(fish)
    if wanted is None:
        raise InputError("the board has no reference.", "tailbeat reference upload thesis")
    params = fish.params.values()
    return ModelStepSetting(
        reference=wanted,
        amplitude_max_rad=params["AMP_MAX_RAD"],
        step_max_rad=params["DU_MAX_RAD"],
        law=Law.from_params(params, wanted.beat_s),
    )


def trials_since(
    identified: Identified, trials: Sequence[TrialSpeeds], unique_id: str
) -> list[TrialSpeeds]:
    """Those of ``trials`` (oldest first) that came after the first of the runs the fish was
    identified by and are none of them; all, when it was identified by another fish's or by a
    table. Runs are known by what is in them: the numbers of a simulated board that starts again,
    or of one that lost its store, come again."""
    if identified.unique_id != unique_id:
        return list(trials)
    own = {swim_crc(trial) for trial in identified.trials}
    is_own = [swim_crc(trial) in own for trial in trials]
    since = is_own.index(True) if any(is_own) else 0
    rows = zip(trials[since:], is_own[since:], strict=True)
    return [trial for trial, its_own in rows if not its_own]


def numbering_restarted(every: Sequence[TrialSpeeds], since: Sequence[TrialSpeeds]) -> bool:
    """Whether the board started anew within ``since`` (a part of ``every``): numbers go back, and
    one names two trials. (Trials that were pulled late go back, too.)"""
    numbers = [trial.trial for trial in since]
    falls = any(after <= before for before, after in pairwise(numbers))
    return falls and len({trial.trial for trial in every}) < len(every)


@dataclass(frozen=True)
class NextInput:
    """Whether the proposal is uploaded, and why where the board holds its best input (because it
    rolled back, or somebody restored it)."""

    upload: bool
    words: str = ""


def choose_next_input(proposal: Proposal, restored: bool, best_m_s: float | None) -> NextInput:
    """``restored``: the board is about to swim its best input again; ``best_m_s``: max|e| of that.
    The proposal takes its place only where the model foresees less than that."""
    if not restored:
        return NextInput(True)
    if proposal.law == "best":
        return NextInput(False, "the best input is next, as the model proposes")
    if proposal.law == "p":
        return NextInput(False, "the best input is next, not a step by P")
    median = proposal.predicted_max_abs_error_m_s[1]
    if best_m_s is None or median < best_m_s:
        return NextInput(True, "the model's plan takes the place of the best amplitudes")
    said = f"{median * 1e3:.1f} mm/s, the best had {best_m_s * 1e3:.1f}"
    return NextInput(False, f"the best input is next: the model predicts nothing better ({said})")


def next_step(
    setting: ModelStepSetting, beliefs: Beliefs, trials: Sequence[TrialSpeeds]
) -> ModelStep:
    """Proposes; changes nothing."""
    foretold = predicted_by(beliefs.after(trials[:-1]), setting.reference, trials)
    proposal = propose_by(beliefs.after(trials), setting, trials)
    document = document_of(proposal, beliefs.identified, setting, trials)
    return ModelStep(proposal, foretold, document)


def upload(fish: Fish, setting: ModelStepSetting, proposal: Proposal) -> None:
    """The next trial's amplitudes, within the board's limit to the last bit."""
    limit = np.float32(setting.amplitude_max_rad)
    fish.upload_amplitudes(np.minimum(proposal.amplitude_rad.astype(np.float32), limit))
