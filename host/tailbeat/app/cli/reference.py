"""reference upload --like.

reference upload, show, check.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.app.cli._library import sound_identified, told_if_another
from tailbeat.app.cli._options import reference_names
from tailbeat.app.cli._reference_words import (
    advice,
    floor_document,
    floor_text,
    suggestion_document,
    suggestion_text,
)
from tailbeat.app.cli._terminal import Connect, Json, connected, echo, mm, progress_bar, say

if TYPE_CHECKING:
    from tailbeat.board.fish import Fish
    from tailbeat.core.reference import Limits, Problem, Reference
    from tailbeat.learning.fish_model import Swim
    from tailbeat.learning.identification import Identified
    from tailbeat.learning.saturation import KnownFish, Saturation
    from tailbeat.session.transfer import Plan


def upload_like(
    fish: Fish,
    reference: Reference,
    like: str,
    identified_file: Path | None,
    dry_run: bool,
    document: dict[str, Any],
    line: str,
    json: bool,
) -> None:
    """Uploads the reference and amplitudes for it, or prints them. ``document``, ``line``: what is
    said of the reference itself."""
    from tailbeat.experiment.library import logbook_of, name_reference
    from tailbeat.learning.identification import Identified
    from tailbeat.session.transfer import carry, plan

    book = logbook_of(fish)
    identified = sound_identified(book) if book is not None else None
    if identified_file is not None:
        identified = Identified.load(identified_file)
    unique_id = fish.unique_id()
    if identified is not None:
        told_if_another(identified, unique_id)
    found = plan(fish, like, reference, identified, book)
    if found.learned.unique_id not in ("", unique_id):
        echo(f"tailbeat: learned by another fish ({found.learned.unique_id})", err=True)
    copy = None
    if not dry_run:
        with progress_bar(json, "upload") as show:
            copy = carry(fish, found, book, lambda done, total: show(done / max(total, 1), ""))
        name_reference(fish, reference)
    document |= {"like": found.as_dict(), "copy": copy, "dry_run": dry_run}
    if dry_run:
        rows = enumerate(found.transferred.amplitude_rad)
        table = [f"{beat},{float(value)!r}" for beat, value in rows]
        echo(f"tailbeat: would upload {reference.name}: {line}; {_words(found)}", err=True)
        say(json, document, "\n".join(["beat,amplitude_rad", *table]))
        return
    kept = f"; what the board had learned is kept in {copy}" if copy is not None else ""
    say(json, document, f"uploaded {reference.name}: {line}; {_words(found)}{kept}")


def _words(found: Plan) -> str:
    learned, done = found.learned, found.transferred
    error = learned.max_abs_error_m_s
    known = f" (max|e| {mm(error)} mm/s)" if error is not None else ""
    beats = f"{done.saturated_beats} beat{'' if done.saturated_beats == 1 else 's'}"
    return (
        f"like {learned.words}{known}: speed times {found.by.magnitude:.3g}, time divided by "
        f"{found.by.time_factor:.3g}, {beats} saturated, expected travel {found.travel_m:.2f} m"
    )


app = typer.Typer(no_args_is_help=True, help="The wanted speed per beat.")

What = Annotated[
    str,
    typer.Argument(
        metavar="REFERENCE",
        autocompletion=reference_names,
        help="thesis[:V,DURATION_S], trapezoid:V,RAMP_S,HOLD_S, cosine:V,RAMP_S,HOLD_S or a CSV "
        "with t_s,v_m_s (a curve's points) or beat,t_s,v_m_s (beat means, as written here).",
    ),
]


def _limits(fish: Fish) -> Limits:
    from tailbeat.core.reference import Limits

    names = ("REF_MAX_M_S", "TANK_LEN_M", "FISH_LEN_M")
    return Limits.from_params({name: fish.params.get(name).value for name in names})


def _document(reference: Reference, crc: int, problems: list[Problem]) -> dict[str, Any]:
    return {
        "name": reference.name,
        "beats": reference.beats,
        "beat_s": reference.beat_s,
        "travel_m": reference.travel_m,
        "max_m_s": float(reference.speed_m_s.max()),
        "crc": crc,
        "speed_m_s": reference.speed_m_s,
        "problems": problems,
    }


def _line(reference: Reference) -> str:
    return (
        f"{reference.beats} beats of {reference.beat_s:g} s, {reference.travel_m:.2f} m, "
        f"up to {mm(float(reference.speed_m_s.max()))} mm/s"
    )


def _refuse(problems: list[Problem]) -> None:
    from tailbeat.core.errors import InputError

    if problems:
        raise InputError(
            " ".join(problem.meaning for problem in problems),
            " ".join(dict.fromkeys(problem.remedy for problem in problems)),
        )


@app.command()
def upload(
    what: What,
    like: Annotated[
        str | None,
        typer.Option(
            "--like",
            metavar="OLD",
            help="Begin with what was learned along OLD, a reference of the same shape: board (what"
            " it holds now), a trial's file, an experiment's folder, or a reference.",
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="With --like: print the amplitudes; change nothing.")
    ] = False,
    identified: Annotated[
        Path | None,
        typer.Option("--identified", metavar="FILE", help="With --like: what identify wrote."),
    ] = None,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Check a reference against the board's limits and make it the board's.

    Another reference than the board has sets the iteration to 0. With --like the first swim has
    amplitudes scaled from those along a reference of another magnitude or duration.

    Example: tailbeat reference upload thesis:0.0633,50 --like board
    """
    from tailbeat.experiment.current import named_reference
    from tailbeat.experiment.library import name_reference

    if like is None and (dry_run or identified is not None):
        raise typer.BadParameter("--dry-run and --identified are for --like OLD")
    reference = named_reference(what)
    with connected(connect) as fish:
        _refuse(reference.check(_limits(fish)))
        if like is not None:
            pass

            document = _document(reference, reference.crc, [])
            upload_like(
                fish, reference, like, identified, dry_run, document, _line(reference), json
            )
            return
        with progress_bar(json, "upload") as show:
            crc = fish.upload_reference(
                reference.record(), lambda done, total: show(done / max(total, 1), "")
            )
        name_reference(fish, reference)
    say(json, _document(reference, crc, []), f"uploaded {reference.name}: {_line(reference)}")


@app.command()
def show(
    connect: Connect = None,
    csv: Annotated[Path | None, typer.Option("--csv", help="Write the beats there.")] = None,
    json: Json = False,
) -> None:
    """Print the board's reference.

    Example: tailbeat reference show --csv reference.csv
    """
    from tailbeat.core.faults import NO_REFERENCE, refusal
    from tailbeat.core.records import decode_reference
    from tailbeat.core.reference import Reference

    with connected(connect) as fish:
        record = fish.reference_record()
    if record is None:
        raise refusal(NO_REFERENCE)
    found = decode_reference(record)
    reference = Reference(found.beat_s, found.speed_m_s, f"{found.crc:08x}")
    if csv is not None:
        reference.to_csv(csv)
    say(json, _document(reference, found.crc, []), f"{reference.name}: {_line(reference)}")


@dataclass(frozen=True)
class _Known:
    """What a reference is checked against; ``identified`` None: the fish was not identified, but
    ``fish`` may know it from trials. None: nothing is known of it."""

    limits: Limits
    amplitude_max_rad: float
    identified: Identified | None
    fish: KnownFish | None


@app.command()
def check(
    what: What,
    suggest: Annotated[
        bool, typer.Option("--suggest", help="Write the nearest reference the fish can follow.")
    ] = False,
    identified: Annotated[
        Path | None,
        typer.Option("--identified", help="What identify has written; default: the logbook's."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="CSV for --suggest; default: NAME-feasible.csv.")
    ] = None,
    amp_max: Annotated[
        float | None,
        typer.Option("--amp-max", metavar="RAD", help="Largest amplitude; default: the board's."),
    ] = None,
    tank: Annotated[
        float | None,
        typer.Option("--tank", metavar="M", help="Length of the tank; default: the board's."),
    ] = None,
    slew: Annotated[
        float | None,
        typer.Option(
            "--slew", metavar="RAD", help="Largest change per beat for the floor; default: any."
        ),
    ] = None,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Check a reference against the board's limits, the tank and what the fish can do.

    Of an identified fish the floor is told: the smallest max|e| of any input, where and why. With
    --identified and --amp-max no board is asked. Once one trial is in the trial library, it tells
    how many beats will be at the amplitude limit.

    Example: tailbeat reference check thesis --suggest
    """
    from tailbeat.experiment.current import named_reference
    from tailbeat.learning.error_bound import band

    reference = named_reference(what)
    known = _known(identified, amp_max, tank, connect)
    problems = reference.check(known.limits)
    found = known.identified and band(known.identified, reference, known.amplitude_max_rad, slew)
    document = _document(reference, reference.crc, problems)
    document["floor"] = floor_document(found) if found else None
    saturation = _expected(known, reference)
    document["saturation"] = saturation
    lines = [f"fits: {_line(reference)}"] if not problems else [str(p) for p in problems]
    if saturation is not None:
        lines.append(saturation.text)
    if found and known.identified:
        lines.append(floor_text(found, known.identified.assumed))
    else:
        lines.append(_UNKNOWN)
    if suggest:
        document["suggestion"], text = _suggested(reference, known, out)
        lines.append(text)
    elif found and (hint := advice(found, what)):
        lines.append(hint)
    if json or suggest or not problems:
        say(json, document, "\n".join(lines))
    if not suggest:
        _refuse(problems)


_UNKNOWN = "floor unknown: this fish has not been identified (tailbeat identify)"


def _expected(known: _Known, reference: Reference) -> Saturation | None:
    from tailbeat.learning.saturation import expected_saturation

    if known.fish is None:
        return None
    return expected_saturation(known.fish, reference, {"AMP_MAX_RAD": known.amplitude_max_rad})


def _known(
    path: Path | None, amp_max: float | None, tank: float | None, connect: str | None
) -> _Known:
    from tailbeat.core.reference import Limits
    from tailbeat.experiment.library import logbook_of
    from tailbeat.learning.identification import Identified
    from tailbeat.learning.saturation import known_fish

    swims: list[Swim] = []
    loaded = Identified.load(path) if path is not None else None
    if loaded is not None and amp_max is not None:
        limits = Limits()
    else:
        with connected(connect) as fish:
            limits = _limits(fish)
            if amp_max is None:
                amp_max = fish.params.get("AMP_MAX_RAD").value
            if loaded is None and (logbook := logbook_of(fish)) is not None:
                loaded = logbook.identified()
                swims = logbook.swims() if loaded is None else []
    if tank is not None:
        limits = replace(limits, tank_m=tank)
    return _Known(limits, amp_max, loaded, known_fish(loaded, swims))


def _suggested(reference: Reference, known: _Known, out: Path | None) -> tuple[dict[str, Any], str]:
    from tailbeat.core.errors import InputError
    from tailbeat.learning import feasible

    if known.identified is None:
        raise InputError(
            "what this fish can follow is not known: it has not been identified.",
            "Run tailbeat identify, or name a file with --identified.",
        )
    found = feasible.suggest(known.identified, reference, known.amplitude_max_rad, known.limits)
    path = out or Path(f"{reference.name}-feasible.csv")
    found.to_csv(path)
    return suggestion_document(found, str(path)), suggestion_text(found, str(path))
