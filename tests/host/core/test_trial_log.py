"""Trial files, written by the simulated board and read back."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from tailbeat.app.demo import same_bits
from tailbeat.board.fish import Fish
from tailbeat.core import reference
from tailbeat.core.errors import InputError
from tailbeat.core.law import Law
from tailbeat.core.law_memory import first_amplitudes
from tailbeat.core.trial_file import (
    NO_MOTION,
    Trial,
    beats_csv,
    fault_text,
    parse_trial,
    read_trial,
)
from tailbeat.session.outcome import StopKind, StopReason
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport

BEATS = 12


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A complete trial, the same with uploaded speeds behind it, and an aborted one."""
    folder = tmp_path_factory.mktemp("trials")
    with Fish.connect("sim:tank", seed=3, camera_lost=0.05) as fish:
        fish.link.run(9.0)  # until the IMU is set up
        fish.params.set("AMP_MAX_RAD", 0.785)
        fish.upload_reference(reference.trapezoid(0.06, 3, BEATS - 6))
        run_trial(fish)
        whole = fish.pull_trial(1, folder)
        speeds = np.full(BEATS, 0.03, dtype=np.float32)
        speeds[4] = np.nan
        fish.upload_speeds(1, speeds, 0.002)
        (folder / "again").mkdir()
        uploaded = fish.pull_trial(1, folder / "again")
        fish.learn()
        beats_seen: list[int] = []

        def guard(what: object) -> StopReason | None:
            beats_seen.append(getattr(what, "beat", -1))
            return StopReason(StopKind.CALLER, "enough") if max(beats_seen) >= 3 else None

        run_trial(fish, guard=guard)
        cut = fish.pull_trial(2, folder)
    return {"whole": whole, "uploaded": uploaded, "cut": cut}


@pytest.fixture(scope="module")
def trial(files: dict[str, Path]) -> Trial:
    return read_trial(files["whole"])


def test_what_a_file_tells(trial: Trial) -> None:
    assert (trial.number, trial.iteration, trial.end) == (1, 1, "complete")
    assert trial.executed_beats == BEATS
    assert trial.board == "simulated"
    assert trial.problems == []
    assert trial.params["AMP_MAX_RAD"] == np.float32(0.785)
    assert trial.reference_crc == reference.trapezoid(0.06, 3, BEATS - 6).crc
    assert trial.battery_v[0][1] == pytest.approx(8.2, abs=0.05)
    assert len(trial.battery_v) >= BEATS - 1
    wanted = reference.trapezoid(0.06, 3, BEATS - 6).speed_m_s
    assert same_bits(trial.beats.reference_m_s, wanted)
    assert same_bits(trial.beats.amplitude_rad, first_amplitudes(Law(lead_beats=1), wanted))


def test_the_last_record_of_a_beat_counts(files: dict[str, Path]) -> None:
    found = read_trial(files["uploaded"])
    assert np.isnan(found.beats.speed_m_s[4])
    assert found.beats.speed_m_s[5] == np.float32(0.03)
    assert found.beats.sigma_m_s[5] == np.float32(0.002)
    assert len(found.slots.index) > 0
    assert found.end == "complete"


def test_an_aborted_trial_keeps_what_it_swam(files: dict[str, Path]) -> None:
    found = read_trial(files["cut"])
    assert found.end == "aborted:ABORT_COMMAND"
    assert 3 < found.executed_beats < BEATS
    assert np.all(np.isfinite(found.beats.speed_m_s[: found.executed_beats]))
    assert np.all(np.isnan(found.beats.speed_m_s[found.executed_beats :]))
    assert np.isfinite(found.max_abs_error_m_s())


def test_a_wall_leaves_the_last_beats_unmeasured(tmp_path: Path) -> None:
    """In what is told at the end and in the file; how far it swam stays as it is."""
    with Fish.connect("sim:tank", seed=3) as fish:
        fish.params.set("GUARD_BEATS", 2)
        fish.upload_reference(reference.trapezoid(0.06, 3, BEATS - 6))
        near = run_trial(
            fish,
            guard=lambda what: (
                StopReason(StopKind.WALL, "wall") if getattr(what, "beat", -1) == 4 else None
            ),
        )
        found = read_trial(fish.pull_trial(1, tmp_path))
    recorded = near.executed_beats
    assert (near.end, found.end, found.executed_beats) == ("aborted:WALL", "aborted:WALL", recorded)
    assert 5 <= recorded < BEATS
    told = {beat.beat: beat.speed_m_s for beat in near.beats}
    speeds = np.array([told[k] for k in range(recorded)], dtype=np.float32)
    assert np.array_equal(np.isfinite(speeds), np.arange(recorded) < recorded - 2)
    assert np.array_equal(speeds, found.beats.speed_m_s[:recorded], equal_nan=True)
    assert np.all(np.isfinite(found.beats.applied_rad[:recorded]))


def test_a_truncated_file_is_read_as_far_as_it_goes(files: dict[str, Path]) -> None:
    raw = files["whole"].read_bytes()
    begin = len(raw) // 2
    for length in range(begin, len(raw), 97):
        found = parse_trial(raw[:length])
        assert found.number == 1
        assert found.problems
    assert any("cut off" in problem for problem in parse_trial(raw[:-1]).problems)


def test_any_truncation_gives_a_trial_or_a_clear_error(files: dict[str, Path]) -> None:
    raw = files["whole"].read_bytes()
    for length in range(0, len(raw) // 2, 61):
        try:
            found = parse_trial(raw[:length])
        except InputError as error:
            assert error.remedy
        else:
            assert found.problems


@pytest.mark.parametrize("raw", [b"", b"ULog", b"not a ulog file at all", b"ULog" + bytes(100)])
def test_other_files_are_refused(raw: bytes) -> None:
    with pytest.raises(InputError):
        parse_trial(raw)


def test_flipped_bytes_never_crash(files: dict[str, Path]) -> None:
    raw = bytearray(files["whole"].read_bytes())
    random = np.random.default_rng(5)
    for _ in range(150):
        bad = bytearray(raw)
        for at in random.integers(16, len(bad), 3):
            bad[at] ^= int(random.integers(1, 256))
        try:
            parse_trial(bytes(bad))
        except InputError as error:
            assert error.remedy


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no trial file"):
        read_trial(tmp_path / "none.ulg")
    with pytest.raises(InputError, match="cannot read"):
        read_trial(tmp_path)


def test_beats_csv(trial: Trial, tmp_path: Path) -> None:
    beats_csv(trial, tmp_path / "b.csv")
    with (tmp_path / "b.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == BEATS
    assert np.float32(rows[5]["speed_m_s"]) == trial.beats.speed_m_s[5]
    assert float(rows[5]["t_s"]) == 5.5


def test_slots_in_si_units(trial: Trial) -> None:
    table = trial.slots.table()
    assert list(table) == ["t_s", "v_m_s", "sigma_m_s", "samples", "gain_m_s", "turn_rad"]
    assert {len(column) for column in table.values()} == {len(trial.slots.index)}
    assert np.all(np.diff(table["t_s"]) > 0)
    seen = trial.slots.samples > 0
    assert np.array_equal(np.isfinite(table["v_m_s"]), seen)
    assert 0.0005 < np.nanmean(table["sigma_m_s"]) < 0.001
    recorded = (table["t_s"] > 0) & (table["t_s"] < BEATS)
    assert np.all(np.isfinite(table["gain_m_s"][recorded]))


YAW_PER_TAIL = -10.0 / 45.0  # sim/water/plant.h
IMU_LAG_US = 20_000  # of the simulated sensor
SENT_US = 5_500  # a frame's way over the wire is in its time


class TailRecorder(SimTransport):
    """Keeps the simulated tail (rad) at every servo frame, by board time (us)."""

    def __init__(self, board: SimBoard) -> None:
        super().__init__(board)
        self.tail_rad: dict[int, float] = {}

    def wait(self, timeout_s: float) -> None:
        super().wait(min(timeout_s, 0.01))
        truth = self.board.world.truth()
        booted_s = self.board.time_s - self.board.board_time_s
        self.tail_rad[round((truth.time_s - booted_s) * 1e6)] = truth.tail_rad


def test_turns_are_those_of_the_simulated_body(tmp_path: Path) -> None:
    line = TailRecorder(SimBoard("tank", seed=4))
    with Fish(line) as fish:
        fish.link.run(9.0)
        fish.upload_reference(reference.trapezoid(0.06, 2, 2))
        line.tail_rad.clear()
        run_trial(fish)
        trial = read_trial(fish.pull_trial(1, tmp_path))
    table = trial.slots.table()
    assert np.array_equal(np.isfinite(table["turn_rad"]), np.isfinite(table["gain_m_s"]))
    times_us = np.array(sorted(line.tail_rad))
    edges_us = trial.start_us + 100_000 * np.arange(61) - IMU_LAG_US - SENT_US
    assert times_us[0] < edges_us[0]
    assert np.max(np.diff(times_us)) == 20_000
    yaw_rad = YAW_PER_TAIL * np.interp(edges_us, times_us, [line.tail_rad[t] for t in times_us])
    turned_rad = table["turn_rad"][:60]
    assert np.array_equal(trial.slots.index[:60], np.arange(60))
    error_rad = turned_rad - np.diff(yaw_rad)
    assert np.max(np.abs(turned_rad)) > 0.03
    assert np.sqrt(np.mean(error_rad**2)) < 0.005 * np.max(np.abs(turned_rad))
    assert abs(np.sum(error_rad)) < 1e-3


def test_a_file_of_an_older_board_has_no_turns(files: dict[str, Path]) -> None:
    raw = files["whole"].read_bytes()
    known = parse_trial(raw)
    found = parse_trial(raw.replace(b"int16_t turn_100urad", b"int16_t x_older_name"))
    assert np.all(found.slots.turn_100urad == NO_MOTION)
    assert found.slots.turn_100urad.shape == found.slots.index.shape
    assert np.all(np.isnan(found.slots.table()["turn_rad"]))
    assert np.array_equal(found.slots.gain_10um_s, known.slots.gain_10um_s)
    assert np.any(known.slots.turn_100urad != NO_MOTION)


def test_fault_text() -> None:
    assert fault_text(0) == "complete"
    assert fault_text(2) == "aborted:LINK_LOST"
    assert fault_text(21) == "fault:LATE_TICK"
    assert fault_text(999) == "fault:FAULT_999"


def test_a_trial_without_slots_is_a_trial(tmp_path: Path) -> None:
    with Fish.connect("sim:tank?seed=1", camera_fps=0, imu_firmware=0) as fish:
        fish.params.set("IMU_TIMEOUT_S", 0)
        fish.params.set("SPD_SOURCE", 1)
        fish.upload_reference(reference.Reference(1.0, np.full(3, 0.02, np.float32), "short"))
        outcome = run_trial(fish)
        trial = read_trial(fish.pull_trial(outcome.number, tmp_path))
    assert trial.end == "complete"
    assert len(trial.slots.index) == len(trial.slots.table()["turn_rad"]) == 0
