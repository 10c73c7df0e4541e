"""The page: one for each browser, all of the same worker.

Everything on it is drawn from the worker's snapshot five times a second, so that browsers which
come, go or reload always show how things stand.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files

from nicegui import ui

from tailbeat.app.web import charts, parts, view
from tailbeat.app.web.cards import (
    CompareCard,
    ParamsCard,
    ReferenceCard,
    limit_card,
    log_card,
    notes_card,
    report_card,
    show_chart,
)
from tailbeat.app.web.parts import Live, titled
from tailbeat.app.web.state import MOVING, PageState
from tailbeat.app.web.worker import Worker

Draw = Callable[[PageState], charts.Options]
_CHARTS: tuple[tuple[str, str, Draw, str], ...] = (
    (
        "Speed of each beat",
        "Dashed: reference. Dots: measured; a gap was not measured. Thin: earlier trials.",
        charts.speed_chart,
        "speed-chart",
    ),
    (
        "Error of each beat",
        "Reference less speed. Triangles: at the amplitude limit. Crosses: no speed measured."
        " Dotted: the error bound.",
        charts.beat_error_chart,
        "beat-error-chart",
    ),
    (
        "Amplitude of each beat",
        "How far the tail swings to either side; this is what is learned.",
        charts.amplitude_chart,
        "amplitude-chart",
    ),
    (
        "Largest error of each trial",
        "One iteration = learned once more. Dotted, once the fish has been measured:"
        " the error bound, below which no amplitudes get.",
        charts.error_chart,
        "error-chart",
    ),
)


def _chart(live: Live, title: str, hint: str, draw: Draw, name: str) -> None:
    with titled(title):
        ui.label(hint).classes("hint")
        chart = ui.echart({}).classes(f"chart live {name}").props(f'role=img aria-label="{title}"')
    live.follow(draw, lambda options: show_chart(chart, options))


def _charts(live: Live) -> None:
    with ui.element("div").classes("charts"):
        for title, hint, draw, name in _CHARTS:
            _chart(live, title, hint, draw, name)


def _tank_card(live: Live) -> None:
    """From above, with the camera's picture where there is one."""
    with titled("The tank from above", "tank"):
        live.label(lambda now: now.travel, "hint")
        chart = ui.echart({}).classes("chart live tank-chart")
        chart.props('role=img aria-label="Where the fish has been in the tank"')
        picture = ui.element("img").classes("camera").props('alt="What the camera sees"')
    live.follow(charts.tank_chart, lambda options: show_chart(chart, options))
    live.follow(lambda now: now.pictures, picture.set_visibility)


_PERIOD_S = 0.2
_TICKS = 5  # periods between two signs of life


_SIDE: tuple[Callable[[Live], object], ...] = (
    parts.status_card, ReferenceCard, limit_card, notes_card,
)  # fmt: skip
_MAIN: tuple[Callable[[Live], object], ...] = (
    _tank_card, _charts, parts.trials_card, CompareCard, report_card, ParamsCard, log_card,
)  # fmt: skip


class Page:
    """One browser's."""

    def __init__(self, worker: Worker) -> None:
        self._worker = worker
        self._serial = -1
        self._periods = 0
        self._live = live = Live(worker)
        ui.add_head_html(f"<style>{_asset('page.css')}</style>")
        ui.add_body_html(f"{_asset('fixed.html')}<script>{_asset('page.js')}</script>")
        ui.colors(primary="#0b4f8a", negative="#b3261e", warning="#ffe2a8")
        ui.dark_mode(None)  # as the browser wishes
        with ui.element("div").classes("root") as root:
            self._header = parts.Header(live)
            with ui.element("div").classes("all"):
                with ui.element("div").classes("side"):
                    for part in _SIDE:
                        part(live)
                with ui.element("div").classes("main"):
                    for part in _MAIN:
                        part(live)
            self._tick = ui.label("0").classes("tick")
        parts.decision_dialog(live)
        parts.question_dialog(live)
        moving = "moving", "calm"
        live.look(root, lambda now: moving[now.phase not in (*MOVING, "connecting")], *moving)
        live.look(root, lambda now: "filled" if now.reference_m_s else "bare", "filled", "bare")
        live.follow(
            lambda now: f"data-phase={now.phase} data-state={now.state or 'none'}", root.props
        )
        self._root = root
        self.refresh()
        ui.timer(_PERIOD_S, self.refresh)

    def refresh(self) -> None:
        """Draws what has changed."""
        now, silent_s = self._worker.now, self._worker.silent_s()
        self._header.refresh(now, silent_s)
        parts.dress(
            self._root, "stale" if view.is_stale(now, silent_s) else "fresh", "stale", "fresh"
        )
        self._periods += 1
        if self._periods % _TICKS == 0:
            self._tick.set_text(str(self._periods))
        if now.serial != self._serial:
            self._serial = now.serial
            self._live.refresh(now)


def _asset(name: str) -> str:
    return files("tailbeat.app.web").joinpath(name).read_text(encoding="utf-8")
