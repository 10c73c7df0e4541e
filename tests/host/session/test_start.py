"""tailbeat start: the whole job in one command, in both modes; which law makes each input."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.app.cli import run
from tailbeat.app.cli._operator import TerminalOperator
from tailbeat.app.cli._terminal import Display
from tailbeat.board.fish import Fish
from tailbeat.core.records import INPUT_UPLOADED
from tailbeat.core.reference import thesis
from tailbeat.experiment.current import begin, experiment_for
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import TrialLibrary, library_of
from tailbeat.learning import fit
from tailbeat.link.messages import BeatEvent
from tailbeat.session.events import (
    Event,
    InputChosen,
    Notice,
    StepEnded,
    TrialDecided,
    TrialStarted,
)
from tailbeat.session.options import Options, Until
from tailbeat.session.outcome import Decision, RecordedTrial
from tailbeat.session.preflight_step import PreflightLimits
from tailbeat.session.series import run_series
from tailbeat.session.start import NobodyThere, StartEnd, StartOptions, run_start
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport

Command = Callable[..., tuple[int, Any, str]]
TWO = Options(until=Until(2), wanted=PreflightLimits(rest_s=1))


def work_in(folder: Path, patch: pytest.MonkeyPatch) -> None:
    """Without a bootstrap, which takes seconds and is tested elsewhere."""
    patch.setattr(fit, "bootstrap", lambda *_, **__: [])
    patch.setenv("TAILBEAT_LOGBOOK", str(folder / "library"))
    patch.chdir(folder)


@pytest.fixture(autouse=True)
def quickly(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    work_in(tmp_path, monkeypatch)


@dataclass
class Agrees:
    """Says yes to everything. ``breaks``: raises KeyboardInterrupt at that event."""

    breaks: Callable[[Event], bool] = lambda _: False
    told: list[Event] = field(default_factory=list)

    def tell(self, event: Event) -> None:
        self.told.append(event)
        if self.breaks(event):
            raise KeyboardInterrupt

    def wants_abort(self) -> bool:
        return False

    def decide(self, recorded: RecordedTrial) -> Decision:
        return Decision("keep")

    def confirm(self, question: str) -> bool:
        return True

    def number(self, question: str, value: float) -> float | None:
        return value

    def laws(self) -> list[str]:
        return [event.law for event in self.told if isinstance(event, InputChosen)]

    def swims(self) -> int:
        return sum(isinstance(event, TrialStarted) for event in self.told)


@dataclass
class Tank:
    """A board at a tank, and the folder of its experiments."""

    board: SimBoard

    def start(self, options: Options = TWO, **given: Any) -> tuple[StartEnd, Agrees]:
        operator = given.pop("operator", None) or Agrees()
        with Fish(SimTransport(self.board)) as fish:
            found: list[Experiment] = []

            def experiment() -> Experiment:
                found.append(experiment_for(fish) or begin(fish, Path("experiments")))
                return found[-1]

            end = run_start(fish, operator, StartOptions(series=options, **given), experiment)
        return end, operator


def new_tank() -> Tank:
    return Tank(SimBoard("tank", seed=11, tail_centre_rad=0.03))


@pytest.fixture
def tank() -> Tank:
    return new_tank()


@pytest.fixture(scope="module")
def first_day(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, bytes]:
    """Folder, and the board's flash, of a fish that the whole job has been done for once."""
    folder, tank = tmp_path_factory.mktemp("first"), new_tank()
    with pytest.MonkeyPatch.context() as patch:
        work_in(folder, patch)
        end, operator = tank.start()
    assert end.series is not None and operator.swims() == 3 + 2
    return folder, tank.board.flash


@pytest.fixture
def known_tank(tank: Tank, first_day: tuple[Path, bytes], tmp_path: Path) -> Tank:
    """The day after, with the board switched on anew."""
    folder, flash = first_day
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    tank.board.flash = flash
    tank.board.world.power_cycle()
    return tank


def names(end: StartEnd) -> list[str]:
    return [step.name for step in end.steps]


def test_from_an_unknown_fish_to_the_bound(tank: Tank) -> None:
    """Three runs, then the first trial is as good as any; the next call knows the fish."""
    end, operator = tank.start()
    assert names(end) == ["health", "tank", "trim", "measure", "limit", "law", "reference"]
    assert all(step.done for step in end.steps) and end.series is not None
    assert operator.swims() == 3 + 2 and operator.laws()[:2] == ["model", "model"]
    bound = re.search(r"[Ee]rror bound ([\d.]+) mm/s", end.steps[-1].words)
    assert bound is not None
    errors = [1e3 * one.max_abs_error_m_s for one in end.series.records]
    assert max(errors) < 1.3 * float(bound[1]) + 2, "noise and all"
    again, operator = tank.start()
    assert names(again) == ["health", "commission", "limit", "law", "reference"]
    assert "skipped, this fish was measured" in again.steps[1].words
    assert operator.swims() == 2


def test_an_interrupted_commissioning_begins_again(tank: Tank) -> None:
    at_measuring = Agrees(lambda event: isinstance(event, StepEnded) and event.name == "trim")
    with pytest.raises(KeyboardInterrupt):
        tank.start(operator=at_measuring)
    end, _ = tank.start()
    assert "measure" in names(end) and end.series is not None


def test_limit_and_law_follow_when_only_they_are_missing(tank: Tank) -> None:
    after_measuring = Agrees(lambda event: isinstance(event, StepEnded) and event.name == "measure")
    with pytest.raises(KeyboardInterrupt):
        tank.start(operator=after_measuring)
    end, _ = tank.start()
    assert names(end) == ["health", "commission", "limit", "law", "reference"]
    assert "saturation" not in end.steps[-1].words, "the limit is raised by now"
    with Fish(SimTransport(tank.board)) as fish:
        assert fish.params.get("AMP_MAX_RAD").value > 0.5
        gain, lead = fish.params.get("ILC_GAIN").value, fish.params.get("ILC_LEAD").value
        fish.params.set("ILC_GAIN", 3.0)
        fish.params.save()
    tank.start()
    with Fish(SimTransport(tank.board)) as fish:
        held = fish.params.get("ILC_GAIN").value, fish.params.get("ILC_LEAD").value
    assert held == (gain, lead) and gain != 3.0, "designed, and stored at every start"


def test_a_death_in_a_measuring_run_is_put_right(tank: Tank) -> None:
    """The computer is gone while the tail beats; the board stops by itself, with a run's input."""

    class Died(BaseException):
        pass

    def dies(event: Event) -> None:
        if isinstance(event, BeatEvent) and event.amplitude_rad > 0.3:
            raise Died

    operator = Agrees()
    operator.tell = dies  # type: ignore[method-assign]
    with pytest.MonkeyPatch.context() as dead, pytest.raises(Died):
        for name in ("abort", "clear", "disarm"):
            dead.setattr(f"tailbeat.board.fish.Fish.{name}", lambda *_, **__: None)
        dead.setattr("tailbeat.board.preserve._put_back", lambda *_: None)
        tank.start(operator=operator)
    with Fish(SimTransport(tank.board)) as fish:
        fish.abort()
        fish.link.run(30.0)
        assert fish.status().state == "ABORTED"
    end, _ = tank.start()
    assert {"measure", "law"} <= set(names(end)) and end.series is not None


def test_a_stopped_board_is_cleared_and_the_fish_commissioned(tank: Tank) -> None:
    with Fish(SimTransport(tank.board)) as fish:
        fish.upload_reference(thesis().record())
        run_trial(
            fish, on_event=lambda event: fish.abort() if isinstance(event, TrialStarted) else None
        )
        assert fish.status().state == "ABORTED"
    refused = Agrees()
    refused.confirm = lambda question: "Clear it" not in question  # type: ignore[method-assign]
    end, _ = tank.start(operator=refused)
    assert end.series is None and "tailbeat board clear" in end.steps[-1].words
    end, operator = tank.start()
    assert "measure" in names(end) and operator.laws()[0] == "model"


def test_a_trial_that_waits_is_decided_on_first(known_tank: Tank) -> None:
    with Fish(SimTransport(known_tank.board)) as fish:
        experiment = begin(fish, Path("experiments"))
        fish.arm()
        run_trial(fish)
        assert fish.status().pending_trial is not None
        operator = Agrees()
        end = run_start(fish, operator, StartOptions(series=TWO), lambda: experiment)
    assert names(end)[0] == "health" and end.series is not None and end.series.why == "swims"
    decided = [event.trial for event in operator.told if isinstance(event, TrialDecided)]
    begun = [event.trial for event in operator.told if isinstance(event, TrialStarted)]
    assert decided[0] == begun[0] - 1


def test_with_nobody_there_an_unknown_fish_does_not_move(tank: Tank) -> None:
    with pytest.raises(NobodyThere, match="the step 'commission' moves the tail"):
        tank.start(acts=False)


def test_with_nobody_there_no_tail_moves(known_tank: Tank) -> None:
    operator = Agrees()
    with pytest.raises(NobodyThere, match="the step 'trials'") as refused:
        known_tank.start(acts=False, operator=operator)
    assert operator.swims() == 0 and refused.value.document == {"step": "trials"}


def test_the_board_alone_goes_on_by_its_designed_law(known_tank: Tank) -> None:
    """The laptop is gone after a trial: others are learned from on the board, from the last input;
    then the model-based law takes over again, the experiment knows which law made each input, and
    the model learns from these trials, too."""
    with Fish(SimTransport(known_tank.board)) as fish:
        before = fish.amplitudes()
        assert before.input == INPUT_UPLOADED and fish.params.get("ILC_GAIN").value != 4.0
        number = run_trial(fish).number
        fish.learn()
        after = fish.amplitudes()
        assert after.input == 0 and not np.array_equal(before.values, after.values)
        assert np.abs(after.values - before.values).max() < 0.15 + 1e-6
        run_trial(fish)
        fish.learn()
    end, operator = known_tank.start(Options(until=Until(1), wanted=None))
    assert operator.laws()[0] == "model" and end.series is not None and end.experiment is not None
    told = [event.text for event in operator.told if isinstance(event, Notice)]
    assert any(f"trials {number} to {number + 1} were executed without" in one for one in told)
    journal = {one["trial"]: one["law"] for one in end.experiment.journal.entries("input")}
    assert (journal[number], journal[number + 1]) == ("model", "p")
    with Fish(SimTransport(known_tank.board)) as fish:
        held = library_of(fish)
        assert held is not None and {number, number + 1} <= {one.trial for one in held.speeds()}


# The law of each input.


def test_p_until_a_model_promises_less(tank: Tank) -> None:
    """Without a commissioning the first trial is the board's, the second the model's."""
    operator = Agrees()
    with Fish(SimTransport(tank.board)) as fish:
        fish.upload_reference(thesis().record())
        experiment = begin(fish, Path("experiments"))
        end = run_series(fish, experiment, operator, Options(until=Until(3), wanted=None))
        chosen = [event for event in operator.told if isinstance(event, InputChosen)]
        held = library_of(fish)
    assert [one.law for one in chosen] == ["p", "model", "model", "model"]
    assert "nothing has been measured" in chosen[0].why and chosen[0].expected_m_s is None
    assert chosen[1].expected_m_s is not None
    assert chosen[1].expected_m_s[2] < end.records[0].max_abs_error_m_s
    journal = [(one["trial"], one["law"]) for one in experiment.journal.entries("input")]
    assert journal == [(1, "p"), (2, "model"), (3, "model"), (4, "model")]
    assert [one["law"] for one in experiment.journal.entries("begun")] == ["p", "model", "model"]
    assert held is not None and len(held.proposals()) == 3


@pytest.mark.parametrize("law", ["p", "model"])
def test_a_law_on_request(tank: Tank, law: Any) -> None:
    end, operator = tank.start(Options(until=Until(1), wanted=None, law=law))
    assert set(operator.laws()) == {law} and end.series is not None


# At the command line.


@pytest.fixture
def command(
    tank: Tank, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Command:
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: SimTransport(tank.board))

    def call(*words: str) -> tuple[int, Any, str]:
        status = run(["start", *words, "--connect", "it"])
        out, err = capsys.readouterr()
        return status, json.loads(out) if "--json" in words and out else out, err

    return call


def test_one_document(command: Command) -> None:
    status, document, err = command("--yes", "--rest", "1", "--until", "2", "--json")
    assert status == 0 and err.count("\n") == 1, err
    assert [step["name"] for step in document["steps"]][-1] == "reference"
    assert len(document["swims"]) == 2 and Path(document["report"]).is_file()


def test_without_an_answer_it_ends_at_the_question(command: Command) -> None:
    status, out, err = command("--rest", "1")
    assert status == 1 and "the step 'commission' moves the tail" in err and out == ""


def test_a_fish_that_is_not_simulated_is_not_moved_by_yes(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tailbeat.app.cli.start.SIMULATED_FISH", ())
    status, document, err = command("--yes", "--rest", "1", "--json")
    assert status == 1 and document["step"] == "commission" and "moves the tail" in err
    with Fish.connect("it") as fish:
        assert (
            fish.status().next_trial == 1 and TrialLibrary.of(fish.unique_id()).identified() is None
        )


# What a newcomer reads and presses.

TERMS = (
    "commission", "reference", "tail beat", "trial", "IMU", "error bound", "model-based",
    "iteration", "feedforward", "feasible", "phase lead", "extension", "extrapolation",
    "decreasing gain", "convergence rate", "certificate", "repeatability", "prediction interval",
    "convergence assessment", "norm-optimal", "preflight", "operator", "clearance",
    "heading error", "heading drift", "yaw oscillation", "coast", "trial library", "event log",
    "baseline", "P law", "warm-start",
)  # fmt: skip
EXPLAINED = {
    "commission": "get to know a new fish",
    "IMU": "(motion sensor)",
    "reference": "(the speed to learn)",
    "tail beat": "(one a second)",
    "AMP_MAX_RAD": "(the largest amplitude of the tail)",
    "error bound": "no input has a smaller largest error",
    "trial": "(the fish moves)",
    "model-based": "planned on this computer",
}
KEYS_MAX, TERMS_MAX = 12, 8


class Fingers:
    """Keys that somebody presses who reads every line: y, the number, Enter."""

    def __init__(self) -> None:
        self.pressed_keys = 0
        self.typed = ""

    def pressed(self) -> bool:
        return False

    def forget(self) -> None:
        pass

    def key(self, timeout_s: float) -> str | None:
        self.pressed_keys += 1
        return "y" if "y/n" in self.typed else "\r"

    def line(self) -> str:
        found = re.search(r"type ([\d.]+): $", self.typed)
        assert found is not None, self.typed
        self.pressed_keys += len(found[1]) + 1
        return found[1]


def test_few_words_and_few_keys(tank: Tank, capsys: pytest.CaptureFixture[str]) -> None:
    """Up to the first trial that was learned from; each word is explained where it comes first."""
    fingers = Fingers()
    display = Display()
    ask = display.ask
    display.ask = lambda text: (setattr(fingers, "typed", text), ask(text))[1]  # type: ignore[method-assign]
    operator = TerminalOperator(display, fingers)
    once = Options(until=Until(1), wanted=PreflightLimits(rest_s=1))
    with Fish(SimTransport(tank.board)) as fish:
        end = run_start(
            fish, operator, StartOptions(series=once), lambda: begin(fish, Path("experiments"))
        )
    assert end.series is not None and end.series.rounds[0].learned is not None
    lines = capsys.readouterr().err.splitlines()
    lines = lines[: next(i for i, line in enumerate(lines) if line.startswith("trial  law"))]
    first: dict[str, str] = {}
    for line in lines:
        for name in re.findall(r"\b[A-Z]{2,}_[A-Z_]+\b", line):
            first.setdefault(name, line)
        for term in TERMS:
            if re.search(rf"\b{term}s?\b", line):
                first.setdefault(term, line)
    assert len(first) <= TERMS_MAX, sorted(first)
    for term, line in first.items():
        assert EXPLAINED[term] in line, f"{term}: {line}"
    assert fingers.pressed_keys <= KEYS_MAX
