"""learn: what the board, or a model of the fish, makes of the pending trial."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import typer

from tailbeat.app.cli._fish import Connect, connected
from tailbeat.app.cli._kept import assessment_after, assessment_lines, pull_with_bar
from tailbeat.app.cli._lazy import arg, opt
from tailbeat.app.cli._options import IdentifiedFile, warn_if_another
from tailbeat.app.cli._terminal import TRIAL_MAX, Output, lines_of, warn
from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError
from tailbeat.core.faults import NO_TRIAL, refusal
from tailbeat.core.printable import mm
from tailbeat.core.records import INPUT_RESTORED
from tailbeat.core.trial_checks import never_corrected
from tailbeat.core.trial_file import read_trial
from tailbeat.experiment.library import TrialLibrary, identified_of, library_of
from tailbeat.learning.assessment import rollback_words
from tailbeat.learning.belief import Beliefs
from tailbeat.learning.convergence import Assessment
from tailbeat.learning.fish_model import TrialSpeeds, trial_speeds
from tailbeat.learning.identification import Identified
from tailbeat.link.messages import LearnReport
from tailbeat.session.decide import learn_and_log, log_state, not_logged_text, restore_best_and_log
from tailbeat.session.next_input import (
    ModelStep,
    NextInput,
    choose_next_input,
    next_step,
    numbering_restarted,
    setting_of,
    trials_since,
    upload,
)
from tailbeat.session.next_input import dry_run as compute
from tailbeat.session.presenter import result


def learn(
    number: int | None = arg("Default: the pending one.", "[TRIAL]", min=1, max=TRIAL_MAX),
    dry_run: bool = opt("Compute the same numbers here; change nothing."),
    restore_best: bool = opt("Use the best input so far in the next trial."),
    law: Literal["p", "model"] = opt(
        "model: this computer plans the next.", "p|model", default="p"
    ),
    identified: IdentifiedFile = None,
    connect: Connect = None,
) -> Output:
    """Let the board learn from the pending trial.

    With --law model the next input comes from a model of the fish, fitted again to all its trials;
    without a pending trial it is planned from what is known. In an experiment the log, the decision
    and what was learned are kept.

    Example: tailbeat trial learn --law model
    """
    if restore_best and (dry_run or law == "model"):
        other = "--dry-run" if dry_run else "--law model"
        raise typer.BadParameter(f"--restore-best and {other} exclude each other")
    if identified is not None and law != "model":
        raise typer.BadParameter("--identified is for --law model")
    with connected(connect) as fish:
        if law == "model":
            return learn_with_model(fish, number, identified, dry_run)
        if dry_run:
            found = compute(fish, number)
            return Output(found.as_dict(), found.text)
        return _restore_best(fish) if restore_best else _learn(fish, number)


def _restore_best(fish: Fish) -> Output:
    restore_best_and_log(fish)
    held = fish.amplitudes()
    document = {"restored": True, "iteration": held.iteration, "amplitude_rad": held.values}
    return Output(document, f"the best input is next, as iteration {held.iteration}")


def _learn(fish: Fish, number: int | None) -> Output:
    report = learn_and_log(fish, number, "trial learn" + ("" if number is None else f" {number}"))
    held, visits = fish.amplitudes(), fish.visits()
    if line := not_logged_text(fish):
        warn(line)
    verdict = assessment_after(fish, report.trial, report.rolled_back)
    document = vars(report) | {"next_iteration": held.iteration, "amplitude_rad": held.values}
    document |= {"visits": visits, "verdict": verdict}
    back = f"; {rollback_words()}" if report.rolled_back else ""
    return Output(
        document,
        lines_of(result(report) + back, never_corrected(visits), assessment_lines(verdict)),
    )


_ANEW = (
    "trial numbers repeat: the trial library holds trials of this board from before its "
    "restart. For another fish, name another folder in TAILBEAT_LOGBOOK"
)


def learn_with_model(
    fish: Fish, number: int | None, identified: Identified | None, dry_run: bool
) -> Output:
    """The pending trial, if there is one, then the next feedforward input."""
    pending = fish.status().pending_trial
    if number not in (None, pending):
        raise refusal(NO_TRIAL)
    unique_id = fish.unique_id()
    book = library_of(fish)
    identified = identified or _identified(book)
    warn_if_another(identified, unique_id)
    setting = setting_of(fish)
    every, kept = _trials(fish, pending, book, dry_run)
    trials = trials_since(identified, every, unique_id)
    if numbering_restarted(every, trials):
        warn(_ANEW)
    step = next_step(setting, Beliefs(identified), trials)
    if dry_run:
        return _output(step, pending, None, None, None)
    report = None if pending is None else learn_and_log(fish, pending, "trial learn --law model")
    restored = report.rolled_back if report else fish.amplitudes().input == INPUT_RESTORED
    following = choose_next_input(step.proposal, restored, fish.status().best_max_abs_error_m_s)
    if following.upload:
        if book is not None:
            book.add_proposal(step.document)
        upload(fish, setting, step.proposal)
        log_state(fish)
    found = None
    if report is not None:
        found = assessment_after(fish, report.trial, report.rolled_back, kept)
    if found is not None and found.kind == "rolled_back" and following.upload:
        found = replace(found, words=f"{found.words}, which the model's plan replaces")
    return _output(step, pending, report, following, found)


def _identified(book: TrialLibrary | None) -> Identified:
    if (found := identified_of(book)) is None:
        raise InputError(
            "the fish has not been identified.",
            "tailbeat session identify, or give --identified FILE.",
        )
    return found


def _trials(
    fish: Fish, pending: int | None, book: TrialLibrary | None, dry_run: bool
) -> tuple[list[TrialSpeeds], Path | None]:
    """All in the library and the pending one, which is kept there unless it is a dry run; and where
    it is kept."""
    if pending is None:
        return book.speeds() if book is not None else [], None
    with TemporaryDirectory() as folder:
        path = pull_with_bar(fish, pending, Path(folder))
        if book is None:
            trial = trial_speeds(read_trial(path))
            return [trial] if trial.measured.any() else [], None
        kept = None if dry_run else book.keep(path)
        return book.speeds(kept or path), kept


def _output(
    step: ModelStep,
    pending: int | None,
    report: LearnReport | None,
    following: NextInput | None,
    verdict: Assessment | None,
) -> Output:
    """``following`` None: a dry run."""
    document: dict[str, Any] = {
        **step.document,
        "trial": pending,
        "foretold_max_abs_error_m_s": step.foretold_m_s,
        "learned": report,
        "uploaded": following is not None and following.upload,
        "next": following.words if following is not None else "",
        "dry_run": following is None,
        "verdict": verdict,
    }
    text = lines_of(_text(step, report, following), assessment_lines(verdict))
    return Output(document, text)


def _text(step: ModelStep, report: LearnReport | None, following: NextInput | None) -> str:
    proposal, parts = step.proposal, []
    if report is not None:
        measured = f"trial {report.trial}: max|e| {mm(report.max_abs_error_m_s)} mm/s"
        parts.append(measured + _expected(", predicted", step.foretold_m_s))
    parts.append(proposal.reason)
    parts += ["worse twice"] if report is not None and report.rolled_back else []
    parts += [following.words] if following is not None and following.words else []
    if following is None or following.upload:
        word = "would be next" if following is None else "next"
        expected = _expected(" max|e|", proposal.predicted_max_abs_error_m_s)
        parts.append(f"{word}{expected} mm/s")
        held = proposal.limited_beats
        parts += [f"DU_MAX_RAD holds {held} beats back"] if held else []
    return "; ".join(parts)


def _expected(word: str, quantiles: tuple[float, float, float] | None) -> str:
    if quantiles is None:
        return ""
    low, median, high = (mm(value) for value in quantiles)
    return f"{word} {median} ({low} to {high})"
