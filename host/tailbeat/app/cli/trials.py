"""trial run, abort, list, pull, show, discard."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.app.cli import trial as swim
from tailbeat.app.cli._library import discard_and_keep, keep_in_logbook
from tailbeat.app.cli._terminal import (
    TRIAL_MAX,
    Connect,
    Json,
    connected,
    mm,
    progress_bar,
    say,
    table,
)
from tailbeat.core.errors import TailbeatError

if TYPE_CHECKING:
    from tailbeat.board.fish import Fish
    from tailbeat.core.trial_file import Trial
    from tailbeat.learning.identification import Identified
    from tailbeat.learning.saturation import Saturation

app = typer.Typer(no_args_is_help=True, help="Swim, and get the logs.")

_SAME = "recomputed: the same speeds and sigmas, bit for bit"

Number = Annotated[
    int | None,
    typer.Argument(min=1, max=TRIAL_MAX, metavar="TRIAL", help="Default: the last one."),
]


app.command()(swim.run)


@app.command()
def abort(connect: Connect = None, json: Json = False) -> None:
    """Stop the tail now.

    Example: tailbeat trial abort
    """
    with connected(connect) as fish:
        fish.abort()
        status = fish.status()
    say(json, status, f"stopped: {status.state}")


@app.command("list")
def list_(connect: Connect = None, json: Json = False) -> None:
    """Print the trials whose logs are on the board.

    Example: tailbeat trial list
    """
    with connected(connect) as fish:
        found = fish.trials()
        pending = fish.status().pending_trial
    rows = [
        [str(t.number), str(t.size_bytes), "pending" if t.number == pending else ""] for t in found
    ]
    say(
        json,
        {"trials": found, "pending_trial": pending},
        lambda: table(["trial", "bytes", ""], rows) if rows else "no trials on the board",
    )


@app.command()
def pull(
    number: Number = None,
    every: Annotated[bool, typer.Option("--all", help="All trials on the board.")] = False,
    into: Annotated[
        Path, typer.Option("--into", help="A folder, or an experiment's folder.")
    ] = Path(),
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Copy logs from the board. An interrupted copy goes on where it stopped.

    Example: tailbeat trial pull 3 --into experiments/2026-05-04_fish_thesis_p4_01
    """
    into.mkdir(parents=True, exist_ok=True)
    with connected(connect) as fish:
        numbers = [t.number for t in fish.trials()] if every else [_which(fish, number)]
        paths = [_pull(fish, wanted, into, json) for wanted in numbers]
        for path in paths:
            keep_in_logbook(fish, path)
    say(json, {"files": paths}, "\n".join(map(str, paths)) or "no trials on the board")


def _which(fish: Fish, number: int | None) -> int:
    from tailbeat.core.errors import InputError

    if number is not None:
        return number
    found = fish.trials()
    if not found:
        raise InputError("there are no trials on the board.", "Swim one: tailbeat trial run")
    return found[-1].number


def _pull(fish: Fish, number: int, into: Path, quiet: bool) -> Path:
    """Into an experiment's raw files, where there is one; otherwise just into the folder."""
    from tailbeat.experiment.current import require_fish
    from tailbeat.experiment.folder import Experiment

    experiment = Experiment(into) if (into / "settings.json").is_file() else None
    if experiment is not None:
        require_fish(fish, experiment)
    folder = into / ".pulling" if experiment else into
    folder.mkdir(exist_ok=True)
    with progress_bar(quiet, f"trial {number}") as show:
        path = fish.pull_trial(
            number, folder, lambda done, total: show(done / max(total, 1), f"{done} bytes")
        )
    if experiment is None:
        return path
    kept = experiment.add_raw(path.name, path.read_bytes())
    path.unlink()
    with contextlib.suppress(OSError):  # the beginning of another trial may lie there
        folder.rmdir()
    return kept


@app.command()
def show(
    what: Annotated[str | None, typer.Argument(metavar="TRIAL|FILE")] = None,
    csv: Annotated[Path | None, typer.Option("--csv", help="Write the beats there.")] = None,
    recompute: Annotated[
        bool,
        typer.Option("--recompute", help="Compute the speeds again, by the board's own code."),
    ] = False,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Print a trial: a file, or a number on the board (default: the last one).

    Example: tailbeat trial show 0003.ulg --csv beats.csv
    """
    from tailbeat.core.trial_file import beats_csv, read_trial
    from tailbeat.learning.saturation import saturation_of

    known: tuple[Identified | None, list[Trial]]
    path = Path(what) if what is not None else None
    if what is not None and path is not None and (path.is_file() or not what.isdecimal()):
        trial = read_trial(path)
        known = (None, [trial])
    else:
        trial, known = _from_board(int(what) if what else None, connect, json)
    saturation = saturation_of(trial, *known)
    if csv is not None:
        beats_csv(trial, csv)
    document = _document(trial) | {"saturation": saturation}
    again = _recomputed(trial) if recompute else None
    if again is not None:
        document["recomputed"] = again
    say(json, document, lambda: _trial_text(trial, saturation) + ("\n" + _SAME if again else ""))
    if again is not None and not again["identical"]:
        raise TailbeatError(
            f"the speeds of trial {trial.number} cannot be computed again from its file",
            "It was written by a firmware that computes otherwise, or is damaged; see the JSON.",
        )


def _recomputed(trial: Trial) -> dict[str, Any]:
    import numpy as np

    from tailbeat.core.errors import InputError
    from tailbeat.core.files import plain
    from tailbeat.core.speed_estimate import recompute_beats

    if trial.uploaded or _source(trial) == "upload":
        raise InputError(
            f"the speeds of trial {trial.number} were uploaded: there is nothing to compute",
            "They are what the file says.",
        )
    if trial.executed_beats == 0 or trial.end_fault is None:
        raise InputError(
            f"trial {trial.number} was not written to its end: there is nothing to compare with",
            "Pull it again.",
        )
    speed, sigma = recompute_beats(trial)
    pairs = ((speed, trial.beats.speed_m_s), (sigma, trial.beats.sigma_m_s))
    # float32 numbers that are equal have equal bits, but for a zero's sign; NaN = not measured
    identical = all(np.array_equal(again, was, equal_nan=True) for again, was in pairs)
    found: dict[str, Any] = plain({"speed_m_s": speed, "sigma_m_s": sigma})
    return found | {"identical": identical}


def _from_board(
    number: int | None, connect: str | None, quiet: bool
) -> tuple[Trial, tuple[Identified | None, list[Trial]]]:
    """The trial, and what the trial library knows of its fish."""
    from tempfile import TemporaryDirectory

    from tailbeat.app.cli._library import sound_identified
    from tailbeat.core.trial_file import read_trial
    from tailbeat.experiment.library import DISCARDED, logbook_of

    with connected(connect) as fish, TemporaryDirectory() as folder:
        path = _pull(fish, _which(fish, number), Path(folder), quiet)
        trial = read_trial(path)
        if (book := logbook_of(fish)) is None:
            return trial, (None, [trial])
        kept = [one.trial for one in book.kept(path)[0] if one.mark != DISCARDED]
    return trial, (sound_identified(book), kept)


def _source(trial: Trial) -> str:
    from tailbeat.link.messages import SPEED_SOURCES

    return SPEED_SOURCES[round(trial.params.get("SPD_SOURCE", 0))]


def _document(trial: Trial) -> dict[str, Any]:
    from tailbeat.core.files import plain
    from tailbeat.core.trial_checks import straightness

    document: dict[str, Any] = plain(trial)
    document["beats"]["error_m_s"] = plain(trial.beats.error_m_s)
    document["slots"] = plain(trial.slots.table())
    document["speed_source"] = _source(trial)
    document["max_abs_error_m_s"] = trial.max_abs_error_m_s()
    document["rms_error_m_s"] = trial.rms_error_m_s()
    straight = straightness(trial)
    document["straight"] = plain(straight)
    document["crooked"] = straight.crooked if straight is not None else None
    document["battery_start_v"], document["battery_end_v"] = _battery(trial)
    return document


def _battery(trial: Trial) -> tuple[float | None, float | None]:
    """At the begin and at the end of the swim."""
    volts = [volt for _, volt in trial.battery_v]
    return (volts[0], volts[-1]) if volts else (None, None)


def _conditions_text(trial: Trial) -> str:
    """Straightness and battery, in one line."""
    from tailbeat.core.trial_checks import straightness

    straight = straightness(trial)
    words = "straightness not known" if straight is None else straight.text()
    begin_v, end_v = _battery(trial)
    volts = "not known" if begin_v is None else f"{begin_v:.2f} V to {end_v:.2f} V"
    return f"{words}; battery {volts}"


def _trial_text(trial: Trial, saturation: Saturation | None) -> str:
    import numpy as np

    from tailbeat.core.trial_checks import not_reached

    b = trial.beats
    rows = [
        [
            str(k),
            "-" if np.isnan(b.applied_rad[k]) else f"{np.degrees(b.applied_rad[k]):.1f}",
            mm(float(b.reference_m_s[k])),
            mm(float(b.speed_m_s[k])),
            mm(float(b.sigma_m_s[k])),
            mm(float(b.error_m_s[k])),
        ]
        for k in range(len(b.samples))
    ]
    missing = not_reached(trial.executed_beats, np.isfinite(b.speed_m_s))
    lines = [
        f"trial {trial.number}, iteration {trial.iteration}, {trial.board}: {trial.end}, "
        f"{trial.executed_beats} beats; max|e| {mm(trial.max_abs_error_m_s())} mm/s, "
        f"RMS {mm(trial.rms_error_m_s())}; speed by "
        f"{_source(trial)}",
        _conditions_text(trial),
        *([saturation.text] if saturation is not None else []),
        *([missing] if missing else []),
        *(f"note: {problem}" for problem in trial.problems),
        table(["beat", "amplitude deg", "reference mm/s", "speed mm/s", "+-", "error mm/s"], rows),
    ]
    return "\n".join(lines)


@app.command()
def discard(
    number: Annotated[
        int | None,
        typer.Argument(min=1, max=TRIAL_MAX, metavar="TRIAL", help="Default: the pending one."),
    ] = None,
    repeat: Annotated[
        bool, typer.Option("--repeat", help="It repeats an input: count it for the noise.")
    ] = False,
    reason: Annotated[
        str, typer.Option("--reason", metavar="TEXT", help="Why, for the experiment's journal.")
    ] = "",
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Drop the pending trial without learning from it; its log stays.

    The logbook keeps it, too: without --repeat as a swim that counts for nothing, neither for the
    model nor for the verdict (the fish touched the wall). So does the experiment the fish is in,
    with the reason.

    Example: tailbeat trial discard --reason "touched the wall at beat 13"
    """
    with connected(connect) as fish:
        discard_and_keep(fish, number, repeat, json, reason)
        status = fish.status()
    what = "kept as a repeat, not learned from" if repeat else "discarded"
    say(json, status, f"{what}; iteration {status.iteration} swims next")
