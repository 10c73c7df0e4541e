"""learn --law model."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from tailbeat.cli.common import mm, progress_bar, say
from tailbeat.cli.keeping import verdict_after_learning, verdict_text
from tailbeat.errors import InputError
from tailbeat.faults import NO_TRIAL, refusal

if TYPE_CHECKING:
    from tailbeat.fish import Fish
    from tailbeat.logbook import Logbook
    from tailbeat.model.identified import Identified
    from tailbeat.model.swim import Swim
    from tailbeat.modelstep import Step
    from tailbeat.results import LearnReport


def learn_with_model(
    fish: Fish, number: int | None, identified_file: Path | None, dry_run: bool, json: bool
) -> None:
    """The pending trial, if there is one, then the amplitudes that swim next."""
    from tailbeat.logbook import logbook_of
    from tailbeat.modelstep import next_step, setting_of, swims_since, upload

    pending = fish.status().pending_trial
    if number not in (None, pending):
        raise refusal(NO_TRIAL)
    unique_id = fish.unique_id()
    book = logbook_of(fish)
    identified = _identified(book, identified_file)
    setting = setting_of(fish)
    swims = _swims(fish, pending, book, dry_run, json)
    step = next_step(setting, identified, swims_since(identified, swims, unique_id))
    if dry_run:
        _say(step, pending, None, None, "", json)
        return
    report = fish.learn(pending) if pending is not None else None
    rolled_back = report is not None and report.rolled_back
    uploaded = not (rolled_back and step.proposal.law == "p")
    if uploaded:
        if book is not None:
            book.add_proposal(step.document)
        upload(fish, setting, step.proposal)
    words = ""
    if report is not None:
        verdict = verdict_after_learning(fish, report.trial, report.rolled_back, json)
        words = verdict_text(verdict)
    _say(step, pending, report, uploaded, words, json)


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
) -> list[Swim]:
    """All in the logbook and the pending one, which is kept there unless it is a dry run."""
    from tailbeat.model.swim import swim_of
    from tailbeat.trial_log import read_trial

    if pending is None:
        return book.swims() if book is not None else []
    with TemporaryDirectory() as folder, progress_bar(json, f"trial {pending}") as show:
        path = fish.pull_trial(
            pending,
            Path(folder),
            lambda done, total: show(done / max(total, 1), f"{done} bytes"),
        )
        swim = swim_of(read_trial(path))
        if book is not None and not dry_run:
            book.keep(path)
    before = book.swims() if book is not None else []
    kept = [one for one in before if one.trial != pending]
    return [*kept, swim] if swim.measured.any() else kept


def _say(
    step: Step,
    pending: int | None,
    report: LearnReport | None,
    uploaded: bool | None,
    words: str,
    json: bool,
) -> None:
    document: dict[str, Any] = {
        **step.document,
        "trial": pending,
        "foretold_max_abs_error_m_s": step.foretold_m_s,
        "learned": report,
        "uploaded": bool(uploaded),
        "dry_run": uploaded is None,
    }
    say(json, document, lambda: _text(step, report, uploaded) + words)


def _text(step: Step, report: LearnReport | None, uploaded: bool | None) -> str:
    proposal = step.proposal
    parts = []
    if report is not None:
        said = f"trial {report.trial}: max|e| {mm(report.max_abs_error_m_s)} mm/s"
        parts.append(said + _expected(", predicted", step.foretold_m_s))
    parts.append(proposal.reason)
    if uploaded is False:
        parts.append("worse twice, so the best amplitudes swim next")
        return "; ".join(parts)
    following = "would swim next" if uploaded is None else "next"
    parts.append(following + _expected(" max|e|", proposal.predicted_max_abs_error_m_s) + " mm/s")
    if proposal.limited_beats:
        parts.append(f"DU_MAX_RAD holds {proposal.limited_beats} beats back")
    return "; ".join(parts)


def _expected(word: str, quantiles: tuple[float, float, float] | None) -> str:
    if quantiles is None:
        return ""
    low, median, high = (mm(value) for value in quantiles)
    return f"{word} {median} ({low} to {high})"
