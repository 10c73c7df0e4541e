"""The operator at a terminal: sees what goes on, stops it with a key, decides. The terminal is put
back as it was in every case."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import Annotated

from tailbeat.app.cli._lazy import opt
from tailbeat.app.cli._terminal import Display, ended, json_asked
from tailbeat.app.cli._trial_table import TrialTable
from tailbeat.core.errors import TailbeatError
from tailbeat.core.faults import ABORT_COMMAND, fault_info
from tailbeat.core.platform.terminal import Keys, terminal_keys
from tailbeat.link.messages import LearnReport
from tailbeat.session.collect import is_good, proposed_decision
from tailbeat.session.events import (
    Assessed,
    BoardText,
    Countdown,
    Event,
    InputChosen,
    LiveValues,
    StepProgress,
    TrialDecided,
    TrialRecorded,
    TrialStarted,
    TrialStopped,
)
from tailbeat.session.outcome import BY_HAND, Decision, RecordedTrial
from tailbeat.session.preflight_step import PreflightLimits
from tailbeat.session.presenter import (
    alert,
    countdown_text,
    live_text,
    record_lines,
    result,
    step_text,
)

_LOOK_S = 0.2  # how long a question goes without a heartbeat to the board
KINDS = {"k": ("keep", "keep"), "r": ("repeat", "repeat"), "d": ("discard", "discard")}
COUNTS = {"c": ("keep", "it counts"), "d": ("discard", "discard")}  # of a repeat
_ENTER = ("\r", "\n")
_ESCAPE = "\x1b"
_ABORTED = fault_info(ABORT_COMMAND).meaning


def _with_rest(rest_s: float) -> PreflightLimits:
    return PreflightLimits(rest_s=rest_s)


Rest = Annotated[
    PreflightLimits | None,
    opt("Rest since the last trial; default: 30.", "S", by=_with_rest, min=0.0, max=3600.0),
]
_FIRST_STEP = "board"  # of the preflight checks: what was typed before it is no answer


class Undecided(TailbeatError):
    """There is nobody to say what becomes of a trial; it waits on the board."""


@contextmanager
def terminal(single_keys: bool = True) -> Iterator[tuple[Display, Keys | None]]:
    """Display and keys, both put back at the end; no keys where the display is none, or where
    lines are to be typed."""
    keyboard = terminal_keys() if single_keys else nullcontext()
    with Display(quiet=json_asked.get()) as display, keyboard as keys:
        yield display, keys if display.moves else None


@dataclass
class TerminalOperator:
    """``keys`` None: nobody is there to press any. ``then``: the answer given beforehand; somebody
    who is there and stopped the trial is asked all the same, before it is learned from. ``idle`` is
    called again and again while a question waits. ``kinds``: letter to kind of decision and its
    word. ``on_event``: gets every event, too. ``agrees``: answers every question with yes."""

    display: Display
    keys: Keys | None
    then: Decision | None = None
    idle: Callable[[], None] = lambda: None
    kinds: Mapping[str, tuple[str, str]] = field(default_factory=lambda: KINDS)
    on_event: Callable[[Event], None] = lambda event: None
    agrees: bool = False
    table: TrialTable = field(default_factory=TrialTable)
    _law: str = ""  # of the last input
    _enter_may_follow: bool = False  # the one that many type after a letter
    _stopped_by_hand: bool = False

    def tell(self, event: Event) -> None:
        """Shows it."""
        self.on_event(event)
        display = self.display
        match event:
            case StepProgress():
                if self.keys is not None and event.step == _FIRST_STEP:
                    self.keys.forget()
                line = step_text(event)
                display.keep(line) if event.ok is False else display.show(line)
            case Countdown():
                self._enter_may_follow = self._stopped_by_hand = False
                display.bell()
                display.show(countdown_text(event))
            case TrialStarted():
                self._enter_may_follow = self._stopped_by_hand = False
            case LiveValues():
                display.show(live_text(event, self.keys is not None, display.width))
            case TrialRecorded(record):
                self.table.lines(event)
                seen = self._decides(record)
                for line in record_lines(record) if seen else ():
                    display.keep(line)
                for problem in record.other_problems if seen else record.problems:
                    display.keep(f"  ! {problem}")
            case TrialDecided() | LearnReport():
                for line in self.table.lines(event):
                    display.keep(line)
            case InputChosen():
                if event.law != self._law:
                    display.keep(result(event))
                self._law = event.law
            case Assessed() if not event.stop:  # the table stays whole
                (display.show if display.moves else display.keep)(event.words)
                if event.saturation:
                    self.display.keep(event.saturation)
            case BoardText(_, text) if self._stopped_by_hand and text == _ABORTED:
                pass  # whoever pressed the key knows
            case _:
                self._keep(event)

    def _keep(self, event: Event) -> None:
        """Lines that stay."""
        if isinstance(event, TrialStopped) and event.reason == BY_HAND:
            self._stopped_by_hand = True
        if words := alert(event):
            self.display.keep(f"tailbeat: {words}", loud=True)
        elif words := result(event):
            self.display.keep(words)

    def wants_abort(self) -> bool:
        """Any key, but for the Enter after an answer."""
        keys = self.keys
        if keys is None or not keys.pressed():
            return False
        if self._enter_may_follow:
            self._enter_may_follow = False
            return keys.key(0.0) not in _ENTER
        return True

    def decide(self, recorded: RecordedTrial) -> Decision:
        """The answer given beforehand, else by a key. Raises Undecided when nobody is there and
        the trial is not plainly good."""
        if self.keys is not None and self._decides(recorded):
            return self._ask(self.keys, recorded, proposed_decision(recorded))
        if self.then is not None:
            return self.then
        if is_good(recorded):
            return Decision("keep")
        raise Undecided(
            f"trial {recorded.outcome.number} waits on the board: {'; '.join(recorded.problems)}",
            "Say what becomes of it: tailbeat trial run --then keep|repeat|discard --reason WHY,"
            " or at a terminal.",
        )

    def _decides(self, recorded: RecordedTrial) -> bool:
        """Whether whoever is there is asked."""
        unseen = self.then == Decision("keep") and proposed_decision(recorded).kind != "keep"
        return self.keys is not None and (self.then is None or unseen)

    def confirm(self, question: str) -> bool:
        """With y; without a terminal the answer is no."""
        if self.agrees or self.keys is None:
            return self.agrees
        self.keys.forget()
        self.display.ask(f"{question} y/n ")
        key = self._key(self.keys, ("y", "n"))
        self.display.keep(key)
        return key == "y"

    def number(self, question: str, value: float) -> float | None:
        """Typed; with ``agrees`` as if it was, without a terminal not."""
        if self.agrees or self.keys is None:
            return value if self.agrees else None
        self.keys.forget()
        self.display.ask(f"{question} {value:g}: ")
        typed = self.keys.line()
        self._enter_may_follow = False
        try:
            return float(typed.replace(",", "."))
        except ValueError:
            return None

    def _ask(self, keys: Keys, recorded: RecordedTrial, proposal: Decision) -> Decision:
        letters = [
            k for k, (kind, _) in self.kinds.items() if kind != "keep" or recorded.measured_beats
        ]
        words = ", ".join(f"{letter} = {self.kinds[letter][1]}" for letter in letters)
        usual = next(pair for pair in self.kinds.values() if pair[0] == proposal.kind)
        keys.forget()  # the key that stopped the tail is no answer
        self.display.bell()
        self.display.ask(f"{words}, Esc = later, Enter = {usual[1]}: ")
        key = self._key(keys, (*letters, *_ENTER))
        kind, word = usual if key in _ENTER else self.kinds[key]
        self.display.keep(word)
        if kind == "keep":
            return Decision("keep")
        return Decision(kind, self._reason(keys, proposal.reason))  # type: ignore[arg-type]

    def _reason(self, keys: Keys, usual: str) -> str:
        self.display.ask(f"why? [{usual}] " if usual else "why? ")
        while not (reason := keys.line() or usual):
            self.display.ask("a reason is needed, one word is enough: ")
        self._enter_may_follow = False
        return reason

    def _key(self, keys: Keys, answers: tuple[str, ...]) -> str:
        """One of ``answers``, however long it takes; what else there is to press is said once.
        Escape puts the question off, as Ctrl-C."""
        reminded = False
        while True:
            key = keys.key(_LOOK_S)
            if why := ended():
                raise KeyboardInterrupt(why)
            if key == _ESCAPE:
                raise KeyboardInterrupt("put off")
            if key is not None and key in answers:
                self._enter_may_follow = key not in _ENTER
                return key
            if key is not None and not reminded:
                reminded = True
                self.display.ask(f"({_named(answers)}) ")
            self.idle()


def _named(keys: tuple[str, ...]) -> str:
    """``k, r, d or Enter``."""
    names = [key for key in keys if key not in _ENTER]
    names += ["Enter"] if len(names) < len(keys) else []
    return f"{', '.join(names[:-1])} or {names[-1]}"
