"""The charts as options for ECharts: pure functions of a snapshot.

Colours are the page's own (page.css), which the browser looks up when it draws: they follow its
wish for dark or light at once. ECharts cannot lighten such a colour, so nothing is emphasized.
They differ in lightness too, and lines in dashes and marks: they are told apart in grey.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from tailbeat.app.web.state import PageState, Point, TrialCurve
from tailbeat.core.printable import mm
from tailbeat.experiment.trial_rows import TrialRow

Options = dict[str, Any]

REFERENCE, MEASURED, LIMIT = "var(--reference)", "var(--sea)", "var(--stop)"
_INK, _GRID, _PAPER = "var(--ink)", "var(--line)", "var(--paper)"
_FONT = {"fontSize": 12, "color": _INK}
_DASHES = "path://M0,3h7v3h-7zM10,3h7v3h-7z"
_CROSS = "path://M0,0L10,10M0,10L10,0"
_SOLID = {"color": MEASURED, "width": 2}
_DASHED = {"color": REFERENCE, "width": 3, "type": [7, 5]}
_OVERLAID = 4
_EARLIER = "var(--earlier)"
_SIDE_M, _MARGIN_M = 0.3, 0.1
_WALL = {"color": _INK, "width": 3}
_ERROR_MIN_MM_S = 0.1  # below it a logarithmic axis shows nothing of interest
_NOT_KEPT = (
    ("repeated", "repeat", "diamond", MEASURED),
    ("discarded", "discard", _CROSS, REFERENCE),
)


def speed_chart(now: PageState) -> Options:
    """Reference and measured speed per beat, mm/s."""
    reference, measured = _mm(now.reference_m_s), _mm(now.speed_m_s)
    dots: Options = {"symbol": "circle", "symbolSize": 6, "showAllSymbol": True}
    options = _frame(
        "mm/s",
        [
            _series("reference", "line", reference, REFERENCE, symbol="none", lineStyle=_DASHED),
            *(_earlier(curve) for curve in _overlaid(now)),
            _series("measured", "line", measured, MEASURED, lineStyle=_SOLID, **dots),
        ],
        beats=len(measured),
        top=_above([v for v in (*reference, *measured) if v is not None]),
    )
    of = [{"name": "reference", "icon": _DASHES}] if reference else []
    options["legend"]["data"] = [*of, {"name": "measured"}]
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
        for wanted, v in zip(now.reference_m_s, now.speed_m_s, strict=not now.run)
    ]
    curve = next((one for one in now.curves if one.trial == now.trial), None)
    flags = curve.saturated if curve is not None else ()
    applied = curve.amplitude_rad if curve is not None else now.amplitude_rad
    saturated = [[k, error[k] or 0.0] for k, flag in enumerate(flags) if flag and k < len(error)]
    is_over = curve is not None or now.phase == "deciding"
    missing = [
        [k, 0]
        for k, (value, amplitude) in enumerate(zip(error, applied, strict=False))
        if is_over and value is None and amplitude is not None
    ]
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
        _series(
            name, "scatter", points, colour, symbol=symbol, symbolSize=9, itemStyle=_stroked(colour)
        )
        for name, points, symbol, colour in marks
        if points
    ]
    options = _frame("mm/s", [bars, *shown], beats=len(error), top=None)
    most = max((abs(v) for v in (*error, (bound or 0.0) * 1e3) if v is not None), default=1.0)
    end = _ceiling(most)
    options["yAxis"] |= {"min": -end, "max": end, "interval": end / 2}
    return options


def _stroked(colour: str) -> Options:
    """For marks that are lines: there is nothing to fill in a cross."""
    return {"color": colour, "borderColor": colour, "borderWidth": 2}


def _ceiling(most_mm_s: float) -> float:
    """A round end of an axis that holds it."""
    return max(10.0, 10.0 * math.ceil(0.11 * most_mm_s)) if math.isfinite(most_mm_s) else 10.0


def tank_chart(now: PageState) -> Options:
    """The tank from above: walls, start pose, tank clearance, and where the fish has been."""
    x0_m, y0_m, heading_rad = now.start_pose
    walls = _walls(now)
    series = [
        _series("wall", "line", [list(one) for one in wall], _INK, symbol="none", lineStyle=_WALL)
        for wall in walls
    ]
    path = [[round(x, 3), round(y, 3)] for x, y in now.track]
    track = _series("path", "line", path, MEASURED, symbol="none", lineStyle=_SOLID)
    end_m = x0_m + now.room_m if now.room_m is not None and math.isfinite(now.room_m) else None
    if end_m is not None:
        track["markLine"] = _line(0.0, "end of the clearance", LIMIT)
        track["markLine"]["label"]["position"] = "insideEndTop"
        track["markLine"]["data"] = [{"xAxis": round(end_m, 3)}]
    turned_deg = round(-90 - math.degrees(heading_rad), 1)  # it points up, and counts to the left
    arrow: Options = {"symbol": "triangle", "symbolSize": 14, "symbolRotate": turned_deg}
    series += [track, _series("start", "scatter", [[x0_m, y0_m]], REFERENCE, **arrow)]
    if path:
        series.append(_series("fish", "scatter", path[-1:], MEASURED, symbolSize=14))
    corners = [point for wall in walls for point in wall]
    xs = [x0_m, *(x for x, _ in (*now.track, *corners)), x0_m + 1.0 if end_m is None else end_m]
    ys = [y0_m, *(y for _, y in (*now.track, *corners))]
    options = _frame("m", series, beats=0, top=None)
    options["legend"]["data"] = [one["name"] for one in series if one["name"] != "wall"]
    options["xAxis"] = _x_axis("m ahead") | {
        "type": "value",
        "min": round(min(xs) - _MARGIN_M, 1),
        "max": round(max(xs) + _MARGIN_M, 1),
        "axisLabel": _FONT | {"showMinLabel": False, "showMaxLabel": False},  # beside others
    }
    side_m = max(_SIDE_M, max(ys) - y0_m, y0_m - min(ys)) + _MARGIN_M
    span = {"min": round(y0_m - side_m, 2), "max": round(y0_m + side_m, 2), "inverse": True}
    beside = {"name": "m to the right", "nameLocation": "start", "axisLine": {"onZero": False}}
    options["yAxis"] |= span | beside | {"splitNumber": 2}
    return options


def _walls(now: PageState) -> list[list[Point]]:
    """Lines: around the calibration's area; else the two end walls, beside which nothing is known.
    The fish starts with its tail at the one behind it, as ``TANK_LEN_M`` is checked."""
    if now.walls:
        return [[*now.walls, now.walls[0]]]
    x0_m, y0_m, _ = now.start_pose
    ends = now.end_walls_m or ()
    return [
        [(round(x0_m + end_m, 3), round(y0_m + side_m, 3)) for side_m in (-_SIDE_M, _SIDE_M)]
        for end_m in ends
    ]


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
        top = _above([limit, *(a for a in degrees if a is not None)])  # a run may go beyond it
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
            style = {"color": _PAPER, "borderColor": colour, "borderWidth": 2}
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
    plain: Options = {"itemStyle": {"color": colour}, "emphasis": {"disabled": True}}
    plain["markLine"] = {"data": []}  # left out, the line drawn before would stay
    return {"name": name, "type": kind, "data": data, **plain, **look}


def _line(value: float, words: str, colour: str) -> Options:
    return {
        "silent": True,
        "symbol": "none",
        "animation": False,
        "lineStyle": {"color": colour, "width": 2, "type": [2, 3]},
        "label": {
            "formatter": words,
            "position": "insideEndTop",
            "color": colour,
            "backgroundColor": _PAPER,  # lines of the grid do not strike it out
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
        "axisLine": {"lineStyle": {"color": _INK}, "onZero": False},
        "axisTick": {"lineStyle": {"color": _INK}},
        "splitLine": {"show": False},
    }


def _frame(unit: str, series: list[Options], beats: int, top: float | None) -> Options:
    """What all charts share. Never animated: what moves here is the fish."""
    value: Options = {
        "type": "value",
        "name": unit,
        "nameTextStyle": _FONT | {"align": "left", "padding": [0, 0, 0, -26]},
        "axisLabel": _FONT,
        "axisLine": {"lineStyle": {"color": _INK}},
        "axisTick": {"lineStyle": {"color": _INK}},
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
        "tooltip": {
            "trigger": "axis",
            "confine": True,
            "backgroundColor": _PAPER,
            "borderColor": _GRID,
            "textStyle": {"color": _INK},
            "axisPointer": {"lineStyle": {"color": REFERENCE}},
        },
        "xAxis": _x_axis("beat, from 0") | {"type": "category", "data": list(range(beats))},
        "yAxis": value,
        "series": series,
    }


# The same in words and numbers, for who does not see the charts. The speeds of every beat are in
# the CSV file of each trial.


def speed_text(now: PageState) -> str:
    """As ``speed_chart``."""
    if now.run:
        return f"{now.run}, without a reference; {_measured(now.speed_m_s)}"
    if not now.reference_m_s:
        return "no reference yet"
    of = f"reference {_range(now.reference_m_s)} mm/s over {len(now.reference_m_s)} beats"
    return f"{of}; {_measured(now.speed_m_s)}"


def beat_error_text(now: PageState) -> str:
    """As ``beat_error_chart``."""
    errors = [
        (abs(wanted - v), k)
        for k, (wanted, v) in enumerate(zip(now.reference_m_s, now.speed_m_s, strict=False))
        if v is not None
    ]
    if not errors:
        return "nothing measured yet"
    most, beat = max(errors)
    words = f"largest {mm(most)} mm/s at beat {beat}; {len(errors)} beats measured"
    curve = next((one for one in now.curves if one.trial == now.trial), None)
    if curve is not None:
        words += f"; {sum(curve.saturated)} beats at the amplitude limit"
    return words + _bound(now)


def amplitude_text(now: PageState) -> str:
    """As ``amplitude_chart``."""
    known = [math.degrees(a) for a in now.amplitude_rad if a is not None]
    limit = now.amplitude_max_rad
    of = "" if limit is None else f"; limit {math.degrees(limit):.0f} degrees"
    if not known:
        return f"no beat executed yet{of}"
    return f"{min(known):.0f} to {max(known):.0f} degrees over {len(known)} beats{of}"


def error_text(now: PageState) -> str:
    """As ``error_chart``."""
    kept = [
        (row.iteration, row.max_abs_error_m_s)
        for row in now.rows
        if row.decision == "keep" and math.isfinite(row.max_abs_error_m_s)
    ]
    if not kept:
        return f"no trial kept yet{_bound(now)}"
    listed = ", ".join(f"iteration {iteration} {mm(error)}" for iteration, error in kept)
    return f"{listed} mm/s{_bound(now)}"


def tank_text(now: PageState) -> str:
    """As ``tank_chart``."""
    walls = "walls as calibrated" if now.walls else ""
    if not walls and now.end_walls_m is not None:
        walls = f"tank {now.end_walls_m[1] - now.end_walls_m[0]:.2f} m long"
    words = [walls or "walls not known"]
    if now.track:
        (x_m, y_m), (x0_m, y0_m, _) = now.track[-1], now.start_pose
        aside = f"{abs(y_m - y0_m):.2f} m to the {'right' if y_m > y0_m else 'left'}"
        words.append(f"fish {x_m - x0_m:.2f} m ahead of its start, {aside}")
    else:
        words.append("the camera has not seen the fish in a trial yet")
    if now.room_m is not None and math.isfinite(now.room_m):
        words.append(f"tank clearance {now.room_m:.2f} m")
    return "; ".join(words)


def compare_text(one: TrialCurve | None, other: TrialCurve | None) -> str:
    """As ``compare_chart``."""
    there = [curve for curve in (one, other) if curve is not None]
    each = [f"trial {curve.trial}: {_measured(curve.speed_m_s)}" for curve in there]
    return "; ".join(each) or "no trial yet"


def _measured(speed_m_s: Sequence[float | None]) -> str:
    known = [v for v in speed_m_s if v is not None]
    if not known:
        return "nothing measured yet"
    return f"measured {_range(known)} mm/s in {len(known)} beats, the last {mm(known[-1])}"


def _range(values_m_s: Sequence[float]) -> str:
    return f"{mm(min(values_m_s))} to {mm(max(values_m_s))}"


def _bound(now: PageState) -> str:
    bound = now.error_bound_m_s
    known = bound is not None and math.isfinite(bound)
    return f"; error bound {mm(bound)} mm/s" if known else ""
