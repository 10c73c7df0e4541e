"""When trials began, by the wall clock: a board counts from when it was switched on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any

from tailbeat.core.trial_file import SLOT_S, Trial
from tailbeat.experiment.analysis import Analysis
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.trial_rows import TrialRow

BY_HOST = "host clock when the trial was asked for"
WHEN_STORED = "host clock when the log was stored"
UNKNOWN = "unknown"
_NS = 1_000_000_000
_CLOCKS_AGREE_S = 1.0
_HALF_SECOND_S = 0.5  # the event log cuts the seconds' fraction off
_APART_S = 1.0

Entry = Mapping[str, Any]


@dataclass(frozen=True)
class TrialStart:
    """The begin of a trial's first beat.

    Attributes
    ----------
    utc_ns : int
        Nanoseconds since 1970, UTC.
    zone_s : int
        Offset of the local time from UTC, s.
    source : str
        ``BY_HOST``: to 0.1 s (0.5 s in event logs of older tools), ``WHEN_STORED``: not later than
        this, ``UNKNOWN``.
    shift_s : float
        Delay, s, that keeps trials apart: a simulated board may run faster than the wall clock.
    """

    utc_ns: int
    zone_s: int
    source: str
    shift_s: float = 0.0

    @property
    def known(self) -> bool:
        """Whether a host's clock was read when the trial was asked for."""
        return self.source == BY_HOST

    @property
    def host_ns(self) -> int:
        """As ``utc_ns``, without the shift."""
        return self.utc_ns - round(self.shift_s * _NS)


def starts_of(experiment: Experiment, analysis: Analysis) -> list[TrialStart]:
    """When each trial of an experiment began, by its event log.

    Parameters
    ----------
    experiment : Experiment
        The folder with the event log.
    analysis : Analysis
        Its trials.

    Returns
    -------
    list of TrialStart
        One for each of ``analysis.trials``; no trial begins before the one before it has ended.
    """
    entries = experiment.journal.entries()
    found: list[TrialStart] = []
    free_ns, zone_s = _moment(str(experiment.settings().get("made") or "1970-01-01T00:00:00+00:00"))
    for row, trial in zip(analysis.rows, analysis.trials, strict=True):
        told = _start(entries, row, trial) or TrialStart(free_ns, zone_s, UNKNOWN)
        late_ns = max(0, free_ns - told.utc_ns) if found else 0
        found.append(replace(told, utc_ns=told.utc_ns + late_ns, shift_s=late_ns / _NS))
        free_ns = found[-1].utc_ns + round((_span_s(trial) + _APART_S) * _NS)
        zone_s = told.zone_s
    return found


def _start(entries: Sequence[Entry], row: TrialRow, trial: Trial) -> TrialStart | None:
    """None: the event log does not tell."""
    begun = _begun(entries, row)
    if begun is not None:
        since_s = trial.start_us * 1e-6 - float(begun["board_s"])
        if since_s >= -_CLOCKS_AGREE_S:  # else the board was switched off meanwhile
            utc_ns, zone_s = _host_time(begun)
            return TrialStart(utc_ns + round(since_s * _NS), zone_s, BY_HOST)
    if not row.time:
        return None
    utc_ns, zone_s = _moment(row.time)
    return TrialStart(utc_ns - round(_span_s(trial) * _NS), zone_s, WHEN_STORED)


def _begun(entries: Sequence[Entry], row: TrialRow) -> Entry | None:
    """The entry of when the trial was asked for, the last one before its log was stored."""
    found = None
    for entry in entries:
        if entry.get("trial") != row.trial:
            continue
        if entry["what"] == "begun" and entry.get("board_s") is not None:
            found = entry
        elif entry["what"] == "swum":
            if entry["time"] == row.time:
                return found
            found = None
    return found


def _host_time(entry: Entry) -> tuple[int, int]:
    """(nanoseconds UTC, zone) of an entry."""
    utc_ns, zone_s = _moment(str(entry["time"]))
    exact_s = entry.get("utc_s")
    if exact_s is None:
        return utc_ns + round(_HALF_SECOND_S * _NS), zone_s
    return round(float(exact_s) * 1000) * (_NS // 1000), zone_s


def _moment(text: str) -> tuple[int, int]:
    """(nanoseconds UTC, offset of the zone in s) of an ISO 8601 time; without a zone it is UTC."""
    time = datetime.fromisoformat(text)
    if time.tzinfo is None:
        time = time.replace(tzinfo=UTC)
    zone = time.utcoffset() or timedelta()
    return round(time.timestamp()) * _NS, round(zone.total_seconds())


def _span_s(trial: Trial) -> float:
    """From the first beat to the last record."""
    slots_s = (float(trial.slots.index.max()) + 1) * SLOT_S if trial.slots.index.size else 0.0
    volts_s = max((t_s for t_s, _ in trial.battery_v), default=0.0)
    return max(trial.executed_beats * trial.beat_s, slots_s, volts_s)
