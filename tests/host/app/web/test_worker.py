"""The thread behind the page: what it shows, what it takes, and that ABORT overtakes. The board is
simulated in this process; its time passes only while the worker waits, so that what happens at a
beat happens at that beat on every machine."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tailbeat.app.web.inbox import Ask, Asks
from tailbeat.app.web.state import PageState
from tailbeat.app.web.view import next_line
from tailbeat.app.web.worker import Worker, simulated_camera
from tailbeat.board.fish import Fish
from tailbeat.core.errors import ConnectError, InputError, LinkLostError
from tailbeat.core.reference import from_text
from tailbeat.core.speed_source import Frame
from tailbeat.experiment.library import FOLDER_VARIABLE
from tailbeat.experiment.store import Journal
from tailbeat.link import _dialect as mavlink
from tailbeat.link.messages import BeatEvent
from tailbeat.sensors.camera.render.source import SimulatedCamera
from tailbeat.session.preflight_step import PreflightLimits
from tailbeat.session.series import SeriesEnd
from tailbeat.sim.board import SimBoard, SimTransport

SHORT = "trapezoid:0.06,2,4"  # 8 beats
PATIENCE_S = 600.0  # wall time; a bound on what hangs, never waited for when all is well


@pytest.fixture(autouse=True)
def _library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "fish"))


class Line(SimTransport):
    """The radio of the board, which can be cut."""

    cut = False

    def read(self) -> bytes:
        if self.cut:
            raise LinkLostError("the cable is out.", "Put it in.")
        return super().read()


class Tank:
    """A board that outlives its connections, and a worker that was asked for it."""

    def __init__(self, root: Path, board: SimBoard | None = None) -> None:
        self.board = board or SimBoard("tank", seed=1)
        self.lines: list[Line] = []
        self.gate: Callable[[], None] = lambda: None
        self.at_start: Callable[[], None] = lambda: None
        self.on_beat: Callable[[int], None] = lambda beat: None
        self.worker = Worker(self.connect, root, self.open_camera, look_s=0.005, retry_s=0.0)

    def connect(self) -> Fish:
        self.gate()
        self.lines.append(Line(self.board))
        fish = Fish(self.lines[-1])
        fish.clock.sync()
        return fish

    @contextmanager
    def open_camera(self, fish: Fish) -> Iterator[Any]:
        self.at_start()
        with simulated_camera(fish) as (camera, _):
            yield camera, self._guard

    def _guard(self, seen: object) -> None:
        if isinstance(seen, BeatEvent):
            self.on_beat(seen.beat)

    def wait(self, until: Callable[[PageState], bool]) -> PageState:
        return self.worker.screen.wait(until, PATIENCE_S)

    def ask(self, what: str, **values: Any) -> PageState:
        """Until it is done, or something has to be decided first."""
        done, was = self.worker.now.done, self.worker.now.recorded
        self.worker.ask(what, **values)
        return self.wait(
            lambda now: (
                now.done > done
                or (now.recorded is not None and was is None)
                or now.phase == "failed"
            )
        )

    def decide(self, kind: str, reason: str = "") -> PageState:
        return self.ask("decide", kind=kind, reason=reason)

    def journal(self, what: str) -> list[dict[str, Any]]:
        folder = self.worker.root / self.worker.now.experiment
        return Journal(folder / "journal.jsonl").entries(what)


@pytest.fixture
def tank(tmp_path: Path) -> Iterator[Tank]:
    made = Tank(tmp_path / "experiments")
    yield made
    made.worker.close()


@pytest.fixture
def ready(tank: Tank) -> Tank:
    """Connected, with a reference."""
    tank.worker.start()
    tank.wait(lambda now: now.phase == "idle")
    now = tank.ask("upload", reference=from_text(SHORT))
    assert (now.problem, len(now.reference_m_s)) == ("", 8)
    return tank


def test_it_connects_and_says_to_what(tank: Tank) -> None:
    tank.worker.start()
    now = tank.wait(lambda now: now.phase == "idle")
    assert (now.board, now.simulated, now.state) == ("simulated", True, "IDLE")
    assert now.battery_v == pytest.approx(8.2)
    assert now.next_trial == 1
    assert now.imu_well is False  # it has only just been switched on


def test_a_swim_from_the_preflight_to_what_was_learned(ready: Tank) -> None:
    now = ready.ask("swim", until="1", preflight=True)
    assert (now.phase, now.recorded and now.recorded.outcome.end) == ("deciding", "complete")
    assert None not in now.speed_m_s
    assert [row.decision for row in now.rows] == [""]
    now = ready.decide("keep")
    assert (now.phase, now.problem, now.iteration, now.next_trial) == ("idle", "", 2, 2)
    assert [(row.decision, row.learned) for row in now.rows] == [("keep", True)]
    assert now.assessment
    assert any("still" in line for line in now.log)
    assert ready.wait(lambda now: now.imu_well is True).imu.startswith("VN-100")


def test_steps_of_the_preflight_are_shown_in_their_order(ready: Tank) -> None:
    seen: list[tuple[str, ...]] = []
    ready.on_beat = lambda beat: seen.append(tuple(s.step for s in ready.worker.now.steps))
    ready.ask("swim", until="1", preflight=True)
    assert seen[0] == tuple(dict.fromkeys(seen[0]))
    assert {"rest", "room", "pose"} <= set(seen[0]) or len(seen[0]) >= 3
    assert all(step.ok for step in ready.worker.now.steps)


def test_abort_in_the_middle_of_a_swim(ready: Tank) -> None:
    def press(beat: int) -> None:
        if beat == 3:
            ready.worker.ask("abort")

    ready.on_beat = press
    now = ready.ask("swim", until="10", preflight=False)
    assert (now.phase, now.state) == ("deciding", "ABORTED")
    assert now.recorded is not None
    assert now.recorded.outcome.end == "aborted:ABORT_COMMAND"
    assert now.recorded.outcome.executed_beats < 8
    assert ready.board.world.truth().pulse_ticks == 0
    with pytest.raises(InputError, match="needs a reason"):
        ready.worker.ask("decide", kind="discard")
    now = ready.decide("discard", "bumped the wall")
    assert (now.phase, now.iteration, now.next_trial) == ("idle", 1, 2)
    assert [(row.decision, row.reason) for row in now.rows] == [("discard", "bumped the wall")]
    assert [entry["reason"] for entry in ready.journal("decided")] == ["bumped the wall"]
    assert ready.board.world.truth().swims == 1  # the other nine were not begun


def test_one_swim_is_one_swim_whatever_becomes_of_it(ready: Tank) -> None:
    ready.ask("swim", until="1", preflight=False)
    assert ready.decide("repeat", "to see the noise").phase == "idle"
    ready.ask("swim", until="1", preflight=False)
    assert ready.decide("discard", "a wave").phase == "idle"
    assert ready.board.world.truth().swims == 2


def test_the_next_swim_is_not_stopped_by_an_old_abort(ready: Tank) -> None:
    ready.on_beat = lambda beat: ready.worker.ask("abort") if beat == 2 else None
    ready.ask("swim", preflight=False)
    ready.decide("discard", "stopped")
    ready.on_beat = lambda beat: None
    now = ready.ask("swim", preflight=False)
    assert now.recorded is not None
    assert now.recorded.outcome.end == "complete"


def test_abort_before_the_start_ends_the_waiting(ready: Tank) -> None:
    ready.at_start = lambda: ready.worker.ask("abort")
    now = ready.ask("swim", preflight=True)
    assert (now.phase, now.state, now.next_trial, now.rows) == ("idle", "IDLE", 1, ())
    assert ready.board.world.truth().swims == 0


def test_abort_while_connecting_is_the_first_thing_said(tank: Tank) -> None:
    somebody = Fish(SimTransport(tank.board))
    somebody.clock.sync()
    somebody.upload_reference(from_text("trapezoid:0.06,5,25"))
    somebody.arm()
    start = mavlink.TAILBEAT_CMD_TRIAL_START
    somebody.link.command(start, 1.0, somebody.clock.now_s())
    somebody.link.run(3.0)
    assert somebody.status().state == "RUNNING"
    trying, go = threading.Event(), threading.Event()

    def gate() -> None:
        trying.set()
        assert go.wait(PATIENCE_S)

    tank.gate = gate
    tank.worker.start()
    assert trying.wait(PATIENCE_S)
    assert tank.worker.now.phase == "connecting"
    tank.worker.ask("abort")
    begun_s = tank.board.time_s
    go.set()
    now = tank.wait(lambda now: now.phase == "idle")
    assert now.state == "ABORTED"
    assert now.fault
    assert tank.board.time_s - begun_s < 10.0  # 30 beats would have been executed otherwise
    tank.wait(
        lambda now: tank.board.world.truth().pulse_ticks == 0
    )  # the coast to the centre is over


def test_an_abort_that_nobody_answers_is_sent_again(
    ready: Tank, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The radio is dead at the wrong moment: the request outlives the connection."""
    real, sent = Fish.abort, []

    def abort(fish: Fish, wall: bool = False) -> None:
        sent.append(fish)
        if len(sent) == 1:
            raise LinkLostError("the board does not answer", "Move the antenna.")
        real(fish, wall)

    monkeypatch.setattr(Fish, "abort", abort)
    ready.worker.ask("abort")
    now = ready.wait(lambda now: now.phase == "idle" and any("stopped" in line for line in now.log))
    assert len(sent) == 2 and sent[0] is not sent[1]
    assert any("does not answer" in line for line in now.log)
    assert not ready.worker.wants_abort


def test_abort_says_no_to_a_question(ready: Tank, monkeypatch: pytest.MonkeyPatch) -> None:
    """A board that was switched off may have a fish that shifted: nobody says yes by ABORT."""
    answers: list[bool] = []

    def series(fish: Fish, experiment: object, operator: Any, *_: object) -> SeriesEnd:
        answers.append(operator.confirm("go on?"))
        return SeriesEnd("stopped", "not now.", [], None)

    monkeypatch.setattr("tailbeat.session.proposals.run_series", series)
    ready.worker.ask("swim", preflight=False)
    ready.wait(lambda now: now.phase == "asking" and now.question == "go on?")
    done = ready.worker.now.done
    ready.worker.ask("abort")
    now = ready.wait(lambda now: now.done > done)
    assert (answers, now.phase, now.question, now.problem) == ([False], "idle", "", "not now.")


def test_a_number_that_is_none_is_asked_for_again(
    ready: Tank, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers: list[float | None] = []

    def series(fish: Fish, experiment: object, operator: Any, *_: object) -> SeriesEnd:
        answers.append(operator.number("To allow it, type", 0.67))
        return SeriesEnd("stopped", "not now.", [], None)

    monkeypatch.setattr("tailbeat.session.proposals.run_series", series)
    ready.worker.ask("swim", preflight=False)
    ready.wait(lambda now: now.phase == "asking" and now.question.endswith("0.67."))
    ready.worker.ask("answer", yes=True, typed="much")
    ready.wait(lambda now: "'much' is no number" in now.question)
    done = ready.worker.now.done
    ready.worker.ask("answer", yes=True, typed="0,67")
    ready.wait(lambda now: now.done > done)
    assert answers == [0.67]


def test_parameters_that_are_shown_are_read_again_after_a_job(ready: Tank) -> None:
    ready.ask("params")
    fish = Fish(SimTransport(ready.board))
    fish.params.set("ILC_GAIN", 5.0)
    now = ready.ask("upload", reference=from_text(SHORT))
    assert next(p.value for p in now.params if p.name == "ILC_GAIN") == 5.0


def test_what_stopped_it_is_shown_until_it_is_cleared(ready: Tank) -> None:
    ready.board.world.set_tilt_rad(1.4)
    now = ready.ask("swim", preflight=False)
    while now.phase in ("deciding", "asking"):
        ready.board.world.set_tilt_rad(0.0)
        now = (
            ready.decide("discard", "lifted out")
            if now.recorded
            else ready.ask("answer", yes=False)
        )
    assert now.problem or now.fault
    if now.state in ("ABORTED", "FAULT"):
        assert now.fault
        now = ready.ask("clear")
    assert (now.state, now.fault) == ("IDLE", "")


def test_whoever_decides_first_decides(ready: Tank) -> None:
    ready.ask("swim", preflight=False)
    outcomes: list[str] = []
    start = threading.Barrier(4)

    def browser(number: int) -> None:
        start.wait()
        try:
            ready.worker.ask("decide", kind="discard", reason=f"by {number}")
            outcomes.append(f"by {number}")
        except InputError as error:
            assert "decided already" in str(error)

    done = ready.worker.now.done
    browsers = [threading.Thread(target=browser, args=(number,)) for number in range(4)]
    for thread in browsers:
        thread.start()
    for thread in browsers:
        thread.join()
    assert len(outcomes) == 1
    now = ready.wait(lambda now: now.done > done)
    assert [row.reason for row in now.rows] == outcomes


def test_the_second_of_two_wishes_hears_that_it_is_late() -> None:
    """Also when nobody has had time to look at the first."""
    asks = Asks()
    asks.open("decide", "note")
    asks.offer(Ask("decide", {"kind": "keep"}))
    with pytest.raises(InputError, match="decided already"):
        asks.offer(Ask("decide", {"kind": "discard"}))
    asks.offer(Ask("note", {"text": "one"}))
    asks.offer(Ask("note", {"text": "two"}))
    first = asks.take("decide")
    assert first is not None
    assert first.values == {"kind": "keep"}
    asks.open("swim")
    asks.offer(Ask("swim"))
    assert asks.open("decide") == [Ask("swim")]  # what nobody took is dropped, but for notes
    assert [asks.take() is not None for _ in range(3)] == [True, True, False]


def test_what_makes_no_sense_now_is_refused(ready: Tank) -> None:
    ask = ready.worker.ask
    with pytest.raises(InputError, match="nothing to decide"):
        ask("decide", kind="keep")
    with pytest.raises(InputError, match="note is empty"):
        ask("note", text=" ")
    with pytest.raises(InputError, match="says no end"):
        ask("swim", until="for ever")
    with pytest.raises(InputError, match="nothing to ask for"):
        ask("dance")
    refused: list[str] = []

    def press_again(beat: int) -> None:
        for what, values in (("swim", {}), ("upload", {"reference": None}), ("clear", {})):
            try:
                ask(what, **values)
            except InputError:
                refused.append(what)

    ready.on_beat = lambda beat: press_again(beat) if beat == 1 else None
    ready.ask("swim", preflight=False)
    assert refused == ["swim", "upload", "clear"]


def test_notes_and_pictures_are_taken_while_it_waits_for_a_decision(
    ready: Tank, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A camera that nobody reads from is cut off by its program after a while."""
    frames, read_in = SimulatedCamera.frames, set[str]()

    def read(camera: SimulatedCamera) -> list[Frame]:
        read_in.add(ready.worker.now.phase)
        return frames(camera)

    monkeypatch.setattr(SimulatedCamera, "frames", read)
    ready.ask("swim", preflight=False)
    ready.worker.ask("note", text="water 22 degrees")
    ready.wait(lambda now: any("water 22 degrees" in line for line in now.log))
    assert [entry["text"] for entry in ready.journal("note")] == ["water 22 degrees"]
    assert ready.worker.now.phase == "deciding" and "deciding" in read_in


def test_a_note_before_the_first_swim_waits_for_the_experiment(tmp_path: Path) -> None:
    """On disk: also for the next time, if nothing is executed today."""
    board = SimBoard("tank", seed=1)
    for text in ("water 21 degrees", "fish was repaired"):
        before = Tank(tmp_path / "experiments", board)
        before.worker.start()
        before.wait(lambda now: now.phase == "idle")
        now = before.ask("note", text=text)
        assert (now.problem, now.experiment) == ("", "")
        assert text in now.log[-1]
        before.worker.close()
    (waiting,) = (tmp_path / "experiments").glob("notes-*.jsonl")
    written = [entry["time"] for entry in Journal(waiting).entries("note")]
    tank = Tank(tmp_path / "experiments", board)
    tank.worker.start()
    tank.wait(lambda now: now.phase == "idle")
    tank.ask("upload", reference=from_text(SHORT))
    tank.ask("swim", preflight=False)
    tank.decide("keep")
    found = [(entry["text"], entry["time"]) for entry in tank.journal("note")]
    assert found == [("water 21 degrees", written[0]), ("fish was repaired", written[1])]
    assert not waiting.exists()
    tank.worker.close()


def test_a_note_that_cannot_be_written_stops_nothing(
    ready: Tank, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise InputError("the disk is full.", "Make room.")

    ready.ask("swim", preflight=False)
    monkeypatch.setattr("tailbeat.experiment.folder.Experiment.note", full)
    ready.worker.ask("note", text="water 22 degrees")
    ready.wait(lambda now: "disk is full" in now.problem)
    assert ready.decide("keep").iteration == 2


def test_a_link_that_is_lost_comes_back(ready: Tank) -> None:
    ready.ask("swim", preflight=False)
    ready.decide("keep")
    name = ready.worker.now.experiment
    tries: list[int] = []
    go = threading.Event()

    def gate() -> None:
        tries.append(1)
        if len(tries) == 1:
            raise ConnectError("nobody answers.", "Switch it on.")
        assert go.wait(PATIENCE_S)

    ready.gate = gate
    ready.lines[-1].cut = True
    now = ready.wait(lambda now: now.phase == "connecting" and "nobody" in now.problem)
    assert now.problem == "nobody answers. Switch it on."
    with pytest.raises(InputError, match="none can start now"):
        ready.worker.ask("swim")
    go.set()
    now = ready.wait(lambda now: now.phase == "idle")
    assert (now.problem, now.experiment, len(now.rows)) == ("", name, 1)
    assert ready.ask("swim", preflight=False).recorded is not None


def test_a_link_lost_while_deciding_keeps_the_decision(ready: Tank) -> None:
    ready.ask("swim", preflight=False)
    ready.lines[-1].cut = True
    connected = len(ready.lines)
    ready.worker.ask("decide", kind="keep")
    now = ready.wait(lambda now: now.phase == "idle" and len(ready.lines) > connected)
    assert now.pending == 1
    assert ready.journal("decided")[-1]["decision"] == "keep"
    now = ready.ask("swim", preflight=False)  # the old one is settled without asking again
    assert now.recorded is not None
    assert now.recorded.outcome.number == 2
    assert now.rows[0].learned


def test_closing_in_the_middle_of_a_swim_stops_the_tail(ready: Tank) -> None:
    ready.on_beat = lambda beat: ready.worker._asks.close() if beat == 2 else None
    ready.worker.ask("swim", preflight=False)
    ready.worker._thread.join(PATIENCE_S)
    assert not ready.worker._thread.is_alive()
    assert ready.board.world.truth().pulse_ticks == 0
    fish = Fish(SimTransport(ready.board))
    fish.clock.sync()
    status = fish.status()
    assert (status.state, status.pending_trial) == ("ABORTED", 1)
    assert status.beat < 8
    raw = ready.worker.root / ready.worker.now.experiment / "raw" / "0001.ulg"
    assert raw.read_bytes() == fish.ftp.read("/trials/0001.ulg")


def test_a_board_that_starts_again_is_greeted_anew(ready: Tank) -> None:
    greeted = sum("connected to" in line for line in ready.worker.now.log)
    ready.board.world.power_cycle()
    now = ready.wait(lambda now: sum("connected to" in s for s in now.log) > greeted)
    assert any("restarted" in line for line in now.log)
    now = ready.wait(lambda now: now.phase == "idle")
    assert (len(now.reference_m_s), now.problem) == (8, "")


def moved_on(question: str, now: PageState) -> bool:
    return now.phase == "idle" or (now.phase == "asking" and now.question != question)


@pytest.mark.parametrize(("commission", "phase"), [("new", "asking"), ("never", "deciding")])
def test_a_board_that_has_lost_all_gets_it_back_by_start(
    ready: Tank, commission: str, phase: str
) -> None:
    """Guided, before anything is asked, or not: nothing is begun anew in silence."""
    ready.ask("swim", preflight=False)
    kept = ready.decide("keep")
    ready.board = SimBoard("tank", seed=1)  # the same fish, with nothing in its memory
    connected = len(ready.lines)
    ready.lines[-1].cut = True
    now = ready.wait(lambda now: now.phase == "idle" and len(ready.lines) > connected)
    assert "lost its reference" in next_line(now) and "START restores" in next_line(now)
    assert (now.reference_m_s, now.experiment, now.problem) == ((), kept.experiment, "")
    ready.worker.ask("swim", preflight=False, commission=commission)
    now = ready.wait(lambda now: now.phase in ("asking", "deciding") or now.done > kept.done)
    assert (now.phase, now.iteration) == (phase, 2), now.problem
    assert any("all it had learned" in line for line in now.log)
    if phase == "asking":
        question = now.question
        ready.worker.ask("answer", yes=True)
        now = ready.wait(lambda now: now.phase == "asking" and now.question != question)
        assert f"is {from_text(SHORT).name}" in next(
            one.words for one in now.guide if one.name == "tank"
        )
        for _ in range(2):  # without the trim it goes on to measuring
            ready.worker.ask("answer", yes=False)
            now = ready.wait(partial(moved_on, now.question))
        assert now.phase == "idle"
    assert (now.reference_m_s, now.experiment) == (kept.reference_m_s, kept.experiment)


def test_a_reference_that_does_not_fit_is_refused(ready: Tank) -> None:
    now = ready.ask("upload", reference=from_text("trapezoid:0.1,5,60"))
    assert "tank has 3.00 m" in now.problem
    assert (now.phase, len(now.reference_m_s)) == ("idle", 8)
    assert ready.ask("upload", reference=from_text(SHORT)).problem == ""


def test_silence_is_told_by_the_wall_clock(tank: Tank) -> None:
    clock = [100.0]
    tank.worker.wall_s = lambda: clock[0]
    assert tank.worker.silent_s() is None
    tank.worker.start()
    tank.wait(lambda now: now.phase == "idle")
    tank.board.world.set_radio(False)
    done = tank.worker.now.done
    tank.worker.ask("clear")  # a round trip that nothing comes back of
    clock[0] = 107.0
    tank.wait(lambda now: now.done > done or now.phase == "connecting")
    assert tank.worker.silent_s() == pytest.approx(7.0)
    tank.board.world.set_radio(True)


def test_only_listed_logs_are_given_out(ready: Tank) -> None:
    ready.ask("swim", preflight=False)
    assert ready.worker.trials.raw_file("0001.ulg") is not None
    for name in ("SHA256SUMS", "../settings.json", "reference.bin", "0002.ulg", ""):
        assert ready.worker.trials.raw_file(name) is None


def test_the_preflight_may_be_set(tmp_path: Path) -> None:
    tank = Tank(tmp_path / "experiments")
    tank.worker.limits = PreflightLimits(rest_s=0.0, still_s=2.0, countdown_s=1.0)
    tank.worker.start()
    tank.wait(lambda now: now.phase == "idle")
    tank.ask("upload", reference=from_text(SHORT))
    now = tank.ask("swim", preflight=True)
    assert any("over 2 s" in line for line in now.log)
    tank.worker.close()
