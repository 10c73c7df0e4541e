"""session identify."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import typer
from numpy.typing import ArrayLike

from tailbeat.app.cli._camera import CameraOptions, LiveCamera, TankCameraOptions, live_camera
from tailbeat.app.cli._fish import Connect, connected
from tailbeat.app.cli._lazy import arg, opt
from tailbeat.app.cli._operator import TerminalOperator, terminal
from tailbeat.app.cli._options import Library
from tailbeat.app.cli._terminal import Output, echo, json_asked, lines_of, progress_bar, table, warn
from tailbeat.board.fish import Fish, board_reference
from tailbeat.board.preserve import restore_interrupted
from tailbeat.core.csv import read_speeds
from tailbeat.core.errors import InputError
from tailbeat.core.printable import mm
from tailbeat.core.speed_source import Camera, speed_source
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import RUN, TrialLibrary, library_of, preserve_folder
from tailbeat.learning.fit_quality import NAMES, Account, account_of, from_trials, with_drag
from tailbeat.learning.identification import Identified, SpeedTable, ThesisFish, from_table
from tailbeat.learning.identification_runs import FRACTIONS, IdentificationRun, Limits
from tailbeat.link.messages import BeatEvent
from tailbeat.report.figures.identification import draw_account, draw_table
from tailbeat.session.events import Event
from tailbeat.session.identify import IdentificationHooks, identify_fish, prior_of, set_params
from tailbeat.session.preflight import prepare
from tailbeat.session.preflight_step import GivenUp, PreflightLimits, countdown

_FISH = "With --table: the fish's "


@dataclass(frozen=True)
class ResultFiles:
    """Where the result goes, besides the board and the fish's trial library."""

    out: Path | None = opt("Write what was found there.")
    library: Library = None
    plot: Path | None = opt("Draw map, trials and residuals.", "PNG")

    def check(self) -> None:
        """Raises InputError for a folder that is not there."""
        for option, path in (("--out", self.out), ("--plot", self.plot)):
            if path is not None and not path.parent.is_dir():
                raise InputError(
                    f"{option}: there is no folder {path.parent}.", "Make it, then again."
                )


@dataclass(frozen=True)
class TableFish:
    """The fish that a table of steady speeds is of."""

    mass_kg: float = opt(_FISH + "mass, kg.", name="--mass", default=0.4)
    length_m: float = opt(_FISH + "length, m.", name="--length", default=0.36)
    density_kg_m3: float = opt(
        "With --table: the water's, kg/m3.", name="--density", default=1000.0
    )
    tail_area_m2: float | None = opt(_FISH + "tail area, m2; default pi*0.165^2/4.", name="--area")

    def known(self) -> ThesisFish:
        """For the thesis's equations."""
        given = {name: value for name, value in vars(self).items() if value is not None}
        return ThesisFish(**given)


@dataclass(frozen=True)
class RunOptions:
    """How the runs are done."""

    yes: bool = opt("Neither wait nor ask before a trial.")
    margin_m: float = opt(
        "Of the tank's length, left free, m.", name="--margin", min=0.0, default=0.15
    )
    rest: float = opt("Rest before each trial.", "S", min=0.0, max=3600.0, default=30.0)

    @property
    def alone(self) -> bool:
        """Nobody is asked anything."""
        return self.yes or json_asked.get()


def identify(
    *,
    files: list[Path] | None = arg("More files for --trials.", "FILE"),
    table_: Path | None = opt("Steady speeds: amplitude_rad,speed_m_s.", "CSV"),
    trials: list[Path] | None = opt("Trial files to use; the fish does not swim.", "FILE..."),
    experiment: Path | None = opt("Its trials are used; the fish does not swim.", "DIR"),
    write: ResultFiles,
    params: bool = opt(
        "Set the board's MDL_... and save them.", name="--params/--no-params", default=True
    ),
    table_fish: TableFish,
    runs: RunOptions,
    camera: TankCameraOptions,
    connect: Connect = None,
) -> Output:
    """Measure the fish: drag, speed over amplitude, dead zone, delay.

    Runs three cruises and a coast-down, gentlest first, within the tank. Then the board gets its
    learned data back. At a terminal each trial begins with the preflight checks of 'trial run'
    (rest, pose, still water, countdown), and any key stops the tail; --yes leaves them out. With
    --table, --trials or --experiment the fish does not swim.

    Example: tailbeat session identify --plot fish.png
    """
    sources = [table_ is not None, bool(trials or files), experiment is not None]
    if sum(sources) > 1:
        raise typer.BadParameter("--table, --trials and --experiment exclude each other")
    write.check()
    if table_ is not None:
        return _from_table(table_, table_fish.known(), write)
    if any(sources):
        return _from_trials([*(trials or []), *(files or [])], experiment, write)
    camera.check()
    return _from_runs(connect, camera, runs, write, params)


def _from_table(path: Path, fish: ThesisFish, write: ResultFiles) -> Output:
    found = from_table(path, fish)
    if write.out is not None:
        found.identified.save(write.out)
    if write.plot is not None:
        draw_table(found, write.plot)
    document = found.as_dict() | {"saved": write.out, "plot": write.plot}
    return Output(document, lambda: _table_text(found, write.out))


def _table_text(found: SpeedTable, out: Path | None) -> str:
    names = ("speed_m_s", "line_m_s", "line_residual_m_s", "thesis_m_s", "thesis_residual_m_s")
    rows = [
        [f"{row['amplitude_rad']:.4f}", *(mm(row[name]) for name in names)] for row in found.rows()
    ]
    header = ["amplitude rad", "speed mm/s", "line", "miss", "thesis's model", "miss"]
    line = found.line
    return lines_of(
        f"alpha {found.alpha_kg_m:.2f} kg/m; speed = {line.slope_m_s_rad:.3f} m/s/rad x "
        f"(amplitude - {line.dead_zone_rad:.3f} rad), pieces {found.gain_min_m_s_rad:.3f} to "
        f"{found.gain_max_m_s_rad:.3f}",
        f"note: {found.note}",
        table(header, rows),
        out and [f"saved in {out}"],
    )


def _from_trials(files: list[Path], experiment: Path | None, write: ResultFiles) -> Output:
    if experiment is not None:
        files = sorted(Experiment.open(experiment).raw.glob("*.ulg"))
    identified, simulated = from_trials(files)
    book = None
    if write.library is not None or not simulated:
        book = TrialLibrary.of(identified.unique_id, write.library)
    return _finished(account_of(identified), book, write, simulated)


def _from_runs(
    connect: str | None, camera: CameraOptions, asked: RunOptions, write: ResultFiles, params: bool
) -> Output:
    with connected(connect) as fish, live_camera(fish, camera) as live:
        simulated = fish.info().simulated
        book = library_of(fish, write.library)
        restore_interrupted(fish, preserve_folder(book), warn)
        values = fish.params.values()
        limits = replace(Limits.from_params(values), margin_m=asked.margin_m)
        by_hand = speed_source(values).uploaded
        found = _found(fish, live, book, limits, asked, by_hand)
        identified = with_drag(found, ThesisFish(length_m=values["FISH_LEN_M"]))
        held = set_params(fish, identified) if params else None
        bare = board_reference(fish) is None
    account = account_of(identified, prior_of(values))
    return _finished(account, book, write, simulated, held, limits.usable_m, bare)


def _found(
    fish: Fish,
    live: LiveCamera,
    book: TrialLibrary | None,
    limits: Limits,
    asked: RunOptions,
    by_hand: bool,
) -> Identified:
    """``by_hand``: somebody measures the speeds, and types the names of their files in lines."""
    wait = not (asked.yes or fish.info().simulated)
    if wait and json_asked.get():
        raise InputError(
            "nobody can be asked before each trial with --json.",
            "Add --yes when the fish is free to swim four times by itself.",
        )
    by_hand = by_hand and not asked.alone
    with terminal(single_keys=not by_hand) as (display, keys):
        here = display.moves and sys.stdin.isatty() and not asked.alone
        operator = TerminalOperator(display, keys)
        check = partial(_preflight, fish, asked.rest, live.camera, operator) if here else None
        # a bar would overwrite the questions
        with progress_bar("identify", quiet=wait or by_hand or here) as show:
            runs = RunView(limits, operator, show, wait, check)
            attendant = IdentificationHooks(
                runs.before,
                None if asked.alone else ask_for_speeds,
                runs.follow,
                lambda path: book and book.keep(path, RUN),
                warn,
                live.guard,
                operator.wants_abort,
            )
            return identify_fish(fish, attendant, preserve_folder(book), live.camera, limits)


@dataclass
class RunView:
    """What is printed of the runs, and asked before each. ``wait``: somebody puts the fish at rest
    first. ``check``: what goes before a run at a terminal with somebody, who stops it by a key if
    the operator has keys."""

    limits: Limits
    operator: TerminalOperator
    bar: Callable[[float, str], None]
    wait: bool = False
    check: Callable[[], None] | None = None
    run: IdentificationRun | None = None

    def before(self, run: IdentificationRun) -> None:
        """Begins it."""
        self.run = run
        if not json_asked.get():
            echo(_run_text(run, self.limits), err=True)
        if self.wait and self.operator.keys is None:
            typer.prompt(
                "Put the fish at rest at its wall, then press Enter (Ctrl-C ends it)",
                default="", show_default=False, prompt_suffix=" ", err=True,
            )  # fmt: skip
        elif self.wait and not self.operator.confirm("Put the fish at rest at its wall. Ready?"):
            raise GivenUp("not identified: the answer was no.", "The board has back what it held.")
        if self.check is not None:
            self.check()

    def follow(self, event: Event) -> None:
        """Shows what happens."""
        if not isinstance(event, BeatEvent):
            self.operator.tell(event)
        elif self.run is not None:
            number, beats = self.run.number, (event.beat + 1) / self.run.beats
            text = f"identification trial {number}, beat {event.beat + 1}"
            self.bar(min(1.0, (number - 1 + beats) / (len(FRACTIONS) + 1)), text)
            if self.check is not None:
                stop = "" if self.operator.keys is None else "; any key stops it"
                self.operator.display.show(text + stop)


def ask_for_speeds(trial: int, beats: int, beat_s: float) -> ArrayLike:
    """Until a file fits."""
    while True:
        name = typer.prompt(f"Speeds of trial {trial} (CSV t_s,v_m_s or beat,speed_m_s)")
        try:
            return read_speeds(Path(name), beats, beat_s, trial).speed_m_s
        except InputError as error:
            warn(str(error))


def _run_text(run: IdentificationRun, limits: Limits) -> str:
    room = f" of {limits.usable_m:.2f} m" if math.isfinite(limits.usable_m) else ""
    return (
        f"identification trial {run.number}, {run.kind}: {run.beats} beats, up to "
        f"{run.cruise_rad:.2f} rad ({math.degrees(run.cruise_rad):.0f} degrees);"
        f" about {run.travel_m:.2f} m, at worst {run.travel_worst_m:.2f}{room}"
    )


def _preflight(
    fish: Fish, rest_s: float, camera: Camera | None, operator: TerminalOperator
) -> None:
    limits = PreflightLimits(rest_s=rest_s)
    prepare(fish, limits, camera, operator)
    countdown(fish, limits, operator)


def _finished(
    account: Account,
    book: TrialLibrary | None,
    write: ResultFiles,
    simulated: bool,
    held: dict[str, float] | None = None,
    usable_m: float | None = None,
    bare: bool = False,
) -> Output:
    """Saves, draws and prints. ``bare``: the board has no reference."""
    saved = []
    if book is not None:
        saved.append(book.set_identified(account.identified))
    if write.out is not None:
        account.identified.save(write.out)
        saved.append(write.out)
    if write.plot is not None:
        draw_account(account, write.plot, simulated)
    document = account.as_dict() | {"params": held, "saved": saved, "plot": write.plot}
    document["usable_m"] = usable_m
    return Output(document, lambda: _text(account, held, saved, bare))


def _text(
    account: Account, held: dict[str, float] | None, saved: list[Path], bare: bool = False
) -> str:
    known: Identified = account.identified
    rows = [
        [label, f"{getattr(known.model, name):.3g}", unit, f"{low:.3g} to {high:.3g}"]
        for name, (label, unit) in NAMES.items()
        for low, high in [known.band[name]]
    ]
    volts = f"; battery {account.battery_text}" if account.battery_v else ""
    drag = f"; alpha {known.alpha_kg_m:.1f} kg/m" if known.alpha_kg_m else ""
    return lines_of(
        f"identified from {len(account.trials)} trials: the model misses {account.beats} beats by "
        f"{mm(account.rms_m_s)} mm/s RMS{volts}{drag}",
        table(["", "", "", "95 % interval"], rows, left=(0, 2, 3)),
        [f"warning: {text}" for text in account.warnings],
        held and f"the board has it, for good: {', '.join(held)}",
        [f"saved in {path}" for path in saved],
        bare and "the board has no reference yet: tailbeat reference upload thesis",
    )
