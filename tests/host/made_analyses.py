"""Analyses made by hand from a few kinds of trials, for what no simulated day brings about."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tailbeat.core.trial_checks import HeadingDrift
from tailbeat.core.trial_file import Beats, Slots, Trial
from tailbeat.experiment.analysis import Analysis, IterationStatistics
from tailbeat.experiment.trial_rows import TrialRow, with_noise

LIMIT_RAD = 0.6
BEATS = 40


def reference(beats: int = BEATS) -> Any:
    return np.asarray(0.0791 * np.sin(np.linspace(0.1, 3.0, beats)) ** 0.5, np.float32)


def trial(
    number: int,
    iteration: int,
    error_m_s: float,
    beats: int = BEATS,
    executed: int | None = None,
    gaps: Sequence[int] = (),
    wanted_rad: float = 0.5,
) -> Trial:
    """A trial whose error is the same in every beat."""
    done = beats if executed is None else executed
    there = np.arange(beats) < done
    wanted = np.full(beats, wanted_rad, np.float32)
    speed = np.where(there, reference(beats) - np.float32(error_m_s), np.float32(np.nan))
    speed[list(gaps)] = np.nan
    nothing = np.zeros(0)
    slots = Slots(*(nothing.astype(kind) for kind in ("u2", "u1", "u1", "f4", "u2", *["i2"] * 3)))
    return Trial(
        number=number,
        iteration=iteration,
        reference_crc=0x1234,
        beat_s=1.0,
        start_us=0,
        board="sim",
        build_id="abc",
        unique_id="00",
        end_fault=0 if done == beats else 1,
        executed_beats=done,
        end="complete" if done == beats else "aborted:ABORT_COMMAND",
        uploaded=False,
        params={"AMP_MAX_RAD": LIMIT_RAD},
        slots=slots,
        rest_before=None,
        rest_after=None,
        beats=Beats(
            amplitude_rad=wanted,
            applied_rad=np.minimum(wanted, np.float32(LIMIT_RAD)),
            reference_m_s=reference(beats),
            speed_m_s=speed.astype(np.float32),
            sigma_m_s=np.full(beats, 0.001, np.float32),
            samples=np.where(np.isfinite(speed), 25, 0).astype(np.uint16),
        ),
        battery_v=[(0.0, 8.1), (40.0, 7.9)],
    )


def row(swim: Trial, decision: str = "keep", **fields: Any) -> TrialRow:
    made = TrialRow(
        trial=swim.number,
        iteration=swim.iteration,
        end=swim.end,
        decision=decision,
        reason="" if decision == "keep" else "touched the <wall> & turned",
        repeat_of=0,
        max_abs_error_m_s=swim.max_abs_error_m_s(),
        rms_error_m_s=swim.rms_error_m_s(),
        measured_beats=int(np.isfinite(swim.beats.speed_m_s).sum()),
        saturated_beats=int((swim.beats.amplitude_rad > LIMIT_RAD).sum()),
        distance_m=float(np.nansum(swim.beats.speed_m_s)),
        contraction=math.nan,
        learned=decision == "keep",
        rolled_back=False,
        straight=HeadingDrift(0.02, 0.1, 0.03, "imu"),
        battery_start_v=8.1,
        battery_end_v=7.9,
        input="law",
        file=f"{swim.number:04d}.ulg",
        time=f"2026-05-04T12:{swim.number % 60:02d}:00+02:00",
        complete=swim.end == "complete" and bool(np.isfinite(swim.beats.speed_m_s).all()),
    )
    return replace(made, **fields)


def band_of(rows: Sequence[TrialRow]) -> IterationStatistics:
    counted = [r for r in rows if r.counts and r.complete]
    iterations = sorted({r.iteration for r in counted})
    columns: list[list[float]] = [[] for _ in range(6)]
    for iteration in iterations:
        mine = [r for r in counted if r.iteration == iteration]
        for at, name in enumerate(("max_abs_error_m_s", "rms_error_m_s")):
            values = [getattr(r, name) for r in mine]
            for n, part in enumerate((50, 5, 95)):
                columns[3 * at + n].append(float(np.percentile(values, part)))
    trials = [sum(r.iteration == iteration for r in counted) for iteration in iterations]
    return IterationStatistics(
        np.array(iterations, np.int64), np.array(trials, np.int64), *(np.array(c) for c in columns)
    )


def analysis(trials: Sequence[Trial], rows: Sequence[TrialRow], **fields: Any) -> Analysis:
    beats = len(trials[0].beats.samples) if trials else BEATS
    made = Analysis(
        name="2026-05-04_carl_thesis_p4-lead1_01",
        simulated=True,
        board="sim",
        unique_id="00ff",
        fish="carl",
        law="p4-lead1",
        reference_name="thesis",
        reference_crc=0x1234,
        reference_m_s=reference(beats).astype(np.float64),
        beat_s=1.0,
        amplitude_max_rad=LIMIT_RAD,
        conditions={"water_c": 21.5, "tail": "soft <blue>"},
        rows=list(rows),
        trials=list(trials),
        band=band_of(rows),
        floor_m_s=0.0105,
        floor_lsq_m_s=0.0113,
        noise_m_s=0.0015,
        start_error_m_s=float(reference(beats).max()),
        floor_by="identified",
        noise_freedom=4,
    )
    made = replace(made, **fields)
    freedom = made.noise_freedom if math.isfinite(made.noise_m_s) else 0
    noisy = with_noise(made.rows, made.noise_m_s, freedom)
    return replace(made, rows=noisy, noise_freedom=freedom)


def series(errors: Sequence[float], **fields: Any) -> Analysis:
    """One kept trial per iteration."""
    trials = [trial(n, n, e, wanted_rad=0.5 - 0.001 * n) for n, e in enumerate(errors, 1)]
    rows = [row(swim) for swim in trials]
    for n in range(1, len(rows)):
        before = rows[n - 1].max_abs_error_m_s
        ratio = rows[n].max_abs_error_m_s / before if before else math.nan
        rows[n] = replace(rows[n], contraction=ratio)
    return analysis(trials, rows, **fields)
