"""What a session reports while it goes on: one class per event, ``Event`` is any of them; and the
operator who gets them.

The terminal, the page, the film and the event log match on the class. A beat is reported as
``BeatEvent``, a learning step as ``LearnReport``, both as the link decodes them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from tailbeat.learning.diagnosis import CauseFound
from tailbeat.link.messages import BeatEvent, LearnReport
from tailbeat.session.outcome import Decision, RecordedTrial, StopReason


@dataclass(frozen=True)
class StepProgress:
    """A preflight step. ``ok`` None: under way; ``left_s`` None: not known."""

    step: str
    text: str
    ok: bool | None = None
    left_s: int | None = None


@dataclass(frozen=True)
class Countdown:
    """Whole seconds until the tail starts; 0: it starts."""

    left_s: int


@dataclass(frozen=True)
class TrialStarted:
    """The board executes the trial. ``run``: names one that follows no reference of the fish's, to
    trim or to measure it."""

    trial: int
    iteration: int
    run: str = ""


@dataclass(frozen=True)
class LiveValues:
    """Values of a running trial, about ten times a second; None: not known. ``silent_s``: since the
    last message of the board."""

    simulated: bool
    beat: int | None = None
    beats: int | None = None
    speed_m_s: float | None = None
    reference_m_s: float | None = None
    amplitude_rad: float | None = None
    battery_v: float | None = None
    silent_s: float | None = None


@dataclass(frozen=True)
class TrialStopped:
    """A guard stops the trial."""

    reason: StopReason


@dataclass(frozen=True)
class InterruptRequested:
    """Ctrl-C: the tail is being stopped."""


@dataclass(frozen=True)
class LinkLost:
    """The link broke; reconnecting."""


@dataclass(frozen=True)
class LinkRestored:
    """The link works again; ``state`` of the board."""

    state: str


@dataclass(frozen=True)
class TrialEnded:
    """The tail rests and the board has stored the trial."""

    trial: int
    end: str


@dataclass(frozen=True)
class InputChosen:
    """What makes the next input. ``law``: ``p`` (the board's own step), ``model``, or ``best`` (the
    best input so far). ``why``: the reason, in words. ``expected_m_s``: 5 %, median and 95 % of its
    max|e| by the model; None: not known."""

    law: str
    why: str
    expected_m_s: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class TrialRecorded:
    """The trial's log is in the experiment; a decision follows. ``made``: what made its input;
    None: not known."""

    record: RecordedTrial
    made: InputChosen | None = None


@dataclass(frozen=True)
class TrialDecided:
    """What becomes of a trial."""

    trial: int
    decision: Decision


@dataclass(frozen=True)
class StepBegun:
    """A step of a guided job. ``why``: what it is for; ``takes``: how long; ``press``: which keys.
    All in words."""

    number: int
    of: int
    name: str
    why: str
    takes: str
    press: str = ""


@dataclass(frozen=True)
class StepEnded:
    """``done`` False: it failed or was left out, as ``words`` say."""

    name: str
    done: bool
    words: str


@dataclass(frozen=True)
class Assessed:
    """The convergence assessment after a learning step; ``saturation`` empty: none."""

    words: str
    stop: bool
    stop_reason: str
    advice: str
    saturation: str = ""


@dataclass(frozen=True)
class TrialDiagnosed:
    """What explains a trial's error, the most important cause first; empty = nothing to be done."""

    trial: int
    causes: tuple[CauseFound, ...]


@dataclass(frozen=True)
class Notice:
    """Information that stops nothing."""

    text: str


@dataclass(frozen=True)
class TrialWarning:
    """Something is wrong with the running trial; it goes on."""

    text: str


@dataclass(frozen=True)
class HoldRequest:
    """The operator has to hold the fish still."""

    text: str


@dataclass(frozen=True)
class BoardText:
    """A line of text of the board; ``severity`` as MAV_SEVERITY, lower is worse."""

    severity: int
    text: str


Event = (
    StepProgress
    | Countdown
    | TrialStarted
    | LiveValues
    | BeatEvent
    | TrialStopped
    | InterruptRequested
    | LinkLost
    | LinkRestored
    | TrialEnded
    | TrialRecorded
    | TrialDecided
    | LearnReport
    | StepBegun
    | StepEnded
    | InputChosen
    | Assessed
    | TrialDiagnosed
    | Notice
    | TrialWarning
    | HoldRequest
    | BoardText
)
OnEvent = Callable[[Event], None]


class Operator(Protocol):
    """All methods are called in the thread that swims, none is called in another."""

    def tell(self, event: Event) -> None:
        """Something happened. Must return at once."""

    def wants_abort(self) -> bool:
        """Whether the tail is to stop, or the waiting before the start to end; asked some ten times
        a second. Stays true until the trial or the waiting has ended."""

    def decide(self, recorded: RecordedTrial) -> Decision:
        """What becomes of it; may take as long as it likes, the tail is still."""

    def confirm(self, question: str) -> bool:
        """A question with yes or no; as above."""

    def number(self, question: str, value: float) -> float | None:
        """Whether ``value`` is typed, so that nobody allows it by a slip; None = nothing was."""


def notice_to(operator: Operator) -> Callable[[str], None]:
    """Reports a text as a Notice."""
    return lambda text: operator.tell(Notice(text))
