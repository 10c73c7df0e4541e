"""learn --law model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from tailbeat.cli.common import echo, mm, progress_bar, say
from tailbeat.cli.keeping import told_if_another, verdict_after_learning, verdict_text
from tailbeat.errors import InputError
from tailbeat.faults import NO_TRIAL, refusal

if TYPE_CHECKING:
    from tailbeat.fish import Fish
    from tailbeat.logbook import Logbook
    from tailbeat.model.identified import Identified
    from tailbeat.model.swim import Swim
    from tailbeat.modelstep import Next, Step
    from tailbeat.results import LearnReport
    from tailbeat.verdict import Verdict

_RESTORED = 3  # what made the amplitudes that swim next, memory_input_t
_ANEW = (
    "trial numbers come again: the logbook holds swims of this board before it started anew; "
    "for another fish name another logbook in TAILBEAT_LOGBOOK"
)


def learn_with_model(
    fish: Fish, number: int | None, identified_file: Path | None, dry_run: bool, json: bool
) -> None:
    """The pending trial, if there is one, then the amplitudes that swim next."""
    from tailbeat.day.bycommand import learn_noted, state_noted
    from tailbeat.logbook import logbook_of
    from tailbeat.modelstep import (
        next_of,
        next_step,
        numbered_anew,
        setting_of,
        swims_since,
        upload,
    )

    pending = fish.status().pending_trial
    if number not in (None, pending):
        raise refusal(NO_TRIAL)
    unique_id = fish.unique_id()
    book = logbook_of(fish)
    identified = _identified(book, identified_file)
    told_if_another(identified, unique_id)
    setting = setting_of(fish)
    every, kept = _swims(fish, pending, book, dry_run, json)
    swims = swims_since(identified, every, unique_id)
    if numbered_anew(every, swims):
        echo(f"tailbeat: {_ANEW}", err=True)
    step = next_step(setting, identified, swims)
    if dry_run:
        _say(step, pending, None, None, None, json)
        return
    report = None if pending is None else learn_noted(fish, pending, "learn --law model")
    restored = report.rolled_back if report else fish.amplitudes().input == _RESTORED
    following = next_of(step.proposal, restored, fish.status().best_max_abs_error_m_s)
    if following.upload:
        if book is not None:
            book.add_proposal(step.document)
        upload(fish, setting, step.proposal)
        state_noted(fish)
    verdict = None
    if report is not None:
        verdict = verdict_after_learning(fish, report.trial, report.rolled_back, json, kept)
    if verdict is not None and verdict.kind == "rolled_back" and following.upload:
        verdict = replace(verdict, words=f"{verdict.words}, which the model's plan replaces")
    _say(step, pending, report, following, verdict, json)


def _identified(book: Logbook | None, file: Path | None) -> Identified:
    from tailbeat.model.identified import Identified

    if file is not None:
        return Identified.load(file)
    found = book.identified() if book is not None else None
    if found is None:
        raise InputError(
            "the fish has not been identified.", "tailbeat identify, or give --identified FILE."
        )
    return found


def _swims(
    fish: Fish, pending: int | None, book: Logbook | None, dry_run: bool, json: bool
) -> tuple[list[Swim], Path | None]:
    """All in the logbook and the pending one, which is kept there unless it is a dry run; and where
    it is kept."""
    from tailbeat.model.swim import swim_of
    from tailbeat.trial_log import read_trial

    if pending is None:
        return book.swims() if book is not None else [], None
    with TemporaryDirectory() as folder, progress_bar(json, f"trial {pending}") as show:
        path = fish.pull_trial(
            pending,
            Path(folder),
            lambda done, total: show(done / max(total, 1), f"{done} bytes"),
        )
        if book is None:
            swim = swim_of(read_trial(path))
            return [swim] if swim.measured.any() else [], None
        if dry_run:
            return book.swims(path), None
        kept = book.keep(path)
        return book.swims(kept), kept


def _say(
    step: Step,
    pending: int | None,
    report: LearnReport | None,
    following: Next | None,
    verdict: Verdict | None,
    json: bool,
) -> None:
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
    say(json, document, lambda: _text(step, report, following) + verdict_text(verdict))


def _text(step: Step, report: LearnReport | None, following: Next | None) -> str:
    proposal = step.proposal
    parts = []
    if report is not None:
        said = f"trial {report.trial}: max|e| {mm(report.max_abs_error_m_s)} mm/s"
        parts.append(said + _expected(", predicted", step.foretold_m_s))
    parts.append(proposal.reason)
    if report is not None and report.rolled_back:
        parts.append("worse twice")
    if following is not None and following.words:
        parts.append(following.words)
    if following is not None and not following.upload:
        return "; ".join(parts)
    word = "would swim next" if following is None else "next"
    parts.append(word + _expected(" max|e|", proposal.predicted_max_abs_error_m_s) + " mm/s")
    if proposal.limited_beats:
        parts.append(f"DU_MAX_RAD holds {proposal.limited_beats} beats back")
    return "; ".join(parts)


def _expected(word: str, quantiles: tuple[float, float, float] | None) -> str:
    if quantiles is None:
        return ""
    low, median, high = (mm(value) for value in quantiles)
    return f"{word} {median} ({low} to {high})"
