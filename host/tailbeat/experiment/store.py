"""What an experiment keeps: files that are never changed, and its journal.

An experiment and a trial library are two stores of files: those that came from a board, and copies
of trial files. In both, one process and thread at a time adds a file, a file is lasting and
read-only once it is there, and a trial whose file has grown (a board appends to it when it gets
speeds later) is kept again: the longest file is the trial. An experiment lists the digests of its
files in ``raw/SHA256SUMS``, as ``sha256sum -c`` reads it; in a trial library the digest is part of
the file's name.

``journal.jsonl`` says what happened in an experiment, in order, one JSON object per line.
Every line has ``time`` (ISO 8601 with zone, local) and ``what``:

``made``, ``opened``; ``typed`` {command}: what makes the fish swim; ``set`` {params, conditions,
...}: what is new of them; ``begun`` and ``swum`` {trial, iteration, end, file, rested_s, pose,
drift, travel, battery_start_v, battery_end_v, board_s}; ``void`` {trial, end}: begun, but not
executed; ``decided`` {trial, decision, reason, file}, ``withdrawn`` {trial, file, reason};
``learned`` {trial, ..., rolled_back}; ``note`` {text}; ``resumed`` {..., board_s}; ``restarted``
{board_s}: the board was switched off, and somebody said to go on; ``trimmed`` {...}; ``identified``
{file}; ``restored`` {trial}

A line that the end of power has torn is never removed: it is ended with ``#torn`` and not read.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any, ClassVar

from tailbeat.core.errors import InputError, reason
from tailbeat.core.files import (
    MAKE_ROOM,
    TEMPORARY,
    locked,
    plain,
    wait_lock,
    write_whole,
)
from tailbeat.core.param_names import of_document
from tailbeat.core.platform.files import BINARY, sync_folder
from tailbeat.core.trial_file import Trial, parse_trial, read_trial

_TORN = b" #torn"


@dataclass(frozen=True)
class Journal:
    """The file; made by the first entry."""

    path: Path

    def add(self, what: str, now: datetime | None = None, **values: Any) -> dict[str, Any]:
        """Appends one line, lasting when it returns; what was written. NaN becomes null. A line
        that an earlier end of power has torn is ended first. Raises InputError (disk full)."""
        time = (now or datetime.now()).astimezone().isoformat(timespec="seconds")
        entry = {"time": time, "what": what, **plain(values)}
        # ASCII, so that a file torn at any byte is still text
        line = json.dumps(entry, allow_nan=False).encode("ascii") + b"\n"
        try:
            is_new = not self.path.exists()
            self._append(line)
            if is_new:
                sync_folder(self.path.parent)
        except OSError as error:
            raise InputError(
                f"cannot write into {self.path} ({reason(error)}).",
                "Make room on this computer, or make the folder writable; then do it again.",
            ) from error
        return entry

    def _append(self, line: bytes) -> None:
        """The line whole, or nothing of it."""
        descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | BINARY, 0o644)
        try:
            wait_lock(descriptor, self.path)  # or another process's half line would count as torn
            size = os.fstat(descriptor).st_size
            content = _end_of(_last_line(self.path)) + line
            try:
                left = content
                while left:
                    left = left[os.write(descriptor, left) :]
                os.fsync(descriptor)
            except OSError:
                with contextlib.suppress(OSError):
                    os.ftruncate(descriptor, size)
                raise
        finally:
            os.close(descriptor)

    def entries(self, what: str | None = None) -> list[dict[str, Any]]:
        """All lines, or those of one kind, in order. A torn last line is left out; any other that
        cannot be read raises InputError."""
        lines = self._lines()
        found = []
        for number, line in enumerate(lines, 1):
            if not line.strip() or line.endswith(_TORN):
                continue
            entry = _entry(line)
            if entry is not None:
                found.append(entry)
            elif number < len(lines):
                raise InputError(
                    f"line {number} of {self.path} is damaged.",
                    "Mend it by hand (one JSON object with time and what), or put a copy back.",
                )
        return [entry for entry in found if what is None or entry["what"] == what]

    def decisions(self) -> dict[int, dict[str, Any]]:
        """The last decision on every trial, by number."""
        return {
            entry["trial"]: entry
            for entry in self.entries("decided")
            if isinstance(entry.get("trial"), int)
        }

    def _lines(self) -> list[bytes]:
        """The last is what comes after the last line end: torn, or empty."""
        try:
            return self.path.read_bytes().split(b"\n")
        except FileNotFoundError:
            return []
        except OSError as error:
            raise InputError(
                f"cannot read {self.path} ({reason(error)}).", "Make the file readable."
            ) from error


def _last_line(path: Path) -> bytes:
    return path.read_bytes().rpartition(b"\n")[2]


def _end_of(last: bytes) -> bytes:
    """What ends a line that was left without an end."""
    if not last:
        return b""
    return b"\n" if _entry(last) is not None else _TORN + b"\n"


def _entry(line: bytes) -> dict[str, Any] | None:
    """None when it is none: no beginning of an object is itself an object."""
    try:
        entry = json.loads(line.decode("utf-8"))
    except (ValueError, RecursionError):
        return None
    if isinstance(entry, dict) and isinstance(entry.get("what"), str) and "time" in entry:
        return of_document(entry)
    return None


SUMS = "SHA256SUMS"
MAKE_ROOM_AGAIN = "Make room on this computer and do it again; what is on the board stays there."
RAW = "raw"
JOURNAL = "journal.jsonl"
_TAKEN_MAX = 1000
_DIGEST_DIGITS = 64
_READ_ONLY = 0o444


@dataclass(frozen=True)
class Kept:
    """A trial of a store and its file. ``mark``: empty, ``discarded`` (counts for nothing) or
    ``run`` (of an identification: the model knows it, but it is in no series). ``names``: of all
    files of the trial, of which ``path`` is the longest."""

    trial: Trial
    path: Path
    mark: str = ""
    names: tuple[str, ...] = ()


def trial_content(path: Path) -> tuple[int, bytes]:
    """The number of the trial in a file, and the file's content. Raises InputError."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(
            f"cannot read {path} ({reason(error)}).", "Pull the trial again."
        ) from error
    return parse_trial(content, path.name).number, content


def read_kept(
    files: Iterable[Path],
    is_sound: Callable[[Path, bytes], bool] = lambda path, content: True,
    latest: Path | None = None,
) -> tuple[list[Kept], list[str]]:
    """The trials of these files, in order, and one line for each file that is not used and why. A
    longer file takes the place of what it begins with. ``latest``: a file whose trial is to be the
    last of all."""
    found: list[tuple[bytes, Kept]] = []
    problems: list[str] = []
    for path in files:
        try:
            content = path.read_bytes()
            if not is_sound(path, content):
                raise InputError(f"{path} is damaged", "Pull that trial again.")
            _join(found, content, path)
        except OSError as error:
            problems.append(f"cannot read {path} ({reason(error)})")
        except InputError as error:
            problems.append(str(error))
    if latest is not None:
        found.append(found.pop(_join(found, latest.read_bytes(), latest)))
    return [kept for _, kept in found], problems


def _join(found: list[tuple[bytes, Kept]], content: bytes, path: Path) -> int:
    """Where in ``found`` the trial of this file is now."""
    trial = parse_trial(content, path.name)
    for at, (held, kept) in enumerate(found):
        if kept.trial.number != trial.number:
            continue
        names = (*kept.names, path.name)
        if held.startswith(content):
            found[at] = held, replace(kept, names=names)
            return at
        if content.startswith(held):
            found[at] = content, Kept(trial, path, names=names)
            return at
    found.append((content, Kept(trial, path, names=(path.name,))))
    return len(found) - 1


@dataclass(frozen=True)
class TrialStore:
    """A folder to which files are added under its lock. ``remedy``: when it cannot be written.
    ``made_by_use``: the folder is made when something is first written."""

    folder: Path
    remedy: ClassVar[str] = MAKE_ROOM
    made_by_use: ClassVar[bool] = False

    @contextlib.contextmanager
    def changing(self) -> Iterator[None]:
        """For a file that is read, changed and written again: one process and thread at a time.
        Raises InputError."""
        try:
            if self.made_by_use:
                self.folder.mkdir(parents=True, exist_ok=True)
            with locked(self.folder):
                yield
        except OSError as error:
            raise InputError(
                f"cannot write into {self.folder} ({reason(error)})", self.remedy
            ) from error

    def add_file(self, path: Path, content: bytes) -> None:
        """Write a file once: lasting and read-only when it returns. Raises InputError.

        Parameters
        ----------
        path, content : Path, bytes
            Where it is written, and all that it holds.
        """
        write_whole(path, content, MAKE_ROOM_AGAIN)
        path.chmod(_READ_ONLY)


@dataclass(frozen=True)
class RawFiles(TrialStore):
    """The untouched files of an experiment, in ``raw/``, and its journal."""

    @property
    def raw(self) -> Path:
        """Where the untouched files lie."""
        return self.folder / RAW

    @property
    def journal(self) -> Journal:
        """What happened, in order; folders of older tools have an empty one."""
        return Journal(self.folder / JOURNAL)

    def add_raw(self, name: str, content: bytes) -> Path:
        """Keep content unchanged for ever, lasting on the disk when it returns.

        Parameters
        ----------
        name : str
            File name in ``raw/``.
        content : bytes
            The same content again does nothing.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            Another content has this name, or the disk is full.
        """
        path, digest = self.raw / name, hashlib.sha256(content).hexdigest()
        with self.changing():
            if not path.exists():
                self.add_file(path, content)
            elif _digest_of(path) != digest:
                raise InputError(
                    f"{path} is there already with other content.",
                    "Raw files are never overwritten; start a new experiment.",
                )
            self._list_sum(digest, name)  # an earlier call may have ended before it did
        return path

    def keep_raw(self, name: str, content: bytes) -> Path:
        """Keep content as ``add_raw`` does, under the next free name.

        Parameters
        ----------
        name : str
            ``NAME-2.EXT`` is used where it is taken by another content.
        content : bytes
            What a file already holds, or holds the beginning of, is not kept again.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            999 names are taken, or the disk is full.
        """
        stem, dot, ending = name.partition(".")
        with self.changing():
            for number in range(1, _TAKEN_MAX):
                path = self.raw / (name if number == 1 else f"{stem}-{number}{dot}{ending}")
                if not path.exists():
                    return self.add_raw(path.name, content)
                held = path.read_bytes()
                if held.startswith(content):
                    return self.add_raw(path.name, held)
        raise InputError(f"{self.raw} is full of {name}.", "Start a new experiment.")

    def keep_trial(self, path: Path) -> Path:
        """Copy a trial's file into the raw files, named by the number in it.

        Parameters
        ----------
        path : Path
            A trial file. Another trial with a number that is taken (the board began again) becomes
            ``NNNN-2.ulg``.

        Returns
        -------
        Path
            The copy.

        Raises
        ------
        InputError
            It is no trial file, or the disk is full.
        """
        number, content = trial_content(path)
        return self.keep_raw(f"{number:04d}.ulg", content)

    def sums(self) -> dict[str, str]:
        """SHA-256 of every raw file by name, in the order they were added.

        A line torn by the end of power says nothing.
        """
        try:
            text = (self.raw / SUMS).read_text(encoding="utf-8", errors="replace")
        except FileNotFoundError:
            return {}
        found = {}
        for line in text.splitlines():
            digest, _, name = line.partition("  ")
            if len(digest) == _DIGEST_DIGITS and name:
                found[name] = digest
        return found

    def _list_sum(self, digest: str, name: str) -> None:
        listed = self.sums()
        if listed.get(name) == digest:
            return
        if name in listed:
            raise InputError(
                f"{self.raw / name} is not what {SUMS} says it was.",
                f"Put the right file back, or start a new experiment; {SUMS} is never changed.",
            )
        lines = [f"{sha}  {other}\n" for other, sha in listed.items()]
        write_whole(self.raw / SUMS, "".join([*lines, f"{digest}  {name}\n"]), MAKE_ROOM_AGAIN)

    def damaged(self) -> list[str]:
        """Names of raw files that are missing or differ from what was added."""
        return [
            name for name, digest in self.sums().items() if _digest_of(self.raw / name) != digest
        ]

    def unlisted(self) -> list[str]:
        """Names of raw files that nobody added through this tool (or the power went just then)."""
        known = {*self.sums(), SUMS}
        there = sorted(path.name for path in self.raw.glob("*") if path.is_file())
        return [name for name in there if name not in known and not name.endswith(TEMPORARY)]

    def raw_problems(self) -> list[str]:
        """One line for each raw file that cannot be trusted; none = all is as it came."""
        changed = ("is missing", "is not what it was when it was added")
        journalled = {name for name in self._journalled() if not (self.raw / name).exists()}
        problems = {
            "is not listed in SHA256SUMS": self.unlisted(),
            "is in the event log and not in the folder": sorted(journalled - set(self.sums())),
        }
        return [
            *(f"raw/{name} {changed[(self.raw / name).exists()]}" for name in self.damaged()),
            *(f"raw/{name} {words}" for words, names in problems.items() for name in names),
        ]

    def _journalled(self) -> list[str]:
        """Names of the trials' files in the journal, in its order."""
        files = (str(entry.get("file") or "") for entry in self.journal.entries("swum"))
        return [Path(file).name for file in files if file]

    def trial_files(self) -> list[Path]:
        """Every trial's file, in the order of the trials.

        By the journal, else by number, or by when they were added where numbers came twice.
        """
        order = sorted(path.name for path in self.raw.glob("*.ulg"))
        if any("-" in name for name in order):
            added = {name: at for at, name in enumerate(self.sums())}
            order.sort(key=lambda name: added.get(name, len(added)))
        when = {name: at for at, name in enumerate(order)}
        found = [name for name in dict.fromkeys(self._journalled()) if name in when]
        for name in order:  # one that is not in the journal: before the first one after it
            if name not in found:
                later = (at for at, other in enumerate(found) if when[other] > when[name])
                found.insert(next(later, len(found)), name)
        return [self.raw / name for name in found]

    def trials(self) -> list[Trial]:
        """Every trial of the series, in order."""
        return [read_trial(path) for path in self.trial_files()]


def _digest_of(path: Path) -> str:
    """Of a file that is not there: empty."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""
