"""The whole guided job on the page, from an unknown fish to a report: by mouse on a laptop, and by
touch on a phone.
"""

from __future__ import annotations

import json
import re
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from .accessibility import require_accessible
from .browser import LAPTOP, PHONE, SPEED, Browser, Touched, browsing, page_of

_PHASE = "document.querySelector('.root')?.dataset.phase"
_QUESTION = "(document.querySelector('.asking')?.innerText ?? '')"
_STEPS = ("health", "tank", "trim", "measure", "limit", "law", "reference", "trials")


def test_by_mouse_on_a_laptop(simulator: Any, tmp_path: Path) -> None:
    with (
        simulator(SPEED) as (address, _),
        page_of(address, tmp_path) as (url, _),
        browsing(tmp_path / "downloads") as browser,
    ):
        browser.size(*LAPTOP)
        browser.driver.get(url)
        browser.phase("idle")
        browser.choose(".until", "1")
        _answer_all(browser, judged=True)
        log = browser.text(".log")
        assert all(f"ok  {name}:" in log for name in _STEPS), log
        _require_done(browser)
        browser.looks("job-laptop")
        assert browser.complaints() == []


@pytest.mark.soak
def test_by_touch_on_a_phone(simulator: Any, tmp_path: Path) -> None:
    """With all choices as they are; ABORT ends it in the second trial."""
    with (
        simulator(SPEED) as (address, _),
        page_of(address, tmp_path) as (url, _),
        browsing(tmp_path / "downloads", Touched) as browser,
    ):
        browser.size(*PHONE)
        browser.driver.get(url)
        browser.phase("idle")
        _answer_all(browser)
        browser.phase("swimming")
        browser.require_abort(*PHONE)
        browser.press("#abort", f"{_PHASE} === 'deciding'")
        browser.click(".reasons button")
        browser.press(".choose-discard", f"{_PHASE} !== 'deciding'")
        browser.phase("idle")
        assert "discarded" in browser.text(".log")
        _require_done(browser, points=0)  # of a trial that was stopped at once
        browser.looks("job-phone")
        assert browser.complaints() == []


def _answer_all(browser: Browser, judged: bool = False) -> None:
    """START, yes to every question, each number typed, until one trial is kept; what is proposed
    after it is left."""
    browser.press(".start", f"{_PHASE} !== 'idle'")
    asked: list[str] = []
    while browser.phase("asking", "deciding") == "asking":
        browser.until("document.querySelector('.asking')?.checkVisibility()")
        if judged and not asked:
            browser.looks("asking", partial(require_accessible, browser))
        asked.append(_answer(browser))
    browser.press(".choose-keep", f"{_PHASE} !== 'deciding'")
    assert sum("To allow it, type" in question for question in asked) == 1, asked
    while browser.phase("asking", "idle", "swimming") == "asking":
        _answer(browser)


def _answer(browser: Browser) -> str:
    question = str(browser.ask(_QUESTION))
    if number := re.search(r"To allow it, type ([0-9.]+)\.\s", question):
        browser.type(".number input", number[1])
    answered = f"{_PHASE} !== 'asking' || {_QUESTION} !== {json.dumps(question)}"
    browser.press(".asking .no" if "Proposal:" in question else ".asking .yes", answered)
    return question


def _require_done(browser: Browser, points: int = 20) -> None:
    """What the page shows of it. ``points``: more than so many on the last trial's path."""
    browser.until("document.querySelectorAll('.trial.keep').length === 1")
    assert "model-based" in browser.text(".trial .made-by")
    assert "model-based" in browser.text(".law")
    options = "getElement(+document.querySelector('.tank-chart').id.slice(1)).chart.getOption()"
    series = browser.ask(f"{options}.series.map(one => [one.name, one.data.length])")
    assert [name for name, _ in series] == ["wall", "wall", "path", "start", "fish"]
    assert series[2][1] > points, "where the fish has been"
    browser.until("document.querySelector('.open-report').checkVisibility()")
    assert "<h1" in browser.ask("fetch('/report').then(answer => answer.text())")
