"""The trial library of a fish: every trial of it this computer has seen, and what was identified.

A folder per fish, named by its unique id, in ``$TAILBEAT_LOGBOOK``, else in ``tailbeat/fish`` of
the user's data: ``trials/`` (copies of trial files, never changed, in the order they came),
``marks/`` (what is to be known of some of them, named like them), ``proposals/`` (inputs this
computer made, and why), ``references.json`` (their names by CRC, which a board does not keep),
``identified.json`` and ``law.json`` (the P law designed for the fish). The model law, the
assessment and a second reference draw on it. Several processes may write at once.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError
from tailbeat.core.files import write_whole
from tailbeat.core.platform.files import sync_folder
from tailbeat.core.reference import Reference
from tailbeat.experiment.library_folder import FOLDER_VARIABLE as FOLDER_VARIABLE
from tailbeat.experiment.library_folder import folder_of, has_library, library_folder
from tailbeat.experiment.store import Kept, TrialStore, read_kept, trial_content
from tailbeat.learning.fish_model import TrialSpeeds, trial_speeds
from tailbeat.learning.identification import Identified
from tailbeat.learning.saturation import KnownFish, known_fish

DISCARDED = "discarded"
RUN = "run"
_MARKS = (DISCARDED, RUN)
_IDENTIFIED = "identified.json"
_REFERENCES = "references.json"
_LAW = "law.json"
_PRESERVED = "before-identify"
_DIGEST_DIGITS = 16


@dataclass(frozen=True)
class TrialLibrary(TrialStore):
    """One fish's folder."""

    remedy = f"Make the folder writable, or name another one in {FOLDER_VARIABLE}."
    made_by_use = True

    @classmethod
    def of(cls, unique_id: str, root: Path | None = None) -> TrialLibrary:
        """The trial library of a fish; the folder is made when something is first kept. ``root``:
        the folder of all trial libraries, if not the usual one. Raises InputError."""
        return cls(folder_of(unique_id, root))

    def keep(self, path: Path, mark: str = "") -> Path:
        """Copies a trial's file; where its copy is, there or now. What is kept already, or the
        beginning of it, is not kept again. ``mark``: as in ``Kept``. Lasting when it returns.
        Raises InputError."""
        number, content = trial_content(path)
        pattern, ending = f"*_{number:04d}_*.ulg", f"_{number:04d}_{_digest(content)}.ulg"
        held = (kept for kept in _sorted(self._trials, pattern) if _begins_with(kept, content))
        copy = next(held, None) or self._add(self._trials, ending, content)
        if mark:
            self.mark(copy, mark)
        return copy

    def mark(self, copy: Path, mark: str) -> None:
        """Says of a trial what it is, see ``Kept``; ``copy``: what ``keep`` returned."""
        with self.changing():
            self._marks.mkdir(exist_ok=True)
            (self._marks / f"{_name_of(copy)}.{mark}").touch()
            sync_folder(self._marks)
            sync_folder(self.folder)

    def unmark(self, copy: Path, mark: str) -> None:
        """Takes a mark back; does nothing where there is none."""
        with self.changing():
            (self._marks / f"{_name_of(copy)}.{mark}").unlink(missing_ok=True)
            if self._marks.is_dir():
                sync_folder(self._marks)

    def kept(self, latest: Path | None = None) -> tuple[list[Kept], list[str]]:
        """All trials, in the order they were kept, and one line for each file that is not used and
        why. Of a trial kept twice, the second time with more in its file, only that counts.
        ``latest``: a trial's file that is to be the last of all, kept or not (a board that starts
        again may have executed one like it before)."""
        found, problems = read_kept(_sorted(self._trials, "*.ulg"), _is_sound, latest)
        return [replace(kept, mark=self._mark_of(kept.path)) for kept in found], problems

    def speeds(self, latest: Path | None = None) -> list[TrialSpeeds]:
        """As the model sees them, without those that have no speed or were discarded."""

        counting = [kept.trial for kept in self.kept(latest)[0] if kept.mark != DISCARDED]
        known = [trial_speeds(trial) for trial in counting]
        return [trial for trial in known if trial.measured.any()]

    def identified(self) -> Identified | None:
        """None when the fish has not been identified. Raises InputError: the file is damaged."""

        path = self.folder / _IDENTIFIED
        return Identified.load(path) if path.is_file() else None

    def set_identified(self, identified: Identified) -> Path:
        """Replaces what was identified; the old file stays beside it, numbered."""
        path = self.folder / _IDENTIFIED
        with self.changing():
            if path.is_file():
                self._add(self.folder / "identified", ".json", path.read_bytes())
            identified.save(path)
        return path

    def add_proposal(self, document: dict[str, Any]) -> Path:
        """Keeps where an input came from: plain values, as JSON. Lasting when it returns."""
        content = json.dumps(document, indent=2).encode() + b"\n"
        return self._add(self.folder / "proposals", ".json", content)

    def proposals(self) -> list[dict[str, Any]]:
        """In the order they were added. Damaged files are left out."""
        found = []
        for path in _sorted(self.folder / "proposals", "*.json"):
            with contextlib.suppress(OSError, ValueError, RecursionError):
                document = json.loads(path.read_bytes())
                if isinstance(document, dict):
                    found.append(document)
        return found

    def designed_law(self, key: str) -> dict[str, float] | None:
        """The parameters of the law that was designed last; None: not for this ``key``."""
        held = self._read(_LAW)
        law = held.get("params") if held.get("key") == key else None
        return {str(name): float(value) for name, value in law.items()} if law else None

    def set_designed_law(self, key: str, params: Mapping[str, float]) -> None:
        """Replaces it. Raises InputError."""
        self.put(_LAW, {"key": key, "params": dict(params)})

    def change_designed_law(self, params: Mapping[str, float]) -> None:
        """Some of its parameters, if there is one. Raises InputError."""
        with self.changing():
            if held := self._read(_LAW):
                self.put(_LAW, held | {"params": held.get("params", {}) | dict(params)})

    def name_reference(self, crc: int, name: str) -> None:
        """Keeps what a reference is called. Lasting when it returns."""
        if self.reference_name(crc) != name:
            with self.changing():
                self.put(_REFERENCES, self._names() | {f"{crc:08x}": name})

    def put(self, name: str, document: Mapping[str, Any]) -> None:
        """Replaces a JSON file of the folder in one step, lasting. What follows from the file as it
        was belongs into one block of ``changing``. Raises InputError."""
        with self.changing():
            write_whole(self.folder / name, json.dumps(document, indent=2) + "\n")

    def reference_name(self, crc: int) -> str | None:
        """None: it was uploaded by another computer, or a tool that kept no names."""
        return self._names().get(f"{crc:08x}")

    def _names(self) -> dict[str, str]:
        return {crc: str(name) for crc, name in self._read(_REFERENCES).items()}

    def _read(self, name: str) -> dict[str, Any]:
        """A JSON file of the folder; empty when it is missing or damaged."""
        with contextlib.suppress(OSError, ValueError, RecursionError):
            document = json.loads((self.folder / name).read_bytes())
            if isinstance(document, dict):
                return document
        return {}

    @property
    def _trials(self) -> Path:
        return self.folder / "trials"

    @property
    def _marks(self) -> Path:
        return self.folder / "marks"

    def _mark_of(self, path: Path) -> str:
        name = _name_of(path)
        return next((m for m in _MARKS if (self._marks / f"{name}.{m}").exists()), "")

    def _add(self, folder: Path, ending: str, content: bytes) -> Path:
        """Writes ``content`` whole or not at all, named by the next order number."""
        with self.changing():
            folder.mkdir(exist_ok=True)
            order = 1 + max((_order(path) for path in folder.iterdir()), default=0)
            path = folder / f"{order:06d}{ending}"
            self.add_file(path, content)
            for made in (self.folder, self.folder.parent):
                sync_folder(made)
        return path


def library_of(fish: Fish, root: Path | None = None) -> TrialLibrary | None:
    """The trial library of a connected board. None for a simulated one in this process, which is a
    new fish every time, unless a folder is named."""
    folder = library_folder(fish, root)
    return None if folder is None else TrialLibrary(folder)


@contextlib.contextmanager
def some_library(fish: Fish) -> Iterator[None]:
    """Gives a simulated fish in this process, which has none, a trial library for the length of a
    block."""
    if has_library(fish):
        yield
        return
    with TemporaryDirectory() as folder:
        fish.library_root = Path(folder)
        try:
            yield
        finally:
            fish.library_root = None


def keep_run(library: TrialLibrary | None, path: Path) -> None:
    """The trial of a run to trim or to measure the fish, where there is a library."""
    if library is not None:
        library.keep(path, RUN)


def identified_of(library: TrialLibrary | None) -> Identified | None:
    """The identified fish of a library, if there are both. Raises InputError for a damaged file."""
    return None if library is None else library.identified()


def identified_if_readable(library: TrialLibrary | None) -> Identified | None:
    """As identified_of; of a damaged file None: then the board's own model counts."""
    try:
        return identified_of(library)
    except InputError:
        return None


def name_reference(fish: Fish, reference: Reference) -> None:
    """Keeps the name of a reference the fish has got. A trial library that cannot be written is no
    reason to fail."""
    with contextlib.suppress(InputError):
        if (book := library_of(fish)) is not None:
            book.name_reference(reference.crc, reference.name)


def _sorted(folder: Path, pattern: str) -> list[Path]:
    with contextlib.suppress(OSError):
        return sorted(folder.glob(pattern))
    return []


def _order(path: Path) -> int:
    digits = path.name.partition(".")[0].partition("_")[0]
    return int(digits) if digits.isascii() and digits.isdigit() else 0


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:_DIGEST_DIGITS]


def _name_of(path: Path) -> str:
    """``NUMBER_DIGEST`` of a copy: whatever its order."""
    return path.stem.partition("_")[2]


def _is_sound(path: Path, content: bytes) -> bool:
    return path.stem.rpartition("_")[2] == _digest(content)


def _begins_with(path: Path, content: bytes) -> bool:
    """Whether it is a sound file that holds ``content``, perhaps with more behind it."""
    with contextlib.suppress(OSError):
        return (held := path.read_bytes()).startswith(content) and _is_sound(path, held)
    return False


def preserve_folder(book: TrialLibrary | None) -> Path | None:
    """Where ``board.preserve`` keeps its copy: one folder for all procedures of a fish, so that an
    interrupted one is found by any other. None for a board without a trial library."""
    return None if book is None else book.folder / _PRESERVED


def known_fish_of(library: TrialLibrary | None) -> KnownFish | None:
    """The model of a fish that its trial library gives; None without a library or a trial."""
    if library is None:
        return None
    identified = library.identified()
    return known_fish(identified, library.speeds() if identified is None else ())


def read_trials(folder: Path) -> tuple[list[Kept], list[str]]:
    """The trial files of a folder by name, or of its ``raw`` (an experiment); and one line for each
    that cannot be read. Raises InputError when there is no folder."""
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}.", "Name an experiment's folder.")
    raw = folder / "raw"
    return read_kept(sorted((raw if raw.is_dir() else folder).glob("*.ulg")))
