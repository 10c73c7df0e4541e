"""The page: picture, table of trials, settings and versions in one file without a network."""

from __future__ import annotations

import base64
import math
from html import escape
from pathlib import Path

from tailbeat.core.files import replace_file
from tailbeat.report.demo_data import Series, Swim

_CSS = """
body{font:16px/1.5 system-ui,sans-serif;color:#222;max-width:1100px;margin:2rem auto;padding:0 1rem}
h1{position:absolute;left:-9999px}h2{font-size:1.15rem;margin:2rem 0 .5rem}
img{width:100%;height:auto}
table{border-collapse:collapse;font-variant-numeric:tabular-nums}
th,td{padding:.3rem .8rem;text-align:right;border-bottom:1px solid #ddd}
th{border-bottom:2px solid #333;font-weight:600}td.l,th.l{text-align:left}
tr.best td{font-weight:700}
.cols{display:flex;flex-wrap:wrap;gap:0 4rem}.note{color:#555}
@media print{body{margin:0;max-width:none}}
"""


def write_html(series: Series, png: bytes, path: Path) -> None:
    """Writes the report; everything it shows is inside the file. The picture carries the title; the
    heading is there for those who hear the page."""
    picture = base64.b64encode(png).decode("ascii")
    simulated = " (simulated)" if series.simulated else ""
    page = f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{escape(series.title)}</title>
<meta name="viewport" content="width=device-width">
<style>{_CSS}</style></head><body>
<h1>{escape(series.title)}</h1>
<img alt="{escape(_alt(series))}" src="data:image/png;base64,{picture}">
<h2>Trials{simulated}</h2>
{_trials(series)}
{_floor(series)}
<div class="cols">
<div><h2>Settings</h2>{_pairs(series.settings)}</div>
<div><h2>Versions</h2>{_pairs(series.versions)}</div>
</div>
</body></html>
"""
    replace_file(path, page)


def _alt(series: Series) -> str:
    if not series.swims:
        return "No trials yet."
    last = series.swims[-1]
    return (
        f"Largest error per iteration, from {series.start_error_m_s * 1e3:.1f} mm/s down to "
        f"{last.max_abs_error_m_s * 1e3:.1f} mm/s at iteration {last.iteration}; "
        "speed and tail amplitude per beat and trial."
    )


def _trials(series: Series) -> str:
    head = (
        "<tr><th>iteration</th><th>trial</th><th>max|e| mm/s</th><th>RMS mm/s</th>"
        "<th>saturated beats</th><th>distance m</th><th class=l>end</th></tr>"
    )
    start = (
        f"<tr><td>0</td><td>–</td><td>{_mm(series.start_error_m_s)}</td><td></td><td></td><td></td>"
        "<td class=l>zero input, not swum</td></tr>"
    )
    finite = [s for s in series.swims if math.isfinite(s.max_abs_error_m_s)]
    best = min(finite, key=lambda s: s.max_abs_error_m_s, default=None)
    rows = "".join(_row(swim, swim is best) for swim in series.swims)
    return f"<table><thead>{head}</thead><tbody>{start}{rows}</tbody></table>"


def _row(swim: Swim, best: bool) -> str:
    mark = ' class="best"' if best else ""
    return (
        f"<tr{mark}><td>{swim.iteration}</td><td>{swim.number}</td>"
        f"<td>{_mm(swim.max_abs_error_m_s)}</td><td>{_mm(swim.rms_error_m_s)}</td>"
        f"<td>{swim.saturated_beats}</td><td>{swim.distance_m:.2f}</td>"
        f"<td class=l>{escape(swim.end)}</td></tr>"
    )


def _floor(series: Series) -> str:
    if series.floor_m_s is None:
        return ""
    text = (
        f"Floor: {_mm(series.floor_m_s)} mm/s is the smallest max|e| any input can reach on this "
        "plant without noise"
    )
    if series.floor_lsq_m_s is not None:
        text += f"; the least-squares optimum has {_mm(series.floor_lsq_m_s)} mm/s"
    return f'<p class="note">{text}.</p>'


def _pairs(pairs: dict[str, str]) -> str:
    rows = "".join(
        f'<tr><td class="l">{escape(key)}</td><td class="l">{escape(value)}</td></tr>'
        for key, value in pairs.items()
    )
    return f"<table>{rows}</table>"


def _mm(value_m_s: float) -> str:
    return "–" if not math.isfinite(value_m_s) else f"{value_m_s * 1e3:.2f}"
