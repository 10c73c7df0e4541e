"""A swim in which something moved the fish: told of every one, of no other."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core.reference import Reference, thesis
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.learning.fish_model import TrialSpeeds, trial_speeds
from tailbeat.learning.fit_quality import disturbance_of
from tailbeat.link.messages import BeatEvent
from tailbeat.session.collect import TrialLog, outcome_of, record_of
from tailbeat.session.trial import run_trial

PUSH_M_S = 0.05
BEATS = 16
HILL = Reference(
    1.0, (0.07 * np.sin(np.linspace(0.2, 2.9, BEATS))).astype(np.float32), "hill"
)  # fmt: skip


class Tank:
    """A simulated fish that learns; what happens to it happens when a beat is heard of."""

    def __init__(self, folder: Path, seed: int, reference: Reference) -> None:
        self.fish, self.folder = Fish.connect("sim:", seed=seed), folder
        self.fish.upload_reference(reference)

    def execute(self, push_m_s: float = 0.0, at: int = 0, dark_s: float = 0.0) -> Trial:
        board = self.fish.sim
        assert board is not None
        heard_s: list[float] = []

        def look(seen: object) -> None:
            if isinstance(seen, BeatEvent) and seen.beat == at and not heard_s:
                heard_s.append(board.time_s)
                board.world.push(push_m_s)
                board.world.set_camera(not dark_s)
            if heard_s and board.time_s - heard_s[0] > dark_s:
                board.world.set_camera(True)

        self.fish.arm()
        number = run_trial(self.fish, guard=look).number
        return read_trial(self.fish.pull_trial(number, self.folder))


@pytest.fixture
def tank(tmp_path: Path) -> Iterator[Tank]:
    made = Tank(tmp_path, 3, HILL)
    yield made
    made.fish.close()


def problems(trial: Trial) -> tuple[str, ...]:
    return record_of(outcome_of(trial), TrialLog(Path("x.ulg"), trial, None), None).problems


def test_a_push_is_told_and_learning_is_not(tank: Tank) -> None:
    tank.fish.params.set("ILC_LEAD", 0)  # with 1, the push back in beat 2 is taken for one ahead
    for at in (2, 7, 11):
        clean = tank.execute()
        assert disturbance_of(trial_speeds(clean)) is None and problems(clean) == ()
        tank.fish.learn()
        pushed = tank.execute(PUSH_M_S if at == 7 else -PUSH_M_S, at)
        tank.fish.discard()
        found = disturbance_of(trial_speeds(pushed))
        assert found is not None and (found.by_m_s > 0) == (at == 7)
        assert 0.012 < abs(found.by_m_s) <= PUSH_M_S
        assert at < found.beats.start <= at + 4  # beats are heard of 2.5 s after their end
        assert problems(pushed) == (found.words(),)


def test_what_is_said() -> None:
    speed = np.r_[np.full(10, 0.05), 0.09, 0.07, np.full(8, 0.05)]
    trial = TrialSpeeds(np.full(20, 0.4253), speed, np.full(20, 0.0005))
    found = disturbance_of(trial)
    assert found is not None
    assert found.words() == "beats 10-11 jump by +40 mm/s: a bump or a wave?"
    noisy = TrialSpeeds(trial.amplitude_rad, speed, np.full(20, 0.007))
    assert disturbance_of(noisy) is None, "the camera is no better than that"


def test_too_little_to_tell() -> None:
    speed = np.full(20, np.nan)
    assert disturbance_of(TrialSpeeds(np.full(20, 0.4), speed, np.full(20, 0.001))) is None
    speed[3:8] = (0.05, 0.05, 0.05, 0.05, 0.15)
    assert disturbance_of(TrialSpeeds(np.full(20, 0.4), speed, np.full(20, 0.001))) is None


def test_a_camera_that_was_away_is_the_reason_of_missing_speeds(tank: Tank) -> None:
    trial = tank.execute(at=4, dark_s=3.0)
    (told,) = problems(trial)
    missing = np.count_nonzero(~np.isfinite(trial.beats.speed_m_s))
    assert told.startswith(f"{missing} of {BEATS} beats have no speed: none came from the camera")
    seconds = float(told.partition("camera for ")[2].partition(" s")[0])
    assert 2.5 < seconds < 5.0
    tank.fish.discard()


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(1, 21))
def test_many_fish(tmp_path: Path, seed: int) -> None:
    print(f"seed {seed}")
    rng = np.random.default_rng(seed)
    tank = Tank(tmp_path, seed, thesis())
    for _ in range(10):
        assert disturbance_of(trial_speeds(tank.execute())) is None
        tank.fish.learn()
        at, by = int(rng.integers(0, 36)), float(rng.choice([-PUSH_M_S, PUSH_M_S]))
        assert disturbance_of(trial_speeds(tank.execute(by, at))) is not None, (at, by)
        tank.fish.discard()
    tank.fish.close()
