"""The way to the fish, and what is reported of its key at connect."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import date

from tailbeat.app.cli._display import ended_as_by_ctrl_c
from tailbeat.app.cli._terminal import echo
from tailbeat.board.fish import Fish
from tailbeat.board.provision import NO_KEY, connect_notice
from tailbeat.core.errors import TailbeatError
from tailbeat.core.files import replace_file
from tailbeat.experiment.library import logbook_of


@contextmanager
def connected(url: str | None, notice: bool = True) -> Iterator[Fish]:
    """A fish for the length of a command, which SIGTERM and SIGHUP end as Ctrl-C does. ``notice``:
    report on stderr when its key is missing; once a day that it has none."""
    with ended_as_by_ctrl_c(), Fish.connect(url) as fish:
        if notice and (line := new_notice(fish)):
            echo(f"tailbeat: {line}", err=True)
        yield fish


_REPORTED = "no-key-told"  # in the trial library of the fish: the day


def new_notice(fish: Fish) -> str | None:
    """As ``connect_notice``; that nobody has set a key yet once per board and day. A key that is
    missing, or was lost, is reported every time."""
    line = connect_notice(fish)
    return None if line == NO_KEY and _reported_today(fish) else line


def _reported_today(fish: Fish) -> bool:
    """Whether it was reported today; from now on it was. Without a trial library: not."""
    today = date.today().isoformat()
    try:
        if (book := logbook_of(fish)) is None:
            return False
        path = book.folder / _REPORTED
        if path.is_file() and path.read_text(encoding="utf-8", errors="replace") == today:
            return True
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, today)
    except (TailbeatError, OSError):
        pass
    return False
