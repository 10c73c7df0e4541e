"""The way from a command to the fish: which one, and what is to know of its key."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from datetime import date
from typing import Annotated, ClassVar

from tailbeat.app.cli._lazy import opt
from tailbeat.app.cli._terminal import ended_as_by_ctrl_c, warn
from tailbeat.board.fish import Fish
from tailbeat.board.provision import NO_KEY, connect_notice
from tailbeat.core.errors import TailbeatError
from tailbeat.core.files import replace_file
from tailbeat.experiment.library_folder import library_folder
from tailbeat.link.stream import StreamAddress, streaming

Connect = Annotated[
    str | None,
    opt(
        "Serial path, tcp:HOST:PORT, udp:PORT, sim[:plant] or vboard; default: find the fish.",
        "URL",
        envvar="TAILBEAT_CONNECT",
        show_default=False,
    ),
]
Stream = Annotated[
    StreamAddress | None,
    opt("Send what the board reports, for PlotJuggler.", "udp://HOST:PORT", by=StreamAddress.parse),
]


@dataclass(frozen=True)
class ConnectOptions:
    """Which fish; what is to know of its key is printed."""

    notice: ClassVar[bool] = True
    connect: Connect = None

    def open(self) -> AbstractContextManager[Fish]:
        """The fish for the length of a command."""
        return connected(self.connect, self.notice)


class SilentConnectOptions(ConnectOptions):
    """Of commands about the key."""

    notice: ClassVar[bool] = False


ConnectedFish = Annotated[Fish, ConnectOptions]
FishWithoutNotice = Annotated[Fish, SilentConnectOptions]


@contextmanager
def connected(
    url: str | None, notice: bool = True, stream: StreamAddress | None = None
) -> Iterator[Fish]:
    """A fish for the length of a command, which SIGTERM and SIGHUP end as Ctrl-C does. ``notice``:
    report on stderr when its key is missing, or was lost; once a day that nobody has set one.
    ``stream``: where what the board reports is sent meanwhile."""
    with ended_as_by_ctrl_c(), Fish.connect(url) as fish, streaming(fish.link, stream):
        line = connect_notice(fish) if notice else None
        if line and not (line == NO_KEY and _reported_today(fish)):
            warn(line)
        yield fish


_REPORTED = "no-key-told"  # in the trial library of the fish: the day


def _reported_today(fish: Fish) -> bool:
    """Whether it was reported today; from now on it was. Without a trial library: not."""
    today = date.today().isoformat()
    try:
        if (folder := library_folder(fish)) is None:
            return False
        path = folder / _REPORTED
        if path.is_file() and path.read_text(encoding="utf-8", errors="replace") == today:
            return True
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, today)
    except (TailbeatError, OSError):
        pass
    return False
