"""trial pull, show, speeds, discard."""

from __future__ import annotations

import contextlib
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import typer

from tailbeat.app.cli._fish import Connect, ConnectedFish, connected
from tailbeat.app.cli._kept import discard_and_keep, keep_in_library, pull_with_bar
from tailbeat.app.cli._lazy import arg, opt
from tailbeat.app.cli._options import sound_identified
from tailbeat.app.cli._terminal import TRIAL_MAX, Output, lines_of, table
from tailbeat.board.fish import Fish
from tailbeat.core.csv import read_speeds
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.files import plain
from tailbeat.core.printable import mm
from tailbeat.core.records import decode_reference
from tailbeat.core.speed_estimate import NothingToRecompute, recomputed
from tailbeat.core.speed_source import speed_source
from tailbeat.core.trial_checks import heading_drift, not_reached
from tailbeat.core.trial_file import Trial, beats_csv, read_trial
from tailbeat.experiment.current import require_fish
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import DISCARDED, library_of
from tailbeat.learning.saturation import Saturation, saturation_of

_SAME = "recomputed: the same speeds and sigmas, bit for bit"

_SPEED_SIGMA_M_S = 0.001  # of speeds that come without one

Number = Annotated[int | None, arg("Default: the last one.", "TRIAL", min=1, max=TRIAL_MAX)]


def pull(
    number: Number = None,
    every: bool = opt("All trials on the board.", name="--all"),
    into: Path = opt("A folder, or an experiment's folder.", default=Path()),
    connect: Connect = None,
) -> Output:
    """Copy logs from the board. An interrupted copy continues where it stopped.

    Example: tailbeat trial pull 3 --into experiments/2026-05-04_fish_thesis_p4_01
    """
    into.mkdir(parents=True, exist_ok=True)
    with connected(connect) as fish:
        numbers = [t.number for t in fish.trials()] if every else [_which(fish, number)]
        paths = [_pull(fish, one, into) for one in numbers]
        for path in paths:
            keep_in_library(fish, path)
    return Output({"files": paths}, "\n".join(map(str, paths)) or "no trials on the board")


def _which(fish: Fish, number: int | None) -> int:
    if number is not None:
        return number
    found = fish.trials()
    if not found:
        raise InputError("there are no trials on the board.", "Swim one: tailbeat trial run")
    return found[-1].number


def _pull(fish: Fish, number: int, into: Path) -> Path:
    """Into an experiment's raw files, where there is one; otherwise just into the folder."""
    experiment = Experiment(into) if (into / "settings.json").is_file() else None
    if experiment is not None:
        require_fish(fish, experiment)
    folder = into / ".pulling" if experiment else into
    folder.mkdir(exist_ok=True)
    path = pull_with_bar(fish, number, folder)
    if experiment is None:
        return path
    kept = experiment.add_raw(path.name, path.read_bytes())
    path.unlink()
    with contextlib.suppress(OSError):  # the beginning of another trial may lie there
        folder.rmdir()
    return kept


def show(
    what: str | None = arg("", "TRIAL|FILE"),
    csv: Path | None = opt("Write the beats there."),
    recompute: bool = opt("Compute the speeds again, by the board's own code."),
    connect: Connect = None,
) -> Output:
    """Print a trial: a file, or a number on the board (default: the last one).

    Example: tailbeat trial show 0003.ulg --csv beats.csv
    """
    if what is not None and (Path(what).is_file() or not what.isdecimal()):
        trial = read_trial(Path(what))
        saturation = saturation_of(trial, None, [trial])
    else:
        trial, saturation = _from_board(int(what) if what else None, connect)
    if csv is not None:
        beats_csv(trial, csv)
    document = _document(trial) | {"saturation": saturation}
    text = _trial_text(trial, saturation)
    if not recompute:
        return Output(document, text)
    try:
        document["recomputed"] = again = recomputed(trial)
    except NothingToRecompute as error:
        words = f"trial {trial.number} cannot be computed again: {error.message}"
        raise InputError(words, error.remedy) from error
    if again.identical:
        return Output(document, f"{text}\n{_SAME}")
    different = TailbeatError(
        f"the speeds of trial {trial.number} cannot be computed again from its file",
        "It was written by a firmware that computes otherwise, or is damaged; see the JSON.",
    )
    return Output(document, text, error=different)


def _from_board(number: int | None, connect: str | None) -> tuple[Trial, Saturation | None]:
    with connected(connect) as fish, TemporaryDirectory() as folder:
        path = _pull(fish, _which(fish, number), Path(folder))
        trial = read_trial(path)
        if (book := library_of(fish)) is None:
            return trial, saturation_of(trial, None, [trial])
        kept = [one.trial for one in book.kept(path)[0] if one.mark != DISCARDED]
    return trial, saturation_of(trial, sound_identified(book), kept)


def _document(trial: Trial) -> dict[str, Any]:
    straight, (begin_v, end_v) = heading_drift(trial), _battery(trial)
    document: dict[str, Any] = plain(trial)
    document["beats"]["error_m_s"] = plain(trial.beats.error_m_s)
    return document | {
        "slots": trial.slots.table(),
        "speed_source": speed_source(trial.params).name,
        "max_abs_error_m_s": trial.max_abs_error_m_s(),
        "rms_error_m_s": trial.rms_error_m_s(),
        "straight": straight,
        "crooked": straight.crooked if straight is not None else None,
        "battery_start_v": begin_v,
        "battery_end_v": end_v,
    }


def _battery(trial: Trial) -> tuple[float | None, float | None]:
    """At the begin and at the end of the trial."""
    volts = [volt for _, volt in trial.battery_v]
    return (volts[0], volts[-1]) if volts else (None, None)


def _conditions_text(trial: Trial) -> str:
    """Straightness and battery, in one line."""
    straight = heading_drift(trial)
    words = "straightness not known" if straight is None else straight.text()
    begin_v, end_v = _battery(trial)
    volts = "not known" if begin_v is None else f"{begin_v:.2f} V to {end_v:.2f} V"
    return f"{words}; battery {volts}"


def _trial_text(trial: Trial, saturation: Saturation | None) -> str:
    b = trial.beats
    speeds = (b.reference_m_s, b.speed_m_s, b.sigma_m_s, b.error_m_s)
    rows = [
        [k, "-" if np.isnan(rad) else f"{np.degrees(rad):.1f}", *(mm(float(v[k])) for v in speeds)]
        for k, rad in enumerate(b.applied_rad)
    ]
    missing = not_reached(trial.executed_beats, np.isfinite(b.speed_m_s))
    header = ["beat", "amplitude deg", "reference mm/s", "speed mm/s", "+-", "error mm/s"]
    return lines_of(
        f"trial {trial.number}, iteration {trial.iteration}, {trial.board}: {trial.end}, "
        f"{trial.executed_beats} beats; max|e| {mm(trial.max_abs_error_m_s())} mm/s, "
        f"RMS {mm(trial.rms_error_m_s())}; speed by {speed_source(trial.params).name}",
        _conditions_text(trial),
        saturation.text if saturation is not None else None,
        missing,
        [f"note: {problem}" for problem in trial.problems],
        table(header, rows),
    )


def discard(
    fish: ConnectedFish,
    number: int | None = arg("Default: the pending one.", "TRIAL", min=1, max=TRIAL_MAX),
    repeat: bool = opt("It repeats an input: count it for the noise."),
    reason: str = opt("Why, for the experiment's event log.", "TEXT", default=""),
) -> Output:
    """Drop the pending trial without learning from it; its log stays.

    The trial library keeps it, too: without --repeat as a trial that does not count, neither for
    the model nor for the convergence assessment (the fish touched the wall). So does the current
    experiment, with the reason.

    Example: tailbeat trial discard --reason "touched the wall at beat 13"
    """
    discard_and_keep(fish, number, repeat, reason)
    status = fish.status()
    what = "kept as a repeat, not learned from" if repeat else "discarded"
    return Output(status, f"{what}; iteration {status.iteration} is next")


def speeds(
    number: int = arg("The pending trial.", "TRIAL", min=1, max=TRIAL_MAX),
    file: Path = arg("t_s,v_m_s or beat,speed_m_s.", "SPEED.csv"),
    sigma_m_s: float | None = opt("Standard deviation of a beat's speed, m/s.", name="--sigma"),
    connect: Connect = None,
) -> Output:
    """Upload speeds measured after the trial, for example from a video.

    With t_s,v_m_s the speed is averaged over each beat; with beat,speed_m_s it is taken as it is
    and an empty cell means not measured. The file of 'camera track' also has each speed's standard
    deviation and its trial; without that the standard deviation is 0.001 m/s.

    Example: tailbeat trial speeds 3 speed.csv
    """
    if sigma_m_s is not None and not 0 < sigma_m_s <= 1:
        raise typer.BadParameter("--sigma is in m/s, more than 0, like 0.001")
    with connected(connect) as fish:
        record = fish.reference_record()
        beat_s = decode_reference(record).beat_s if record else 1.0
        beats = fish.status().beats
        found = read_speeds(file, beats, beat_s, number)
        sigma = found.sigma_m_s if sigma_m_s is None else None
        if sigma is None:
            sigma = np.full(beats, sigma_m_s or _SPEED_SIGMA_M_S, dtype=np.float32)
        fish.upload_speeds(number, found.speed_m_s, sigma)
    document = {
        "trial": number,
        "measured_beats": found.measured,
        "speed_m_s": found.speed_m_s,
        "sigma_m_s": np.where(np.isfinite(found.speed_m_s), sigma, np.nan),
    }
    return Output(document, f"trial {number} has speeds for {found.measured} of {beats} beats")
