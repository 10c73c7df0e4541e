"""tailbeat trial run with somebody to guide: options, questions, keys, what is told in the end."""

from __future__ import annotations

import io
import json
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.app.cli import run
from tailbeat.app.cli._operator import TerminalOperator, Undecided
from tailbeat.app.cli._terminal import Display
from tailbeat.app.cli.trial_run import _text
from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.experiment.folder import Experiment
from tailbeat.link.messages import TrialOutcome
from tailbeat.session.events import Countdown, StepProgress, TrialStarted
from tailbeat.session.outcome import BY_HAND, Decision, RecordedTrial, StopKind, StopReason
from tailbeat.session.series import Round, SeriesEnd
from tailbeat.sim.board import SimBoard, SimTransport

Command = Callable[..., tuple[int, Any, str]]
SPEEDS = [0.03, 0.06, 0.07, 0.06, 0.03]
FAST = ("--rest", "1")


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
def trial(board: SimBoard, capsys: pytest.CaptureFixture[str]) -> Command:
    def command(*words: str) -> tuple[int, Any, str]:
        status = run(["trial", *words, "--connect", "it"])
        out, err = capsys.readouterr()
        return status, json.loads(out) if "--json" in words and out else out, err

    return command


def the_experiment() -> Experiment:
    (folder,) = Path("experiments").iterdir()
    return Experiment.open(folder)


def test_without_anybody_one_swim_waits_as_ever(trial: Command) -> None:
    status, document, err = trial("run", "--json")
    assert (status, err, document["end"]) == (0, "", "complete")
    assert not Path("experiments").exists()
    with Fish.connect("it") as fish:
        assert fish.status().pending_trial == 1


def test_a_series_as_one_document(trial: Command) -> None:
    words = ("run", "--until", "2", "--then", "keep", *FAST, "--json")
    status, document, err = trial(*words)
    assert status == 0 and document["why"] == "swims"
    assert err.count("\n") == 1 and "a new experiment begins: experiments" in err
    first, second = document["swims"]
    assert [first["trial"], second["trial"]] == [1, 2] and second["decision"] == "keep"
    assert second["report"]["iteration"] == 2 and second["report"]["rolled_back"] is False
    assert second["ready"]["pose"]["source"] == "camera"
    assert abs(second["straight"]["mean_yaw_rad"]) < 0.1
    assert 6.0 < second["battery_end_v"] <= second["battery_start_v"] + 0.05
    assert document["verdict"]["kind"] != "first"
    assert the_experiment().trial_files()[1].name == Path(second["file"]).name


def test_words_for_people(trial: Command) -> None:
    status, out, err = trial("run", "--then", "keep", *FAST)
    lines = out.splitlines()
    assert status == 0 and lines[0].startswith("trial 1, iteration 1: keep, max|e| ")
    assert lines[-1] == "ended: 1 trial"
    head, units, row = [line.split() for line in err.splitlines()[-4:-1]]
    assert " ".join(head) == "trial law predicted max|e| RMS at limit battery decision"
    assert set(units) == {"mm/s", "beats"} and row[:2] == ["1", "p"] and row[-2:] == ["the", "best"]
    assert "ok  still: " not in err and "\x1b" not in err, "what changes is not for a file"
    assert "it swims in" not in err, "what changes is not for a file"


def test_the_next_call_goes_on_in_the_same_experiment(trial: Command) -> None:
    trial("run", "--then", "keep", *FAST)
    status, document, err = trial("run", "--then", "keep", *FAST, "--json")
    assert (status, err) == (0, "")
    assert len(the_experiment().trials()) == 2 and document["swims"][0]["trial"] == 2


def test_repeats_count_when_they_are_what_was_asked_for(trial: Command) -> None:
    words = ("run", "--until", "2", "--then", "repeat", "--reason", "noise", *FAST, "--json")
    status, document, _ = trial(*words)
    assert status == 0 and [one["iteration"] for one in document["swims"]] == [1, 1]
    assert {one["reason"] for one in document["swims"]} == {"noise"}


def test_nobody_there_keeps_what_is_plainly_good(trial: Command) -> None:
    status, document, _ = trial("run", "--guide", "--rest", "1", "--json")
    assert status == 0 and document["swims"][0]["decision"] == "keep"


def test_nobody_there_decides_nothing_else(trial: Command, board: SimBoard) -> None:
    with Fish.connect("it") as fish:
        fish.params.set("SPD_SOURCE", 1)
    status, out, err = trial("run", "--guide", *FAST)
    assert status == 1 and out == ""
    assert err.splitlines()[-1].startswith("tailbeat: trial 1 waits on the board: ")
    assert "--then keep|repeat|discard" in err
    with Fish.connect("it") as fish:
        assert fish.status().pending_trial == 1
    status, out, err = trial("run", "--until", "1", "--then", "discard", "--reason", "x", *FAST)
    assert status == 0 and re.findall(r"^trial (\d)", out, re.M) == ["1", "2"]
    rows = [line.split() for line in err.splitlines() if line.endswith("discard")]
    assert [row[:2] for row in rows] == [["1", "p"], ["2", "p"]], "the law, by the event log"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--then", "discard"), "--reason"),
        (("--then", "drop"), "'drop' is not one of 'keep', 'repeat', 'discard'"),
        (("--reason", "why"), "--then"),
        (("--no-guide", "--until", "3"), "--no-guide"),
        (("--no-guide", "--no-learn"), "--no-guide"),
    ],
)
def test_senseless_options(trial: Command, words: tuple[str, ...], told: str) -> None:
    status, out, err = trial("run", *words)
    assert status == 2 and not out and told in err and err.count("\n") == 1


def test_no_end(trial: Command) -> None:
    status, _, err = trial("run", "--until", "never")
    assert status == 1 and "converged, battery or a number" in err
    assert not Path("experiments").exists()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("trial", "run", "--until", "never"), "'never' says no end of a series"),
        (("trial", "run", "--into", "nowhere"), "nowhere is no experiment"),
        (("trial", "run", "--camera", "0"), "a camera needs a calibration"),
        (("trial", "run", "--camera", "tcp:there"), "tcp:there has no port number"),
        (("trial", "run", "--video", "a.mkv"), "--video films what a camera sees"),
        (("session", "commission", "--calibration", "none.json"), "none.json"),
        (("session", "commission", "--camera", "0"), "a camera needs a calibration"),
        (("session", "resume", "--into", "nowhere"), "nowhere is no experiment"),
        (("session", "resume", "--camera", "0"), "a camera needs a calibration"),
        (("session", "status", "--into", "nowhere"), "nowhere is no experiment"),
        (("session", "trim", "--camera", "0"), "a camera needs a calibration"),
        (("session", "identify", "--camera", "0"), "a camera needs a calibration"),
        (("session", "identify", "--out", "nowhere/a.json"), "there is no folder nowhere"),
        (("session", "identify", "--plot", "nowhere/a.png"), "there is no folder nowhere"),
        (("session", "frist"), "Did you mean 'first'? Try: "),
    ],
)
def test_what_can_be_told_before_there_is_a_board(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    told: str,
) -> None:
    def connect(url: str | None) -> None:
        raise AssertionError("nobody is to be called")

    monkeypatch.setattr("tailbeat.board.fish.open_transport", connect)
    assert run(list(words)) in (1, 2)
    err = capsys.readouterr().err
    assert told in err and err.count("\n") == 1


def test_another_fish_s_experiment(trial: Command) -> None:
    trial("run", "--then", "keep", *FAST)
    experiment = the_experiment()
    experiment.write_settings({"unique_id": "ab" * 16})
    status, _, err = trial("run", "--into", str(experiment.folder), "--then", "keep")
    assert status == 1 and err.count("\n") == 1 and "another fish" in err


def test_no_room_is_refused_unguided_too(trial: Command) -> None:
    with Fish.connect("it") as fish:
        fish.params.set("TANK_LEN_M", 0.66)
        fish.params.set("DU_MAX_RAD", 0)
        fish.upload_amplitudes(np.full(5, 0.5, np.float32))
    status, _, err = trial("run")
    assert status == 1 and err.count("\n") == 1 and "TANK_LEN_M" in err
    with Fish.connect("it") as fish:
        assert fish.status().next_trial == 1 and fish.status().state == "IDLE"


def test_discard_with_a_reason_is_journalled(trial: Command) -> None:
    trial("run", "--then", "keep", *FAST)
    trial("run", "--no-guide")
    assert trial("discard", "--reason", "touched the wall")[0] == 0
    last = the_experiment().journal.entries("decided")[-1]
    assert (last["trial"], last["decision"], last["reason"]) == (2, "discard", "touched the wall")
    assert len(the_experiment().trials()) == 2


def test_discard_outside_of_an_experiment_is_as_ever(trial: Command) -> None:
    trial("run")
    assert trial("discard")[0] == 0 and not Path("experiments").exists()


# the person


class Typed:
    """Keys that come one after the other."""

    def __init__(self, keys: str, lines: tuple[str, ...] = (), pressed: bool = False) -> None:
        self._keys, self._lines, self._pressed = list(keys), list(lines), pressed
        self.forgotten = 0

    def pressed(self) -> bool:
        return self._pressed

    def forget(self) -> None:
        self.forgotten += 1

    def key(self, timeout_s: float) -> str | None:
        key = self._keys.pop(0)
        return None if key == "_" else key

    def line(self) -> str:
        return self._lines.pop(0)


class Typing(Typed):
    """Keys are pressed as long as they are not taken."""

    def pressed(self) -> bool:
        return bool(self._keys)

    def types(self, keys: str) -> None:
        self._keys += keys


def recorded(end: str = "complete", measured: int = 5, *problems: str) -> RecordedTrial:
    outcome = TrialOutcome(7, 2, end, 5)
    return RecordedTrial(
        outcome, Path("7.ulg"), None, None, 0.01, 0.01, measured, 5, 8.0, 7.9, problems
    )


def stopped(by: StopReason) -> RecordedTrial:
    end = "aborted:ABORT_COMMAND"
    return replace(recorded(end, 3, f"not complete: {end} ({by})"), stopped=by)


@pytest.mark.parametrize(
    ("keys", "lines", "wanted"),
    [
        ("k", (), Decision("keep")),
        ("\n", (), Decision("keep")),
        ("__xk", (), Decision("keep")),
        ("d", ("bumped",), Decision("discard", "bumped")),
        ("r", ("", "", "noise"), Decision("repeat", "noise")),
    ],
)
def test_keys_decide(keys: str, lines: tuple[str, ...], wanted: Decision) -> None:
    idle = []
    typed = Typed(keys, lines)
    operator = TerminalOperator(Display(), typed, None, lambda: idle.append(1))
    assert operator.decide(recorded()) == wanted
    assert typed.forgotten == 1, "the key that stopped the tail is no answer"
    assert len(idle) == len(keys) - 1, "the link goes on while the question waits"


def test_what_is_proposed(capsys: pytest.CaptureFixture[str]) -> None:
    wall = recorded("aborted:WALL", 3, "not complete: aborted:WALL")
    by_hand = stopped(BY_HAND)
    for one, reason in ((wall, "too close to the wall"), (by_hand, "stopped by hand")):
        operator = TerminalOperator(Display(), Typed("\n", ("",)))
        assert operator.decide(one) == Decision("discard", reason)
        assert "Esc = later, Enter = discard" in capsys.readouterr().err
    room = stopped(StopReason(StopKind.DISTANCE, "room: 2 m"))
    assert TerminalOperator(Display(), Typed("\n")).decide(room) == Decision("keep")


def test_keep_is_no_answer_for_a_swim_without_speeds() -> None:
    operator = TerminalOperator(Display(), Typed("kd", ("no camera",)))
    assert operator.decide(recorded("complete", 0)) == Decision("discard", "no camera")


def test_a_few_missing_beats_need_no_answer() -> None:
    nobody = TerminalOperator(Display(), None, None)
    one = recorded("complete", 39, "1 of 40 beats have no speed")
    assert nobody.decide(replace(one, judged=True)) == Decision("keep")
    others = replace(one, judged=True, problems=(*one.problems, "not straight: +20 degrees off"))
    for wrong in (one, others, replace(one, judged=True, problems=("no beat of it",))):
        with pytest.raises(Undecided):
            nobody.decide(wrong)


def test_at_a_terminal_the_table_is_not_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    end = SeriesEnd("swims", "1 trial", [Round(recorded(), Decision("keep"), None)], None)
    assert _text(end, good=True).splitlines()[1:] == ["ended: 1 trial"]
    for name in ("stdout", "stderr"):
        screen = io.StringIO()
        monkeypatch.setattr(screen, "isatty", lambda: True)
        monkeypatch.setattr(sys, name, screen)
    assert _text(end, good=True) == "ended: 1 trial"


def test_escape_puts_it_off() -> None:
    with pytest.raises(KeyboardInterrupt, match="put off"):
        TerminalOperator(Display(), Typed("\x1b")).decide(recorded())


def test_the_answer_given_beforehand() -> None:
    nobody = TerminalOperator(Display(), None, Decision("keep"))
    by_hand = stopped(BY_HAND)
    assert nobody.decide(by_hand) == Decision("keep")
    somebody = TerminalOperator(Display(), Typed("d", ("bumped",)), Decision("keep"))
    assert somebody.decide(recorded()) == Decision("keep")
    assert somebody.decide(by_hand) == Decision("discard", "bumped")


def test_nobody() -> None:
    nobody = TerminalOperator(Display(), None)
    assert nobody.decide(recorded()) == Decision("keep")
    for one in (recorded("complete", 5, "not straight"), recorded("aborted:WALL")):
        with pytest.raises(Undecided):
            nobody.decide(one)
    assert not nobody.confirm("Clear it?") and not nobody.wants_abort()


def test_the_enter_after_a_letter_stops_nothing() -> None:
    for letter, events, typed_later, stops in (
        ("k", [], "\n", False),
        ("k", [], "x", True),
        ("k", [Countdown(5)], "\n", True),
        ("k", [TrialStarted(8, 1)], "\n", True),
        ("\n", [], "\n", True),
    ):
        keys = Typing(letter)
        operator = TerminalOperator(Display(), keys)
        assert operator.decide(recorded()) == Decision("keep") and not operator.wants_abort()
        for event in events:
            operator.tell(event)
        keys.types(typed_later)
        assert operator.wants_abort() == stops, (letter, events, typed_later)
        if not stops:
            assert not operator.wants_abort()
            keys.types("\n")
            assert operator.wants_abort(), "one is forgiven, not two"


def test_what_was_typed_before_the_countdown_is_forgotten() -> None:
    keys = Typed("")
    TerminalOperator(Display(), keys).tell(StepProgress("board", "idle", True, None))
    assert keys.forgotten == 1


def test_confirm() -> None:
    assert TerminalOperator(Display(), Typed("\n_y")).confirm("Clear it?")
    assert not TerminalOperator(Display(), Typed("n")).confirm("Clear it?")
