"""session commission, trim, design, status, resume."""

from __future__ import annotations

import math
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import typer

from tailbeat.app.cli._camera import CameraOptions, LiveCamera, TankCameraOptions, live_camera
from tailbeat.app.cli._fish import Connect, ConnectedFish, connected
from tailbeat.app.cli._lazy import opt
from tailbeat.app.cli._operator import COUNTS, KINDS, Rest, TerminalOperator, terminal
from tailbeat.app.cli._options import (
    IdentifiedFile,
    Into,
    Plot,
    ReferenceName,
    Yes,
    experiment_of,
    in_no_experiment,
    reference_names,
)
from tailbeat.app.cli._terminal import Display, Output, command_typed, json_asked, lines_of, pick
from tailbeat.board.fish import Fish, board_reference
from tailbeat.board.preserve import restore_interrupted
from tailbeat.core.errors import InputError
from tailbeat.core.files import plain
from tailbeat.core.platform.terminal import Keys
from tailbeat.core.printable import mm
from tailbeat.core.reference import Reference, thesis
from tailbeat.experiment.current import (
    current,
    experiment_for,
    is_interrupted,
    named_reference,
    note_set,
)
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import TrialLibrary, library_of, preserve_folder
from tailbeat.learning.design import Design, law_words
from tailbeat.learning.design import design as design_law
from tailbeat.learning.identification import Identified, from_table
from tailbeat.report.figures.convergence import draw_law
from tailbeat.session.commission import CommissionStep, commission_fish
from tailbeat.session.options import Options
from tailbeat.session.outcome import Decision
from tailbeat.session.preflight_step import PreflightLimits
from tailbeat.session.resume import Restored, repeat_best, restore, restore_params
from tailbeat.session.status import status_of, words
from tailbeat.session.trim import Trim, apply, find_centre


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
        known = identified or _identified(table, fish)
        chosen = reference or (fish and board_reference(fish)) or thesis()
        step_rad = fish.params.get("DU_MAX_RAD").value if fish else 0.0
        if amplitude_max_rad is None:
            amplitude_max_rad = fish.params.get("AMP_MAX_RAD").value if fish else math.pi / 4
        limit_rad = amplitude_max_rad
        found = design_law(known, chosen, limit_rad, gain, lead, q, step_max_rad=step_rad)
        if found.refused and not force:
            remedy = f"Use --gain {found.static_gain_best:.2f}, or --force to insist."
            raise InputError(found.refused, remedy)
        if apply and fish is not None:
            _apply(fish, found)
        if plot is not None:
            of_thesis = design_law(known, chosen, limit_rad, 4.0, 0.0, 1, step_max_rad=step_rad)
            draw_law(found, of_thesis, plot)
    return Output(_document(found, chosen, known, apply), lambda: _text(found, apply))


def _identified(table: Path | None, fish: Fish | None) -> Identified:
    if table is not None:
        return from_table(table).identified
    known = TrialLibrary.of(fish.unique_id()).identified() if fish is not None else None
    if known is None:
        raise InputError(
            "this fish has not been identified.",
            "Run 'tailbeat session identify' first, or give --table CSV with steady speeds.",
        )
    return known


def _apply(fish: Fish, found: Design) -> None:
    """The certificate is for kd = 0, the last error held beyond the end, a constant gain and the
    last trial alone, so those go with it; older firmware knows only the last trial."""
    known = fish.params.list()
    law = {name: value for name, value in found.law.params().items() if name in known}
    note_set(fish, {name: fish.params.set(name, value).value for name, value in law.items()})


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
        f"L2-optimal {mm(found.floor_m_s)} mm/s by the model: noise aside, no law does much better",
    ]
    applied_words = (
        "applied    it is the board's now, with ILC_KD, ILC_END_EXT, ILC_DECR_RATE and "
        "ILC_KIND 0; 'tailbeat params save' makes it last"
    )
    warnings = [f"warning    {line}" for line in found.warnings]
    forced = found.refused and f"forced     {found.refused.rstrip('.')}"
    return lines_of(lines, forced, warnings, applied and applied_words)


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
        "for the saturated law and small errors outside the dead zone, in the "
        f"{found.input_beats} beats of that speed. One step leaves at most {found.input_ratio:.2f} "
        "of the amplitudes' distance from the fixed point. Later steps are not covered"
    )


def commission(
    *,
    reference: Reference = opt(
        "The reference, as for 'reference upload'.",
        autocompletion=reference_names,
        default="thesis",
        by=named_reference,
    ),
    rest: Rest = None,
    yes: Yes = False,
    camera: TankCameraOptions,
    connect: Connect = None,
) -> Output:
    """Check, trim and measure a new fish, offer it a limit, design its law.

    Runs three or more short trials, from the careful defaults of the board. The amplitude limit is
    offered only up to what a trial reached without a fault, and you type the number. Asks before
    every trial.

    Example: tailbeat session commission --reference thesis --camera 0 --calibration tank.json
    """
    camera.check()
    with connected(connect) as fish, live_camera(fish, camera) as live, terminal() as there:
        operator = _operator(*there, yes and fish.info().simulated)
        steps = []
        limits = rest or PreflightLimits()
        for step in commission_fish(fish, reference, operator, live.camera, live.guard, limits):
            operator.tell(step)
            steps.append(step)
        held = fish.params.values("AMP_MAX_RAD", "DU_MAX_RAD")
    well = steps[-1].done
    document = {"ok": well, "steps": steps, "params": held}
    return Output(document, _end_text(steps[-1], held), status=0 if well else 1)


def resume(
    *,
    into: Into = None,
    another_board: bool = opt("The fish's board was replaced by this one."),
    repeat: bool = opt(
        "Run the best trial once more, to measure the shift.",
        name="--repeat/--no-repeat",
        default=True,
    ),
    rest: Rest = None,
    yes: Yes = False,
    camera: TankCameraOptions,
    connect: Connect = None,
) -> Output:
    """Restore the board after a battery swap, repeat the best trial, print the shift.

    The repeat is not learned from; the feedforward input of the next trial stays. Exit status 0
    when learning may go on, 1 when the fish must be trimmed or identified first.

    Example: tailbeat session resume --camera 0 --calibration tank.json
    """
    camera.check()
    with connected(connect) as fish, live_camera(fish, camera) as live, terminal() as there:
        if (experiment := _to_resume(fish, into)) is None:
            if another_board:
                raise in_no_experiment(fish)
            return _restore_without_experiment(fish)
        restored = restore(fish, experiment, another_board)
        there[0].keep(_restored_lines(restored, experiment))
        document: dict[str, Any] = {"experiment": experiment.folder, "restored": restored}
        if not repeat or fish.status().best_iteration is None:
            why = "" if repeat else " (--no-repeat)"
            text = f"nothing to repeat{why}; go on: tailbeat trial run"
            return Output(document | {"trial": None, "shift": None}, text)
        operator = _operator(*there, yes, repeats=True)
        given = Options(wanted=rest or PreflightLimits(), typed=command_typed())
        shift = repeat_best(fish, experiment, operator, given, live.camera, live.guard)[1]
    text = f"{shift.words}\nthe input of iteration {restored.iteration} is next, as before"
    document |= {"trial": shift.repeat_trial, "shift": shift}
    return Output(document, text, status=int(shift.remedy in ("trim", "identify")))


def status(fish: ConnectedFish, into: Into = None) -> Output:
    """Print the current experiment, its best trial, battery, convergence and limits.

    Example: tailbeat session status
    """
    found = status_of(fish, into or experiment_of(fish))
    return Output(found, lambda: "\n".join(words(found)))


def _to_resume(fish: Fish, into: Experiment | None) -> Experiment | None:
    """The one that was named, or the one the fish is in; None when the board has been given another
    reference than that one's since, and no experiment of it has begun."""
    if into is not None:
        return into
    goes_on = is_interrupted(fish) or fish.status().reference_crc is None
    return current(fish) if goes_on else experiment_for(fish)


def _restore_without_experiment(fish: Fish) -> Output:
    """A fish that is in no experiment: what a trim or an identification has left can be put
    back, and what commands have set."""
    notes: list[str] = []
    put_back = restore_interrupted(fish, preserve_folder(library_of(fish)), notes.append)
    params, refused = restore_params(fish)
    if not put_back and not params and current(fish) is None:
        raise in_no_experiment(fish)
    document = {"experiment": None, "params": params, "notes": notes + refused}
    given = [f"given back: {name} {now:g} (it had {was:g})" for name, (was, now) in params.items()]
    nothing = "no experiment of this reference has begun: nothing to repeat; tailbeat trial run"
    text = lines_of([f"{note}; it has it back" for note in notes], refused, given, nothing)
    return Output(document, text)


def _operator(
    display: Display, keys: Keys | None, yes: bool, repeats: bool = False
) -> TerminalOperator:
    """``yes``: every answer is yes. ``repeats``: of a trial only whether it counts is asked."""
    then = Decision("keep") if yes and repeats else None
    kinds = COUNTS if repeats else KINDS
    return TerminalOperator(display, keys, then, kinds=kinds, agrees=yes)


def _end_text(last: CommissionStep, limits: dict[str, float]) -> str:
    amplitude_rad, step_rad = limits["AMP_MAX_RAD"], limits["DU_MAX_RAD"]
    if not last.done:
        return f"ended at {last.name}; AMP_MAX_RAD is {amplitude_rad:.2f}"
    return (
        f"ready: AMP_MAX_RAD {amplitude_rad:.2f}, DU_MAX_RAD {step_rad:.2f}, "
        "saved; next: tailbeat trial run"
    )


def _restored_lines(found: Restored, experiment: Experiment) -> str:
    before, trial = found.params_before, found.pending_trial
    given = [f"{name} {value:g} (it had {before[name]:g})" for name, value in found.params.items()]
    given += ["the reference"] * found.reference + ["all that was learned"] * found.learned
    what = f"restored as the experiment last had it: {', '.join(given)}"
    return lines_of(
        what if given else "the board lacks nothing",
        [f"tailbeat: {note}" for note in found.notes],
        f"{experiment.name}: iteration {found.iteration} is next, {found.battery_v:.2f} V",
        trial is not None and f"trial {trial} waits on the board and is left alone",
    )


def trim(
    *,
    to_apply: bool | None = opt(
        "Set SERVO_CENTRE_US to what is found, for good; default: asked.",
        name="--apply/--no-apply",
        show_default=False,
    ),
    yes: bool = opt("Do not ask before each trial."),
    rest: float = opt("Rest before each trial.", "S", min=0.0, max=3600.0, default=30.0),
    camera: CameraOptions,
    connect: Connect = None,
) -> Output:
    """Find the servo's centre by how the fish turns in two short trials.

    The tail's centre is set a little to either side and then restored; what the board has learned
    stays. Nothing is changed for good before you say so.

    Example: tailbeat session trim
    """
    camera.check()
    with connected(connect) as fish, live_camera(fish, camera) as live:
        found, held = _trimmed(fish, live, to_apply, yes, rest)
    return Output(_trim_document(found, held), lambda: _trim_text(found, held))


def _trimmed(
    fish: Fish, live: LiveCamera, to_apply: bool | None, yes: bool, rest_s: float
) -> tuple[Trim, float | None]:
    """What was found, and what is set now if it was applied."""
    alone = yes or fish.info().simulated
    with terminal() as (display, keys):
        if not alone and keys is None:
            raise InputError(
                "nobody can be asked before each trial here.",
                "Add --yes when the fish is free to swim twice by itself, or call it at a"
                " terminal.",
            )
        operator, limits = _operator(display, keys, alone), PreflightLimits(rest_s=rest_s)
        found = find_centre(fish, operator, live.camera, live.guard, limits)
        if to_apply is None and keys is not None and not json_asked.get():
            display.keep(found.text())
            to_apply = _operator(display, keys, False).confirm("Set it for good?")
        return found, apply(fish, found) if to_apply else None


def _trim_document(found: Trim, held: float | None) -> dict[str, Any]:
    return {
        **pick(found, "was_us", "centre_us", "sigma_us", "source", "swims"),
        "turn_before_rad_m": found.turn_rad(found.was_us, 1.0),
        "turn_sigma_rad_m": abs(found.turn_rad_m_us) * found.sigma_us,
        "applied": held is not None,
        "held_us": held,
    }


def _trim_text(found: Trim, held: float | None) -> str:
    if held is not None:
        return f"{found.text()}\nset for good: SERVO_CENTRE_US {held:.1f}"
    return (
        f"{found.text()}\nnothing was changed; to set it: tailbeat params set SERVO_CENTRE_US "
        f"{found.centre_us:.1f}, tailbeat params save"
    )
