"""Somebody at the live page who says yes, types what is asked for and keeps every trial."""

from __future__ import annotations

from tailbeat.app.web.state import PageState
from tailbeat.app.web.worker import Worker
from tailbeat.core.errors import InputError

PATIENCE_S = 600.0  # wall time; a bound on what hangs


def start_on_page(worker: Worker, until: str, commission: str) -> tuple[PageState, list[str]]:
    """Presses START and answers until all is done; the state then, and the questions."""
    done, asked = worker.now.done, []
    worker.ask("swim", until=until, preflight=True, law="auto", commission=commission)
    while True:
        now = worker.screen.wait(
            lambda now: now.done > done or now.phase in ("asking", "deciding"), PATIENCE_S
        )
        if now.done > done:
            return now, asked
        try:
            _answer(worker, now)
        except InputError:  # said already, and the next question is not there yet
            _another(worker, now.serial)
            continue
        if now.phase == "asking":
            asked.append(now.question)


def _answer(worker: Worker, now: PageState) -> None:
    if now.phase == "deciding":
        worker.ask("decide", kind="keep")
    else:
        typed = f"{now.number:.2f}" if now.number is not None else ""
        worker.ask("answer", yes=True, typed=typed)


def _another(worker: Worker, serial: int) -> None:
    worker.screen.wait(lambda now: now.serial > serial, PATIENCE_S)
