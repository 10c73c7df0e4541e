"""The charts as options for ECharts: pure functions of a snapshot.

Colours differ in lightness too, and lines in dashes and marks: they are told apart in grey.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from tailbeat.app.web.state import PageState, TrialCurve
from tailbeat.experiment.trial_rows import TrialRow

Options = dict[str, Any]

REFERENCE, MEASURED, LIMIT = "#8a8f98", "#0b4f8a", "#b3261e"
_INK, _GRID = "#3c4450", "#e3e6ea"
_FONT = {"fontSize": 12, "color": _INK}
_DASHES = "path://M0,3h7v3h-7zM10,3h7v3h-7z"
_CROSS = "path://M0,0L10,10M0,10L10,0"
_SOLID = {"color": MEASURED, "width": 2}
_DASHED = {"color": REFERENCE, "width": 3, "type": [7, 5]}
_OVERLAID = 4
_EARLIER = "#9fb4c7"
_SIDE_M = 0.3
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
            *(_earlier(curve) for curve in _overlaid(now)),
            _series("measured", "line", measured, MEASURED, lineStyle=_SOLID, **dots),
        ],
        beats=len(reference),
        top=_above([*reference, *(v for v in measured if v is not None)]),
    )
    options["legend"]["data"] = [{"name": "reference", "icon": _DASHES}, {"name": "measured"}]
    return options


def _overlaid(now: PageState) -> list[TrialCurve]:
    """The last trials before the one that is shown, along the same reference."""
    same = [one for one in now.curves if _mm(one.reference_m_s) == _mm(now.reference_m_s)]
    return [one for one in same if one.trial != now.trial][-_OVERLAID:]


def _earlier(curve: TrialCurve) -> Options:
    look: Options = {"symbol": "none", "z": 1}
    return _series(
        f"trial {curve.trial}", "line", _mm(curve.speed_m_s), _EARLIER,
        lineStyle={"color": _EARLIER, "width": 1}, **look,
    )  # fmt: skip


def _mm(values_m_s: Sequence[float | None]) -> list[float | None]:
    return [None if v is None else round(v * 1e3, 2) for v in values_m_s]


def beat_error_chart(now: PageState) -> Options:
    """Reference less speed of each beat of the trial that is shown, mm/s; saturated beats and those
    without a speed are marked."""
    error = [
        None if v is None else round((wanted - v) * 1e3, 2)
        for wanted, v in zip(now.reference_m_s, now.speed_m_s, strict=True)
    ]
    curve = next((one for one in now.curves if one.trial == now.trial), None)
    flags = curve.saturated if curve is not None else ()
    saturated = [[k, error[k] or 0.0] for k, flag in enumerate(flags) if flag and k < len(error)]
    executed = curve is not None or now.phase == "deciding"
    missing = [[k, 0] for k, value in enumerate(error) if executed and value is None]
    bars = _series("error", "bar", error, MEASURED, barCategoryGap="25%")
    bound = now.error_bound_m_s
    if bound is not None and _drawable(bound):
        bars["markLine"] = _line(bound * 1e3, f"error bound ±{bound * 1e3:.1f}", LIMIT)
        bars["markLine"]["data"].append({"yAxis": -round(bound * 1e3, 3), "label": {"show": False}})
    marks = (
        ("at the limit", saturated, "triangle", LIMIT),
        ("no speed", missing, _CROSS, REFERENCE),
    )
    shown = [
        _series(name, "scatter", points, colour, symbol=symbol, symbolSize=9)
        for name, points, symbol, colour in marks
        if points
    ]
    options = _frame("mm/s", [bars, *shown], beats=len(error), top=None)
    most = max((abs(v) for v in (*error, (bound or 0.0) * 1e3) if v is not None), default=1.0)
    options["yAxis"] |= {"min": -_ceiling(most), "max": _ceiling(most)}
    return options


def _ceiling(most_mm_s: float) -> float:
    """A round end of an axis that holds it."""
    return 5.0 * math.ceil(1.1 * most_mm_s / 5.0) if math.isfinite(most_mm_s) else 5.0


def tank_chart(now: PageState) -> Options:
    """The tank from above: walls, start, how far there is room, and where the fish has been."""
    x0_m, y0_m = now.track[0] if now.track else (0.0, 0.0)
    end_m = x0_m + now.room_m if now.room_m is not None and math.isfinite(now.room_m) else None
    series = []
    if now.walls:
        outline = [*now.walls, now.walls[0]]
        look: Options = {"symbol": "none", "lineStyle": {"color": _INK, "width": 3}}
        series.append(_series("walls", "line", [list(one) for one in outline], _INK, **look))
    path = [[round(x, 3), round(y, 3)] for x, y in now.track]
    track = _series("path", "line", path, MEASURED, symbol="none", lineStyle=_SOLID)
    if end_m is not None:
        track["markLine"] = {
            "silent": True, "symbol": "none", "animation": False,
            "lineStyle": {"color": LIMIT, "width": 3},
            "label": {"formatter": "end of the room", "color": LIMIT, "fontSize": 12,
                      "position": "insideEndTop"},
            "data": [{"xAxis": round(end_m, 3)}],
        }  # fmt: skip
    arrow: Options = {"symbol": "triangle", "symbolSize": 14, "symbolRotate": -90}
    series += [track, _series("start", "scatter", [[x0_m, y0_m]], REFERENCE, **arrow)]
    if path:
        series.append(_series("fish", "scatter", path[-1:], MEASURED, symbolSize=14))
    xs = [x for x, _ in (*now.track, *now.walls)] or [0.0, 1.0]
    ys = [y for _, y in (*now.track, *now.walls)] or [0.0]
    side_m = max(_SIDE_M, *(abs(y - y0_m) for y in ys)) * 1.1
    options = _frame("m", series, beats=0, top=None)
    options["xAxis"] = _x_axis("m ahead") | {
        "type": "value",
        "min": round(min(*xs, x0_m) - 0.2, 1),
        "max": round(max(*xs, end_m or 0.0) + 0.2, 1),
    }
    span = {"min": round(y0_m - side_m, 2), "max": round(y0_m + side_m, 2), "inverse": True}
    options["yAxis"] |= span | {"splitNumber": 2}
    return options


def compare_chart(one: TrialCurve | None, other: TrialCurve | None) -> Options:
    """The speeds of two trials, with the reference of the first."""
    there = [curve for curve in (one, other) if curve is not None]
    if not there:
        return _frame("mm/s", [], beats=0, top=None)
    reference = _mm(there[0].reference_m_s)
    looks = (_SOLID, {"color": LIMIT, "width": 2, "type": [3, 3]})
    series = [
        _series("reference", "line", reference, REFERENCE, symbol="none", lineStyle=_DASHED),
        *(
            _series(
                f"trial {curve.trial}", "line", _mm(curve.speed_m_s), str(look["color"]),
                symbol=symbol, symbolSize=6, lineStyle=look,
            )
            for curve, look, symbol in zip(there, looks, ("circle", "rect"), strict=False)
        ),
    ]  # fmt: skip
    return _frame("mm/s", series, beats=len(reference), top=None)


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
