"""The upper part of the page: how things stand, and the button that begins a trial.

The list of trials, newest first, with what can be downloaded of each.

What only people know: what becomes of a trial, and yes or no.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from nicegui import ui

from tailbeat.app.web import view
from tailbeat.app.web.view import PageState
from tailbeat.app.web.worker import Worker
from tailbeat.core.errors import InputError
from tailbeat.core.printable import mm
from tailbeat.experiment.trial_rows import TrialRow
from tailbeat.session.collect import proposed_decision
from tailbeat.session.events import StepProgress
from tailbeat.session.outcome import RecordedTrial
from tailbeat.session.presenter import record_lines

if TYPE_CHECKING:
    from collections.abc import Callable


UNTIL = {
    "1": "one trial",
    "3": "three trials",
    "10": "ten trials",
    "converged": "until nothing more is gained",
    "battery": "until the battery is low",
}
_LOOKS = ("well", "low", "unknown")


def refused(worker: Worker, what: str, **values: object) -> str:
    """Asks; why not, empty = it was taken in."""
    try:
        worker.ask(what, **values)
    except InputError as error:
        return str(error)
    return ""


def wish(worker: Worker, what: str, **values: object) -> bool:
    """Asks, and tells whoever pressed the button why not."""
    if why := refused(worker, what, **values):
        ui.notify(why, type="warning", position="top", multi_line=True, timeout=6000)
    return not why


def dress(element: ui.element, look: str, looks: tuple[str, ...] = _LOOKS) -> None:
    """Gives it one look of several."""
    others = " ".join(one for one in looks if one != look)
    element.classes(add=look, remove=others)


class Header:
    """Connection, board, battery, motion sensor, age of what is shown."""

    def __init__(self) -> None:
        with ui.element("header").classes("top"):
            ui.label("tailbeat").classes("brand")
            self._simulated = ui.label("SIMULATED").classes("simulated")
            self._where = ui.label().classes("where")
            with ui.element("div").classes("chips"):
                self._link = ui.label().classes("chip link")
                self._battery = ui.label().classes("chip battery")
                self._imu = ui.label().classes("chip imu")

    def refresh(self, now: PageState, silent_s: float | None) -> None:
        """Shows it."""
        self._simulated.set_visibility(now.simulated)
        self._where.set_text(view.where_line(now))
        chips = (self._link, self._battery, self._imu)
        for chip, (text, look) in zip(chips, view.chips(now, silent_s), strict=True):
            chip.set_text(text)
            dress(chip, look)
        self._imu.props(f"title={json.dumps(now.imu)}")


class Status:
    """What is going on, what is wrong, and START."""

    def __init__(self, worker: Worker) -> None:
        self._worker = worker
        self._steps_shown: tuple[StepProgress, ...] | None = None
        with ui.element("section").classes("card now"):
            self._headline = ui.label().classes("headline")
            self._live = ui.label().classes("figures live")
            self._steps = ui.element("div").classes("steps")
            self._verdict = ui.label().classes("hint verdict")
            with ui.element("div").classes("banner fault") as self._fault:
                self._fault_text = ui.label()
                ui.button("Clear: the fish may swim again", on_click=self._clear).classes("clear")
            self._problem = ui.label().classes("banner problem")
            self._begin()

    def _begin(self) -> None:
        with ui.element("div").classes("go") as self._go:
            self._next = ui.label().classes("travel next")
            self._until = ui.select(UNTIL, value="1", label="How long").props("outlined")
            self._until.classes("until")
            self._ritual = ui.switch(
                "Preflight checks before each trial: rest, pose, still water", value=True
            )
            self._start = ui.button("START", on_click=self._swim).props("unelevated")
            self._start.classes("start")

    def _swim(self) -> None:
        wish(self._worker, "swim", until=self._until.value, ritual=self._ritual.value)

    def _clear(self) -> None:
        wish(self._worker, "clear")

    def refresh(self, now: PageState) -> None:
        """Shows it."""
        self._headline.set_text(view.phase_line(now))
        counting = "counting" if now.phase == "countdown" else "calm"
        dress(self._headline, counting, ("counting", "calm"))
        live = view.live_line(now)
        self._live.set_text(live)
        self._live.set_visibility(bool(live))
        self._show_steps(now.steps if now.phase in ("ritual", "countdown") else ())
        self._verdict.set_text(f"Last swim: {now.verdict}")
        self._verdict.set_visibility(bool(now.verdict) and now.phase == "idle")
        self._fault_text.set_text(now.fault)
        self._fault.set_visibility(bool(now.fault) and now.phase == "idle")
        self._problem.set_text(now.problem)
        self._problem.set_visibility(bool(now.problem))
        self._go.set_visibility(now.phase in ("idle", "connecting", "working"))
        self._next.set_text(view.next_line(now))
        ready = now.phase == "idle" and bool(now.reference_m_s)
        self._start.set_enabled(ready)

    def _show_steps(self, steps: tuple[StepProgress, ...]) -> None:
        if steps == self._steps_shown:
            return
        self._steps_shown = steps
        self._steps.clear()
        looks = {True: "done", False: "bad", None: "under-way"}
        with self._steps:
            for step in steps:
                left = "" if step.left_s is None else f" ({step.left_s:.0f} s)"
                ui.label(step.text + left).classes(looks[step.ok])


class Trials:
    """Drawn anew only when there is another trial, or another word on one."""

    def __init__(self) -> None:
        self._shown: tuple[TrialRow, ...] | None = None
        with ui.element("section").classes("card trial-list"):
            self._title = ui.label().classes("title")
            ui.label(
                "Errors against the wanted speed, in mm/s: the largest of any beat, and the typical"
                " one (RMS). “ulg” is the log as the board wrote it, “csv” its beats."
            ).classes("hint")
            self._list = ui.element("div").classes("trials live")

    def refresh(self, now: PageState) -> None:
        """Shows them."""
        where = f" in {now.experiment}" if now.experiment else ""
        self._title.set_text(f"Swims{where}")
        if now.rows == self._shown:
            return
        self._shown = now.rows
        self._list.clear()
        with self._list:
            if not now.rows:
                ui.label("None yet.").classes("hint")
            for row in reversed(now.rows):
                _row(row)


def _row(row: TrialRow) -> None:
    name = Path(row.file).name
    with ui.element("div").classes(f"trial {row.decision or 'undecided'}"):
        with ui.element("div").classes("number"):
            ui.label(str(row.trial))
            ui.label(f"iteration {row.iteration}").classes("iteration")
        with ui.element("div").classes("errors"):
            ui.label(f"max {mm(row.max_abs_error_m_s)} · RMS {mm(row.rms_error_m_s)}")
        with ui.element("div").classes("words"):
            ui.label(view.row_line(row))
            if text := view.straight(row):
                crooked = row.straight is not None and row.straight.crooked
                ui.label(text).classes("crooked" if crooked else "straight")
        with ui.element("div").classes("files"):
            _file("ulg", f"/raw/{name}", name, f"log of trial {row.trial}")
            stem = Path(name).stem
            _file("csv", f"/beats/{stem}.csv", f"{stem}.csv", f"beats of trial {row.trial}")


def _file(text: str, address: str, name: str, title: str) -> None:
    with ui.element("a").classes("file") as link:
        ui.label(text)
    link.props(f'href="{address}" download="{name}" title="{title}"')


REASONS = (
    "bumped the wall",
    "water was not still",
    "hand in the water",
    "camera lost the fish",
    "not straight",
    "battery low",
)
_COLOURS = {"keep": "primary", "repeat": "grey-8", "discard": "grey-8"}


class _Refusal:
    """Why a button of a dialog did nothing: beside that button, for on a phone nothing else of the
    page can be seen."""

    def __init__(self, worker: Worker) -> None:
        self._worker = worker
        self._text = ui.label().classes("banner problem refusal")
        self._text.props("role=alert").set_visibility(False)

    def ask(self, what: str, **values: object) -> None:
        """Asks, and shows why not."""
        why = refused(self._worker, what, **values)
        if why and self._worker.now.phase not in ("deciding", "asking"):
            ui.notify(why, type="warning", position="top")  # somebody else was quicker
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


class Deciding:
    """Opens in every browser when a trial is to be decided on, and closes once somebody has."""

    def __init__(self, worker: Worker) -> None:
        self._shown: RecordedTrial | None = None
        with (
            ui.dialog().props("persistent no-focus") as self._dialog,
            ui.card().classes("dialog deciding"),
        ):
            self._title = ui.label().classes("title")
            self._facts = ui.column().style("gap:4px")
            self._why = ui.input("Reason (needed to repeat or discard)").props("outlined")
            self._why.classes("reason").style("width:100%")
            with ui.element("div").classes("reasons"):
                for reason in REASONS:
                    ui.button(reason, on_click=self._setter(reason)).props("outline color=grey-8")
            with ui.element("div").classes("choices"):
                for kind, (name, _) in view.DECISIONS.items():
                    button = ui.button(name, on_click=self._maker(kind), color=_COLOURS[kind])
                    button.classes(f"choose-{kind}").props("unelevated")
                    if kind == "keep":
                        self._keep = button
            self._refusal = _Refusal(worker)
            for name, meaning in view.DECISIONS.values():
                ui.label(f"{name}: {meaning}.").classes("hint")

    def _setter(self, reason: str) -> Callable[[], object]:
        return lambda: self._why.set_value(reason)

    def _maker(self, kind: str) -> Callable[[], object]:
        return lambda: self._refusal.ask("decide", kind=kind, reason=self._why.value or "")

    def refresh(self, now: PageState) -> None:
        """Shows or hides it."""
        recorded = now.recorded if now.phase == "deciding" else None
        if recorded is self._shown:
            return
        self._shown = recorded
        if recorded is None:
            self._dialog.close()
            return
        self._fill(recorded)
        self._dialog.open()

    def _fill(self, recorded: RecordedTrial) -> None:
        self._refusal.show("")
        self._title.set_text(f"What becomes of trial {recorded.outcome.number}?")
        self._facts.clear()
        with self._facts:
            for line in record_lines(recorded):
                ui.label(line)
            for problem in recorded.problems:
                ui.label(problem).classes("banner problem").style("width:100%")
        self._why.set_value(proposed_decision(recorded).reason)
        self._keep.set_enabled(recorded.measured_beats > 0)


class Asking:
    """A question with yes or no."""

    def __init__(self, worker: Worker) -> None:
        self._shown = ""
        with ui.dialog().props("persistent") as self._dialog, ui.card().classes("dialog asking"):
            self._text = ui.label().style("line-height:1.4")
            with ui.element("div").classes("choices").style("grid-template-columns:1fr 1fr"):
                for name, yes in (("Yes", True), ("No", False)):
                    button = ui.button(name, on_click=self._maker(yes)).classes(name.lower())
                    button.props("unelevated" if yes else "outline")
            self._refusal = _Refusal(worker)

    def _maker(self, yes: bool) -> Callable[[], object]:
        return lambda: self._refusal.ask("answer", yes=yes)

    def refresh(self, now: PageState) -> None:
        """Shows or hides it."""
        question = now.question if now.phase == "asking" else ""
        if question == self._shown:
            return
        self._shown = question
        self._text.set_text(question[:1].upper() + question[1:])
        self._refusal.show("")
        if question:
            self._dialog.open()
        else:
            self._dialog.close()
