"""The TCP link breaks in the middle of a pull and of a trial."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core.errors import LinkLostError
from tailbeat.link.messages import BeatEvent
from tailbeat.link.sockets import TcpTransport
from tailbeat.session.events import Event, LinkLost, LinkRestored
from tailbeat.session.trial import run_trial


@pytest.fixture
def address(simulator) -> Iterator[str]:
    with simulator(20) as (listen, _):
        yield listen


def cut(fish: Fish) -> None:
    """Breaks the connection under the fish's feet."""
    assert isinstance(fish.transport, TcpTransport)
    assert fish.transport._socket is not None
    fish.transport._socket.shutdown(socket.SHUT_RDWR)


def with_reference(fish: Fish, beats: int) -> None:
    fish.params.set("TANK_LEN_M", 0)
    fish.upload_reference(records.encode_reference(1.0, [0.05] * beats))


def test_cut_in_the_middle_of_a_pull(address: str, tmp_path: Path) -> None:
    with Fish.connect(address) as fish:
        with_reference(fish, 20)
        assert run_trial(fish).end == "complete"
        todo = ["cut"]

        def break_off(done: int, total: int) -> None:
            if done > total // 2 and todo:
                todo.clear()
                cut(fish)

        with pytest.raises(LinkLostError):
            fish.pull_trial(1, tmp_path, break_off)
    assert not (tmp_path / "0001.ulg").exists()
    kept = (tmp_path / "0001.ulg.part").stat().st_size
    assert kept > 0
    with Fish.connect(address) as fish:
        seen: list[int] = []
        path = fish.pull_trial(1, tmp_path, lambda done, _: seen.append(done))
        assert seen[0] > kept
        assert path.read_bytes() == fish.ftp.read("/trials/0001.ulg")
    assert [p.name for p in tmp_path.iterdir()] == ["0001.ulg"]


def test_cut_in_the_middle_of_a_trial(address: str) -> None:
    with Fish.connect(address) as fish:
        with_reference(fish, 30)
        events: list[type] = []

        def follow(event: Event) -> None:
            if isinstance(event, BeatEvent) and event.beat == 3 and LinkLost not in events:
                cut(fish)
            events.append(type(event))

        outcome = run_trial(fish, on_event=follow)
        assert LinkLost in events
        assert LinkRestored in events
        # Back within the board's patience it goes on; later it has stopped by itself.
        assert outcome.end in ("complete", "aborted:LINK_LOST")
        assert fish.status().pending_trial == outcome.number
        assert fish.learn().measured_beats >= 3


def test_the_simulator_goes_away_for_good(simulator) -> None:
    with simulator(20) as (listen, server), Fish.connect(listen) as fish:
        with_reference(fish, 30)

        def follow(event: Event) -> None:
            if isinstance(event, BeatEvent):
                server.kill()

        with pytest.raises(LinkLostError) as lost:
            run_trial(fish, on_event=follow, reconnect_s=1.0)
    assert "did not come back" in str(lost.value)
