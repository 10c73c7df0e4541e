"""identify."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.cli.common import Connect, Json, connected, mm, progress_bar, say, table
from tailbeat.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from tailbeat.logbook import Logbook
    from tailbeat.model.account import Account
    from tailbeat.model.guided import Person
    from tailbeat.model.identified import Identified
    from tailbeat.model.runs import Limits, Run
    from tailbeat.model.table import Table

_FISH = "With --table: the fish's "


def identify(
    files: Annotated[
        list[Path] | None, typer.Argument(metavar="[FILE]...", help="More files for --trials.")
    ] = None,
    table_: Annotated[
        Path | None,
        typer.Option("--table", metavar="CSV", help="Steady speeds: amplitude_rad,speed_m_s."),
    ] = None,
    trials: Annotated[
        list[Path] | None,
        typer.Option("--trials", metavar="FILE...", help="Swim nothing; use these trial files."),
    ] = None,
    experiment: Annotated[
        Path | None,
        typer.Option("--experiment", metavar="DIR", help="Swim nothing; use its trials."),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Write what was found there.")] = None,
    logbook: Annotated[
        Path | None,
        typer.Option("--logbook", metavar="DIR", help="Folder of the logbooks, if not the usual."),
    ] = None,
    params: Annotated[
        bool, typer.Option("--params/--no-params", help="Set the board's MDL_... and save them.")
    ] = True,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="PNG", help="Draw map, runs and residuals.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not wait for Enter before a run.")] = False,
    margin_m: Annotated[
        float, typer.Option("--margin", min=0.0, help="Of the tank's length, left free, m.")
    ] = 0.15,
    mass_kg: Annotated[float, typer.Option("--mass", help=_FISH + "mass, kg.")] = 0.4,
    length_m: Annotated[float, typer.Option("--length", help=_FISH + "length, m.")] = 0.36,
    density_kg_m3: Annotated[
        float, typer.Option("--density", help="With --table: the water's, kg/m3.")
    ] = 1000.0,
    tail_area_m2: Annotated[
        float | None,
        typer.Option("--area", help=_FISH + "tail area, m2; default pi*0.165^2/4."),
    ] = None,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Find out what the fish is like: drag, speed over amplitude, dead zone, delay.

    Swims three cruises and a coast-down, gentlest first, within the tank; the board gets back what
    it had learned. With --table, --trials or --experiment nothing is swum.

    Example: tailbeat identify --plot fish.png
    """
    sources = [table_ is not None, bool(trials or files), experiment is not None]
    if sum(sources) > 1:
        raise typer.BadParameter("--table, --trials and --experiment exclude each other")
    if table_ is not None:
        from tailbeat.model.table import ThesisFish

        area = ThesisFish.tail_area_m2 if tail_area_m2 is None else tail_area_m2
        about = ThesisFish(mass_kg, length_m, density_kg_m3, area)
        _from_table(table_, about, out, plot, json)
    elif any(sources):
        _from_trials([*(trials or []), *(files or [])], experiment, out, logbook, plot, json)
    else:
        _swum(connect, yes, margin_m, out, logbook, params, plot, json)


def _from_table(path: Path, about: Any, out: Path | None, plot: Path | None, json: bool) -> None:
    from tailbeat.model.table import from_table

    found = from_table(path, about)
    if out is not None:
        found.identified.save(out)
    if plot is not None:
        from tailbeat.report.identified import draw_table

        draw_table(found, plot)
    document = found.as_dict() | {"saved": out, "plot": plot}
    say(json, document, lambda: _table_text(found, out))


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


def _from_trials(
    files: list[Path],
    experiment: Path | None,
    out: Path | None,
    logbook: Path | None,
    plot: Path | None,
    json: bool,
) -> None:
    from tailbeat.experiment import Experiment
    from tailbeat.logbook import Logbook
    from tailbeat.model.account import account_of, from_trials

    if experiment is not None:
        files = sorted(Experiment.open(experiment).raw.glob("*.ulg"))
    identified, simulated = from_trials(files)
    book = None
    if logbook is not None or not simulated:
        book = Logbook.of(identified.unique_id, logbook)
    _finish(account_of(identified), None, book, out, plot, simulated, None, json)


def _swum(
    connect: str | None,
    yes: bool,
    margin_m: float,
    out: Path | None,
    logbook: Path | None,
    params: bool,
    plot: Path | None,
    json: bool,
) -> None:
    from dataclasses import replace

    from tailbeat.boardreference import board_reference
    from tailbeat.logbook import logbook_of
    from tailbeat.model.account import account_of, with_drag
    from tailbeat.model.guided import identify_fish, prior_of, set_params
    from tailbeat.model.lent import safe_folder
    from tailbeat.model.runs import Limits
    from tailbeat.model.table import ThesisFish
    from tailbeat.results import SPEED_SOURCES

    with connected(connect) as fish:
        simulated = fish.info().simulated
        book = logbook_of(fish, logbook)
        values = {name: p.value for name, p in fish.params.list().items()}
        limits = replace(Limits.from_params(values), margin_m=margin_m)
        alone = yes or json
        wait = not (yes or simulated)
        if wait and json:
            raise InputError(
                "nobody can be asked before each run with --json.",
                "Add --yes when the fish is free to swim four times by itself.",
            )
        asks = not alone and SPEED_SOURCES[round(values["SPD_SOURCE"])] == "upload"
        # a bar would overwrite the questions
        with progress_bar(json or wait or asks, "identify") as show:
            person = _person(limits, book, wait, alone, json, show)
            safe = safe_folder(book)
            found = identify_fish(fish, person, safe, limits=limits)
        identified = with_drag(found, ThesisFish(length_m=values["FISH_LEN_M"]))
        held = set_params(fish, identified) if params else None
        bare = board_reference(fish) is None
    account = account_of(identified, prior_of(values))
    _finish(account, held, book, out, plot, simulated, limits, json, bare)


def _person(
    limits: Limits, book: Logbook | None, wait: bool, alone: bool, json: bool, show: Any
) -> Person:
    """Whoever sits at the terminal. ``alone``: nobody who could be asked for speeds."""
    from tailbeat.logbook import RUN
    from tailbeat.model.guided import Person
    from tailbeat.model.runs import FRACTIONS

    now: list[Run] = []

    def before(run: Run) -> None:
        now.append(run)
        if not json:
            typer.echo(_run_text(run, limits), err=True)
        if wait:
            typer.prompt(
                "Put the fish at rest at its wall, then press Enter (Ctrl-C ends it)",
                default="", show_default=False, prompt_suffix=" ", err=True,
            )  # fmt: skip

    def follow(event: dict[str, Any]) -> None:
        if event["event"] == "beat" and now:
            done = (len(now) - 1 + (event["beat"] + 1) / now[-1].beats) / (len(FRACTIONS) + 1)
            show(min(done, 1.0), f"run {now[-1].number}, beat {event['beat'] + 1}")
        elif event["event"] in ("warning", "hold", "guard"):
            typer.echo(f"tailbeat: {event.get('text') or event.get('reason')}", err=True)

    def speeds(trial: int, beats: int, beat_s: float) -> ArrayLike:
        from tailbeat.speedcsv import read_speeds

        while True:
            name = typer.prompt(f"Speeds of trial {trial} (CSV t_s,v_m_s or beat,speed_m_s)")
            try:
                return read_speeds(Path(name), beats, beat_s, trial).speed_m_s
            except InputError as error:
                typer.echo(f"tailbeat: {error}", err=True)

    def keep(path: Path) -> None:
        if book is not None:
            book.keep(path, RUN)

    def note(text: str) -> None:
        typer.echo(f"tailbeat: {text}", err=True)

    return Person(before, None if alone else speeds, follow, keep, note)


def _run_text(run: Run, limits: Limits) -> str:
    import math

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
    out: Path | None,
    plot: Path | None,
    simulated: bool,
    limits: Limits | None,
    json: bool,
    bare: bool = False,
) -> None:
    """Saves, draws and prints. ``bare``: the board has no reference."""
    saved = []
    if book is not None:
        saved.append(book.set_identified(account.identified))
    if out is not None:
        account.identified.save(out)
        saved.append(out)
    if plot is not None:
        from tailbeat.report.identified import draw_account

        draw_account(account, plot, simulated)
    document = account.as_dict() | {"params": held, "saved": saved, "plot": plot}
    document["usable_m"] = limits.usable_m if limits else None
    say(json, document, lambda: _text(account, held, saved, bare))


def _text(
    account: Account, held: dict[str, float] | None, saved: list[Path], bare: bool = False
) -> str:
    from tailbeat.model.account import NAMES

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
