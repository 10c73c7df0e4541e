"""The upper part of the page: how things stand, and the button that begins a swim.

The list of swims, newest first, with what can be downloaded of each.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from nicegui import ui

from tailbeat.app.web import words
from tailbeat.core.errors import InputError
from tailbeat.session.presenter import mm

if TYPE_CHECKING:
    from tailbeat.app.web.view import Snapshot
    from tailbeat.app.web.worker import Conductor
    from tailbeat.experiment.analysis import TrialRow
    from tailbeat.session.events import StepProgress

UNTIL = {
    "1": "one swim",
    "3": "three swims",
    "10": "ten swims",
    "converged": "until nothing more is gained",
    "battery": "until the battery is low",
}
_LOOKS = ("well", "low", "unknown")


def refused(conductor: Conductor, what: str, **values: object) -> str:
    """Asks; why not, empty = it was taken in."""
    try:
        conductor.ask(what, **values)
    except InputError as error:
        return str(error)
    return ""


def wish(conductor: Conductor, what: str, **values: object) -> bool:
    """Asks, and tells whoever pressed the button why not."""
    if why := refused(conductor, what, **values):
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

    def refresh(self, now: Snapshot, silent_s: float | None) -> None:
        """Shows it."""
        self._simulated.set_visibility(now.simulated)
        self._where.set_text(words.where_line(now))
        chips = (self._link, self._battery, self._imu)
        for chip, (text, look) in zip(chips, words.chips(now, silent_s), strict=True):
            chip.set_text(text)
            dress(chip, look)
        self._imu.props(f"title={json.dumps(now.imu)}")


class Status:
    """What is going on, what is wrong, and START."""

    def __init__(self, conductor: Conductor) -> None:
        self._conductor = conductor
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
            self._ritual = ui.switch("Look before each swim: rest, pose, still water", value=True)
            self._start = ui.button("START", on_click=self._swim).props("unelevated")
            self._start.classes("start")

    def _swim(self) -> None:
        wish(self._conductor, "swim", until=self._until.value, ritual=self._ritual.value)

    def _clear(self) -> None:
        wish(self._conductor, "clear")

    def refresh(self, now: Snapshot) -> None:
        """Shows it."""
        self._headline.set_text(words.phase_line(now))
        counting = "counting" if now.phase == "countdown" else "calm"
        dress(self._headline, counting, ("counting", "calm"))
        live = words.live_line(now)
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
        self._next.set_text(words.next_line(now))
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

    def refresh(self, now: Snapshot) -> None:
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
            ui.label(words.row_line(row))
            if text := words.straight(row):
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
