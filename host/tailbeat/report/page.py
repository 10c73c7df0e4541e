"""The page of ``tailbeat report``: everything it shows is inside the file."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from tailbeat.experiment.analysis import WATER_TEMPERATURE, Analysis
from tailbeat.experiment.compare import count
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.trial_rows import TrialRow
from tailbeat.report.style import PAGE, freedom_words, mm, simulated_mark

_EVENTS = ("made", "set", "trimmed", "identified", "restored", "resumed")
_UNKNOWN = "not recorded"
_VALUE_CHARS_MAX = 160
_WIDE_PX = round(0.9 * 96 * PAGE.width_in)  # in narrower windows its text would shrink too far


@dataclass(frozen=True)
class Material:
    """What the page shows beyond the analysis. ``events``: (time, what, words)."""

    notes: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    events: Sequence[tuple[str, str, str]] = ()


def material(experiment: Experiment) -> Material:
    """Out of the experiment's folder."""
    entries = [one for one in experiment.journal.entries() if one["what"] in _EVENTS]
    return Material(
        notes=experiment.notes(),
        settings=experiment.settings(),
        events=[(str(one["time"]), str(one["what"]), _words(one)) for one in entries],
    )


@dataclass(frozen=True)
class Picture:
    """A figure as SVG, for wide windows and for narrow ones. ``alternative``: its text for who
    does not see it."""

    name: str
    wide: bytes
    narrow: bytes
    caption: str
    alternative: str


def page(analyses: Sequence[Analysis], given: Material, pictures: Sequence[Picture]) -> str:
    """The first of ``analyses`` is the page's own, the others are what it is compared with."""
    analysis = analyses[0]
    templates = Environment(
        loader=PackageLoader("tailbeat", "report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    templates.filters["data"] = _data_url
    return templates.get_template("page.html").render(
        analysis=analysis,
        best=analysis.best_row,
        columns=_columns(len(analysis.reference_m_s)),
        conditions=_conditions(analysis, given.settings),
        events=given.events,
        folders=[f"experiments/{one.name}" for one in analyses],
        headline=headline(analysis),
        mark=simulated_mark(analyses),
        notes=_notes(given.notes),
        params=_plain_items(given.settings.get("params")),
        pictures=pictures,
        problems=_problems(analyses),
        versions=_versions(analysis, given.settings),
        wide_px=_WIDE_PX,
    )


def headline(analysis: Analysis) -> str:
    """The result in one sentence: from, to, over how many trials, the error bound, the noise."""
    whole = [row for row in analysis.last_rows if row.counts and row.complete]
    if not whole:
        return _no_result(analysis.last_rows)
    counting = count(analysis)
    rows = counting.rows
    words = (
        f"Largest error over the beats: from {mm(whole[0].max_abs_error_m_s)} mm/s in the first "
        f"complete trial to {_reached(rows, counting.worse)}"
    )
    mean = sum(row.max_abs_error_m_s for row in rows) / len(rows)
    if analysis.start_error_m_s > 0:
        part = 100 * (1 - mean / analysis.start_error_m_s)
        words += (
            f", {abs(part):.0f} % {'less' if part >= 0 else 'more'} than the "
            f"{mm(analysis.start_error_m_s)} mm/s of the baseline (u = 0)"
        )
    if math.isfinite(analysis.floor_m_s):
        words += (
            f"; error bound without disturbances: {mm(analysis.floor_m_s)} mm/s on the "
            f"{'simulated' if analysis.floor_by == 'simulator' else 'identified'} fish"
        )
    if math.isfinite(analysis.noise_m_s):
        words += (
            f"; repeats scatter by {mm(analysis.noise_m_s)} mm/s (standard deviation, "
            f"{freedom_words(analysis.noise_freedom)})"
        )
    return words + "."


def _no_result(rows: Sequence[TrialRow]) -> str:
    undecided = sum(row.undecided for row in rows)
    gone = sum(not row.counts for row in rows) - undecided
    cut = len(rows) - gone - undecided
    return (
        f"No result: none of {len(rows)} trial{'s' * (len(rows) != 1)} is complete and counts "
        f"({gone} discarded, {undecided} not decided on, {cut} incomplete)."
    )


def _reached(rows: Sequence[TrialRow], worse: int) -> str:
    values = [row.max_abs_error_m_s for row in rows]
    if len(rows) == 1:
        return f"{mm(values[0])} mm/s in one trial, {rows[0].trial}, that was never repeated"
    inputs = {row.repeat_of or row.trial for row in rows}
    of = "of the best input" if len(inputs) == 1 else "since progress ended"
    of += f", {worse} of them worse than disturbances explain" if worse else ""
    mean = sum(values) / len(values)
    return (
        f"{mm(mean)} mm/s (mean of {len(rows)} trials {of}, {mm(min(values))} to {mm(max(values))})"
    )


def _problems(analyses: Sequence[Analysis]) -> list[str]:
    return [
        f"{analysis.name}: {problem}" if at else problem
        for at, analysis in enumerate(analyses)
        for problem in analysis.problems
    ]


def _data_url(svg: bytes) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(svg).decode("ascii")


def _columns(beats: int) -> list[tuple[str, str, Callable[[TrialRow], str]]]:
    """Of the table of trials: name, class, text of a row's cell."""
    return [
        ("trial", "", lambda row: str(row.trial)),
        ("iteration", "", lambda r: f"{r.iteration}{f' (epoch {r.epoch})' if r.epoch else ''}"),
        ("max|e| mm/s", "", lambda row: _number(row.max_abs_error_m_s * 1e3, 2)),
        ("RMS mm/s", "", lambda row: _number(row.rms_error_m_s * 1e3, 2)),
        ("decision", "l", lambda row: row.decision or "not decided"),
        ("reason", "l text", lambda row: row.reason),
        ("over the one before", "", _contraction),
        ("repeat of", "", lambda row: str(row.repeat_of or "")),
        ("learning", "l", _learning),
        ("end", "l", lambda row: row.end),
        ("measured beats", "", lambda row: f"{row.measured_beats} of {beats}"),
        ("saturated beats", "", lambda row: str(row.saturated_beats)),
        ("distance m", "", lambda row: _number(row.distance_m, 2)),
        ("heading error, at most", "l", _straight),
        ("battery V", "", lambda r: " → ".join(
            _number(volts, 2) for volts in (r.battery_start_v, r.battery_end_v))),
        ("input", "l", lambda row: row.input),
        ("time", "l", lambda row: row.time.replace("T", " ")),
        ("file", "l", lambda row: row.file),
    ]  # fmt: skip


def _learning(row: TrialRow) -> str:
    return "rolled back to the best" if row.rolled_back else "learned" if row.learned else "–"


def _contraction(row: TrialRow) -> str:
    text = _number(row.contraction, 2)
    if math.isfinite(row.noise_low):
        text += f" ({row.noise_low:.2f} to {row.noise_high:.2f})"
    return text


def _straight(row: TrialRow) -> str:
    if row.straight is None:
        return "not known"
    angles = row.straight.worst_yaw_rad, row.straight.mean_yaw_rad
    worst, mean = (round(math.degrees(angle)) for angle in angles)
    return f"{worst:+d}°, mean {mean:+d}°{', NOT STRAIGHT' if row.straight.crooked else ''}"


def _conditions(analysis: Analysis, settings: Mapping[str, Any]) -> dict[str, str]:
    peak = max((float(value) for value in analysis.reference_m_s), default=math.nan)
    conditions = dict(analysis.conditions)
    water = conditions.pop(WATER_TEMPERATURE, None)
    return {
        "fish": analysis.fish or _UNKNOWN,
        "operator": _plain(settings.get("operator") or None),
        "configuration": _plain(settings.get("configuration") or None),
        "water temperature": _UNKNOWN if water is None else f"{_plain(water)} °C",
        "reference": f"{analysis.reference_name or 'without a name'}, "
        f"{len(analysis.reference_m_s)} beats of {analysis.beat_s:g} s, up to {mm(peak)} mm/s, "
        f"CRC {analysis.reference_crc:#010x}",
        "law": analysis.law or _UNKNOWN,
        "amplitude limit": f"{analysis.amplitude_max_rad:.3f} rad "
        f"({math.degrees(analysis.amplitude_max_rad):.0f}°)",
        **_plain_items(conditions),
    }


def _versions(analysis: Analysis, settings: Mapping[str, Any]) -> dict[str, str]:
    builds = sorted({trial.build_id for trial in analysis.trials if trial.build_id})
    return {
        "board": f"{analysis.board} {analysis.unique_id}",
        "firmware": ", ".join(builds) or _plain(settings.get("firmware")),
        **_plain_items(settings.get("tool")),
    }


def _notes(markdown: str) -> dict[str, list[Any]]:
    """``entries``: the notes' own lines with their times; ``text``: other lines."""
    entries, text = [], []
    for line in markdown.splitlines():
        if note := re.match(r"- \*\*(.+?)\*\* (.*)", line):
            entries.append(note.groups())
        elif line.strip() and not line.startswith("# "):
            text.append(line.strip())
    return {"entries": entries, "text": text}


def _words(entry: Mapping[str, Any]) -> str:
    rest = {key: value for key, value in entry.items() if key not in ("time", "what")}
    given = (f"{key} {_plain(value)}" for key, value in rest.items() if value not in (None, {}))
    text = "; ".join(given)
    return text if len(text) <= _VALUE_CHARS_MAX else text[: _VALUE_CHARS_MAX - 1] + "…"


def _plain_items(values: Any) -> dict[str, str]:
    """Of a table in a user's file; empty without one."""
    return {k: _plain(value) for k, value in values.items()} if isinstance(values, dict) else {}


def _plain(value: Any) -> str:
    if value is None:
        return _UNKNOWN
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, dict):
        return ", ".join(f"{key} {_plain(item)}" for key, item in value.items())
    if isinstance(value, list):
        return ", ".join(map(_plain, value))
    return str(value)


def _number(value: float, digits: int) -> str:
    return "–" if not math.isfinite(value) else f"{value:.{digits}f}"
