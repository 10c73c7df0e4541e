"""The page: one for each browser, all of the same worker.

Everything on it is drawn from the worker's snapshot five times a second, so that browsers which
come, go or reload always show how things stand.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files

from nicegui import ui

from tailbeat.app.web import charts, parts, view
from tailbeat.app.web.cards import (
    ParamsCard,
    ReferenceCard,
    limit_card,
    log_card,
    notes_card,
    report_card,
)
from tailbeat.app.web.parts import Choice, Live, titled
from tailbeat.app.web.state import MOVING, PageState
from tailbeat.app.web.worker import Worker


@dataclass(frozen=True)
class ChartCard:
    """``draw`` and ``words`` show the same of a snapshot."""

    title: str
    hint: str
    draw: Callable[[PageState], charts.Options]
    words: Callable[[PageState], str]
    name: str


_CARDS = (
    ChartCard(
        "Speed of each beat",
        "Dashed: reference. Dots: measured; a gap was not measured. Thin: earlier trials.",
        charts.speed_chart,
        charts.speed_text,
        "speed-chart",
    ),
    ChartCard(
        "Error of each beat",
        "Reference less speed. Triangles: at the amplitude limit. Crosses: no speed measured."
        " Dotted: the error bound.",
        charts.beat_error_chart,
        charts.beat_error_text,
        "beat-error-chart",
    ),
    ChartCard(
        "Amplitude of each beat",
        "The feedforward input: how far the tail beats to either side. This is what is learned.",
        charts.amplitude_chart,
        charts.amplitude_text,
        "amplitude-chart",
    ),
    ChartCard(
        "Largest error of each trial",
        "By iteration. Dotted, once the fish was measured: the error bound, which no input beats.",
        charts.error_chart,
        charts.error_text,
        "error-chart",
    ),
)


class Chart:
    """One that is drawn as SVG: its colours are the page's, in the light and in the dark."""

    def __init__(self, title: str, classes: str) -> None:
        self._title = title
        self._chart = ui.echart({}, renderer="svg").classes(f"chart {classes}").props("role=img")
        self.say("")

    def show(self, options: charts.Options) -> None:
        """Other options for it."""
        self._chart.options.clear()
        self._chart.options.update(options)
        self._chart.update()

    def say(self, words: str) -> None:
        """The same for a screen reader."""
        text = f"{self._title}: {words}" if words else self._title
        self._chart.props(f"aria-label={json.dumps(text)}")


def charts_part(live: Live) -> None:
    """All four."""
    with ui.element("div").classes("charts"):
        for card in _CARDS:
            with titled(card.title):
                ui.label(card.hint).classes("hint")
                chart = Chart(card.title, f"live {card.name}")
            live.follow(card.draw, chart.show)
            live.follow(card.words, chart.say)


def tank_card(live: Live) -> None:
    """From above, with the camera's picture where there is one."""
    with titled("The tank from above", "tank"):
        live.label(lambda now: now.travel, "hint")
        chart = Chart("The tank from above", "live tank-chart")
        picture = ui.element("img").classes("camera").props('alt="What the camera sees"')
    live.follow(charts.tank_chart, chart.show)
    live.follow(charts.tank_text, chart.say)
    live.follow(lambda now: now.pictures, picture.set_visibility)


class CompareCard:
    """Two trials over each other."""

    def __init__(self, live: Live) -> None:
        self._live = live
        with titled("Compare two trials", "compare"):
            with ui.element("div").classes("two"):
                self._one = Choice("First", {"": "none yet"}, self._draw)
                self._other = Choice("Second", {"": "none yet"}, self._draw)
            self._words = ui.label().classes("hint")
            self._chart = Chart("Speeds of two trials", "live compare-chart")
        live.follow(lambda now: tuple(curve.trial for curve in now.curves), self._offer)

    def _offer(self, trials: tuple[int, ...]) -> None:
        """The best and the last, until somebody chooses."""
        names = {str(number): f"trial {number}" for number in reversed(trials)}
        rows = [row for row in self._live.worker.now.rows if row.trial in trials and row.counts]
        best = min(rows, key=lambda row: row.max_abs_error_m_s, default=None)
        self._one.offer(names or {"": "none yet"}, str(best.trial) if best is not None else "")
        self._other.offer(names or {"": "none yet"}, str(trials[-1]) if trials else "")
        self._draw()

    def _draw(self) -> None:
        now = self._live.worker.now
        curves = {str(curve.trial): curve for curve in now.curves}
        chosen = [curves.get(one.value) for one in (self._one, self._other)]
        errors = {str(row.trial): row.max_abs_error_m_s * 1e3 for row in now.rows}
        words = [
            f"trial {one.value}: largest error {errors[one.value]:.1f} mm/s"
            for one in (self._one, self._other)
            if one.value in errors
        ]
        self._words.set_text("; ".join(words))
        self._chart.show(charts.compare_chart(*chosen))
        self._chart.say(charts.compare_text(*chosen))


_PERIOD_S = 0.2
_TICKS = 5  # periods between two signs of life


_SIDE: tuple[Callable[[Live], object], ...] = (
    parts.status_card, ReferenceCard, limit_card, notes_card,
)  # fmt: skip
_MAIN: tuple[Callable[[Live], object], ...] = (
    tank_card, charts_part, parts.trials_card, CompareCard, report_card, ParamsCard, log_card,
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
            live.label(view.announcement, "said").props("role=status")
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
        found = "bare", "filled"
        live.look(root, lambda now: found[bool(now.reference_m_s or now.run)], *found)
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
