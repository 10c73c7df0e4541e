"""learn, law, speed upload."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from tailbeat.cli.common import TRIAL_MAX, Connect, Json, connected, echo, mm, say
from tailbeat.cli.keeping import verdict_after_learning, verdict_text

_SPEED_SIGMA_M_S = 0.001  # of speeds that come without one

speed_app = typer.Typer(no_args_is_help=True, help="Speeds measured after the swim.")


def learn(
    number: Annotated[
        int | None,
        typer.Argument(min=1, max=TRIAL_MAX, metavar="[TRIAL]", help="Default: the pending one."),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Compute the same numbers here; change nothing.")
    ] = False,
    restore_best: Annotated[
        bool, typer.Option("--restore-best", help="Swim the best amplitudes so far next.")
    ] = False,
    law: Annotated[
        str, typer.Option("--law", metavar="p|model", help="model: this computer plans the next.")
    ] = "p",
    identified: Annotated[
        Path | None,
        typer.Option("--identified", metavar="FILE", help="With --law model: what identify wrote."),
    ] = None,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Let the board learn from the trial that waits for it.

    With --law model the next amplitudes come from the identified fish, re-fitted on all its swims;
    without a trial that waits they are planned from what is known. In an experiment the trial is
    kept: its log, the decision and what was learned are written down there.

    Example: tailbeat learn --law model
    """
    if dry_run and restore_best:
        raise typer.BadParameter("--dry-run and --restore-best exclude each other")
    if law not in ("p", "model"):
        raise typer.BadParameter("--law is p or model")
    if identified is not None and law != "model":
        raise typer.BadParameter("--identified is for --law model")
    if restore_best and law == "model":
        raise typer.BadParameter("--restore-best and --law model exclude each other")
    with connected(connect) as fish:
        if law == "model":
            from tailbeat.cli.modelled import learn_with_model

            learn_with_model(fish, number, identified, dry_run, json)
            return
        if dry_run:
            from tailbeat.dryrun import dry_run as compute

            found = compute(fish, number)
            say(json, found.as_dict(), found.text)
            return
        if restore_best:
            from tailbeat.day.bycommand import restore_best_noted

            restore_best_noted(fish)
            held = fish.amplitudes()
            text = f"the best amplitudes swim next, as iteration {held.iteration}"
            say(
                json,
                {"restored": True, "iteration": held.iteration, "amplitude_rad": held.values},
                text,
            )
            return
        from tailbeat.day.bycommand import learn_noted, not_noted
        from tailbeat.verdict import rollback_words
        from tailbeat.visits import never_corrected

        report = learn_noted(fish, number, "learn" + ("" if number is None else f" {number}"))
        held, visits = fish.amplitudes(), fish.visits()
        if line := not_noted(fish):
            echo(f"tailbeat: {line}", err=True)
        verdict = verdict_after_learning(fish, report.trial, report.rolled_back, json)
    document: dict[str, Any] = {**vars(report), "next_iteration": held.iteration}
    document["amplitude_rad"] = held.values
    document["visits"] = visits
    document["verdict"] = verdict
    text = f"learned from trial {report.trial}: max|e| {mm(report.max_abs_error_m_s)} mm/s"
    text += f", RMS {mm(report.rms_error_m_s)}" + (", the best so far" if report.improved else "")
    text += f"; {rollback_words()}" if report.rolled_back else ""
    missing = never_corrected(visits)
    say(json, document, text + (f"\n{missing}" if missing else "") + verdict_text(verdict))


def law(
    config: Annotated[Path, typer.Option("--config", help="LAW.json: fields of the law.")],
    amplitudes: Annotated[Path, typer.Option("--input", help="CSV beat,amplitude_rad.")],
    errors: Annotated[Path, typer.Option("--error", help="CSV beat,error_m_s; empty = none.")],
    json: Json = False,
) -> None:
    """Apply the learning law once, with the code the board runs.

    Example: tailbeat law --config law.json --input u.csv --error e.csv
    """
    from tailbeat import laws
    from tailbeat.beatcsv import read_column

    old = read_column(amplitudes, "amplitude_rad")
    error = read_column(errors, "error_m_s", gaps=True)
    chosen = laws.load(config)
    following, report = laws.update(
        chosen, old, [0.0 if e != e else e for e in error], [e == e for e in error]
    )
    document = {
        "law": chosen,
        "amplitude_rad": following,
        "applied_rad": laws.saturate(chosen, following),
        "report": report,
    }
    rows = [f"{beat},{float(value)!r}" for beat, value in enumerate(following)]
    say(json, document, "\n".join(["beat,amplitude_rad", *rows]))


@speed_app.command("upload")
def upload(
    number: Annotated[
        int, typer.Argument(min=1, max=TRIAL_MAX, metavar="TRIAL", help="The pending trial.")
    ],
    file: Annotated[Path, typer.Argument(metavar="SPEED.csv", help="t_s,v_m_s or beat,speed_m_s.")],
    sigma_m_s: Annotated[
        float | None,
        typer.Option("--sigma", help="Standard deviation of a beat's speed, m/s."),
    ] = None,
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Give the pending trial speeds measured after the swim, for example from a video.

    With t_s,v_m_s the speed is averaged over each beat; with beat,speed_m_s it is taken as it is
    and an empty cell means not measured. What 'camera track' writes also says how sure each speed
    is and of which trial they are; without that the standard deviation is 0.001 m/s.

    Example: tailbeat speed upload 3 speed.csv
    """
    import numpy as np

    from tailbeat.records import decode_reference
    from tailbeat.speedcsv import read_speeds

    if sigma_m_s is not None and not 0 < sigma_m_s <= 1:
        raise typer.BadParameter("--sigma is in m/s, more than 0, like 0.001")
    with connected(connect) as fish:
        record = fish.reference_record()
        beat_s = decode_reference(record).beat_s if record else 1.0
        beats = fish.status().beats
        found = read_speeds(file, beats, beat_s, number)
        sigma = found.sigma_m_s if sigma_m_s is None else None
        if sigma is None:
            sigma = np.full(beats, sigma_m_s or _SPEED_SIGMA_M_S, dtype=np.float32)
        fish.upload_speeds(number, found.speed_m_s, sigma)
    document = {
        "trial": number,
        "measured_beats": found.measured,
        "speed_m_s": found.speed_m_s,
        "sigma_m_s": np.where(np.isfinite(found.speed_m_s), sigma, np.nan),
    }
    say(json, document, f"trial {number} has speeds for {found.measured} of {beats} beats")
