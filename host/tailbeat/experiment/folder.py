"""The folder of an experiment.

``DATE_fish_reference_law_NN/`` with ``raw/`` (what came from the board, read-only, listed in
``raw/SHA256SUMS`` as ``sha256sum -c`` reads it), ``notes.md``, ``settings.json`` and
``journal.jsonl``; docs/reference/experiment-folder.md says what else may lie in it.

One program at a time swims in an experiment; the system lets go when that program dies.

The board's state as the experiment last saw it: ``board/`` with its parameters and all that was
learned, so that another battery, or another board, can go on.

One file, ``board/state.json``, replaced in one step: half of a state would be worse than none.
``state-N.json`` is one that knew more than what replaced it.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tailbeat.board.fish import Fish
from tailbeat.board.flash.backup import BackupPlaces
from tailbeat.board.snapshot import Snapshot, make_folder
from tailbeat.core.errors import InputError, TailbeatError, reason
from tailbeat.core.faults import NO_REFERENCE, refusal
from tailbeat.core.files import MAKE_ROOM, WRITE_LOCK, write_whole
from tailbeat.core.param_names import of_document
from tailbeat.core.platform.files import try_lock
from tailbeat.experiment.store import JOURNAL, MAKE_ROOM_AGAIN, RAW, RawFiles

_SETTINGS = "settings.json"

JUDGING = 2  # in settings: trials are judged on their measured beats; older folders have none
_NOTES = "notes.md"
_EXPORT = "export"
_MADE_FOLDERS = ("board", "report")
_MADE_FILES = (
    "report.html", "report.png", "analysis.json", "redo.md", "reference.csv", ".lock", WRITE_LOCK,
)  # fmt: skip


@dataclass(frozen=True)
class Experiment(RawFiles):
    """A series of trials on disk.

    Attributes
    ----------
    folder : Path
        Its folder, with ``settings.json``, ``raw/``, ``journal.jsonl`` and ``notes.md``.
    """

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
        (folder / RAW).mkdir(exist_ok=True)
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
            write_whole(self.folder / _SETTINGS, text, MAKE_ROOM_AGAIN)

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
            write_whole(path, f"{old}\n- **{stamp}** {text.strip()}\n", MAKE_ROOM_AGAIN)

    def notes(self) -> str:
        """All notes, Markdown."""
        return (self.folder / _NOTES).read_text(encoding="utf-8")

    def clear(self) -> None:
        """Deletes what belongs to the experiment, raw files too; other files in its folder stay."""
        for name in (RAW, _EXPORT, *_MADE_FOLDERS):
            shutil.rmtree(self.folder / name, ignore_errors=True)
        for name in (_SETTINGS, _NOTES, JOURNAL, *_MADE_FILES):
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


def _slug(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9.]+", "-", text).strip("-.") or "x"


def _tool() -> dict[str, str]:
    return {"tailbeat": version("tailbeat"), "python": sys.version.split()[0]}


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
                f"another program runs a trial in {experiment.name}.",
                "Go on there, at its terminal or its page; or end it, then begin again.",
            )
        yield
    finally:
        os.close(descriptor)


_ASIDE_MAX = 999


def copy_state(fish: Fish, experiment: Experiment) -> Snapshot:
    """Reads it from the board and writes it whole, lasting; a copy that knows more stays beside it.
    The parameters are the expected ones: a board that restarted has lost what was not saved. Raises
    InputError (disk full), Refused without a reference."""
    taken = Snapshot.take(fish, expected_params(experiment) or None)
    state = replace(taken, next_trial=0, signed=False)  # as the file has it
    if state.reference is None:
        raise refusal(NO_REFERENCE)
    path = _path(experiment)
    make_folder(path.parent)
    with experiment.changing():
        _set_aside(experiment, state)
        state.write_file(path)
    return state


def require_not_lost(fish: Fish, experiment: Experiment) -> None:
    """Raises InputError when the board has forgotten what the copy holds (its storage was erased,
    or its reference was uploaded again): what it swims and learns next would take its place."""
    held, status = held_state(experiment), fish.status()
    if held is None:
        return
    now = replace(
        held,
        iteration=status.iteration,
        last_learned_trial=status.last_learned_trial,
        learned=fish.learned_record(),
    )
    if not held.knows_more(now):
        return
    first = "" if status.pending_trial is None else "tailbeat trial discard --reason WHY, then "
    raise InputError(
        f"the board has lost what it had learned: it is at iteration {max(1, now.iteration)}. "
        f"{experiment.name} has a copy of iteration {held.iteration}.",
        f"To restore it: {first}tailbeat session resume. To start over: tailbeat experiment new",
    )


def held_state(experiment: Experiment) -> Snapshot | None:
    """As it was written last; None = never. Raises InputError when it is damaged."""
    return Snapshot.read_file(_path(experiment))


def expected_params(experiment: Experiment) -> dict[str, float]:
    """The parameters that its board is expected to have: those of the copy, which follows what
    commands set; without one those the experiment was made with, and what was set since. Empty =
    made by hand."""
    if (held := held_state(experiment)) is not None:
        return held.params
    params = dict(experiment.settings().get("params") or {})
    for entry in experiment.journal.entries("set"):
        params |= entry.get("params") or {}
    return {str(name): float(value) for name, value in params.items()}


def set_held_params(experiment: Experiment, params: Mapping[str, float]) -> None:
    """These were set on purpose since the copy was made; without a copy nothing is done."""
    with experiment.changing():
        if (held := held_state(experiment)) is not None:
            replace(held, params=held.params | dict(params)).write_file(_path(experiment))


def _set_aside(experiment: Experiment, state: Snapshot) -> None:
    try:
        held = held_state(experiment)
    except InputError:
        return  # what cannot be read cannot be given back
    if held is None or not held.knows_more(state):
        return
    content, path = held.file_content(), _path(experiment)
    for number in range(1, _ASIDE_MAX):
        aside = path.with_name(f"state-{number}.json")
        if not aside.exists():
            write_whole(aside, content, MAKE_ROOM)
            return
        if aside.read_bytes() == content:
            return


def _path(experiment: Experiment) -> Path:
    return experiment.folder / "board" / "state.json"
