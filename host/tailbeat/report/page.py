"""The page of ``tailbeat report``: everything it shows is inside the file."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

from tailbeat.experiment.analysis import Analysis
from tailbeat.experiment.compare import count
from tailbeat.experiment.conditions import WATER_TEMPERATURE
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.trial_rows import TrialRow
from tailbeat.report.style import PAGE, SIMULATED, freedom_words, mm, simulated_mark

_HAPPENED = ("made", "set", "trimmed", "identified", "restored", "resumed")
_VALUE_CHARS_MAX = 160
_WIDE_PX = round(0.9 * 96 * PAGE.width_in)  # in narrower windows its text would shrink too far
_CSS = """
:root{color-scheme:light}
body{font:16px/1.5 system-ui,sans-serif;color:#1d1d1d;background:#fff;max-width:900px;
margin:1.5rem auto 4rem;padding:0 1rem;overflow-wrap:break-word}
h1{font-size:1.35rem;line-height:1.25;margin:0 0 .4rem}h2{font-size:1.15rem;margin:2.4rem 0 .6rem}
.mark{font-size:.85rem;font-weight:700;color:#fff;background:#444;border-radius:.3rem;
padding:.1rem .5rem;white-space:nowrap}
.head{font-size:1.1rem}.problems{border-left:.3rem solid #b35900;padding-left:.8rem}
figure{margin:1.2rem 0}figcaption{font-size:.85rem;color:#444;line-height:1.45;margin-top:.4rem}
picture img{display:block;width:100%;height:auto}
.scroll{overflow-x:auto;border:1px solid #ddd;border-radius:.3rem;background:
linear-gradient(90deg,#fff 1.5rem,#fff0) 0 0/3rem 100% local,
linear-gradient(270deg,#fff 1.5rem,#fff0) 100% 0/3rem 100% local,
linear-gradient(90deg,#0004,#0000) 0 0/.8rem 100% scroll,
linear-gradient(270deg,#0004,#0000) 100% 0/.8rem 100% scroll #fff;background-repeat:no-repeat}
.scroll:focus-visible{outline:3px solid #0072b2}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.85rem}
caption{text-align:left;color:#444;padding:.3rem .6rem}
th,td{padding:.3rem .6rem;text-align:right;border-bottom:1px solid #e2e2e2;vertical-align:top}
td,thead th{white-space:nowrap}thead th{border-bottom:2px solid #333}.l{text-align:left}
td.text{text-align:left;white-space:normal;min-width:9rem}
.pairs th{text-align:left;font-weight:400;color:#444}.pairs td{text-align:left;white-space:normal;
overflow-wrap:anywhere}
tbody th time{font-weight:400}
tr.gone td,tr.gone th{color:#5c5c5c;background:#0000000b}tr.best td,tr.best th{font-weight:700}
ul.notes{padding-left:1.1rem}ul.params{columns:15rem;padding:0;list-style:none;font-size:.85rem}
@media screen and (min-width:960px){.trials{width:min(96vw,1500px);margin-left:50%;
transform:translateX(-50%)}}time{color:#444;font-variant-numeric:tabular-nums}
code,pre{font-size:.85rem}pre{background:#f4f4f4;padding:.7rem;overflow-x:auto;border-radius:.3rem}
.cols{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,19rem),1fr));gap:0 2rem}
@media print{@page{margin:12mm}body{margin:0;max-width:none;font-size:10pt}
.scroll{overflow:visible;border:0;background:none}table{font-size:6pt}th,td{padding:1pt 2pt}
td,thead th{white-space:normal}td.text{min-width:0}td.l{overflow-wrap:anywhere}
figure,tr{break-inside:avoid}
h2{break-after:avoid}.mark{color:#000;background:none;border:1.5pt solid #000}}
"""


@dataclass(frozen=True)
class Material:
    """What the page tells beyond the analysis. ``happened``: (time, what, words)."""

    notes: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    happened: Sequence[tuple[str, str, str]] = ()


def material(experiment: Experiment) -> Material:
    """Out of the experiment's folder."""
    entries = [one for one in experiment.journal.entries() if one["what"] in _HAPPENED]
    return Material(
        notes=experiment.notes(),
        settings=experiment.settings(),
        happened=[(str(one["time"]), str(one["what"]), _words(one)) for one in entries],
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
    mark = simulated_mark(analyses)
    badge = f' <span class="mark">{mark}</span>' if mark else ""
    title = escape(f"{analysis.name}{f' ({mark})' if mark else ''}")
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<meta name="viewport" content="width=device-width,initial-scale=1">
<style>{_CSS}</style></head><body>
<header><h1>{escape(_title(analysis))}{badge}</h1>
<p class="head">{escape(headline(analysis))}</p></header>
<main>
{_problems(analyses)}{_figures(pictures)}
<h2>Trials</h2>
{_trials(analysis)}
<div class="cols">
<section><h2>Conditions</h2>
{_pairs(_conditions(analysis, given.settings), analysis, "conditions")}</section>
<section><h2>Versions</h2>
{_pairs(_versions(analysis, given.settings), analysis, "versions")}</section>
</div>
<h2>Notes</h2>
{_notes(given.notes)}
{_happened(given, analysis)}
<h2>Settings</h2>
{_params(given.settings, analysis)}
<h2>How to do it again</h2>
{_redo(analyses)}
</main></body></html>
"""


def _title(analysis: Analysis) -> str:
    fish = analysis.fish or f"{analysis.board} fish"
    return f"{fish} learns the {analysis.reference_name or 'wanted'} speed profile"


def headline(analysis: Analysis) -> str:
    """The result in one sentence: from, to, over how many swims, the floor, the noise."""

    whole = [row for row in analysis.last_rows if row.counts and row.complete]
    if not whole:
        return _no_result(analysis.last_rows)
    counting = count(analysis)
    rows = counting.rows
    words = (
        f"Largest error over the beats: from {mm(whole[0].max_abs_error_m_s)} mm/s in the first "
        f"complete swim to {_reached(rows, counting.worse)}"
    )
    mean = sum(row.max_abs_error_m_s for row in rows) / len(rows)
    if analysis.start_error_m_s > 0:
        part = 100 * (1 - mean / analysis.start_error_m_s)
        words += (
            f", {abs(part):.0f} % {'less' if part >= 0 else 'more'} than the "
            f"{mm(analysis.start_error_m_s)} mm/s of a fish that does not move"
        )
    words += _floor(analysis)
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
        f"No result: none of {_swims(len(rows))} is complete and counts ({gone} discarded, "
        f"{undecided} not decided on, {cut} incomplete)."
    )


def _reached(rows: Sequence[TrialRow], worse: int) -> str:
    values = [row.max_abs_error_m_s for row in rows]
    if len(rows) == 1:
        return f"{mm(values[0])} mm/s in one swim, trial {rows[0].trial}, that was never repeated"
    inputs = {row.repeat_of or row.trial for row in rows}
    of = "of the best input" if len(inputs) == 1 else "since progress ended"
    of += f", {worse} of them worse than noise explains" if worse else ""
    mean = sum(values) / len(values)
    return (
        f"{mm(mean)} mm/s (mean of {len(rows)} swims {of}, {mm(min(values))} to {mm(max(values))})"
    )


def _floor(analysis: Analysis) -> str:
    if not math.isfinite(analysis.floor_m_s):
        return ""
    fish = "simulated" if analysis.floor_by == "simulator" else "identified"
    floor = mm(analysis.floor_m_s)
    return f"; without noise no input does better than {floor} mm/s on the {fish} fish"


def _problems(analyses: Sequence[Analysis]) -> str:
    lines = [
        f"{analysis.name}: {problem}" if at else problem
        for at, analysis in enumerate(analyses)
        for problem in analysis.problems
    ]
    if not lines:
        return ""
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f'<section class="problems"><h2>To know</h2><ul>{items}</ul></section>\n'


def _figures(pictures: Sequence[Picture]) -> str:
    parts = ["<h2>Figures</h2>"]
    media = f"(min-width: {_WIDE_PX}px), print"
    parts += [
        f'<figure id="{one.name}"><picture><source media="{media}" srcset="{_data(one.wide)}">'
        f'<img alt="{escape(one.alternative)}" src="{_data(one.narrow)}"></picture>'
        f"<figcaption>{escape(one.caption)}</figcaption></figure>"
        for one in pictures
    ]
    return "\n".join(parts)


def _data(svg: bytes) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(svg).decode("ascii")


_HEAD = (
    ("trial", ""),
    ("iteration", ""),
    ("max|e| mm/s", ""),
    ("RMS mm/s", ""),
    ("decision", "l"),
    ("reason", "l"),
    ("over the one before", ""),
    ("repeat of", ""),
    ("what the board did", "l"),
    ("end", "l"),
    ("measured beats", ""),
    ("saturated beats", ""),
    ("distance m", ""),
    ("off its way, at most", "l"),
    ("battery V", ""),
    ("input", "l"),
    ("swum", "l"),
    ("file", "l"),
)


def _trials(analysis: Analysis) -> str:
    best = analysis.best_row
    head = "".join(f'<th scope="col"{_class(kind)}>{escape(name)}</th>' for name, kind in _HEAD)
    beats = len(analysis.reference_m_s)
    body = "".join(_trial(row, row is best, beats) for row in analysis.rows)
    words = (
        f"{_swims(len(analysis.rows))}; the best is bold, those that do not count are grey; "
        "in brackets: what noise alone does to the ratio, 95 %"
    )
    return _scroll(
        f"<caption>{_caption(words, analysis)}</caption>"
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody>",
        "Trials",
        "trials",
    )


def _trial(row: TrialRow, best: bool, beats: int) -> str:
    did = "rolled back to the best" if row.rolled_back else "learned" if row.learned else "–"
    cells = (
        (f"{row.iteration}{f' (epoch {row.epoch})' if row.epoch else ''}", ""),
        (_mm(row.max_abs_error_m_s), ""),
        (_mm(row.rms_error_m_s), ""),
        (row.decision or "not decided", "l"),
        (row.reason, "text"),
        (_contraction(row), ""),
        (str(row.repeat_of or ""), ""),
        (did, "l"),
        (row.end, "l"),
        (f"{row.measured_beats} of {beats}", ""),
        (str(row.saturated_beats), ""),
        (_number(row.distance_m, 2), ""),
        (_straight(row), "l"),
        (f"{_number(row.battery_start_v, 2)} → {_number(row.battery_end_v, 2)}", ""),
        (row.input, "l"),
        (row.time.replace("T", " "), "l"),
        (row.file, "l"),
    )
    kind = "gone" if not row.counts else "best" if best else ""
    body = "".join(f"<td{_class(kind)}>{escape(text)}</td>" for text, kind in cells)
    return f'<tr{_class(kind)}><th scope="row">{row.trial}</th>{body}</tr>'


def _contraction(row: TrialRow) -> str:
    text = _number(row.contraction, 2)
    if math.isfinite(row.noise_low):
        text += f" ({row.noise_low:.2f} to {row.noise_high:.2f})"
    return text


def _straight(row: TrialRow) -> str:
    if row.straight is None:
        return "not known"
    worst, mean = (
        round(math.degrees(angle))
        for angle in (row.straight.worst_yaw_rad, row.straight.mean_yaw_rad)
    )
    flag = ", NOT STRAIGHT" if row.straight.crooked else ""
    return f"{worst:+d}°, mean {mean:+d}°{flag}"


def _conditions(analysis: Analysis, settings: Mapping[str, Any]) -> dict[str, str]:
    peak = max((float(value) for value in analysis.reference_m_s), default=math.nan)
    conditions = dict(analysis.conditions)
    water = conditions.pop(WATER_TEMPERATURE, None)
    return {
        "fish": analysis.fish or "not told",
        "operator": _plain(settings.get("operator") or "not told"),
        "configuration": _plain(settings.get("configuration") or "not told"),
        "water temperature": "not told" if water is None else f"{_plain(water)} °C",
        "reference": f"{analysis.reference_name or 'without a name'}, "
        f"{len(analysis.reference_m_s)} beats of {analysis.beat_s:g} s, up to {mm(peak)} mm/s, "
        f"CRC {analysis.reference_crc:#010x}",
        "law": analysis.law or "not told",
        "amplitude limit": f"{analysis.amplitude_max_rad:.3f} rad "
        f"({math.degrees(analysis.amplitude_max_rad):.0f}°)",
        **{key: _plain(value) for key, value in conditions.items()},
    }


def _versions(analysis: Analysis, settings: Mapping[str, Any]) -> dict[str, str]:
    tool = settings.get("tool")
    builds = sorted({trial.build_id for trial in analysis.trials if trial.build_id})
    return {
        "board": f"{analysis.board} {analysis.unique_id}",
        "firmware": ", ".join(builds) or str(settings.get("firmware", "not told")),
        **({key: _plain(value) for key, value in tool.items()} if isinstance(tool, dict) else {}),
    }


def _params(settings: Mapping[str, Any], analysis: Analysis) -> str:
    params = settings.get("params")
    if not isinstance(params, dict) or not params:
        return "<p>None are written down.</p>"
    items = "".join(
        f"<li><code>{escape(str(name))}</code> {escape(_plain(value))}</li>"
        for name, value in params.items()
    )
    words = _caption("Parameters of the board when the experiment was made", analysis)
    return f'<p>{words}:</p><ul class="params">{items}</ul>'


def _pairs(pairs: Mapping[str, str], analysis: Analysis, words: str) -> str:
    if not pairs:
        return "<p>None are written down.</p>"
    rows = "".join(
        f'<tr><th scope="row">{escape(key)}</th><td>{escape(value)}</td></tr>'
        for key, value in pairs.items()
    )
    table = f"<caption>{_caption(words, analysis)}</caption><tbody>{rows}</tbody>"
    return _scroll(table, words.capitalize(), "pairs")


def _scroll(table: str, name: str, kind: str = "") -> str:
    """A table wider than the window scrolls in its box; by keyboard too."""
    return (
        f'<div class="scroll {kind}" tabindex="0" role="region" aria-label="{escape(name)}">'
        f"<table>{table}</table></div>"
    )


def _caption(words: str, analysis: Analysis) -> str:
    return escape(f"{words} ({SIMULATED})" if analysis.simulated else words)


def _notes(markdown: str) -> str:
    """The notes' own lines as a list with their times, other text as it stands."""
    items, rest = [], []
    for line in markdown.splitlines():
        if note := re.match(r"- \*\*(.+?)\*\* (.*)", line):
            items.append(f"<li><time>{escape(note[1])}</time> {escape(note[2])}</li>")
        elif line.strip() and not line.startswith("# "):
            rest.append(f"<p>{escape(line.strip())}</p>")
    listed = f'<ul class="notes">{"".join(items)}</ul>' if items else ""
    return "".join(rest) + listed or "<p>None.</p>"


def _happened(given: Material, analysis: Analysis) -> str:
    if not given.happened:
        return ""
    rows = "".join(
        f'<tr><th scope="row"><time>{escape(time.replace("T", " "))}</time></th>'
        f'<td class="l">{escape(what)}</td><td class="text">{escape(words)}</td></tr>'
        for time, what, words in given.happened
    )
    caption = f"<caption>{_caption('besides swims and notes', analysis)}</caption>"
    return f"<h2>What happened</h2>{_scroll(f'{caption}<tbody>{rows}</tbody>', 'What happened')}"


def _redo(analyses: Sequence[Analysis]) -> str:
    name, *others = (f"experiments/{analysis.name}" for analysis in analyses)
    against = "".join(f" --against {other}" for other in others)
    return (
        "<p>From the raw files, bit for bit; then this page and the figures:</p>"
        f"<pre><code>tailbeat experiment replay {escape(name)}\n"
        f"tailbeat report {escape(name)}{escape(against)} --paper</code></pre>"
        "<p>In the water: <code>redo.md</code> in the experiment's folder says what was done, in "
        "order.</p>"
    )


def _words(entry: Mapping[str, Any]) -> str:
    rest = {key: value for key, value in entry.items() if key not in ("time", "what")}
    text = "; ".join(
        f"{key} {_plain(value)}" for key, value in rest.items() if value not in (None, {})
    )
    return text if len(text) <= _VALUE_CHARS_MAX else text[: _VALUE_CHARS_MAX - 1] + "…"


def _plain(value: Any) -> str:
    if value is None:
        return "not told"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, dict):
        return ", ".join(f"{key} {_plain(item)}" for key, item in value.items())
    if isinstance(value, list):
        return ", ".join(map(_plain, value))
    return str(value)


def _swims(count: int) -> str:
    return f"{count} swim{'' if count == 1 else 's'}"


def _mm(value_m_s: float) -> str:
    return "–" if not math.isfinite(value_m_s) else f"{value_m_s * 1e3:.2f}"


def _number(value: float, digits: int) -> str:
    return "–" if not math.isfinite(value) else f"{value:.{digits}f}"


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""
