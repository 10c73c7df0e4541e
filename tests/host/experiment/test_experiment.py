"""Experiment folders and exports."""

from __future__ import annotations

import csv
import hashlib
import shutil
import stat
import subprocess
from datetime import datetime
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.io import loadmat

from tailbeat.app.demo import DemoOptions, run_demo
from tailbeat.core import reference
from tailbeat.core.errors import InputError
from tailbeat.experiment.export import export
from tailbeat.experiment.folder import Experiment, list_experiments

NOON = datetime(2026, 5, 4, 12, 0, 0)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An experiment with two simulated trials."""
    folder = tmp_path_factory.mktemp("demo") / "series"
    run_demo(DemoOptions(trials=2, out=folder))
    return folder


def make(root: Path) -> Experiment:
    return Experiment.new(root, "carl the fish", "thesis", "p4-lead1", NOON)


def test_names_count_up(tmp_path: Path) -> None:
    names = [make(tmp_path).name for _ in range(3)]
    assert names == [f"2026-05-04_carl-the-fish_thesis_p4-lead1_{n:02d}" for n in (1, 2, 3)]
    assert [e.name for e in list_experiments(tmp_path)] == names
    assert list_experiments(tmp_path / "none") == []


def test_names_cannot_leave_the_root(tmp_path: Path) -> None:
    made = Experiment.new(tmp_path, "../../x", "a/b", "", NOON)
    assert made.folder.parent == tmp_path
    assert made.name == "2026-05-04_x_a-b_x_01"


def test_raw_files_are_read_only_and_listed(tmp_path: Path) -> None:
    made = make(tmp_path)
    path = made.add_raw("0001.ulg", b"swim")
    assert stat.S_IMODE(path.stat().st_mode) == 0o444
    sums = (made.raw / "SHA256SUMS").read_text()
    assert sums == f"{hashlib.sha256(b'swim').hexdigest()}  0001.ulg\n"
    made.add_raw("0001.ulg", b"swim")
    assert (made.raw / "SHA256SUMS").read_text() == sums
    with pytest.raises(InputError, match="other content"):
        made.add_raw("0001.ulg", b"another")
    assert path.read_bytes() == b"swim"


def test_damage_is_found(tmp_path: Path) -> None:
    made = make(tmp_path)
    for name in ("a", "b", "c"):
        made.add_raw(name, name.encode())
    (made.raw / "a").chmod(0o644)
    (made.raw / "a").write_bytes(b"x")
    (made.raw / "b").unlink()
    assert made.damaged() == ["a", "b"]


def test_notes_have_the_time(tmp_path: Path) -> None:
    made = make(tmp_path)
    made.note("water 22 °C ", NOON)
    made.note("second", NOON)
    assert "- **2026-05-04 12:00:00** water 22 °C\n" in made.notes()
    assert made.notes().index("water") < made.notes().index("second")


def test_settings_add_up(tmp_path: Path) -> None:
    made = make(tmp_path)
    made.write_settings({"params": {"ILC_GAIN": 4.0}})
    assert made.settings()["params"] == {"ILC_GAIN": 4.0}
    assert made.settings()["fish"] == "carl the fish"
    assert "tailbeat" in made.settings()["tool"]


def test_only_an_experiment_opens(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is no experiment"):
        Experiment.open(tmp_path)
    made = make(tmp_path)
    assert Experiment.open(made.folder) == made
    with pytest.raises(InputError, match="already holds"):
        Experiment.at(made.folder, "a", "b", "c")


def test_clear_leaves_other_files(tmp_path: Path) -> None:
    made = make(tmp_path)
    made.add_raw("0001.ulg", b"swim")
    (made.folder / "thoughts.txt").write_text("mine")
    made.clear()
    assert [path.name for path in made.folder.iterdir()] == ["thoughts.txt"]


def test_export_without_trials_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no trials"):
        export(make(tmp_path))


def test_unknown_format(recorded: Path) -> None:
    with pytest.raises(InputError, match="no format xls"):
        export(Experiment.open(recorded), ["xls"])


def test_exports_agree(recorded: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(recorded, copy)
    files = {path.name: path for path in export(Experiment.open(copy))}
    assert set(files) == {
        "trials.csv", "beats.csv", "slots.csv", "trials.mat",
        "beats.parquet", "slots.parquet", "trials.parquet",
    }  # fmt: skip
    with files["beats.csv"].open() as file:
        rows = list(csv.DictReader(file))
    matrices = loadmat(files["trials.mat"])
    table = pq.read_table(files["beats.parquet"]).to_pydict()
    assert len(rows) == 80
    assert matrices["speed_m_s"].shape == (2, 40)
    from_csv = np.array([float(row["speed_m_s"]) for row in rows], dtype=np.float32)
    assert from_csv.tobytes() == np.array(table["speed_m_s"], dtype=np.float32).tobytes()
    np.testing.assert_array_equal(matrices["speed_m_s"].ravel(), from_csv.astype(np.float64))
    wanted = [float(row["reference_m_s"]) for row in rows[:40]]
    np.testing.assert_array_equal(np.array(wanted, np.float32), reference.thesis().speed_m_s)


MATLAB_KEYWORDS = frozenset(
    ["break", "case", "catch", "classdef", "continue", "else", "elseif", "end", "for", "function",
     "global", "if", "otherwise", "parfor", "persistent", "return", "spmd", "switch", "try",
     "while"]
)  # fmt: skip


def test_matlab_names_and_units(recorded: Path, tmp_path: Path) -> None:
    (path,) = export(Experiment.open(recorded), ["mat"], tmp_path)
    content = {k: v for k, v in loadmat(path).items() if not k.startswith("__")}
    assert not MATLAB_KEYWORDS & set(content)
    assert [str(cell[0]) for cell in content["trial_end"][:, 0]] == ["complete", "complete"]
    units = content.pop("units")
    named = {name: str(units[name][0, 0][0]) for name in units.dtype.names}
    assert set(named) < set(content)
    assert named["speed_m_s"] == "m/s" and named["amplitude_rad"] == "rad"
    assert {len(array) for array in content.values()} == {2}  # one row per trial, of all


def test_parquet_has_units_in_its_schema(recorded: Path, tmp_path: Path) -> None:
    files = export(Experiment.open(recorded), ["parquet"], tmp_path)
    for path in files:
        for field in pq.read_schema(path):
            unit = (field.metadata or {}).get(b"unit", b"").decode()
            assert bool(unit) == field.name.endswith(("_m", "_s", "_rad", "_v")), field.name
    beats = pq.read_schema(tmp_path / "beats.parquet")
    assert beats.field("speed_m_s").metadata == {b"unit": b"m/s"}


def test_damaged_settings_are_told(tmp_path: Path) -> None:
    experiment = Experiment.at(tmp_path / "e", "carangi", "thesis", "p4")
    for text in ("{", "[]"):
        (experiment.folder / "settings.json").write_text(text)
        with pytest.raises(InputError, match="is damaged"):
            experiment.settings()


def test_a_raw_file_whose_sum_was_not_listed_is_listed_next_time(tmp_path: Path) -> None:
    experiment = Experiment.at(tmp_path / "e", "carangi", "thesis", "p4")
    path = experiment.add_raw("0001.ulg", b"trial")
    sums = experiment.raw / "SHA256SUMS"
    listed = sums.read_text()
    sums.write_text("")  # as if the power had gone between the file and its sum
    assert experiment.add_raw("0001.ulg", b"trial") == path
    assert experiment.add_raw("0001.ulg", b"trial") == path
    assert sums.read_text() == listed


def test_a_number_that_is_taken_gets_another_name(tmp_path: Path, recorded: Path) -> None:
    """A board whose storage was made anew counts from 1 again."""
    experiment = Experiment.at(tmp_path / "e", "carangi", "thesis", "p4")
    first, second = recorded / "raw" / "0001.ulg", tmp_path / "other.ulg"
    assert experiment.keep_trial(first).name == "0001.ulg"
    assert experiment.keep_trial(first).name == "0001.ulg"
    content = first.read_bytes()
    second.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    assert experiment.keep_trial(second).name == "0001-2.ulg"
    assert experiment.keep_trial(second).name == "0001-2.ulg"
    assert experiment.keep_trial(recorded / "raw" / "0002.ulg").name == "0002.ulg"
    assert [p.name for p in experiment.trial_files()] == ["0001.ulg", "0001-2.ulg", "0002.ulg"]
    experiment.journal.add("swum", trial=2, file="0002.ulg")
    experiment.journal.add("swum", trial=1, file="raw/0001-2.ulg")
    assert [p.name for p in experiment.trial_files()] == ["0001.ulg", "0002.ulg", "0001-2.ulg"]
    assert stat.S_IMODE((experiment.raw / "0001-2.ulg").stat().st_mode) == 0o444
    assert experiment.raw_problems() == []
    with pytest.raises(InputError, match="not a ULog file"):
        experiment.keep_trial(recorded / "settings.json")


def test_the_sums_are_for_sha256sum(tmp_path: Path) -> None:
    made = make(tmp_path)
    for name in ("0001.ulg", "with space.bin"):
        made.add_raw(name, name.encode())
    command = ["sha256sum", "--strict", "-c", "SHA256SUMS"]
    done = subprocess.run(command, cwd=made.raw, capture_output=True, check=True, text=True)
    assert done.stdout == "0001.ulg: OK\nwith space.bin: OK\n"


def test_a_full_disk_is_told_and_the_trial_can_be_kept_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = make(tmp_path)
    made.add_raw("0001.ulg", b"swim")

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tailbeat.core.files.os.fsync", full)
    for write in (
        lambda: made.add_raw("0002.ulg", b"swim"),
        lambda: made.write_settings({"fish": "x"}),
        lambda: made.note("x"),
    ):
        with pytest.raises(InputError, match=r"No space left.*Make room"):
            write()
    monkeypatch.undo()
    assert made.settings()["fish"] == "carl the fish"
    assert sorted(p.name for p in made.raw.iterdir()) == ["0001.ulg", "SHA256SUMS"]
    assert made.journal.entries() == []
    made.add_raw("0002.ulg", b"swim")
    assert made.raw_problems() == []


def test_what_nobody_added_is_told(tmp_path: Path) -> None:
    made = make(tmp_path)
    (made.raw / "0009.ulg").write_bytes(b"by hand")
    assert made.raw_problems() == ["raw/0009.ulg is not listed in SHA256SUMS"]
    made.add_raw("0009.ulg", b"by hand")
    assert made.raw_problems() == []


def test_a_listed_sum_is_never_replaced(tmp_path: Path) -> None:
    made = make(tmp_path)
    path = made.add_raw("0001.ulg", b"swim")
    path.unlink()
    with pytest.raises(InputError, match="is not what SHA256SUMS says"):
        made.add_raw("0001.ulg", b"another")
