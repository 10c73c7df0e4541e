"""The flash image on the emulated board, through the host tool: it does what the simulated board
does. Needs the image: make firmware."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tailbeat.app.demo import DemoOptions, run_demo
from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core import reference as references
from tailbeat.core.image import image_remedy
from tailbeat.session.trial import run_trial
from tailbeat.session.trial_camera import default_camera

IMAGE = Path(__file__).parents[2] / "build" / "firmware" / "tailbeat.elf"
START = "from tailbeat.app.cli import main; main()"
BEATS = 3


@pytest.fixture(scope="module")
def image() -> Path:
    if not IMAGE.is_file():
        pytest.fail(f"there is no {IMAGE}: make firmware", pytrace=False)
    return IMAGE


def command(*arguments: str | Path) -> list[str]:
    return [sys.executable, "-c", START, *map(str, arguments)]


def run(*arguments: str | Path) -> dict:
    done = subprocess.run(command(*arguments), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return json.loads(done.stdout)


def session(url: str, seed: int, source: int, trials: int) -> dict[str, object]:
    """Trials with speeds from the camera (0) or uploaded (1), and all that came of them."""
    speed = 0.07 * np.sin(np.linspace(0.2, 2.9, BEATS))
    with Fish.connect(url, seed=seed) as fish:
        for name, value in {"ILC_LEAD": 1, "SPD_SOURCE": source, "DU_MAX_RAD": 0}.items():
            fish.params.set(name, value)
        fish.upload_reference(records.encode_reference(1.0, speed))
        found: dict[str, object] = {"kind": fish.info().board}
        for trial in range(1, trials + 1):
            assert run_trial(fish).end == "complete"
            true = fish.sim.world.true_beats()
            if source == 1:
                fish.upload_speeds(trial, true.astype(np.float32), np.full(BEATS, 1e-3))
            found[f"error {trial}"] = fish.learn(trial).max_abs_error_m_s
            found[f"true {trial}"] = true.tobytes()
            found[f"25 Hz {trial}"] = fish.sim.world.true_speeds_25hz().tobytes()
            found[f"learned {trial}"] = fish.amplitudes().values.tobytes()
        found["time"] = fish.sim.time_s
        found["flash"] = fish.sim.flash
    return found


def test_same_seed_same_run(image: Path) -> None:
    url = f"vboard:{image}"
    first, again = session(url, 5, 0, 1), session(url, 5, 0, 1)
    assert first == again
    assert session(url, 6, 0, 1)["error 1"] != first["error 1"]


def test_time_of_the_board_is_that_of_its_firmware(image: Path) -> None:
    with Fish.connect(f"vboard:{image}") as fish:
        assert fish.clock.now_s() == pytest.approx(fish.sim.board_time_s, abs=1e-3)


def test_power_cycle_keeps_what_is_stored(image: Path) -> None:
    with Fish.connect(f"vboard:{image}") as fish:
        fish.params.set("ILC_GAIN", 5.5)
        fish.params.save()
        fish.params.set("ILC_LEAD", 3)
        fish.sim.world.set_battery_v(7.3)
        fish.sim.world.power_cycle()
        fish.link.run(1.0)
        assert fish.params.get("ILC_GAIN").value == 5.5
        assert fish.params.get("ILC_LEAD").value == 1
        assert fish.status().battery_v == pytest.approx(7.3, abs=0.03)
        assert fish.health()["reset_cause"] == "power"
        assert fish.sim.board_time_s < 5


def test_imu_may_be_unplugged_and_may_be_fast(image: Path) -> None:
    with Fish.connect(f"vboard:{image}") as fish:
        fish.params.set("IMU_BAUD", 460800)
        fish.params.set("IMU_RATE_HZ", 400)
        imu = fish.imu_verdict()
        assert (imu.state, imu.problem.name, imu.rate_hz) == ("streaming", "NONE", 400)
        before = fish.health()
        fish.link.run(2.0)
        after = fish.health()
        assert after["imu_frames"] - before["imu_frames"] == pytest.approx(800, abs=20)
        assert after["imu_crc_failed"] == before["imu_crc_failed"]
        assert after["serial_overruns"] == 0
        fish.sim.world.set_imu(False)
        fish.link.run(0.1)
        before = fish.health()
        fish.link.run(1.0)
        assert fish.health()["imu_frames"] == before["imu_frames"]


def test_info_command(image: Path) -> None:
    found = run("info", "--connect", f"vboard:{image}", "--json")
    assert (found["board"], found["simulated"]) == ("emulated", True)
    assert bytes.fromhex(found["unique_id"])[:8] == b"tailbeat"
    assert found["status"]["state"] == "IDLE"


@pytest.mark.soak
def test_demo_command_tells_all_a_simulator_knows(image: Path, tmp_path: Path) -> None:
    url = f"vboard:{image}"
    given = ("--law", "p", "--trials", "1", "--plant", "thesis", "--seed", "7", "--out", tmp_path)
    found = run("sim", "demo", "--connect", url, *given, "--json")
    assert (found["plant"], found["seed"], found["lead"]) == ("thesis", 7, 0)
    assert found["floor_m_s"] == pytest.approx(0.0008, abs=0.0002)
    trial = found["trials"][1]
    assert trial["true_max_abs_error_m_s"] == pytest.approx(trial["max_abs_error_m_s"], abs=2e-4)
    assert "emulated" in (tmp_path / "report" / "report.html").read_text()
    assert json.loads((tmp_path / "settings.json").read_text())["board"] == "emulated"


def test_a_short_demo_knows_it_is_emulated(image: Path, tmp_path: Path) -> None:
    reference = references.Reference(1.0, references.thesis().speed_m_s[:4], "short")
    options = DemoOptions(
        plant="thesis", trials=1, seed=7, connect=f"vboard:{image}", out=tmp_path / "out"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tailbeat.app.demo.reference.thesis", lambda: reference)
        found = run_demo(options)
    assert (found.plant, found.seed, found.lead) == ("thesis", 7, 0)
    true = found.trials[1].true_max_abs_error_m_s
    assert true == pytest.approx(found.trials[1].max_abs_error_m_s, abs=2e-4)
    assert "emulated" in found.report.read_text()
    assert json.loads((tmp_path / "out" / "settings.json").read_text())["board"] == "emulated"


def test_vboard_command_serves_the_board(image: Path) -> None:
    arguments = ("sim", "board", image, "--json", "--listen", "tcp:127.0.0.1:0", "--seed", "2")
    with subprocess.Popen(command(*arguments), stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            listen = json.loads(server.stdout.readline())["listen"]
            with Fish.connect(listen) as fish:
                assert fish.info().board == "emulated"
                camera = default_camera(fish)
                assert camera is not None
                assert camera.clock == "board"
                camera.close()
        finally:
            server.kill()


def test_vboard_command_without_an_image() -> None:
    done = subprocess.run(
        command("sim", "board", "no-such.elf"), capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert done.stderr == f"tailbeat: there is no flash image no-such.elf. {image_remedy()}\n"
