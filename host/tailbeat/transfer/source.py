"""What was learned along a reference: as a board holds it, and as trial files tell it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat.errors import InputError
from tailbeat.flashing.backup import Backup
from tailbeat.records import decode_learned, decode_reference
from tailbeat.reference import Reference
from tailbeat.trial_log import Trial, read_trial
from tailbeat.verdict import best_of, score_of

INPUT_LAW, INPUT_FIRST, INPUT_UPLOADED, INPUT_RESTORED = range(4)  # memory_input_t
_NOTHING = "Leave out --like, and the fish learns afresh; or name a trial or an experiment."


@dataclass(frozen=True)
class Learned:
    """``amplitude_rad``: float32, one per beat of ``reference``. ``words``: where it comes from.
    ``max_abs_error_m_s``: of the trial that swam it; ``travel_m``: how far it came; None = not
    known. ``unique_id``: of its fish; empty = not known."""

    reference: Reference
    amplitude_rad: NDArray[np.float32]
    words: str
    max_abs_error_m_s: float | None = None
    travel_m: float | None = None
    unique_id: str = ""


def has_learned(record: bytes | None) -> bool:
    """Whether a learned record (None = there is none) holds more than the first guess."""
    if record is None:
        return False
    held = decode_learned(record)
    return held.best_iteration > 0 or (held.iteration > 0 and held.input != INPUT_FIRST)


def of_records(reference: bytes | None, learned: bytes | None, where: str) -> Learned:
    """The best of what a board holds, or held; without a best what swims next. Raises InputError
    when it has learned nothing."""
    if reference is None or learned is None or not has_learned(learned):
        raise InputError(f"{where} has learned nothing along its reference yet.", _NOTHING)
    wanted, held = decode_reference(reference), decode_learned(learned)
    best = held.best_iteration > 0
    words = f"{where}, iteration {held.best_iteration if best else held.iteration}"
    return Learned(
        reference=Reference(wanted.beat_s, wanted.speed_m_s, f"{wanted.crc:08x}"),
        amplitude_rad=held.best_rad if best else held.amplitude_rad,
        words=words,
        max_abs_error_m_s=held.best_max_abs_error_m_s if best else None,
    )


def of_backup(folder: Path) -> Learned:
    """Of a copy that ``tailbeat flash`` or an earlier --like made."""
    backup = Backup.read(folder)
    return of_records(backup.reference, backup.learned, f"the copy {folder.name}")


def of_trials(trials: Iterable[Trial], where: str, crc: int | None = None) -> Learned:
    """The best of the trials that are judged; of several references ``crc``, or that of the last
    such trial. Raises InputError when there is none."""
    known = list(trials)
    if not known:
        raise InputError(
            f"{where} holds no trial files.", "Name the folder of an experiment, or one with *.ulg."
        )
    judged = [(trial, score_of(trial)) for trial in known if crc in (None, trial.reference_crc)]
    judged = [one for one in judged if one[1].judged and _is_known(one[0])]
    if not judged:
        raise InputError(
            f"{where} has no whole trial"
            + (" along that reference" if crc is not None else "")
            + ": executed to its end, with the speeds of 80 % of its beats.",
            "Swim and learn along the old reference first, or leave out --like.",
        )
    wanted = judged[-1][0].reference_crc if crc is None else crc
    alike = [one for one in judged if one[0].reference_crc == wanted]
    score = best_of([found for _, found in alike])
    best = next(trial for trial, found in alike if found is score)
    reference = Reference(best.beat_s, best.beats.reference_m_s, f"{best.reference_crc:08x}")
    return Learned(
        reference=reference,
        amplitude_rad=best.beats.applied_rad,
        words=f"trial {best.number} of {where}",
        max_abs_error_m_s=best.max_abs_error_m_s(),
        travel_m=_travel_m(best),
        unique_id=best.unique_id,
    )


def of_file(path: Path) -> Learned:
    """A trial's file. Raises InputError."""
    return of_trials([read_trial(path)], path.name)


def of_folder(folder: Path) -> Learned:
    """An experiment, a folder with trial files, or a copy of a board. Raises InputError."""
    if (folder / "board.json").is_file():
        return of_backup(folder)
    files = sorted(folder.glob("raw/*.ulg")) or sorted(folder.glob("*.ulg"))
    return of_trials(map(read_trial, files), folder.name)


def _is_known(trial: Trial) -> bool:
    beats = trial.beats
    return bool(np.isfinite(beats.applied_rad).all() and np.isfinite(beats.reference_m_s).all())


def _travel_m(trial: Trial) -> float:
    """A beat without a speed counts with its reference."""
    beats = trial.beats
    speed = np.where(np.isfinite(beats.speed_m_s), beats.speed_m_s, beats.reference_m_s)
    return float(np.sum(speed, dtype=np.float64)) * trial.beat_s
