"""Memories side by side: each learns as one alone does."""

from __future__ import annotations

import numpy as np
import pytest

from tailbeat.core.errors import InputError
from tailbeat.core.law import PAST_KINDS, Averaging, Law
from tailbeat.core.law_memory import LawMemories, LawMemory
from tailbeat.core.reference import from_text

LAWS = (Law(), Law(kp_rad_s_m=5.0, amplitude_max_rad=0.6), Law(kp_rad_s_m=9.0))


@pytest.mark.parametrize("past", PAST_KINDS)
def test_each_learns_as_one_alone(past: str) -> None:
    """Also with beats and whole trials that nobody measured, and amplitudes brought back."""
    reference = from_text("cosine:0.05,3,6").speed_m_s
    averaging = Averaging(PAST_KINDS[past].number, 3)
    memories = LawMemories(LAWS, reference, averaging)
    alone = [LawMemory(len(reference)) for _ in LAWS]
    for memory, law in zip(alone, LAWS, strict=True):
        memory.average(averaging)
        memory.first(law, reference)
    rng = np.random.default_rng(7)
    backs = 0
    for trial in range(12):
        error = rng.normal(0, 0.01 * (1 + trial % 5), (3, len(reference))).astype(np.float32)
        measured = rng.random(error.shape) < 0.9
        measured[trial % 3] &= trial % 4 > 0
        error[~measured] = 0
        back = memories.learn(error, measured, measured[:, -1], 1.3)
        for i, (memory, law) in enumerate(zip(alone, LAWS, strict=True)):
            if measured[i].any():
                memory.learn(law, error[i], measured[i], bool(measured[i, -1]), 1.3)
            assert back[i] == (measured[i].any() and memory.rolled_back)
        backs += int(back.sum())
        assert np.array_equal(memories.amplitude_rad, [memory.amplitude_rad for memory in alone])
    assert backs > 0


def test_trials_of_other_fish_are_refused() -> None:
    reference = from_text("cosine:0.05,3,6").speed_m_s
    memories = LawMemories(LAWS, reference)
    some = np.zeros((2, len(reference)), np.float32)
    with pytest.raises(InputError, match="are no trials of 3 fish"):
        memories.learn(some, some > 0, some[:, 0] > 0)
    not_finite = np.full((3, len(reference)), np.nan, np.float32)
    with pytest.raises(InputError):
        memories.learn(not_finite, not_finite != 0, np.ones(3, dtype=bool))
