"""The folder of an experiment.

``DATE_fish_reference_law_NN/`` with ``raw/`` (what came from the board, read-only, listed in
``raw/SHA256SUMS`` as ``sha256sum -c`` reads it), ``notes.md`` and ``settings.json``.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import sys
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from tailbeat.errors import InputError
from tailbeat.trial_log import Trial, read_trial

_SETTINGS = "settings.json"
_NOTES = "notes.md"
_RAW = "raw"
_EXPORT = "export"
_SUMS = "SHA256SUMS"


@dataclass(frozen=True)
class Experiment:
    """A series of trials on disk."""

    folder: Path

    @classmethod
    def new(
        cls, root: Path, fish: str, reference: str, law: str, now: datetime | None = None
    ) -> Experiment:
        """Makes ``root/DATE_fish_reference_law_NN`` with the first NN that is free."""
        date = (now or datetime.now()).strftime("%Y-%m-%d")
        stem = "_".join([date, _slug(fish), _slug(reference), _slug(law)])
        for number in range(1, 1000):
            folder = root / f"{stem}_{number:02d}"
            try:
                folder.mkdir(parents=True)
            except FileExistsError:
                continue
            return cls._fill(folder, fish, reference, law, now)
        raise InputError(f"{root} holds 999 of {stem} already.", "Use another root folder.")

    @classmethod
    def at(
        cls, folder: Path, fish: str, reference: str, law: str, now: datetime | None = None
    ) -> Experiment:
        """Makes the experiment in exactly this folder, which must not hold one yet."""
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
            {"made": made, "fish": fish, "reference": reference, "law": law, "tool": _tool()}
        )
        (folder / _NOTES).write_text(f"# {folder.name}\n", encoding="utf-8")
        return experiment

    @classmethod
    def open(cls, folder: Path) -> Experiment:
        """An existing experiment."""
        if not (folder / _SETTINGS).is_file():
            raise InputError(
                f"{folder} is no experiment.", "List them with: tailbeat experiment list"
            )
        return cls(folder)

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.name

    @property
    def raw(self) -> Path:
        """Where the untouched files lie."""
        return self.folder / _RAW

    @property
    def export_folder(self) -> Path:
        """Where exports go."""
        return self.folder / _EXPORT

    def settings(self) -> dict[str, Any]:
        """What was set when the trials were swum."""
        path = self.folder / _SETTINGS
        try:
            values = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            values = None
        if not isinstance(values, dict):
            raise InputError(f"{path} is damaged.", "Mend it by hand; it is a JSON object.")
        return values

    def write_settings(self, values: dict[str, Any]) -> None:
        """Adds to the settings; what is there under other keys stays."""
        path = self.folder / _SETTINGS
        old = self.settings() if path.exists() else {}
        part = path.with_suffix(".part")
        part.write_text(json.dumps(old | values, indent=2) + "\n", encoding="utf-8")
        part.replace(path)

    def note(self, text: str, now: datetime | None = None) -> None:
        """Adds a line with the time to the notes."""
        stamp = (now or datetime.now()).strftime("%Y-%m-%d %H:%M:%S")
        with (self.folder / _NOTES).open("a", encoding="utf-8") as file:
            file.write(f"\n- **{stamp}** {text.strip()}\n")

    def notes(self) -> str:
        """All notes, Markdown."""
        return (self.folder / _NOTES).read_text(encoding="utf-8")

    def add_raw(self, name: str, content: bytes) -> Path:
        """Keeps ``content`` unchanged for ever. The same content again does nothing; another
        content under a name that is taken is refused."""
        path = self.raw / name
        digest = hashlib.sha256(content).hexdigest()
        if path.exists():
            if hashlib.sha256(path.read_bytes()).hexdigest() == digest:
                self._list_sum(digest, name)  # an earlier call may have ended before it did
                return path
            raise InputError(
                f"{path} is there already with other content.",
                "Raw files are never overwritten; start a new experiment.",
            )
        part = path.with_name(path.name + ".part")
        part.write_bytes(content)
        part.chmod(0o444)
        part.replace(path)
        self._list_sum(digest, name)
        return path

    def _list_sum(self, digest: str, name: str) -> None:
        sums, line = self.raw / _SUMS, f"{digest}  {name}"
        if sums.exists() and line in sums.read_text(encoding="utf-8").splitlines():
            return
        with sums.open("a", encoding="utf-8") as file:
            file.write(line + "\n")

    def damaged(self) -> list[str]:
        """Names of raw files that are missing or differ from what was added."""
        sums = self.raw / _SUMS
        bad = []
        for line in sums.read_text(encoding="utf-8").splitlines() if sums.exists() else []:
            digest, _, name = line.partition("  ")
            path = self.raw / name
            if not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() != digest:
                bad.append(name)
        return bad

    def trials(self) -> list[Trial]:
        """Every trial of the series, by number."""
        return [read_trial(path) for path in sorted(self.raw.glob("*.ulg"))]

    def clear(self) -> None:
        """Deletes what belongs to the experiment, raw files too; other files in its folder stay."""
        for name in (_RAW, _EXPORT):
            shutil.rmtree(self.folder / name, ignore_errors=True)
        for name in (_SETTINGS, _NOTES, "report.html", "report.png"):
            (self.folder / name).unlink(missing_ok=True)


def list_experiments(root: Path) -> list[Experiment]:
    """The experiments below ``root``, oldest first."""
    if not root.is_dir():
        return []
    return [Experiment(path.parent) for path in sorted(root.glob(f"*/{_SETTINGS}"))]


def _slug(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9.]+", "-", text).strip("-.") or "x"


def _tool() -> dict[str, str]:
    from importlib.metadata import PackageNotFoundError, version

    try:
        tailbeat = version("tailbeat")
    except PackageNotFoundError:
        tailbeat = "unknown"
    return {"tailbeat": tailbeat, "python": sys.version.split()[0]}
