"""The IMU's calibration by hand turns, with a simulated hand and a sensor whose registers count."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tailbeat.app.cli import run
from tailbeat.app.cli.imu_calibration import SCALE_PARAMETER
from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, Refused
from tailbeat.link.messages import ImuFrame
from tailbeat.sensors.vn100.calibration import (
    MOUNTS,
    SCALE_SD_MAX,
    ImuCalibration,
    Recording,
    calibrate,
    missing,
    recorded,
)
from tailbeat.sim.hand import Hand

FLAWS = {
    "imu_rate_scale": 1e-3, "imu_accel_scale": 1e-3, "imu_misaligned_rad": 1e-3,
    "tremor_rad": 1e-3,
}  # fmt: skip
URL = "sim:tank?" + "&".join(f"{name}={value}" for name, value in FLAWS.items())
RATE_HZ = 100


def turned(fish: Fish) -> list[ImuFrame]:
    """Until enough is known."""
    assert fish.sim is not None
    found, hand, kept = Recording(), Hand(fish.sim.world), []
    with closing(fish.imu_frames()) as frames:
        for frame in frames:
            hand.follow(frame.time_s)
            kept.append(frame)
            if found.add(frame) and not missing(found):
                break
    return kept


@pytest.fixture(scope="module")
def frames() -> list[ImuFrame]:
    with Fish.connect(URL, seed=3) as fish:
        fish.imu_verdict()
        return turned(fish)


def off(found: ImuCalibration) -> float:
    """The largest error of a scale or an axis."""
    return float(np.abs(found.rate - np.eye(3)).max())


def uneven(found: ImuCalibration) -> float:
    """Of the accelerometers; the size of gravity here, which nobody knows, apart."""
    return float(np.abs(found.accel - np.eye(3) * np.trace(found.accel) / 3).max())


@pytest.mark.parametrize("mount", [0, 4])
def test_what_is_written_into_the_imu_counts(mount: int) -> None:
    """In the sensor's own axes: with a mounting the rows are turned with it."""
    with Fish.connect(URL, seed=11) as fish:
        fish.imu_verdict()
        if mount:
            fish.params.set("IMU_MOUNT", mount)
            fish.imu_verdict()
            fish.imu_save()
            fish.imu_verdict()
        before = calibrate(recorded(turned(fish)))
        fish.imu_calibrate(before.rows(MOUNTS[mount]))
        assert fish.imu_verdict().problem.well
        after = calibrate(recorded(turned(fish)))
    assert off(before) > 2e-3
    assert off(after) < 5e-4
    assert np.abs(after.scale_error).max() < 5 * SCALE_SD_MAX
    assert uneven(after) < 3e-4 < uneven(before)


def test_the_command(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert run(["board", "imu", "calibrate", "--connect", f"{URL}&seed=3", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["written"] and found["rests"] <= 20
    assert max(found["scale_sd"]) <= SCALE_SD_MAX
    assert found["imu_scale_sd"] == 2e-4
    assert run(["board", "imu", "calibrate", "--connect", f"{URL}&seed=3", "--dry-run"]) == 0
    out, err = capsys.readouterr()
    assert out.count("\n") == 2 and out.endswith("nothing was changed\n") and err == ""
    assert run(["board", "imu", "calibrate", "--connect", URL, "--undo"]) == 0
    assert SCALE_PARAMETER in capsys.readouterr().out


def test_from_a_recording(
    frames: list[ImuFrame], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    table = tmp_path / "turns.csv"
    names = [*(f"accel_{a}_m_s2" for a in "xyz"), *(f"rate_{a}_rad_s" for a in "xyz")]
    lines = [",".join(["sequence", "t_s", *names, "yaw_deg", "pitch_deg", "roll_deg"])]
    for frame in frames:
        values = (*frame.accel_m_s2, *frame.rate_rad_s, *frame.ypr_deg)
        lines.append(f"{frame.sequence},{frame.time_s:.6f}," + ",".join(f"{v:.9g}" for v in values))
    table.write_text("\n".join(lines) + "\n")
    command = ["board", "imu", "calibrate", "--connect", "sim:", "--dry-run", "--json"]
    assert run([*command, "--recording", str(table)]) == 0
    read = json.loads(capsys.readouterr().out)
    known = calibrate(recorded(frames))
    np.testing.assert_allclose(read["rate_matrix"], known.rate, atol=1e-6)
    table.write_text("a,b\n1,2\n")
    assert run([*command, "--recording", str(table)]) == 1
    assert "board imu record" in json.loads(capsys.readouterr().out)["error"]["remedy"]


def test_it_says_what_to_do(frames: list[ImuFrame]) -> None:
    """Sides first, then turns; every one of them until nothing is left."""
    found, told = Recording(), []
    for frame in frames:
        if found.add(frame):
            told.append(missing(found))
    assert told[0] == "lay it right side down"
    assert any("quarter turn" in words or "whole turn" in words for words in told)
    assert told[-1] == "" and all(told[:-1])
    assert found.sides == {"+x", "-x", "+y", "-y", "+z", "-z"}


def test_too_little_is_refused(frames: list[ImuFrame]) -> None:
    with pytest.raises(InputError, match="at rest 0 times of at least 8"):
        calibrate(Recording())
    with pytest.raises(InputError, match="hold it still for 3 s"):
        calibrate(recorded(frames[: 20 * RATE_HZ]))


def test_turns_that_nobody_heard_of_are_found_out(frames: list[ImuFrame]) -> None:
    """A gyroscope that slips for a second contradicts gravity; a gap in the frames ends what was
    known; a few lost frames do not matter."""
    slipped = [
        replace(frame, rate_rad_s=(0.0, 0.0, 0.0)) if 1250 < i < 1350 else frame
        for i, frame in enumerate(frames)
    ]
    with pytest.raises(InputError, match="contradict each other"):
        calibrate(recorded(slipped))
    middle = len(frames) // 2
    assert len(recorded(frames[:middle] + frames[middle + 50 :]).rests) < 10
    thinned = [frame for i, frame in enumerate(frames) if i % 97]
    few, all_of = calibrate(recorded(thinned)), calibrate(recorded(frames))
    assert np.all(np.abs(few.scale_error - all_of.scale_error) < 4 * few.scale_sd)


def test_senseless_rows_are_refused() -> None:
    with Fish.connect("sim:") as fish:
        fish.imu_verdict()
        with pytest.raises(Refused):
            fish.imu_calibrate(np.full((6, 3), 3.0))
