"""Trial files, written by the simulated board and read back."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from tailbeat import laws, reference
from tailbeat.demo import same_bits
from tailbeat.errors import InputError
from tailbeat.fish import Fish
from tailbeat.laws import Law
from tailbeat.trial_log import (
    Trial,
    beats_csv,
    fault_text,
    parse_trial,
    read_trial,
)

BEATS = 12


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A complete trial, the same with uploaded speeds behind it, and an aborted one."""
    folder = tmp_path_factory.mktemp("trials")
    with Fish.connect("sim:tank", seed=3, camera_lost=0.05) as fish:
        fish.link.run(9.0)  # until the IMU is set up
        fish.params.set("AMP_MAX_RAD", 0.785)
        fish.upload_reference(reference.trapezoid(0.06, 3, BEATS - 6))
        fish.run_trial()
        whole = fish.pull_trial(1, folder)
        speeds = np.full(BEATS, 0.03, dtype=np.float32)
        speeds[4] = np.nan
        fish.upload_speeds(1, speeds, 0.002)
        (folder / "again").mkdir()
        uploaded = fish.pull_trial(1, folder / "again")
        fish.learn()
        beats_seen: list[int] = []

        def guard(what: object) -> str | None:
            beats_seen.append(getattr(what, "beat", -1))
            return "enough" if max(beats_seen) >= 3 else None

        fish.run_trial(guard=guard)
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
    assert same_bits(trial.beats.amplitude_rad, laws.first(Law(), wanted))


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
    with pytest.raises(InputError, match="cannot read"):
        read_trial(tmp_path / "none.ulg")


def test_beats_csv(trial: Trial, tmp_path: Path) -> None:
    beats_csv(trial, tmp_path / "b.csv")
    with (tmp_path / "b.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == BEATS
    assert np.float32(rows[5]["speed_m_s"]) == trial.beats.speed_m_s[5]
    assert float(rows[5]["t_s"]) == 5.5


def test_slots_in_si_units(trial: Trial) -> None:
    table = trial.slots.table()
    assert list(table) == ["t_s", "v_m_s", "sigma_m_s", "samples", "gain_m_s"]
    assert {len(column) for column in table.values()} == {len(trial.slots.index)}
    assert np.all(np.diff(table["t_s"]) > 0)
    seen = trial.slots.samples > 0
    assert np.array_equal(np.isfinite(table["v_m_s"]), seen)
    assert 0.0005 < np.nanmean(table["sigma_m_s"]) < 0.001
    swum = (table["t_s"] > 0) & (table["t_s"] < BEATS)
    assert np.all(np.isfinite(table["gain_m_s"][swum]))


def test_fault_text() -> None:
    assert fault_text(0) == "complete"
    assert fault_text(2) == "aborted:LINK_LOST"
    assert fault_text(21) == "fault:LATE_TICK"
    assert fault_text(999) == "fault:FAULT_999"
