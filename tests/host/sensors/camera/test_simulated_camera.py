"""What the simulated camera sees beside the position: the tail, and the LED through its shutter."""

from __future__ import annotations

import json
import math
import random
import socket
import struct
import time

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core.errors import InputError
from tailbeat.core.native import lib
from tailbeat.core.speed_source import CameraGone, Frame
from tailbeat.sensors.camera.render.source import RemoteCamera, SimulatedCamera
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimulatedBoard
from tailbeat.sim.world import FRAME_US, CameraFrame, Wires, World

EXPOSURE_S = 0.02
YAW_PER_TAIL = -10 / 45  # sim/water/plant.h


def lit_part(edges_us: list[int], picture: CameraFrame, exposure_s: float) -> float:
    """Part of the exposure after an odd number of the edges: on, off, on, ..."""
    half_us = exposure_s * 1e6 / 2
    begin_us, end_us = picture.time_s * 1e6 - half_us, picture.time_s * 1e6 + half_us
    on_us = 0.0
    for on, off in zip(edges_us[::2], [*edges_us[1::2], math.inf], strict=False):
        on_us += max(0.0, min(off, end_us) - max(on, begin_us))
    return on_us / (end_us - begin_us)


@pytest.mark.parametrize("seed", range(5))
def test_led_is_what_the_open_shutter_saw(seed: int) -> None:
    chance = random.Random(seed)
    world = Wires("tank", 1, camera_fps=27.0, camera_exposure_s=EXPOSURE_S)
    edges_us: list[int] = []
    next_us = 300_000
    while world.time_us < 8_000_000:
        end_us = world.time_us + FRAME_US
        while next_us <= end_us:
            world.led(next_us, len(edges_us) % 2 == 0)
            edges_us.append(next_us)
            next_us += chance.randrange(FRAME_US, 10 * FRAME_US)
        world.frame(end_us, 0)
    pictures = world.camera_read(world.time_us)
    assert len(pictures) > 200
    parts = [lit_part(edges_us, picture, EXPOSURE_S) for picture in pictures]
    assert [picture.led for picture in pictures] == pytest.approx(parts, abs=1e-9)
    assert sum(0 < part < 1 for part in parts) > 10


def test_tail_is_the_servos_and_turns_the_head() -> None:
    world = Wires("tank", 1, camera_noise=0.0, place_sigma_rad=0.0)
    fish = World(world.handle, None)  # type: ignore[arg-type]
    tails = [0.0]
    for n in range(300):
        angle = 0.6 * math.sin(2 * math.pi * n / 50)
        world.frame(world.time_us + FRAME_US, round(3 * (1500 + 572.9578 * angle)))
        tails.append(fish.truth().tail_rad)
    pictures = world.camera_read(world.time_us)
    times = np.array([picture.time_s for picture in pictures])
    seen = np.array([picture.tail_rad for picture in pictures])
    assert len(seen) > 140
    assert np.abs(seen).max() > 0.5
    np.testing.assert_allclose(seen, np.interp(times, np.arange(301) * 0.02, tails), atol=1e-9)
    heading = np.array([picture.heading_rad for picture in pictures])
    np.testing.assert_allclose(heading, YAW_PER_TAIL * seen, atol=1e-12)


class Watched(SimulatedCamera):
    """Keeps the pictures it was made of."""

    def __init__(self, board: SimulatedBoard) -> None:
        super().__init__(board)
        self.pictures: list[CameraFrame] = []

    def frames(self) -> list[Frame]:
        taken = self.board.camera_frames()
        self.pictures += taken
        return [Frame(f.time_s, f.x_m, f.y_m, f.heading_rad) for f in taken]


def test_the_firmwares_code_is_in_the_pictures_of_a_swim() -> None:
    """There is one begin of the trial, a tick of the board, with which all pictures agree."""
    with Fish.connect("sim:tank", camera_fps=24.0, camera_exposure_s=EXPOSURE_S) as fish:
        fish.upload_reference(records.encode_reference(1.0, np.full(6, 0.05, np.float32)))
        fish.upload_amplitudes(np.full(6, 0.4))
        fish.arm()
        board = fish.sim
        assert board is not None
        armed_us = round(board.time_s * 1e6)
        board.run(0.5)
        watched = Watched(board)
        trial = run_trial(fish, watched).number
    pictures = watched.pictures
    begins = range(1_700_000, round(board.time_s * 1e6) - 6_000_000, FRAME_US)
    on = [lib.blink_on(frame, trial) for frame in range(300)]
    agreeing = [begin for begin in begins if begin > armed_us and _agree(pictures, begin, on)]
    assert len(agreeing) == 1


def _agree(pictures: list[CameraFrame], begin_us: int, on: list[bool]) -> bool:
    shown = [True, *on]  # armed before
    changes = [n - 1 for n in range(1, len(shown)) if shown[n] != shown[n - 1]]
    edges_us = [0, *(begin_us + n * FRAME_US for n in changes)]
    trial = [p for p in pictures if begin_us < p.time_s * 1e6 - 1e4 < begin_us + 5_900_000]
    assert len(trial) > 130
    return all(abs(p.led - lit_part(edges_us, p, EXPOSURE_S)) < 1e-9 for p in trial)


def test_exposure_is_no_longer_than_a_picture_lasts() -> None:
    Wires("tank", 1, camera_fps=200.0)  # with the usual 10 ms, cut to 5
    with pytest.raises(InputError, match="cannot run with these values"):
        Wires("tank", 1, camera_exposure_s=-0.01)


def test_remote_camera_takes_lines_with_more_than_it_needs() -> None:
    line = {"t_board_s": 1.5, "x_m": 0.25, "y_m": -0.01, "heading_rad": 0.1}
    with socket.create_server(("127.0.0.1", 0)) as listener:
        camera = RemoteCamera("127.0.0.1", listener.getsockname()[1])
        peer, _ = listener.accept()
        with peer:
            lines = [line, {**line, "tail_rad": 0.3, "led": 0.5}, {**line, "led": None}]
            assert not camera.computed
            peer.sendall("".join(json.dumps(one) + "\n" for one in lines).encode())
        frames: list[Frame] = []
        deadline = time.monotonic() + 600.0
        while len(frames) < len(lines) and time.monotonic() < deadline:
            frames += camera.frames()
        camera.close()
    assert frames == [Frame(1.5, 0.25, -0.01, 0.1)] * 3
    assert camera.computed  # a simulator's line was among them


@pytest.mark.parametrize("how", ["closes", "resets"])
def test_a_remote_camera_that_hangs_up_is_gone_once_and_after_its_frames(how: str) -> None:
    line = b'{"t_board_s": 1.5, "x_m": 0.25}\n'
    with socket.create_server(("127.0.0.1", 0)) as listener:
        camera = RemoteCamera("127.0.0.1", listener.getsockname()[1])
        peer, _ = listener.accept()
        assert camera.frames() == []
        peer.sendall(line)
        deadline = time.monotonic() + 600.0
        frames: list[Frame] = []
        if how == "resets":
            while not frames and time.monotonic() < deadline:
                frames = camera.frames()
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        peer.close()
        with pytest.raises(CameraGone, match="hung up"):
            while time.monotonic() < deadline:
                frames += camera.frames()
        assert frames == [Frame(1.5, 0.25)]
        assert camera.frames() == camera.frames() == []
        camera.close()
        assert camera.frames() == []
