"""Everything that is derived from an experiment's raw files: ``analysis.json``.

A pure function of ``raw/``, ``journal.jsonl`` and ``settings.json``, written so that the same
files give the same bytes on any machine: sums are exact (``math.fsum``), and numbers have nine
digits, which is what single precision holds, for the last bits are another processor's own. The
error bounds have six: they come from a fit by matrix algebra, in which processors differ by 5e-12.
Conditions: water temperature and whatever else may matter later.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.files import canonical, plain, write_whole
from tailbeat.core.records import decode_reference
from tailbeat.core.reference import Reference
from tailbeat.core.trial_file import Trial
from tailbeat.experiment.folder import JUDGING, Experiment
from tailbeat.experiment.store import Kept, read_kept
from tailbeat.experiment.trial_rows import TrialRow, histories_of, noise_of, rows_of, with_noise
from tailbeat.learning.convergence import Score, best_of, score_of
from tailbeat.learning.error_bound import error_bound
from tailbeat.learning.error_bound_solve import plant_config
from tailbeat.learning.fish_model import FishModel, trial_speeds
from tailbeat.learning.identification import Identified
from tailbeat.learning.model_law import swim_crc
from tailbeat.learning.saturation import saturation_of
from tailbeat.link.messages import SIMULATED_FISH

ANALYSIS = "analysis.json"
_FORMAT = "tailbeat analysis 1"
_DIGITS = 9
_BOUND_DIGITS = 6
_BAND = (50.0, 5.0, 95.0)  # median, low, high


@dataclass(frozen=True)
class IterationStatistics:
    """Per iteration of the last epoch, over its complete trials that count (max|e| of a part of the
    beats says nothing of the whole): how many, median and 5 to 95 % band of max|e| and RMS; of one
    trial all three are the same. Shape (iterations,)."""

    iteration: NDArray[np.int64]
    swims: NDArray[np.int64]
    max_median_m_s: F64
    max_low_m_s: F64
    max_high_m_s: F64
    rms_median_m_s: F64
    rms_low_m_s: F64
    rms_high_m_s: F64


@dataclass(frozen=True)
class Analysis:
    """``rows``: every trial, discarded ones too, in the order they were executed. ``trials``: the
    same as read from the files. ``floor_m_s``: max|e| of the best input of the fish,
    ``floor_lsq_m_s`` of the best by least squares; ``floor_by`` says of what: the ``identified``
    fish, or the ``simulator`` where nothing was identified; NaN = neither is there. ``noise_m_s``:
    standard deviation of max|e| between repeats with ``noise_freedom`` degrees of freedom, NaN = no
    repeats. ``problems``: what is wrong with the folder, trials that were not straight, and where
    the board began anew; one line each."""

    name: str
    simulated: bool
    board: str
    unique_id: str
    fish: str
    law: str
    reference_name: str
    reference_crc: int
    reference_m_s: F64
    beat_s: float
    amplitude_max_rad: float
    conditions: dict[str, Any]
    rows: list[TrialRow]
    trials: list[Trial]
    band: IterationStatistics
    floor_m_s: float
    floor_lsq_m_s: float
    noise_m_s: float
    start_error_m_s: float  # of the zero input: the reference's largest speed
    problems: list[str] = field(default_factory=list)
    floor_by: str = ""
    noise_freedom: int = 0

    @property
    def epoch(self) -> int:
        """The last one."""
        return max((row.epoch for row in self.rows), default=0)

    @property
    def last_rows(self) -> list[TrialRow]:
        """Those of the last epoch: iterations of two do not go together."""
        return [row for row in self.rows if row.epoch == self.epoch]

    @property
    def best_row(self) -> TrialRow | None:
        """The best of the last epoch (``best_of``); None = none is complete and counts."""
        pairs = self.judged
        best = best_of([score for _, score in pairs])
        return next((row for row, score in pairs if score is best), None)

    @cached_property
    def judged(self) -> list[tuple[TrialRow, Score]]:
        """Those of the last epoch that are complete and count."""
        return [
            (row, score_of(trial))
            for row, trial in zip(self.rows, self.trials, strict=True)
            if row.counts and row.complete and row.epoch == self.epoch
        ]

    @property
    def reference(self) -> Reference:
        """What was to be executed."""
        return Reference(
            self.beat_s, self.reference_m_s.astype(np.float32), self.reference_name or "reference"
        )

    def document(self) -> Any:
        """As plain JSON values, without the trials' samples."""
        held = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "trials"}
        return _rounded(plain({"format": _FORMAT, **held}))


def analyse(experiment: Experiment) -> Analysis:
    """Reads and derives. A raw file that is damaged is left out, and told in ``problems``. Raises
    InputError: no trials."""
    settings = experiment.settings()
    problems = experiment.raw_problems()
    sound, names = _sound_trials(experiment, problems)
    identified = _identified(experiment, problems)
    held, crc = _reference(experiment, [kept.trial for kept in sound], problems)
    histories = histories_of(experiment.journal.entries(), names)
    kept = [
        (one.path, one.trial)
        for one in sound
        if _is_of(one.trial, crc, one.path.name, identified, problems)
    ]
    if not kept:
        raise _no_trials(experiment, problems)
    recorded = [trial for _, trial in kept]
    rows = rows_of(kept, histories, _judges_gaps(settings))
    noise = noise_of(rows, recorded)
    rows = with_noise(rows, *noise)
    limit = recorded[-1].params.get("AMP_MAX_RAD", math.pi / 4)
    bound = _error_bound(identified, settings, held, limit)
    problems += _remarks(str(settings.get("unique_id", "")), rows, recorded, identified)
    return Analysis(
        name=experiment.stable_name,
        simulated=bool(settings.get("simulated"))
        or any(t.board in SIMULATED_FISH for t in recorded),
        board=str(settings.get("board", recorded[-1].board)),
        unique_id=str(settings.get("unique_id", recorded[-1].unique_id)),
        fish=str(settings.get("fish", "")),
        law=str(settings.get("law", "")),
        reference_name=str(settings.get("reference", "")),
        reference_crc=crc,
        reference_m_s=held.speed_m_s.astype(np.float64),
        beat_s=held.beat_s,
        amplitude_max_rad=limit,
        conditions=dict(settings.get("conditions") or {}),
        rows=rows,
        trials=recorded,
        band=_band(rows),
        floor_m_s=bound[0],
        floor_lsq_m_s=bound[1],
        noise_m_s=noise[0],
        start_error_m_s=float(np.max(np.abs(held.speed_m_s))),
        problems=problems,
        floor_by=bound[2],
        noise_freedom=noise[1],
    )


def _remarks(
    unique_id: str, rows: Sequence[TrialRow], trials: Sequence[Trial], identified: Identified | None
) -> list[str]:
    """One line for each trial that was not straight, one when the amplitude limit holds the last
    back, one for each trial of another fish, and one for each time the board began anew."""
    crooked = [
        f"trial {row.trial} has a heading error up to"
        f" {math.degrees(abs(row.straight.worst_yaw_rad)):.0f} degrees:"
        f" the speed along the tank is below the fish's own"
        for row in rows
        if row.straight is not None and row.straight.crooked and row.counts
    ]
    counting = [trial for row, trial in zip(rows, trials, strict=True) if row.counts]
    found = saturation_of(counting[-1], identified, counting) if counting else None
    saturated = [] if found is None else [f"trial {counting[-1].number} is {found.text}"]
    others = [
        f"{row.file} is of another fish ({trial.unique_id})"
        for row, trial in zip(rows, trials, strict=True)
        if unique_id and trial.unique_id and trial.unique_id != unique_id
    ]
    anew = [
        f"the board restarted learning with trial {row.trial} ({row.file}): iterations count from"
        f" {row.iteration} again. Figures and comparisons use the trials since the last restart"
        for before, row in pairwise(rows)
        if row.epoch != before.epoch
    ]
    return [*crooked, *saturated, *others, *anew]


def write_analysis(experiment: Experiment) -> Path:
    """``analysis.json``."""
    path = experiment.folder / ANALYSIS
    write_whole(path, canonical(analyse(experiment).document()))
    return path


def _no_trials(experiment: Experiment, problems: Sequence[str]) -> InputError:
    why = f" that can be read ({problems[0]})" if problems else ""
    return InputError(
        f"{experiment.name} holds no trials{why}.",
        "Run one (tailbeat trial run), or pull one: tailbeat trial pull --into FOLDER",
    )


def _sound_trials(experiment: Experiment, problems: list[str]) -> tuple[list[Kept], dict[str, str]]:
    """The trials, and for each raw file the name of its trial's. Files that were tampered with are
    no data any more."""
    damaged = set(experiment.damaged())
    files = [path for path in experiment.trial_files() if path.name not in damaged]
    found, unread = read_kept(files)
    problems += unread
    problems += [f"{kept.path.name}: {line}" for kept in found for line in kept.trial.problems]
    return found, {name: kept.path.name for kept in found for name in kept.names}


def _identified(experiment: Experiment, problems: list[str]) -> Identified | None:
    """The last one: a fish may be identified anew on the way."""

    files = [str(entry.get("file", "")) for entry in experiment.journal.entries("identified")]
    name = Path(files[-1]).name if files else "identified.json"
    path = experiment.raw / name
    if not path.is_file() or name in experiment.damaged():
        return None
    try:
        return Identified.load(path)
    except InputError as error:
        problems.append(str(error))
        return None


def _reference(
    experiment: Experiment, trials: Sequence[Trial], problems: list[str]
) -> tuple[Reference, int]:
    """The experiment's own and its CRC; in a folder made by hand those of the last trial."""
    name = str(experiment.settings().get("reference", ""))
    path = experiment.raw / "reference.bin"
    if path.is_file() and path.name not in experiment.damaged():
        record = decode_reference(path.read_bytes())
        return Reference(record.beat_s, record.speed_m_s, name), record.crc
    if not trials:
        raise _no_trials(experiment, problems)
    last = trials[-1]
    speed_m_s = np.nan_to_num(last.beats.reference_m_s)
    return Reference(last.beat_s, speed_m_s, name), last.reference_crc


def _is_of(
    trial: Trial,
    crc: int,
    name: str,
    identified: Identified | None,
    problems: list[str],
) -> bool:
    """Whether a trial is of the series: the runs a fish was identified by are not."""
    if trial.reference_crc != crc:
        problems.append(f"{name}: it has another reference; left out")
        return False
    if identified is None or identified.source != "runs":
        return True

    return swim_crc(trial_speeds(trial)) not in {swim_crc(one) for one in identified.trials}


def _judges_gaps(settings: Mapping[str, Any]) -> bool:
    """Whether trials with missing beats are judged; not in a folder that an older tool made, whose
    ``analysis.json`` must come out as it was. A folder made by hand is judged as one made now."""
    return "made" not in settings or settings.get("judging", 0) == JUDGING


def _band(rows: Sequence[TrialRow]) -> IterationStatistics:
    last = max((row.epoch for row in rows), default=0)
    counting = [row for row in rows if row.counts and row.complete and row.epoch == last]
    iterations = sorted({row.iteration for row in counting})
    groups = [[row for row in counting if row.iteration == i] for i in iterations]
    columns: list[F64] = []
    for name in ("max_abs_error_m_s", "rms_error_m_s"):
        values = [np.percentile([getattr(r, name) for r in group], _BAND) for group in groups]
        columns += list(np.array(values, dtype=np.float64).reshape(-1, len(_BAND)).T)
    counts = [len(group) for group in groups]
    return IterationStatistics(
        np.array(iterations, dtype=np.int64), np.array(counts, dtype=np.int64), *columns
    )


_Simulator = tuple[str, tuple[tuple[str, float], ...]]  # a plant and its settings


def _error_bound(
    identified: Identified | None, settings: Mapping[str, Any], held: Reference, limit: float
) -> tuple[float, float, str]:
    """(smallest max|e|, max|e| of the least-squares input, of what), without the digits that are
    another processor's own."""
    beats = held.beat_s, held.speed_m_s.tobytes()
    if identified is not None:
        return *_both_bounds(identified.model, *beats, limit), "identified"
    plant, simulator = settings.get("plant"), settings.get("simulator")
    if plant and isinstance(simulator, dict):
        values = sorted((n, v) for n, v in simulator.items() if n not in ("seed", "plant"))
        with contextlib.suppress(InputError):  # one of another version had other settings
            return *_both_bounds((str(plant), tuple(values)), *beats, limit), "simulator"
    return math.nan, math.nan, ""


@lru_cache(maxsize=16)
def _both_bounds(
    fish: FishModel | _Simulator, beat_s: float, speeds: bytes, limit: float
) -> tuple[float, float]:
    """Kept, as a page asks for the same ones after every trial, and a simulator's take seconds."""
    held = Reference(beat_s, np.frombuffer(speeds, dtype=np.float32), "")
    plant = fish if isinstance(fish, FishModel) else plant_config(fish[0], dict(fish[1]))
    found = error_bound(plant, held, limit)
    return (
        round_to(found.minimax_m_s, _BOUND_DIGITS),
        round_to(found.lsq_max_abs_m_s, _BOUND_DIGITS),
    )


def round_to(value: float, digits: int = _DIGITS) -> float:
    """That many digits; NaN stays."""
    return float(f"{value:.{digits}g}")


def _rounded(value: Any) -> Any:
    """Plain values with floats of nine digits."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return round_to(value) if isinstance(value, float) else value


WATER_TEMPERATURE = "water_temperature_degc"
WORDS = ("operator", "configuration")
_KEY = re.compile(r"[a-z][a-z0-9_]*\Z")
_TEMPERATURE_DEGC = (0.0, 45.0)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\Z")

Conditions = dict[str, str | float]


def parse_conditions(pairs: Sequence[str], water_degc: float | None = None) -> Conditions:
    """``["salinity_psu=0.3", "wall=glass"]`` to values: numbers where they are numbers. Raises
    InputError."""
    found: Conditions = {}
    for pair in pairs:
        key, equals, text = (part.strip() for part in pair.partition("="))
        if not equals or not text or not _KEY.match(key):
            raise InputError(
                f"'{pair}' is no condition.",
                "Write it like water_depth_m=0.35: small letters, the unit in the name, a value.",
            )
        if key in found:
            raise InputError(f"{key} is given twice.", "Give it once.")
        found[key] = float(text) if _NUMBER.match(text) else text
    if water_degc is not None and found.setdefault(WATER_TEMPERATURE, water_degc) != water_degc:
        raise InputError(f"{WATER_TEMPERATURE} is given twice.", "Give it once.")
    _check_temperature(found.get(WATER_TEMPERATURE))
    return found


def _check_temperature(value: str | float | None) -> None:
    low, high = _TEMPERATURE_DEGC
    if value is None or (
        isinstance(value, float) and math.isfinite(value) and low <= value <= high
    ):
        return
    raise InputError(
        f"water of {value} degrees Celsius is out of range.",
        f"Give {low:g} to {high:g} degrees Celsius.",
    )


def set_conditions(
    experiment: Experiment, conditions: Conditions, words: dict[str, str] | None = None
) -> None:
    """What turns out later. The settings hold what is so now, the journal what was so when; it is
    written first. Raises InputError."""
    words = words or {}
    more: dict[str, Any] = dict(words)
    if not conditions and not words:
        raise InputError("nothing to set.", "Give --condition KEY=VALUE or --water-temp C.")
    settings = experiment.settings()
    held = settings.get("conditions", {})
    before = {key: held.get(key) for key in conditions}
    before |= {key: settings.get(key) for key in words}
    experiment.journal.add("set", conditions=conditions, before=before, **more)
    experiment.write_settings({"conditions": {**held, **conditions}, **words})
