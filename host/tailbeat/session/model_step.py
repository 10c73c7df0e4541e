"""Learning with the model on a connected board: what ``learn --law model`` and the demo do.

The board learns from the trial, too: its iteration, its best input and its rollback go on, and its
own step stands should the computer fail before the model's amplitudes are uploaded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from tailbeat.board.fish import Fish, board_reference
from tailbeat.core.errors import InputError
from tailbeat.core.law import Law
from tailbeat.core.reference import Reference
from tailbeat.learning.fish_model import TrialSpeeds
from tailbeat.learning.identification import Identified
from tailbeat.learning.model_law import Proposal, document_of, predicted_before, propose, swim_crc


@dataclass(frozen=True)
class ModelStepSetting:
    """What the board swims for: its reference, its limits (``step_max_rad`` 0 = none), its law."""

    reference: Reference
    amplitude_max_rad: float
    step_max_rad: float
    law: Law


@dataclass(frozen=True)
class ModelStep:
    """``foretold_m_s``: 5 %, 50 % and 95 % of max|e| of the last swim, by what was known before it;
    None without one. ``document``: the proposal's provenance."""

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


def swims_since(
    identified: Identified, swims: Sequence[TrialSpeeds], unique_id: str
) -> list[TrialSpeeds]:
    """Those of ``swims`` (oldest first) that came after the runs the fish was identified by; all,
    when it was identified by another fish's or by a table. Runs are known by what is in them: the
    numbers of a simulated board that starts again, or of one that lost its store, come again."""
    if identified.unique_id != unique_id:
        return list(swims)
    own = {swim_crc(swim) for swim in identified.swims}
    last = max((at for at, swim in enumerate(swims) if swim_crc(swim) in own), default=-1)
    return list(swims[last + 1 :])


def numbered_anew(every: Sequence[TrialSpeeds], since: Sequence[TrialSpeeds]) -> bool:
    """Whether the board started anew within ``since`` (a part of ``every``): numbers go back, and
    one names two swims. (Trials that were pulled late go back, too.)"""
    numbers = [swim.trial for swim in since]
    falls = any(after <= before for before, after in pairwise(numbers))
    return falls and len({swim.trial for swim in every}) < len(every)


@dataclass(frozen=True)
class Next:
    """Whether the proposal is uploaded, and why where the board holds its best input (because it
    rolled back, or somebody restored it)."""

    upload: bool
    words: str = ""


def next_of(proposal: Proposal, restored: bool, best_m_s: float | None) -> Next:
    """``restored``: the board is about to swim its best input again; ``best_m_s``: max|e| of that.
    The proposal takes its place only where the model foresees less than that."""
    if not restored:
        return Next(True)
    if proposal.law == "p":
        return Next(False, "the best amplitudes swim next, not a step by P")
    median = proposal.predicted_max_abs_error_m_s[1]
    if best_m_s is None or median < best_m_s:
        return Next(True, "the model's plan takes the place of the best amplitudes")
    said = f"{median * 1e3:.1f} mm/s, the best had {best_m_s * 1e3:.1f}"
    return Next(False, f"the best amplitudes swim next: the model foresees nothing better ({said})")


def next_step(
    setting: ModelStepSetting, identified: Identified, swims: Sequence[TrialSpeeds]
) -> ModelStep:
    """Proposes; changes nothing."""
    proposal = propose(
        identified,
        setting.reference,
        setting.amplitude_max_rad,
        swims,
        setting.law,
        setting.step_max_rad,
    )
    document = document_of(
        proposal,
        identified,
        setting.reference,
        setting.amplitude_max_rad,
        swims,
        setting.law,
        setting.step_max_rad,
    )
    return ModelStep(proposal, predicted_before(identified, setting.reference, swims), document)


def upload(fish: Fish, setting: ModelStepSetting, proposal: Proposal) -> None:
    """The next swim's amplitudes, within the board's limit to the last bit."""
    limit = np.float32(setting.amplitude_max_rad)
    fish.upload_amplitudes(np.minimum(proposal.amplitude_rad.astype(np.float32), limit))
