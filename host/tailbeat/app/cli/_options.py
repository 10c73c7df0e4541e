"""Options that several commands have, each declared once; among them the way to the fish."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Annotated, ClassVar

from tailbeat.app.cli._lazy import opt
from tailbeat.app.cli._terminal import ended_as_by_ctrl_c, warn
from tailbeat.board.fish import Fish
from tailbeat.board.provision import NO_KEY, connect_notice
from tailbeat.core.errors import TailbeatError
from tailbeat.core.files import replace_file
from tailbeat.experiment.library import library_of
from tailbeat.session.preflight_step import PreflightLimits

Connect = Annotated[
    str | None,
    opt(
        "Serial path, tcp:HOST:PORT, udp:PORT, sim[:plant] or vboard; default: find the fish.",
        "URL",
        name="--connect",
        envvar="TAILBEAT_CONNECT",
        show_default=False,
    ),
]
IdentifiedFile = Annotated[Path | None, opt("What 'session identify' wrote.", "FILE")]
Plot = Annotated[Path | None, opt("Draw it.", "PNG")]
Library = Annotated[Path | None, opt("Folder of the trial libraries.", "DIR")]
Into = Annotated[Path | None, opt("The experiment; default: the fish's current.", "FOLDER")]
Rest = Annotated[
    float | None,
    opt("Rest since the last trial; default: 30.", "S", min=0.0, max=3600.0),
]
Root = Annotated[Path, opt("Folder that holds the experiments.")]
EXPERIMENTS = Path("experiments")


def preflight_limits(rest_s: float | None) -> PreflightLimits:
    """The usual ones, with the rest of ``--rest``."""
    return PreflightLimits() if rest_s is None else PreflightLimits(rest_s=rest_s)


_KINDS = ("thesis", "thesis:", "trapezoid:", "cosine:")


def reference_names(incomplete: str) -> list[str]:
    """What the shell offers: kinds of references, CSV files, and folders that may hold some."""
    folder = Path(incomplete if incomplete.endswith("/") else Path(incomplete).parent)
    try:
        files = sorted(folder.iterdir())
    except OSError:
        files = []
    found = [str(path) for path in files if path.suffix.lower() == ".csv"]
    found += [f"{path}/" for path in files if path.is_dir() and not path.name.startswith(".")]
    return [name for name in (*_KINDS, *found) if name.startswith(incomplete)]


ReferenceName = Annotated[
    str | None,
    opt(
        "As for 'reference upload'; default: the board's (without a board: thesis).",
        name="--reference",
        autocompletion=reference_names,
        show_default=False,
    ),
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
def connected(url: str | None, notice: bool = True) -> Iterator[Fish]:
    """A fish for the length of a command, which SIGTERM and SIGHUP end as Ctrl-C does. ``notice``:
    report on stderr when its key is missing, or was lost; once a day that nobody has set one."""
    with ended_as_by_ctrl_c(), Fish.connect(url) as fish:
        line = connect_notice(fish) if notice else None
        if line and not (line == NO_KEY and _reported_today(fish)):
            warn(line)
        yield fish


_REPORTED = "no-key-told"  # in the trial library of the fish: the day


def _reported_today(fish: Fish) -> bool:
    """Whether it was reported today; from now on it was. Without a trial library: not."""
    today = date.today().isoformat()
    try:
        if (book := library_of(fish)) is None:
            return False
        path = book.folder / _REPORTED
        if path.is_file() and path.read_text(encoding="utf-8", errors="replace") == today:
            return True
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, today)
    except (TailbeatError, OSError):
        pass
    return False
