"""An experiment done again from its raw files: the same bits, and every changed one is found."""

from __future__ import annotations

import json
import random
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tailbeat.errors import InputError
from tailbeat.experiment import Experiment
from tailbeat.experiment.analysis import write_analysis
from tailbeat.experiment.current import make
from tailbeat.experiment.replay import Replay, replay, write_redo
from tailbeat.fish import Fish

from .swum_experiment import BEATS, REFERENCE, swim_experiment, writable


@pytest.fixture(scope="module")
def swum(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    experiment = swim_experiment(tmp_path_factory.mktemp("replay"))
    write_analysis(experiment)
    return experiment


@pytest.fixture
def copy(swum: Experiment, tmp_path: Path) -> Experiment:
    return Experiment(Path(shutil.copytree(swum.folder, tmp_path / "copy")))


def again(experiment: Experiment, tmp_path: Path) -> Replay:
    return replay(experiment, tmp_path / "scratch")


def test_everything_comes_out_the_same(swum: Experiment, tmp_path: Path) -> None:
    before = {path: path.read_bytes() for path in swum.folder.rglob("*") if path.is_file()}
    found = again(swum, tmp_path)
    assert found == Replay(
        raw=7,
        recomputed=[1, 2, 3, 4, 5, 6],
        not_recomputed=[],
        learned=[1, 2, 4, 6],  # 3 was discarded, 5 a repeat; 6 by the board's state
        figures=["analysis.json"],
        different=[],
    )
    assert found.identical
    assert {p: p.read_bytes() for p in swum.folder.rglob("*") if p.is_file()} == before


@pytest.mark.parametrize(
    "params",
    [
        {"LAW_KIND": 1.0},
        {"LAW_KIND": 2.0, "LAW_WINDOW": 3.0},
        {"LAW_FADE": 1.0, "LAW_FADE_FROM": 1.0},
        {"LAW_GAIN": 12.0, "ROLLBACK_RATIO": 1.01, "LAW_LEAD": 8.0, "DU_MAX_RAD": 0.0},
    ],
)
def test_every_law_is_learned_again(params: dict[str, float], tmp_path: Path) -> None:
    """Also what the law looks back on, beats that fade, and roll-backs."""
    experiment = swim_experiment(tmp_path, **params)
    found = again(experiment, tmp_path)
    assert found.learned == [1, 2, 4, 6]
    assert found.identical
    rolled_back = [e["rolled_back"] for e in experiment.journal.entries("learned")]
    assert any(rolled_back) == ("ROLLBACK_RATIO" in params)


def test_one_flipped_bit_in_any_raw_file_is_found(copy: Experiment, tmp_path: Path) -> None:
    dice = random.Random(3)
    for name in sorted(copy.sums()):
        path = writable(copy.raw / name)
        content = path.read_bytes()
        at, bit = dice.randrange(len(content)), 1 << dice.randrange(8)
        path.write_bytes(content[:at] + bytes([content[at] ^ bit]) + content[at + 1 :])
        found = again(copy, tmp_path / name)
        told = f"raw/{name} is not what it was when it was added"
        assert told in found.different, (name, at, bit)
        path.write_bytes(content)
    assert again(copy, tmp_path / "last").identical


def test_one_flipped_bit_in_the_analysis_is_found(copy: Experiment, tmp_path: Path) -> None:
    path = copy.folder / "analysis.json"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    assert any(line.startswith("analysis.json") for line in again(copy, tmp_path).different)


def test_a_missing_and_a_foreign_raw_file_are_found(copy: Experiment, tmp_path: Path) -> None:
    (copy.raw / "0002.ulg").unlink()
    (copy.raw / "0099.ulg").write_bytes(b"whatever")
    found = again(copy, tmp_path).different
    assert "raw/0002.ulg is missing" in found
    assert "raw/0099.ulg is not listed in SHA256SUMS" in found


def test_learning_that_never_happened_is_found(copy: Experiment, tmp_path: Path) -> None:
    """A journal that says otherwise: the law would have given trial 6 other amplitudes."""
    copy.journal.add("learned", trial=5, rolled_back=False)
    assert "trial 6 did not swim what the law makes of trial 5" in again(copy, tmp_path).different


def test_a_board_state_of_another_history_is_found(copy: Experiment, tmp_path: Path) -> None:
    from tailbeat.experiment import board

    state = board.held_state(copy)
    assert state is not None
    assert state.learned is not None
    learned = bytearray(state.learned)
    path = copy.folder / "board" / "state.json"
    document = json.loads(path.read_text())
    document["iteration"] += 1
    path.write_text(json.dumps(document))
    assert any("state.json is damaged" in line for line in again(copy, tmp_path).different)
    other = replace(state, learned=bytes(learned[:40] + bytes([learned[40] ^ 1]) + learned[41:]))
    assert board._document(other)["sha256"] != board._document(state)["sha256"]


def test_uploaded_speeds_are_told_not_counted(tmp_path: Path) -> None:
    with Fish.connect("sim:tank?seed=1") as fish:
        fish.params.set("SPD_SOURCE", 1)
        fish.upload_reference(REFERENCE)
        experiment = make(fish, tmp_path, REFERENCE)
        for _ in range(2):
            fish.arm()
            number = fish.run_trial().number
            before = fish.pull_trial(number, tmp_path)
            kept = experiment.keep_trial(before)
            before.unlink()
            fish.upload_speeds(number, REFERENCE.speed_m_s * 0.5, np.full(BEATS, 0.001))
            fish.learn(number)
            grown = experiment.keep_trial(fish.pull_trial(number, tmp_path))
            assert (kept.name, grown.name) == (f"000{number}.ulg", f"000{number}-2.ulg")
            experiment.journal.add("learned", trial=number, rolled_back=False)
    found = again(experiment, tmp_path)
    assert found.not_recomputed == [(n, "its speeds were uploaded") for n in (1, 2)]
    assert found.recomputed == []
    assert found.learned == [1]
    assert found.not_learned == [(2, "no trial swam after it")]
    assert found.identical


def test_the_page_is_made_again(copy: Experiment, tmp_path: Path) -> None:
    from tailbeat.report.paper import write_report

    write_report(copy)
    (copy.folder / "report" / "report.html").write_text("another page")
    assert [line.split()[0] for line in again(copy, tmp_path).different] == ["report/report.html"]


@pytest.mark.soak
def test_the_whole_report_is_drawn_again(copy: Experiment, tmp_path: Path) -> None:
    from tailbeat.report.paper import write_report

    write_report(copy, paper=True)
    found = again(copy, tmp_path / "a")
    assert found.identical, found.different
    assert "report/report.html" in found.figures
    assert sum(name.endswith(".svg") for name in found.figures) >= 3
    assert "report/tables/trials.mat" in found.figures
    made = json.loads((copy.folder / "report" / "report.json").read_text())
    made["versions"]["matplotlib"] = "1.0"
    (copy.folder / "report" / "report.json").write_text(json.dumps(made))
    found = again(copy, tmp_path / "b")
    assert found.identical  # another matplotlib draws other bytes: told, not held against it
    assert any(name == "report/learning.svg" and "1.0" in why for name, why in found.not_drawn)
    assert "report/tables/trials.csv" in found.figures


def test_nothing_to_compare(tmp_path: Path) -> None:
    empty = Experiment.at(tmp_path / "e", "carangi", "thesis", "p4")
    with pytest.raises(InputError, match="holds no trials"):
        again(empty, tmp_path)


def test_redo_tells_what_the_simulated_fish_was(tmp_path: Path) -> None:
    with Fish.connect("sim:thesis?seed=7", tail_centre_rad=0.08) as fish:
        text = write_redo(make(fish, tmp_path, REFERENCE)).read_text()
    (line,) = [line for line in text.splitlines() if "tailbeat sim " in line]
    begin, _, value = line.rpartition("=")
    assert begin == (
        "# in another terminal: tailbeat sim --plant thesis --seed 7 --set tail_centre_rad"
    )
    assert np.float32(value) == np.float32(0.08)


def test_redo_tells_the_day(swum: Experiment, tmp_path: Path) -> None:
    text = write_redo(swum).read_text()
    for words in (
        "**simulated**",
        "# in another terminal: tailbeat sim --plant tank --seed 1\n",
        "tailbeat params set LAW_LEAD 1\n",
        "--condition water_temperature_degc=21.5",
        "trial 3: discard (bumped the wall)",
        "learned from trial 6",
        "tailbeat experiment replay .",
        "sha256sum -c SHA256SUMS",
    ):
        assert words in text
    assert "GUARD_BEATS" not in text  # as on a new board
    assert text.index("trial 3: discard") < text.index("learned from trial 4")
    assert str(swum.folder.parent) not in text
    assert write_redo(swum).read_text() == text
