"""reference upload, show, check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from tailbeat.app.cli._fish import Connect, ConnectedFish, connected
from tailbeat.app.cli._lazy import arg, opt
from tailbeat.app.cli._options import (
    IdentifiedFile,
    reference_names,
    sound_identified,
    warn_if_another,
)
from tailbeat.app.cli._terminal import Output, bytes_bar, command_typed, lines_of, pick, warn
from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError
from tailbeat.core.faults import NO_REFERENCE, refusal
from tailbeat.core.printable import amplitude_rows, mm
from tailbeat.core.records import decode_reference
from tailbeat.core.reference import Reference, ReferenceLimits, ReferenceProblem
from tailbeat.experiment.current import named_reference
from tailbeat.experiment.library import known_fish_of, library_of, name_reference
from tailbeat.learning.error_bound import ErrorBoundRange, Miss, Suggestion, error_bound_range
from tailbeat.learning.error_bound import suggest as suggest_feasible
from tailbeat.learning.identification import Identified
from tailbeat.learning.saturation import KnownFish, expected_saturation, known_fish
from tailbeat.session.transfer import TransferPlan, plan, upload_transfer

_BOUND_FINE_M_S = 0.002


def _bound_document(around: ErrorBoundRange) -> dict[str, Any]:
    """Keys of ``reference check --json`` under ``floor``."""
    return {
        **pick(around.bound, "minimax_m_s", "lsq_max_abs_m_s", "lsq_rms_m_s", "spots"),
        "lsq_max_abs_band_m_s": around.lsq_max_abs_m_s,
        "minimax_band_m_s": around.minimax_m_s,
        "minimax_input_rad": around.bound.minimax_input,
        "lsq_input_rad": around.bound.lsq_input,
    }


def _bound_lines(around: ErrorBoundRange, assumed: Sequence[str]) -> list[str]:
    """One line, and one for each place where the reference cannot be reached. ``assumed``: what of
    the fish was not identified."""
    found, (low, high) = around.bound, around.minimax_m_s
    lines = [
        f"error bound {mm(found.minimax_m_s)} mm/s ({mm(low)} to {mm(high)}); "
        f"the L2-optimal input leaves {mm(found.lsq_max_abs_m_s)}",
        *map(_spot_text, found.spots),
    ]
    if assumed:
        rests = f"  it rests on an assumed {', '.join(assumed)}: identify it with trials"
        lines.append(f"{rests} (tailbeat session identify)")
    return lines


def _spot_text(spot: Miss) -> str:
    where = f"beat {spot.first}" if spot.first == spot.last else f"beats {spot.first}-{spot.last}"
    way = "slow" if spot.error_m_s > 0 else "fast"
    return f"  {where}: up to {mm(abs(spot.error_m_s))} mm/s too {way}: {spot.why}"


def _upload_warm(
    fish: Fish, reference: Reference, old: str, identified: Identified | None, dry_run: bool
) -> Output:
    """Uploads the reference and amplitudes for it, or prints them."""
    book = library_of(fish)
    if identified is None and book is not None:
        identified = sound_identified(book)
    unique_id = fish.unique_id()
    if identified is not None:
        warn_if_another(identified, unique_id)
    found = plan(fish, old, reference, identified, book)
    if found.learned.unique_id not in ("", unique_id):
        warn(f"learned by another fish ({found.learned.unique_id})")
    document = _document(reference) | {"like": found.as_dict(), "copy": None, "dry_run": dry_run}
    words = f"{reference.name}: {_line(reference)}; {_words(found)}"
    if dry_run:
        warn(f"would upload {words}")
        return Output(document, amplitude_rows(found.transferred.amplitude_rad))
    with bytes_bar("upload") as show:
        copy = upload_transfer(fish, found, book, show)
    name_reference(fish, reference)
    kept = f"; what the board had learned is kept in {copy}" if copy is not None else ""
    return Output(document | {"copy": copy}, f"uploaded {words}{kept}")


def _words(found: TransferPlan) -> str:
    learned, done = found.learned, found.transferred
    error = learned.max_abs_error_m_s
    known = f" (max|e| {mm(error)} mm/s)" if error is not None else ""
    beats = f"{done.saturated_beats} beat{'' if done.saturated_beats == 1 else 's'}"
    return (
        f"like {learned.words}{known}: speed times {found.by.magnitude:.3g}, time divided by "
        f"{found.by.time_factor:.3g}, {beats} saturated, expected travel {found.travel_m:.2f} m"
    )


What = Annotated[
    Reference,
    arg(
        "thesis[:V,DURATION_S], trapezoid:V,RAMP_S,HOLD_S, cosine:V,RAMP_S,HOLD_S or a CSV "
        "with t_s,v_m_s (a curve's points) or beat,t_s,v_m_s (beat means, as written here).",
        "REFERENCE",
        autocompletion=reference_names,
        by=named_reference,
    ),
]


def _limits(fish: Fish) -> ReferenceLimits:
    names = ("REF_MAX_M_S", "TANK_LEN_M", "FISH_LEN_M")
    return ReferenceLimits.from_params(fish.params.values(*names))


def _document(reference: Reference, problems: Sequence[ReferenceProblem] = ()) -> dict[str, Any]:
    return {
        **pick(reference, "name", "beats", "beat_s", "travel_m", "speed_m_s", "crc"),
        "max_m_s": float(reference.speed_m_s.max()),
        "problems": problems,
    }


def _line(reference: Reference) -> str:
    return (
        f"{reference.beats} beats of {reference.beat_s:g} s, {reference.travel_m:.2f} m, "
        f"up to {mm(float(reference.speed_m_s.max()))} mm/s"
    )


def _refusal(problems: list[ReferenceProblem]) -> InputError | None:
    meaning = " ".join(problem.meaning for problem in problems)
    remedies = dict.fromkeys(problem.remedy for problem in problems)
    return InputError(meaning, " ".join(remedies)) if problems else None


def upload(
    reference: What,
    warm_start: str | None = opt(
        "Begin with what was learned along OLD, a reference of the same shape. OLD is board (what"
        " it holds now), a trial's file, an experiment's folder or a reference.",
        "OLD",
    ),
    dry_run: bool = opt("With --warm-start: print the amplitudes; change nothing."),
    identified: IdentifiedFile = None,
    connect: Connect = None,
) -> Output:
    """Check a reference against the board's limits and make it the board's.

    Another reference than the present one sets the iteration to 0. With --warm-start the first
    trial has amplitudes scaled from those along a reference of another magnitude or duration.

    Example: tailbeat reference upload thesis:0.0633,50 --warm-start board
    """
    if warm_start is None and (dry_run or identified is not None):
        raise typer.BadParameter("--dry-run and --identified are for --warm-start OLD")
    with connected(connect) as fish:
        if (refused := _refusal(reference.check(_limits(fish)))) is not None:
            raise refused
        if warm_start is not None:
            return _upload_warm(fish, reference, warm_start, identified, dry_run)
        with bytes_bar("upload") as show:
            fish.upload_reference(reference.record(), show)
        name_reference(fish, reference)
    return Output(_document(reference), f"uploaded {reference.name}: {_line(reference)}")


def show(
    fish: ConnectedFish,
    csv: Path | None = opt("Write the beats there."),
) -> Output:
    """Print the board's reference.

    Example: tailbeat reference show --csv reference.csv
    """
    if (record := fish.reference_record()) is None:
        raise refusal(NO_REFERENCE)
    found = decode_reference(record)
    reference = Reference(found.beat_s, found.speed_m_s, f"{found.crc:08x}")
    if csv is not None:
        reference.to_csv(csv)
    return Output(_document(reference), f"{reference.name}: {_line(reference)}")


@dataclass(frozen=True)
class _CheckedAgainst:
    """What a reference is checked against; ``identified`` None: the fish was not identified, but
    ``fish`` may know it from trials. None: nothing is known of it."""

    limits: ReferenceLimits
    amplitude_max_rad: float
    identified: Identified | None
    fish: KnownFish | None


def check(
    reference: What,
    suggest: bool = opt("Write the nearest feasible reference."),
    identified: IdentifiedFile = None,
    out: Path | None = opt("CSV for --suggest; default: NAME-feasible.csv."),
    amp_max: float | None = opt("Largest amplitude; default: the board's.", "RAD"),
    tank: float | None = opt("Length of the tank; default: the board's.", "M"),
    slew: float | None = opt("Largest change per beat for the error bound; default: any.", "RAD"),
    connect: Connect = None,
) -> Output:
    """Check a reference against the board's limits, the tank and the fish.

    For an identified fish the error bound is printed: the smallest achievable max|e|, where and
    why. With --identified and --amp-max no board is asked. Once one trial is in the trial library,
    it also tells how many beats will be at the amplitude limit.

    Example: tailbeat reference check thesis --suggest
    """
    known = _known(identified, amp_max, tank, connect)
    problems = reference.check(known.limits)
    limit = known.amplitude_max_rad
    found, bound_lines, saturation = None, [_UNKNOWN], None
    if known.identified is not None:
        found = error_bound_range(known.identified, reference, limit, slew)
        bound_lines = _bound_lines(found, known.identified.assumed)
    if known.fish is not None:
        slower = "the suggested one" if suggest else f"{command_typed()} --suggest"
        saturation = expected_saturation(known.fish, reference, {"AMP_MAX_RAD": limit}, slower)
    suggestion = _suggested(reference, known) if suggest else None
    beyond = found is not None and found.bound.lsq_max_abs_m_s > _BOUND_FINE_M_S and not saturation
    document = _document(reference, problems) | {
        "floor": found and _bound_document(found),
        "saturation": saturation,
    }
    lines = lines_of(
        map(str, problems) if problems else f"fits: {_line(reference)}",
        saturation and saturation.text,
        bound_lines,
    )
    if suggestion is not None:
        path = out or Path(f"{reference.name}-feasible.csv")
        suggestion.to_csv(path)
        document["suggestion"] = _suggestion_document(suggestion, path)
        return Output(document, lines_of(lines, _suggestion_lines(suggestion, path)))
    hint = f"a feasible reference for this fish: {command_typed()} --suggest" if beyond else None
    refused = _refusal(problems)
    return Output(document, "" if refused else lines_of(lines, hint), error=refused)


_UNKNOWN = "error bound unknown: this fish has not been identified (tailbeat session identify)"


def _known(
    identified: Identified | None, amp_max: float | None, tank: float | None, connect: str | None
) -> _CheckedAgainst:
    if identified is not None and amp_max is not None:
        limits, known = ReferenceLimits(), known_fish(identified, ())
    else:
        with connected(connect) as fish:
            limits = _limits(fish)
            if amp_max is None:
                amp_max = fish.params.get("AMP_MAX_RAD").value
            library = library_of(fish)
            if identified is None and library is not None:
                identified = library.identified()
            known = known_fish(identified, ()) if identified else known_fish_of(library)
    if tank is not None:
        limits = replace(limits, tank_m=tank)
    return _CheckedAgainst(limits, amp_max, identified, known)


def _suggested(reference: Reference, known: _CheckedAgainst) -> Suggestion:
    if known.identified is None:
        raise InputError(
            "what this fish can follow is not known: it has not been identified.",
            "Run tailbeat session identify, or name a file with --identified.",
        )
    return suggest_feasible(known.identified, reference, known.amplitude_max_rad, known.limits)


def _suggestion_document(found: Suggestion, path: Path) -> dict[str, Any]:
    document = pick(found.reference, "beats", "beat_s", "travel_m", "speed_m_s", "crc")
    return document | {"path": path, "floor_lsq_m_s": found.floor_m_s, "changes": found.changes}


def _suggestion_lines(found: Suggestion, path: Path) -> list[str]:
    made = found.reference
    return [
        f"suggested: {made.beats} beats, {made.travel_m:.2f} m, "
        f"the L2-optimal input leaves {mm(found.floor_m_s)} mm/s",
        *(f"  {change}" for change in found.changes),
        f"written to {path}; use it: tailbeat reference upload {path}",
    ]
