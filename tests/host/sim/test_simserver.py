"""The simulator as a process: ports, clients that drop, the camera, the console."""

from __future__ import annotations

import json
import os
import re
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import TextIO

import pytest

from tailbeat.app.cli.sim import _serve_text
from tailbeat.board import connect as find
from tailbeat.board.fish import Fish
from tailbeat.board.provision import connect_notice, set_key
from tailbeat.core import reference
from tailbeat.core.errors import ConnectError, InputError, Refused
from tailbeat.sim.board import SimBoard
from tailbeat.sim.server import Addresses, SimServer, parse_listen

SPEED = 40.0
PATIENCE_S = 600.0


@contextmanager
def running(pty: bool = False, speed: float = SPEED) -> Iterator[SimServer]:
    server = SimServer(SimBoard("tank"), "tcp:127.0.0.1:0", pty, speed)
    stop = threading.Event()
    thread = threading.Thread(target=server.serve, args=(stop.is_set,))
    thread.start()
    try:
        yield server
    finally:
        stop.set()
        thread.join()
        server.close()


def connect(address: str) -> socket.socket:
    host, port = parse_listen(address)
    return socket.create_connection((host, port), PATIENCE_S)


def test_a_fish_answers_and_clients_may_come_again() -> None:
    with running() as server:
        times = []
        for _ in range(3):
            with Fish.connect(server.addresses.listen) as fish:
                info = fish.info()
                assert info.simulated
                times.append(info.status.time_s)
        assert times == sorted(times)


def test_the_ports_are_called_what_the_page_calls_them() -> None:
    at = Addresses("tcp:h:1", "tcp:h:2", "tcp:h:3", "/dev/pts/7", "tcp:h:4")
    lines = _serve_text("simulated fish", 1.0, at).splitlines()[1:]
    page = Path(__file__).parents[3] / "docs/how-to/simulate.md"
    names = re.findall(r"^\| 576[123] \| ([\w -]+\w)", page.read_text(), re.M)
    assert names == ["camera", "USB serial", "fault-injection port"]
    assert all(line.startswith(f"{name} tcp:h:") for name, line in zip(names, lines, strict=True))


def test_the_board_lives_on_when_a_client_drops() -> None:
    with running() as server:
        with Fish.connect(server.addresses.listen) as fish:
            fish.params.set("ILC_GAIN", 5.0)
            fish.link.transport.close()
        with Fish.connect(server.addresses.listen) as fish:
            assert fish.params.get("ILC_GAIN").value == 5.0


def test_a_second_client_is_turned_away() -> None:
    with running() as server, Fish.connect(server.addresses.listen) as fish:
        with pytest.raises(ConnectError) as told:
            Fish.connect(server.addresses.listen)
        console = server.addresses.console
        assert str(told.value) == (
            f"another program is connected to {server.addresses.listen}. Go on in that program; any"
            f" key there stops a trial, and so does: tailbeat stop --connect {console}."
        )
        assert fish.info().simulated
        with Fish.connect(console) as wired:  # which is there for both
            assert wired.info().simulated
            with pytest.raises(ConnectError, match=f"another program is connected to {console}"):
                Fish.connect(console)


def test_a_second_program_that_seeks_the_fish_is_told_who_has_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(find, "likely_ports", lambda: iter(()))
    with running() as server, Fish.connect(server.addresses.listen):
        host, port = parse_listen(server.addresses.listen)
        monkeypatch.setattr(find, "DEFAULT_HOST", host)
        monkeypatch.setattr(find, "DEFAULT_PORT", port)
        with pytest.raises(ConnectError, match=r"another program is connected.*tailbeat stop"):
            find.find_board()


def test_camera_speaks_json_lines_in_board_time() -> None:
    with (
        running() as server,
        connect(server.addresses.camera) as camera,
        Fish.connect(server.addresses.listen) as fish,
    ):
        lines = camera.makefile()
        first, second = json.loads(lines.readline()), json.loads(lines.readline())
        assert list(first) == ["t_board_s", "x_m", "y_m", "heading_rad", "tail_rad", "led"]
        assert first["led"] == 0.0
        assert second["t_board_s"] > first["t_board_s"]
        assert fish.status().time_s >= first["t_board_s"]
        fish.upload_reference(reference.thesis().record())
        fish.arm()
        armed_s = fish.status().time_s
        while (row := json.loads(lines.readline()))["t_board_s"] < armed_s + 0.1:
            pass
        assert row["led"] == 1.0
        assert row["tail_rad"] == 0.0


def test_camera_is_on_the_next_port() -> None:
    with running() as server:
        radio = parse_listen(server.addresses.listen)[1]
        assert parse_listen(server.addresses.camera)[1] == radio + 1


def test_the_world_is_on_the_fourth_port() -> None:
    with running() as server:
        addresses = asdict(server.addresses)
        assert list(addresses) == ["listen", "camera", "console", "pty", "world"]
        radio = parse_listen(server.addresses.listen)[1]
        assert parse_listen(server.addresses.world)[1] == radio + 3
        with connect(server.addresses.world) as hand, hand.makefile() as lines:
            hand.sendall(b"place 0.5 0 0.2\npusch 1\ntruth\n")
            assert lines.readline() == "ok\n"
            assert "push" in lines.readline()
            assert json.loads(lines.readline())["heading_rad"] == 0.2
        with connect(server.addresses.world) as hand:  # one that has said its last still listens
            hand.sendall(b"truth\nplace 0.7 0 0")
            hand.shutdown(socket.SHUT_WR)
            answers = hand.makefile().read().splitlines()
        assert json.loads(answers[0])["x_m"] == pytest.approx(0.5, abs=0.01)
        assert answers[1:] == ["ok"]


def test_a_camera_goes_dark_by_a_word() -> None:
    with (
        running() as server,
        connect(server.addresses.camera) as camera,
        connect(server.addresses.world) as hand,
    ):
        pictures, answers = camera.makefile(), hand.makefile()
        pictures.readline()
        hand.sendall(b"camera off\n")
        assert answers.readline() == "ok\n"
        hand.sendall(b"truth\n")
        dark_s = json.loads(answers.readline())["time_s"]
        while json.loads(answers_to(hand, answers))["time_s"] < dark_s + 5:
            pass
        hand.sendall(b"camera on\n")
        times = [json.loads(pictures.readline())["t_board_s"] for _ in range(50)]
        while max(b - a for a, b in pairwise(times)) < 4:
            times.append(json.loads(pictures.readline())["t_board_s"])
            assert times[-1] < dark_s + 60


def answers_to(hand: socket.socket, answers: TextIO) -> str:
    hand.sendall(b"truth\n")
    return answers.readline()


def test_console_is_on_the_port_after_that() -> None:
    with running() as server:
        radio = parse_listen(server.addresses.listen)[1]
        assert parse_listen(server.addresses.console)[1] == radio + 2
        with (
            Fish.connect(server.addresses.console) as wire,
            Fish.connect(server.addresses.listen) as fish,
        ):
            wire.params.set("ILC_GAIN", 5.0)
            assert fish.params.get("ILC_GAIN").value == 5.0


def test_a_key_by_the_console_and_a_signed_session() -> None:
    with running(speed=4.0) as server:  # a frame older than 10 s of the board's time is refused
        with Fish.connect(server.addresses.console) as wire:
            with pytest.raises(Refused), Fish.connect(server.addresses.listen) as fish:
                set_key(fish)
            set_key(wire)
        for number in range(3):
            with Fish.connect(server.addresses.listen) as fish:
                fish.params.set("ILC_LEAD", number)
                fish.link.run(0.2)
                assert fish.params.get("ILC_LEAD").value == number
                assert connect_notice(fish) is None
                assert fish.health()["refused_unsigned"] == 0  # connecting asks nothing unsigned


@pytest.mark.skipif(sys.platform == "win32", reason="no ptys")
def test_console_on_a_pty() -> None:
    with running(pty=True) as server:
        path = server.addresses.pty
        assert path is not None
        for _ in range(2):
            with Fish.connect(path) as fish:
                assert fish.info().simulated
        assert os.path.exists(path)  # noqa: PTH110


def test_a_port_that_is_taken() -> None:
    with running() as server, pytest.raises(ConnectError, match="cannot listen") as caught:
        SimServer(SimBoard("tank"), server.addresses.listen)
    assert "--listen" in caught.value.remedy


def test_garbage_does_not_stop_it() -> None:
    with running() as server:
        with connect(server.addresses.listen) as stranger:
            stranger.sendall(bytes(range(256)) * 64)
        with Fish.connect(server.addresses.listen) as fish:
            assert fish.info().simulated


class Wall:
    """A clock that moves when the board works: ``cost`` wall seconds per simulated one."""

    def __init__(self, board: SimBoard, cost: float) -> None:
        self.now_s = 0.0
        self._run = board.run
        board.run = self._work  # type: ignore[method-assign]
        self._cost = cost

    def _work(self, duration_s: float) -> float:
        self.now_s += duration_s * self._cost
        return self._run(duration_s)

    def __call__(self) -> float:
        return self.now_s


@pytest.mark.parametrize(("cost", "slow"), [(0.5, [2.0]), (0.05, [])])
def test_a_board_that_falls_behind_is_told_once(cost: float, slow: list[float]) -> None:
    board = SimBoard("tank")
    wall = Wall(board, cost)
    told: list[float] = []
    server = SimServer(board, "tcp:127.0.0.1:0", speed=10.0, on_slow=told.append, wall_s=wall)
    longest_s = 0.0
    while wall.now_s < 11.0:
        before_s = wall.now_s
        wall.now_s += 0.005
        server.step()
        longest_s = max(longest_s, wall.now_s - before_s)
    server.close()
    assert told == pytest.approx(slow, rel=0.1)
    assert longest_s < 0.12
    assert board.time_s == pytest.approx(11.0 * min(10.0, 1 / cost), rel=0.1)


@pytest.mark.parametrize(
    "text", ["", "udp:1.2.3.4:5", "tcp:5760", "tcp:h:x", "tcp:h:99999", "tcp:h:65534"]
)
def test_places_that_are_none(text: str) -> None:
    with pytest.raises(InputError, match="no place to listen"):
        parse_listen(text)


def test_speed_must_make_sense() -> None:
    for speed in (0.0, -1.0, float("nan")):
        with pytest.raises(InputError, match="makes no sense"):
            SimServer(SimBoard("tank"), "tcp:127.0.0.1:0", speed=speed)


def test_time_passes_at_the_given_pace() -> None:
    with running() as server:
        for _ in range(2000):
            with Fish.connect(server.addresses.listen) as fish:
                if fish.status().time_s > 5:
                    return
    raise AssertionError("the board's time stands still")
