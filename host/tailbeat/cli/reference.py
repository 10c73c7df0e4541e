"""reference upload, show, check."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.cli.common import Connect, Json, connected, mm, progress_bar, say

if TYPE_CHECKING:
    from tailbeat.fish import Fish
    from tailbeat.reference import Limits, Problem, Reference

app = typer.Typer(no_args_is_help=True, help="The wanted speed per beat.")

What = Annotated[
    str,
    typer.Argument(
        metavar="REFERENCE",
        help="thesis, trapezoid:V,RAMP_S,HOLD_S, cosine:V,RAMP_S,HOLD_S or a CSV with t_s,v_m_s.",
    ),
]


def _limits(fish: Fish) -> Limits:
    from tailbeat.reference import Limits

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
    from tailbeat.errors import InputError

    if problems:
        raise InputError(
            " ".join(problem.meaning for problem in problems),
            " ".join(dict.fromkeys(problem.remedy for problem in problems)),
        )


@app.command()
def upload(what: What, connect: Connect = None, json: Json = False) -> None:
    """Check a reference against the board's limits and make it the board's.

    Another reference than the board has sets the iteration to 0.

    Example: tailbeat reference upload thesis
    """
    from tailbeat.reference import from_text

    reference = from_text(what)
    with connected(connect) as fish:
        _refuse(reference.check(_limits(fish)))
        with progress_bar(json, "upload") as show:
            crc = fish.upload_reference(
                reference.record(), lambda done, total: show(done / max(total, 1), "")
            )
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
    from tailbeat.faults import NO_REFERENCE, refusal
    from tailbeat.records import decode_reference
    from tailbeat.reference import Reference

    with connected(connect) as fish:
        record = fish.reference_record()
    if record is None:
        raise refusal(NO_REFERENCE)
    found = decode_reference(record)
    reference = Reference(found.beat_s, found.speed_m_s, f"{found.crc:08x}")
    if csv is not None:
        reference.to_csv(csv)
    say(json, _document(reference, found.crc, []), f"{reference.name}: {_line(reference)}")


@app.command()
def check(what: What, connect: Connect = None, json: Json = False) -> None:
    """Check a reference against the board's limits and the tank, without uploading.

    Example: tailbeat reference check swim.csv
    """
    from tailbeat.reference import from_text

    reference = from_text(what)
    with connected(connect) as fish:
        problems = reference.check(_limits(fish))
    if json or not problems:
        say(json, _document(reference, reference.crc, problems), f"fits: {_line(reference)}")
    _refuse(problems)
