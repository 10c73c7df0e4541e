"""session design: gain, lead and filter for a fish, and what they will do."""

from __future__ import annotations

import math
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import typer

from tailbeat.app.cli._lazy import opt
from tailbeat.app.cli._options import Connect, IdentifiedFile, Plot, ReferenceName, connected
from tailbeat.app.cli._terminal import Output, pick
from tailbeat.board.fish import Fish, board_reference
from tailbeat.core.errors import InputError
from tailbeat.core.files import plain
from tailbeat.core.printable import mm
from tailbeat.core.reference import Reference, thesis
from tailbeat.experiment.current import named_reference, note_set
from tailbeat.experiment.library import TrialLibrary
from tailbeat.learning.design import Design, law_words
from tailbeat.learning.design import design as design_law
from tailbeat.learning.identification import Identified, from_table
from tailbeat.report.figures.convergence import draw_law


def design(
    identified: IdentifiedFile = None,
    table: Path | None = opt("Steady speeds: amplitude_rad,speed_m_s.", "CSV"),
    reference: ReferenceName = None,
    gain: float | None = opt("Judge this gain, rad per m/s."),
    lead: float | None = opt("Judge this lead: 0, 0.5, 1, ... beats."),
    q: int | None = opt("Length of the filter Q; 1 = none.", min=1),
    amplitude_max_rad: float | None = opt(
        "rad; default: the board's, or pi/4 without a board.",
        name="--amplitude-max",
        min=0.01,
        max=1.0471976,
        show_default=False,
    ),
    force: bool = opt("Also a law that does not learn."),
    apply: bool = opt("Make it the connected board's."),
    plot: Plot = None,
    connect: Connect = None,
) -> Output:
    """Choose gain, lead and filter for an identified fish, or assess given ones.

    The fish: a file, a table of steady speeds, or what the trial library has of the connected one.
    Without --apply nothing changes on the board.

    Example: tailbeat session design --table amplitude.csv --gain 4
    """
    if identified is not None and table is not None:
        raise typer.BadParameter("--identified and --table exclude each other")
    needs_fish = apply or (identified is None and table is None)
    with connected(connect) if needs_fish else nullcontext() as fish:
        known = _identified(identified, table, fish)
        chosen = _reference(reference, fish)
        step_rad = fish.params.get("DU_MAX_RAD").value if fish else 0.0
        if amplitude_max_rad is None:
            amplitude_max_rad = fish.params.get("AMP_MAX_RAD").value if fish else math.pi / 4
        found = design_law(known, chosen, amplitude_max_rad, gain, lead, q, step_max_rad=step_rad)
        if found.refused and not force:
            remedy = f"Use --gain {found.static_gain_best:.2f}, or --force to insist."
            raise InputError(found.refused, remedy)
        if apply and fish is not None:
            _apply(fish, found)
        if plot is not None:
            _plot(plot, known, chosen, found)
    return Output(_document(found, chosen, known, apply), lambda: _text(found, apply))


def _identified(file: Path | None, table: Path | None, fish: Fish | None) -> Identified:
    if file is not None:
        return Identified.load(file)
    if table is not None:
        return from_table(table).identified

    known = TrialLibrary.of(fish.unique_id()).identified() if fish is not None else None
    if known is None:
        raise InputError(
            "this fish has not been identified.",
            "Run 'tailbeat session identify' first, or give --table CSV with steady speeds.",
        )
    return known


def _reference(text: str | None, fish: Fish | None) -> Reference:
    if text is not None:
        return named_reference(text)
    held = board_reference(fish) if fish is not None else None
    return held or thesis()


def _apply(fish: Fish, found: Design) -> None:
    """The certificate is for kd = 0, the last error held beyond the end, a constant gain and the
    last trial alone, so those go with it; older firmware knows only the last trial."""
    known = fish.params.list()
    law = {name: value for name, value in found.law.params().items() if name in known}
    note_set(fish, {name: fish.params.set(name, value).value for name, value in law.items()})


def _plot(path: Path, known: Identified, chosen: Reference, found: Design) -> None:
    thesis = design_law(
        known, chosen, found.law.amplitude_max_rad, 4.0, 0.0, 1, step_max_rad=found.law.step_max_rad
    )
    draw_law(found, thesis, path)


def _document(found: Design, chosen: Reference, known: Identified, applied: bool) -> dict[str, Any]:
    return {
        "gain_rad_s_m": found.law.kp_rad_s_m,
        **pick(found.law, "lead_beats", "q_len"),
        "reference": chosen.name,
        **pick(known, "source", "assumed"),
        "applied": applied,
        "worst_cycles": found.worst_cycles,
        **plain(found),
    }


def _text(found: Design, applied: bool) -> str:
    medians = " ".join(mm(float(value)) for value in found.series.median_m_s)
    lines = [
        f"law        {law_words(found.law)}",
        f"steady     errors become {found.ratio_dc:.2f} of themselves per trial; gain "
        f"{found.static_gain_best:.2f} does best, below {found.static_gain_max:.2f} they shrink",
        f"worst      {_worst(found)}",
        f"proved     {_proved(found)}",
        f"simulated  max|e| {medians} mm/s from iteration 0 on (medians)",
        f"           90 % of the last: {mm(float(found.series.low_m_s[-1]))} to "
        f"{mm(float(found.series.high_m_s[-1]))} mm/s",
        f"bound      {mm(found.floor_m_s)} mm/s by the model: noise aside, no law does much better",
    ]
    if found.refused:
        lines.append(f"forced     {found.refused.rstrip('.')}")
    lines += [f"warning    {line}" for line in found.warnings]
    if applied:
        lines.append(
            "applied    it is the board's now, with ILC_KD, ILC_END_EXT, ILC_DECR_RATE and "
            "ILC_KIND 0; 'tailbeat params save' makes it last"
        )
    return "\n".join(lines)


def _worst(found: Design) -> str:
    low, high = (speed * 1e3 for speed in found.speeds_m_s)
    models = f"any of {found.models} models" if found.models > 2 else "the model"
    return (
        f"{found.ratio_max:.2f} per trial at {found.worst_cycles:.2f} cycles/beat, by {models} at "
        f"{low:.0f} to {high:.0f} mm/s; {found.ratio_slow:.2f} at less, down to "
        f"{found.slow_from_m_s * 1e3:.0f} mm/s"
    )


def _proved(found: Design) -> str:
    if not found.input_ratio < 1:
        return (
            "nothing of the saturated law: one step may take amplitudes away from the fixed point "
            f"(norm {found.input_ratio:.2f})"
        )
    return (
        "of the saturated law, for small errors outside the dead zone: one step leaves at most "
        f"{found.input_ratio:.2f} of the amplitudes' distance from the fixed point when the "
        f"{found.input_beats} beats of that speed are off; not that all further steps do"
    )
