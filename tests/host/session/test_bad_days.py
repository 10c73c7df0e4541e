"""Bad days through the command line, as somebody types it and reads it: camera, link, battery, the
wrong fish, a full disk, Ctrl-C, a power cut, a second person. One line says what is wrong and what
to do, the tail stops, nothing is lost, and the next command goes on. Virtual time.

Ctrl-C and the full disk at every moment: ``pytest -m soak``.
"""

from __future__ import annotations

import builtins
import errno
import io
import itertools
import json
import math
import os
import pkgutil
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

from tailbeat.app.cli import run
from tailbeat.app.cli._operator import TerminalOperator
from tailbeat.app.cli.app import app
from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core.speed_source import CameraGone, Frame
from tailbeat.experiment.current import begin, set_and_save
from tailbeat.experiment.folder import Experiment
from tailbeat.sensors.camera.render.source import SimulatedCamera
from tailbeat.session.outcome import Decision, RecordedTrial
from tailbeat.sim.board import CONSOLE, SimBoard, SimTransport

from ..tank_day import Day, Tank

SPEEDS = [0.03, 0.06, 0.07, 0.06, 0.05, 0.04, 0.03, 0.02]
STOP_S = 1.2  # beats end where they are; the tail goes to its centre
KEEP = ("trial", "run", "--then", "keep", "--rest", "1")
NOBODY = ("trial", "run", "--guide", "--rest", "1")
NEWS = "a new experiment begins"


@dataclass
class Watched(Tank):
    """Also knows when the tail stopped, and can have somebody press Ctrl-C."""

    stopped_s: float = math.nan
    waits: int = 0
    interrupt_at: int = 0
    later: list[tuple[float, Callable[[], None]]] = field(default_factory=list)

    def wait(self, timeout_s: float) -> None:
        for due in [due for due in self.later if self.board.time_s >= due[0]]:
            self.later.remove(due)
            due[1]()
        self.waits += 1
        if self.waits == self.interrupt_at:
            raise KeyboardInterrupt
        swam = self.board.world.truth().swimming
        super().wait(timeout_s)
        if swam and not self.board.world.truth().swimming:
            self.stopped_s = self.board.time_s


@dataclass
class BadDay(Day):
    """Reads what is said, line by line, and looks after every command whether all is in order."""

    tank: Watched
    lines: list[str] = field(default_factory=list)
    bad_s: float = math.nan

    def goes_wrong(self, beat: int, act: Callable[[], object]) -> None:
        """In the middle of that beat of the next trial."""

        def now() -> None:
            self.bad_s = self.board.time_s
            act()

        self.happens(beat, now)

    def says(self, *words: object) -> tuple[int, Any]:
        """(exit status, JSON document without its error, or None); ``lines`` is what stood on
        stderr."""
        status = run([*map(str, words), "--json", "--connect", "the board"])
        out, err = self.capsys.readouterr()
        self.lines = [line for line in err.splitlines() if NEWS not in line]
        assert "Traceback" not in err and all(len(line) < 400 for line in self.lines), err
        document = json.loads(out) if out else None
        if document is not None and "error" in document:
            error = document.pop("error")
            assert " ".join(error["message"].split()).rstrip(".") in self.lines[-1]
        return status, document or None

    def fish(self) -> Fish:
        return Fish(self.tank)

    def status(self) -> Any:
        return self.fish().status()

    def experiment(self) -> Experiment:
        return Experiment.open(max(Path("experiments").iterdir()))

    def require_stopped_within(self, limit_s: float) -> None:
        """After what went wrong."""
        self.fish().link.run(STOP_S)
        assert not self.board.world.truth().swimming
        assert self.tank.stopped_s - self.bad_s <= limit_s + STOP_S

    def require_nothing_lost(self) -> None:
        """Every trial of the board's is pending, or in the raw files and in the journal."""
        fish = self.fish()
        fish.link.run(6.0)  # so long a trial that was cut may take to be pending
        status = fish.status()
        assert not self.board.world.truth().swimming and status.state not in ("ARMED", "RUNNING")
        waiting = status.pending_trial
        if not Path("experiments").exists():
            assert fish.trials() == []
            return
        experiment = self.experiment()
        known = {entry["trial"] for entry in experiment.journal.entries("swum")}
        files = {trial.number for trial in experiment.trials()}
        began = experiment.journal.entries("begun")
        open_trial = began[-1]["trial"] if began else None
        for trial in fish.trials():
            there = trial.number in known & files
            # a trial cut before its first speed is not pending; its log stays on the board
            assert there or trial.number in (waiting, open_trial), f"trial {trial.number}"
        assert experiment.damaged() == []

    def require_resume(self, differs: str) -> None:
        """It was switched off: nothing swims or is learned before 'session resume'."""
        before, trials = (
            self.experiment().folder / "board" / "state.json",
            self.board.world.truth().swims,
        )
        held = before.read_bytes() if before.exists() else b""
        assert self.says(*KEEP)[0] == 1 and len(self.lines) == 1, self.lines
        words_of(differs, "tailbeat session resume", self.lines)
        assert self.board.world.truth().swims == trials
        assert (before.read_bytes() if before.exists() else b"") == held
        self.require_resume_only()

    def require_resume_only(self) -> None:
        assert self.says("session", "resume", "--no-repeat")[0] == 0, self.lines

    def require_goes_on(self) -> None:
        """The same command again ends with a kept trial, and all that was executed is accounted
        for."""
        self.require_nothing_lost()
        status, document = self.says(*KEEP)
        assert status == 0, self.lines
        assert (document["swims"][-1]["decision"], document["swims"][-1]["end"]) == (
            "keep", "complete"
        )  # fmt: skip
        experiment, now = self.experiment(), self.status()
        assert (now.state, now.pending_trial) == ("IDLE", None)
        assert experiment.raw_problems() == []
        files = sorted(path.name for path in experiment.trial_files())
        for what in ("swum", "decided"):
            told = [entry["file"] for entry in experiment.journal.entries(what)]
            assert sorted(told) == files, f"{what}: {told}"
        assert len(self.fish().trials()) == len(files)
        learned = [entry["trial"] for entry in experiment.journal.entries("learned")]
        decided = experiment.journal.entries("decided")
        kept = [entry["trial"] for entry in decided if entry["decision"] == "keep"]
        assert learned == sorted(set(learned)) and set(learned) == set(kept)
        assert not (experiment.folder / ".pulling").exists()


@pytest.fixture(scope="module")
def parser() -> Any:
    return typer.main.get_command(app)


@pytest.fixture
def fresh(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    parser: Any,
) -> Callable[[], BadDay]:
    """Another day, in a folder of its own, with an experiment that has just begun."""
    monkeypatch.setattr("typer.main.get_command", lambda _: parser)  # made once, it takes 0.2 s
    numbers = itertools.count()

    def make() -> BadDay:
        folder = tmp_path / f"day-{next(numbers)}"
        folder.mkdir()
        monkeypatch.chdir(folder)
        monkeypatch.setenv("TAILBEAT_LOGBOOK", str(folder / "logbook"))
        day = connect_to(SimBoard("tank", seed=3, camera_fps=12.5), monkeypatch, capsys)
        begin(day.fish(), Path("experiments"))
        return day

    return make


@pytest.fixture
def day(fresh: Callable[[], BadDay]) -> BadDay:
    return fresh()


def connect_to(
    board: SimBoard, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> BadDay:
    """Whoever connects from now on finds this board, with a reference on it."""
    tank = Watched(board)
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: tank)
    with Fish.connect("it") as fish:
        fish.params.set("ILC_LEAD", 1.5)
        fish.upload_reference(records.encode_reference(1.0, SPEEDS))
        fish.upload_amplitudes(np.full(len(SPEEDS), 0.2, np.float32))
    return BadDay(board, tank, capsys)


def words_of(problem: str, remedy: str, lines: list[str]) -> None:
    """One line, and one only, names the problem, and says what to do."""
    (line,) = [line for line in lines if problem in line]
    assert line.startswith("tailbeat: ") and remedy in line, line


# the camera


class BadCamera(SimulatedCamera):
    """Dies, or shows one picture for ever."""

    computed = False
    ill = ""
    last: Frame | None = None

    def frames(self) -> list[Frame]:
        frames = super().frames()
        if BadCamera.ill == "gone":
            raise CameraGone("camera 0 gives no pictures any more", "Plug it in, then begin again.")
        if BadCamera.ill == "frozen" and BadCamera.last is not None:
            last = BadCamera.last
            return [replace(last, t_s=frame.t_s) for frame in frames]
        if frames:
            BadCamera.last = frames[-1]
        return frames


@pytest.fixture
def camera(monkeypatch: pytest.MonkeyPatch, day: BadDay) -> type[BadCamera]:
    place = "tailbeat.session.trial_camera.SimulatedCamera"
    monkeypatch.setattr(place, lambda _: BadCamera(day.board))
    monkeypatch.setattr(BadCamera, "ill", "")
    monkeypatch.setattr(BadCamera, "last", None)
    return BadCamera


@pytest.mark.parametrize("command", [KEEP, NOBODY])
def test_the_camera_dies(day: BadDay, camera: type[BadCamera], command: tuple[str, ...]) -> None:
    day.goes_wrong(4, lambda: setattr(camera, "ill", "gone"))
    status, document = day.says(*command)
    day.require_stopped_within(0.5)
    words_of("camera 0 gives no pictures any more", "Plug it in", day.lines)
    assert day.lines[1] == "tailbeat: trial aborted by command"
    if command is KEEP:
        assert status == 0 and document["swims"][0]["end"] == "aborted:ABORT_COMMAND"
        assert len(day.lines) == 2
        day.require_nothing_lost()
        status, _ = day.says(*KEEP)
        assert status == 1 and len(day.lines) == 1 and "Plug it in" in day.lines[0]
    else:
        assert status == 1 and len(day.lines) == 3
        words_of("trial 1 waits on the board: not complete", "Say what becomes of it", day.lines)
    camera.ill = ""
    day.require_goes_on()


def test_the_picture_freezes(day: BadDay, camera: type[BadCamera]) -> None:
    """The IMU carries the speed on for a while; without one its beats would be unmeasured."""
    day.goes_wrong(3, lambda: setattr(camera, "ill", "frozen"))
    day.types("params", "set", "IMU_TIMEOUT_S", 0)
    day.board.world.set_imu(False)
    status, document = day.says(*NOBODY)
    assert status == 1 and document is None
    words_of("the camera's picture stands still", "unmeasured", day.lines)
    words_of("trial 1 waits on the board", "Say what becomes of it", day.lines)
    assert "of 8 beats have no speed" in day.lines[-1]
    status, _ = day.says("trial", "run", "--then", "discard", "--reason", "camera", "--rest", "1")
    assert status == 1, "it is decided on, but nothing swims before a camera that sees nothing"
    words_of("picture stands still", "Look at the camera", day.lines)
    camera.ill = ""
    day.require_goes_on()
    assert day.experiment().journal.entries("decided")[0]["decision"] == "discard"


# the link


def cut_the_link(day: BadDay, beat: int, for_s: float) -> None:
    def cut() -> None:
        day.board.world.set_radio(False)
        day.tank.later.append((day.board.time_s + for_s, lambda: day.board.world.set_radio(True)))

    day.goes_wrong(beat, cut)


LOST = "tailbeat: the link broke; trying to get it back (without it the board stops by itself)"
BACK = "tailbeat: the link is back; the board has stopped the tail meanwhile"
ON = "tailbeat: the link is back; the trial continues"


@pytest.mark.parametrize("command", [KEEP, NOBODY])
def test_the_link_drops_for_20_s(day: BadDay, command: tuple[str, ...]) -> None:
    cut_the_link(day, 2, 20.0)
    status, document = day.says(*command)
    day.require_stopped_within(5.0)
    assert day.lines[:2] == [LOST, BACK]
    if command is KEEP:
        assert status == 0 and len(day.lines) == 2
        (trial,) = document["swims"]
        assert (trial["end"], trial["executed_beats"]) == ("aborted:LINK_LOST", 7)
        assert "not complete: aborted:LINK_LOST" in trial["problems"]
    else:
        assert status == 1 and len(day.lines) == 3
        words_of("not complete: aborted:LINK_LOST", "--then keep|repeat|discard", day.lines)
    day.require_goes_on()


def test_a_fish_that_may_swim_unattended_swims_on(day: BadDay) -> None:
    day.types("params", "set", "LINK_TIMEOUT_S", 0)
    cut_the_link(day, 1, 5.0)
    status, document = day.says(*KEEP)
    assert (status, document["swims"][0]["end"]) == (0, "complete")
    assert day.lines == [LOST, ON]
    cut_the_link(day, 1, 20.0)  # longer than the trial
    status, document = day.says(*KEEP)
    assert (status, document["swims"][0]["end"]) == (0, "complete")
    assert day.lines == [LOST, BACK]
    day.require_goes_on()


@pytest.mark.parametrize("timeout_s", [5, 0])
def test_the_link_never_comes_back(day: BadDay, timeout_s: int) -> None:
    day.types("params", "set", "LINK_TIMEOUT_S", timeout_s)
    cut_the_link(day, 2, math.inf)
    status, document = day.says(*KEEP)
    assert status == 1 and document is None and len(day.lines) == 2 and day.lines[0] == LOST
    words_of("broke during trial 1 and did not come back in 60 s", "run the same", day.lines)
    day.require_stopped_within(timeout_s or len(SPEEDS))
    status, _ = day.says(*KEEP)
    assert status == 1 and len(day.lines) == 1
    words_of("Nothing was received", "the Bluetooth module is paired", day.lines)
    day.board.world.set_radio(True)
    day.require_goes_on()
    assert day.lines == ["tailbeat: trial 1 waits on the board; it is decided on first"]


# the battery


def test_the_battery_sags_in_mid_swim(day: BadDay) -> None:
    day.goes_wrong(3, lambda: day.board.world.set_battery_v(5.5))
    status, document = day.says(*KEEP)
    day.require_stopped_within(1.0)  # BATT_SAG_S
    assert status == 1 and document["why"] == "stopped"
    assert day.lines[0] == "tailbeat: battery critically low" and len(day.lines) == 2
    words_of("BATTERY_CRITICAL", "change the battery", day.lines)
    assert day.lines[1].endswith("Then: tailbeat session resume")
    status, _ = day.says(*KEEP)
    assert status == 1 and not day.board.world.truth().swimming, "nothing swims on such a battery"
    words_of("BATTERY_CRITICAL", "change the battery", day.lines)
    day.board.world.swap_battery(8.2)
    assert day.says("learn")[0] == 1, "its parameters come back first"
    day.says("session", "resume", "--yes", "--rest", 1)  # it may advise to identify
    day.require_goes_on()


def test_a_new_battery_is_not_gone_on_with_unasked(day: BadDay) -> None:
    day.goes_wrong(3, lambda: day.board.world.set_battery_v(5.5))
    assert day.says(*KEEP)[0] == 1
    day.board.world.swap_battery(8.2)
    assert day.says("learn")[0] == 1 and "session resume" in day.lines[0]
    day.require_resume("ILC_LEAD is 1, was 1.5")
    day.require_goes_on()
    assert [e["trial"] for e in day.experiment().journal.entries("learned")] == [1, 2]


def test_a_board_that_was_switched_off_and_has_all_of_it(day: BadDay) -> None:
    """Its parameters were saved: only its clock tells."""
    assert day.says("params", "save")[0] == 0
    assert day.says(*KEEP)[0] == 0
    day.board.world.swap_battery(8.2)
    day.fish().link.run(1.0)
    trials = day.board.world.truth().swims
    assert day.says(*KEEP)[0] == 1 and len(day.lines) == 1
    words_of("the board was switched off since trial 1", "tailbeat session resume", day.lines)
    assert day.board.world.truth().swims == trials
    assert day.says("session", "resume", "--no-repeat")[0] == 0
    day.require_goes_on()


def test_a_swap_before_the_first_swim(day: BadDay) -> None:
    """Nothing knows what was set but the trial library: no experiment has begun."""
    shutil.rmtree("experiments")
    assert day.says("params", "set", "ILC_GAIN", "3")[0] == 0
    day.board.world.swap_battery(8.2)
    new = ("experiment", "new", "--reference", "thesis")
    for words in (KEEP, ("trial", "run", "--no-guide"), new):
        assert day.says(*words)[0] == 1
        words_of("ILC_GAIN is 4, was 3", "tailbeat session resume", day.lines)
    assert day.board.world.truth().swims == 0 and not list(Path("experiments").glob("*"))
    assert day.says("session", "resume")[1]["params"]["ILC_GAIN"] == [4.0, 3.0]
    assert day.says(*KEEP)[0] == 0


def test_a_swap_between_two_references(day: BadDay) -> None:
    """The old experiment is not asked, the new one has not begun."""
    assert day.says(*KEEP)[0] == 0
    assert day.says("reference", "upload", "trapezoid:0.05,2,4")[0] == 0
    assert day.says("params", "set", "ILC_GAIN", "3")[0] == 0
    day.board.world.swap_battery(8.2)
    assert day.says(*KEEP)[0] == 1
    words_of("ILC_GAIN is 4, was 3", "tailbeat session resume", day.lines)
    assert day.says("session", "resume")[0] == 0
    assert {n: day.fish().params.get(n).value for n in ("ILC_GAIN", "ILC_LEAD")} == {
        "ILC_GAIN": 3.0, "ILC_LEAD": 1.5
    }  # fmt: skip
    assert day.says(*KEEP)[1]["swims"][0]["trial"] == 2


def test_back_to_an_experiment_of_another_reference(day: BadDay) -> None:
    """Trial numbers run on: the board is ahead of the copy, and yet knows nothing of it."""
    assert day.says(*KEEP, "--until", "2")[0] == 0
    first = day.experiment()
    state = first.folder / "board" / "state.json"
    before = json.loads(state.read_text())
    assert day.says("reference", "upload", "trapezoid:0.05,2,4")[0] == 0
    assert day.says(*KEEP)[0] == 0
    assert day.says("reference", "upload", first.folder / "reference.csv")[0] == 0
    assert day.says(*KEEP, "--into", first.folder)[0] == 1
    words_of("the board has lost what it had learned", "tailbeat session resume", day.lines)
    assert json.loads(state.read_text()) == before
    restored = day.says("session", "resume", "--no-repeat", "--into", first.folder)[1]["restored"]
    assert restored["learned"] and restored["iteration"] == before["iteration"]
    goes_on = Path(day.says(*KEEP)[1]["experiment"])
    assert goes_on.resolve() == first.folder.resolve(), "it is in that one now"


def test_another_experiment_has_other_parameters(day: BadDay) -> None:
    assert day.says(*KEEP)[0] == 0
    first = day.experiment()
    csv = first.folder / "reference.csv"
    assert day.says("experiment", "new", "--another", "--reference", csv)[0] == 0
    assert day.says("params", "set", "ILC_GAIN", "5")[0] == 0
    assert day.says("experiment", "use", first.folder)[0] == 0
    assert day.says(*KEEP)[0] == 1
    words_of("is set for another experiment", "ILC_GAIN is 5, was 4", day.lines)


def test_a_swap_while_the_question_is_open(day: BadDay, monkeypatch: pytest.MonkeyPatch) -> None:
    decide = TerminalOperator.decide

    def slowly(self: TerminalOperator, recorded: RecordedTrial) -> Decision:
        day.board.world.swap_battery(8.2)
        return decide(self, recorded)

    with monkeypatch.context() as patch:
        patch.setattr(TerminalOperator, "decide", slowly)
        assert day.says(*KEEP, "--until", "3")[0] == 1
    words_of("ILC_LEAD is 1, was 1.5", "tailbeat session resume", day.lines)
    assert day.experiment().journal.entries("learned") == []
    assert day.status().pending_trial == 1 and day.board.world.truth().swims == 1
    day.require_resume_only()
    day.require_goes_on()


def test_what_is_set_to_what_the_board_has_is_meant_too(day: BadDay) -> None:
    assert day.says(*KEEP)[0] == 0
    day.board.world.swap_battery(8.2)
    assert day.says("params", "reset")[0] == 0
    resumed = day.says("session", "resume", "--no-repeat")[1]["restored"]
    assert resumed["params"] == {}, "every parameter was set on purpose, to its default"
    day.require_goes_on()


def test_a_way_out_of_an_older_setting(day: BadDay) -> None:
    """Set for a reference that never swam, lost, and the older experiment gone on with."""
    assert day.says(*KEEP)[0] == 0
    csv = day.experiment().folder / "reference.csv"
    assert day.says("reference", "upload", "trapezoid:0.05,2,4")[0] == 0
    assert day.says("params", "set", "ILC_GAIN", "3")[0] == 0
    day.board.world.swap_battery(8.2)
    assert day.says("reference", "upload", csv)[0] == 0
    assert day.says("session", "resume", "--no-repeat")[0] == 0, day.lines
    assert day.says("experiment", "new", "--another", "--reference", csv)[0] == 0, day.lines


def test_a_damaged_account_of_what_was_set(day: BadDay) -> None:
    shutil.rmtree("experiments")
    (meant,) = Path(os.environ["TAILBEAT_LOGBOOK"]).glob("*/meant.json")
    meant.write_text("{")
    assert day.says(*KEEP)[0] == 1
    words_of("meant.json is damaged", "then delete the file", day.lines)
    meant.unlink()
    assert day.says(*KEEP)[0] == 0


def test_only_what_a_command_sets_is_meant(day: BadDay) -> None:
    assert day.says(*KEEP)[0] == 0
    assert day.says("params", "set", "ILC_GAIN", "3")[0] == 0
    assert day.says(*KEEP)[0] == 0, "a command of this tool set it"
    set_and_save(day.fish(), {"ILC_GAIN": 3.5})
    assert day.says(*KEEP)[0] == 0, "as trim, identify and the first session do"
    day.fish().params.set("ILC_GAIN", 2.5)  # from a ground station
    assert day.says(*KEEP)[0] == 1
    words_of("ILC_GAIN is 2.5, was 3.5", "tailbeat params save", day.lines)
    assert day.says("params", "save")[1] == {"saved": True, "accepted": {"ILC_GAIN": 2.5}}
    day.require_goes_on()


def test_the_battery_is_too_low_for_another_swim(day: BadDay) -> None:
    assert day.says(*KEEP)[0] == 0
    day.board.world.set_battery_v(6.4)
    begin_s = day.board.time_s
    status, document = day.says(*KEEP)
    assert status == 1 and document["why"] == "battery" and len(day.lines) == 1
    words_of("the battery has 6.40 V, and below 6.60 V", "change it, then: tailbeat", day.lines)
    assert day.board.time_s - begin_s < 2.0, "before anybody has waited"
    status, document = day.says(*KEEP, "--until", "battery")
    assert (status, day.lines, document["why"]) == (0, [], "battery"), "as was asked for"
    day.board.world.set_battery_v(8.2)
    day.require_goes_on()


def test_power_is_cut_in_mid_swim(day: BadDay) -> None:
    assert day.says(*KEEP)[0] == 0
    day.goes_wrong(3, day.board.world.power_cycle)
    status, document = day.says(*KEEP, "--until", "3")
    day.require_stopped_within(0.0)
    assert status == 1 and document["why"] == "stopped" and len(document["swims"]) == 1
    assert len(day.lines) == 2, day.lines
    words_of("the board restarted during a trial", "Check the battery and its switch", day.lines)
    words_of("trial 2 (aborted:REBOOT) has no speeds", "discarded", day.lines)
    day.require_resume("ILC_LEAD is 1, was 1.5")
    day.require_goes_on()
    assert day.lines == []


def test_power_is_cut_and_nobody_waits_for_the_end(
    day: BadDay, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The board does not hold the trial, so only the journal knows that it is undecided."""
    day.goes_wrong(3, day.board.world.power_cycle)

    def press(*_: Any) -> Any:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("tailbeat.session.decide.Decisions.decide", press)
        assert day.says(*KEEP)[0] == 130
    day.require_resume("ILC_LEAD is 1, was 1.5")
    day.require_goes_on()
    words_of("trial 1 was left undecided", "decided on first", day.lines)


# the wrong fish


def test_another_fish(
    day: BadDay, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert day.says(*KEEP)[0] == 0
    folder = day.experiment().folder
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    other = connect_to(SimBoard("tank", seed=4), monkeypatch, capsys)
    for command, remedy in (
        ((*KEEP, "--into", folder), "Connect the right fish"),
        (("session", "resume", "--into", folder, "--yes"), "--another-board"),
    ):
        status, document = other.says(*command)
        assert status == 1 and document is None and len(other.lines) == 1
        words_of("this is another fish", remedy, other.lines)
        assert other.fish().trials() == [] and other.status().iteration == 1
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    status, document = other.says(*KEEP)  # without a name it gets an experiment of its own
    assert status == 0 and document["experiment"] != str(folder)
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: day.tank)
    status, document = day.says(*KEEP)
    assert status == 0 and Path(document["experiment"]).name == folder.name


# somebody else


@pytest.mark.parametrize("command", [KEEP, NOBODY])
def test_a_second_program_aborts_and_clears(day: BadDay, command: tuple[str, ...]) -> None:
    def second() -> None:
        fish = Fish(SimTransport(day.board, CONSOLE))
        fish.abort()
        fish.clear()

    day.goes_wrong(4, second)
    status, document = day.says(*command)
    day.require_stopped_within(0.5)
    assert day.lines[0] == "tailbeat: trial aborted by command"
    if command is KEEP:
        assert status == 0 and len(day.lines) == 1
        assert document["swims"][0]["end"] == "aborted:ABORT_COMMAND"
    else:
        assert status == 1 and len(day.lines) == 2
        words_of("not complete: aborted:ABORT_COMMAND", "Say what becomes of it", day.lines)
    day.require_goes_on()


# Ctrl-C


def moments(last: int, most: int) -> list[int]:
    """Spread over all waits; the trial and what follows it lie in the second half."""
    return sorted({1, *np.linspace(2, last, most - 1).astype(int).tolist()})


@pytest.mark.parametrize("most", [7, pytest.param(250, marks=pytest.mark.soak)])
def test_ctrl_c_at_any_moment(fresh: Callable[[], BadDay], most: int) -> None:
    whole = fresh()
    begin_at = whole.tank.waits
    assert whole.says(*KEEP)[0] == 0
    for n in moments(whole.tank.waits - begin_at, most):
        day = fresh()
        day.tank.interrupt_at = day.tank.waits + n
        status, _ = day.says(*KEEP)
        assert status == 130, f"wait {n}: {status} {day.lines}"
        told = [line for line in day.lines if "stopped by" in line]
        assert len(told) == 1 and told[0] == day.lines[-1], f"wait {n}: {day.lines}"
        day.fish().link.run(STOP_S)
        assert not day.board.world.truth().swimming, f"wait {n}"
        day.require_goes_on()


@pytest.mark.parametrize(
    ("where", "after"),
    [
        ("tailbeat.session.series.countdown", True),  # armed
        ("tailbeat.session.trial._command_start", False),
        ("tailbeat.session.trial._command_start", True),  # it swims, and nobody knows
        ("tailbeat.session.trial._step", False),
        ("tailbeat.session.decide.Decisions.decide", False),  # swum, and nobody has decided
    ],
)
def test_ctrl_c_at_the_worst_moments(
    day: BadDay, monkeypatch: pytest.MonkeyPatch, where: str, after: bool
) -> None:
    real = pkgutil.resolve_name(where)
    pressed: list[str] = []
    with monkeypatch.context() as patch:

        def press(*given: Any, **named: Any) -> Any:
            first = not pressed
            pressed.append(where)
            if after or not first:
                result = real(*given, **named)
            if first:
                raise KeyboardInterrupt
            return result

        patch.setattr(where, press)
        status, _ = day.says(*KEEP)
    assert pressed and status == 130, day.lines
    assert sum("stopped by" in line for line in day.lines) == 1, day.lines
    day.fish().link.run(STOP_S)
    assert not day.board.world.truth().swimming
    day.require_goes_on()


@pytest.mark.parametrize("presses", [1, 2])
@pytest.mark.parametrize("beat", [-0.4, 4])
def test_ctrl_c_in_mid_swim(day: BadDay, beat: int, presses: int) -> None:
    """In the first beat, when nothing is measured yet, and later; once, and by an impatient one."""

    def press() -> None:
        if presses == 2:
            day.tank.interrupt_at = day.tank.waits + 2
        raise KeyboardInterrupt

    day.goes_wrong(beat, press)
    status, document = day.says(*KEEP)
    assert status == 130 and document["why"] == "interrupted"
    assert day.lines[0] == "tailbeat: Ctrl-C: the tail is being stopped"
    words_of(
        "trial 1 was stopped by hand" if presses == 1 else "stopped by Ctrl-C; nothing is lost",
        "by hand" if presses == 1 else "the same command goes on",
        day.lines,
    )
    day.require_stopped_within(0.5)
    day.require_goes_on()


# the disk


class FullFile(io.FileIO):
    """Can be made, but takes nothing."""

    def write(self, content: Any) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.name))


class FullDisk:
    """No space left on device, at the n-th of all steps that need some below a folder; 0 = never.
    ``steps``: (what, path)."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, folder: Path, at: int = 0) -> None:
        self.steps: list[tuple[str, Path]] = []
        self._folder, self._at = folder, at
        self._open, self._os_open, self._write = io.open, os.open, os.write
        self._fsync, self._replace = os.fsync, os.replace
        for module, name, stand_in in (
            (io, "open", self.open), (builtins, "open", self.open), (os, "open", self.os_open),
            (os, "write", self.write), (os, "fsync", self.fsync), (os, "replace", self.replace),
        ):  # fmt: skip
            monkeypatch.setattr(module, name, stand_in)

    def _needs(self, what: str, path: object) -> bool:
        where = Path(str(path)).absolute()
        if self._folder not in where.parents:
            return False
        self.steps.append((what, where))
        return len(self.steps) == self._at

    def _take(self, what: str, path: object) -> None:
        if self._needs(what, path):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    def open(self, file: Any, mode: str = "r", *rest: Any, **named: Any) -> Any:
        if not isinstance(file, str | Path) or not set(mode) & set("wax+"):
            return self._open(file, mode, *rest, **named)
        self._take("open", file)
        if not self._needs("write", file):
            return self._open(file, mode, *rest, **named)
        binary = io.BufferedWriter(FullFile(file, mode.replace("b", "")))
        return binary if "b" in mode else io.TextIOWrapper(binary, encoding="utf-8")

    def os_open(self, path: Any, flags: int, *rest: Any, **named: Any) -> int:
        if flags & (os.O_WRONLY | os.O_RDWR):
            self._take("open", path)
        return self._os_open(path, flags, *rest, **named)

    def write(self, descriptor: int, content: bytes) -> int:
        self._take("write", Path(f"/proc/self/fd/{descriptor}").readlink())
        return self._write(descriptor, content)

    def fsync(self, descriptor: int) -> None:
        self._take("fsync", Path(f"/proc/self/fd/{descriptor}").readlink())
        self._fsync(descriptor)

    def replace(self, old: Any, new: Any, **named: Any) -> None:
        self._take("replace", new)
        self._replace(old, new, **named)


linux = pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs names of open files")

WHERE = {
    "the pulled log": ".pulling/0001.ulg",
    "the camera's positions": ".pulling/0001_positions.csv",
    "raw": "raw/0001.ulg",
    "the journal": "journal.jsonl",
    "the copy of the board's state": "board/state.json",
    "redo": "redo.md",
}


def require_full_disk(
    day: BadDay, monkeypatch: pytest.MonkeyPatch, at: int, *words: object
) -> None:
    with monkeypatch.context() as patch:
        full = FullDisk(patch, Path("experiments").resolve(), at)
        status, document = day.says(*words)
    step = full.steps[at - 1] if len(full.steps) >= at else None
    assert status == 1 and document is None, f"{step}: {status}"
    day.lines = [line for line in day.lines if "ROLLED BACK" not in line]
    assert len(day.lines) == 1, f"{step}: {day.lines}"
    words_of("No space left on device", "oom", day.lines)
    assert str(day.experiment().folder.name) in day.lines[0], "which disk, which file"
    assert "another place" not in day.lines[0], "there is none for this file"


@linux
@pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.soak)])
def test_the_disk_is_full(
    fresh: Callable[[], BadDay], monkeypatch: pytest.MonkeyPatch, every: bool
) -> None:
    """At one step of every file; ``every``: at every step."""
    whole = fresh()
    with monkeypatch.context() as patch:
        disk = FullDisk(patch, Path("experiments").resolve())
        assert whole.says(*KEEP)[0] == 0
    for at in range(1, len(disk.steps) + 1) if every else one_of_each(disk.steps):
        day = fresh()
        require_full_disk(day, monkeypatch, at, *KEEP)
        day.require_goes_on()


def one_of_each(steps: list[tuple[str, Path]]) -> list[int]:
    """The last step of every file, of another kind for each."""
    found = []
    for turn, ending in enumerate(WHERE.values()):
        kind = ("open", "write", "fsync", "replace")[turn % 4]
        of_it = [at for at, (_, path) in enumerate(steps, 1) if ending in str(path)]
        assert of_it, f"{ending} is not written any more"
        found.append(([at for at in of_it if steps[at - 1][0] == kind] or of_it)[-1])
    return found


@linux
@pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.soak)])
def test_no_room_for_the_report(day: BadDay, monkeypatch: pytest.MonkeyPatch, every: bool) -> None:
    assert day.says(*KEEP)[0] == 0
    folder = day.experiment().folder
    for at in itertools.count(1) if every else [1]:
        with monkeypatch.context() as patch:
            disk = FullDisk(patch, Path("experiments").resolve(), at)
            status = run(["report", str(folder)])
        out, err = day.capsys.readouterr()
        if len(disk.steps) < at:
            break
        assert (status, out) == (1, ""), f"{disk.steps[at - 1]}"
        assert err.count("\n") == 1 and "No space left on device" in err, err
        assert "free space" in err or "oom" in err or "elsewhere" in err or "lace" in err, err
    day.require_goes_on()
