"""TIMESYNC: offset, rate, restarts."""

from __future__ import annotations

import pytest

from tailbeat.board.fish import Fish
from tailbeat.link.timesync import BoardClock, ClockSample


def forget(clock: BoardClock) -> None:
    """As before the first exchange."""
    clock._recent.clear()
    clock._anchor = None
    clock._rate_error = float("inf")


def test_offset_to_a_board_that_booted_later() -> None:
    with Fish.connect("sim:tank", boot_s=2.0) as fish:
        assert fish.sim is not None
        fish.link.run(3.0)
        assert fish.clock.rate == 1.0
        assert fish.clock.now_s() == pytest.approx(fish.sim.board_time_s, abs=0.02)
        assert fish.clock.board_s(10.0) == pytest.approx(8.0, abs=0.02)


def test_the_shortest_round_trip_wins(fish: Fish) -> None:
    clock = fish.clock
    base = fish.transport.now_s() + 100.0
    forget(clock)
    clock.add(ClockSample(base, 200.0, 0.01))
    clock.add(ClockSample(base + 0.01, 200.015, 0.6))
    assert clock.board_s(base) == pytest.approx(200.0)
    clock.add(ClockSample(base + 0.02, 200.021, 0.001))
    assert clock.board_s(base) == pytest.approx(200.001)


@pytest.mark.parametrize("rate", [0.1, 20.0, 300.0])
def test_rate_of_a_board_in_virtual_time(fish: Fish, rate: float) -> None:
    clock = fish.clock
    forget(clock)
    for k in range(8):
        host_s = 1000.0 + 0.02 * k
        clock.add(ClockSample(host_s, 500.0 + rate * 0.02 * k, 0.0005))
    assert clock.rate == pytest.approx(rate, rel=0.01)
    assert fish.link.rate == clock.rate


def test_jitter_of_a_radio_is_no_rate(fish: Fish) -> None:
    clock = fish.clock
    forget(clock)
    for k in range(1, 9):
        host_s = 1000.0 + 0.02 * k
        jitter_s = 0.03 if k % 2 else -0.03
        clock.add(ClockSample(host_s, 500.0 + 0.02 * k + jitter_s, 0.08))
    assert clock.rate == 1.0


def test_a_restart_of_the_board_is_noticed(fish: Fish) -> None:
    assert fish.sim is not None
    fish.link.run(20.0)
    fish.sim.world.power_cycle()
    fish.link.run(0.5)
    fish.clock.sync()
    assert fish.clock.now_s() == pytest.approx(fish.sim.board_time_s, abs=0.02)
    assert fish.clock.rate == 1.0  # nothing of the time before the restart is in it


def test_keep_refreshes_without_waiting(fish: Fish) -> None:
    before = fish.clock._recent[-1].host_s
    for _ in range(400):
        fish.link.idle(0.01)
        fish.clock.keep()
    assert fish.clock._recent[-1].host_s > before + 2.0


def test_a_fresh_series_measures_the_rate_anew(fish: Fish) -> None:
    """After a reconnect the board may run at another speed; what was known so well is of before."""
    clock = fish.clock
    clock.rate, clock._rate_error = 5.0, 1e-9
    clock.sync()
    assert clock.rate == 1.0
