"""From the board to the disk: everything that an erase would take away."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tailbeat import records
from tailbeat.errors import InputError, TailbeatError
from tailbeat.experiment import Experiment, list_experiments
from tailbeat.fish import Fish
from tailbeat.flashing.backup import Backup, new_folder
from tailbeat.provision import MISSING, trust_of
from tailbeat.results import TrialFile

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
