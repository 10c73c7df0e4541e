"""The charts as options for ECharts: pure functions of a snapshot, so that they can be looked at
without a browser.

Colours differ in lightness too, and lines in dashes and marks: they are told apart in grey.

The lower part of the page: another reference, notes, what has happened.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from nicegui import events, ui

from tailbeat.app.web.status import wish
from tailbeat.app.web.view import LOG_LINES, PageState
from tailbeat.app.web.worker import Worker
from tailbeat.core.errors import InputError
from tailbeat.core.reference import Reference, from_csv, from_text
from tailbeat.experiment.trial_rows import TrialRow

Options = dict[str, Any]

REFERENCE, MEASURED, LIMIT, QUIET = "#8a8f98", "#0b4f8a", "#b3261e", "#c4c9d1"
_INK, _GRID = "#3c4450", "#e3e6ea"
_FONT = {"fontSize": 12, "color": _INK}
_DASHES = "path://M0,3h7v3h-7zM10,3h7v3h-7z"
_FLOOR_MM_S = 0.1  # below it a logarithmic axis shows nothing of interest


def speed_chart(now: PageState) -> Options:
    """Wanted and measured speed per beat, mm/s."""
    wanted = [round(v * 1e3, 2) for v in now.reference_m_s]
    measured = [None if v is None else round(v * 1e3, 2) for v in now.speed_m_s]
    options = _frame(
        "mm/s",
        [
            {
                "name": "wanted",
                "type": "line",
                "data": wanted,
                "symbol": "none",
                "lineStyle": {"color": REFERENCE, "width": 3, "type": [7, 5]},
                "itemStyle": {"color": REFERENCE},
            },
            {
                "name": "measured",
                "type": "line",
                "data": measured,
                "symbol": "circle",
                "showAllSymbol": True,
                "symbolSize": 6,
                "lineStyle": {"color": MEASURED, "width": 2},
                "itemStyle": {"color": MEASURED},
            },
        ],
        beats=len(wanted),
        top=_above([*wanted, *(v for v in measured if v is not None)]),
    )
    options["legend"]["data"] = [{"name": "wanted", "icon": _DASHES}, {"name": "measured"}]
    return options


def amplitude_chart(now: PageState) -> Options:
    """Amplitude of each beat, degrees, with the largest that is allowed."""
    degrees = [None if a is None else round(math.degrees(a), 2) for a in now.amplitude_rad]
    bars: Options = {
        "name": "amplitude",
        "type": "bar",
        "data": degrees,
        "barCategoryGap": "25%",
        "itemStyle": {"color": MEASURED},
    }
    top = None
    if now.amplitude_max_rad is not None:
        limit = math.degrees(now.amplitude_max_rad)
        top = _above([limit])
        bars["markLine"] = _line(limit, f"limit {limit:.0f}°", LIMIT)
    return _frame("degrees", [bars], beats=len(degrees), top=top)


def error_chart(now: PageState) -> Options:
    """Largest error of each swim by iteration, on a logarithmic axis, with the floor."""
    open_trial = now.recorded.outcome.number if now.recorded is not None else None
    rows = [
        row
        for row in now.rows
        if _drawable(row.max_abs_error_m_s) and (row.decision or row.trial != open_trial)
    ]
    kept = _points(rows, ("keep", ""))
    repeats = _points(rows, ("repeat",))
    dropped = _points(rows, ("discard",))
    series: list[Options] = [
        {
            "name": "kept",
            "type": "line",
            "data": kept,
            "symbol": "circle",
            "symbolSize": 9,
            "lineStyle": {"color": MEASURED, "width": 2},
            "itemStyle": {"color": MEASURED},
        },
    ]
    if repeats:
        series.append(_marks("repeated", repeats, "emptyDiamond", MEASURED))
    if dropped:
        series.append(_marks("discarded", dropped, "path://M0,0L10,10M0,10L10,0", REFERENCE))
    if now.floor_m_s is not None and _drawable(now.floor_m_s):
        floor = now.floor_m_s * 1e3
        series[0]["markLine"] = _line(floor, f"floor {floor:.1f}: no input does better", LIMIT)
    options = _frame("mm/s", series, beats=0, top=None)
    last = max((row.iteration for row in rows), default=1)
    options["xAxis"] = _x_axis("iteration") | {
        "type": "value",
        "min": 0,
        "max": max(5, last + 1),
        "minInterval": 1,
    }
    options["yAxis"] |= _octaves(now, rows)
    return options


def _octaves(now: PageState, rows: Sequence[TrialRow]) -> Options:
    """Powers of two around what is drawn: of ten there would be a label or two."""
    values = [row.max_abs_error_m_s for row in rows]
    values += [v for v in (now.floor_m_s, now.start_error_m_s) if v is not None and _drawable(v)]
    low = max(min(values, default=0.008) * 1e3, _FLOOR_MM_S)
    high = max(max(values, default=0.064) * 1e3, 2 * low)
    return {
        "type": "log",
        "logBase": 2,
        "min": 2.0 ** math.floor(math.log2(low) - 0.2),
        "max": 2.0 ** math.ceil(math.log2(high)),
    }


def _drawable(value: float | None) -> bool:
    return value is not None and math.isfinite(value) and value > 0


def _points(rows: Sequence[TrialRow], decisions: tuple[str, ...]) -> list[list[float]]:
    return [
        [row.iteration, round(row.max_abs_error_m_s * 1e3, 3)]
        for row in rows
        if row.decision in decisions
    ]


def _marks(name: str, points: list[list[float]], symbol: str, colour: str) -> Options:
    return {
        "name": name,
        "type": "scatter",
        "data": points,
        "symbol": symbol,
        "symbolSize": 10,
        "itemStyle": {"color": colour, "borderColor": colour, "borderWidth": 2},
    }


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
    """The wanted speed: by its name or as a file."""

    def __init__(self, worker: Worker) -> None:
        self._worker = worker
        self._wanted: Reference | None = None
        self._is_known = False
        with (
            ui.element("section").classes("card reference"),
            ui.expansion("Another reference: the speed to swim") as self._fold,
        ):
            ui.label(
                "thesis; or trapezoid:0.06,8,20 = 0.06 m/s, 8 s up and down, 20 s between; or a CSV"
                " file with the columns t_s,v_m_s. Learning begins anew."
            ).classes("hint")
            with ui.element("div").classes("line").style("width:100%"):
                self._text = ui.input("Shape", value="thesis").props("outlined").classes("shape")
                ui.button("Use it", on_click=self._by_text).classes("use").style("min-height:56px")
            self._file()
        with ui.dialog() as self._sure, ui.card().classes("dialog"):
            self._question = ui.label().style("line-height:1.4")
            with ui.element("div").classes("choices").style("grid-template-columns:1fr 1fr"):
                ui.button("Begin anew", on_click=self._use).classes("sure")
                ui.button("Leave it", on_click=self._sure.close).props("outline")

    def refresh(self, now: PageState) -> None:
        """Unfolds it for a board without a reference, once it is known which this is."""
        if not self._is_known and now.phase not in ("connecting", "failed"):
            self._is_known = True
            self._fold.set_value(not now.reference_m_s)

    def _file(self) -> None:
        """Chosen in the browser itself: it opens its window of files only straight from a tap."""
        upload = ui.upload(
            auto_upload=True,
            max_files=1,
            max_file_size=_CSV_BYTES_MAX,
            on_upload=self._by_file,
            on_rejected=self._too_large,
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

    def _too_large(self) -> None:
        ui.notify("that is no CSV file of less than 1 MB", type="warning", position="top")

    def _offer(self, make: object) -> None:
        assert callable(make)
        try:
            self._wanted = make()
        except InputError as error:
            ui.notify(str(error), type="warning", position="top", multi_line=True, timeout=8000)
            return
        now = self._worker.now
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
        if wish(self._worker, "upload", reference=self._wanted):
            self._fold.set_value(False)


class NotesCard:
    """A line with its time for the experiment's notes."""

    def __init__(self, worker: Worker) -> None:
        self._worker = worker
        with ui.element("section").classes("card notes"):
            ui.label("Note").classes("title")
            ui.label("Water temperature, who helped, what was odd: kept with its time.").classes(
                "hint"
            )
            with ui.element("div").classes("line"):
                self._text = ui.input("What to remember").props("outlined").classes("note")
                self._text.on("keydown.enter", self._add)
                ui.button("Add", on_click=self._add).classes("add").style("min-height:56px")

    def _add(self) -> None:
        if wish(self._worker, "note", text=self._text.value or ""):
            self._text.set_value("")


class LogCard:
    """What has happened, newest first: that is what is looked for."""

    def __init__(self) -> None:
        self._seen = 0
        with ui.element("section").classes("card"):
            ui.label("What happened").classes("title")
            self._lines = ui.element("div").classes("log")

    def refresh(self, now: PageState) -> None:
        """Adds what is new, and forgets the oldest."""
        new = now.logged - self._seen
        self._seen = now.logged
        for text in now.log[-new:] if new > 0 else ():
            with self._lines:
                line = ui.label(text)
            line.move(self._lines, 0)
        for old in self._lines.default_slot.children[LOG_LINES:]:
            self._lines.remove(old)
