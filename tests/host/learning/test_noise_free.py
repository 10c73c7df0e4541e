"""Simulated fish before a camera without noise: positions that do not change are a fish at rest."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core.reference import from_text
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard

from ..tank_day import Day, Tank

QUIET = {
    "gain_sigma": 0.0, "flow_sigma_m_s": 0.0, "start_sigma_m_s": 0.0,
    "camera_noise_m": 0.0, "imu_noise": 0.0,
}  # fmt: skip


@pytest.fixture
def day_of(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Callable[[SimBoard], Day]:
    def make(board: SimBoard) -> Day:
        tank = Tank(board)
        monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: tank)
        monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "logbook"))
        monkeypatch.chdir(tmp_path)
        return Day(board, tank, capsys)

    return make


@pytest.mark.parametrize(
    "board", [SimBoard("thesis"), SimBoard("tank", camera_noise_m=0.0)], ids=["thesis", "tank"]
)
def test_a_guided_series(day_of: Callable[[SimBoard], Day], board: SimBoard) -> None:
    day = day_of(board)
    day.types("reference", "upload", "thesis")
    series = day.types("trial", "run", "--until", 2, "--then", "keep")
    assert [trial["decision"] for trial in series["swims"]] == ["keep", "keep"]
    for trial in series["swims"]:
        assert trial["ready"]["pose"]["source"] == trial["ready"]["drift"]["source"] == "camera"
        assert trial["ready"]["drift"]["speed_m_s"] < 1e-4
        assert trial["problems"] == [] and trial["max_abs_error_m_s"] < 0.0792


def test_a_second_reference_that_does_not_set_the_fish_going() -> None:
    """Its first amplitudes are within the dead zone: it has not moved, and that is a speed."""
    with Fish.connect("sim:tank", seed=1, **QUIET) as fish:
        assert fish.sim is not None
        for words in ("trapezoid:0.06,4,6", "trapezoid:0.06,4,6", "trapezoid:0.048,5,7.5"):
            if (wanted := from_text(words)).crc != fish.status().reference_crc:
                fish.upload_reference(wanted.record())
            outcome = run_trial(fish)
            speeds = [beat.speed_m_s for beat in outcome.beats]
            assert None not in speeds, words
            np.testing.assert_allclose(speeds, fish.sim.world.true_beats(), atol=2e-3)
            assert fish.learn(outcome.number).max_abs_error_m_s > 0
        assert max(fish.sim.world.true_beats()) < 1e-3, "it has not been set going"
