"""Addresses, and the ways bytes travel."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import time
from collections.abc import Callable, Iterator

import pytest

from tailbeat.board import connect
from tailbeat.board.fish import Fish
from tailbeat.core.errors import ConnectError, InputError, LinkLostError
from tailbeat.core.speed_source import CameraGone
from tailbeat.link import _dialect as mavlink
from tailbeat.link.sockets import TcpTransport
from tailbeat.link.transport import Transport
from tailbeat.sensors.camera.render.source import RemoteCamera, SimulatedCamera
from tailbeat.sim.board import SimBoard, SimTransport


def take(transport: Transport, count: int) -> bytes:
    got = b""
    deadline = time.monotonic() + 600.0
    while len(got) < count and time.monotonic() < deadline:
        transport.wait(0.1)
        got += transport.read()
    return got


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server


def heartbeat(vehicle: int = mavlink.MAV_TYPE_SUBMARINE) -> bytes:
    message = mavlink.MAVLink_heartbeat_message(vehicle, mavlink.MAV_AUTOPILOT_GENERIC, 0, 0, 4, 3)
    return message.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=1))


def test_tcp(listener: socket.socket) -> None:
    transport = connect.open_transport(f"tcp:127.0.0.1:{listener.getsockname()[1]}")
    peer, _ = listener.accept()
    with peer, contextlib.closing(transport):
        assert transport.read() == b""
        peer.sendall(b"hello")
        assert take(transport, 5) == b"hello"
        transport.write(b"fish")
        assert peer.recv(16) == b"fish"
        peer.sendall(b"last")
        peer.close()
        assert take(transport, 4) == b"last"
        with pytest.raises(LinkLostError):
            take(transport, 1)


def test_tcp_takes_more_than_the_socket_and_sends_it_later(listener: socket.socket) -> None:
    transport = TcpTransport("127.0.0.1", listener.getsockname()[1])
    peer, _ = listener.accept()
    data = bytes(range(256)) * 2000
    with peer, contextlib.closing(transport):
        for at in range(0, len(data), 10000):
            transport.write(data[at : at + 10000])
        peer.settimeout(0.05)
        got = b""
        while len(got) < len(data):
            transport.wait(0.0)
            with contextlib.suppress(TimeoutError):
                got += peer.recv(65536)
        assert got == data


def test_tcp_nobody_there(listener: socket.socket) -> None:
    port = listener.getsockname()[1]
    listener.close()
    with pytest.raises(ConnectError) as refused:
        connect.open_transport(f"tcp:127.0.0.1:{port}")
    assert "tailbeat sim" in str(refused.value)


@pytest.mark.parametrize("url", ["tcp:..:5", "udp:..:5"])
def test_names_no_host_can_have(url: str) -> None:
    with pytest.raises(ConnectError):
        connect.open_transport(url)


def test_tcp_version_6_in_brackets() -> None:
    assert connect.tcp_address("tcp:[::1]:5760") == ("::1", 5760)


def test_tcp_reopens(listener: socket.socket) -> None:
    transport = TcpTransport("127.0.0.1", listener.getsockname()[1])
    first, _ = listener.accept()
    first.close()
    with pytest.raises(
        LinkLostError, match=r"closed the connection at once\. It may serve one program"
    ):
        take(transport, 1)
    transport.reopen()
    second, _ = listener.accept()
    second.sendall(b"again")
    assert take(transport, 5) == b"again"
    second.close()
    transport.close()
    transport.close()
    with pytest.raises(LinkLostError):
        transport.write(b"x")


def test_udp_answers_who_spoke() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    transport = connect.open_transport(f"udp:{port}")
    with contextlib.closing(transport), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as board:
        board.settimeout(600)
        transport.write(b"nobody hears this")
        board.sendto(b"hello", ("127.0.0.1", port))
        assert take(transport, 5) == b"hello"
        transport.write(b"fish")
        assert board.recv(64) == b"fish"


def test_udp_speaks_first_to_a_named_peer() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as board:
        board.bind(("127.0.0.1", 0))
        board.settimeout(600)
        transport = connect.open_transport(f"udp:127.0.0.1:{board.getsockname()[1]}")
        with contextlib.closing(transport):
            transport.write(b"hello")
            data, sender = board.recvfrom(64)
            board.sendto(data.upper(), sender)
            assert take(transport, 5) == b"HELLO"


@pytest.mark.skipif(sys.platform == "win32", reason="no ptys")
def test_serial_on_a_pty() -> None:
    import pty
    import tty

    master, slave = pty.openpty()
    tty.setraw(slave)
    transport = connect.open_transport(os.ttyname(slave))
    os.write(master, b"hello")
    assert take(transport, 5) == b"hello"
    transport.write(b"fish")
    assert os.read(master, 16) == b"fish"
    transport.close()
    os.close(slave)
    os.close(master)


def test_serial_missing() -> None:
    with pytest.raises(ConnectError) as missing:
        connect.open_transport("/dev/no-such-port")
    assert "/dev/no-such-port" in str(missing.value)


@pytest.mark.parametrize(
    "url",
    ["", "xyz", "tcp:", "tcp:host", "tcp:host:port", "tcp:h:99999", "udp:x", "sim:pond",
     "sim?seed=x", "sim?seed=nan", "sim?seed=-1", "sim?seed=1e30",
     "sim?nonsense=1", "sim?camera=1", "sim:tank?plant=thesis", "sim?plant=pond",
     "sim?seed=1&seed=2", "sim?port=usb", "sim?port=1"],
)  # fmt: skip
def test_senseless_addresses(url: str) -> None:
    with pytest.raises(InputError) as bad:
        connect.open_transport(url)
    assert "\n" not in str(bad.value)


def test_sim_address_with_values() -> None:
    transport = connect.open_transport("sim:thesis?seed=9&mass=0.5", camera_fps=50.0)
    assert isinstance(transport, SimTransport)
    board = transport.board
    assert (board.plant, board.seed) == ("thesis", 9)
    assert board.config["mass_kg"] == 0.5
    assert board.config["camera_fps"] == 50.0
    assert connect.open_transport("sim").board.plant == "tank"
    assert connect.open_transport("sim?plant=thesis").board.plant == "thesis"
    assert connect.open_transport(f"sim?seed={2**64 - 1}").board.seed == 2**64 - 1
    assert connect.open_transport("sim?kappa=5").board.config["kappa_per_m"] == 5.0
    with pytest.raises(InputError):
        connect.open_transport("tcp:127.0.0.1:1", kappa=5.0)


def test_a_simulated_board_has_an_id_of_its_own_unless_a_seed_is_given() -> None:
    def board_id(url: str) -> bytes:
        with Fish.connect(url) as fish:
            assert fish.sim is not None and fish.sim.seed == 1, "the disturbances are the usual"
            return bytes.fromhex(fish.unique_id())

    first, second = board_id("sim"), board_id("sim")
    assert first != second and first[:8] == second[:8] == b"sim-fish"
    assert board_id("sim?seed=1") == board_id("sim:thesis?seed=1") == b"sim-fish\x01" + bytes(7)


def test_finding_a_fish(listener: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connect, "likely_ports", lambda: iter(["/dev/no-such-port"]))
    monkeypatch.setattr(connect, "DEFAULT_PORT", listener.getsockname()[1])
    with pytest.raises(ConnectError) as nobody:
        connect.find_board(listen_s=0.1)
    text = str(nobody.value)
    assert "/dev/no-such-port" in text
    assert "no tailbeat heartbeat" in text
    assert "tailbeat sim" in text
    assert "\n" not in text


def test_another_vehicle_is_not_a_fish(listener: socket.socket) -> None:
    transport = TcpTransport("127.0.0.1", listener.getsockname()[1])
    peer, _ = listener.accept()
    with peer, contextlib.closing(transport):
        peer.sendall(heartbeat(mavlink.MAV_TYPE_QUADROTOR))
        assert connect.hear_board(transport, 0.2) is None
        peer.sendall(b"noise" + heartbeat())
        assert connect.hear_board(transport, 5.0) is not None


def test_simulated_time_passes_only_in_waits() -> None:
    transport = SimTransport(SimBoard())
    begin = transport.now_s()
    transport.read()
    assert transport.now_s() == begin
    transport.wait(0.0)  # never nothing, or a loop of zero waits would hang
    assert transport.now_s() > begin


def test_pictures_end_waits_only_while_watched() -> None:
    board = SimBoard()
    transport = SimTransport(board)
    transport.wait(3.0)
    camera = SimulatedCamera(board)
    begin = transport.now_s()
    transport.read()
    transport.wait(0.5)
    transport.wait(0.5)  # the first picture was not fetched: this must not return at once
    assert transport.now_s() >= begin + 0.04
    frames = camera.frames()
    assert frames
    assert [f.t_s for f in frames] == sorted(f.t_s for f in frames)
    camera.close()


def test_remote_camera_survives_nonsense(listener: socket.socket) -> None:
    camera = RemoteCamera("127.0.0.1", listener.getsockname()[1])
    peer, _ = listener.accept()
    good = b'{"t_board_s": 1.0, "x_m": 0.5, "y_m": 0, "heading_rad": 0}'
    lines = [good, b"[]", b"{", b'{"x_m":1}']
    with peer:
        peer.sendall(b"\n".join(lines) + b'\n{"t_board_s": 2.0, ')
        frames = wait_for(camera.frames, 1)
        assert [(f.t_s, f.x_m) for f in frames] == [(1.0, 0.5)]
        peer.sendall(b'"x_m": 0.6}\n')
        assert [(f.t_s, f.x_m) for f in wait_for(camera.frames, 1)] == [(2.0, 0.6)]
    with pytest.raises(CameraGone):
        camera.frames()
    assert camera.frames() == []
    camera.close()


def wait_for(frames: Callable[[], list], count: int) -> list:
    got: list = []
    deadline = time.monotonic() + 600.0
    while len(got) < count and time.monotonic() < deadline:
        got += frames()
    return got
