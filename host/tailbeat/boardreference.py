"""The reference of a connected board, and the one that stands for none."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tailbeat.records import decode_reference
from tailbeat.reference import Reference

if TYPE_CHECKING:
    from tailbeat.fish import Fish

# A board cannot lose its reference again. After an identification on one that had none a beat at
# rest stands for none: no run's amplitudes may swim again.
REST = Reference(1.0, np.zeros(1, np.float32), "rest")


def board_reference(fish: Fish) -> Reference | None:
    """None when it has none, or one that is zero throughout."""
    record = fish.reference_record()
    if record is None:
        return None
    held = decode_reference(record)
    if not np.any(held.speed_m_s):
        return None
    return Reference(held.beat_s, held.speed_m_s, f"{held.crc:08x}")
