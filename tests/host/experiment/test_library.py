"""The trial library: what is kept is there for good, once, in order, whoever else writes."""

from __future__ import annotations

import json
import stat
import threading
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError
from tailbeat.core.records import encode_reference
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.experiment.library import DISCARDED, RUN, TrialLibrary, library_of
from tailbeat.session.trial import run_trial

FISH = "00112233445566778899aabbccddeeff"


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of three simulated trials."""
    folder = tmp_path_factory.mktemp("raw")
    with Fish.connect("sim:tank?seed=1") as fish:
        fish.upload_reference(encode_reference(1.0, np.full(12, 0.05)))
        for number in (1, 2, 3):
            run_trial(fish)
            fish.learn(number)
            fish.pull_trial(number, folder)
    return folder


@pytest.fixture
def library(tmp_path: Path) -> TrialLibrary:
    return TrialLibrary.of(FISH, tmp_path)


def trials_of(library: TrialLibrary) -> list[Trial]:
    return [kept.trial for kept in library.kept()[0]]


def test_nothing_is_made_before_something_is_kept(library: TrialLibrary) -> None:
    assert library.kept() == ([], [])
    assert library.speeds() == []
    assert library.proposals() == []
    assert library.identified() is None
    assert not library.folder.exists()


def test_trials_come_back_in_the_order_they_came(library: TrialLibrary, raw: Path) -> None:
    for number in (2, 1, 3):
        kept = library.keep(raw / f"{number:04d}.ulg")
        assert kept.read_bytes() == (raw / f"{number:04d}.ulg").read_bytes()
        assert stat.S_IMODE(kept.stat().st_mode) == 0o444
    assert [trial.number for trial in trials_of(library)] == [2, 1, 3]
    again = read_trial(raw / "0002.ulg")
    np.testing.assert_array_equal(trials_of(library)[0].beats.speed_m_s, again.beats.speed_m_s)
    assert [swim.trial for swim in library.speeds()] == [2, 1, 3]


def test_the_same_content_is_kept_once(library: TrialLibrary, raw: Path, tmp_path: Path) -> None:
    first = library.keep(raw / "0001.ulg")
    copy = tmp_path / "other-name.ulg"
    copy.write_bytes((raw / "0001.ulg").read_bytes())
    assert library.keep(copy) == first
    assert len(list(first.parent.iterdir())) == 1


def test_a_file_that_grew_takes_the_place_of_its_beginning(
    library: TrialLibrary, raw: Path, tmp_path: Path
) -> None:
    whole = (raw / "0001.ulg").read_bytes()
    short = tmp_path / "short.ulg"
    short.write_bytes(whole[: len(whole) - 700])
    library.keep(short)
    library.keep(raw / "0002.ulg")
    kept = library.keep(raw / "0001.ulg")
    assert [(t.number, t.end) for t in trials_of(library)] == [(1, "complete"), (2, "complete")]
    assert library.keep(short) != kept  # the beginning is there already
    assert len(trials_of(library)) == 2


def test_marks_are_the_contents_and_stay(library: TrialLibrary, raw: Path) -> None:
    library.keep(raw / "0001.ulg", RUN)
    library.keep(raw / "0002.ulg")
    second = library.keep(raw / "0002.ulg", DISCARDED)
    assert [kept.mark for kept in library.kept()[0]] == [RUN, DISCARDED]
    assert library.keep(raw / "0002.ulg") == second
    assert [swim.trial for swim in library.speeds()] == [1]
    assert [trial.number for trial in trials_of(library)] == [1, 2]


def test_the_latest_is_the_last_kept_or_not(library: TrialLibrary, raw: Path) -> None:
    for number in (1, 2):
        library.keep(raw / f"000{number}.ulg")
    again = library.kept(raw / "0001.ulg")[0]
    assert [kept.trial.number for kept in again] == [2, 1]
    assert [swim.trial for swim in library.speeds(raw / "0003.ulg")] == [1, 2, 3]
    assert len(trials_of(library)) == 2


def test_numbers_that_start_again_are_other_trials(
    library: TrialLibrary, raw: Path, tmp_path: Path
) -> None:
    """A board that lost its store counts from 1 again."""
    other = bytearray((raw / "0001.ulg").read_bytes())
    other[-1] ^= 1
    (tmp_path / "0001.ulg").write_bytes(other)
    library.keep(raw / "0001.ulg")
    library.keep(raw / "0002.ulg")
    library.keep(tmp_path / "0001.ulg")
    assert [trial.number for trial in trials_of(library)] == [1, 2, 1]


def test_a_damaged_file_is_named_and_the_trial_can_be_kept_again(
    library: TrialLibrary, raw: Path
) -> None:
    first = library.keep(raw / "0001.ulg")
    library.keep(raw / "0002.ulg")
    first.chmod(0o644)
    first.write_bytes(first.read_bytes()[:-5])
    (first.parent / "000009_0009_0011223344556677.ulg").write_bytes(b"no trial")
    kept, problems = library.kept()
    assert [one.trial.number for one in kept] == [2]
    assert len(problems) == 2
    assert str(first) in problems[0]
    again = library.keep(raw / "0001.ulg")
    assert again != first
    assert [trial.number for trial in trials_of(library)] == [2, 1]


def test_what_is_no_trial_is_refused(library: TrialLibrary, tmp_path: Path) -> None:
    (tmp_path / "x.ulg").write_bytes(b"hello")
    with pytest.raises(InputError, match="not a ULog"):
        library.keep(tmp_path / "x.ulg")
    with pytest.raises(InputError, match="cannot read"):
        library.keep(tmp_path / "none.ulg")
    assert not library.folder.exists()


def test_a_folder_nobody_can_write_is_told(tmp_path: Path, raw: Path) -> None:
    (tmp_path / "root").write_text("a file in its place")
    with pytest.raises(InputError, match="TAILBEAT_LOGBOOK"):
        TrialLibrary.of(FISH, tmp_path / "root").keep(raw / "0001.ulg")


def _add_many(root: Path, writer: int) -> None:
    for count in range(25):
        TrialLibrary.of(FISH, root).add_proposal({"writer": writer, "count": count})


def test_several_processes_write_at_once(tmp_path: Path) -> None:
    with ProcessPoolExecutor(4) as pool:
        list(pool.map(_add_many, [tmp_path] * 4, range(4)))
    library = TrialLibrary.of(FISH, tmp_path)
    found = library.proposals()
    assert len(found) == 100
    for writer in range(4):
        assert [d["count"] for d in found if d["writer"] == writer] == list(range(25))
    names = sorted(path.name for path in (library.folder / "proposals").iterdir())
    orders = [name.partition(".")[0] for name in names]
    assert len(set(orders)) == 100
    assert not any(name.endswith(".part") for name in names)


def test_a_change_waits_for_the_change_before_it(library: TrialLibrary) -> None:
    """Else two could take the same number."""
    library.add_proposal({"who": "before"})
    other = threading.Thread(target=library.add_proposal, args=[{"who": "other"}])
    with library.changing():
        other.start()
        library.add_proposal({"who": "ours"})
        assert [d["who"] for d in library.proposals()] == ["before", "ours"]
    other.join()
    assert [d["who"] for d in library.proposals()] == ["before", "ours", "other"]
    names = [path.name for path in sorted((library.folder / "proposals").iterdir())]
    assert names == ["000001.json", "000002.json", "000003.json"]


def test_what_a_crash_left_behind_is_no_trial(library: TrialLibrary, raw: Path) -> None:
    folder = library.keep(raw / "0001.ulg").parent
    (folder / "000002.part").write_bytes(b"half a tri")
    library.keep(raw / "0002.ulg")
    assert [trial.number for trial in trials_of(library)] == [1, 2]
    assert library.kept()[1] == []


def test_proposals_are_plain_json(library: TrialLibrary) -> None:
    path = library.add_proposal({"law": "model", "amplitude_rad": [0.1, 0.2]})
    assert path.name == "000001.json"
    assert json.loads(path.read_text()) == {"law": "model", "amplitude_rad": [0.1, 0.2]}
    (path.parent / "000002.json").write_text("{ half")
    library.add_proposal({"law": "p"})
    assert [d["law"] for d in library.proposals()] == ["model", "p"]


def test_where_it_lies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TAILBEAT_LOGBOOK", raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert TrialLibrary.of(FISH).folder == tmp_path / "tailbeat" / "fish" / FISH
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "mine"))
    assert TrialLibrary.of(FISH.upper()).folder == tmp_path / "mine" / FISH
    for bad in ("", "../x", "a/b", "ü", "f" * 65):
        with pytest.raises(InputError, match="unique_id"):
            TrialLibrary.of(bad)


def test_a_simulated_fish_in_this_process_has_one_only_when_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fish: Fish
) -> None:
    monkeypatch.delenv("TAILBEAT_LOGBOOK", raising=False)
    assert library_of(fish) is None
    assert library_of(fish, tmp_path) == TrialLibrary(tmp_path / fish.unique_id())
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "e"))
    assert library_of(fish) == TrialLibrary(tmp_path / "e" / fish.unique_id())
