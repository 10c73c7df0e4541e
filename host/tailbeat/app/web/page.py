"""The page: one for each browser, all of the same worker, and what can be downloaded from it.

Everything on it is drawn from the worker's snapshot five times a second, so that browsers which
come, go or reload always show how things stand.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Protocol

from fastapi import HTTPException
from fastapi.responses import FileResponse, Response
from nicegui import app, ui

from tailbeat.app.web import cards, view
from tailbeat.app.web.cards import LogCard, NotesCard, ReferenceCard
from tailbeat.app.web.status import Asking, Deciding, Header, Status, Trials, dress
from tailbeat.app.web.view import MOVING, PageState
from tailbeat.app.web.worker import Worker
from tailbeat.core.errors import TailbeatError
from tailbeat.core.trial_file import beats_csv, read_trial

if TYPE_CHECKING:
    from collections.abc import Callable


_PERIOD_S = 0.2
_TICKS = 5  # periods between two signs of life


def build(worker: Worker) -> None:
    """Registers the page and what goes with it."""
    serve_downloads(worker)

    @ui.page("/", title="tailbeat")
    def page() -> None:
        _Page(worker)


def _asset(name: str) -> str:
    return files("tailbeat.app.web").joinpath(name).read_text(encoding="utf-8")


class _Part(Protocol):
    """What shows a snapshot."""

    def refresh(self, now: PageState) -> None:
        """Shows it."""


class _Chart:
    """Redrawn when what it shows has changed."""

    def __init__(
        self, title: str, hint: str, draw: Callable[[PageState], dict[str, Any]], name: str
    ) -> None:
        self._draw = draw
        self._shown: dict[str, Any] = {}
        with ui.element("section").classes("card"):
            ui.label(title).classes("title")
            ui.label(hint).classes("hint")
            self._chart = ui.echart({}).classes(f"chart live {name}")

    def refresh(self, now: PageState) -> None:
        options = self._draw(now)
        if options == self._shown:
            return
        self._shown = options
        self._chart.options.clear()
        self._chart.options.update(options)
        self._chart.update()


class _Page:
    """One browser's."""

    def __init__(self, worker: Worker) -> None:
        self._worker = worker
        self._serial = -1
        self._periods = 0
        ui.add_head_html(f"<style>{_asset('page.css')}</style>")
        ui.add_body_html(f"{_asset('fixed.html')}<script>{_asset('page.js')}</script>")
        ui.colors(primary="#0b4f8a", negative="#b3261e", warning="#ffe2a8")
        with ui.element("div").classes("root") as self._root:
            self._header = Header()
            with ui.element("main").classes("all"):
                with ui.element("div").classes("side"):
                    self._status = Status(worker)
                    self._reference = ReferenceCard(worker)
                    self._notes = NotesCard(worker)
                with ui.element("div").classes("main"):
                    self._charts = self._make_charts()
                    self._trials = Trials()
                    self._log = LogCard()
            self._tick = ui.label("0").classes("tick")
        others = (self._trials, self._log, Deciding(worker), Asking(worker))
        self._parts: list[_Part] = [self._status, self._reference, *self._charts, *others]
        self.refresh()
        ui.timer(_PERIOD_S, self.refresh)

    @staticmethod
    def _make_charts() -> list[_Chart]:
        with ui.element("div").classes("charts"):
            drawn = [
                _Chart(
                    "Speed of each beat",
                    "Dashed: wanted. Dots: measured; a gap was not measured.",
                    cards.speed_chart,
                    "speed-chart",
                ),
                _Chart(
                    "Amplitude of each beat",
                    "How far the tail swings to either side; this is what is learned.",
                    cards.amplitude_chart,
                    "amplitude-chart",
                ),
            ]
        drawn.append(
            _Chart(
                "Largest error of each trial",
                "One iteration = learned once more. Dotted, once the fish has been identified:"
                " the floor, below which no amplitudes get.",
                cards.error_chart,
                "error-chart",
            )
        )
        return drawn

    def refresh(self) -> None:
        """Draws what has changed."""
        now, silent_s = self._worker.now, self._worker.silent_s()
        self._header.refresh(now, silent_s)
        dress(self._root, "stale" if view.is_stale(now, silent_s) else "fresh", ("stale", "fresh"))
        self._periods += 1
        if self._periods % _TICKS == 0:
            self._tick.set_text(str(self._periods))
        if now.serial == self._serial:
            return
        self._serial = now.serial
        moving = now.phase in (*MOVING, "connecting")
        dress(self._root, "moving" if moving else "calm", ("moving", "calm"))
        dress(self._root, "filled" if now.reference_m_s else "bare", ("filled", "bare"))
        self._root.props(f"data-phase={now.phase} data-state={now.state or 'none'}")
        for part in self._parts:
            part.refresh(now)


def serve_downloads(worker: Worker) -> None:
    """``/raw/NAME``: a log; ``/beats/NAME.csv``: its beats. Only those in the trial list."""

    @app.get("/raw/{name}")
    def raw(name: str) -> Response:
        path = worker.raw_file(name)
        if path is None or not path.is_file():
            raise HTTPException(404, "there is no such trial")
        return FileResponse(path, media_type="application/octet-stream", filename=name)

    @app.get("/beats/{name}.csv")
    def beats(name: str) -> Response:
        path = worker.raw_file(f"{name}.ulg")
        if path is None or not path.is_file():
            raise HTTPException(404, "there is no such trial")
        try:
            text = _beats_csv(path)
        except TailbeatError as error:
            raise HTTPException(422, str(error)) from error
        headers = {"content-disposition": f'attachment; filename="{name}.csv"'}
        return Response(text, media_type="text/csv", headers=headers)


def _beats_csv(path: Path) -> str:

    with TemporaryDirectory() as folder:
        out = Path(folder) / "beats.csv"
        beats_csv(read_trial(path), out)
        return out.read_text(encoding="utf-8")
