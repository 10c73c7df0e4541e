"""How a floor and a suggested reference are told: as a document and in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tailbeat.app.cli._terminal import mm

if TYPE_CHECKING:
    from tailbeat.learning.error_bound import Band, Spot
    from tailbeat.learning.feasible import Suggestion

_FLOOR_FINE_M_S = 0.002


def floor_document(band: Band) -> dict[str, Any]:
    """Keys of ``reference check --json`` under ``floor``."""
    found = band.floor
    return {
        "minimax_m_s": found.minimax_m_s,
        "lsq_max_abs_m_s": found.lsq_max_abs_m_s,
        "lsq_max_abs_band_m_s": band.lsq_max_abs_m_s,
        "lsq_rms_m_s": found.lsq_rms_m_s,
        "minimax_input_rad": found.minimax_input,
        "lsq_input_rad": found.lsq_input,
        "spots": found.spots,
    }


def floor_text(band: Band, assumed: Sequence[str] = ()) -> str:
    """One line, and one for each place where the reference cannot be reached. ``assumed``: what of
    the fish no run has told."""
    found, (low, high) = band.floor, band.lsq_max_abs_m_s
    lines = [
        f"floor (least squares) {mm(found.lsq_max_abs_m_s)} mm/s ({mm(low)} to {mm(high)} by what "
        f"is known of the fish), minimax {mm(found.minimax_m_s)}: no input can do better than that"
    ]
    lines += [f"  {_spot_text(spot)}" for spot in found.spots]
    if assumed:
        lines.append(
            f"  it rests on an assumed {', '.join(assumed)}: runs tell better (tailbeat identify)"
        )
    return "\n".join(lines)


def _spot_text(spot: Spot) -> str:
    where = f"beat {spot.first}" if spot.first == spot.last else f"beats {spot.first}-{spot.last}"
    way = "slow" if spot.error_m_s > 0 else "fast"
    return f"{where}: up to {mm(abs(spot.error_m_s))} mm/s too {way}: {spot.why}"


def advice(band: Band, what: str) -> str:
    """What to do about a floor of the reference ``what``; empty when it is fine."""
    if band.floor.lsq_max_abs_m_s <= _FLOOR_FINE_M_S:
        return ""
    return f"a reference this fish can follow: tailbeat reference check {what} --suggest"


def suggestion_document(found: Suggestion, path: str) -> dict[str, Any]:
    """Keys of ``reference check --suggest --json`` under ``suggestion``."""
    return {
        "path": path,
        "beats": found.reference.beats,
        "beat_s": found.reference.beat_s,
        "travel_m": found.reference.travel_m,
        "speed_m_s": found.reference.speed_m_s,
        "crc": found.reference.crc,
        "floor_lsq_m_s": found.floor_m_s,
        "changes": found.changes,
    }


def suggestion_text(found: Suggestion, path: str) -> str:
    """What was written, what it changes and how good it is."""
    reference = found.reference
    lines = [
        f"suggested: {reference.beats} beats, {reference.travel_m:.2f} m, "
        f"floor (least squares) {mm(found.floor_m_s)} mm/s",
        *(f"  {change}" for change in found.changes),
        f"written to {path}; use it: tailbeat reference upload {path}",
    ]
    return "\n".join(lines)
