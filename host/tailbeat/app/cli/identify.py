"""session identify."""

from __future__ import annotations

import math
import sys
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.app.cli._camera import CAMERA, LiveCamera, LiveOptions, TankCameraOptions, live_camera
from tailbeat.app.cli._connect import connected
from tailbeat.app.cli._display import Display
from tailbeat.app.cli._keyboard import terminal_keys
from tailbeat.app.cli._operator import TerminalOperator
from tailbeat.app.cli._options import Connect, Json, Library
from tailbeat.app.cli._terminal import echo, mm, progress_bar, say, table
from tailbeat.board.fish import Fish, board_reference
from tailbeat.board.preserve import restore_interrupted
from tailbeat.core.csv import read_speeds
from tailbeat.core.errors import InputError
from tailbeat.core.speed_source import speed_source
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import RUN, Logbook, logbook_of, preserve_folder
from tailbeat.learning.fit_quality import NAMES, Account, account_of, from_trials, with_drag
from tailbeat.learning.identification import Identified
from tailbeat.learning.identification_runs import FRACTIONS, Limits, Run
from tailbeat.learning.speed_table import Table, ThesisFish, from_table
from tailbeat.link.messages import BeatEvent
from tailbeat.report.figures.identification import draw_account, draw_table
from tailbeat.session.events import Event, HoldRequest, TrialStopped, TrialWarning
from tailbeat.session.identify import Attendant, identify_fish, prior_of, set_params
from tailbeat.session.preflight.checklist import prepare
from tailbeat.session.preflight.step import GivenUp, PreflightLimits, countdown
from tailbeat.session.presenter import alert

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


_FISH = "With --table: the fish's "


@dataclass(frozen=True)
class Outputs:
    """Where the result goes, besides the board and the fish's trial library."""

    out: Annotated[Path | None, typer.Option("--out", help="Write what was found there.")] = None
    library: Library = None
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="PNG", help="Draw map, runs and residuals.")
    ] = None

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

    mass_kg: Annotated[float, typer.Option("--mass", help=_FISH + "mass, kg.")] = 0.4
    length_m: Annotated[float, typer.Option("--length", help=_FISH + "length, m.")] = 0.36
    density_kg_m3: Annotated[
        float, typer.Option("--density", help="With --table: the water's, kg/m3.")
    ] = 1000.0
    tail_area_m2: Annotated[
        float | None,
        typer.Option("--area", help=_FISH + "tail area, m2; default pi*0.165^2/4."),
    ] = None

    def known(self) -> ThesisFish:
        """For the thesis's equations."""
        area = ThesisFish.tail_area_m2 if self.tail_area_m2 is None else self.tail_area_m2
        return ThesisFish(self.mass_kg, self.length_m, self.density_kg_m3, area)


_OUTPUTS, _TABLE_FISH = Outputs(), TableFish()


def identify(
    files: Annotated[
        list[Path] | None, typer.Argument(metavar="FILE", help="More files for --trials.")
    ] = None,
    table_: Annotated[
        Path | None,
        typer.Option("--table", metavar="CSV", help="Steady speeds: amplitude_rad,speed_m_s."),
    ] = None,
    trials: Annotated[
        list[Path] | None,
        typer.Option(
            "--trials", metavar="FILE...", help="Trial files to use; the fish does not swim."
        ),
    ] = None,
    experiment: Annotated[
        Path | None,
        typer.Option(
            "--experiment", metavar="DIR", help="Its trials are used; the fish does not swim."
        ),
    ] = None,
    outputs: Outputs = _OUTPUTS,
    params: Annotated[
        bool, typer.Option("--params/--no-params", help="Set the board's MDL_... and save them.")
    ] = True,
    yes: Annotated[bool, typer.Option("--yes", help="Neither wait nor ask before a run.")] = False,
    margin_m: Annotated[
        float, typer.Option("--margin", min=0.0, help="Of the tank's length, left free, m.")
    ] = 0.15,
    table_fish: TableFish = _TABLE_FISH,
    rest: Annotated[
        float,
        typer.Option("--rest", min=0.0, max=3600.0, metavar="S", help="Rest before each run."),
    ] = 30.0,
    camera: TankCameraOptions = CAMERA,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Measure the fish: drag, speed over amplitude, dead zone, delay.

    Runs three cruises and a coast-down, gentlest first, within the tank; then the board gets its
    learned data back. At a terminal each run begins with the preflight checks of 'trial run' (rest,
    pose, still water, countdown) and any key stops the tail; --yes leaves them out. With --table,
    --trials or --experiment the fish does not swim.

    Example: tailbeat session identify --plot fish.png
    """
    sources = [table_ is not None, bool(trials or files), experiment is not None]
    if sum(sources) > 1:
        raise typer.BadParameter("--table, --trials and --experiment exclude each other")
    outputs.check()
    if table_ is not None:
        _from_table(table_, table_fish.known(), outputs, json)
    elif any(sources):
        _from_trials([*(trials or []), *(files or [])], experiment, outputs, json)
    else:
        asked = RunOptions(yes, json, margin_m, rest, camera.live().check())
        _from_runs(connect, asked, outputs, params)


def _from_table(path: Path, fish: ThesisFish, outputs: Outputs, json: bool) -> None:
    found = from_table(path, fish)
    if outputs.out is not None:
        found.identified.save(outputs.out)
    if outputs.plot is not None:
        draw_table(found, outputs.plot)
    document = found.as_dict() | {"saved": outputs.out, "plot": outputs.plot}
    say(json, document, lambda: _table_text(found, outputs.out))


def _table_text(found: Table, out: Path | None) -> str:
    rows = [
        [
            f"{row['amplitude_rad']:.4f}",
            *(mm(row[name]) for name in ("speed_m_s", "line_m_s", "line_residual_m_s")),
            *(mm(row[name]) for name in ("thesis_m_s", "thesis_residual_m_s")),
        ]
        for row in found.rows()
    ]
    header = ["amplitude rad", "speed mm/s", "line", "miss", "thesis's model", "miss"]
    line = found.line
    lines = [
        f"alpha {found.alpha_kg_m:.2f} kg/m; speed = {line.slope_m_s_rad:.3f} m/s/rad x "
        f"(amplitude - {line.dead_zone_rad:.3f} rad), pieces {found.gain_min_m_s_rad:.3f} to "
        f"{found.gain_max_m_s_rad:.3f}",
        f"note: {found.note}",
        table(header, rows),
    ]
    return "\n".join([*lines, *([f"saved in {out}"] if out else [])])


def _from_trials(files: list[Path], experiment: Path | None, outputs: Outputs, json: bool) -> None:
    if experiment is not None:
        files = sorted(Experiment.open(experiment).raw.glob("*.ulg"))
    identified, simulated = from_trials(files)
    book = None
    if outputs.library is not None or not simulated:
        book = Logbook.of(identified.unique_id, outputs.library)
    _finish(account_of(identified), None, book, outputs, simulated, None, json)


@dataclass(frozen=True)
class RunOptions:
    """What was given on the command line for the runs."""

    yes: bool
    json: bool
    margin_m: float
    rest_s: float
    camera: LiveOptions

    @property
    def alone(self) -> bool:
        """Nobody is asked anything."""
        return self.yes or self.json


def _from_runs(connect: str | None, asked: RunOptions, outputs: Outputs, params: bool) -> None:
    with connected(connect) as fish, live_camera(fish, asked.camera) as live:
        simulated = fish.info().simulated
        book = logbook_of(fish, outputs.library)
        restore_interrupted(fish, preserve_folder(book), _note)
        values = {name: p.value for name, p in fish.params.list().items()}
        limits = replace(Limits.from_params(values), margin_m=asked.margin_m)
        found = _found(fish, live, book, limits, asked, values)
        identified = with_drag(found, ThesisFish(length_m=values["FISH_LEN_M"]))
        held = set_params(fish, identified) if params else None
        bare = board_reference(fish) is None
    account = account_of(identified, prior_of(values))
    _finish(account, held, book, outputs, simulated, limits, asked.json, bare)


def _found(
    fish: Fish,
    live: LiveCamera,
    book: Logbook | None,
    limits: Limits,
    asked: RunOptions,
    values: dict[str, float],
) -> Identified:
    wait = not (asked.yes or fish.info().simulated)
    if wait and asked.json:
        raise InputError(
            "nobody can be asked before each run with --json.",
            "Add --yes when the fish is free to swim four times by itself.",
        )
    by_hand = not asked.alone and speed_source(values).uploaded
    with ExitStack() as stack:
        display = stack.enter_context(Display(quiet=asked.json))
        there = None
        if display.moves and sys.stdin.isatty():
            # the names of files with speeds are typed in lines
            keys = None if by_hand else stack.enter_context(terminal_keys())
            there = _There(fish, live, display, TerminalOperator(display, keys), not by_hand, asked)
        # a bar would overwrite the questions
        quiet = asked.json or wait or by_hand or (there is not None and not asked.alone)
        show = stack.enter_context(progress_bar(quiet, "identify"))
        attendant = _attendant(limits, book, wait, asked.alone, asked.json, show, there)
        attendant = replace(attendant, guard=live.guard)
        return identify_fish(fish, attendant, preserve_folder(book), live.camera, limits)


@dataclass(frozen=True)
class _There:
    """Somebody at the terminal, who sees each run and, with ``keys``, stops it with one."""

    fish: Fish
    live: LiveCamera
    display: Display
    person: TerminalOperator
    keys: bool
    asked: RunOptions

    def ready(self, wait: bool) -> None:
        """What goes before a run; nothing with --yes."""
        if self.asked.alone:
            return
        if not self.keys:
            _wait_for_enter(wait)
        elif wait and not self.person.confirm("Put the fish at rest at its wall. Ready?"):
            raise GivenUp("not identified: the answer was no.", "The board has back what it held.")
        wanted = PreflightLimits(rest_s=self.asked.rest_s)
        prepare(self.fish, wanted, self.live.camera, self.person)
        countdown(self.fish, wanted, self.person)

    def follow(self, event: Event, run: Run) -> None:
        """Shows it."""
        if isinstance(event, BeatEvent):
            stops = "; any key stops it" if self.keys else ""
            self.display.show(f"run {run.number}, beat {event.beat + 1}{stops}")
        else:
            self.person.tell(event)


def _wait_for_enter(wait: bool) -> None:
    if wait:
        typer.prompt(
            "Put the fish at rest at its wall, then press Enter (Ctrl-C ends it)",
            default="", show_default=False, prompt_suffix=" ", err=True,
        )  # fmt: skip


def _note(text: str) -> None:
    echo(f"tailbeat: {text}", err=True)


def _attendant(
    limits: Limits,
    book: Logbook | None,
    wait: bool,
    alone: bool,
    json: bool,
    show: Any,
    there: _There | None = None,
) -> Attendant:
    """Whoever sees to it. ``alone``: nobody who could be asked for speeds."""
    now: list[Run] = []

    def before(run: Run) -> None:
        now.append(run)
        if not json:
            echo(_run_text(run, limits), err=True)
        if there is not None:
            there.ready(wait)
        else:
            _wait_for_enter(wait)

    def follow(event: Event) -> None:
        if there is not None and not alone:
            there.follow(event, now[-1])
        elif isinstance(event, BeatEvent) and now:
            done = (len(now) - 1 + (event.beat + 1) / now[-1].beats) / (len(FRACTIONS) + 1)
            show(min(done, 1.0), f"run {now[-1].number}, beat {event.beat + 1}")
        elif isinstance(event, TrialWarning | HoldRequest | TrialStopped):
            _note(alert(event))

    def speeds(trial: int, beats: int, beat_s: float) -> ArrayLike:
        while True:
            name = typer.prompt(f"Speeds of trial {trial} (CSV t_s,v_m_s or beat,speed_m_s)")
            try:
                return read_speeds(Path(name), beats, beat_s, trial).speed_m_s
            except InputError as error:
                echo(f"tailbeat: {error}", err=True)

    def keep(path: Path) -> None:
        if book is not None:
            book.keep(path, RUN)

    stop = there.person.wants_abort if there is not None else lambda: False
    return Attendant(before, None if alone else speeds, follow, keep, _note, wants_abort=stop)


def _run_text(run: Run, limits: Limits) -> str:
    room = f" of {limits.usable_m:.2f} m" if math.isfinite(limits.usable_m) else ""
    return (
        f"run {run.number}, {run.kind}: {run.beats} beats, up to {run.cruise_rad:.2f} rad "
        f"({math.degrees(run.cruise_rad):.0f} degrees); about {run.travel_m:.2f} m, at worst "
        f"{run.travel_worst_m:.2f}{room}"
    )


def _finish(
    account: Account,
    held: dict[str, float] | None,
    book: Logbook | None,
    outputs: Outputs,
    simulated: bool,
    limits: Limits | None,
    json: bool,
    bare: bool = False,
) -> None:
    """Saves, draws and prints. ``bare``: the board has no reference."""
    saved = []
    if book is not None:
        saved.append(book.set_identified(account.identified))
    if outputs.out is not None:
        account.identified.save(outputs.out)
        saved.append(outputs.out)
    if outputs.plot is not None:
        draw_account(account, outputs.plot, simulated)
    document = account.as_dict() | {"params": held, "saved": saved, "plot": outputs.plot}
    document["usable_m"] = limits.usable_m if limits else None
    say(json, document, lambda: _text(account, held, saved, bare))


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
    lines = [
        f"identified from {len(account.swims)} swims: the model misses {account.beats} beats by "
        f"{mm(account.rms_m_s)} mm/s RMS{volts}{drag}",
        table(["", "", "", "95 % interval"], rows, left=(0, 2, 3)),
        *(f"warning: {text}" for text in account.warnings),
    ]
    if held:
        lines.append(f"the board has it, for good: {', '.join(held)}")
    lines += [f"saved in {path}" for path in saved]
    if bare:
        lines.append("the board has no reference yet: tailbeat reference upload thesis")
    return "\n".join(lines)
