"""Commands that decide on a trial and let the board learn, in the experiment the fish is in."""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from tailbeat.app.cli.app import app
from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, Refused
from tailbeat.core.reference import Reference
from tailbeat.experiment.analysis import analyse
from tailbeat.experiment.current import begin
from tailbeat.experiment.folder import Experiment, held_state
from tailbeat.experiment.library import library_of
from tailbeat.experiment.redo import relearn
from tailbeat.link.messages import BeatEvent
from tailbeat.session.collect import keep_log, outcome_of, proposed_decision, record_of
from tailbeat.session.events import Event
from tailbeat.session.guards import stop_when
from tailbeat.session.log import SessionLog
from tailbeat.session.outcome import BY_HAND, Decision, StopKind, StopReason
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport

HILL = Reference(1.0, (0.07 * np.sin(np.linspace(0.2, 2.9, 6))).astype(np.float32), "hill")


@pytest.fixture
def fish(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Fish]:
    """A fish with a reference that every command connects to."""
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "logbook"))
    board = SimBoard("tank", seed=1)
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: SimTransport(board))
    with Fish.connect("it") as fish:
        fish.params.set("ILC_LEAD", 1)
        fish.upload_reference(HILL)
        yield fish


@pytest.fixture
def experiment(fish: Fish, tmp_path: Path) -> Experiment:
    return begin(fish, tmp_path / "experiments")


def types(*words: str) -> Result:
    return CliRunner().invoke(app, [*words, "--connect", "it"])


def trials(fish: Fish, until_beat: int | None = None) -> int:
    """The next trial, as ``trial run`` in a script swims it; its number."""
    fish.arm()
    reached = False

    def hear(event: Event) -> None:
        nonlocal reached
        reached = reached or (isinstance(event, BeatEvent) and event.beat == until_beat)

    return run_trial(fish, on_event=hear, guard=stop_when(lambda: reached, BY_HAND)).number


def whats(experiment: Experiment) -> list[str]:
    return [entry["what"] for entry in experiment.journal.entries()][1:]


def test_what_learn_learns_is_in_the_experiment(fish: Fish, experiment: Experiment) -> None:
    for _ in range(2):
        trials(fish)
        assert types("learn").exit_code == 0
    assert whats(experiment) == ["swum", "decided", "learned"] * 2
    assert experiment.journal.decisions()[2]["decision"] == "keep"
    assert sorted(path.name for path in experiment.raw.glob("*.ulg")) == ["0001.ulg", "0002.ulg"]
    analysis = analyse(experiment)
    assert [(row.decision, row.learned) for row in analysis.rows] == [("keep", True)] * 2
    held = held_state(experiment)
    assert held is not None and held.learned == fish.learned_record()
    assert SessionLog(experiment).open_trial() is None


def test_what_is_dropped_without_a_word_is_in_it_too(fish: Fish, experiment: Experiment) -> None:
    for words, kind in (
        (("trial", "discard"), "discard"),
        (("trial", "discard", "--repeat"), "repeat"),
    ):
        number = trials(fish)
        assert types(*words).exit_code == 0
        decision = experiment.journal.decisions()[number]
        assert (decision["decision"], decision["reason"]) == (kind, "by command, no reason given")
    assert [row.trial for row in analyse(experiment).rows] == [1, 2]


def test_the_best_brought_back_is_in_the_experiment(fish: Fish, experiment: Experiment) -> None:
    for _ in range(2):
        trials(fish)
        assert types("learn").exit_code == 0
    assert types("learn", "--restore-best").exit_code == 0
    assert experiment.journal.entries("restored")[0]["trial"] in (1, 2)
    held = held_state(experiment)
    assert held is not None and held.learned == fish.learned_record()
    again = relearn(analyse(experiment), held)
    assert again.learned == [1, 2] and not again.different


def test_what_was_kept_to_be_learned_later_is_decided_once(
    fish: Fish, experiment: Experiment
) -> None:
    account = SessionLog(experiment)
    log = keep_log(fish, experiment, trials(fish))
    recorded = record_of(outcome_of(log.trial), log, None)
    account.recorded(recorded)
    account.decided(recorded, Decision("keep"))
    assert types("learn").exit_code == 0
    assert whats(experiment) == ["swum", "decided", "learned"]


def test_a_swim_along_another_reference_is_none_of_the_experiments(
    fish: Fish, experiment: Experiment
) -> None:
    fish.upload_reference(Reference(1.0, HILL.speed_m_s * np.float32(0.9), "lower"))
    trials(fish)
    assert types("learn").exit_code == 0
    assert types("learn", "--restore-best").exit_code == 0
    assert whats(experiment) == [] and not list(experiment.raw.glob("*.ulg"))


def test_what_is_written_nowhere_is_told(fish: Fish, experiment: Experiment) -> None:
    fish.upload_reference(Reference(1.0, HILL.speed_m_s[::-1].copy(), "other"))
    for words in (("trial", "learn"), ("trial", "discard")):
        trials(fish)
        told = types(*words).stderr
        assert f"not written into {experiment.name}, which is of another reference" in told
    assert whats(experiment) == []


def test_nothing_is_learned_on_a_full_disk_before_it_is_written_down(
    fish: Fish, experiment: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    number = trials(fish)
    full = _FullDisk(monkeypatch, allowed=0)
    result = types("learn")
    assert isinstance(result.exception, InputError)
    assert fish.status().pending_trial == number
    full.allowed = 2  # for swum and decided; what was learned finds no room
    assert isinstance(types("learn").exception, InputError)
    assert fish.status().last_learned_trial == number
    full.allowed = 100
    assert types("learn").exit_code == 0, "what is owed is written down"
    assert whats(experiment) == ["swum", "decided", "learned"]
    assert isinstance(types("learn").exception, Refused)


class _FullDisk:
    """The journal takes so many lines more."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, allowed: int) -> None:
        self.allowed = allowed
        append = "tailbeat.experiment.store.Journal._append"
        from tailbeat.experiment.store import Journal

        real = Journal._append

        def limited(journal: Journal, line: bytes) -> None:
            if self.allowed <= 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            self.allowed -= 1
            real(journal, line)

        monkeypatch.setattr(append, limited)


@pytest.mark.parametrize("words", [("trial", "discard", "--reason", "a wave"), ("trial", "learn")])
def test_a_stopped_board_is_told_before_anything_is_written(
    fish: Fish, experiment: Experiment, words: tuple[str, ...]
) -> None:
    number = trials(fish, until_beat=1)
    assert fish.status().state == "ABORTED"
    before = whats(experiment)
    refused = types(*words).exception
    assert isinstance(refused, Refused)
    typed = " ".join(words).replace("a wave", "'a wave'")
    assert str(refused) == (
        "the board is stopped (ABORT_COMMAND: trial aborted by command)."
        f" tailbeat board clear, then again: tailbeat {typed}"
    )
    assert whats(experiment) == before
    fish.clear()
    assert types(*words).exit_code == 0
    assert fish.status().pending_trial is None
    assert experiment.journal.decisions()[number]["decision"] == (
        "keep" if words == ("trial", "learn") else "discard"
    )


@pytest.mark.parametrize("words", [("trial", "discard", "--reason", "a wave"), ("trial", "learn")])
def test_what_the_board_refuses_is_withdrawn(
    fish: Fish, experiment: Experiment, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    number = trials(fish)

    def refuses(self: Fish, trial: int | None = None) -> None:
        raise Refused(52, "WRITE_FAILED", "storage could not be written", "Try again.")

    for name in ("discard", "learn"):
        monkeypatch.setattr(Fish, name, refuses)
    assert isinstance(types(*words).exception, Refused)
    assert whats(experiment) == ["swum", "decided", "withdrawn"]
    account = SessionLog(experiment)
    assert account.decision_on(experiment.raw / f"{number:04d}.ulg") is None
    assert account.open_trial() == number
    book = library_of(fish)
    assert book is not None
    assert not any(one.mark for one in book.kept()[0])


def test_a_swim_that_somebody_stopped_is_proposed_to_be_dropped_whenever_asked(
    fish: Fish, experiment: Experiment
) -> None:
    """``stop`` from elsewhere: no program here knows of it but by the log."""
    log = keep_log(fish, experiment, trials(fish, until_beat=1))
    now = record_of(outcome_of(log.trial), log, None, BY_HAND)
    later = record_of(outcome_of(log.trial), log, None)
    assert proposed_decision(now) == Decision("discard", BY_HAND.text)
    assert proposed_decision(later).kind == "discard"


@pytest.mark.parametrize("written", ["now", "by an older version"])
@pytest.mark.parametrize(
    ("stopped", "wanted"),
    [
        (BY_HAND, Decision("discard", BY_HAND.text)),
        (StopReason(StopKind.DISTANCE, "room: travel 1.9 m"), Decision("keep")),
    ],
)
def test_who_stopped_it_is_known_after_a_restart(
    fish: Fish, experiment: Experiment, written: str, stopped: StopReason, wanted: Decision
) -> None:
    """The room's guard ends a swim with the same command as a key."""
    number = trials(fish, until_beat=1)
    log = keep_log(fish, experiment, number)
    at_once = record_of(outcome_of(log.trial), log, None, stopped)
    SessionLog(experiment).recorded(at_once)
    if written == "by an older version":
        path = experiment.journal.path
        path.write_text(re.sub(r', "stopped": \{[^}]*\}', "", path.read_text()))
        assert "stopped" not in experiment.journal.entries("swum")[-1]
    again = keep_log(fish, experiment, number)
    later = record_of(outcome_of(again.trial), again, None)
    assert proposed_decision(at_once) == proposed_decision(later) == wanted
    assert later.problems == at_once.problems
