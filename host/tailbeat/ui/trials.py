"""The list of swims, newest first, with what can be downloaded of each."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from nicegui import ui

from tailbeat.ui import words

if TYPE_CHECKING:
    from tailbeat.experiment.analysis import TrialRow
    from tailbeat.ui.snapshot import Snapshot


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
            ui.label(f"max {words.mm(row.max_abs_error_m_s)} · RMS {words.mm(row.rms_error_m_s)}")
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
