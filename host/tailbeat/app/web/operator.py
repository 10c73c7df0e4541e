"""The operator of a session whose answers come from a browser."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from tailbeat.app.web import state
from tailbeat.app.web.inbox import Ask, number_of
from tailbeat.app.web.state import PageState, Phase, Screen
from tailbeat.app.web.trials import PageTrials
from tailbeat.board.fish import Fish
from tailbeat.link.messages import LearnReport
from tailbeat.session.events import Event, StepEnded, TrialDecided
from tailbeat.session.outcome import Decision, RecordedTrial


class Desk(Protocol):
    """What the operator needs of the worker."""

    screen: Screen
    trials: PageTrials

    @property
    def now(self) -> PageState: ...

    @property
    def wants_abort(self) -> bool: ...

    def answered(self, fish: Fish, kind: str, **shown: Any) -> Ask:
        """Waits for an answer; the link is kept meanwhile."""

    def set_phase(self, phase: Phase, *open_: str, **changes: Any) -> None:
        """What is shown first, then what may be asked."""

    def look_at_reference(self, fish: Fish) -> None:
        """The board has another one."""


@dataclass(frozen=True)
class PageOperator:
    """The operator at a browser."""

    worker: Desk
    fish: Fish

    def tell(self, event: Event) -> None:
        """Shown at once."""
        worker = self.worker
        worker.screen.show(state.after(worker.now, event, state.clock()))
        match event:
            case LearnReport() | TrialDecided(_, Decision("repeat" | "discard")):
                worker.trials.refresh()
            case StepEnded():  # whatever it has run, the board has its reference again
                worker.look_at_reference(self.fish)

    def wants_abort(self) -> bool:
        """The flag itself."""
        return self.worker.wants_abort

    def decide(self, recorded: RecordedTrial) -> Decision:
        """Whoever decides first decides."""
        self.worker.trials.refresh()
        ask = self.worker.answered(self.fish, "decide", recorded=recorded, step="", left_s=None)
        self.worker.set_phase("working", "note", recorded=None)
        return Decision(ask.values["kind"], ask.values["reason"])

    def confirm(self, question: str) -> bool:
        """Likewise."""
        ask = self.worker.answered(self.fish, "answer", question=state.on_the_page(question))
        self.worker.set_phase("working", "note", question="")
        return bool(ask.values["yes"])

    def number(self, question: str, value: float) -> float | None:
        """What is typed below the question, which stays until it is a number or the answer no."""
        worker, more, typed = self.worker, "", None
        while typed is None:
            words = state.on_the_page(f"{question} {value:g}.") + more
            ask = worker.answered(self.fish, "answer", question=words, number=value)
            if not ask.values["yes"]:
                break
            typed = number_of(ask.values["typed"])
            more = f" '{ask.values['typed']}' is no number: type it, or answer no."
        worker.set_phase("working", "note", question="", number=None)
        return typed
