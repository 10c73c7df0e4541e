"""An experiment done again from its raw files: the same bits, and every changed one is found."""

from __future__ import annotations

import json
import random
import shutil
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError
from tailbeat.experiment.analysis import Analysis, write_analysis
from tailbeat.experiment.current import make
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.redo import write_redo
from tailbeat.report.page import Picture
from tailbeat.report.paper import Drawing, write_report
from tailbeat.report.replay import Replay, replay
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard
from tailbeat.sim.server import SimServer

from ..swum_experiment import BEATS, REFERENCE, swim_experiment, writable


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    experiment = swim_experiment(tmp_path_factory.mktemp("replay"))
    write_analysis(experiment)
    return experiment


@pytest.fixture
def copy(recorded: Experiment, tmp_path: Path) -> Experiment:
    return Experiment(Path(shutil.copytree(recorded.folder, tmp_path / "copy")))


def again(experiment: Experiment, tmp_path: Path) -> Replay:
    return replay(experiment, tmp_path / "scratch")


def test_everything_comes_out_the_same(recorded: Experiment, tmp_path: Path) -> None:
    before = {path: path.read_bytes() for path in recorded.folder.rglob("*") if path.is_file()}
    found = again(recorded, tmp_path)
    assert found == Replay(
        raw=7,
        recomputed=[1, 2, 3, 4, 5, 6],
        not_recomputed=[],
        learned=[1, 2, 4, 6],  # 3 was discarded, 5 a repeat; 6 by the board's state
        figures=["analysis.json"],
        different=[],
    )
    assert found.identical
    assert {p: p.read_bytes() for p in recorded.folder.rglob("*") if p.is_file()} == before


@pytest.mark.parametrize(
    "params",
    [
        {"ILC_KIND": 1.0, "ILC_DECR_RATE": 1.0, "ILC_DECR_FROM": 1.0},
        {"ILC_KIND": 2.0, "ILC_WINDOW": 3.0},
        {"ILC_GAIN": 12.0, "ROLLBACK_RATIO": 1.01, "ILC_LEAD": 8.0, "DU_MAX_RAD": 0.0},
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
    """In every other file at a time: with none whole there is nothing to replay."""
    dice = random.Random(3)
    names = sorted(copy.sums())
    for half in (names[::2], names[1::2]):
        contents = {name: writable(copy.raw / name).read_bytes() for name in half}
        for name, content in contents.items():
            at, bit = dice.randrange(len(content)), 1 << dice.randrange(8)
            flipped = bytes([content[at] ^ bit])
            (copy.raw / name).write_bytes(content[:at] + flipped + content[at + 1 :])
        found = again(copy, tmp_path / half[0])
        told = [line for line in found.different if line.startswith("raw/")]
        was = "is not what it was when it was added"
        assert sorted(told) == [f"raw/{name} {was}" for name in half]
        for name, content in contents.items():
            (copy.raw / name).write_bytes(content)
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
    whole = len(copy.sums())
    replayed = again(copy, tmp_path)
    found = replayed.different
    assert "raw/0002.ulg is missing" in found
    assert "raw/0099.ulg is not listed in SHA256SUMS" in found
    assert not [line for line in found if "tailbeat report" in line], "not made again from these"
    assert any("put them back from a copy" in why for _, why in replayed.not_drawn)
    assert replayed.raw == whole - 1


def test_learning_that_never_happened_is_found(copy: Experiment, tmp_path: Path) -> None:
    """A journal that says otherwise: the law would have given trial 6 other amplitudes."""
    copy.journal.add("learned", trial=5, rolled_back=False)
    assert "trial 6 did not swim what the law makes of trial 5" in again(copy, tmp_path).different


def test_a_board_state_of_another_history_is_found(copy: Experiment, tmp_path: Path) -> None:
    from tailbeat.experiment import folder

    state = folder.held_state(copy)
    assert state is not None
    assert state.learned is not None
    learned = bytearray(state.learned)
    path = copy.folder / "board" / "state.json"
    document = json.loads(path.read_text())
    document["iteration"] += 1
    path.write_text(json.dumps(document))
    assert any("state.json is damaged" in line for line in again(copy, tmp_path).different)
    other = replace(state, learned=bytes(learned[:40] + bytes([learned[40] ^ 1]) + learned[41:]))
    assert other.file_content()[-80:] != state.file_content()[-80:], "another sha256"


def test_uploaded_speeds_are_told_not_counted(tmp_path: Path) -> None:
    with Fish.connect("sim:tank?seed=1") as fish:
        fish.params.set("SPD_SOURCE", 1)
        fish.upload_reference(REFERENCE)
        experiment = make(fish, tmp_path, REFERENCE)
        for _ in range(2):
            fish.arm()
            number = run_trial(fish).number
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
    assert found.not_learned == [(2, "no trial was executed after it")]
    assert found.identical


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """A report with one picture that takes no time; all are drawn twice in a soak test."""

    def drawn(analyses: list[Analysis]) -> list[Drawing]:
        errors = str([row.max_abs_error_m_s for row in analyses[0].rows]).encode()
        return [Drawing(Picture("learning", errors, b"<svg/>", "caption", "text"), Figure())]

    monkeypatch.setattr("tailbeat.report.paper.draw_all", drawn)


def test_the_page_is_made_again(copy: Experiment, tmp_path: Path, undrawn: None) -> None:
    write_report(copy)
    assert again(copy, tmp_path / "same").identical
    (copy.folder / "report" / "report.html").write_text("another page")
    assert [line.split()[0] for line in again(copy, tmp_path).different] == ["report/report.html"]


def test_a_report_file_that_is_gone_is_missed(
    copy: Experiment, tmp_path: Path, undrawn: None
) -> None:
    write_report(copy, paper=True)
    for name in ("learning.pdf", "tables/trials.csv"):
        (copy.folder / "report" / name).unlink()
    assert again(copy, tmp_path).different == [
        f"report/{name} is missing; make it again: tailbeat report"
        for name in ("learning.pdf", "tables/trials.csv")
    ]


def test_a_comparison_whose_other_side_is_gone_is_not_identical(
    copy: Experiment, tmp_path: Path, undrawn: None
) -> None:
    other = Experiment(Path(shutil.copytree(copy.folder, tmp_path / "other")))
    write_report(copy, against=[other])
    assert again(copy, tmp_path / "there").identical
    shutil.rmtree(other.folder)
    found = again(copy, tmp_path / "gone")
    assert not found.identical
    (line,) = found.different
    assert line.startswith("report cannot be made again: ../other, which it compares with, is gone")
    assert ("report/report.html", "../other is gone") in found.not_drawn


@pytest.mark.soak
def test_the_whole_report_is_drawn_again(copy: Experiment, tmp_path: Path) -> None:
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


def test_redo_tells_numbers_as_the_board_holds_them(tmp_path: Path) -> None:
    with Fish.connect("sim") as fish:
        fish.params.set("AMP_MAX_RAD", 0.68)
        fish.params.set("ILC_LEAD", 2)
        made = make(fish, tmp_path, REFERENCE)
        held = fish.params.get("AMP_MAX_RAD").value
    made.journal.add("set", params={"AMP_MAX_RAD": held})
    text = write_redo(made).read_text()
    assert held != 0.68, "single precision"
    assert "tailbeat params set AMP_MAX_RAD 0.68\n" in text
    assert "tailbeat params set ILC_LEAD 2\n" in text and ": set AMP_MAX_RAD = 0.68\n" in text


def test_redo_tells_what_fish_another_process_simulated(tmp_path: Path) -> None:
    """At the radio's port and at the wired console's."""
    stop = threading.Event()
    board = SimBoard("thesis", seed=7, tail_centre_rad=0.25)
    server = SimServer(board, "tcp:127.0.0.1:0", speed=20.0)
    serving = threading.Thread(target=server.serve, args=(stop.is_set,))
    serving.start()
    try:
        for number, url in enumerate((server.addresses.listen, server.addresses.console)):
            with Fish.connect(url) as fish:
                text = write_redo(make(fish, tmp_path / str(number), REFERENCE)).read_text()
            assert "- simulated plant: thesis\n- seed: 7\n" in text
            assert "tailbeat sim --plant thesis --seed 7 --set tail_centre_rad=0.25\n" in text
    finally:
        stop.set()
        serving.join()
        server.close()


def test_redo_tells_what_is_not_known(tmp_path: Path) -> None:
    """Of a simulated board in another process; and of the options."""
    with Fish.connect("sim") as fish:
        made = make(fish, tmp_path, REFERENCE)
    settings = made.settings()
    del settings["plant"], settings["seed"], settings["simulator"]
    (made.folder / "settings.json").write_text(json.dumps(settings))
    made.journal.add(
        "swum", trial=1, iteration=1, end="complete", rested_s=31.4, pose={"source": "camera"}
    )
    text = write_redo(made).read_text()
    assert "- simulated plant: unknown\n- seed: unknown\n" in text
    assert "tailbeat sim, with the plant and the seed of then (unknown)" in text
    assert "iteration 1, complete, rested 31 s, pose by camera\n" in text
    assert "options (`--rest`, `--until`" in text
    made.journal.add("typed", command="tailbeat trial run --until 3")
    text = write_redo(made).read_text()
    assert ": `tailbeat trial run --until 3`\n" in text and "are not known" not in text


def test_redo_tells_the_day(recorded: Experiment, tmp_path: Path) -> None:
    text = write_redo(recorded).read_text()
    for words in (
        "**simulated**",
        "# in another terminal: tailbeat sim --plant tank --seed 1\n",
        "tailbeat params set AMP_MAX_RAD 0.785\n",
        "--condition water_temperature_degc=21.5",
        "trial 3: discard (bumped the wall)",
        "learned from trial 6",
        "tailbeat experiment replay .",
        "sha256sum -c SHA256SUMS",
    ):
        assert words in text
    assert "GUARD_BEATS" not in text  # as on a new board
    assert text.index("trial 3: discard") < text.index("learned from trial 4")
    assert str(recorded.folder.parent) not in text
    assert write_redo(recorded).read_text() == text
