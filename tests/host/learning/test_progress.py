"""tailbeat experiment progress, and what learn and trial pull put into the trial library."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tailbeat.app.cli import run
from tailbeat.board.fish import Fish
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.experiment.library import TrialLibrary
from tailbeat.experiment.store import Kept
from tailbeat.learning.assessment import progress_of, series_of
from tailbeat.learning.fish_model import FishModel, trial_speeds
from tailbeat.learning.identification import Identified
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport

TRIALS = 4
Run = Callable[..., tuple[str, str]]


@pytest.fixture
def tailbeat(capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs a command that must succeed: (stdout, stderr)."""

    def command(*words: str) -> tuple[str, str]:
        assert run(list(words)) == 0
        out, err = capsys.readouterr()
        return out, err

    return command


@pytest.fixture(scope="module")
def board() -> SimBoard:
    return SimBoard("tank")


@pytest.fixture
def connected(board: SimBoard, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: SimTransport(board))


@pytest.fixture(scope="module")
def recorded(board: SimBoard, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the trials of a short reference, learned on the board."""
    from tailbeat.core.reference import from_text

    folder = tmp_path_factory.mktemp("swum")
    csv = folder / "swim.csv"
    csv.write_text("t_s,v_m_s\n0,0\n2,0.06\n8,0.06\n10,0\n")
    with Fish(SimTransport(board)) as fish:
        for name, value in {"AMP_MAX_RAD": 0.75, "ILC_LEAD": 1, "DU_MAX_RAD": 0}.items():
            fish.params.set(name, value)
        fish.upload_reference(from_text(str(csv)))
        for _ in range(TRIALS):
            number = run_trial(fish, None).number
            fish.learn(number)
            fish.pull_trial(number, folder)
    return folder


@pytest.mark.painted
def test_a_folder_of_trials(recorded: Path, tailbeat: Run, tmp_path: Path) -> None:
    png = tmp_path / "p.png"
    out, err = tailbeat(
        "experiment", "progress", "--experiment", str(recorded), "--plot", str(png), "--json"
    )
    found = json.loads(out)
    assert err == ""
    assert [row["trial"] for row in found["trials"]] == list(range(1, TRIALS + 1))
    assert found["trials"][0]["verdict"] == "first"
    worst = [row["max_abs_error_m_s"] for row in found["trials"]]
    assert found["verdict"]["best_max_abs_error_m_s"] == min(worst)
    assert found["visits"] == [TRIALS] * 10
    assert png.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    text, _ = tailbeat("experiment", "progress", "--experiment", str(recorded))
    assert text.splitlines()[0].split() == [
        "trial", "iteration", "max|e|", "mm/s", "RMS", "mm/s", "repeats", "assessment",
    ]  # fmt: skip
    assert f"best: trial {1 + int(np.argmin(worst))}" in text


def test_another_reference_and_a_damaged_file(
    recorded: Path, tailbeat: Run, tmp_path: Path
) -> None:
    raw = tmp_path / "raw"
    raw.mkdir()
    for path in recorded.glob("*.ulg"):
        (raw / path.name).write_bytes(path.read_bytes())
    (raw / "0009.ulg").write_bytes(b"no trial")
    out, err = tailbeat("experiment", "progress", "--experiment", str(tmp_path), "--json")
    assert len(json.loads(out)["trials"]) == TRIALS
    assert err == "tailbeat: 0009.ulg is not a ULog file. Pull the trial again.\n"
    crc = json.loads(out)["reference_crc"]
    same, _ = tailbeat(
        "experiment", "progress", "--experiment", str(tmp_path), "--reference", hex(crc), "--json"
    )
    assert json.loads(same) == json.loads(out)


@pytest.mark.parametrize(
    ("words", "meaning"),
    [
        (["--experiment", "FOLDER", "--reference", "0x1"], "no trial of the reference 0x00000001"),
        (["--experiment", "FOLDER", "--reference", "x"], "'x' is no reference's CRC"),
        (["--experiment", "FOLDER", "--apply"], "there is nothing to apply"),
        (["--experiment", "/none"], "there is no folder"),
    ],
)
def test_what_makes_no_sense(
    recorded: Path, words: list[str], meaning: str, capsys: pytest.CaptureFixture[str]
) -> None:
    line = [str(recorded) if word == "FOLDER" else word for word in words]
    assert run(["experiment", "progress", *line]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("tailbeat: ")
    assert meaning in err
    assert err.count("\n") == 1


@pytest.mark.usefixtures("connected", "recorded")
def test_a_simulated_fish_keeps_nothing_by_itself(
    tailbeat: Run, library_folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    tailbeat("trial", "pull", "--into", str(tmp_path), "--connect", "x")
    assert not library_folder.exists()
    assert run(["experiment", "progress", "--connect", "x"]) == 1
    assert "has no trial library" in capsys.readouterr().err


@pytest.mark.usefixtures("connected", "recorded")
def test_pull_and_learn_fill_the_library(
    tailbeat: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, board: SimBoard
) -> None:
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "book"))
    tailbeat("trial", "pull", "--all", "--into", str(tmp_path), "--connect", "x")
    out, _ = tailbeat("experiment", "progress", "--connect", "x", "--json")
    before = [row["trial"] for row in json.loads(out)["trials"]]
    assert before[-TRIALS:] == list(range(1, TRIALS + 1))
    ran, _ = tailbeat("trial", "run", "--connect", "x", "--json")
    number = json.loads(ran)["number"]
    text, err = tailbeat("learn", "--connect", "x")
    assert err == ""
    head, words = text.splitlines()[:2]
    assert head.startswith(f"learned from trial {number}: ")
    assert words.startswith(("progress: ", "within noise", "the best, but", "worse"))
    out, _ = tailbeat("experiment", "progress", "--connect", "x", "--json")
    rows = json.loads(out)["trials"]
    assert [row["trial"] for row in rows] == [*before, number]
    assert rows[-1]["words"] == words
    book = TrialLibrary(next((tmp_path / "book").iterdir()))
    assert len(book.kept()[0]) == TRIALS + 1


@pytest.mark.usefixtures("connected", "recorded")
def test_learning_does_not_fail_with_the_library(
    tailbeat: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "book").write_text("a file in its place")
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "book"))
    tailbeat("trial", "run", "--connect", "x")
    out, err = tailbeat("learn", "--connect", "x", "--json")
    assert json.loads(out)["verdict"] is None
    assert err.startswith("tailbeat: no assessment of trial ")
    assert "TAILBEAT_LOGBOOK" in err


def test_a_fluctuating_series_gets_a_falling_gain(
    tailbeat: Run, monkeypatch: pytest.MonkeyPatch, recorded: Path
) -> None:
    trial = read_trial(recorded / "0001.ulg")
    shape = np.ones(10, np.float32)

    def made(number: int, worst: float) -> Trial:
        speed = trial.beats.reference_m_s - np.float32(worst) * shape
        beats = replace(trial.beats, speed_m_s=speed, amplitude_rad=shape * number / 100)
        return replace(trial, number=number, beats=replace(beats, applied_rad=beats.amplitude_rad))

    worst = (0.05, 0.02, 0.012, 0.021, 0.010, 0.022, 0.012, 0.02, 0.011)
    trials = [made(at + 1, value) for at, value in enumerate(worst)]
    kept = [Kept(trial, recorded / "0001.ulg") for trial in trials]
    monkeypatch.setattr("tailbeat.app.cli.report.read_trials", lambda folder: (kept, []))
    set_to: dict[str, float] = {}

    class Params:
        def set(self, name: str, value: float) -> SimpleNamespace:
            set_to[name] = value
            return SimpleNamespace(value=value)

    @contextmanager
    def connected(url: str | None) -> Iterator[SimpleNamespace]:
        yield SimpleNamespace(params=Params())

    noted: dict[str, float] = {}
    monkeypatch.setattr("tailbeat.app.cli.report.note_set", lambda _, params: noted.update(params))
    monkeypatch.setattr("tailbeat.app.cli.report.connected", connected)
    out, _ = tailbeat("experiment", "progress", "--experiment", str(recorded), "--apply", "--json")
    found = json.loads(out)
    assert found["fluctuation"] > 1.3
    assert found["fade"] == set_to == found["applied"] == noted
    assert 0 < set_to["ILC_DECR_RATE"] <= 10
    assert set_to["ILC_DECR_FROM"] >= 1
    text, _ = tailbeat("experiment", "progress", "--experiment", str(recorded))
    assert f"ILC_DECR_RATE {set_to['ILC_DECR_RATE']:g}" in text
    assert progress_of(trials).fade is not None
    planned = [replace(trial, input="uploaded") for trial in trials]
    assert progress_of(planned).fade is None  # no gain made those amplitudes
    worse = made(len(trials) + 1, 0.03)
    assert progress_of([*trials, worse]).verdict.kind == "worse"
    assert progress_of([*trials, worse]).fade is None


def at(trial: Trial, number: int, iteration: int, crc: int, limit: float = 0.75) -> Trial:
    params = {**trial.params, "AMP_MAX_RAD": limit}
    return replace(trial, number=number, iteration=iteration, reference_crc=crc, params=params)


@pytest.mark.parametrize(
    ("swims", "numbers"),
    [  # (iteration, reference, AMP_MAX_RAD)
        ([(1, 7, 0.75), (2, 7, 0.75), (2, 7, 0.75), (3, 7, 0.75)], [1, 2, 3, 4]),
        ([(1, 7, 0.75), (2, 7, 0.75), (1, 8, 0.75), (3, 7, 0.75)], [1, 2, 4]),  # put back
        ([(1, 7, 0.75), (2, 7, 0.75), (1, 8, 0.75), (1, 7, 0.75), (2, 7, 0.75)], [4, 5]),
        ([(1, 7, 0.75), (1, 8, 0.75), (1, 7, 0.75)], [3]),
        ([(1, 7, 0.75), (2, 7, 0.75), (1, 7, 0.75)], [3]),  # a new board
        ([(1, 7, 0.75), (2, 7, 0.75), (3, 7, 0.6), (4, 7, 0.6)], [3, 4]),
    ],
)
def test_where_a_series_begins(
    recorded: Path, swims: list[tuple[int, int, float]], numbers: list[int]
) -> None:
    trial = read_trial(recorded / "0001.ulg")
    trials = [at(trial, n + 1, i, crc, most) for n, (i, crc, most) in enumerate(swims)]
    assert [one.number for one in series_of(trials, 7)] == numbers


def identified_by(trials: list[Trial], source: str = "runs") -> Identified:
    model = FishModel(10.0, 0.219, 0.197, 0.3)
    return Identified(
        model, [model], np.diag([0.01, 0.001, 1e-4, 1e-3]), source=source,
        unique_id=trials[0].unique_id, trials=[trial_speeds(trial) for trial in trials],
    )  # fmt: skip


def test_runs_of_an_identification_are_no_series(recorded: Path) -> None:
    trials = [read_trial(path) for path in sorted(recorded.glob("*.ulg"))]
    found = progress_of(trials, identified=identified_by(trials[:2]))
    assert [row.trial for row in found.rows] == list(range(3, TRIALS + 1))
    by_trials = progress_of(trials, identified=identified_by(trials[:2], "trials"))
    assert len(by_trials.rows) == TRIALS


def test_a_row_says_what_was_said_then(recorded: Path) -> None:
    trials = [read_trial(path) for path in sorted(recorded.glob("*.ulg"))]
    known = replace(identified_by(trials), source="trials")
    last = progress_of(trials, identified=known).rows
    then = [progress_of(trials[: n + 1], identified=known).rows[-1] for n in range(TRIALS)]
    assert [row.words for row in last] == [row.words for row in then]


def test_an_experiment_brings_its_fish_and_lists_its_references(
    recorded: Path, tailbeat: Run, tmp_path: Path
) -> None:
    raw = tmp_path / "raw"
    shutil.copytree(recorded, raw)
    trials = [read_trial(path) for path in sorted(recorded.glob("*.ulg"))]
    without, _ = tailbeat("experiment", "progress", "--experiment", str(tmp_path), "--json")
    assert json.loads(without)["floor_m_s"] is None
    identified_by(trials, "trials").save(raw / "identified.json")
    out, _ = tailbeat("experiment", "progress", "--experiment", str(tmp_path), "--json")
    assert json.loads(out)["floor_m_s"] > 0
    listed, _ = tailbeat(
        "experiment", "progress", "--experiment", str(tmp_path), "--reference", "list", "--json"
    )
    [row] = json.loads(listed)["references"]
    assert (row["reference_crc"], row["trials"]) == (trials[0].reference_crc, TRIALS)
    text, _ = tailbeat(
        "experiment", "progress", "--experiment", str(tmp_path), "--reference", "list"
    )
    assert f"{trials[0].reference_crc:#010x}" in text


@pytest.mark.usefixtures("connected", "recorded")
def test_a_discarded_repeat_counts_and_a_spoiled_swim_does_not(
    tailbeat: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "book"))
    tailbeat("trial", "run", "--connect", "x")
    tailbeat("learn", "--connect", "x")
    tailbeat("learn", "--restore-best", "--connect", "x")
    numbers = []
    for words in (["--repeat"], []):
        ran, _ = tailbeat("trial", "run", "--connect", "x", "--json")
        numbers.append(json.loads(ran)["number"])
        tailbeat("trial", "discard", *words, "--connect", "x")
    book = TrialLibrary(next((tmp_path / "book").iterdir()))
    assert [kept.mark for kept in book.kept()[0]] == ["", "", "discarded"]
    assert [trial.trial for trial in book.speeds()][-1] == numbers[0]
    out, _ = tailbeat("experiment", "progress", "--connect", "x", "--json")
    found = json.loads(out)
    assert [row["trial"] for row in found["trials"]][-1] == numbers[0]
    assert found["discarded"] == [numbers[1]]
    text, _ = tailbeat("experiment", "progress", "--connect", "x")
    assert f"discarded, not counted: trial {numbers[1]}" in text
    tailbeat("trial", "pull", "--all", "--into", str(tmp_path), "--connect", "x")
    assert [k.mark for k in book.kept()[0]].count("discarded") == 1


@pytest.mark.usefixtures("connected", "recorded")
def test_a_trial_that_cannot_be_kept_is_discarded_all_the_same(
    tailbeat: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, board: SimBoard
) -> None:
    (tmp_path / "book").write_text("a file in its place")
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "book"))
    tailbeat("trial", "run", "--connect", "x")
    out, err = tailbeat("trial", "discard", "--connect", "x", "--json")
    assert json.loads(out)["pending_trial"] is None
    assert err.startswith("tailbeat: not kept in the trial library: ")


def test_what_excludes_each_other(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["learn", "--restore-best", "--law", "model", "--connect", "sim"]) == 2
    assert "exclude each other" in capsys.readouterr().err
