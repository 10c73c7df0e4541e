"""What is told of a board's key at connect, without saying the same at every command."""

from __future__ import annotations

from datetime import date
from typing import TYPE_CHECKING

from tailbeat.errors import TailbeatError
from tailbeat.lasting import replace_file

if TYPE_CHECKING:
    from tailbeat.fish import Fish

_TOLD = "no-key-told"  # in the logbook of the fish: the day


def notice_today(fish: Fish) -> str | None:
    """As ``connect_notice``; that nobody has set a key yet once per board and day. A key that is
    missing, or was lost, is told every time."""
    from tailbeat.provision import NO_KEY, connect_notice

    line = connect_notice(fish)
    return None if line == NO_KEY and _told_before(fish) else line


def _told_before(fish: Fish) -> bool:
    """Whether it was told today; from now on it was. A logbook that cannot say: not told."""
    from tailbeat.logbook import logbook_of

    today = date.today().isoformat()
    try:
        if (book := logbook_of(fish)) is None:
            return False
        path = book.folder / _TOLD
        if path.is_file() and path.read_text(encoding="utf-8", errors="replace") == today:
            return True
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, today)
    except (TailbeatError, OSError):
        pass
    return False
