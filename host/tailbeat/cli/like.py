"""reference upload --like."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from tailbeat.cli.common import echo, mm, progress_bar, say
from tailbeat.cli.keeping import sound_identified, told_if_another

if TYPE_CHECKING:
    from tailbeat.fish import Fish
    from tailbeat.reference import Reference
    from tailbeat.transfer.upload import Plan


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
    from tailbeat.logbook import logbook_of, name_reference
    from tailbeat.model.identified import Identified
    from tailbeat.transfer.upload import carry, plan

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
