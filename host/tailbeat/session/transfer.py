"""What was learned along a reference: as a board holds it, and as trial files tell it.

A reference like an old one, and what was learned along that, onto a connected board.

A board forgets what it had learned when another reference arrives. So a copy of that is on the disk
before, in the fish's trial library, and beside it the CRC of the reference that comes: when the
link drops between the two uploads, the same command finds the board with the new reference and
nothing learned, and takes the copy.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.board.fish import Fish
from tailbeat.board.preserve import require_idle
from tailbeat.board.snapshot import Snapshot, new_folder
from tailbeat.core.arrays import F32
from tailbeat.core.errors import InputError
from tailbeat.core.files import write_whole
from tailbeat.core.records import (
    INPUT_FIRST,
    INPUT_UPLOADED,
    decode_learned,
    decode_reference,
    record_crc,
)
from tailbeat.core.reference import Reference, ReferenceLimits
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.experiment.current import named_reference
from tailbeat.experiment.folder import list_experiments
from tailbeat.experiment.library import TrialLibrary
from tailbeat.learning.convergence import best_of, score_of
from tailbeat.learning.fish_model import FishModel
from tailbeat.learning.identification import Identified
from tailbeat.learning.transfer import TOLERANCE, Similarity, Transferred, similarity, transfer
from tailbeat.session.identify import MODEL_PARAMS

_NOTHING = "Leave out --warm-start, and the fish learns afresh; or name a trial or an experiment."


@dataclass(frozen=True)
class LearnedInput:
    """``amplitude_rad``: float32, one per beat of ``reference``. ``words``: where it comes from.
    ``max_abs_error_m_s``: of the trial that swam it; ``travel_m``: how far it came; None = not
    known. ``unique_id``: of its fish; empty = not known."""

    reference: Reference
    amplitude_rad: F32
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


def of_records(reference: bytes | None, learned: bytes | None, where: str) -> LearnedInput:
    """The best of what a board holds, or held; without a best what swims next. Raises InputError
    when it has learned nothing."""
    if reference is None or learned is None or not has_learned(learned):
        raise InputError(f"{where} has learned nothing along its reference yet.", _NOTHING)
    wanted, held = decode_reference(reference), decode_learned(learned)
    best = held.best_iteration > 0
    words = f"{where}, iteration {held.best_iteration if best else held.iteration}"
    return LearnedInput(
        reference=Reference(wanted.beat_s, wanted.speed_m_s, f"{wanted.crc:08x}"),
        amplitude_rad=held.best_rad if best else held.amplitude_rad,
        words=words,
        max_abs_error_m_s=held.best_max_abs_error_m_s if best else None,
    )


def of_backup(folder: Path) -> LearnedInput:
    """Of a copy that ``tailbeat board flash`` or an earlier --warm-start made."""
    backup = Snapshot.read(folder)
    return of_records(backup.reference, backup.learned, f"the copy {folder.name}")


def of_trials(trials: Iterable[Trial], where: str, crc: int | None = None) -> LearnedInput:
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
            "Swim and learn along the old reference first, or leave out --warm-start.",
        )
    wanted = judged[-1][0].reference_crc if crc is None else crc
    alike = [one for one in judged if one[0].reference_crc == wanted]
    score = best_of([found for _, found in alike])
    best = next(trial for trial, found in alike if found is score)
    reference = Reference(best.beat_s, best.beats.reference_m_s, f"{best.reference_crc:08x}")
    return LearnedInput(
        reference=reference,
        amplitude_rad=best.beats.applied_rad,
        words=f"trial {best.number} of {where}",
        max_abs_error_m_s=best.max_abs_error_m_s(),
        travel_m=_travel_m(best),
        unique_id=best.unique_id,
    )


def of_folder(folder: Path) -> LearnedInput:
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


BOARD = "board"
COPIES = "learned"  # below the trial library
_NEXT = "next-reference.txt"
_ROUNDING = 1e-9


@dataclass(frozen=True)
class TransferPlan:
    """``travel_m``: how far the fish is expected to come: as far as the old trial, or reference,
    scaled, less what the limit takes. ``model_of``: ``identified`` or ``board``. ``swims_it``: the
    board has the new reference already, with nothing learned along it."""

    learned: LearnedInput
    new: Reference
    by: Similarity
    transferred: Transferred
    travel_m: float
    model_of: str
    swims_it: bool = False

    def as_dict(self) -> dict[str, Any]:
        """SI units; what ``--json`` prints of it."""
        return {
            "from": self.learned.words,
            "old_reference": self.learned.reference.name,
            "old_max_abs_error_m_s": self.learned.max_abs_error_m_s,
            "magnitude": self.by.magnitude,
            "time_factor": self.by.time_factor,
            "residual_m_s": self.by.residual_m_s,
            "saturated_beats": self.transferred.saturated_beats,
            "expected_travel_m": self.travel_m,
            "model": self.model_of,
            "amplitude_rad": self.transferred.amplitude_rad,
        }


def plan(
    fish: Fish,
    like: str,
    new: Reference,
    identified: Identified | None = None,
    book: TrialLibrary | None = None,
    experiments: Path = Path("experiments"),
) -> TransferPlan:
    """What would be uploaded; changes nothing. ``like``: ``board``, a trial's file, a folder of
    them (an experiment), a copy of a board, or a reference, whose best trial is looked for on the
    board, in the trial library and in ``experiments``. ``identified`` None: by the board's MDL_...

    Raises InputError: the board is not ready, has learned along ``new`` already, or nothing was
    learned along the old one; the two are not alike; the fish would swim farther than the tank is
    long."""
    state = _state(fish, new)
    learned = _learned(fish, like, new, state, book, experiments)
    by = similarity(learned.reference, new)
    if not by.alike:
        raise InputError(
            f"{new.name} is no scaled copy of the reference that was learned "
            f"({_shape(learned.reference)}). The best fit misses by "
            f"{by.residual_m_s * 1e3:.1f} mm/s, {by.residual_m_s / by.peak_m_s:.0%} of its "
            f"largest speed; {TOLERANCE:.0%} are allowed.",
            "Scale speed and time of the old reference only, or leave out --warm-start.",
        )
    params = fish.params.values()
    transferred = transfer(
        learned.amplitude_rad,
        learned.reference,
        new,
        by,
        _model(identified, params),
        params["AMP_MAX_RAD"],
    )
    old_m = learned.reference.travel_m if learned.travel_m is None else learned.travel_m
    travel_m = by.magnitude / by.time_factor * old_m * transferred.share
    _require_room(travel_m, ReferenceLimits.from_params(params))
    model_of = "identified" if identified is not None else "board"
    return TransferPlan(learned, new, by, transferred, travel_m, model_of, state.swims_it)


def upload_transfer(
    fish: Fish,
    found: TransferPlan,
    book: TrialLibrary | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path | None:
    """Uploads the reference, then the amplitudes; where the copy is of what the board had learned,
    None when it had nothing or there is no trial library. Repeating it after a broken link is
    safe."""
    copy = None
    if not found.swims_it and book is not None:
        copy = _copied(fish, book.folder / COPIES, found.new.crc)
    fish.upload_reference(found.new.record(), progress)
    fish.upload_amplitudes(found.transferred.amplitude_rad)
    return copy


@dataclass(frozen=True)
class _State:
    reference: bytes | None
    learned: bytes | None
    swims_it: bool


def _state(fish: Fish, new: Reference) -> _State:
    status = require_idle(fish, "upload")
    reference, learned = fish.reference_record(), fish.learned_record()
    swims_it = status.reference_crc == new.crc
    if swims_it and not _is_fresh(learned):
        raise InputError(
            f"the board has learned along {new.name} already (iteration {status.iteration}).",
            "Go on with that, or use its best input next: tailbeat trial learn --restore-best.",
        )
    return _State(reference, learned, swims_it)


def _is_fresh(learned: bytes | None) -> bool:
    """Nothing was learned yet: no amplitudes, the first guess, or uploaded ones."""
    if not has_learned(learned):
        return True
    assert learned is not None
    held = decode_learned(learned)
    return held.iteration <= 1 and held.best_iteration == 0 and held.input == INPUT_UPLOADED


def _learned(
    fish: Fish,
    like: str,
    new: Reference,
    state: _State,
    book: TrialLibrary | None,
    experiments: Path,
) -> LearnedInput:
    if like == BOARD:
        if state.swims_it:
            return _left(fish, new, book)
        return of_records(state.reference, state.learned, "the board")
    path = Path(like)
    if path.is_dir():
        return of_folder(path)
    if path.suffix == ".ulg":
        return of_trials([read_trial(path)], path.name)
    return _along(fish, like, state, book, experiments)


def _left(fish: Fish, new: Reference, book: TrialLibrary | None) -> LearnedInput:
    """The copy that was made before ``new`` came; the last, when there are some."""
    root = book.folder / COPIES if book is not None else None
    for folder in sorted(root.iterdir(), reverse=True) if root and root.is_dir() else []:
        try:
            meant = (folder / _NEXT).read_text(encoding="ascii").strip()
            if meant == f"{new.crc:#010x}":
                return of_backup(folder)
        except (OSError, ValueError, InputError):
            continue
    raise InputError(
        f"the board has {new.name} already, and of what it learned before there is no copy here.",
        "Name a trial, an experiment or a copy with --warm-start.",
    )


def _along(
    fish: Fish, text: str, state: _State, book: TrialLibrary | None, experiments: Path
) -> LearnedInput:
    """A reference by name or CSV."""

    try:
        old = named_reference(text)
    except InputError as error:
        raise InputError(
            f"'{text}' is nothing to learn from.",
            "After --warm-start give 'board', a trial's .ulg, a reference that was learned, or the "
            "folder of an experiment or copy.",
        ) from error
    held = state.reference is not None and record_crc(state.reference) == old.crc
    if held and has_learned(state.learned):
        return of_records(state.reference, state.learned, "the board")
    unique_id = fish.unique_id()
    kept = [one.trial for one in book.kept()[0] if not one.mark] if book is not None else []
    for experiment in list_experiments(experiments):
        if _is_along(experiment.raw / "reference.bin", old.crc):
            kept += [trial for trial in experiment.trials() if trial.unique_id == unique_id]
    return of_trials(kept, f"this fish along {old.name}", old.crc)


def _shape(reference: Reference) -> str:
    peak_m_s = float(reference.speed_m_s.max())
    return f"{len(reference.speed_m_s)} beats, up to {peak_m_s * 1e3:.1f} mm/s"


def _is_along(path: Path, crc: int) -> bool:
    try:
        return record_crc(path.read_bytes()) == crc
    except (OSError, InputError):
        return False


def _model(identified: Identified | None, params: dict[str, float]) -> FishModel:
    if identified is not None:
        return identified.model
    model = FishModel(**{field: params[name] for name, field in MODEL_PARAMS.items()})
    if model.slope_m_s_rad <= 0:
        raise InputError(
            "MDL_SLOPE is 0: thrust says nothing of amplitude.",
            "Identify the fish (tailbeat session identify), or set MDL_SLOPE.",
        )
    return model


def _require_room(travel_m: float, limits: ReferenceLimits) -> None:
    room_m = limits.tank_m - limits.fish_m
    if limits.tank_m > 0 and travel_m > room_m + _ROUNDING:
        raise InputError(
            f"by what was learned the fish would travel {travel_m:.2f} m, and the tank clearance"
            f" is {room_m:.2f} m.",
            "Shorten or slow the reference, or correct TANK_LEN_M (0 = not checked).",
        )


def _copied(fish: Fish, root: Path, next_crc: int) -> Path | None:
    """On the disk when this returns; ``next-reference.txt`` last, without it nothing is taken
    from the copy unasked."""
    learned = fish.learned_record()
    if not has_learned(learned):
        return None
    info = fish.info()
    folder = new_folder(root, info.unique_id)
    Snapshot(
        unique_id=info.unique_id,
        build_id=info.build_id,
        params={},
        next_trial=info.status.next_trial,
        reference=fish.reference_record(),
        learned=learned,
    ).write(folder)
    write_whole(folder / _NEXT, f"{next_crc:#010x}\n")
    return folder
