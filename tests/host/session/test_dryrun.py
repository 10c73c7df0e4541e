"""`learn --dry-run` computes what the board will: bit for bit, rollback included."""

from __future__ import annotations

import numpy as np

from tailbeat.board.fish import Fish
from tailbeat.core import reference
from tailbeat.session.next_input import dry_run
from tailbeat.session.outcome import StopKind, StopReason
from tailbeat.session.trial import run_trial

ENOUGH = StopReason(StopKind.CALLER, "enough")


def swim_and_compare(fish: Fish) -> bool:
    """One trial; whether learning from it rolled back. The dry run must say the same before."""
    run_trial(fish)
    foretold = dry_run(fish)
    learned = fish.learn()
    assert foretold.amplitude_rad.tobytes() == fish.amplitudes().values.tobytes()
    assert foretold.rolled_back == learned.rolled_back
    assert np.float32(foretold.report.max_abs_error_m_s) == np.float32(learned.max_abs_error_m_s)
    return foretold.rolled_back


def test_every_trial_of_a_session_is_foretold(fish: Fish) -> None:
    fish.params.set("ILC_LEAD", 1)
    fish.upload_reference(reference.cosine(0.06, 4.0, 6.0).record())
    assert not any(swim_and_compare(fish) for _ in range(4))


def test_a_session_with_half_a_beat_and_a_fading_gain_is_foretold(fish: Fish) -> None:
    for name, value in {"ILC_LEAD": 0.5, "ILC_DECR_RATE": 0.7, "ILC_DECR_FROM": 1}.items():
        fish.params.set(name, value)
    fish.upload_reference(reference.cosine(0.06, 4.0, 6.0).record())
    beats = fish.status().beats
    for learned in range(4):
        visits = fish.visits()
        assert visits is not None
        assert visits.tolist() == [learned] * beats
        assert not swim_and_compare(fish)


def test_a_rollback_is_foretold_and_brings_back_the_best_as_swum(fish: Fish) -> None:
    fish.upload_reference(reference.cosine(0.06, 4.0, 6.0).record())
    for _ in range(3):
        assert not swim_and_compare(fish)
    best = fish.amplitudes(best=True)
    rolled_back = []
    for _ in range(2):
        fish.upload_amplitudes(np.zeros(best.beats))
        rolled_back.append(swim_and_compare(fish))
    assert rolled_back == [False, True]
    assert fish.amplitudes().values.tobytes() == best.values.tobytes()


def test_an_aborted_trial_is_foretold(fish: Fish) -> None:
    fish.upload_reference(reference.cosine(0.06, 4.0, 6.0).record())
    swim_and_compare(fish)
    visited = fish.visits()
    frames = iter(range(1000))
    outcome = run_trial(fish, guard=lambda _: ENOUGH if next(frames) > 200 else None)
    assert outcome.end == "aborted:ABORT_COMMAND"
    fish.clear()
    foretold = dry_run(fish)
    fish.learn()
    assert foretold.amplitude_rad.tobytes() == fish.amplitudes().values.tobytes()
    visits = fish.visits()
    assert visited is not None and visits is not None
    more = visits - visited
    assert more[0] == 1 and more[-1] == 0  # the beats that were not reached keep their gain
