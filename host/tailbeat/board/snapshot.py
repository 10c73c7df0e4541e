"""What a board held, in a folder on disk.

``board.json`` (who it was, and its parameters), ``reference.bin``, ``learned.bin``, ``crash.bin``;
the records are those of docs/protocol.md. Trials pulled on the way lie in ``trials/`` unless they
went elsewhere.

From the board to the disk: everything that an erase would take away.

The copy of what a board held before an identification: on the disk until the board has it back.

Beside the records of a backup lies ``references.txt``, the CRC of every reference that the runs
gave the board: by it a later identification knows whether an earlier one was broken off.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from tailbeat.board.fish import Fish
from tailbeat.board.provision import MISSING, trust_of
from tailbeat.core import records
from tailbeat.core.errors import InputError, TailbeatError, reason
from tailbeat.core.files import replace_file, sync_folder
from tailbeat.core.param_names import with_current_names
from tailbeat.experiment.folder import Experiment, list_experiments
from tailbeat.link.messages import TrialFile

_BOARD = "board.json"
_FORMAT = "tailbeat backup 1"
_RECORDS = ("reference", "learned", "crash")


@dataclass(frozen=True)
class Backup:
    """The content of a board. Records are bytes as in docs/protocol.md; None = it had none.

    ``signed``: it had a key. The key itself is not in it: no board gives it away."""

    unique_id: str
    build_id: str
    params: dict[str, float]
    next_trial: int
    reference: bytes | None = None
    learned: bytes | None = None
    crash: bytes | None = None
    signed: bool = False
    made: str = field(default="", compare=False)

    def write(self, folder: Path) -> None:
        """Puts all of it on the disk itself before returning, and reads it back to be sure."""
        folder.mkdir(parents=True, exist_ok=True)
        for name in _RECORDS:
            record = getattr(self, name)
            if record is not None:
                replace_file(folder / f"{name}.bin", record)
        replace_file(folder / _BOARD, json.dumps(self._document(), indent=2).encode() + b"\n")
        if Backup.read(folder) != self:
            raise InputError(
                f"the backup in {folder} differs from what was written",
                "Use another disk: --out FOLDER",
            )

    def _document(self) -> dict[str, Any]:
        return {
            "format": _FORMAT,
            "made": self.made or datetime.now().astimezone().isoformat(timespec="seconds"),
            "unique_id": self.unique_id,
            "build_id": self.build_id,
            "next_trial": self.next_trial,
            "params": self.params,
            "signed": self.signed,
            "records": [name for name in _RECORDS if getattr(self, name) is not None],
        }

    @classmethod
    def read(cls, folder: Path) -> Backup:
        """The backup in ``folder``. Raises InputError when it is none, or incomplete."""
        try:
            document = json.loads((folder / _BOARD).read_text(encoding="utf-8"))
            if document["format"] != _FORMAT:
                raise ValueError(f"its format is {document['format']!r}")
            records = {
                name: (folder / f"{name}.bin").read_bytes()
                for name in document["records"]
                if name in _RECORDS
            }
            return cls(
                unique_id=str(document["unique_id"]),
                build_id=str(document["build_id"]),
                params=with_current_names(
                    {str(name): float(v) for name, v in document["params"].items()}
                ),
                next_trial=int(document["next_trial"]),
                signed=bool(document.get("signed", False)),
                made=str(document["made"]),
                **records,
            )
        except OSError as error:
            why = f"cannot read {error.filename or folder} ({reason(error)})"
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            why = f"{folder / _BOARD} is damaged ({error})"
        raise InputError(
            f"{folder} is no backup of a board: {why}",
            "Give the folder that tailbeat flash made; it holds board.json.",
        )


def new_folder(root: Path, unique_id: str, now: datetime | None = None) -> Path:
    """Makes ``root/DATE_TIME_ID``, ID being the beginning of the unique id; never an old one."""
    stamp = (now or datetime.now()).strftime("%Y-%m-%d_%H%M%S")
    for number in range(1, 100):
        suffix = "" if number == 1 else f"_{number}"
        folder = root / f"{stamp}_{unique_id[:8]}{suffix}"
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        return folder
    raise InputError(f"{root} holds 99 backups of this second", "Use another folder: --out FOLDER")


OnStep = Callable[[float, str], None]

EXPERIMENTS = Path("experiments")
_QUIET_STATES = ("IDLE", "ABORTED", "FAULT")
_NO_BATTERY_V = 1.0  # a board on USB power alone measures next to nothing


@dataclass(frozen=True)
class Kept:
    """Where the board's content is now."""

    folder: Path
    backup: Backup
    trials: list[Path]  # pulled now; those that had been pulled before are not in it


def keep(fish: Fish, out: Path, on_step: OnStep, experiments: Path = EXPERIMENTS) -> Kept:
    """Saves the board's content in a new folder below ``out`` and pulls the trials that are in no
    experiment yet. ``out`` may be an experiment's folder: the trials then join its raw files.
    Nothing changes on the board."""
    info = fish.info()
    folder = new_folder(_root(out), info.unique_id)
    on_step(0.0, "saving parameters, reference and learned input")
    backup = Backup(
        unique_id=info.unique_id,
        build_id=info.build_id,
        params={name: p.value for name, p in fish.params.list().items()},
        next_trial=info.status.next_trial,
        reference=fish.reference_record(),
        learned=fish.learned_record(),
        crash=fish.crash_record(),
        signed=bool(fish.link.signing.signs),
    )
    backup.write(folder)
    trials = _pull_trials(fish, out, folder / "trials", experiments, on_step)
    return Kept(folder, backup, trials)


def require_quiet(fish: Fish, wipes: bool) -> None:
    """Raises InputError while flashing would do harm. ``wipes``: stored data will be lost."""
    status = fish.status()
    if status.state not in _QUIET_STATES:
        raise InputError(
            f"the board is {status.state}; it is not flashed while the tail may move",
            "Stop it first: tailbeat disarm",
        )
    critical_v = fish.params.get("BATT_CRIT_V").value
    if _NO_BATTERY_V < status.battery_v < critical_v:
        raise InputError(
            f"the battery is at {status.battery_v:.2f} V, below BATT_CRIT_V ({critical_v:g} V);"
            " a board that loses power while it is flashed has no firmware",
            "Charge or unplug the battery.",
        )
    if wipes and status.pending_trial is not None:
        raise InputError(
            f"trial {status.pending_trial} was swum but not learned from, and that cannot be put"
            " back onto the board",
            "Finish it first: tailbeat learn, or tailbeat trial discard",
        )


def key_warning(fish: Fish) -> str | None:
    """What to know before the board's key is erased; None when it comes back, or there is none."""
    if trust_of(fish) != MISSING:
        return None
    return (
        "the board has a key that this computer has not: after flashing it has none, and anyone in"
        " radio range can move its tail"
    )


def _root(out: Path) -> Path:
    return out / "backups" if _is_experiment(out) else out


def _is_experiment(folder: Path) -> bool:
    return (folder / "settings.json").is_file()


def _pull_trials(
    fish: Fish, out: Path, folder: Path, experiments: Path, on_step: OnStep
) -> list[Path]:
    """Every trial that is neither in ``out`` nor in an experiment, byte for byte."""
    found = fish.trials()
    total = sum(trial.size_bytes for trial in found) or 1
    places = [e.raw for e in list_experiments(experiments)] + [Experiment(out).raw, out]
    pulled, done = [], 0
    for trial in found:
        on_step(done / total, f"pulling trial {trial.number}")
        if not _have(fish, trial, places):
            pulled.append(_file(fish.pull_trial(trial.number, folder), out))
        done += trial.size_bytes
    return pulled


def _have(fish: Fish, trial: TrialFile, places: list[Path]) -> bool:
    """Whether one of ``places`` holds exactly this trial; other fish number theirs alike."""
    name = f"{trial.number:04d}.ulg"
    same_size = [
        place / name
        for place in places
        if (place / name).is_file() and (place / name).stat().st_size == trial.size_bytes
    ]
    if not same_size:
        return False
    crc = fish.ftp.crc32(trial.path)
    return any(records.crc32(path.read_bytes()) == crc for path in same_size)


def _file(path: Path, out: Path) -> Path:
    """Into the experiment's raw files if ``out`` is one and the number is free there."""
    if not _is_experiment(out):
        return path
    try:
        kept = Experiment(out).add_raw(path.name, path.read_bytes())
    except TailbeatError:
        return path
    path.unlink()
    return kept


_REFERENCES = "references.txt"
_ASIDE_MAX = 999


def put_safe(safe: Path, now: Backup, note: Callable[[str], None]) -> None:
    """Writes a copy of ``now``, what the board holds. One that is there already is set aside, never
    overwritten. ``note``: told what a person should know."""
    if (safe / _BOARD).exists():
        aside = _aside(safe)
        note(f"an older copy of what the board held is kept in {aside} (tailbeat flash --restore)")
    (safe / _REFERENCES).unlink(missing_ok=True)
    now.write(safe)


def left_in(safe: Path) -> Backup | None:
    """The copy in there; None = no whole one."""
    try:
        return Backup.read(safe)
    except InputError:
        return None


def note_reference(safe: Path, crc: int) -> None:
    """To be called before the board gets a reference of a run. Lasting when it returns."""
    with (safe / _REFERENCES).open("a", encoding="ascii") as file:
        file.write(f"{crc:#010x}\n")
        file.flush()
        os.fsync(file.fileno())
    sync_folder(safe)


def is_of_a_run(safe: Path | None, crc: int | None) -> bool:
    """Whether a broken-off identification gave the board the reference ``crc``."""
    if safe is None or crc is None or not (safe / _BOARD).is_file():
        return False
    try:
        return f"{crc:#010x}" in (safe / _REFERENCES).read_text(encoding="ascii").split()
    except (OSError, ValueError):
        return False


def forget(safe: Path) -> None:
    """The board has it back. ``board.json`` goes first: without it the rest is no copy."""
    (safe / _BOARD).unlink(missing_ok=True)
    shutil.rmtree(safe, ignore_errors=True)


def _aside(safe: Path) -> Path:
    for number in range(1, _ASIDE_MAX):
        aside = safe.with_name(f"{safe.name}-{number}")
        if not aside.exists():
            safe.rename(aside)
            sync_folder(safe.parent)
            return aside
    raise InputError(f"{safe.parent} is full of copies.", "Take the older ones away.")
