"""What a sweep showed: medians, bands and claims, from its Parquet file alone.

The figure of a Monte Carlo study: true max|e| over the iterations, with a 90 % band.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import cycle, product
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.report.style import ACCENT, GREY, Axes, Figure, mpl_ticker, picture
from tailbeat.studies.montecarlo.recipe import AGAINST_KEYS, BY_REPEATS, ClaimSpec, Recipe
from tailbeat.studies.montecarlo.results import FAILED, FISH, GROUP, Group, Rows, Table

_QUANTILES = {"median": 50, "p05": 5, "p90": 90, "p95": 95, "max": 100, "min": 0}
_BAND = 95  # of runs of one input, in per cent: what their largest rise stays below
_RESAMPLES = 200
_EARLIER = slice(4, 7)  # trials 5 to 7, by which a run has settled, and its last ones
_LAST = slice(-3, None)


@dataclass(frozen=True)
class GroupSummary:
    """One group. Arrays over iterations, true max|e| in m/s, of the fish that did not fail.
    ``fixed``: it learns nothing."""

    plant: str
    law: str
    noise: str
    corner: str
    reference: str
    fixed: bool
    fish: int
    failed: int
    floor_minimax_m_s: float
    floor_lsq_m_s: float
    median_m_s: F64
    low_m_s: F64
    high_m_s: F64
    measured_median_m_s: F64
    true_rms_median_m_s: F64

    @property
    def over_floor(self) -> float:
        """Median of the last iteration over the floor."""
        return float(self.median_m_s[-1] / self.floor_lsq_m_s)


@dataclass(frozen=True)
class ClaimResult:
    """How a claim came out. ``figure``: the worst group's, ``group`` says which; ``interval``: 95 %
    of it, had other fish been drawn. ``is_open``: it does not hold, but with other fish it could:
    the interval reaches the bound."""

    text: str
    holds: bool
    is_open: bool
    figure: float
    interval: tuple[float, float]
    bound: str
    group: str
    figures: dict[str, float]


@dataclass(frozen=True)
class StudySummary:
    """All of a sweep. ``failures``: the fish that could not be identified or taught, and why."""

    recipe: str
    title: str
    lines: list[GroupSummary]
    claims: list[ClaimResult]
    failures: list[str]

    @property
    def failed(self) -> list[ClaimResult]:
        """Claims that do not hold, and would not with other fish."""
        return [claim for claim in self.claims if not (claim.holds or claim.is_open)]

    @property
    def open(self) -> list[ClaimResult]:
        """Claims that more fish would decide."""
        return [claim for claim in self.claims if claim.is_open]


def summarise(recipe: Recipe, table: Table) -> StudySummary:
    """From the results of a recipe, or as much of them as there is."""
    rows = Rows.of(table)
    lines = [_line(key, group) for key, group in rows.groups()]
    known = {plant.name for plant in recipe.plants}
    foreign = not known.issuperset(rows.words("plant"))  # which no claim is about
    claims = [] if foreign else [judge(one, rows) for one in recipe.claims]
    return StudySummary(recipe.name, recipe.title, lines, claims, _failures(rows.failures))


def _failures(rows: Rows) -> list[str]:
    texts = (rows.words(name) for name in (*FISH, "failure"))
    return [
        f"{' / '.join(filter(None, words))}, seed {seed}: {failure}"
        for seed, *words, failure in zip(rows.columns["seed"], *texts, strict=True)
    ]


def _line(key: Group, rows: Rows) -> GroupSummary:
    fish = len(np.unique(rows.columns["seed"]))
    lsq, own = rows.columns["floor_lsq_m_s"], rows.columns["floor_minimax_m_s"]
    failed = len(rows.failures)
    swam = rows.where(np.array(rows.words("verdict")) != FAILED) if failed < fish else rows
    true = swam.grid("true_max_abs_error_m_s")
    low, median, high = np.percentile(true, [5, 50, 95], axis=0)
    names: dict[str, Any] = dict(zip(GROUP, key, strict=True))
    return GroupSummary(
        **names,
        fixed="fixed" in rows.words("swum_law"),
        fish=fish,
        failed=failed,
        floor_minimax_m_s=float(np.median(own)),
        floor_lsq_m_s=float(np.median(np.where(np.isfinite(lsq), lsq, own))),
        median_m_s=median,
        low_m_s=low,
        high_m_s=high,
        measured_median_m_s=_known_median(swam.grid("max_abs_error_m_s")),
        true_rms_median_m_s=np.median(swam.grid("true_rms_error_m_s"), axis=0),
    )


def _known_median(grid: F64) -> F64:
    """Of what is known in each column, NaN where nothing is."""
    return np.array(
        [np.median(known) if (known := column[np.isfinite(column)]).size else np.nan
         for column in grid.T]
    )  # fmt: skip


def judge(claim: ClaimSpec, rows: Rows) -> ClaimResult:
    """A claim about results. Without any row that it speaks of it does not hold."""
    more = filter(None, [claim.over, claim.against.get("of")])
    needed = {*GROUP, "seed", "iteration", claim.of, *more}
    rows = Rows({name: rows.columns[name] for name in sorted(needed)}, rows.texts)
    chosen = rows.select(claim.where)
    groups = [(("all",), chosen)] if claim.pool else list(chosen.groups())
    found: dict[str, tuple[float, Rows, Rows | None]] = {}
    for key, group in groups:
        other = _counterpart(claim, key, rows) if claim.against else None
        name = " / ".join(word for word in key if word)
        found[name] = (_compared(claim, group, other), group, other)
    figures = {name: figure for name, (figure, _, _) in found.items()}
    result = _verdict(claim, figures)
    if not np.isfinite(result.figure):
        return result
    _, group, other = found[result.group]
    interval = _interval(claim, group, other)
    reaches = interval[0] <= _most(claim) and interval[1] >= _least(claim)
    return replace(result, interval=interval, is_open=reaches and not result.holds)


def _least(claim: ClaimSpec) -> float:
    return -np.inf if claim.at_least is None else claim.at_least


def _most(claim: ClaimSpec) -> float:
    return np.inf if claim.at_most is None else claim.at_most


def _compared(claim: ClaimSpec, group: Rows, other: Rows | None) -> float:
    if claim.statistic in BY_REPEATS:
        assert other is not None  # the recipe was checked
        return _by_repeats(claim, group, other)
    figure = _figure(claim, group)
    return figure if other is None else figure / _figure(claim, other, against=True)


def _interval(claim: ClaimSpec, group: Rows, other: Rows | None) -> tuple[float, float]:
    """95 % of a figure over fish that are drawn anew from those there are; the same ones every
    time. Where both are of the same fish, they stay together."""
    rng = np.random.default_rng(1)
    seeds = np.unique(group.columns["seed"])
    figures = []
    for _ in range(_RESAMPLES):
        drawn = rng.choice(seeds, len(seeds))
        figures.append(_compared(claim, group.of_fish(drawn), other and other.of_fish(drawn)))
    known = np.array(figures)[np.isfinite(figures)]
    if not known.size:
        return float("nan"), float("nan")
    low, high = np.percentile(known, (2.5, 97.5))
    return float(low), float(high)


def _verdict(claim: ClaimSpec, figures: dict[str, float]) -> ClaimResult:
    unknown = float("nan"), float("nan")
    low, high = _least(claim), _most(claim)
    limits = (("at least", claim.at_least), ("at most", claim.at_most))
    bound = " and ".join(f"{words} {value:g}" for words, value in limits if value is not None)
    known = {key: value for key, value in figures.items() if np.isfinite(value)}
    if not known or len(known) < len(figures):
        missing = next((key for key in figures if key not in known), "no rows")
        return ClaimResult(claim.text, False, False, float("nan"), unknown, bound, missing, figures)
    worst = max(known, key=lambda key: max(known[key] - high, low - known[key]))
    holds = low <= known[worst] <= high
    return ClaimResult(claim.text, bool(holds), False, known[worst], unknown, bound, worst, figures)


def _counterpart(claim: ClaimSpec, key: Group, rows: Rows) -> Rows:
    """The rows a group is held against: of the same plant, noise and so on, but for what
    ``against`` names; a law without corners has only one."""
    wanted = {k: v for k, v in claim.against.items() if k not in AGAINST_KEYS}
    if claim.pool:
        return rows.select({**claim.where, **wanted})
    same = {name: value for name, value in zip(GROUP, key, strict=True) if name not in wanted}
    if "law" in wanted:
        same.pop("corner", None)
    return rows.select({**same, **wanted})


def _figure(claim: ClaimSpec, rows: Rows, against: bool = False) -> float:
    """The statistic of a group. A counterpart without an iteration of its own stands for all of
    its trials if it is another law, for the same iteration if not."""
    iteration = claim.iteration
    if against:
        other = claim.against.get("iteration")
        iteration = other if other is not None or "law" in claim.against else iteration
    rows = _at(rows, iteration, claim.from_iteration)
    column = claim.against.get("of", claim.of) if against else claim.of
    values = rows.columns[column].astype(np.float64)
    if claim.over:
        values = values / rows.columns[claim.over]
    if not values.size or not np.isfinite(values).all():
        return float("nan")
    statistic = claim.against.get("statistic", claim.statistic) if against else claim.statistic
    if statistic == "reach":
        return _reached(rows, values, claim.level)
    if statistic == "share":
        return float(np.mean(values != 0))
    return float(np.percentile(values, _QUANTILES.get(statistic, 50)))


def _reached(rows: Rows, values: F64, level: float) -> float:
    """Median over fish of the first iteration at which a value is at most ``level``, the one after
    the last for a fish that never got there."""
    grid = Rows({**rows.columns, "value": values}, rows.texts).grid("value")
    reached = np.hstack([grid <= level, np.ones((len(grid), 1), dtype=bool)])
    first = int(rows.columns["iteration"].min())
    return float(np.median(first + np.argmax(reached, axis=1)))


def _at(rows: Rows, iteration: int | None, from_iteration: int) -> Rows:
    at = rows.columns["iteration"]
    if iteration is None or not len(rows):
        return rows.where(at >= from_iteration)
    return rows.where(at == (at.max() if iteration < 0 else iteration))


def _by_repeats(claim: ClaimSpec, rows: Rows, repeats: Rows) -> float:
    """Share of runs that rise no more than 95 % of equally long runs of a fixed input do: at most
    over the best so far (``monotone``), or in the end over what they had settled at (``settled``).
    """
    if not len(rows) or not len(repeats):
        return float("nan")
    rise = _largest_rise if claim.statistic == "monotone" else _late_rise
    run = rows.grid(claim.of)[:, 1:]
    same = repeats.grid(claim.of)[:, 1:][:, : run.shape[1]]
    if same.shape[1] < run.shape[1] or not (np.isfinite(run).all() and np.isfinite(same).all()):
        return float("nan")
    rises, band = rise(run), np.percentile(rise(same), _BAND)
    return float(np.mean(rises <= band)) if np.isfinite(rises).all() else float("nan")


def _late_rise(runs: F64) -> F64:
    """Mean max|e| of the last three trials over that of trials 5 to 7, per run; NaN when there
    are not as many."""
    if runs.shape[1] < _EARLIER.stop - _LAST.start:
        return np.full(len(runs), np.nan)
    late: F64 = runs[:, _LAST].mean(axis=1) / runs[:, _EARLIER].mean(axis=1)
    return late


def _largest_rise(runs: F64) -> F64:
    """max over iterations of max|e| over the smallest before, per run; 1 for a run of one trial."""
    if runs.shape[1] < 2:
        return np.ones(len(runs))
    best = np.minimum.accumulate(runs, axis=1)
    rise: F64 = (runs[:, 1:] / best[:, :-1]).max(axis=1)
    return rise


_STYLES = (
    (ACCENT, "-"), ("#b45f06", "--"), ("0.35", ":"), ("#38761d", "-."),
    ("#741b47", (0, (5, 1, 1, 1, 1, 1))),
)  # fmt: skip
_CORNERS_NAMED = 3  # more corners than that are drawn as one bundle
_ACROSS, _ACROSS_MAX = 3, 5  # panels in a row, and as many as that if they are the plants
_LEGENDS_MAX = 6  # panels with a legend each; more of them share one
_BANDS_MAX = 3  # laws in a panel whose bands can be told apart


def render(summary: StudySummary, path: Path) -> None:
    """Writes a PNG, a panel for every plant, noise and reference."""
    panels = _panels(summary.lines)
    plants = len({line.plant for line in summary.lines})
    across = min(len(panels), plants if 1 < plants <= _ACROSS_MAX else _ACROSS)
    down = math.ceil(len(panels) / across)
    with picture(path, 520 * across, 420 * down + 60, text_pt=11.0, layout="constrained") as figure:
        figure.suptitle(summary.title, fontweight="bold", x=0.02, ha="left", fontsize=14)
        grid = figure.subplots(down, across, squeeze=False, sharey=True)
        for axes in grid.flat[len(panels) :]:
            axes.axis("off")
        for i, (title, lines) in enumerate(panels):
            _panel(grid.flat[i], title, lines)
            if i % across == 0:
                grid.flat[i].set_ylabel("true max|e|, mm/s")
        _legends(figure, list(grid.flat[: len(panels)]))


def _panels(lines: list[GroupSummary]) -> list[tuple[str, list[GroupSummary]]]:
    """(title, lines), a row of plants for each reference and noise."""
    order = [
        list(dict.fromkeys(getattr(line, name) for line in lines))
        for name in ("reference", "noise", "plant")
    ]
    found = []
    for key in product(*order):
        there = [line for line in lines if (line.reference, line.noise, line.plant) == key]
        if there:
            reference, noise, plant = key
            words = [plant, *([reference] if len(order[0]) > 1 else [])]
            words += [noise] if len(order[1]) > 1 else []
            found.append((", ".join(words), there))
    return found


def _panel(axes: Axes, title: str, lines: list[GroupSummary]) -> None:
    axes.set_title(title, loc="left", fontsize=11, fontweight="normal")
    laws = list(dict.fromkeys(line.law for line in lines))
    for law, (color, dash) in zip(laws, cycle(_STYLES)):
        bundle = [line for line in lines if line.law == law]
        for j, line in enumerate(bundle):
            _curve(axes, line, color, dash, _label(law, bundle, j), len(laws) <= _BANDS_MAX)
    floor = lines[0].floor_lsq_m_s * 1e3
    axes.axhline(floor, color=GREY, lw=1, label="L2-optimal input")
    axes.set_title(
        f"L2-optimal {floor:.1f} mm/s", loc="right", fontsize=9, fontweight="normal", color=GREY
    )
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:g}"[0] in "25" else "")
    axes.xaxis.set_major_locator(mpl_ticker.MaxNLocator(integer=True))
    axes.set_xlabel("iteration")
    axes.grid(axis="y")


def _legends(figure: Figure, panels: list[Axes]) -> None:
    """One for all where the panels are many and draw the same laws."""
    entries = [panel.get_legend_handles_labels() for panel in panels]
    same = all(labels == entries[0][1] for _, labels in entries)
    if same and len(panels) > _LEGENDS_MAX:
        handles, labels = entries[0]
        figure.legend(handles, labels, loc="outside lower left", ncols=len(labels))
        return
    for panel in panels:
        panel.legend(fontsize=9, loc="best")


def _label(law: str, bundle: list[GroupSummary], j: int) -> str:
    if len(bundle) <= _CORNERS_NAMED:
        return " ".join(word for word in (law, bundle[j].corner) if word)
    return f"{law}, {len(bundle)} corners" if j == 0 else ""


def _curve(axes: Axes, line: GroupSummary, color: str, dash: Any, label: str, band: bool) -> None:
    first = 1 if line.fixed else 0
    iteration = np.arange(first, len(line.median_m_s))
    median, low, high = (
        values[first:] * 1e3 for values in (line.median_m_s, line.low_m_s, line.high_m_s)
    )
    faint = 0.15 if not line.corner else 0.03
    if band:
        axes.fill_between(iteration, low, high, color=color, alpha=faint, lw=0)
    axes.plot(
        iteration, median, linestyle=dash, color=color, lw=1.6 if not line.corner else 0.9,
        label=label,
    )  # fmt: skip
