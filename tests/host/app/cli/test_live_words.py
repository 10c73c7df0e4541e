"""What is said of a guided swim: the line while it swims, and what a key press that stops it
leaves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tailbeat.app.cli._operator import TerminalOperator
from tailbeat.app.cli._terminal import Display
from tailbeat.core.errors import InputError
from tailbeat.link.messages import TrialOutcome
from tailbeat.session.events import (
    BoardText,
    Event,
    LiveValues,
    TrialRecorded,
    TrialStarted,
    TrialStopped,
)
from tailbeat.session.outcome import BY_HAND, Decision, RecordedTrial, StopKind, StopReason
from tailbeat.session.presenter import live_text

from ...session.test_trial_run_guided import Typed

LIVE = LiveValues(True, 98, 100, 0.1633, 0.17, 0.7, 7.92, 0.4)
UNKNOWN = LiveValues(False, beats=100)


@pytest.mark.parametrize("width", [60, 80, 120])
@pytest.mark.parametrize("link", [{"silent_s": 0.4}, {"silent_s": 12.0}])
def test_the_words_that_matter_stay(width: int, link: dict[str, float]) -> None:
    line = live_text(replace(LIVE, **link), True, width)
    assert len(line) <= width
    late = "silent 12 s" in line
    assert late == (link["silent_s"] > 5) and (late or "link ok" in line)
    for word in ("simulated", "any key stops", "99/100", "163.3", "170.0"):
        assert word in line, (width, line)
    assert ("7.92 V" in line) == (width >= 80), line
    assert late or ("40.1 deg" in line) == (width >= 80), line
    assert ("amplitude 40.1 deg" in line and "reference 170.0" in line) == (width == 120), line


def test_where_nothing_fits_the_stop_is_what_is_left() -> None:
    assert live_text(LIVE, True, 20)[: len("simulated  any key stops")].endswith("any key stops")


def test_the_line_without_a_key_and_of_what_is_not_known() -> None:
    assert live_text(UNKNOWN, False, 80) == "link ok  starting  v - mm/s  reference -"


def test_the_line_is_as_wide_as_the_window(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[str] = []
    display = Display()
    display.moves = True
    monkeypatch.setattr(display, "show", shown.append)
    for columns in ("60", "120"):
        monkeypatch.setenv("COLUMNS", columns)
        display._terminal = None  # asks the environment once
        TerminalOperator(display, Typed("")).tell(LIVE)
    narrow, wide = shown
    assert 50 < len(narrow) <= 60 < len(wide) <= 120


def told(operator: TerminalOperator, *events: Event) -> None:
    for event in events:
        operator.tell(event)


def swum_event() -> TrialRecorded:
    outcome = TrialOutcome(7, 2, "aborted:ABORT_COMMAND", 5)
    problems = ("not complete: aborted:ABORT_COMMAND (stopped by hand)", "not straight")
    recorded = RecordedTrial(
        outcome, Path("7.ulg"), None, None, 0.01, 0.01, 3, 5, 8.0, 7.9, problems, False, BY_HAND
    )
    return TrialRecorded(recorded)


ABORTED = BoardText(4, "trial aborted by command")


def test_a_key_press_that_stops_says_it_once(capsys: pytest.CaptureFixture[str]) -> None:
    operator = TerminalOperator(Display(), Typed(""))
    told(operator, TrialStopped(BY_HAND), ABORTED, swum_event())
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "tailbeat: stopped by hand"
    assert lines[1] == (
        "trial 7: aborted:ABORT_COMMAND (stopped by hand), 5 beats, 3 of 5 beats measured"
    )
    assert lines[2].startswith("  largest error max|e| ") and lines[3:] == ["  ! not straight"]


def test_an_abort_from_elsewhere_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    """Also in the trial after one that was stopped by a key."""
    operator = TerminalOperator(Display(), Typed(""))
    told(operator, TrialStopped(BY_HAND))
    told(operator, TrialStarted(8, 1), ABORTED)
    told(operator, TrialStopped(StopReason(StopKind.DISTANCE, "room: 2 m")), ABORTED)
    told(operator, TrialStopped(BY_HAND))
    told(operator, BoardText(4, "battery critical"))
    assert capsys.readouterr().err.splitlines() == [
        "tailbeat: stopped by hand",
        "tailbeat: trial aborted by command",
        "tailbeat: stopped: room: 2 m",
        "tailbeat: trial aborted by command",
        "tailbeat: stopped by hand",
        "tailbeat: battery critical",
    ]


def recorded() -> RecordedTrial:
    outcome = TrialOutcome(7, 2, "complete", 5)
    return RecordedTrial(outcome, Path("7.ulg"), None, None, 0.01, 0.01, 5, 5, 8.0, 7.9, ())


def test_another_key_is_answered_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert TerminalOperator(Display(), Typed("xx_ k")).decide(recorded()) == Decision("keep")
    err = capsys.readouterr().err
    assert err.count("(k, r, d or Enter) ") == 1 and err.count("\n") == 1, "in the question's line"
    assert not TerminalOperator(Display(), Typed("xxn")).confirm("Clear it?")
    assert capsys.readouterr().err == "Clear it? y/n (y or n) n\n"
    TerminalOperator(Display(), Typed("__k")).decide(recorded())
    assert " or Enter)" not in capsys.readouterr().err, "nothing was pressed"


def test_a_reason_is_asked_for_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    operator = TerminalOperator(Display(), Typed("d", ("", "wall")))
    assert operator.decide(recorded()) == Decision("discard", "wall")
    _, _, asked = capsys.readouterr().err.partition("why? ")
    assert asked == "a reason is needed, one word is enough: "


@pytest.mark.parametrize(
    ("message", "told"),
    [
        ("what is it", "what is it. Say it."),
        ("what is it.", "what is it. Say it."),
        ("what is it?", "what is it? Say it."),
    ],
)
def test_one_mark_ends_a_message(message: str, told: str) -> None:
    assert str(InputError(message, "Say it.")) == told
