"""Before an erase: may the board be flashed, and everything that it holds, to the disk."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tailbeat.board.fish import Fish
from tailbeat.board.provision import MISSING, trust_of
from tailbeat.board.snapshot import Snapshot, new_folder
from tailbeat.core import records
from tailbeat.core.errors import InputError
from tailbeat.link.messages import TrialFile

OnStep = Callable[[float, str], None]

_QUIET_STATES = ("IDLE", "ABORTED", "FAULT")
_NO_BATTERY_V = 1.0  # a board on USB power alone measures next to nothing


@dataclass(frozen=True)
class BackupPlaces:
    """Where backups go. ``root``: each gets a folder of its own below it. ``known``: folders whose
    trials need not be pulled again. ``add``: takes a trial that was pulled, and tells its place."""

    root: Path = Path("backups")
    known: Sequence[Path] = ()
    add: Callable[[Path], Path] = lambda path: path


@dataclass(frozen=True)
class Backup:
    """Where the board's content is now."""

    folder: Path
    snapshot: Snapshot
    trials: list[Path]  # pulled now; those that had been pulled before are not in it


def back_up(fish: Fish, places: BackupPlaces, on_step: OnStep) -> Backup:
    """Saves the board's content in a new folder and pulls the trials that are not known yet.
    Nothing changes on the board."""
    info = fish.info()
    folder = new_folder(places.root, info.unique_id)
    on_step(0.0, "saving parameters, reference and learned input")
    held = replace(Snapshot.take(fish, fish.params.values(), info), crash=fish.crash_record())
    held.write(folder)
    return Backup(folder, held, _pull_trials(fish, places, folder / "trials", on_step))


def require_quiet(fish: Fish, wipes: bool) -> None:
    """Raises InputError while flashing would do harm. ``wipes``: stored data will be lost."""
    status = fish.status()
    if status.state not in _QUIET_STATES:
        raise InputError(
            f"the board is {status.state}; it is not flashed while the tail may move",
            "Stop it first: tailbeat board disarm",
        )
    critical_v = fish.params.get("BATT_CRIT_V").value
    if _NO_BATTERY_V < status.battery_v < critical_v:
        raise InputError(
            f"the battery is at {status.battery_v:.2f} V, below BATT_CRIT_V ({critical_v:g} V)."
            " A board that loses power while it is flashed has no firmware",
            "Charge or unplug the battery.",
        )
    if wipes and status.pending_trial is not None:
        raise InputError(
            f"trial {status.pending_trial} was executed but not learned from, and that cannot be"
            " put back onto the board",
            "Finish it first: tailbeat trial learn, or tailbeat trial discard",
        )


def key_warning(fish: Fish) -> str | None:
    """What to know before the board's key is erased; None when it comes back, or there is none."""
    if trust_of(fish) != MISSING:
        return None
    return (
        "the board has a key that this computer does not have. Flashing erases it: then anyone in"
        " Bluetooth range can move its tail"
    )


def _pull_trials(fish: Fish, places: BackupPlaces, folder: Path, on_step: OnStep) -> list[Path]:
    """Every trial that is not known yet, byte for byte."""
    found = fish.trials()
    total = sum(trial.size_bytes for trial in found) or 1
    pulled, done = [], 0
    for trial in found:
        on_step(done / total, f"pulling trial {trial.number}")
        if not _is_known(fish, trial, places.known):
            pulled.append(places.add(fish.pull_trial(trial.number, folder)))
        done += trial.size_bytes
    return pulled


def _is_known(fish: Fish, trial: TrialFile, known: Sequence[Path]) -> bool:
    """Whether one of ``known`` holds exactly this trial; other fish number theirs alike."""
    paths = [folder / f"{trial.number:04d}.ulg" for folder in known]
    same_size = [p for p in paths if p.is_file() and p.stat().st_size == trial.size_bytes]
    if not same_size:
        return False
    crc = fish.ftp.crc32(trial.path)
    return any(records.crc32(path.read_bytes()) == crc for path in same_size)
