"""session commission, trim, resume, status."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from tailbeat.app.cli._camera import CameraOptions, LiveCamera, TankCameraOptions, live_camera
from tailbeat.app.cli._experiment import experiment_of, in_no_experiment
from tailbeat.app.cli._lazy import opt
from tailbeat.app.cli._operator import COUNTS, KINDS, Keys, TerminalOperator, terminal
from tailbeat.app.cli._options import (
    Connect,
    Into,
    Rest,
    connected,
    preflight_limits,
    reference_names,
)
from tailbeat.app.cli._terminal import Display, Output, command_typed, json_asked, pick
from tailbeat.board.fish import Fish
from tailbeat.board.preserve import restore_interrupted
from tailbeat.core.errors import InputError
from tailbeat.experiment.current import current, experiment_for, is_interrupted, named_reference
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import library_of, preserve_folder
from tailbeat.session.commission import CommissionStep, commission_fish
from tailbeat.session.outcome import Decision
from tailbeat.session.preflight_step import PreflightLimits
from tailbeat.session.resume import Restored, repeat_best, restore, restore_params
from tailbeat.session.series import Options
from tailbeat.session.status import status_of, words
from tailbeat.session.trim import Trim, apply, find_centre

Yes = Annotated[bool, opt("Answer every question with yes.", name="--yes")]


def commission(
    *,
    reference: str = opt(
        "The reference, as for 'reference upload'.",
        autocompletion=reference_names,
        default="thesis",
    ),
    rest: Rest = None,
    yes: Yes = False,
    camera: TankCameraOptions,
    connect: Connect = None,
) -> Output:
    """Check, trim, identify and design for a new fish, then raise its limits.

    Begins with the careful defaults of the board. Each limit rises in small steps, each with its
    reason and after a short trial at that step; after a failed step the limits stay where they
    were. Asks before every trial and before anything is raised.

    Example: tailbeat session commission --reference thesis --camera 0 --calibration tank.json
    """
    profile = named_reference(reference)
    camera.check()
    with connected(connect) as fish, live_camera(fish, camera) as live, terminal() as there:
        display = there[0]
        operator = _operator(*there, yes)
        steps = []
        limits = preflight_limits(rest)
        for step in commission_fish(fish, profile, operator, live.camera, live.guard, limits):
            display.keep(f"{'ok' if step.done else '--'}  {step.name}: {step.words}")
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
    if into is not None:
        Experiment.open(into)
    camera.check()
    with connected(connect) as fish, live_camera(fish, camera) as live, terminal() as there:
        if (experiment := _to_resume(fish, into)) is None:
            if another_board:
                raise in_no_experiment(fish)
            return _restore_without_experiment(fish)
        restored = restore(fish, experiment, another_board)
        for line in _restored_lines(restored, experiment):
            there[0].keep(line)
        document: dict[str, Any] = {"experiment": experiment.folder, "restored": restored}
        if not repeat or fish.status().best_iteration is None:
            why = "" if repeat else " (--no-repeat)"
            text = f"nothing to repeat{why}; go on: tailbeat trial run"
            return Output(document | {"trial": None, "shift": None}, text)
        operator = _operator(*there, yes, repeats=True)
        given = Options(wanted=preflight_limits(rest), typed=command_typed())
        shift = repeat_best(fish, experiment, operator, given, live.camera, live.guard)[1]
    text = f"{shift.words}\nthe amplitudes of iteration {restored.iteration} swim next, as before"
    document |= {"trial": shift.repeat_trial, "shift": shift}
    return Output(document, text, status=int(shift.remedy in ("trim", "identify")))


def status(into: Into = None, connect: Connect = None) -> Output:
    """Print the current experiment, its best trial, battery, convergence and limits.

    Example: tailbeat session status
    """
    if into is not None:
        Experiment.open(into)
    with connected(connect) as fish:
        found = status_of(fish, Experiment.open(into) if into else experiment_of(fish))
    return Output(found, lambda: "\n".join(words(found)))


def _to_resume(fish: Fish, into: Path | None) -> Experiment | None:
    """The one that was named, or the one the fish is in; None when the board has been given another
    reference than that one's since, and no experiment of it has begun."""
    if into is not None:
        return Experiment.open(into)
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
    lines = [f"{note}; it has it back" for note in notes] + refused
    lines += [f"given back: {name} {now:g} (it had {was:g})" for name, (was, now) in params.items()]
    lines.append("no experiment of this reference has begun: nothing to repeat; tailbeat trial run")
    document = {"experiment": None, "params": params, "notes": notes + refused}
    return Output(document, "\n".join(lines))


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
        "saved; swim: tailbeat trial run"
    )


def _restored_lines(found: Restored, experiment: Experiment) -> list[str]:
    before = found.params_before
    given = [f"{name} {value:g} (it had {before[name]:g})" for name, value in found.params.items()]
    given += ["the reference"] if found.reference else []
    given += ["all that was learned"] if found.learned else []
    what = f"given back, as the experiment last had it: {', '.join(given)}"
    lines = [what if given else "the board lacks nothing"]
    lines += [f"tailbeat: {note}" for note in found.notes]
    lines.append(
        f"{experiment.name}: iteration {found.iteration} swims next, {found.battery_v:.2f} V"
    )
    if found.pending_trial is not None:
        lines.append(f"trial {found.pending_trial} waits on the board and is left alone")
    return lines


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
