"""start: from a connected fish to a report, step by step."""

from __future__ import annotations

import sys
import webbrowser
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from tailbeat.app.cli._camera import LiveCamera, TankCameraOptions, live_camera
from tailbeat.app.cli._fish import Connect, Stream, connected
from tailbeat.app.cli._lazy import opt
from tailbeat.app.cli._operator import Rest, TerminalOperator, terminal
from tailbeat.app.cli._options import Yes, reference_names
from tailbeat.app.cli._terminal import Output, command_typed, json_asked, lines_of, warn
from tailbeat.app.cli.trial_run import GOOD_ENDS, experiment_for, keep_alive, series_document
from tailbeat.board.fish import Fish
from tailbeat.core.reference import Reference
from tailbeat.experiment.current import named_reference
from tailbeat.experiment.redo import write_redo
from tailbeat.link.messages import SIMULATED_FISH
from tailbeat.report.paper import write_report
from tailbeat.session.next_law import LawName
from tailbeat.session.options import Options, Until
from tailbeat.session.outcome import Decision
from tailbeat.session.preflight_step import PreflightLimits
from tailbeat.session.presenter import result
from tailbeat.session.start import REPORT, StartEnd, StartOptions, run_start


def start(
    *,
    reference: Reference | None = opt(
        "What to learn, as for 'reference upload'; default: the board's, else thesis.",
        "NAME|CSV",
        autocompletion=reference_names,
        by=named_reference,
        show_default=False,
    ),
    until: Until | None = opt(
        "Run trials until then; default: converged.", "converged|battery|N", by=Until.parse
    ),
    law: LawName = opt(
        "Of the inputs; auto: model-based once a model predicts the fish, else P.",
        "auto|model|p",
        default="auto",
    ),
    anew: bool = opt("Measure the fish again, though it is known.", name="--anew"),
    rest: Rest = None,
    yes: Yes = False,
    open_: bool = opt("Show the report in a browser.", name="--open/--no-open", default=True),
    stream: Stream = None,
    camera: TankCameraOptions,
    connect: Connect = None,
) -> Output:
    """Lead through the whole job: health, commissioning, reference, trials, report.

    Each step says why, how long it takes and what to press. What is done already is skipped, so the
    same command continues an interrupted job. --yes answers the questions of a simulated fish; on
    any other it stops before the tail moves.

    Example: tailbeat start --connect sim --yes
    """
    camera.check()
    series = Options(
        until=until or Until(None, converged=True),
        wanted=rest or PreflightLimits(),
        typed=command_typed(),
        law=law,
    )
    fish_here = connected(connect, stream=stream)
    with fish_here as fish, live_camera(fish, camera) as live, terminal() as there:
        asked = StartOptions(reference, series, anew=anew)
        end = _run(fish, live, there, asked, yes)
        if _is_reported(end):
            there[0].keep(result(REPORT))
    page = _report(end, open_)
    status = _status(end)
    if end.series is not None and status:
        warn(end.series.words)
    return Output(_document(end, page), lambda: _text(end, page), status)


def _run(fish: Fish, live: LiveCamera, there: Any, options: StartOptions, yes: bool) -> StartEnd:
    display, keys = there
    simulated = fish.info().board in SIMULATED_FISH
    agrees = yes and simulated
    operator = TerminalOperator(
        display,
        None if yes else keys,
        Decision("keep") if agrees else None,
        partial(keep_alive, fish),
        on_event=live.follow,
        agrees=agrees,
    )
    asks = keys is not None and not yes
    folder = partial(experiment_for, fish, None, lambda text: display.keep(text, loud=True))
    series = replace(options.series, proposes=asks)
    given = replace(options, series=series, acts=agrees or asks)
    return run_start(fish, operator, given, folder, live.camera, live.guard)


def _is_reported(end: StartEnd) -> bool:
    return end.experiment is not None and end.series is not None and bool(end.series.rounds)


def _report(end: StartEnd, show: bool) -> Path | None:
    """The page of the experiment; in a browser where there is a person to look at it."""
    if not _is_reported(end):
        return None
    assert end.experiment is not None
    page = write_report(end.experiment).page
    write_redo(end.experiment)
    if show and not json_asked.get() and sys.stderr.isatty():
        webbrowser.open(page.resolve().as_uri())
    return page


def _status(end: StartEnd) -> int:
    why = "" if end.series is None else end.series.why
    return 0 if why in (*GOOD_ENDS, "battery") else 130 if why == "interrupted" else 1


def _document(end: StartEnd, page: Path | None) -> dict[str, Any]:
    steps = [{"name": one.name, "done": one.done, "words": one.words} for one in end.steps]
    series = {} if end.series is None else series_document(end.series)
    folder = end.experiment.folder if end.experiment is not None else None
    return {"steps": steps, "experiment": folder, "report": page, **series}


def _text(end: StartEnd, page: Path | None) -> str:
    if end.series is None:
        return f"ended at {end.steps[-1].name}; begin again with the same command"
    return lines_of(end.series.text, page and f"report {page}")
