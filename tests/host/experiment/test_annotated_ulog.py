"""Logs with what only the host knows: read by pyulog, and the same trial to the tool."""

from __future__ import annotations

import shutil
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pyulog import ULog

from tailbeat.core import ulog
from tailbeat.core.speed_estimate import recompute_beats
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.experiment.annotated_ulog import annotate
from tailbeat.experiment.export import export
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.units import unit_of
from tailbeat.experiment.wall_clock import BY_HOST, WHEN_STORED, TrialStart
from tailbeat.link.params import known_parameters

from ..swum_experiment import swim_experiment

START = TrialStart(1_777_888_999_123_456_000, 7200, BY_HOST)
OLD = Path(__file__).parents[2] / "data" / "written_by_0bf270a" / "trials" / "0016.ulg"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    return swim_experiment(tmp_path_factory.mktemp("ulog"))


def same(one: Trial, other: Trial) -> bool:
    """All that a trial tells; of slots without samples the speed tells nothing."""
    assert one.slots.samples.tobytes() == other.slots.samples.tobytes()
    for name, column in one.slots.table().items():
        np.testing.assert_array_equal(column, other.slots.table()[name])
    for name, column in one.beats.table().items():
        np.testing.assert_array_equal(column, other.beats.table()[name])
    rest = {"slots": one.slots, "beats": one.beats}
    return one == replace(other, **rest)


@pytest.fixture(params=["new", "old"])
def log(request: pytest.FixtureRequest, recorded: Experiment) -> Path:
    return OLD if request.param == "old" else recorded.raw / "0002.ulg"


def test_pyulog_reads_units_defaults_and_time(log: Path, tmp_path: Path) -> None:
    trial = read_trial(log)
    path = tmp_path / "0002.ulg"
    path.write_bytes(annotate(log.read_bytes(), trial, START))
    read = ULog(str(path))
    assert not read.file_corruption
    info = read.msg_info_dict
    assert info["unit_beat_speed_m_s"] == info["unit_slot_si_v_m_s"] == "m/s"
    assert info["unit_slot_turn_100urad"] == "100 urad"
    assert info["unit_AMP_MAX_RAD"] == "rad"
    assert info["start_utc_us"] == START.utc_ns // 1000
    assert info["time_ref_utc"] == 7200
    defaults = read.get_default_parameters(0)
    assert set(defaults) == set(read.initial_parameters)
    assert defaults["AMP_MAX_RAD"] == known_parameters()["AMP_MAX_RAD"].default
    clock = read.get_dataset("clock").data
    assert clock["timestamp"][0] == trial.start_us
    assert clock["time_utc_usec"][0] == START.utc_ns // 1000


def test_empty_slots_are_nan(recorded: Experiment, tmp_path: Path) -> None:
    path = recorded.raw / "0002.ulg"
    trial = read_trial(path)
    (tmp_path / "a.ulg").write_bytes(annotate(path.read_bytes(), trial, START))
    read = ULog(str(tmp_path / "a.ulg"))
    slot, si = read.get_dataset("slot").data, read.get_dataset("slot_si").data
    empty = slot["samples"] == 0
    assert 0 < empty.sum() < len(empty)
    assert np.isnan(slot["speed_m_s"]).tolist() == empty.tolist()
    table = trial.slots.table()
    for name in ("v_m_s", "sigma_m_s", "gain_m_s", "turn_rad"):
        np.testing.assert_array_equal(si[name], table[name].astype(np.float32))
    np.testing.assert_allclose(si["timestamp"], trial.start_us + table["t_s"] * 1e6, atol=1)


def test_the_tool_reads_the_same_trial(log: Path, tmp_path: Path) -> None:
    trial = read_trial(log)
    (tmp_path / log.name).write_bytes(annotate(log.read_bytes(), trial, START))
    again = read_trial(tmp_path / log.name)
    assert same(trial, again)
    for before, after in zip(recompute_beats(trial), recompute_beats(again), strict=True):
        np.testing.assert_array_equal(before, after)


def test_a_log_that_was_cut_off(recorded: Experiment) -> None:
    whole = (recorded.raw / "0002.ulg").read_bytes()
    for length in range(ulog.HEADER_BYTES, len(whole), 997):
        cut = whole[:length]
        held = b"".join(one.content() for one in ulog.records(cut))
        assert cut.startswith(whole[: ulog.HEADER_BYTES] + held)
        made = annotate(cut, read_trial(recorded.raw / "0002.ulg"), START)
        assert sum(1 for _ in ulog.records(made)) > sum(1 for _ in ulog.records(cut))


def test_no_time_is_written_that_no_host_gave(recorded: Experiment) -> None:
    path = recorded.raw / "0001.ulg"
    made = annotate(path.read_bytes(), read_trial(path), replace(START, source=WHEN_STORED))
    assert b"start_utc_us" not in made
    kinds = [
        struct.unpack_from("<H", one.body)[0] for one in ulog.records(made) if one.kind == b"D"
    ]
    assert 100 in kinds and 101 not in kinds


def test_the_export_writes_one_file_per_trial(recorded: Experiment, tmp_path: Path) -> None:
    copy = Experiment(Path(shutil.copytree(recorded.folder, tmp_path / "copy")))
    before = {path.name: path.read_bytes() for path in copy.trial_files()}
    files = export(copy, ["ulog"])
    assert [path.relative_to(copy.folder).as_posix() for path in files] == [
        f"export/ulog/{number:04d}.ulg" for number in range(1, 7)
    ]
    assert {path.name: path.read_bytes() for path in copy.trial_files()} == before
    first = [path.read_bytes() for path in files]
    assert [path.read_bytes() for path in export(copy, ["ulog"])] == first


def test_units_are_in_the_names() -> None:
    names = ("speed_m_s", "curvature_1_m", "sigma_10um_s", "applied_rad", "t_s", "samples", "end")
    assert [unit_of(name) for name in names] == ["m/s", "1/m", "10 um/s", "rad", "s", "", ""]
