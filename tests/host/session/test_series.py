"""A series of trials: what is kept in which order, how it ends, and that nothing is ever lost."""

from __future__ import annotations

import errno
import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core.errors import InputError, Refused, TailbeatError
from tailbeat.core.reference import thesis
from tailbeat.core.speed_source import CameraGone, Frame
from tailbeat.core.trial_file import read_trial
from tailbeat.experiment.current import begin, note_set
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import DISCARDED, TrialLibrary
from tailbeat.link.messages import BeatEvent, LearnReport
from tailbeat.sensors.camera.render.source import SimulatedCamera
from tailbeat.session import series as series_module
from tailbeat.session.events import (
    Assessed,
    Countdown,
    Event,
    InterruptRequested,
    LinkLost,
    LinkRestored,
    LiveValues,
    Notice,
    TrialDecided,
    TrialEnded,
    TrialRecorded,
    TrialStarted,
    TrialWarning,
)
from tailbeat.session.log import Drain, SessionLog, forecast, too_low
from tailbeat.session.options import Options, Until
from tailbeat.session.outcome import KINDS, Decision, RecordedTrial
from tailbeat.session.preflight_step import GivenUp
from tailbeat.session.series import SeriesEnd, run_series
from tailbeat.session.status import status_of
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport
from tailbeat.studies.montecarlo.populations import draw

KEEP, AGAIN = Decision("keep"), Decision("repeat", "once more")
BUMPED = Decision("discard", "bumped the wall")
SPEEDS = 0.07 * np.sin(np.linspace(0.2, 2.9, 6))


E = TypeVar("E")


class Script:
    """Somebody who knows beforehand what to say, and keeps what was told."""

    def __init__(self, *answers: Decision, abort_beat: int | None = None) -> None:
        self.answers = list(answers)
        self.abort_beat = abort_beat
        self.yes = True
        self.told: list[Event] = []
        self.asked: list[int] = []
        self.questions: list[str] = []
        self._beat = -1

    def tell(self, event: Event) -> None:
        self.told.append(event)
        if isinstance(event, BeatEvent):
            self._beat = event.beat
        elif isinstance(event, TrialRecorded):
            self._beat = -1

    def wants_abort(self) -> bool:
        return self.abort_beat is not None and self._beat >= self.abort_beat

    def decide(self, recorded: RecordedTrial) -> Decision:
        self.asked.append(recorded.outcome.number)
        if self.answers:
            return self.answers.pop(0)
        return KEEP if recorded.measured_beats else Decision("discard", "did not swim")

    def confirm(self, question: str) -> bool:
        self.questions.append(question)
        return self.yes

    def number(self, question: str, value: float) -> float | None:
        return value

    def of(self, kind: type[E]) -> list[E]:
        return [event for event in self.told if isinstance(event, kind)]


@pytest.fixture
def board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SimBoard:
    """A fish with a reference that always connects again as the same."""
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "logbook"))
    simulated = SimBoard("tank", seed=1)
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: SimTransport(simulated))
    with Fish.connect("it") as fish:
        fish.params.set("ILC_LEAD", 1)
        fish.upload_reference(records.encode_reference(1.0, SPEEDS))
    return simulated


@pytest.fixture
def fish(board: SimBoard) -> Iterator[Fish]:
    with Fish.connect("it") as connected:
        yield connected


@pytest.fixture
def experiment(fish: Fish, tmp_path: Path) -> Experiment:
    return begin(fish, tmp_path / "experiments")


@pytest.fixture
def trial(fish: Fish, experiment: Experiment) -> Callable[..., SeriesEnd]:
    """A series without preflight checks."""

    def call(operator: Script, trials: int | None = 1, **options: Any) -> SeriesEnd:
        options = {"until": Until(trials), "wanted": None, **options}
        return run_series(fish, experiment, operator, Options(**options))

    return call


def kinds(experiment: Experiment) -> list[str]:
    return [entry["what"] for entry in experiment.journal.entries()]


def set_meant(fish: Fish, experiment: Experiment, name: str, value: float) -> None:
    """As 'params set' does it for a fish that is in the experiment."""
    note_set(fish, {name: fish.params.set(name, value).value}, experiment)


def at_rest(fish: Fish, board: SimBoard) -> bool:
    """Not armed, the tail still within the stop's own time. (Only some seconds later a trial that
    was cut is pending.)"""
    fish.link.run(1.5)
    still = not board.world.truth().swimming and fish.status().state not in ("ARMED", "RUNNING")
    fish.link.run(5.0)
    return still


def require_nothing_lost(fish: Fish, experiment: Experiment) -> None:
    """Every trial that the board has is pending, or both in the raw files and in the journal."""
    assert experiment.damaged() == []
    known = {entry["trial"] for entry in experiment.journal.entries("swum")}
    files = {trial.number for trial in experiment.trials()}
    pending = fish.status().pending_trial
    for trial in fish.trials():
        assert trial.number == pending or trial.number in known & files


# until


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("converged", Until(None, converged=True)),
        ("battery", Until(None)),
        (" 12 ", Until(12)),
        ("1", Until(1)),
    ],
)
def test_until(text: str, wanted: Until) -> None:
    assert Until.parse(text) == wanted


@pytest.mark.parametrize("text", ["", "0", "-1", "1.5", "soon", "1000", "²"])
def test_no_end(text: str) -> None:
    with pytest.raises(InputError, match="converged, battery or a number"):
        Until.parse(text)


# the order of a round


def test_a_kept_swim_is_in_the_raw_files_the_journal_the_library_and_learned(
    trial: Callable[..., SeriesEnd], fish: Fish, experiment: Experiment
) -> None:
    operator = Script(KEEP)
    end = trial(operator)
    assert end.why == "swims" and end.records[0].outcome.end == "complete"
    assert [path.name for path in experiment.trial_files()] == ["0001.ulg"]
    assert kinds(experiment)[-5:] == ["begun", "swum", "decided", "learned", "input"]
    assert fish.status().last_learned_trial == 1 and fish.status().pending_trial is None
    assert len(TrialLibrary.of(fish.unique_id()).kept()[0]) == 1
    assert end.verdict is not None and end.verdict.kind == "first"
    report = end.rounds[0].learned
    assert report is not None
    assert report.max_abs_error_m_s == pytest.approx(end.records[0].max_abs_error_m_s, rel=1e-5)
    told = [type(event) for event in operator.told]
    shown = [(one.beat, one.reference_m_s) for one in operator.of(LiveValues) if one.beat]
    assert shown == [(beat, pytest.approx(SPEEDS[beat])) for beat, _ in shown] != []
    order = [TrialStarted, TrialEnded, TrialRecorded, TrialDecided, LearnReport, Assessed]
    assert [told.index(kind) for kind in order] == sorted(told.index(kind) for kind in order)


def test_only_kept_swims_count(
    trial: Callable[..., SeriesEnd], fish: Fish, experiment: Experiment
) -> None:
    end = trial(Script(AGAIN, BUMPED, KEEP, KEEP), trials=2)
    assert [one.decision.kind for one in end.rounds] == ["repeat", "discard", "keep", "keep"]
    iterations = [recorded.outcome.iteration for recorded in end.records]
    assert iterations == [1, 1, 1, 2]
    assert fish.status().iteration == 3
    first, second = (read_trial(end.records[k].file).beats.applied_rad for k in (0, 2))
    assert np.array_equal(first, second)
    marks = [kept.mark for kept in TrialLibrary.of(fish.unique_id()).kept()[0]]
    assert marks == ["", DISCARDED, "", ""]
    decided = [(e["decision"], e["reason"]) for e in experiment.journal.entries("decided")]
    assert decided == [
        ("repeat", "once more"), ("discard", "bumped the wall"), ("keep", ""), ("keep", "")
    ]  # fmt: skip


def test_the_verdict_knows_repeats_and_no_discarded_swim(trial: Callable[..., SeriesEnd]) -> None:
    end = trial(Script(BUMPED, KEEP))
    assert end.verdict is not None and end.verdict.kind == "first"
    end = trial(Script(AGAIN, KEEP))
    assert end.verdict is not None and end.verdict.kind != "first"


def test_a_repeat_is_one_also_by_the_next_command(
    fish: Fish, experiment: Experiment, trial: Callable[..., SeriesEnd]
) -> None:
    """Though a model that predicts the fish would plan another input meanwhile."""
    for answer in (AGAIN, BUMPED, KEEP, KEEP):
        trial(Script(answer), counts=KINDS)
    trials = [one.trial for one in SessionLog(experiment).executed()[0]]
    inputs = [one.beats.amplitude_rad.tolist() for one in trials]
    assert inputs[0] == inputs[1] == inputs[2] != inputs[3]
    why = [entry["why"] for entry in experiment.journal.entries("input")]
    assert "the input of trial 1 once more, as it was decided" in why


def test_a_trial_with_more_in_its_log_later_counts_once(
    fish: Fish, experiment: Experiment, trial: Callable[..., SeriesEnd]
) -> None:
    """Speeds may be uploaded once it is kept: the log grows, and is pulled again."""
    trial(Script())
    trial(Script(), learn=False)
    account, raw = SessionLog(experiment), experiment.raw / "0002.ulg"
    grown = raw.with_name("0002-2.ulg")
    grown.write_bytes(raw.read_bytes() + raw.read_bytes()[-1:])
    entries = {what: experiment.journal.entries(what)[-1] for what in ("swum", "decided")}
    before = len(account.drains())
    for what, entry in entries.items():
        values = {name: entry[name] for name in entry if name not in ("what", "time")}
        experiment.journal.add(what, **(values | {"file": grown.name}))
    assert [one.number for one in account.counting()] == [1, 2]
    assert len(account.drains()) == before == 2
    assert status_of(fish, experiment).trials == 2
    experiment.journal.add("decided", trial=2, decision="discard", reason="a wave", file=grown.name)
    assert [one.number for one in account.counting()] == [1]
    grown.write_bytes(b"no log")
    assert [one.number for one in account.counting()] == [1, 2]  # a discarded one may be damaged
    raw.write_bytes(b"no log")
    with pytest.raises(InputError, match=raw.name):
        account.counting()


def test_what_counts_can_be_chosen(trial: Callable[..., SeriesEnd]) -> None:
    end = trial(Script(AGAIN, AGAIN), trials=2, counts=("repeat",))
    assert end.why == "swims" and len(end.rounds) == 2 and end.verdict is None


def test_positions_are_kept_from_the_start_of_the_swim(
    trial: Callable[..., SeriesEnd], experiment: Experiment, board: SimBoard
) -> None:
    trial(Script(KEEP))
    lines = (experiment.raw / "0001_positions.csv").read_text().splitlines()
    assert lines[0] == "t_s,x_m,y_m,heading_rad"
    rows = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    recorded = rows[(rows[:, 0] >= 0) & (rows[:, 0] <= 6)]
    assert (
        6 * 25 - 5 <= len(recorded) <= 6 * 25 + 1
    )  # pictures come a little late, the last too late
    way_m = recorded[-1, 1] - recorded[0, 1]
    assert way_m == pytest.approx(float(board.world.true_beats().sum()), abs=5e-3)
    assert not (experiment.folder / ".pulling").exists()


def test_a_swim_that_nothing_is_learned_from_yet(
    trial: Callable[..., SeriesEnd], fish: Fish
) -> None:
    end = trial(Script(KEEP), learn=False)
    assert end.why == "swims" and fish.status().pending_trial == 1
    with pytest.raises(InputError, match="waits to be learned from"):
        trial(Script(), learn=False)
    asked = Script()
    end = trial(asked)
    assert asked.asked == [2], "trial 1 was decided on before"
    assert [one.learned is not None for one in end.rounds] == [True, True]


# ends


def test_a_person_s_key_stops_it_and_the_series_after_the_decision(
    trial: Callable[..., SeriesEnd], fish: Fish, experiment: Experiment, board: SimBoard
) -> None:
    end = trial(Script(BUMPED, abort_beat=2), trials=5)
    assert end.why == "interrupted" and len(end.rounds) == 1
    recorded = end.records[0]
    assert recorded.outcome.end == "aborted:ABORT_COMMAND" and recorded.outcome.executed_beats < 6
    assert any("stopped by hand" in problem for problem in recorded.problems)
    assert fish.status().state == "IDLE" and fish.status().iteration == 1
    assert trial(Script(KEEP)).records[0].outcome.end == "complete"
    require_nothing_lost(fish, experiment)


def test_beats_of_an_aborted_swim_can_be_learned_from(
    trial: Callable[..., SeriesEnd], fish: Fish
) -> None:
    end = trial(Script(KEEP, abort_beat=1))
    assert end.why == "interrupted" and fish.status().last_learned_trial == 1


def test_converged_ends_it(
    trial: Callable[..., SeriesEnd], fish: Fish, experiment: Experiment
) -> None:
    set_meant(fish, experiment, "AMP_MAX_RAD", 0.7)
    end = trial(Script(), trials=None, until=Until(None, converged=True))
    assert end.why == "converged" and end.verdict is not None and end.verdict.stop
    assert 3 <= len(end.rounds) < 30
    assert end.verdict.stop_reason in end.words


def test_a_series_at_the_amplitude_limit_is_not_called_converged(
    trial: Callable[..., SeriesEnd], fish: Fish, experiment: Experiment
) -> None:
    set_meant(fish, experiment, "AMP_MAX_RAD", 0.4)
    operator = Script()
    end = trial(operator, trials=None, until=Until(None, converged=True))
    assert end.why == "saturated" and end.verdict is not None
    found = end.verdict.saturation
    assert found is not None and found.needed_rad is not None and found.needed_rad > 0.45
    assert found.words in end.words and "tailbeat params set AMP_MAX_RAD" in end.words
    last = [event for event in operator.told if isinstance(event, Assessed)][-1]
    assert last.saturation == found.text
    trials = [
        read_trial(path) for path in sorted(end.rounds[-1].recorded.file.parent.glob("*.ulg"))
    ]
    assert found.beats == sum(trials[-1].beats.applied_rad >= np.float32(0.4)) > 0


def test_a_low_battery_ends_it_before_anybody_waits(
    trial: Callable[..., SeriesEnd], board: SimBoard, fish: Fish
) -> None:
    board.world.set_battery_v(6.3)
    fish.link.run(3.0)
    end = trial(Script(), trials=None)
    assert end.why == "battery" and "6.60 V" in end.words and "session resume" in end.words
    assert end.rounds == []


def test_a_battery_that_is_too_low_once_it_was(
    trial: Callable[..., SeriesEnd], board: SimBoard, fish: Fish
) -> None:
    """Above the limit, but the board wants 0.2 V more: its refusal ends the series, too."""
    board.world.set_battery_v(6.3)
    fish.link.run(3.0)
    with pytest.raises(TailbeatError):
        fish.arm()
    board.world.set_battery_v(6.7)
    fish.link.run(3.0)
    assert trial(Script()).why == "battery"


def test_the_board_s_own_stop_is_left_as_it_is(
    trial: Callable[..., SeriesEnd], board: SimBoard, fish: Fish, experiment: Experiment
) -> None:
    class Rolls(Script):
        def tell(self, event: Event) -> None:
            super().tell(event)
            if isinstance(event, BeatEvent) and event.beat == 2:
                board.world.set_tilt_rad(1.4)

    set_meant(fish, experiment, "TILT_MAX_RAD", 0.5)
    end = trial(Rolls(KEEP), trials=4)
    assert end.why == "stopped" and "TILT" in end.words and "tailbeat board clear" in end.words
    assert fish.status().state == "ABORTED" and fish.status().pending_trial == 1
    assert kinds(experiment)[-1] == "decided"
    board.world.set_tilt_rad(0.0)
    refuses = Script()
    refuses.yes = False
    end = trial(refuses)
    assert end.why == "stopped" and len(refuses.questions) == 1 and refuses.asked == []
    goes_on = Script()
    end = trial(goes_on)
    assert end.why == "swims" and goes_on.asked == [2]
    assert [one.learned.trial for one in end.rounds if one.learned] == [1, 2]


def test_a_stopped_board_without_a_trial_is_asked_about(
    trial: Callable[..., SeriesEnd], fish: Fish
) -> None:
    fish.arm()
    fish.abort()
    operator = Script()
    assert trial(operator).why == "swims"
    assert len(operator.questions) <= 1


def test_rollback_is_told_with_what_it_means(
    trial: Callable[..., SeriesEnd], fish: Fish, board: SimBoard, experiment: Experiment
) -> None:
    trial(Script(), trials=3)
    set_meant(fish, experiment, "ROLLBACK_RATIO", 1.001)
    board.world.set_start(0.15)  # every trial begins with a push
    operator = Script()
    for _ in range(3):
        board.world.set_start(0.15)
        trial(operator)
    learned = operator.of(LearnReport)
    if not any(event.rolled_back for event in learned):
        pytest.fail(f"the set-up makes nothing worse: {learned}")
    loud = [event.text for event in operator.of(Notice)]
    assert any(text.startswith("ROLLED BACK") and "best" in text for text in loud)


# the trial that waits


def test_what_was_swum_elsewhere_is_decided_on_first(
    trial: Callable[..., SeriesEnd], fish: Fish, experiment: Experiment
) -> None:
    assert run_trial(fish).end == "complete"
    operator = Script(BUMPED, KEEP)
    end = trial(operator)
    assert operator.asked == [1, 2]
    assert [one.decision.kind for one in end.rounds] == ["discard", "keep"]
    require_nothing_lost(fish, experiment)


def test_another_fish_or_reference_is_refused(
    trial: Callable[..., SeriesEnd], fish: Fish, experiment: Experiment
) -> None:
    experiment.write_settings({"unique_id": "00" * 16})
    with pytest.raises(InputError, match="another fish"):
        trial(Script())
    experiment.write_settings({"unique_id": fish.unique_id()})
    fish.upload_reference(records.encode_reference(1.0, SPEEDS * 0.5))
    with pytest.raises(InputError, match="another reference"):
        trial(Script())
    assert fish.status().next_trial == 1


def test_a_fish_that_swims_is_left_alone(
    fish: Fish, experiment: Experiment, trial: Callable[..., SeriesEnd], board: SimBoard
) -> None:
    seen: list[bool] = []

    def meddle(event: Event) -> None:
        if isinstance(event, BeatEvent) and event.beat == 1 and not seen:
            with pytest.raises(TailbeatError, match="swims already"):
                trial(Script())
            seen.append(board.world.truth().swimming)

    assert run_trial(fish, on_event=meddle).end == "complete"
    assert seen == [True]


def test_a_swim_without_speeds_cannot_be_kept(
    trial: Callable[..., SeriesEnd], fish: Fish, experiment: Experiment, board: SimBoard
) -> None:
    set_meant(fish, experiment, "SPD_SOURCE", 1)
    with pytest.raises(InputError, match="trial speeds"):
        trial(Script(KEEP))
    assert fish.status().pending_trial == 1 and "decided" not in kinds(experiment)
    fish.upload_speeds(1, np.full(6, 0.05), np.full(6, 0.001))
    end = trial(Script(KEEP, BUMPED), counts=("keep", "discard"))
    assert end.rounds[0].learned is not None and end.rounds[0].learned.trial == 1
    assert end.rounds[0].recorded.file.name == "0001-2.ulg"


def test_a_refusal_to_learn_is_asked_about_again(
    trial: Callable[..., SeriesEnd], fish: Fish, experiment: Experiment
) -> None:
    run_trial(fish)
    set_meant(fish, experiment, "ILC_LEAD", 10)
    with pytest.raises(Refused):
        trial(Script(KEEP))
    operator = Script(BUMPED, KEEP)
    set_meant(fish, experiment, "ILC_LEAD", 1)
    trial(operator)
    assert operator.asked == [1, 2]


def test_a_board_that_counts_from_one_again(
    fish: Fish, board: SimBoard, experiment: Experiment, trial: Callable[..., SeriesEnd]
) -> None:
    trial(Script(KEEP, KEEP), trials=2)
    board.flash = bytes(len(board.flash))
    board.world.power_cycle()
    fish.link.run(3.0)
    if fish.status().state in ("ABORTED", "FAULT"):
        fish.clear()
    fish.params.set("ILC_LEAD", 1)
    fish.upload_reference(records.encode_reference(1.0, SPEEDS))
    operator = Script(BUMPED)
    with pytest.raises(InputError, match=r"has lost what it had learned.*session resume"):
        trial(operator, counts=("discard",))
    (experiment.folder / "board" / "state.json").unlink()  # nobody wants it back
    end = trial(operator, counts=("discard",))
    assert end.records[0].file.name == "0001-2.ulg" and operator.asked == [1]
    assert [path.name for path in experiment.trial_files()] == [
        "0001.ulg", "0002.ulg", "0001-2.ulg"
    ]  # fmt: skip


# bad days


class Calls:
    """Raises at the n-th of all calls that go through it, once."""

    def __init__(self, at: int, error: BaseException) -> None:
        self.at, self.error, self.count = at, error, 0

    def __call__(self) -> None:
        self.count += 1
        if self.count == self.at:
            raise self.error


class Interrupting(Script):
    """Ctrl-C arrives in one of the person's methods."""

    def __init__(self, calls: Calls, *answers: Decision) -> None:
        super().__init__(*answers)
        self._calls = calls

    def tell(self, event: Event) -> None:
        self._calls()
        super().tell(event)

    def wants_abort(self) -> bool:
        self._calls()
        return super().wants_abort()

    def decide(self, recorded: RecordedTrial) -> Decision:
        self._calls()
        return super().decide(recorded)


def require_goes_on(
    fish: Fish,
    board: SimBoard,
    experiment: Experiment,
    trial: Callable[..., SeriesEnd],
    n: int,
) -> None:
    """The tail is still, nothing armed or lost, and the next call is a usual one."""
    assert at_rest(fish, board), f"call {n}: {fish.status()}"
    require_nothing_lost(fish, experiment)
    end = trial(Script())
    assert end.why == "swims", f"call {n}: {end.words}"
    assert end.records[-1].outcome.end == "complete", f"call {n}"
    require_nothing_lost(fish, experiment)
    assert experiment.raw_problems() == []
    recorded = [entry["file"] for entry in experiment.journal.entries("swum")]
    assert len(recorded) == len(set(recorded)), f"call {n}: journalled twice"
    decided = [entry["file"] for entry in experiment.journal.entries("decided")]
    assert sorted(decided) == sorted(set(decided)) == sorted(recorded), f"call {n}"
    learned = [entry["trial"] for entry in experiment.journal.entries("learned")]
    assert len(learned) == len(set(learned)), f"call {n}: learned twice"
    assert fish.status().iteration == 1 + len(learned), f"call {n}"
    assert fish.status().state == "IDLE" and fish.status().pending_trial is None


def spread(last: int, most: int) -> list[int]:
    """Numbers of calls from the first to the last; closer where something is decided: the end."""
    return sorted({1, *(last - np.geomspace(1, last, most).astype(int)).tolist(), last} - {0})


FEW = [6, pytest.param(40, marks=pytest.mark.soak)]


@pytest.mark.parametrize("most", FEW)
def test_ctrl_c_in_any_call_of_the_person(
    fish: Fish, board: SimBoard, experiment: Experiment, trial: Callable[..., SeriesEnd], most: int
) -> None:
    whole = Calls(0, KeyboardInterrupt())
    assert trial(Interrupting(whole, KEEP)).why == "swims"
    for n in spread(whole.count, most):
        end = trial(Interrupting(Calls(n, KeyboardInterrupt())))
        assert end.why in ("interrupted", "swims"), f"call {n}"
        require_goes_on(fish, board, experiment, trial, n)


@pytest.mark.parametrize("most", [4, pytest.param(40, marks=pytest.mark.soak)])
@pytest.mark.parametrize("method", ["read", "write"])
def test_ctrl_c_in_any_call_of_the_link(
    fish: Fish,
    board: SimBoard,
    experiment: Experiment,
    trial: Callable[..., SeriesEnd],
    monkeypatch: pytest.MonkeyPatch,
    method: str,
    most: int,
) -> None:
    real = getattr(fish.transport, method)

    def run(calls: Calls) -> SeriesEnd:
        def call(*arguments: Any) -> Any:
            calls()
            return real(*arguments)

        with monkeypatch.context() as patch:
            patch.setattr(fish.transport, method, call)
            return trial(Script())

    fish.link.transport = fish.transport
    whole = Calls(0, KeyboardInterrupt())
    assert run(whole).why == "swims"
    for n in spread(whole.count, most):
        try:
            assert run(Calls(n, KeyboardInterrupt())).why in ("interrupted", "swims"), f"call {n}"
        except KeyboardInterrupt:
            assert n < 60, "only before it begins may Ctrl-C come out"
        require_goes_on(fish, board, experiment, trial, n)


def test_a_swim_that_ends_before_its_first_beat(
    fish: Fish, board: SimBoard, experiment: Experiment, trial: Callable[..., SeriesEnd]
) -> None:
    operator = Script(abort_beat=-1)
    end = trial(operator)
    assert end.why == "interrupted" and end.rounds == [] and operator.asked == []
    require_goes_on(fish, board, experiment, trial, 0)


def test_ctrl_c_once_it_is_armed(
    fish: Fish,
    board: SimBoard,
    experiment: Experiment,
    trial: Callable[..., SeriesEnd],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from tailbeat.session.preflight_step import PreflightLimits

    real = series_module.countdown

    def counted(fish: Fish, *rest: Any) -> None:
        real(fish, *rest)
        assert fish.status().state == "ARMED"
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(series_module, "countdown", counted)
        wanted = PreflightLimits(rest_s=0.0, still_s=2.0, countdown_s=1.0)
        assert trial(Script(), wanted=wanted).why == "interrupted"
    require_goes_on(fish, board, experiment, trial, 0)


def test_what_was_learned_but_not_written_down(
    fish: Fish,
    board: SimBoard,
    experiment: Experiment,
    trial: Callable[..., SeriesEnd],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from tailbeat.experiment.store import Journal

    real = Journal.add

    def add(self: Journal, what: str, *rest: Any, **values: Any) -> dict[str, Any]:
        if what == "learned":
            raise InputError("cannot write (No space left on device)", "Make room.")
        return real(self, what, *rest, **values)

    with monkeypatch.context() as patch:
        patch.setattr(Journal, "add", add)
        with pytest.raises(InputError):
            trial(Script())
    assert fish.status().last_learned_trial == 1 and "learned" not in kinds(experiment)
    require_goes_on(fish, board, experiment, trial, 0)
    assert [entry["trial"] for entry in experiment.journal.entries("learned")] == [1, 2]


def test_ctrl_c_twice_in_mid_swim(
    fish: Fish, board: SimBoard, experiment: Experiment, trial: Callable[..., SeriesEnd]
) -> None:
    class Impatient(Script):
        def tell(self, event: Event) -> None:
            super().tell(event)
            beat = isinstance(event, BeatEvent) and event.beat == 1
            if beat or isinstance(event, InterruptRequested):
                raise KeyboardInterrupt

    end = trial(Impatient())
    assert end.why == "interrupted" and end.rounds == []
    require_goes_on(fish, board, experiment, trial, 0)


class FullDisk:
    """Writing below a folder fails from the n-th write on."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, folder: Path, at: int) -> None:
        self.count, self._at, self._folder = 0, at, folder
        self._open, self._write, self._create = Path.open, os.write, os.open
        monkeypatch.setattr(os, "open", self.create)
        monkeypatch.setattr(Path, "open", self.open)
        monkeypatch.setattr(Path, "write_bytes", self.write_bytes)
        monkeypatch.setattr(os, "write", self.write)

    def check(self, path: object) -> None:
        self.count += 1
        if self.count >= self._at:
            raise OSError(errno.ENOSPC, "No space left on device", str(path))

    @property
    def open(self) -> Callable[..., Any]:
        def opened(path: Path, mode: str = "r", *rest: Any, **named: Any) -> Any:
            if self._folder in path.parents and set(mode) & set("wax+"):
                self.check(path)
            return self._open(path, mode, *rest, **named)

        return opened

    def create(self, path: Any, flags: int, *rest: Any, **named: Any) -> int:
        if flags & os.O_EXCL and self._folder in Path(path).parents:
            self.check(path)
        return self._create(path, flags, *rest, **named)

    @property
    def write_bytes(self) -> Callable[..., int]:
        def write(path: Path, content: bytes) -> int:
            with path.open("wb") as file:
                return int(file.write(content))

        return write

    def write(self, descriptor: int, content: bytes) -> int:
        where = Path(f"/proc/self/fd/{descriptor}").readlink()
        if self._folder in where.parents:
            self.check(where)
        return self._write(descriptor, content)


@pytest.mark.parametrize("step", [3, pytest.param(1, marks=pytest.mark.soak)])
def test_a_full_disk_at_any_write(
    fish: Fish,
    board: SimBoard,
    experiment: Experiment,
    trial: Callable[..., SeriesEnd],
    monkeypatch: pytest.MonkeyPatch,
    step: int,
) -> None:
    with monkeypatch.context() as patch:
        whole = FullDisk(patch, experiment.folder, at=10**9)
        trial(Script())
    assert whole.count > 5
    for n in range(1, whole.count + 1, step):
        with monkeypatch.context() as patch:
            FullDisk(patch, experiment.folder, at=n)
            with pytest.raises(InputError) as told:
                trial(Script())
        assert "No space left on device" in str(told.value), f"write {n}"
        assert "\n" not in str(told.value) and told.value.remedy, f"write {n}"
        require_goes_on(fish, board, experiment, trial, n)


def test_the_link_is_gone_for_20_s_in_mid_swim(fish: Fish, board: SimBoard, tmp_path: Path) -> None:
    """The board stops by its own rule; the series learns how it ended, and goes on."""
    fish.upload_reference(records.encode_reference(1.0, np.full(16, 0.06)))
    experiment = begin(fish, tmp_path / "longer")

    class Dips(Script):
        cut_at_s = math.inf

        def tell(self, event: Event) -> None:
            super().tell(event)
            if isinstance(event, BeatEvent) and event.beat == 1 and math.isinf(self.cut_at_s):
                self.cut_at_s = board.time_s
                board.world.set_radio(False)

    operator = Dips(KEEP, KEEP)
    real = fish.transport.wait

    def wait(timeout_s: float) -> None:
        real(timeout_s)
        if board.time_s > operator.cut_at_s + 20.0:
            board.world.set_radio(True)

    fish.link.transport.wait = wait  # type: ignore[method-assign]
    options = Options(until=Until(2), wanted=None)
    end = run_series(fish, experiment, operator, options)
    assert len(operator.of(LinkLost)) >= 1 and len(operator.of(LinkRestored)) == 1
    assert [recorded.outcome.end for recorded in end.records] == ["aborted:LINK_LOST", "complete"]
    assert [one.learned is not None for one in end.rounds] == [True, True]
    assert max(event.silent_s for event in operator.of(LiveValues)) > 2.0
    require_nothing_lost(fish, experiment)


def test_a_link_that_does_not_come_back(
    fish: Fish, board: SimBoard, experiment: Experiment, trial: Callable[..., SeriesEnd]
) -> None:
    class Cuts(Script):
        def tell(self, event: Event) -> None:
            super().tell(event)
            if isinstance(event, BeatEvent):
                board.world.set_radio(False)

    with pytest.raises(TailbeatError, match="link broke"):
        trial(Cuts(), reconnect_s=10.0)
    board.world.set_radio(True)
    assert not board.world.truth().swimming
    require_goes_on(fish, board, experiment, trial, 0)


def test_a_camera_that_dies(
    fish: Fish, board: SimBoard, experiment: Experiment, trial: Callable[..., SeriesEnd]
) -> None:
    class Dies(SimulatedCamera):
        dead_at_s = math.inf

        def frames(self) -> list[Frame]:
            if board.time_s > self.dead_at_s:
                raise CameraGone("cam was unplugged", "Plug it in.")
            return super().frames()

    camera = Dies(board)
    camera.dead_at_s = board.time_s + 4.0
    operator = Script(BUMPED)
    options = Options(until=Until(1), wanted=None, counts=("discard",))
    end = run_series(fish, experiment, operator, options, camera)
    assert end.records[0].outcome.end == "aborted:ABORT_COMMAND"
    assert any("unplugged" in event.text for event in operator.of(TrialWarning))
    require_goes_on(fish, board, experiment, trial, 0)


# battery


PARAMS = {"BATT_LOW_V": 6.6, "BATT_CRIT_V": 6.0}


@pytest.mark.parametrize(
    ("now_v", "drains", "told"),
    [
        (7.4, [], None),
        (7.4, [Drain(7.5, 7.3, 7.0)], None),
        (6.7, [Drain(6.9, 6.8, 6.6)], "after this one"),
        (6.7, [Drain(6.75, 6.5, 5.9)], "will not last"),
        (6.7, [Drain(6.71, 6.7, 6.65)], None),
        (7.0, [Drain(6.9, 6.8, 6.6)], None),
    ],
)
def test_the_forecast(now_v: float, drains: list[Drain], told: str | None) -> None:
    words = forecast(now_v, drains, PARAMS)
    assert (words is None) == (told is None) and (told is None or told in str(words))


def test_too_low() -> None:
    assert too_low(6.6, PARAMS) is None and too_low(6.59, PARAMS) is not None
    assert too_low(1.0, {"BATT_LOW_V": 0.0}) is None


def test_a_battery_that_falls_is_told_and_journalled(
    fish: Fish, board: SimBoard, experiment: Experiment, trial: Callable[..., SeriesEnd]
) -> None:
    for volts in (7.2, 6.95, 6.7):
        board.world.set_battery_v(volts)
        fish.link.run(3.0)
        operator = Script()
        trial(operator)
    assert any("after this one" in event.text for event in operator.of(Notice))
    starts = [entry["battery_start_v"] for entry in experiment.journal.entries("swum")]
    assert starts == pytest.approx([7.2, 6.95, 6.7], abs=0.15)


# the preflight checks


def test_checks_that_are_given_up(
    fish: Fish,
    board: SimBoard,
    experiment: Experiment,
    trial: Callable[..., SeriesEnd],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def given_up(*_: Any) -> None:
        raise GivenUp("nobody wanted to wait", "Begin again.")

    from tailbeat.session.preflight_step import PreflightLimits

    monkeypatch.setattr(series_module, "prepare", given_up)
    end = trial(Script(), wanted=PreflightLimits())
    assert end.why == "interrupted" and "nobody wanted to wait" in end.words
    require_goes_on(fish, board, experiment, trial, 0)


def test_with_the_checks(
    fish: Fish, board: SimBoard, experiment: Experiment, trial: Callable[..., SeriesEnd]
) -> None:
    from tailbeat.session.preflight_step import PreflightLimits

    operator = Script()
    end = trial(
        operator, trials=2, wanted=PreflightLimits(rest_s=20.0, still_s=4.0, countdown_s=3.0)
    )
    assert end.why == "swims" and len(operator.of(Countdown)) == 2 * 4
    ready = end.records[1].ready
    assert ready is not None and ready.rested_s is not None and ready.rested_s >= 20.0
    last = experiment.journal.entries("swum")[-1]
    assert last["rested_s"] == pytest.approx(ready.rested_s)
    assert last["travel"]["expected_m"] == pytest.approx(ready.travel.expected_m)
    assert last["pose"]["heading_rad"] == pytest.approx(0.0, abs=0.1)
    assert last["drift"]["speed_m_s"] < 0.002


@pytest.mark.parametrize("most", [3, pytest.param(60, marks=pytest.mark.soak)])
def test_ctrl_c_in_any_call_of_the_person_with_the_checks(
    fish: Fish, board: SimBoard, experiment: Experiment, trial: Callable[..., SeriesEnd], most: int
) -> None:
    from tailbeat.session.preflight_step import PreflightLimits

    wanted = PreflightLimits(rest_s=0.0, still_s=2.0, countdown_s=2.0)
    whole = Calls(0, KeyboardInterrupt())
    trial(Interrupting(whole), wanted=wanted)
    for n in spread(whole.count, most):
        end = trial(Interrupting(Calls(n, KeyboardInterrupt())), wanted=wanted)
        assert end.why in ("interrupted", "swims"), f"call {n}"
        require_goes_on(fish, board, experiment, trial, n)


@pytest.mark.parametrize("plant", ["tank", "reactive"])
def test_lost_beats_hinder_no_series(
    plant: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The camera sees nothing of every 25th beat: there is a best trial all the same, each is
    assessed, and the series comes to its end. 20 of 20 fish of the realistic population."""
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "logbook"))
    settings = draw("realistic", plant, 7101) | {"lost_beats": 0.04, "outliers": 0.0}
    with Fish.connect(f"sim:{plant}", seed=7101, **settings) as fish:
        for name, value in {"ILC_LEAD": 1, "AMP_MAX_RAD": 0.785, "DU_MAX_RAD": 0}.items():
            fish.params.set(name, value)
        fish.params.set("TANK_LEN_M", 0)
        fish.upload_reference(thesis().record())
        operator, experiment = Script(), begin(fish, tmp_path / "experiments")
        end = run_series(fish, experiment, operator, Options(Until(30, converged=True), None))
        best_m_s = fish.status().best_max_abs_error_m_s
    recorded = operator.of(TrialRecorded)
    assert any(one.record.measured_beats < 40 for one in recorded)
    assert end.why in ("converged", "saturated")
    assert 4 <= len(recorded) <= 15
    assert best_m_s is not None and 0 < best_m_s < 0.03
    assert len(operator.of(Assessed)) == len(recorded)
