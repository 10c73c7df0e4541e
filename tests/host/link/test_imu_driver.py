"""The board finds its VN-100 and sets it up, or says why not: against the simulator's model."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError
from tailbeat.link.mavlink import Message
from tailbeat.sim.board import SimBoard, SimTransport

VERDICT_S = 5.0
STREAMING = 3
NONE, STARTING, SILENT, UNREADABLE, NO_REPLY = 0, 1, 2, 3, 4
WRONG_PORT, NOISY, NEEDS_SAVE = 8, 9, 10


@contextmanager
def fish_with(**config: float) -> Iterator[Fish]:
    with Fish(SimTransport(SimBoard("tank", seed=1, boot_s=0.0, **config))) as fish:
        yield fish


def imu_at(fish: Fish, board_s: float) -> Message:
    assert fish.sim is not None
    fish.link.run(max(0.0, board_s - fish.sim.board_time_s))
    return fish.link.request("TAILBEAT_IMU_INFO")


def verdict(fish: Fish, since_s: float = 0.0) -> tuple[Message, float]:
    """The first word other than STARTING, and when it came; within five seconds there is one."""
    assert fish.sim is not None
    while True:
        info = imu_at(fish, fish.sim.board_time_s + 0.05)
        after_s = fish.sim.board_time_s - since_s
        if info.problem != STARTING or after_s > VERDICT_S:
            return info, after_s


def frames(fish: Fish) -> int:
    return int(fish.health()["imu_frames"])


@pytest.mark.parametrize("firmware", [2, 3])
@pytest.mark.parametrize("port", [1, 2])
def test_cold_start(firmware: int, port: int) -> None:
    with fish_with(imu_firmware=firmware, imu_port=port) as fish:
        info, after_s = verdict(fish)
        print(f"firmware {firmware}, port {port}: streams {after_s:.2f} s after the start")
        assert (info.problem, info.state) == (NONE, STREAMING)
        assert after_s <= VERDICT_S
        assert info.model.startswith("VN-100")
        assert info.firmware.startswith(str(firmware))
        assert (info.port, info.baud, info.rate_hz) == (port, 115200, 100)
        before = frames(fish)
        fish.link.run(10.0)
        assert frames(fish) - before == pytest.approx(1000, abs=60)
        assert fish.health()["imu_lost"] == 0


@pytest.mark.parametrize(
    "baud", [9600, 19200, 38400, 57600, 115200, 128000, 230400, 460800, 921600]
)
def test_it_is_found_at_any_baud_rate(baud: int) -> None:
    with fish_with(imu_baud=baud) as fish:
        info, after_s = verdict(fish)
        print(f"{baud} baud: streams {after_s:.2f} s after the start")
        assert (info.problem, info.state, info.baud) == (NONE, STREAMING, 115200)
        assert after_s <= VERDICT_S


@pytest.mark.parametrize("port", [1, 2])
@pytest.mark.parametrize(("rate_hz", "baud"), [(200, 230400), (400, 460800), (400, 921600)])
def test_faster(rate_hz: int, baud: int, port: int) -> None:
    """The port that nobody uses stays at 115200, too slow for it."""
    with fish_with(imu_port=port) as fish:
        verdict(fish)
        assert fish.sim is not None
        fish.params.set("IMU_BAUD", baud)
        fish.params.set("IMU_RATE_HZ", rate_hz)
        info, _ = verdict(fish, fish.sim.board_time_s)
        assert (info.problem, info.state, info.baud, info.rate_hz) == (
            NONE,
            STREAMING,
            baud,
            rate_hz,
        )
        before = frames(fish)
        fish.link.run(5.0)
        assert frames(fish) - before == pytest.approx(5 * rate_hz, rel=0.05)


def test_the_wrong_port_is_named() -> None:
    with fish_with(imu_port=2) as fish:
        verdict(fish)
        assert fish.sim is not None
        fish.params.set("IMU_PORT", 1)
        info, after_s = verdict(fish, fish.sim.board_time_s)
        assert info.problem == WRONG_PORT
        assert after_s <= VERDICT_S
        fish.params.set("IMU_PORT", 0)
        info, _ = verdict(fish, fish.sim.board_time_s)
        assert (info.problem, info.port) == (NONE, 2)


def test_nothing_there() -> None:
    with fish_with(imu_firmware=0) as fish:
        info, after_s = verdict(fish)
        assert info.problem == SILENT
        assert after_s <= VERDICT_S


@pytest.mark.parametrize("port", [1, 2])
def test_the_wrong_port_is_named_at_speed_too(port: int) -> None:
    """The other port still runs at 115200, which is too slow: that is not the line's fault."""
    with fish_with(imu_port=port) as fish:
        verdict(fish)
        assert fish.sim is not None
        fish.params.set("IMU_BAUD", 460800)
        fish.params.set("IMU_RATE_HZ", 400)
        fish.params.set("IMU_PORT", 3 - port)
        info, after_s = verdict(fish, fish.sim.board_time_s)
        assert info.problem == WRONG_PORT
        assert after_s <= VERDICT_S


def test_rate_and_baud_must_fit() -> None:
    with fish_with() as fish:
        for name, value in (("IMU_RATE_HZ", 400), ("IMU_RATE_HZ", 300), ("IMU_BAUD", 100000)):
            with pytest.raises(InputError, match="does not go with"):
                fish.params.set(name, value)
        assert fish.params.get("IMU_RATE_HZ").value == 100


@pytest.mark.parametrize("firmware", [2, 3])
@pytest.mark.parametrize("mount", [1, 2, 3, 4, 5])
def test_the_mounting_takes_effect_after_a_save(mount: int, firmware: int) -> None:
    """Firmware 3 writes -1 as -01.000000."""
    with fish_with(imu_firmware=firmware) as fish:
        verdict(fish)
        assert fish.sim is not None
        fish.params.set("IMU_MOUNT", mount)
        info, _ = verdict(fish, fish.sim.board_time_s)
        assert info.problem == (NONE if mount == 1 else NEEDS_SAVE)
        fish.imu_save()
        fish.link.run(1.0)
        info, after_s = verdict(fish, fish.sim.board_time_s)
        assert (info.problem, info.state) == (NONE, STREAMING)
        assert after_s <= VERDICT_S
        fish.sim.world.power_cycle()
        info, _ = verdict(fish)
        assert (info.problem, info.state) == (NONE, STREAMING)


@pytest.mark.parametrize("bit_errors", [1e-4, 1e-3])
def test_a_noisy_line(bit_errors: float) -> None:
    with fish_with(imu_bit_errors=bit_errors) as fish:
        info, after_s = verdict(fish)
        print(f"bit errors {bit_errors}: problem {info.problem} after {after_s:.2f} s")
        assert info.problem in (NONE, NOISY)
        assert after_s <= VERDICT_S
        fish.link.run(20.0)
        info = fish.link.request("TAILBEAT_IMU_INFO")
        assert info.problem in (NONE, NOISY)
        health = fish.health()
        assert health["imu_implausible"] == 0
        damaged = (int(health["imu_crc_failed"]), int(health["imu_lost"]))
        print(f"  damaged, lost: {damaged}")
        assert damaged[0] > 0


def test_a_line_that_is_all_noise() -> None:
    with fish_with(imu_bit_errors=0.05) as fish:
        info, after_s = verdict(fish)
        assert info.problem in (UNREADABLE, NOISY, NO_REPLY)
        assert after_s <= VERDICT_S


@pytest.mark.parametrize("baud", [115200, 460800])
def test_it_restarts(baud: int) -> None:
    """With its saved settings: at another baud rate, and with ASCII output."""
    with fish_with() as fish:
        verdict(fish)
        fish.params.set("IMU_BAUD", baud)
        assert fish.sim is not None
        verdict(fish, fish.sim.board_time_s)
        fish.sim.world.reboot_imu()
        began_s = fish.sim.board_time_s
        fish.link.run(0.7)
        info, after_s = verdict(fish, began_s)
        print(f"{baud} baud: streams again {after_s:.2f} s after a restart")
        assert (info.problem, info.state, info.baud) == (NONE, STREAMING, baud)
        assert after_s <= VERDICT_S
        assert fish.health()["imu_restarts"] == 1


def test_it_wedges_and_comes_back_with_the_power() -> None:
    with fish_with() as fish:
        verdict(fish)
        assert fish.sim is not None
        fish.sim.world.wedge_imu()
        began_s = fish.sim.board_time_s
        fish.link.run(1.0)
        info, after_s = verdict(fish, began_s)
        assert info.problem == SILENT
        assert after_s <= VERDICT_S
        fish.sim.world.power_cycle()
        info, _ = verdict(fish)
        assert info.problem == NONE
