"""The folder of an experiment.

``DATE_fish_reference_law_NN/`` with ``raw/`` (what came from the board, read-only, listed in
``raw/SHA256SUMS`` as ``sha256sum -c`` reads it), ``notes.md``, ``settings.json`` and
``journal.jsonl``; docs/experiment-folder.md says what else may lie in it.

One program at a time swims in an experiment; the system lets go when that program dies.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import shutil
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from tailbeat.board.flash.backup import BackupPlaces
from tailbeat.core.errors import InputError, TailbeatError, reason
from tailbeat.core.files import MAKE_ROOM, TEMPORARY, write_whole
from tailbeat.core.locks import WRITE_LOCK, locked, try_lock
from tailbeat.core.param_names import of_document
from tailbeat.core.trial_file import Trial, parse_trial, read_trial
from tailbeat.experiment.journal import Journal

_SETTINGS = "settings.json"

JUDGING = 2  # in settings: trials are judged on their measured beats; older folders have none
_NOTES = "notes.md"
_JOURNAL = "journal.jsonl"
_RAW = "raw"
_EXPORT = "export"
_SUMS = "SHA256SUMS"
_MADE_FOLDERS = ("board", "report")
_MADE_FILES = (
    "report.html", "report.png", "analysis.json", "redo.md", "reference.csv", ".lock", WRITE_LOCK,
)  # fmt: skip
_TAKEN_MAX = 1000
_MAKE_ROOM = "Make room on this computer and do it again; what is on the board stays there."
_DIGEST_DIGITS = 64


@dataclass(frozen=True)
class Experiment:
    """A series of trials on disk.

    Attributes
    ----------
    folder : Path
        Its folder, with ``settings.json``, ``raw/``, ``journal.jsonl`` and ``notes.md``.
    """

    folder: Path

    @classmethod
    def new(
        cls, root: Path, fish: str, reference: str, law: str, now: datetime | None = None
    ) -> Experiment:
        """Make ``root/DATE_fish_reference_law_NN`` with the first NN that is free.

        Parameters
        ----------
        root : Path
            Folder of all experiments; it is made when it is missing.
        fish, reference, law : str
            Names of the three for settings and folder name.
        now : datetime, optional
            When it is made; default: now.

        Returns
        -------
        Experiment
            The new experiment.

        Raises
        ------
        InputError
            The folder cannot be made.
        """
        date = (now or datetime.now()).strftime("%Y-%m-%d")
        stem = "_".join([date, _slug(fish), _slug(reference), _slug(law)])
        for number in range(1, 1000):
            folder = root / f"{stem}_{number:02d}"
            try:
                folder.mkdir(parents=True)
            except FileExistsError:
                continue
            except OSError as error:
                raise InputError(
                    f"cannot make {folder} ({reason(error)}).", "Choose another --root."
                ) from error
            return cls._fill(folder, fish, reference, law, now)
        raise InputError(f"{root} holds 999 of {stem} already.", "Use another root folder.")

    @classmethod
    def at(
        cls, folder: Path, fish: str, reference: str, law: str, now: datetime | None = None
    ) -> Experiment:
        """Make the experiment in exactly this folder.

        Parameters
        ----------
        folder : Path
            It must not hold an experiment yet.
        fish, reference, law : str
            Names of the three for settings and folder name.
        now : datetime, optional
            When it is made; default: now.

        Returns
        -------
        Experiment
            The new experiment.

        Raises
        ------
        InputError
            The folder holds an experiment.
        """
        if (folder / _SETTINGS).exists():
            raise InputError(
                f"{folder} already holds an experiment.", "Choose another folder, or remove it."
            )
        folder.mkdir(parents=True, exist_ok=True)
        return cls._fill(folder, fish, reference, law, now)

    @classmethod
    def _fill(
        cls, folder: Path, fish: str, reference: str, law: str, now: datetime | None
    ) -> Experiment:
        (folder / _RAW).mkdir(exist_ok=True)
        experiment = cls(folder)
        made = (now or datetime.now()).astimezone().isoformat(timespec="seconds")
        experiment.write_settings(
            {
                "name": folder.name,
                "made": made,
                "fish": fish,
                "reference": reference,
                "law": law,
                "tool": _tool(),
                "judging": JUDGING,
            }
        )
        write_whole(folder / _NOTES, f"# {folder.name}\n")
        return experiment

    @staticmethod
    def is_at(folder: Path) -> bool:
        """Whether the folder holds an experiment.

        Parameters
        ----------
        folder : Path
            Any folder; it need not exist.

        Returns
        -------
        bool
            Whether it has ``settings.json``.
        """
        return (folder / _SETTINGS).is_file()

    @classmethod
    def open(cls, folder: Path) -> Experiment:
        """Open an existing experiment.

        Parameters
        ----------
        folder : Path
            Its folder.

        Returns
        -------
        Experiment
            The experiment.

        Raises
        ------
        InputError
            The folder holds none.
        """
        if not cls.is_at(folder):
            raise InputError(
                f"{folder} is no experiment.", "List them with: tailbeat experiment list"
            )
        return cls(folder)

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.name

    @property
    def stable_name(self) -> str:
        """The name it was given: that of a copy in another folder is the same."""
        settings = self.settings()
        told = [str(settings.get(key, "")) for key in ("made", "fish", "reference", "law")]
        older = "_".join([told[0][:10], *(_slug(text) for text in told[1:])])
        return str(settings.get("name", older))

    @property
    def raw(self) -> Path:
        """Where the untouched files lie."""
        return self.folder / _RAW

    @property
    def export_folder(self) -> Path:
        """Where exports go."""
        return self.folder / _EXPORT

    def require_own(self, folder: Path) -> Path:
        """Check that a folder made by this package lies within the experiment's.

        Parameters
        ----------
        folder : Path
            Nothing is written or deleted elsewhere through a link.

        Returns
        -------
        Path
            The same folder.

        Raises
        ------
        InputError
            It is a link that leads out of the experiment.
        """
        if not folder.resolve().is_relative_to(self.folder.resolve()):
            raise InputError(
                f"{folder} is a link to {folder.resolve()}, outside the experiment.",
                "Replace the link with a folder, then run this again.",
            )
        return folder

    @property
    def journal(self) -> Journal:
        """What happened, in order; folders of older tools have an empty one."""
        return Journal(self.folder / _JOURNAL)

    def settings(self) -> dict[str, Any]:
        """What was set when the trials were executed."""
        path = self.folder / _SETTINGS
        try:
            values = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            values = None
        if not isinstance(values, dict):
            raise InputError(f"{path} is damaged.", "Mend it by hand; it is a JSON object.")
        return of_document(values)

    def write_settings(self, values: dict[str, Any]) -> None:
        """Add to the settings; what is there under other keys stays.

        Parameters
        ----------
        values : dict
            JSON types.

        Raises
        ------
        InputError
            The disk is full, or the settings are damaged.
        """
        with self.changing():
            old = self.settings() if (self.folder / _SETTINGS).exists() else {}
            text = json.dumps(old | values, indent=2) + "\n"
            write_whole(self.folder / _SETTINGS, text, _MAKE_ROOM)

    def note(self, text: str, now: datetime | None = None) -> None:
        """Add a line with the time to the notes, and to the journal.

        Parameters
        ----------
        text : str
            One line.
        now : datetime, optional
            Time of the note; default: now.

        Raises
        ------
        InputError
            The disk is full.
        """
        moment = now or datetime.now()
        self.journal.add("note", moment, text=text.strip())
        stamp = moment.strftime("%Y-%m-%d %H:%M:%S")
        path = self.folder / _NOTES
        with self.changing():
            old = path.read_text(encoding="utf-8") if path.exists() else f"# {self.name}\n"
            write_whole(path, f"{old}\n- **{stamp}** {text.strip()}\n", _MAKE_ROOM)

    def notes(self) -> str:
        """All notes, Markdown."""
        return (self.folder / _NOTES).read_text(encoding="utf-8")

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
        with self.changing():
            return self._add_raw(name, content)

    def _add_raw(self, name: str, content: bytes) -> Path:
        path = self.raw / name
        digest = hashlib.sha256(content).hexdigest()
        if path.exists():
            if _digest_of(path) == digest:
                self._list_sum(digest, name)  # an earlier call may have ended before it did
                return path
            raise InputError(
                f"{path} is there already with other content.",
                "Raw files are never overwritten; start a new experiment.",
            )
        write_whole(path, content, _MAKE_ROOM)
        path.chmod(0o444)
        self._list_sum(digest, name)
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
                    return self._add_raw(path.name, content)
                held = path.read_bytes()
                if held.startswith(content):
                    return self._add_raw(path.name, held)
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
        try:
            content = path.read_bytes()
        except OSError as error:
            raise InputError(
                f"cannot read {path} ({reason(error)}).", "Pull the trial again."
            ) from error
        return self.keep_raw(f"{parse_trial(content, path.name).number:04d}.ulg", content)

    def sums(self) -> dict[str, str]:
        """SHA-256 of every raw file by name, in the order they were added.

        A line torn by the end of power says nothing.
        """
        try:
            text = (self.raw / _SUMS).read_text(encoding="utf-8", errors="replace")
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
                f"{self.raw / name} is not what {_SUMS} says it was.",
                f"Put the right file back, or start a new experiment; {_SUMS} is never changed.",
            )
        lines = [f"{sha}  {other}\n" for other, sha in listed.items()]
        write_whole(self.raw / _SUMS, "".join([*lines, f"{digest}  {name}\n"]), _MAKE_ROOM)

    def damaged(self) -> list[str]:
        """Names of raw files that are missing or differ from what was added."""
        return [
            name for name, digest in self.sums().items() if _digest_of(self.raw / name) != digest
        ]

    def unlisted(self) -> list[str]:
        """Names of raw files that nobody added through this tool (or the power went just then)."""
        known = {*self.sums(), _SUMS}
        there = sorted(path.name for path in self.raw.glob("*") if path.is_file())
        return [name for name in there if name not in known and not name.endswith(TEMPORARY)]

    def raw_problems(self) -> list[str]:
        """One line for each raw file that cannot be trusted; none = all is as it came."""
        missing = "is missing"
        changed = "is not what it was when it was added"
        lines = [
            f"raw/{name} {changed if (self.raw / name).exists() else missing}"
            for name in self.damaged()
        ]
        lines += [f"raw/{name} is not listed in {_SUMS}" for name in self.unlisted()]
        return lines + [
            f"raw/{name} is in the journal and not in the folder" for name in self._gone()
        ]

    def _gone(self) -> list[str]:
        """Swims that the journal tells of, whose files nobody lists any more."""
        told = {Path(str(entry.get("file") or "")).name for entry in self.journal.entries("swum")}
        unlisted = told - set(self.sums())
        return sorted(name for name in unlisted if name and not (self.raw / name).exists())

    def trial_files(self) -> list[Path]:
        """Every trial's file, in the order of the trials.

        By the journal, else by number, or by when they were added where numbers came twice.
        """
        return _in_order(
            {path.name: path for path in self.raw.glob("*.ulg")},
            [str(entry.get("file", "")) for entry in self.journal.entries("swum")],
            list(self.sums()),
        )

    def trials(self) -> list[Trial]:
        """Every trial of the series, in order."""
        return [read_trial(path) for path in self.trial_files()]

    @contextlib.contextmanager
    def changing(self) -> Iterator[None]:
        """For a file that is read, changed and written again: one process and thread at a time.
        Raises InputError."""
        with contextlib.ExitStack() as held:
            try:
                held.enter_context(locked(self.folder))
            except OSError as error:
                raise InputError(
                    f"cannot write into {self.folder} ({reason(error)}).", MAKE_ROOM
                ) from error
            yield

    def clear(self) -> None:
        """Deletes what belongs to the experiment, raw files too; other files in its folder stay."""
        for name in (_RAW, _EXPORT, *_MADE_FOLDERS):
            shutil.rmtree(self.folder / name, ignore_errors=True)
        for name in (_SETTINGS, _NOTES, _JOURNAL, *_MADE_FILES):
            (self.folder / name).unlink(missing_ok=True)


def backup_places(out: Path, experiments: Path = Path("experiments")) -> BackupPlaces:
    """Where a backup of a board goes: trials that are in an experiment are not pulled again.
    ``out`` may be an experiment's folder: trials that are pulled then join its raw files."""
    known = [e.raw for e in list_experiments(experiments)] + [Experiment(out).raw, out]
    if not Experiment.is_at(out):
        return BackupPlaces(out, known)
    return BackupPlaces(out / "backups", known, partial(_moved_into, Experiment(out)))


def _moved_into(experiment: Experiment, path: Path) -> Path:
    """Into the raw files, if the number is free there."""
    try:
        kept = experiment.add_raw(path.name, path.read_bytes())
    except TailbeatError:
        return path
    path.unlink()
    return kept


def list_experiments(root: Path) -> list[Experiment]:
    """The experiments below ``root``, oldest first."""
    if not root.is_dir():
        return []
    return [Experiment(path.parent) for path in sorted(root.glob(f"*/{_SETTINGS}"))]


def _digest_of(path: Path) -> str:
    """Of a file that is not there: empty."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""


def _in_order(files: dict[str, Path], recorded: Sequence[str], added: Sequence[str]) -> list[Path]:
    """Those of ``recorded`` in its order; each other one before the first that was executed
    later."""
    order = sorted(files)
    if any("-" in name for name in files):
        place = {name: at for at, name in enumerate(added)}
        order.sort(key=lambda name: place.get(name, len(place)))
    when = {name: at for at, name in enumerate(order)}
    told = [name for name in dict.fromkeys(Path(file).name for file in recorded) if name in files]
    for name in order:
        if name not in told:
            later = (at for at, other in enumerate(told) if when[other] > when[name])
            told.insert(next(later, len(told)), name)
    return [files[name] for name in told]


def _slug(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9.]+", "-", text).strip("-.") or "x"


def _tool() -> dict[str, str]:
    from importlib.metadata import PackageNotFoundError, version

    try:
        tailbeat = version("tailbeat")
    except PackageNotFoundError:
        tailbeat = "unknown"
    return {"tailbeat": tailbeat, "python": sys.version.split()[0]}


LOCK = ".lock"


@contextlib.contextmanager
def alone(experiment: Experiment) -> Iterator[None]:
    """For the length of a block. Raises InputError when another program is in one."""
    path = experiment.folder / LOCK
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise InputError(f"cannot make {path} ({reason(error)}).", MAKE_ROOM) from error
    try:
        if not try_lock(descriptor):
            raise InputError(
                f"another program swims in {experiment.name}.",
                "Go on there, at its terminal or its page; or end it, then begin again.",
            )
        yield
    finally:
        os.close(descriptor)
