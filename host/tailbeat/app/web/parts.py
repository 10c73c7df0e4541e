"""The parts of the page that show the fish: its state, the trials, questions to the operator.

Each element follows the snapshot by a function of it, and is changed only when that gives something
else.
"""

from __future__ import annotations

import html
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from nicegui import ui
from nicegui.events import GenericEventArguments

from tailbeat.app.web import view
from tailbeat.app.web.state import GuideStep, PageState
from tailbeat.app.web.worker import Worker
from tailbeat.core.errors import InputError
from tailbeat.core.printable import mm
from tailbeat.experiment.trial_rows import TrialRow
from tailbeat.session.collect import proposed_decision
from tailbeat.session.events import StepProgress
from tailbeat.session.outcome import RecordedTrial
from tailbeat.session.presenter import record_lines

Shown = TypeVar("Shown")

UNTIL = {
    "converged": "until it has converged",
    "1": "one trial",
    "3": "three trials",
    "10": "ten trials",
    "battery": "until the battery is low",
}
LAWS = {
    "auto": "model-based; P until the fish is known",
    "model": "model-based",
    "p": "P law on the board",
}
COMMISSION = {
    "new": "if the fish is unknown: three short trials",
    "anew": "again",
    "never": "no: trials only",
}
REASONS = (
    "bumped the wall",
    "water was not still",
    "hand in the water",
    "camera lost the fish",
    "not straight",
    "battery low",
)
_COLOURS = {"keep": "primary", "repeat": "grey-8", "discard": "grey-8"}
# What grows into its place moves from under a finger: dialogs and folds open in place.
AT_ONCE = "transition-duration=0"
# Icons drawn here: Quasar's own come from a font of 129 kB.
UNFOLDED = 'duration=0 expand-icon="M7 10l5 5 5-5z"'
_STEP_LOOKS = {True: "done", False: "bad", None: "under-way"}


class Live:
    """The elements of one browser's page that follow the worker's snapshot."""

    def __init__(self, worker: Worker) -> None:
        self.worker = worker
        self._followers: list[Callable[[PageState], None]] = []

    def refresh(self, now: PageState) -> None:
        """Shows what has changed."""
        for follower in self._followers:
            follower(now)

    def follow(self, of: Callable[[PageState], Shown], show: Callable[[Shown], object]) -> None:
        """Calls ``show`` whenever ``of`` the snapshot is another, and for the first one."""
        shown: list[Shown] = []

        def refresh(now: PageState) -> None:
            if [value := of(now)] != shown:
                shown[:] = [value]
                show(value)

        self._followers.append(refresh)

    def label(self, of: Callable[[PageState], str], classes: str) -> ui.label:
        """A text; hidden as long as it is empty."""
        label = ui.label().classes(classes)

        def show(text: str) -> None:
            label.set_text(text)
            label.set_visibility(bool(text))

        self.follow(of, show)
        return label

    def refusal(self, of: str) -> None:
        """Why the request, or the change of the parameter, of this card failed."""
        self.label(lambda now: now.problem if now.failed == of else "", "banner problem refusal")

    def drawn(
        self, of: Callable[[PageState], Shown], draw: Callable[[Shown], object], classes: str
    ) -> None:
        """An element whose content is drawn anew."""
        element = ui.element("div").classes(classes)

        def show(value: Shown) -> None:
            element.clear()
            with element:
                draw(value)

        self.follow(of, show)

    def look(self, element: ui.element, of: Callable[[PageState], str], *looks: str) -> None:
        """One of several looks."""
        self.follow(of, lambda look: dress(element, look, *looks))

    def dialog(
        self, dialog: ui.dialog, of: Callable[[PageState], Shown], fill: Callable[[Shown], None]
    ) -> None:
        """Opens when there is something to ask, and closes once somebody has answered."""

        def show(value: Shown) -> None:
            if not value:
                dialog.close()
                return
            fill(value)
            dialog.open()

        self.follow(of, show)

    def refused(self, what: str, **values: object) -> str:
        """Asks the worker; why it refuses, empty = it does not."""
        try:
            self.worker.ask(what, **values)
        except InputError as error:
            return str(error)
        return ""

    def ask(self, what: str, **values: object) -> bool:
        """Asks, and shows why not."""
        if why := self.refused(what, **values):
            warn(why)
        return not why


@contextmanager
def titled(title: str, classes: str = "") -> Iterator[None]:
    """A card with a heading."""
    with ui.element("section").classes(f"card {classes}").props(f'aria-label="{title}"'):
        ui.label(title).classes("title").props("role=heading aria-level=2")
        yield


class Choice:
    """A select of the browser's own with its label: for mouse, finger, keyboard and screen reader
    alike. ``on_change`` is called after ``value`` has changed."""

    def __init__(
        self,
        label: str,
        options: dict[str, str],
        on_change: Callable[[], object] = lambda: None,
        classes: str = "",
    ) -> None:
        self._on_change = on_change
        with ui.element("label").classes(f"choice {classes}"):
            ui.label(label)
            self._select = ui.element("select")
        self._select.on("change", self._chosen, js_handler="(e) => emit(e.target.value)")
        self.value = ""
        self.offer(options, next(iter(options)))

    def offer(self, options: dict[str, str], value: str) -> None:
        """Other options, with that one chosen."""
        self.value = value
        self._select.clear()
        with self._select:
            for name, words in options.items():
                chosen = " selected" if name == value else ""
                option = ui.html(html.escape(words), tag="option", sanitize=False)
                option.props(f'value="{name}"{chosen}')

    def _chosen(self, event: GenericEventArguments) -> None:
        self.value = str(event.args)
        self._on_change()


def warn(text: str) -> None:
    """For a moment, above everything."""
    ui.notify(text, type="warning", position="top", multi_line=True, timeout=6000)


def dress(element: ui.element, look: str, *looks: str) -> None:
    """Gives it one look of several."""
    element.classes(add=look, remove=" ".join(one for one in looks if one != look))


class Header:
    """Connection, board, battery, IMU, age of what is shown."""

    def __init__(self, live: Live) -> None:
        with ui.element("header").classes("top"):
            ui.label("tailbeat").classes("brand").props("role=heading aria-level=1")
            live.label(lambda now: "SIMULATED" if now.simulated else "", "simulated")
            live.label(view.where_line, "where")
            with ui.element("div").classes("chips"):
                names = ("link", "battery", "imu")
                self._chips = [ui.label().classes(f"chip {name}") for name in names]
        title = self._chips[-1].props
        live.follow(lambda now: now.imu, lambda text: title(f"title={json.dumps(text)}"))

    def refresh(self, now: PageState, silent_s: float | None) -> None:
        """Shows what also changes while nothing is heard."""
        for chip, (text, look) in zip(self._chips, view.chips(now, silent_s), strict=True):
            chip.set_text(text)
            dress(chip, look, "well", "low", "unknown")


def status_card(live: Live) -> None:
    """What is going on, what is wrong, and START."""

    def is_stopped(now: PageState) -> bool:
        return bool(now.fault) and now.phase == "idle"

    def assessment(now: PageState) -> str:
        is_news = now.assessment and now.phase == "idle" and not now.guide
        return f"Last trial: {now.assessment}" if is_news else ""

    with ui.element("section").classes("card now").props('aria-label="The job"'):
        headline = live.label(view.phase_line, "headline")
        counting = "counting", "calm"
        live.look(headline, lambda now: counting[now.phase != "countdown"], *counting)
        live.label(view.live_line, "figures live")
        live.drawn(view.guide_shown, _draw_guide, "steps guide")
        live.drawn(view.steps_shown, _draw_steps, "steps preflight")
        live.label(lambda now: now.law, "hint law")
        live.label(lambda now: now.diagnosis, "banner problem diagnosis")
        live.label(assessment, "hint assessment")
        with ui.element("div").classes("banner fault").props("role=alert") as fault:
            live.label(lambda now: now.fault, "")
            clear = ui.button("Clear the fault", on_click=lambda: live.ask("clear"))
            clear.classes("clear")
        live.follow(is_stopped, fault.set_visibility)
        live.label(lambda now: now.problem, "banner problem").props("role=alert")
        _start(live)


def _start(live: Live) -> None:
    with ui.element("div").classes("go") as go:
        live.label(view.next_line, "travel next")
        start = ui.button("START").props("unelevated").classes("start")
        commission = Choice("Commissioning", COMMISSION, classes="commission")
        until = Choice("Trials", UNTIL, classes="until")
        law = Choice("Law", LAWS, classes="law-choice")
        preflight = ui.switch(
            "Preflight checks before each trial: rest, pose, still water", value=True
        )
        health = ui.button("Check the fish's health", on_click=lambda: live.ask("health"))
        health.props("outline").classes("check-health")

    def swim() -> None:
        live.ask(
            "swim",
            until=until.value,
            preflight=preflight.value,
            law=law.value,
            commission=commission.value,
        )

    start.on_click(swim)
    live.follow(lambda now: now.phase in ("idle", "connecting", "working"), go.set_visibility)
    for button in (start, health):
        live.follow(lambda now: now.phase == "idle", button.set_enabled)


def _draw_guide(steps: tuple[GuideStep, ...]) -> None:
    for step in steps:
        ui.label(f"{step.name}: {step.words}").classes(_STEP_LOOKS[step.done])


def _draw_steps(steps: tuple[StepProgress, ...]) -> None:
    for step in steps:
        left = "" if step.left_s is None else f" ({step.left_s:.0f} s)"
        ui.label(step.text + left).classes(_STEP_LOOKS[step.ok])


def trials_card(live: Live) -> None:
    """The trials, newest first, with what can be downloaded of each."""
    with titled("Trials", "trial-list"):
        live.label(lambda now: f"In {now.experiment}." if now.experiment else "", "hint")
        ui.label(
            "Errors against the reference in mm/s: largest of any beat, and RMS. “ulg” is the"
            " log as the board wrote it, “csv” its beats."
        ).classes("hint")
        live.drawn(lambda now: (now.rows, now.made_by), _draw_rows, "trials live")


def _draw_rows(shown: tuple[tuple[TrialRow, ...], tuple[str, ...]]) -> None:
    rows, made_by = shown
    if not rows:
        ui.label("None yet.").classes("hint")
    for row, law in reversed(list(zip(rows, made_by, strict=True))):
        _row(row, law)


def _row(row: TrialRow, law: str) -> None:
    name = Path(row.file).name
    with ui.element("div").classes(f"trial {row.decision or 'undecided'}"):
        with ui.element("div").classes("number"):
            ui.label(str(row.trial))
            ui.label(f"iteration {row.iteration}").classes("iteration")
        with ui.element("div").classes("errors"):
            ui.label(f"max {mm(row.max_abs_error_m_s)} · RMS {mm(row.rms_error_m_s)}")
        with ui.element("div").classes("words"):
            ui.label(view.row_line(row))
            ui.label(f"input: {law}").classes("made-by")
            if row.straight is not None:
                drift = ui.label(view.heading_drift(row.straight))
                drift.classes("crooked" if row.straight.crooked else "")
        with ui.element("div").classes("files"):
            _file("ulg", f"/raw/{name}", name, f"log of trial {row.trial}")
            stem = Path(name).stem
            _file("csv", f"/beats/{stem}.csv", f"{stem}.csv", f"beats of trial {row.trial}")


def _file(text: str, address: str, name: str, title: str) -> None:
    with ui.element("a").classes("file") as link:
        ui.label(text)
    link.props(f'href="{address}" download="{name}" aria-label="{text}: {title}"')


class _Answers:
    """Asks for the buttons of a dialog. Why one did nothing stands beside it, for on a phone
    nothing else of the page can be seen."""

    def __init__(self, live: Live) -> None:
        self._live = live
        self._text = ui.label().classes("banner problem refusal")
        self._text.props("role=alert").set_visibility(False)

    def ask(self, what: str, **values: object) -> None:
        """Asks, and shows why not."""
        why = self._live.refused(what, **values)
        if why and self._live.worker.now.phase not in ("deciding", "asking"):
            warn(why)  # somebody else was quicker
        else:
            self.show(why)

    def show(self, why: str) -> None:
        """Empty = nothing was refused."""
        self._text.set_text(why)
        self._text.set_visibility(bool(why))
        if why:
            ui.run_javascript(
                f"getHtmlElement({self._text.id}).scrollIntoView({{block: 'nearest'}})"
            )


def decision_dialog(live: Live) -> None:
    """Opens in every browser when a trial is to be decided on."""

    def decide(kind: str) -> None:
        answers.ask("decide", kind=kind, reason=why.value or "")

    with (
        ui.dialog().props(f"persistent no-focus {AT_ONCE}") as dialog,
        ui.card().classes("dialog deciding"),
    ):
        title = ui.label().classes("title")
        facts = ui.column().style("gap:4px")
        why = ui.input("Reason (needed to repeat or discard)").props("outlined")
        why.classes("reason").style("width:100%")
        with ui.element("div").classes("reasons"):
            for reason in REASONS:
                setter = _given(why.set_value, reason)
                ui.button(reason, on_click=setter).props("outline")
        choices = ui.element("div").classes("choices")
        answers = _Answers(live)
        buttons = {}
        for kind, (name, meaning) in view.DECISIONS.items():
            with choices:
                buttons[kind] = ui.button(name, color=_COLOURS[kind])
                buttons[kind].on_click(_given(decide, kind))
                buttons[kind].classes(f"choose-{kind}").props("unelevated")
            ui.label(f"{name}: {meaning}.").classes("hint")

    def fill(recorded: RecordedTrial | None) -> None:
        assert recorded is not None
        answers.show("")
        _name(dialog, view.decision_line(recorded))
        title.set_text(view.decision_line(recorded))
        facts.clear()
        with facts:
            for line in record_lines(recorded):
                ui.label(line)
            for problem in recorded.problems:
                ui.label(problem).classes("banner problem").style("width:100%")
        why.set_value(proposed_decision(recorded).reason)
        buttons["keep"].set_enabled(recorded.measured_beats > 0)

    live.dialog(dialog, lambda now: now.recorded if now.phase == "deciding" else None, fill)


def question_dialog(live: Live) -> None:
    """A question with yes or no."""
    with ui.dialog().props(f"persistent {AT_ONCE}") as dialog, ui.card().classes("dialog asking"):
        text = ui.label().style("line-height:1.4")
        number = ui.input("Type the number").props("outlined inputmode=decimal")
        number.classes("number").style("width:100%")
        choices = ui.element("div").classes("choices").style("grid-template-columns:1fr 1fr")
        answers = _Answers(live)
        with choices:
            for name, yes in (("Yes", True), ("No", False)):
                answer = _given(
                    lambda yes: answers.ask("answer", yes=yes, typed=number.value or ""), yes
                )
                button = ui.button(name, on_click=answer).classes(name.lower())
                button.props("unelevated" if yes else "outline")

    def fill(question: str) -> None:
        number.set_value("")
        number.set_visibility(live.worker.now.number is not None)
        words = question[:1].upper() + question[1:]
        _name(dialog, words)
        text.set_text(words)
        answers.show("")

    live.dialog(dialog, lambda now: now.question if now.phase == "asking" else "", fill)


def _given(do: Callable[[Any], object], value: object) -> Callable[[], object]:
    """What a button does; not the loop's last value."""
    return lambda: do(value)


def _name(dialog: ui.dialog, words: str) -> None:
    """For a screen reader."""
    dialog.props(f"aria-label={json.dumps(words)}")
