"""What is derived from an experiment, and that the same files always give the same bytes."""

from __future__ import annotations

import json
import locale
import math
import shutil
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tailbeat.app.demo import DemoOptions, run_demo
from tailbeat.core.errors import InputError
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.experiment.analysis import Analysis, _band, _remarks, analyse, write_analysis
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.trial_rows import TrialHistory, TrialRow, noise_of, rows_of

from .. import made_analyses as made
from ..swum_experiment import BEATS, REFERENCE, swim_experiment, writable

_RECORD = b"\x05\x00D\x00\x00\x00\x00\x00"  # of data, as a log has at its end


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    return swim_experiment(tmp_path_factory.mktemp("analysis"))


@pytest.fixture(scope="module")
def analysis(recorded: Experiment) -> Analysis:
    return analyse(recorded)


@pytest.fixture
def copy(recorded: Experiment, tmp_path: Path) -> Experiment:
    return Experiment(Path(shutil.copytree(recorded.folder, tmp_path / "else" / "where")))


def test_every_swim_is_a_row(analysis: Analysis) -> None:
    rows = analysis.rows
    assert [row.trial for row in rows] == [1, 2, 3, 4, 5, 6]
    assert [row.iteration for row in rows] == [1, 2, 3, 3, 4, 4]
    assert [row.decision for row in rows] == ["keep", "keep", "discard", "keep", "repeat", "keep"]
    assert rows[2].reason == "bumped the wall"
    assert [row.learned for row in rows] == [True, True, False, True, False, True]
    assert [row.repeat_of for row in rows] == [0, 0, 0, 0, 0, 5]  # a discarded one is no first
    assert all(row.complete and row.measured_beats == BEATS for row in rows)
    assert all(row.file == f"{row.trial:04d}.ulg" and row.time for row in rows)
    assert analysis.problems == []


def test_the_numbers_are_those_of_the_logs(recorded: Experiment, analysis: Analysis) -> None:
    for row in analysis.rows:
        trial = read_trial(recorded.raw / row.file)
        error = (REFERENCE.speed_m_s - trial.beats.speed_m_s).astype(np.float64)
        assert row.max_abs_error_m_s == np.abs(error).max()
        assert row.rms_error_m_s == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)
        assert row.distance_m == pytest.approx(np.sum(trial.beats.speed_m_s), rel=1e-6)
        assert row.battery_start_v == trial.battery_v[0][1]
    error_of = {row.trial: row.max_abs_error_m_s for row in analysis.rows}
    assert [row.contraction for row in analysis.rows[3:]] == [
        error_of[4] / error_of[2], pytest.approx(math.nan, nan_ok=True), error_of[6] / error_of[4],
    ]  # fmt: skip
    assert [math.isnan(row.contraction) for row in analysis.rows[:3]] == [True, False, True]
    assert analysis.noise_m_s == pytest.approx(np.std([error_of[5], error_of[6]], ddof=1))
    assert analysis.noise_freedom == 1
    half = 12.7062047364 * np.sqrt(2) * analysis.noise_m_s / error_of[2]
    assert analysis.rows[3].noise_high == pytest.approx(1 + half)
    assert analysis.rows[3].noise_low == pytest.approx(max(0.05, 1 - half))
    assert analysis.start_error_m_s == REFERENCE.speed_m_s.max()


def test_the_battery_is_that_from_before_the_tail_loaded_it(copy: Experiment) -> None:
    """A log begins later; of a trial that no preflight check preceded it is all there is."""
    path = copy.folder / "journal.jsonl"
    entries = [json.loads(line) for line in path.read_text().splitlines()]
    trials = [entry for entry in entries if entry["what"] == "swum"]
    trials[0]["battery_start_v"], trials[1]["battery_start_v"] = 8.31, None
    path.write_text("".join(json.dumps(entry) + "\n" for entry in entries))
    rows = analyse(copy).rows
    assert rows[0].battery_start_v == 8.31
    assert rows[1].battery_start_v == read_trial(copy.raw / rows[1].file).battery_v[0][1]


def test_the_band_is_of_what_counts(analysis: Analysis) -> None:
    band, error_of = analysis.band, {row.trial: row.max_abs_error_m_s for row in analysis.rows}
    assert band.iteration.tolist() == [1, 2, 3, 4]
    assert band.swims.tolist() == [1, 1, 1, 2]
    assert band.max_low_m_s[2] == band.max_median_m_s[2] == band.max_high_m_s[2] == error_of[4]
    low, high = sorted((error_of[5], error_of[6]))
    assert band.max_median_m_s[3] == pytest.approx((low + high) / 2)
    assert band.max_low_m_s[3] == pytest.approx(low + 0.05 * (high - low))
    assert band.rms_high_m_s.shape == (4,)


def test_the_floor_is_the_simulators_without_an_identified_fish(analysis: Analysis) -> None:
    assert analysis.simulated
    assert analysis.floor_by == "simulator"
    for value in (analysis.floor_m_s, analysis.floor_lsq_m_s):
        assert value == float(f"{value:.6g}")  # its further digits are the processor's own
    assert 0 < analysis.floor_m_s <= analysis.floor_lsq_m_s < analysis.start_error_m_s


def test_the_same_bytes_anywhere(
    recorded: Experiment, copy: Experiment, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    first = write_analysis(recorded).read_bytes()
    assert write_analysis(recorded).read_bytes() == first
    monkeypatch.setenv("TZ", "Pacific/Chatham")
    time.tzset()
    for name in ("C", "C.UTF-8"):
        locale.setlocale(locale.LC_ALL, name)
        monkeypatch.chdir(tmp_path)
        assert write_analysis(Experiment(Path("else/where"))).read_bytes() == first
    monkeypatch.undo()
    time.tzset()
    text = first.decode("ascii")
    assert str(recorded.folder.parent) not in text
    document = json.loads(text)
    assert list(document) == sorted(document)
    assert "trials" not in document
    assert document["rows"][0]["straight"] is None or document["rows"][0]["straight"]["source"]


def test_what_is_decided_later_counts(copy: Experiment) -> None:
    copy.journal.add("decided", trial=6, decision="discard", reason="seen on film", file="0006.ulg")
    copy.journal.add("withdrawn", trial=3, file="0003.ulg", reason="")
    found = analyse(copy)
    assert [row.decision for row in found.rows][2] == ""
    assert [row.undecided for row in found.rows] == [False, False, True, False, False, False]
    assert found.band.swims.tolist() == [1, 1, 1, 1]
    copy.journal.add("learned", trial=3, file="0003.ulg", rolled_back=False)
    assert not any(row.undecided for row in analyse(copy).rows)


def test_a_swim_that_the_journal_does_not_know_is_undecided(copy: Experiment) -> None:
    """As one that was pulled by hand into the folder of a day."""
    path = copy.folder / "journal.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(line for line in lines if '"trial": 6' not in line))
    last = analyse(copy).rows[-1]
    assert (last.trial, last.decision, last.undecided, last.counts) == (6, "", True, False)


def made_rows(
    *trials: Trial, decision: str = "keep", learned: bool | None = True
) -> list[TrialRow]:
    """Made of trials that were never in the water."""
    kept = [(Path(f"{at:04d}.ulg"), trial) for at, trial in enumerate(trials)]
    said = TrialHistory(decision=decision, learned=learned, recorded=True)
    return rows_of(kept, {path.name: said for path, _ in kept}, True)


def swum_by(
    number: int, iteration: int, error_m_s: float, by: str = "law", rad: float = 0
) -> Trial:
    trial = made.trial(number, iteration, error_m_s, wanted_rad=rad or 0.1 + 0.01 * iteration)
    return replace(trial, input=by)


def contractions(rows: list[TrialRow]) -> list[float | None]:
    return [None if math.isnan(row.contraction) else round(row.contraction, 6) for row in rows]


def test_contraction_is_of_the_laws_steps_alone() -> None:
    first = swum_by(1, 1, 0.04, "first")
    learned = made_rows(first, swum_by(2, 2, 0.02), swum_by(3, 3, 0.01))
    assert contractions(learned) == [None, 0.5, 0.5]
    for by in ("restored", "uploaded", "first"):
        assert contractions(made_rows(first, swum_by(2, 2, 0.02, by))) == [None, None]
    told = made_rows(first, swum_by(2, 2, 0.02, ""), swum_by(3, 3, 0.04, "", rad=0.11))
    assert contractions(told) == [None, 0.5, None]  # the last swam trial 1's amplitudes
    undecided = made_rows(first, swum_by(2, 2, 0.02), decision="", learned=False)
    assert contractions(undecided) == [None, None]
    repeats = made_rows(first, swum_by(2, 2, 0.02), decision="repeat", learned=False)
    assert contractions(repeats) == [None, None]


def test_a_board_that_began_anew_is_another_epoch() -> None:
    """Its first amplitudes are the old ones: no repeats of trials under other numbers."""
    day = [swum_by(1, 1, 0.04, "first"), swum_by(2, 2, 0.02), swum_by(3, 3, 0.01)]
    anew = [swum_by(1, 1, 0.05, "first"), swum_by(2, 2, 0.03)]
    rows = made_rows(*day, *anew)
    assert [row.epoch for row in rows] == [0, 0, 0, 1, 1]
    assert contractions(rows) == [None, 0.5, 0.5, None, 0.6]
    assert [row.repeat_of for row in rows] == [0] * 5
    band = _band(rows)
    assert band.swims.tolist() == [1, 1]
    assert band.max_median_m_s == pytest.approx([0.05, 0.03])
    assert noise_of(rows, [*day, *anew])[1] == 0
    (told,) = _remarks("", rows, [*day, *anew], None)
    assert told.startswith("the board restarted learning with trial 1 (0003.ulg)")
    at_first = made_rows(day[0], anew[0])
    assert [row.epoch for row in at_first] == [0, 1]
    given_back = made_rows(*day, swum_by(1, 4, 0.01, "restored"))  # another board
    assert [row.epoch for row in given_back] == [0, 0, 0, 0]


def test_a_ratio_never_spans_two_epochs() -> None:
    late = [swum_by(1, 1, 0.04, "first"), swum_by(2, 2, 0.02), swum_by(3, 3, 0.01)]
    rows = made_rows(*late, swum_by(4, 2, 0.005))
    assert [row.epoch for row in rows] == [0, 0, 0, 1]
    assert contractions(rows)[-1] is None


def test_a_damaged_log_is_told_and_the_rest_goes_on(copy: Experiment) -> None:
    path = copy.raw / "0007.ulg"
    copy.add_raw(path.name, b"ULog" + bytes(40))
    found = analyse(copy)
    assert [row.trial for row in found.rows] == [1, 2, 3, 4, 5, 6]
    assert any("0007.ulg" in line for line in found.problems)


def test_a_tampered_trial_is_no_data(copy: Experiment) -> None:
    path = writable(copy.raw / "0004.ulg")
    content = bytearray(path.read_bytes())
    content[-100] ^= 1
    path.write_bytes(content)
    (copy.raw / "0001.ulg").unlink()
    found = analyse(copy)
    assert [row.trial for row in found.rows] == [2, 3, 5, 6]
    assert found.problems == [
        "raw/0001.ulg is missing",
        "raw/0004.ulg is not what it was when it was added",
    ]


def test_a_trial_of_another_reference_is_left_out(copy: Experiment) -> None:
    from tailbeat.core.records import encode_reference

    other = copy.folder.parent / "other"
    shutil.copytree(copy.folder, other)
    writable(other / "raw" / "reference.bin").write_bytes(
        encode_reference(1.0, REFERENCE.speed_m_s * np.float32(0.5))
    )
    (other / "raw" / "SHA256SUMS").unlink()
    with pytest.raises(InputError, match=r"holds no trials that can be read .*0001.ulg"):
        analyse(Experiment(other))


def test_a_log_that_grew_is_one_trial(copy: Experiment) -> None:
    """Speeds that come later are appended to the log: it is kept a second time, longer."""
    short = copy.folder / "short.ulg"
    short.write_bytes((copy.raw / "0006.ulg").read_bytes()[:-40])
    (copy.raw / "0006.ulg").unlink()
    sums = copy.raw / "SHA256SUMS"
    sums.write_text("".join(line for line in sums.open() if "0006.ulg" not in line))
    assert copy.keep_trial(short).name == "0006.ulg"
    grown = copy.folder / "grown.ulg"
    grown.write_bytes(short.read_bytes() + _RECORD)
    assert copy.keep_trial(grown).name == "0006-2.ulg"
    assert copy.keep_trial(short).name == "0006.ulg"
    rows = analyse(copy).rows
    assert [row.file for row in rows] == [*(f"000{n}.ulg" for n in range(1, 6)), "0006-2.ulg"]


def test_folders_without_a_journal(tmp_path: Path) -> None:
    """Made by an older tool: settings had no name then."""
    folder = tmp_path / "demo"
    run_demo(DemoOptions(trials=3, out=folder))
    (folder / "journal.jsonl").unlink()
    settings = json.loads((folder / "settings.json").read_text())
    settings.pop("name")
    (folder / "settings.json").write_text(json.dumps(settings))
    found = analyse(Experiment.open(folder))
    assert [row.decision for row in found.rows] == ["", "", ""]
    assert [row.learned for row in found.rows] == [True, True, False]
    assert found.name == f"{settings['made'][:10]}_sim-tank_thesis_p4-lead1"
    result_floor = found.floor_m_s
    assert 0.005 < result_floor < 0.02
    first = write_analysis(Experiment(folder)).read_bytes()
    moved = Path(shutil.move(folder, tmp_path / "moved"))
    assert write_analysis(Experiment(moved)).read_bytes() == first


def test_no_trials(tmp_path: Path) -> None:
    empty = Experiment.at(tmp_path / "e", "carangi", "thesis", "p4")
    with pytest.raises(InputError, match="holds no trials"):
        analyse(empty)


def test_a_file_that_only_the_journal_knows_is_missed(recorded: Experiment, tmp_path: Path) -> None:
    copy = Experiment(Path(shutil.copytree(recorded.folder, tmp_path / "copy")))
    gone = copy.trial_files()[2].name
    (copy.raw / gone).unlink()
    sums = copy.raw / "SHA256SUMS"
    sums.chmod(0o644)
    kept = [line for line in sums.read_text().splitlines() if not line.endswith(gone)]
    sums.write_text("\n".join(kept) + "\n")
    assert f"raw/{gone} is in the event log and not in the folder" in copy.raw_problems()


def test_what_a_simulated_board_swam_is_simulated_whatever_the_settings_say(
    recorded: Experiment, tmp_path: Path
) -> None:
    copy = Experiment(Path(shutil.copytree(recorded.folder, tmp_path / "copy")))
    copy.write_settings({"simulated": False, "unique_id": "ab" * 16, "conditions": None})
    found = analyse(copy)
    assert found.simulated
    assert found.conditions == {}
    assert sum("is of another fish" in problem for problem in found.problems) == len(found.rows)
