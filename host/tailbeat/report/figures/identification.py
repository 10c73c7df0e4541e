"""The picture of an identified fish: its map, and every run against the model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.learning.fish_model import PARAMS
from tailbeat.learning.fit_quality import NAMES, Account, TrialAccount, steady_band
from tailbeat.learning.identification import Identified, SpeedTable
from tailbeat.report.style import ACCENT, BAND, GREY, INK, Axes, Figure, picture

_PANELS_MAX = 6
_COLUMNS = 2


def draw_account(account: Account, path: Path, simulated: bool = False) -> None:
    """Writes a PNG of 1600 x 1000 px: map with band, numbers, runs with residuals."""
    count = len(account.trials)
    title = f"The fish, identified from {count} trial{'' if count == 1 else 's'}"
    volts = f", battery {account.battery_text}" if account.battery_v else ""
    words = (
        f"{account.beats} beats, the model misses them by {account.rms_m_s * 1e3:.1f} mm/s "
        f"RMS{volts}"
    )
    with picture(path, 1600, 1000, title, words, text_pt=12.5) as figure:
        if simulated:
            figure.text(
                0.98, 0.955, "SIMULATED", fontsize=14, fontweight="bold", ha="right", va="center",
                color="white", bbox={"boxstyle": "round,pad=0.45", "facecolor": "0.25", "lw": 0},
            )  # fmt: skip
        parts: Any = figure.subfigures(1, 2, width_ratios=[0.38, 0.62])
        left, right = parts
        axes = left.add_axes((0.17, 0.38, 0.78, 0.455))
        top_rad = max(trial.top_rad for trial in account.trials)
        _draw_map(axes, account.identified, *account.steady, top_rad, "95 % band")
        _numbers(left, account)
        _runs(right, account)


def draw_table(table: SpeedTable, path: Path) -> None:
    """Writes a PNG of 1000 x 700 px: the map through the rows of a table."""
    with picture(path, 1000, 700) as figure:
        axes = figure.add_axes((0.11, 0.12, 0.85, 0.76))
        top_rad = float(table.amplitude_rad[-1])
        name = "band, each row left out in turn"
        _draw_map(axes, table.identified, table.amplitude_rad, table.speed_m_s, top_rad, name)


def _draw_map(
    axes: Axes, identified: Identified, amplitude: F64, speed: F64, top_rad: float, band: str
) -> None:
    grid = np.linspace(0.0, 1.05 * top_rad, 200)
    low, high = steady_band(identified.models, grid)
    degrees = np.degrees(grid)
    axes.fill_between(degrees, low * 1e3, high * 1e3, color=BAND, lw=0, label=band)
    model = identified.model.steady_m_s(grid) * 1e3
    axes.plot(degrees, model, color=ACCENT, lw=2.4, label="model")
    axes.plot(
        np.degrees(amplitude), speed * 1e3, "o", ms=9, mfc="white", mec=INK, mew=2,
        label="measured, steady",
    )  # fmt: skip
    dead = float(np.degrees(identified.model.dead_zone_rad))
    axes.annotate(
        f"dead zone\nto {dead:.1f}°", (dead / 2, 0), (0, 8), textcoords="offset points",
        ha="center", va="bottom", color=GREY,
    )  # fmt: skip
    axes.set_xlim(0, degrees[-1])
    axes.set_ylim(0, max(float(high[-1]) * 1e3, float(np.max(speed, initial=0)) * 1e3) * 1.06)
    axes.set(xlabel="amplitude, degrees", title="Steady speed, mm/s, over tail amplitude")
    axes.grid()
    axes.legend(loc="upper left")


def _numbers(part: Figure, account: Account) -> None:
    """The first four numbers under the map."""
    known = account.identified
    for row, (name, (label, unit)) in enumerate((name, NAMES[name]) for name in PARAMS):
        low, high = known.band[name]
        value = getattr(known.model, name)
        assumed = "assumed" if name in known.assumed else f"{low:.3g} … {high:.3g}"
        y = 0.235 - 0.048 * row
        part.text(0.05, y, label, fontsize=13)
        part.text(0.62, y, f"{value:.3g} {unit}", fontsize=13, ha="right", fontweight="bold")
        part.text(0.95, y, assumed, fontsize=13, ha="right", color=GREY)
    part.text(0.95, 0.283, "95 % interval", fontsize=12, ha="right", color=GREY)


def _runs(part: Figure, account: Account) -> None:
    trials = account.trials[-_PANELS_MAX:]
    rows = -(-len(trials) // _COLUMNS)
    grid = part.add_gridspec(
        rows, _COLUMNS, left=0.07, right=0.975, bottom=0.075, top=0.835, hspace=0.36, wspace=0.17,
    )  # fmt: skip
    speed = max(float(np.nanmax(np.r_[s.speed_m_s, s.model_m_s])) for s in trials) * 1e3
    miss = max(float(np.nanmax(np.abs(s.speed_m_s - s.model_m_s))) for s in trials) * 1e3
    for index, trial in enumerate(trials):
        cell = grid[index // _COLUMNS, index % _COLUMNS].subgridspec(
            2, 1, height_ratios=[2.6, 1], hspace=0.12
        )
        above = part.add_subplot(cell[0])
        below = part.add_subplot(cell[1], sharex=above)
        _draw_run(above, below, trial, speed, miss)
        if index == 0:
            above.legend(loc="upper left")
        if index % _COLUMNS == 0:
            above.set_ylabel("mm/s")
            below.set_ylabel("miss,\nmm/s")
        if index + _COLUMNS >= len(trials):
            below.set_xlabel("time, s")


def _draw_run(above: Axes, below: Axes, trial: TrialAccount, top: float, miss: float) -> None:
    middle = (np.arange(len(trial.speed_m_s)) + 0.5) * trial.beat_s
    above.plot(
        middle, trial.speed_m_s * 1e3, "o", ms=5.5, mfc="white", mec=INK, mew=1.4, zorder=3,
        label="measured",
    )  # fmt: skip
    above.plot(middle, trial.model_m_s * 1e3, color=ACCENT, lw=2, zorder=2, label="model")
    above.set(ylim=(-0.04 * top, top * 1.12), title=_run_title(trial))
    above.tick_params(labelbottom=False)
    below.axhline(0, color=ACCENT, lw=1.2)
    below.vlines(middle, 0, (trial.speed_m_s - trial.model_m_s) * 1e3, color=INK, lw=2)
    below.set_ylim(-1.15 * max(miss, 1.0), 1.15 * max(miss, 1.0))
    for axes in (above, below):
        axes.grid(axis="y")


def _run_title(trial: TrialAccount) -> str:
    name = f"trial {trial.trial}: " if trial.trial else ""
    volts = f", {trial.battery_v:.1f} V" if trial.battery_v is not None else ""
    return f"{name}up to {np.degrees(trial.top_rad):.0f}°, {trial.way_m:.2f} m{volts}"
