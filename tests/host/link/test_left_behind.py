"""What an earlier command, or another program, has left behind: trial run goes on only from what is
the fish's and the experiment's own, and says what puts the rest right. Virtual time."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.app.cli import run
from tailbeat.app.cli._terminal import ended, ended_as_by_ctrl_c
from tailbeat.board import preserve
from tailbeat.board.fish import Fish
from tailbeat.board.preserve import preserved
from tailbeat.board.snapshot import Snapshot
from tailbeat.core import records
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.experiment.current import begin, current
from tailbeat.experiment.folder import Experiment, alone, copy_state, held_state
from tailbeat.experiment.library import library_of, preserve_folder
from tailbeat.session import preflight, series
from tailbeat.session.events import Event
from tailbeat.session.log import SessionLog, write_held
from tailbeat.session.options import Options, Until
from tailbeat.session.outcome import Decision, RecordedTrial
from tailbeat.session.series import run_series
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport

SPEEDS = [0.03, 0.06, 0.07, 0.06, 0.03]
OTHER = [0.02, 0.05, 0.05, 0.02]
KEEP = ("trial", "run", "--then", "keep", "--rest", "1")
Says = Callable[..., tuple[int, str]]


@pytest.fixture
def board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SimBoard:
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "logbook"))
    monkeypatch.chdir(tmp_path)
    simulated = SimBoard("tank", seed=1)
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: SimTransport(simulated))
    with Fish.connect("it") as fish:
        fish.params.set("ILC_LEAD", 1)
        fish.upload_reference(records.encode_reference(1.0, SPEEDS))
    return simulated


@pytest.fixture
def says(board: SimBoard, capsys: pytest.CaptureFixture[str]) -> Says:
    """(exit status, the last line on stderr)"""

    def command(*words: str) -> tuple[int, str]:
        status = run([*words, "--connect", "it"])
        lines = capsys.readouterr().err.splitlines()
        return status, lines[-1] if lines else ""

    return command


@contextmanager
def connected() -> Iterator[Fish]:
    with Fish.connect("it") as fish:
        yield fish


def experiment() -> Experiment:
    (folder,) = Path("experiments").iterdir()
    return Experiment.open(folder)


def journal(what: str) -> list[dict[str, Any]]:
    return experiment().journal.entries(what)


class Script:
    """Answers keep, after something has happened."""

    def __init__(self, first: Callable[[], object] = lambda: None, answer: str = "keep") -> None:
        self._first, self._answer = first, Decision(answer, "bumped" if answer != "keep" else "")  # type: ignore[arg-type]
        self.told: list[Event] = []

    def tell(self, event: Event) -> None:
        self.told.append(event)

    def wants_abort(self) -> bool:
        return False

    def decide(self, recorded: RecordedTrial) -> Decision:
        self._first()
        return self._answer

    def confirm(self, question: str) -> bool:
        return True

    def number(self, question: str, value: float) -> float | None:
        return value


ONCE = Options(until=Until(1), wanted=None)


def break_off_a_trim(monkeypatch: pytest.MonkeyPatch) -> None:
    """The laptop dies: nothing is put back."""
    with connected() as fish, monkeypatch.context() as patch:
        patch.setattr(preserve, "_put_back", lambda *_: None)
        with preserved(fish, preserve_folder(library_of(fish)), lambda _: None, "trim") as board:
            board.prepare("a run", np.full(4, 0.1, np.float32), OTHER)


@pytest.mark.parametrize("begun", [True, False])
def test_a_trim_that_was_broken_off(
    says: Says, monkeypatch: pytest.MonkeyPatch, begun: bool
) -> None:
    if begun:
        assert says(*KEEP)[0] == 0
    break_off_a_trim(monkeypatch)
    for words in (KEEP, ("trial", "run", "--no-guide"), ("trial", "run", "--guide")):
        status, line = says(*words)
        assert status == 1 and "was broken off" in line, words
        assert line.endswith("tailbeat session resume")
    with connected() as fish:
        assert fish.status().next_trial == (2 if begun else 1), "nothing has swum"
    folders = list(Path("experiments").iterdir()) if Path("experiments").exists() else []
    assert len(folders) == begun, "no experiment begins along a run's reference"
    assert says("session", "resume", "--no-repeat")[0] == 0
    assert says(*KEEP)[0] == 0 and len(experiment().trials()) == 1 + begun


def test_the_page_does_not_go_on_either(says: Says, monkeypatch: pytest.MonkeyPatch) -> None:
    """It calls the library."""
    assert says(*KEEP)[0] == 0
    made = experiment()
    break_off_a_trim(monkeypatch)
    with connected() as fish:
        with pytest.raises(InputError, match=r"was broken off.*session resume"):
            begin(fish, Path("experiments"))
        with pytest.raises(InputError, match=r"was broken off.*session resume"):
            run_series(fish, made, Script(), ONCE)


def erase(board: SimBoard) -> None:
    board.flash = bytes(len(board.flash))
    board.world.power_cycle()
    with connected() as fish:
        fish.link.run(3.0)
        if fish.status().state in ("ABORTED", "FAULT"):
            fish.clear()


def test_a_board_that_was_erased(says: Says, board: SimBoard) -> None:
    assert says(*KEEP, "--until", "2")[0] == 0
    held = held_state(experiment())
    assert held is not None and held.iteration == 3
    erase(board)
    status, line = says(*KEEP)
    assert status == 1 and "lost its reference" in line and "tailbeat session resume" in line
    assert says("reference", "upload", str(experiment().folder / "reference.csv"))[0] == 0
    status, line = says(*KEEP)
    assert status == 1 and "the board has lost what it had learned" in line
    assert "copy of iteration 3" in line and "tailbeat session resume" in line
    assert line.endswith("To start over: tailbeat experiment new")
    assert held_state(experiment()) == held and len(experiment().trials()) == 2
    assert says("session", "resume", "--no-repeat")[0] == 0
    assert says(*KEEP)[0] == 0
    assert journal("swum")[-1]["iteration"] == 3, "it goes on where it was"


def test_an_erased_board_begins_anew(says: Says, board: SimBoard) -> None:
    """As a simulated one does that was started again with the same seed."""
    assert says(*KEEP)[0] == 0
    before, csv = experiment(), str(experiment().folder / "reference.csv")
    erase(board)
    status, line = says("experiment", "new")
    assert status == 1 and "Upload one: tailbeat reference upload" in line
    status, line = says(*KEEP)
    assert status == 1
    assert "tailbeat reference upload " in line and f"{csv}, then tailbeat exp" in line
    assert says("reference", "upload", csv)[0] == 0
    assert says("experiment", "new")[0] == 0
    assert says(*KEEP)[0] == 0
    with connected() as fish:
        now = current(fish)
    assert now is not None and now != before and len(now.trials()) == 1


def test_a_board_without_its_reference_that_had_learned_nothing(
    says: Says, board: SimBoard
) -> None:
    assert says("experiment", "new")[0] == 0
    erase(board)
    status, line = says(*KEEP)
    assert status == 1 and "the board has lost its reference. " in line
    assert says("session", "resume")[0] == 0
    assert says(*KEEP)[0] == 0


def test_a_copy_that_knows_more_is_kept(says: Says, board: SimBoard) -> None:
    assert says(*KEEP, "--until", "2")[0] == 0
    before = (experiment().folder / "board" / "state.json").read_bytes()
    with connected() as fish:
        copy_state(fish, experiment())
        aside = experiment().folder / "board" / "state-1.json"
        assert not aside.exists(), "the board knows as much"
        for speeds in (OTHER, SPEEDS):
            fish.upload_reference(records.encode_reference(1.0, speeds))
        for _ in range(2):
            copy_state(fish, experiment())
    assert aside.read_bytes() == before
    assert len(list(aside.parent.glob("state*.json"))) == 2


def state(last: int | None, iteration: int, learned: bytes | None = b"old") -> Snapshot:
    return Snapshot(
        "id", {}, iteration=iteration, reference=b"", learned=learned, last_learned_trial=last
    )


def test_what_knows_more() -> None:
    held = state(4, 5)
    assert held.knows_more(state(None, 0, None)) and held.knows_more(state(1, 2, b"new"))
    assert held.knows_more(state(4, 3, b"new"))
    assert not held.knows_more(state(5, 6, b"new")) and not held.knows_more(state(4, 5, b"best"))
    assert not held.knows_more(state(None, 5)), "given back: it is the same"
    assert not held.knows_more(state(None, 6, b"new")), "it has learned elsewhere"
    assert not state(None, 1).knows_more(state(None, 0, None)), "nothing was learned"


# a countdown that was given up


def swim_another(reference: list[float]) -> None:
    with connected() as fish:
        if fish.status().state in ("ABORTED", "FAULT"):
            fish.clear()
        own = fish.reference_record()
        fish.upload_reference(records.encode_reference(1.0, reference))
        fish.discard(run_trial(fish).number)
        assert own is not None
        fish.upload_reference(own)


def begin_and_leave(monkeypatch: pytest.MonkeyPatch, killed: bool) -> None:
    def given_up(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(series, "countdown", given_up)
    if killed:
        monkeypatch.setattr(SessionLog, "void", lambda *_: None)


@pytest.mark.parametrize("killed", [False, True])
@pytest.mark.parametrize("reference", [OTHER, SPEEDS])
def test_a_countdown_given_up_adopts_no_other_swim(
    says: Says, monkeypatch: pytest.MonkeyPatch, killed: bool, reference: list[float]
) -> None:
    with monkeypatch.context() as patch:
        begin_and_leave(patch, killed)
        assert says(*KEEP)[0] == 130
    assert len(journal("begun")) == 1 and len(journal("void")) == (not killed)
    assert journal("begun")[0]["iteration"] == 1, "what swims first is iteration 1"
    swim_another(reference)
    assert says(*KEEP)[0] == 0
    there = [trial.number for trial in experiment().trials()]
    looks_alike = killed and reference is SPEEDS
    assert there == ([1, 2] if looks_alike else [2]), "only what was begun here"
    decided = [entry["decision"] for entry in journal("decided")]
    assert decided == (["discard", "keep"] if looks_alike else ["keep"])
    assert not (experiment().folder / ".pulling").exists()


def test_a_swim_from_before_it_was_begun(says: Says) -> None:
    assert says(*KEEP)[0] == 0
    (trial,) = experiment().trials()
    account = SessionLog(experiment())
    for board_s, is_it in ((trial.start_us * 1e-6 - 3, True), (trial.start_us * 1e-6 + 3, False)):
        account.begun(trial.number, 1, None, 8.0, board_s)
        assert account.is_begun(trial) == is_it
    account.begun(trial.number + 1, 1, None, 8.0, 0.0)
    assert not account.is_begun(trial)


# two at a time


def test_only_one_program_swims_in_an_experiment(board: SimBoard) -> None:
    refused: list[str] = []
    with connected() as fish:
        made = begin(fish, Path("experiments"))

        def second() -> None:
            with connected() as other, pytest.raises(InputError) as error:
                run_series(other, made, Script(), ONCE)
            refused.append(str(error.value))

        end = run_series(fish, made, Script(second), ONCE)
        assert (end.why, end.rounds[0].learned is not None) == ("swims", True)
        assert len(refused) == 1 and "another program runs a trial in" in refused[0]
        assert run_series(fish, made, Script(), ONCE).why == "swims", "it is free again"


def test_the_lock_goes_with_its_program(board: SimBoard) -> None:
    with connected() as fish:
        made = begin(fish, Path("experiments"))
    if not hasattr(os, "fork"):
        pytest.skip("no fork")
    read, write = os.pipe()
    if (child := os.fork()) == 0:
        with alone(made):
            os.write(write, b"x")
            signal.pause()
    os.read(read, 1)
    with pytest.raises(InputError, match="another program"), alone(made):
        pass
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    with alone(made):
        pass
    os.close(read)
    os.close(write)


@pytest.mark.parametrize(
    ("act", "answer", "words"),
    [
        ("discard", "keep", "has not learned from it"),
        ("learn", "discard", "has learned from it"),
    ],
)
def test_a_decision_that_came_too_late(board: SimBoard, act: str, answer: str, words: str) -> None:
    with connected() as fish:
        made = begin(fish, Path("experiments"))
        operator = Script(lambda: getattr(fish, act)(1), answer)
        with pytest.raises(TailbeatError, match=words):
            run_series(fish, made, operator, ONCE)
    assert [one["trial"] for one in journal("withdrawn")] == [1]
    account = SessionLog(made)
    assert account.decision_on(made.raw / "0001.ulg") is None


def test_a_repeat_that_was_broken_off(says: Says) -> None:
    assert says(*KEEP, "--until", "3")[0] == 0
    with connected() as fish:
        learned = fish.learned_record()
        assert learned is not None
        next_trial = fish.status().next_trial
        write_held(experiment(), Snapshot("", {}, next_trial=next_trial, learned=learned))
        fish.restore_best()
    status, line = says(*KEEP)
    assert status == 1 and "repeat of the best" in line
    assert line.endswith("tailbeat session resume") and len(experiment().trials()) == 3
    assert says("session", "resume", "--no-repeat")[0] == 0
    with connected() as fish:
        assert fish.learned_record() == learned
    assert says(*KEEP)[0] == 0


# ended from outside


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_ended_by_a_signal(
    says: Says, board: SimBoard, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    class Tank(SimTransport):
        sent = False

        def wait(self, timeout_s: float) -> None:
            super().wait(timeout_s)
            if board.world.truth().swimming and not Tank.sent:
                Tank.sent = True
                os.kill(os.getpid(), number)

    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: Tank(board))
    outside = signal.signal(number, signal.SIG_DFL)  # the tests themselves may run under nohup
    try:
        status, line = says(*KEEP)
        assert status == 130 and "trial 1" in line and Tank.sent
        assert not board.world.truth().swimming and not ended()
        assert signal.getsignal(number) == signal.SIG_DFL
    finally:
        signal.signal(number, outside)


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_signals_that_are_somebody_elses() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with ended_as_by_ctrl_c():
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN, "nohup"
            with pytest.raises(KeyboardInterrupt, match="ended by SIGTERM"):
                os.kill(os.getpid(), signal.SIGTERM)
            assert ended() == "ended by SIGTERM"
    finally:
        signal.signal(signal.SIGHUP, before)


# the preflight checks


def test_the_battery_sags_while_it_rests(
    says: Says, board: SimBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert says(*KEEP)[0] == 0
    look = preflight._check_battery

    def sags(fish: Fish, *rest: Any) -> None:
        board.world.set_battery_v(6.4)
        look(fish, rest[0], fish.status())

    monkeypatch.setattr(preflight, "_check_battery", sags)
    status, _ = says(*KEEP, "--until", "battery")
    assert status == 0, "as was asked for"
    assert len(journal("swum")) == 1


def test_the_first_yaw_since_the_board_was_switched_on(says: Says) -> None:
    assert says(*KEEP)[0] == 0
    account = SessionLog(experiment())
    now = datetime.now().astimezone()
    found = account.first_yaw_deg(now - timedelta(hours=1))
    assert found == journal("begun")[0]["pose"]["yaw_deg"] and found is not None
    add = account.journal.add
    add("begun", now + timedelta(hours=2), trial=2, pose={"yaw_deg": 40.0})
    assert account.first_yaw_deg(now - timedelta(hours=1)) == found
    assert account.first_yaw_deg(now + timedelta(hours=1)) == 40.0
    add("resumed")
    assert account.first_yaw_deg(now - timedelta(hours=1)) is None
    assert json.loads(account.journal.path.read_text().splitlines()[-1])["what"] == "resumed"


def test_without_a_camera_every_start_points_as_the_first(
    says: Says, board: SimBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tailbeat.session.trial_camera.SimulatedCamera", lambda _: None)
    throw = ("trial", "run", "--then", "discard", "--reason", "x", "--rest", "1")
    assert says(*throw)[0] == 0
    first = journal("begun")[0]["pose"]
    assert first["source"] == "imu"
    add = experiment().journal.add
    add("begun", datetime.now() - timedelta(days=1), trial=9, pose={"yaw_deg": 170.0})
    add("void", trial=9, end="not started")
    board.world.place(0.0, 0.0, 0.7)
    status, line = says(*throw)
    assert status == 1 and "turn the nose" in line and "degrees" in line
