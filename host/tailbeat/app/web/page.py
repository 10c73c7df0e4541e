"""The page: one for each browser, all of the same worker.

Everything on it is drawn from the worker's snapshot five times a second, so that browsers which
come, go or reload always show how things stand.

The charts are options for ECharts, pure functions of a snapshot. Colours differ in lightness too,
and lines in dashes and marks: they are told apart in grey.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from nicegui import events, ui

from tailbeat.app.web import parts, view
from tailbeat.app.web.parts import Live, warn
from tailbeat.app.web.view import LOG_LINES, MOVING, PageState
from tailbeat.app.web.worker import Worker
from tailbeat.core.errors import InputError
from tailbeat.core.reference import Reference, from_csv, from_text
from tailbeat.experiment.trial_rows import TrialRow

Options = dict[str, Any]

REFERENCE, MEASURED, LIMIT = "#8a8f98", "#0b4f8a", "#b3261e"
_INK, _GRID = "#3c4450", "#e3e6ea"
_FONT = {"fontSize": 12, "color": _INK}
_DASHES = "path://M0,3h7v3h-7zM10,3h7v3h-7z"
_CROSS = "path://M0,0L10,10M0,10L10,0"
_SOLID = {"color": MEASURED, "width": 2}
_DASHED = {"color": REFERENCE, "width": 3, "type": [7, 5]}
_ERROR_MIN_MM_S = 0.1  # below it a logarithmic axis shows nothing of interest
_NOT_KEPT = (
    ("repeated", "repeat", "emptyDiamond", MEASURED),
    ("discarded", "discard", _CROSS, REFERENCE),
)


def speed_chart(now: PageState) -> Options:
    """Reference and measured speed per beat, mm/s."""
    reference = [round(v * 1e3, 2) for v in now.reference_m_s]
    measured = [None if v is None else round(v * 1e3, 2) for v in now.speed_m_s]
    dots: Options = {"symbol": "circle", "symbolSize": 6, "showAllSymbol": True}
    options = _frame(
        "mm/s",
        [
            _series("reference", "line", reference, REFERENCE, symbol="none", lineStyle=_DASHED),
            _series("measured", "line", measured, MEASURED, lineStyle=_SOLID, **dots),
        ],
        beats=len(reference),
        top=_above([*reference, *(v for v in measured if v is not None)]),
    )
    options["legend"]["data"] = [{"name": "reference", "icon": _DASHES}, {"name": "measured"}]
    return options


def amplitude_chart(now: PageState) -> Options:
    """Amplitude of each beat, degrees, with the largest that is allowed."""
    degrees = [None if a is None else round(math.degrees(a), 2) for a in now.amplitude_rad]
    bars = _series("amplitude", "bar", degrees, MEASURED, barCategoryGap="25%")
    top = None
    if now.amplitude_max_rad is not None:
        limit = math.degrees(now.amplitude_max_rad)
        top = _above([limit])
        bars["markLine"] = _line(limit, f"limit {limit:.0f}°", LIMIT)
    return _frame("degrees", [bars], beats=len(degrees), top=top)


def error_chart(now: PageState) -> Options:
    """Largest error of each trial by iteration, on a logarithmic axis, with the error bound."""
    open_trial = now.recorded.outcome.number if now.recorded is not None else None
    rows = [
        row
        for row in now.rows
        if _drawable(row.max_abs_error_m_s) and (row.decision or row.trial != open_trial)
    ]
    kept = _points(rows, "keep", "")
    dots: Options = {"symbol": "circle", "symbolSize": 9}
    series = [_series("kept", "line", kept, MEASURED, lineStyle=_SOLID, **dots)]
    for name, decision, symbol, colour in _NOT_KEPT:
        if points := _points(rows, decision):
            style = {"color": colour, "borderColor": colour, "borderWidth": 2}
            look: Options = {"symbol": symbol, "symbolSize": 10, "itemStyle": style}
            series.append(_series(name, "scatter", points, colour, **look))
    if now.error_bound_m_s is not None and _drawable(now.error_bound_m_s):
        bound = now.error_bound_m_s * 1e3
        words = f"error bound {bound:.1f}: no input does better"
        series[0]["markLine"] = _line(bound, words, LIMIT)
    options = _frame("mm/s", series, beats=0, top=None)
    last = max((row.iteration for row in rows), default=1)
    whole = {"type": "value", "min": 0, "max": max(5, last + 1), "minInterval": 1}
    options["xAxis"] = _x_axis("iteration") | whole
    options["yAxis"] |= _octaves(now, rows)
    return options


def _octaves(now: PageState, rows: Sequence[TrialRow]) -> Options:
    """Powers of two around what is drawn: of ten there would be a label or two."""
    values = [row.max_abs_error_m_s for row in rows]
    values += [
        v for v in (now.error_bound_m_s, now.start_error_m_s) if v is not None and _drawable(v)
    ]
    low = max(min(values, default=0.008) * 1e3, _ERROR_MIN_MM_S)
    high = max(max(values, default=0.064) * 1e3, 2 * low)
    return {
        "type": "log",
        "logBase": 2,
        "min": 2.0 ** math.floor(math.log2(low) - 0.2),
        "max": 2.0 ** math.ceil(math.log2(high)),
    }


def _drawable(value: float | None) -> bool:
    return value is not None and math.isfinite(value) and value > 0


def _points(rows: Sequence[TrialRow], *decisions: str) -> list[list[float]]:
    return [
        [row.iteration, round(row.max_abs_error_m_s * 1e3, 3)]
        for row in rows
        if row.decision in decisions
    ]


def _series(name: str, kind: str, data: Sequence[Any], colour: str, **look: Any) -> Options:
    return {"name": name, "type": kind, "data": data, "itemStyle": {"color": colour}, **look}


def _line(value: float, words: str, colour: str) -> Options:
    return {
        "silent": True,
        "symbol": "none",
        "animation": False,
        "lineStyle": {"color": colour, "width": 2, "type": [2, 3]},
        "label": {
            "formatter": words,
            "position": "insideStartTop",
            "color": colour,
            "fontSize": 12,
        },
        "data": [{"yAxis": round(value, 3)}],
    }


def _above(values: Sequence[float]) -> float | None:
    """A round top for an axis; None = nothing to go by."""
    most = max(values, default=0.0) * 1.25
    return 20.0 * math.ceil(most / 20.0) if most > 0 else None


def _x_axis(name: str) -> Options:
    return {
        "name": name,
        "nameLocation": "middle",
        "nameGap": 26,
        "nameTextStyle": _FONT,
        "axisLabel": _FONT,
        "axisLine": {"lineStyle": {"color": _INK}},
        "splitLine": {"show": False},
    }


def _frame(unit: str, series: list[Options], beats: int, top: float | None) -> Options:
    """What all charts share. Never animated: what moves here is the fish."""
    value: Options = {
        "type": "value",
        "name": unit,
        "nameTextStyle": _FONT | {"align": "left", "padding": [0, 0, 0, -26]},
        "axisLabel": _FONT,
        "min": 0,
        "splitLine": {"lineStyle": {"color": _GRID}},
    }
    if top is not None:
        value["max"] = top
    return {
        "animation": False,
        "textStyle": {"fontFamily": "inherit"},
        "grid": {"left": 44, "right": 14, "top": 34, "bottom": 44},
        "legend": {"top": 0, "right": 4, "textStyle": _FONT, "itemWidth": 26}
        if len(series) > 1
        else {"show": False},
        "tooltip": {"trigger": "axis", "confine": True},
        "xAxis": _x_axis("beat") | {"type": "category", "data": list(range(1, beats + 1))},
        "yAxis": value,
        "series": series,
    }


_SHAPES = ("thesis", "trapezoid", "cosine")
_CSV_BYTES_MAX = 1_000_000


def reference_of_text(text: str) -> Reference:
    """A shape by its name. Never a file of this computer: whoever looks at the page gave it."""

    words = text.strip()
    kind, _, numbers = words.partition(":")
    if kind not in _SHAPES or (not numbers and words != "thesis"):
        raise InputError(
            f"'{words}' is no reference.",
            "Write thesis, thesis:SPEED,SECONDS, trapezoid:SPEED,RAMP,HOLD or"
            " cosine:SPEED,RAMP,HOLD (m/s and s), or choose a CSV file.",
        )
    return from_text(words)


def reference_of_csv(name: str, content: bytes) -> Reference:
    """The columns t_s,v_m_s of a file that was sent."""

    with TemporaryDirectory() as folder:
        path = Path(folder) / (Path(name).name or "reference.csv")
        path.write_bytes(content)
        return from_csv(path)


class ReferenceCard:
    """Another reference: by its name or as a file."""

    def __init__(self, live: Live) -> None:
        self._live = live
        self._chosen: Reference | None = None
        self._is_known = False
        with (
            ui.element("section").classes("card reference"),
            ui.expansion("Another reference: the speed to swim").props(
                parts.UNFOLDED
            ) as self._fold,
        ):
            ui.label(
                "thesis; or trapezoid:0.06,8,20 = 0.06 m/s, 8 s up and down, 20 s between; or a CSV"
                " file with the columns t_s,v_m_s. Learning begins anew."
            ).classes("hint")
            with ui.element("div").classes("line").style("width:100%"):
                self._text = ui.input("Shape", value="thesis").props("outlined").classes("shape")
                ui.button("Use it", on_click=self._by_text).classes("use").style("min-height:56px")
            self._file()
        with ui.dialog().props(parts.AT_ONCE) as self._sure, ui.card().classes("dialog"):
            self._question = ui.label().style("line-height:1.4")
            with ui.element("div").classes("choices").style("grid-template-columns:1fr 1fr"):
                ui.button("Begin anew", on_click=self._use).classes("sure")
                ui.button("Leave it", on_click=self._sure.close).props("outline")
        live.follow(self._is_found, self._unfold)

    def _is_found(self, now: PageState) -> bool:
        self._is_known = self._is_known or now.phase not in ("connecting", "failed")
        return self._is_known

    def _unfold(self, is_found: bool) -> None:
        """For a board without a reference, once it is known which this is."""
        if is_found:
            self._fold.set_value(not self._live.worker.now.reference_m_s)

    def _file(self) -> None:
        """Chosen in the browser itself: it opens its window of files only straight from a tap."""
        upload = ui.upload(
            auto_upload=True,
            max_files=1,
            max_file_size=_CSV_BYTES_MAX,
            on_upload=self._by_file,
            on_rejected=lambda: warn("that is no CSV file of less than 1 MB"),
        )
        upload.props("accept=.csv").classes("csv")
        choose = ui.button("Choose a CSV file").props("outline").classes("choose")
        choose.on("click", js_handler=f"() => getElement({upload.id}).$refs.qRef.pickFiles()")

    def _by_text(self) -> None:
        self._offer(lambda: reference_of_text(self._text.value or ""))

    async def _by_file(self, upload: events.UploadEventArguments) -> None:
        content = await upload.file.read()
        self._offer(lambda: reference_of_csv(upload.file.name, content))
        if isinstance(upload.sender, ui.upload):
            upload.sender.reset()

    def _offer(self, make: Callable[[], Reference]) -> None:
        try:
            self._chosen = make()
        except InputError as error:
            warn(str(error))
            return
        now = self._live.worker.now
        if now.iteration == 0 or not now.reference_m_s:
            self._use()
            return
        self._question.set_text(
            f"The fish has learned for {now.iteration} iterations along its present reference."
            " With another one the board begins from nothing; the trials so far stay as they are."
        )
        self._sure.open()

    def _use(self) -> None:
        self._sure.close()
        if self._live.ask("upload", reference=self._chosen):
            self._fold.set_value(False)


def notes_card(live: Live) -> None:
    """A line with its time for the experiment's notes."""
    with ui.element("section").classes("card notes"):
        ui.label("Note").classes("title")
        ui.label("Water temperature, who helped, what was odd: kept with its time.").classes("hint")
        with ui.element("div").classes("line"):
            text = ui.input("What to remember").props("outlined").classes("note")

            def add() -> None:
                if live.ask("note", text=text.value or ""):
                    text.set_value("")

            text.on("keydown.enter", add)
            ui.button("Add", on_click=add).classes("add").style("min-height:56px")


def log_card(live: Live) -> None:
    """What has happened, newest first: that is what is looked for."""
    seen = 0

    def show(log: tuple[int, tuple[str, ...]]) -> None:
        """Adds what is new, and forgets the oldest."""
        nonlocal seen
        new, seen = log[0] - seen, log[0]
        for text in log[1][-new:] if new > 0 else ():
            with lines:
                line = ui.label(text)
            line.move(lines, 0)
        for old in lines.default_slot.children[LOG_LINES:]:
            lines.remove(old)

    with ui.element("section").classes("card"):
        ui.label("What happened").classes("title")
        lines = ui.element("div").classes("log")
    live.follow(lambda now: (now.logged, now.log), show)


def _chart(
    live: Live, title: str, hint: str, draw: Callable[[PageState], Options], name: str
) -> None:
    with ui.element("section").classes("card"):
        ui.label(title).classes("title")
        ui.label(hint).classes("hint")
        chart = ui.echart({}).classes(f"chart live {name}")

    def show(options: Options) -> None:
        chart.options.clear()
        chart.options.update(options)
        chart.update()

    live.follow(draw, show)


def _charts(live: Live) -> None:
    with ui.element("div").classes("charts"):
        _chart(
            live,
            "Speed of each beat",
            "Dashed: reference. Dots: measured; a gap was not measured.",
            speed_chart,
            "speed-chart",
        )
        _chart(
            live,
            "Amplitude of each beat",
            "How far the tail swings to either side; this is what is learned.",
            amplitude_chart,
            "amplitude-chart",
        )
    _chart(
        live,
        "Largest error of each trial",
        "One iteration = learned once more. Dotted, once the fish has been identified:"
        " the error bound, below which no amplitudes get.",
        error_chart,
        "error-chart",
    )


_PERIOD_S = 0.2
_TICKS = 5  # periods between two signs of life


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
        with ui.element("div").classes("root") as root:
            self._header = parts.Header(live)
            with ui.element("main").classes("all"):
                with ui.element("div").classes("side"):
                    for part in (parts.status_card, ReferenceCard, notes_card):
                        part(live)
                with ui.element("div").classes("main"):
                    for part in (_charts, parts.trials_card, log_card):
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
