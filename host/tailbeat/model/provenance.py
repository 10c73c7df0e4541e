"""Where an input came from: everything a proposal was made of, as JSON, and the way to make it
again from that and the trials."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.errors import InputError
from tailbeat.laws import Law
from tailbeat.model.identified import Identified
from tailbeat.model.modellaw import Proposal, propose
from tailbeat.model.swim import Swim
from tailbeat.reference import Reference
from tailbeat.verdict import input_crc

FORMAT = "tailbeat proposal 1"


def document_of(
    proposal: Proposal,
    identified: Identified,
    reference: Reference,
    amplitude_max_rad: float,
    swims: Sequence[Swim],
    fallback: Law,
    step_max_rad: float,
) -> dict[str, Any]:
    """JSON types, SI units. The arguments are those ``propose`` was called with."""
    low, median, high = proposal.predicted_max_abs_error_m_s
    return {
        "format": FORMAT,
        "law": proposal.law,
        "reason": proposal.reason,
        "input_crc": input_crc(proposal.amplitude_rad),
        "amplitude_rad": _numbers(proposal.amplitude_rad),
        "predicted_m_s": _numbers(proposal.predicted_m_s),
        "low_m_s": _numbers(proposal.low_m_s),
        "high_m_s": _numbers(proposal.high_m_s),
        "predicted_max_abs_error_m_s": {"low": low, "median": median, "high": high},
        "model": asdict(proposal.model),
        "disturbance_m_s": _numbers(proposal.disturbance_m_s),
        "fitted_trials": list(proposal.trials),
        "chance": proposal.chance,
        "limited_beats": proposal.limited_beats,
        "reference": {
            "crc": reference.crc,
            "name": reference.name,
            "beat_s": reference.beat_s,
            "speed_m_s": [float(v) for v in reference.speed_m_s],
        },
        "amplitude_max_rad": amplitude_max_rad,
        "step_max_rad": step_max_rad,
        "fallback": asdict(fallback),
        "swims": [{"trial": swim.trial, "crc": swim_crc(swim)} for swim in swims],
        "identified": identified.as_dict(),
    }


def again(document: dict[str, Any], swims: Sequence[Swim]) -> Proposal:
    """The proposal made anew; ``swims``: of the fish, in any order, those it names among them.

    Raises InputError when one is missing or no longer what it was, or the document is damaged.
    """
    try:
        reference = Reference(
            beat_s=float(document["reference"]["beat_s"]),
            speed_m_s=np.array(document["reference"]["speed_m_s"], dtype=np.float32),
            name=str(document["reference"]["name"]),
        )
        return propose(
            Identified.from_dict(document["identified"]),
            reference,
            float(document["amplitude_max_rad"]),
            _named(document["swims"], swims),
            Law(**document["fallback"]),
            float(document["step_max_rad"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            "this is no proposal, or it is damaged.", "Take one from the fish's logbook."
        ) from error


def _named(names: Sequence[dict[str, Any]], swims: Sequence[Swim]) -> list[Swim]:
    by_crc = {swim_crc(swim): swim for swim in swims}
    missing = [str(name["trial"]) for name in names if name["crc"] not in by_crc]
    if missing:
        raise InputError(
            f"the proposal was made from other data of trial {', '.join(missing)}.",
            "Look for that trial's file in the fish's logbook.",
        )
    return [by_crc[name["crc"]] for name in names]


def swim_crc(swim: Swim) -> int:
    """CRC-32 of all that the model learns from a swim."""
    crc = zlib.crc32(f"{swim.trial} {swim.reference_crc} {swim.beat_s!r}".encode())
    for values in (swim.amplitude_rad, swim.speed_m_s, swim.sigma_m_s):
        crc = zlib.crc32(np.nan_to_num(values, nan=-1.0).astype("<f8").tobytes(), crc)
    return crc


def _numbers(values: NDArray[np.float64]) -> list[float]:
    return [float(value) for value in values]
