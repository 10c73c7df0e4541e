"""The commands of experiments, and which experiment a fish is in."""

from __future__ import annotations

import json
import shlex
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer import Context
from typer.main import get_command
from typer.testing import CliRunner, Result

from tailbeat.app.cli import run
from tailbeat.app.cli._options import reference_names
from tailbeat.app.cli.app import app
from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, Refused
from tailbeat.core.records import encode_reference
from tailbeat.core.reference import from_text
from tailbeat.experiment.analysis import set_conditions, write_analysis
from tailbeat.experiment.current import (
    begin,
    current,
    made_before,
    make,
    named_reference,
    require_same,
    use,
)
from tailbeat.experiment.folder import Experiment, copy_state, held_state
from tailbeat.report.paper import Written
from tailbeat.sim.board import SimBoard, SimTransport

from ...swum_experiment import REFERENCE, swim_experiment, writable


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    return swim_experiment(tmp_path_factory.mktemp("cli"))


@pytest.fixture
def copy(recorded: Experiment, tmp_path: Path) -> Experiment:
    return Experiment(Path(shutil.copytree(recorded.folder, tmp_path / "copy")))


@pytest.fixture(autouse=True)
def book(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "book"))
    return tmp_path / "book"


def call(*words: object) -> Result:
    return CliRunner().invoke(app, ["experiment", *map(str, words)])


def document(*words: object, code: int = 0) -> Any:
    result = call(*words, "--json")
    assert result.exit_code == code, result.output
    return json.loads(result.stdout)


def test_done_again_as_redo_says(
    copy: Experiment, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The commands as they are, in their order, from the experiment's folder, with a new board."""
    _, _, text = call("show", copy.folder, "--redo").output.partition("## Before the first trial")
    typed = [shlex.split(line, comments=True) for line in text.split("```")[1].splitlines()]
    board = SimTransport(SimBoard("tank", seed=1))
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: board)
    monkeypatch.chdir(copy.folder)
    before = set(copy.folder.rglob("*"))
    for program, *words in filter(None, typed):
        assert program == "tailbeat" and run([*words, "--connect", "it"]) == 0, words
    assert "the board has another reference" not in capsys.readouterr().err
    assert set(copy.folder.rglob("*")) == before, "nothing new in the old folder"
    with Fish.connect("it") as fish:
        again = current(fish)
        assert again is not None and again.folder.parent == copy.folder.parent
        params = fish.params.values()
        require_same(fish, again)
    old, new = copy.settings(), again.settings()
    assert params == old["params"] and new["reference"] == old["reference"] == REFERENCE.name
    assert new["conditions"] == old["conditions"] and new["fish"] == old["fish"]
    assert (again.raw / "reference.bin").read_bytes() == (copy.raw / "reference.bin").read_bytes()
    assert document("replay", ".")["identical"]


def test_a_reference_that_was_changed_by_hand_has_another_name(copy: Experiment) -> None:
    path = copy.folder / "reference.csv"
    assert named_reference(str(path)).name == REFERENCE.name
    path.write_text(path.read_text().replace(",0.0", ",0.01", 1))
    assert named_reference(str(path)).name == "reference"


def test_a_fish_stays_in_its_experiment(tmp_path: Path) -> None:
    """The conditions from new, set and note without naming the folder."""
    sim = ("--connect", "sim?seed=1")
    new = ("--reference", "thesis", "--water-temp", 21.5, "--condition", "wall=glass")
    made = document("new", *new, "--operator", "jo", "--root", tmp_path / "e", *sim)
    assert made["board_has_reference"] is False
    folder = Path(made["folder"])
    found = document("set", "--condition", "salinity_psu=0.3", "--water-temp", 22, *sim)
    assert found["conditions"] == {
        "water_temperature_degc": 22.0, "wall": "glass", "salinity_psu": 0.3,
    }  # fmt: skip
    assert call("note", "fish looks tired", *sim).output.endswith("noted\n")
    journal = Experiment.open(folder).journal
    assert [entry["what"] for entry in journal.entries()] == ["made", "set", "note"]
    changed = journal.entries("set")[0]
    assert changed["before"]["water_temperature_degc"] == 21.5
    shown = call("show", *sim)
    for words in ("operator: jo", "salinity_psu: 0.3", "no trials yet", "fish looks tired"):
        assert words in shown.output
    assert "water_temperature_degc: 22.0" in shown.output


def test_the_same_again_makes_no_second_folder(tmp_path: Path) -> None:
    root = tmp_path / "e"
    sim = ("--connect", "sim?seed=1", "--root", root)
    new = ("new", "--reference", "thesis", "--water-temp", 21.5)
    (first,) = {document(*new, *sim)["folder"] for _ in range(2)}
    corrected = call("new", "--reference", "thesis", "--water-temp", 22, *sim)
    assert isinstance(corrected.exception, InputError)
    assert f"tailbeat experiment set {first}" in str(corrected.exception)
    assert [path.name for path in root.iterdir()] == [Path(first).name]
    second = document(*new, "--another", *sim)["folder"]
    assert second != first and len(list(root.iterdir())) == 2
    other = document("new", "--reference", "thesis:0.06,40", *sim)["folder"]
    assert other not in (first, second)


@pytest.mark.parametrize("touch", ["note", "set", "swim", "params"])
def test_one_that_was_begun_is_left_alone(tmp_path: Path, touch: str) -> None:
    root, wanted = tmp_path / "e", from_text("thesis")
    with Fish.connect("sim?seed=1") as fish:
        made = make(fish, root, wanted)
        assert made_before(fish, root, wanted, {"conditions": {}}) is not None
        assert made_before(fish, tmp_path, wanted, {"conditions": {}}) is None
        if touch == "note":
            made.note("it is cold")
        elif touch == "set":
            set_conditions(made, {"wall": "glass"})
        elif touch == "params":
            fish.params.set("ILC_LEAD", 2)
        else:
            (made.raw / "0001.ulg").touch()
        assert made_before(fish, root, wanted, {"conditions": {}}) is None


def test_one_experiment_is_not_compared_with_itself(recorded: Experiment) -> None:
    found = call("compare", recorded.folder, recorded.folder / ".." / recorded.name)
    assert isinstance(found.exception, InputError)
    assert "the same experiment" in str(found.exception)


def test_the_way_to_redo_it_stays_true(copy: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    path = copy.folder / "redo.md"
    call("note", copy.folder, "it is cold")
    assert "note: it is cold" in path.read_text()
    call("set", copy.folder, "--condition", "wall=glass")
    assert "--condition wall=glass" in path.read_text()
    path.unlink()
    written = Written(copy.folder / "report.html", [], [])
    monkeypatch.setattr("tailbeat.report.paper.write_report", lambda *_: written)
    assert run(["report", str(copy.folder)]) == 0
    assert "note: it is cold" in path.read_text()


@pytest.mark.parametrize(
    ("begun", "names"),
    [
        ("", ["thesis", "thesis:", "trapezoid:", "cosine:", "mine.csv", "more/"]),
        ("t", ["thesis", "thesis:", "trapezoid:"]),
        ("m", ["mine.csv", "more/"]),
        ("more/", ["more/hers.CSV"]),
        ("nowhere/x", []),
    ],
)
def test_the_shell_completes_references(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, begun: str, names: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "more").mkdir()
    for name in ("mine.csv", "more/hers.CSV", "notes.txt", "more/a.md"):
        (tmp_path / name).touch()
    assert reference_names(begun) == names


@pytest.mark.parametrize(
    "command",
    [
        "reference upload",
        "reference check",
        "session commission",
        "experiment new",
        "session design",
    ],
)
def test_each_reference_is_completed(command: str) -> None:
    found: Any = get_command(app)
    for word in command.split():
        found = found.commands[word]
    (param,) = (one for one in found.loaded.params if one.name in ("what", "reference"))
    values = param.shell_complete(Context(found), "tra")
    assert [value.value for value in values] == ["trapezoid:"]


@pytest.mark.parametrize(
    "words", [["wall"], ["Wall=x"], ["a b=x"], ["=3"], ["x="], ["x=1", "x=2"], ["é=1"]]
)
def test_conditions_that_make_no_sense(copy: Experiment, words: list[str]) -> None:
    given = [part for word in words for part in ("--condition", word)]
    result = call("set", copy.folder, *given)
    assert isinstance(result.exception, InputError)
    assert copy.settings()["conditions"] == {"water_temperature_degc": 21.5}


def test_water_that_is_not_believed(copy: Experiment) -> None:
    assert isinstance(call("set", copy.folder, "--water-temp", 71).exception, InputError)


def test_show_tells_trials_and_decisions(recorded: Experiment) -> None:
    lines = call("show", recorded.folder).output.splitlines()
    assert "simulated" in lines[0]
    third = next(line for line in lines if line.split()[:2] == ["3", "3"])
    assert third.endswith("discard: bumped the wall")
    assert any(line.endswith("keep (repeats trial 5) (learned)") for line in lines)
    assert len(document("show", recorded.folder)["trials"]) == 6
    assert "tailbeat experiment replay ." in call("show", recorded.folder, "--redo").output


def test_every_command_tells_of_tampering(copy: Experiment, recorded: Experiment) -> None:
    path = writable(copy.raw / "0002.ulg")
    path.write_bytes(path.read_bytes()[:-1])
    told = "raw/0002.ulg is not what it was when it was added"
    shown = call("show", copy.folder)
    assert (shown.exit_code, told in shown.output) == (1, True)
    listed = call("list", "--root", copy.folder.parent)
    assert (listed.exit_code, "DAMAGED: 0002.ulg" in listed.output) == (1, True)
    replayed = call("replay", copy.folder)
    assert (replayed.exit_code, told in replayed.output) == (1, True)
    for words in (
        ("export", copy.folder, "--format", "csv"),
        ("compare", copy.folder, recorded.folder),
    ):
        assert told in call(*words).stderr


def test_replay_is_quiet_when_all_is_well(recorded: Experiment) -> None:
    result = call("replay", recorded.folder)
    assert result.exit_code == 0
    assert result.output == (
        "nothing differs, but not all was compared: 7 raw files, speeds of 6 trials, learning from"
        " 4, 0 derived files came out the same\n"
        "not compared: analysis.json: it is not there; make it: tailbeat report\n"
    )
    write_analysis(recorded)
    result = call("replay", recorded.folder)
    assert result.output == (
        "identical: 7 raw files, speeds of 6 trials, learning from 4, 1 derived files came out the"
        " same\n"
    )
    assert document("replay", recorded.folder)["identical"] is True


def test_compare(recorded: Experiment, copy: Experiment) -> None:
    copy.write_settings({"conditions": {"water_temperature_degc": 24.0}})
    result = call("compare", recorded.folder, copy.folder, "--iterations", "3,4")
    assert result.output.startswith("no difference in max|e| is shown")
    assert "simulated" in result.output
    assert "they differ in: water_temperature_degc 21.5 against 24" in result.output
    found = document(
        "compare", recorded.folder, copy.folder, "--what", "rms", "--iterations", "3,4"
    )
    assert (len(found["a_m_s"]), found["difference_m_s"], found["repeats"]) == (3, 0.0, None)


def test_exports_hold_what_was_decided(copy: Experiment) -> None:
    import csv

    files = [Path(path) for path in document("export", copy.folder)["files"]]
    with (copy.folder / "export" / "trials.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["decision"] for row in rows][2] == "discard"
    assert [row["repeat_of"] for row in rows] == ["0", "0", "0", "0", "0", "5"]
    assert {row["simulated"] for row in rows} == {"True"}
    assert list(rows[0])[:3] == ["trial", "iteration", "end"]
    assert float(rows[5]["battery_start_v"]) > 6
    before = {path: path.read_bytes() for path in files}
    document("export", copy.folder)
    assert {path: path.read_bytes() for path in files} == before
    assert b"simulated" in (copy.folder / "export" / "trials.mat").read_bytes()[:116]


def test_mcap_by_its_own_option(copy: Experiment) -> None:
    names = [Path(path).name for path in document("export", copy.folder, "--mcap")["files"]]
    assert names == ["experiment.mcap"]
    both = document("export", copy.folder, "--format", "csv", "--format", "mcap", "--mcap")
    assert len(both["files"]) == 4
    assert copy.raw_problems() == []
    result = call("export", copy.folder, "--format", "xls")
    assert result.exit_code == 1 and "csv, mat, parquet, mcap, ulog" in str(result.exception)


def test_the_current_experiment_is_the_fishs(tmp_path: Path) -> None:
    with Fish.connect("sim?seed=1") as fish:
        assert current(fish) is None
        with pytest.raises(Refused):
            begin(fish, tmp_path)
        fish.upload_reference(REFERENCE)
        first, second = begin(fish, tmp_path), begin(fish, tmp_path, "b", {"x_m": 1.0})
        assert current(fish) == second
        use(fish, first)
        assert current(fish) == first
        require_same(fish, first)
        shutil.rmtree(first.folder)
        assert current(fish) is None
        fish.upload_reference(encode_reference(1.0, [0.01, 0.02]))
        with pytest.raises(InputError, match=r"another reference .* reference upload"):
            require_same(fish, second)
        second.write_settings({"unique_id": "0" * 32})
        with pytest.raises(InputError, match=r"another fish: .*Connect the right fish"):
            require_same(fish, second)


def test_the_boards_state_comes_back(recorded: Experiment, tmp_path: Path) -> None:
    held = held_state(recorded)
    assert held is not None
    assert held.last_learned_trial == 6
    assert held.iteration == 5
    experiment = Experiment.at(tmp_path / "e", "a", "b", "c")
    assert held_state(experiment) is None
    with Fish.connect("sim?seed=1") as fish:
        with pytest.raises(Refused):
            copy_state(fish, experiment)
        fish.upload_reference(held.reference)
        assert held.learned is not None
        fish.upload_learned(held.learned)
        copied = copy_state(fish, experiment)
    assert replace(copied, params=held.params, last_learned_trial=6) == held
    assert held_state(experiment) == copied
    path = experiment.folder / "board" / "state.json"
    for spoiled in (b"", b"{}", path.read_bytes().replace(b'"iteration": 5', b'"iteration": 4')):
        path.write_bytes(spoiled)
        with pytest.raises(InputError, match="is damaged"):
            held_state(experiment)
