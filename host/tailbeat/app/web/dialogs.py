"""What only people know: what becomes of a swim, and yes or no."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from tailbeat.app.web import words
from tailbeat.app.web.status import refused
from tailbeat.session.collect import proposed
from tailbeat.session.presenter import record_lines

if TYPE_CHECKING:
    from collections.abc import Callable

    from tailbeat.app.web.view import Snapshot
    from tailbeat.app.web.worker import Conductor
    from tailbeat.session.collect import Swum

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

    def __init__(self, conductor: Conductor) -> None:
        self._conductor = conductor
        self._text = ui.label().classes("banner problem refusal")
        self._text.props("role=alert").set_visibility(False)

    def ask(self, what: str, **values: object) -> None:
        """Asks, and shows why not."""
        why = refused(self._conductor, what, **values)
        if why and self._conductor.now.phase not in ("deciding", "asking"):
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
    """Opens in every browser when a swim is to be decided on, and closes once somebody has."""

    def __init__(self, conductor: Conductor) -> None:
        self._shown: Swum | None = None
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
                for kind, (name, _) in words.DECISIONS.items():
                    button = ui.button(name, on_click=self._maker(kind), color=_COLOURS[kind])
                    button.classes(f"choose-{kind}").props("unelevated")
                    if kind == "keep":
                        self._keep = button
            self._refusal = _Refusal(conductor)
            for name, meaning in words.DECISIONS.values():
                ui.label(f"{name}: {meaning}.").classes("hint")

    def _setter(self, reason: str) -> Callable[[], object]:
        return lambda: self._why.set_value(reason)

    def _maker(self, kind: str) -> Callable[[], object]:
        return lambda: self._refusal.ask("decide", kind=kind, reason=self._why.value or "")

    def refresh(self, now: Snapshot) -> None:
        """Shows or hides it."""
        swum = now.swum if now.phase == "deciding" else None
        if swum is self._shown:
            return
        self._shown = swum
        if swum is None:
            self._dialog.close()
            return
        self._fill(swum)
        self._dialog.open()

    def _fill(self, swum: Swum) -> None:
        self._refusal.show("")
        self._title.set_text(f"What becomes of trial {swum.outcome.number}?")
        self._facts.clear()
        with self._facts:
            for line in record_lines(swum):
                ui.label(line)
            for problem in swum.problems:
                ui.label(problem).classes("banner problem").style("width:100%")
        self._why.set_value(proposed(swum).reason)
        self._keep.set_enabled(swum.measured_beats > 0)


class Asking:
    """A question with yes or no."""

    def __init__(self, conductor: Conductor) -> None:
        self._shown = ""
        with ui.dialog().props("persistent") as self._dialog, ui.card().classes("dialog asking"):
            self._text = ui.label().style("line-height:1.4")
            with ui.element("div").classes("choices").style("grid-template-columns:1fr 1fr"):
                for name, yes in (("Yes", True), ("No", False)):
                    button = ui.button(name, on_click=self._maker(yes)).classes(name.lower())
                    button.props("unelevated" if yes else "outline")
            self._refusal = _Refusal(conductor)

    def _maker(self, yes: bool) -> Callable[[], object]:
        return lambda: self._refusal.ask("answer", yes=yes)

    def refresh(self, now: Snapshot) -> None:
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
