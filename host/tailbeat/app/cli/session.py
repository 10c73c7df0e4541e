"""session first, resume, status."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.app.cli._options import (
    CalibrationOption,
    CameraOption,
    LatencyOption,
    MarkerIdOption,
    MarkerKindOption,
    MarkerSideOption,
    WallOption,
    marker_of,
    reference_names,
)
from tailbeat.app.cli._terminal import Connect, Json, command_typed, connected, say
from tailbeat.core.errors import InputError

if TYPE_CHECKING:
    from tailbeat.app.cli._display import Display
    from tailbeat.app.cli._keyboard import Keys
    from tailbeat.app.cli._operator import TerminalPerson
    from tailbeat.board.fish import Fish
    from tailbeat.experiment.folder import Experiment
    from tailbeat.session.commission import Step
    from tailbeat.session.resume import Restored

app = typer.Typer(no_args_is_help=True, help="A day at the tank: first session, battery swap.")

IntoOption = Annotated[
    Path | None,
    typer.Option("--into", metavar="FOLDER", help="The experiment; default: the one it is in."),
]
RestOption = Annotated[
    float | None,
    typer.Option(
        "--rest", min=0.0, max=3600.0, metavar="S", help="Rest since the last swim; default: 30."
    ),
]
Yes = Annotated[bool, typer.Option("--yes", help="Answer every question with yes.")]


@app.command()
def first(
    reference: Annotated[
        str,
        typer.Option(
            "--reference",
            help="What it is to swim, as for 'reference upload'.",
            autocompletion=reference_names,
        ),
    ] = "thesis",
    rest: RestOption = None,
    yes: Yes = False,
    camera: CameraOption = None,
    calibration: CalibrationOption = None,
    marker: MarkerKindOption = "aruco",
    marker_id: MarkerIdOption = None,
    marker_side: MarkerSideOption = None,
    latency: LatencyOption = 0.0,
    wall: WallOption = None,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """A fish that nobody knows yet: look it over, trim, identify, design, raise its limits.

    Begins with the board's careful defaults. Each limit rises in small steps, each with its reason
    and after a short swim has proved it; a step that fails leaves the limits where they were. Asks
    before every swim and before anything is raised.

    Example: tailbeat session first --reference thesis --camera 0 --calibration tank.json
    """
    from tailbeat.app.cli._live_camera import LiveOptions, live_camera
    from tailbeat.experiment.current import named_reference

    wanted = named_reference(reference)
    on_fish = marker_of(marker, marker_id, marker_side)
    options = LiveOptions(camera, on_fish, calibration, latency, None, wall).check()
    with connected(connect) as fish, live_camera(fish, options) as live, _Terminal(json) as there:
        from tailbeat.session.commission import first_session
        from tailbeat.session.preflight.step import Wanted

        display, keys = there
        ritual = Wanted() if rest is None else Wanted(rest_s=rest)
        person = _person(display, keys, yes)
        steps = []
        for step in first_session(fish, wanted, person, live.camera, live.guard, ritual):
            display.keep(_step_text(step))
            steps.append(step)
        limits = {name: fish.params.get(name).value for name in ("AMP_MAX_RAD", "DU_MAX_RAD")}
    well = steps[-1].done
    say(json, {"ok": well, "steps": steps, "params": limits}, _last_words(steps, limits))
    if not well:
        raise typer.Exit(1)


@app.command()
def resume(
    into: IntoOption = None,
    another_board: Annotated[
        bool, typer.Option("--another-board", help="The fish's board was replaced by this one.")
    ] = False,
    repeat: Annotated[
        bool, typer.Option("--repeat/--no-repeat", help="Swim the best once to tell the shift.")
    ] = True,
    rest: RestOption = None,
    yes: Yes = False,
    camera: CameraOption = None,
    calibration: CalibrationOption = None,
    marker: MarkerKindOption = "aruco",
    marker_id: MarkerIdOption = None,
    marker_side: MarkerSideOption = None,
    latency: LatencyOption = 0.0,
    wall: WallOption = None,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """After a battery swap: give the board back what it knew, repeat the best, tell the shift.

    The repeat is not learned from; the amplitudes that were to swim next swim next. Exit status 0
    when learning may go on, 1 when the fish is to be trimmed or identified first.

    Example: tailbeat session resume --camera 0 --calibration tank.json
    """
    from tailbeat.app.cli._live_camera import LiveOptions, live_camera

    _require_folder(into)
    on_fish = marker_of(marker, marker_id, marker_side)
    options = LiveOptions(camera, on_fish, calibration, latency, None, wall).check()
    with connected(connect) as fish, live_camera(fish, options) as live, _Terminal(json) as there:
        from tailbeat.session.resume import restore

        display, keys = there
        if (experiment := _to_resume(fish, into)) is None:
            if another_board:
                raise _in_none(fish)
            _put_back_alone(fish, json)
            return
        restored = restore(fish, experiment, another_board)
        for line in _restored_lines(restored, experiment):
            display.keep(line)
        document: dict[str, Any] = {"experiment": experiment.folder, "restored": restored}
        if not repeat or fish.status().best_iteration is None:
            why = "" if repeat else " (--no-repeat)"
            text = f"nothing to repeat{why}; go on: tailbeat trial run"
            say(json, document | {"trial": None, "shift": None}, text)
            return
        person = _person(display, keys, yes, repeats=True)
        shift = _repeated(fish, experiment, person, live, rest)
    lines = [shift.words, f"the amplitudes of iteration {restored.iteration} swim next, as before"]
    say(json, document | {"trial": shift.repeat_trial, "shift": shift}, "\n".join(lines))
    if shift.remedy in ("trim", "identify"):
        raise typer.Exit(1)


@app.command()
def status(into: IntoOption = None, connect: Connect = None, json: Json = False) -> None:
    """Which experiment the fish is in, and where it stands: best, battery, verdict, limits.

    Example: tailbeat session status
    """
    from tailbeat.session.status import standing_of, words

    _require_folder(into)
    with connected(connect) as fish:
        found = standing_of(fish, _experiment(fish, into))
    say(json, found, lambda: "\n".join(words(found)))


def _repeated(
    fish: Fish, experiment: Experiment, person: TerminalPerson, live: Any, rest: float | None
) -> Any:
    from tailbeat.session.preflight.step import Wanted
    from tailbeat.session.repeat import repeat_best
    from tailbeat.session.series import Options

    wanted = Wanted() if rest is None else Wanted(rest_s=rest)
    options = Options(wanted=wanted, typed=command_typed())
    return repeat_best(fish, experiment, person, options, live.camera, live.guard)[1]


def _require_folder(into: Path | None) -> None:
    """Before anything is connected."""
    from tailbeat.experiment.folder import Experiment

    if into is not None:
        Experiment.open(into)


def _found(fish: Fish, into: Path | None) -> Experiment | None:
    from tailbeat.experiment.current import current
    from tailbeat.experiment.folder import Experiment

    return Experiment.open(into) if into is not None else current(fish)


def _to_resume(fish: Fish, into: Path | None) -> Experiment | None:
    """The one that was named, or the one the fish is in; None when the board has been given another
    reference than that one's since, and no experiment of it has begun."""
    from tailbeat.experiment.current import is_interrupted, swims_for

    found = _found(fish, into)
    if into is not None or is_interrupted(fish) or fish.status().reference_crc is None:
        return found
    return swims_for(fish)


def _experiment(fish: Fish, into: Path | None) -> Experiment:
    if (found := _found(fish, into)) is None:
        raise _in_none(fish)
    return found


def _in_none(fish: Fish) -> InputError:
    return InputError(
        f"this fish ({fish.unique_id()}) is in no experiment.",
        "Name it: --into FOLDER (tailbeat experiment list), or begin one: tailbeat trial run",
    )


def _put_back_alone(fish: Fish, json: bool) -> None:
    """A fish that swims for no experiment: what a trim or an identification has left can be put
    back, and what commands have set."""
    from tailbeat.board.preserve import restore_interrupted
    from tailbeat.experiment.current import current
    from tailbeat.experiment.library import logbook_of, preserve_folder
    from tailbeat.session.resume import restore_params

    notes: list[str] = []
    put_back = restore_interrupted(fish, preserve_folder(logbook_of(fish)), notes.append)
    params, refused = restore_params(fish)
    if not put_back and not params and current(fish) is None:
        raise _in_none(fish)
    lines = [f"{note}; it has it back" for note in notes] + refused
    lines += [f"given back: {name} {now:g} (it had {was:g})" for name, (was, now) in params.items()]
    lines.append("no experiment of this reference has begun: nothing to repeat; tailbeat trial run")
    say(json, {"experiment": None, "params": params, "notes": notes + refused}, "\n".join(lines))


class _Terminal:
    """Display and keys, both put back at the end."""

    def __init__(self, quiet: bool) -> None:
        from contextlib import ExitStack

        self._quiet, self._stack = quiet, ExitStack()

    def __enter__(self) -> tuple[Display, Keys | None]:
        from tailbeat.app.cli._display import Display
        from tailbeat.app.cli._keyboard import terminal_keys

        display = self._stack.enter_context(Display(quiet=self._quiet))
        keys = self._stack.enter_context(terminal_keys())
        return display, keys if display.moves else None

    def __exit__(self, *what: Any) -> None:
        self._stack.__exit__(*what)


def _person(
    display: Display, keys: Keys | None, yes: bool, repeats: bool = False
) -> TerminalPerson:
    """``yes``: every answer is yes. ``repeats``: of a swim only whether it counts is asked."""
    from tailbeat.app.cli._operator import COUNTS, KINDS, TerminalPerson
    from tailbeat.session.operator import Decision

    class Agreeing(TerminalPerson):
        def confirm(self, question: str) -> bool:
            return True

    then = Decision("keep") if yes and repeats else None
    kinds = COUNTS if repeats else KINDS
    return (Agreeing if yes else TerminalPerson)(display, keys, then, kinds=kinds)


def _step_text(step: Step) -> str:
    return f"{'ok' if step.done else '--'}  {step.name}: {step.words}"


def _last_words(steps: list[Step], limits: dict[str, float]) -> str:
    last = steps[-1]
    if not last.done:
        return f"ended at {last.name}; AMP_MAX_RAD is {limits['AMP_MAX_RAD']:.2f}"
    return (
        f"ready: AMP_MAX_RAD {limits['AMP_MAX_RAD']:.2f}, DU_MAX_RAD {limits['DU_MAX_RAD']:.2f}, "
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
