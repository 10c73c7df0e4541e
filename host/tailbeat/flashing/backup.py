"""What a board held, in a folder on disk.

``board.json`` (who it was, and its parameters), ``reference.bin``, ``learned.bin``, ``crash.bin``;
the records are those of docs/protocol.md. Trials pulled on the way lie in ``trials/`` unless they
went elsewhere.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from tailbeat.errors import InputError, reason
from tailbeat.lasting import replace_file

_BOARD = "board.json"
_FORMAT = "tailbeat backup 1"
_RECORDS = ("reference", "learned", "crash")


@dataclass(frozen=True)
class Backup:
    """The content of a board. Records are bytes as in docs/protocol.md; None = it had none.

    ``signed``: it had a key. The key itself is not in it: no board gives it away."""

    unique_id: str
    build_id: str
    params: dict[str, float]
    next_trial: int
    reference: bytes | None = None
    learned: bytes | None = None
    crash: bytes | None = None
    signed: bool = False
    made: str = field(default="", compare=False)

    def write(self, folder: Path) -> None:
        """Puts all of it on the disk itself before returning, and reads it back to be sure."""
        folder.mkdir(parents=True, exist_ok=True)
        for name in _RECORDS:
            record = getattr(self, name)
            if record is not None:
                replace_file(folder / f"{name}.bin", record)
        replace_file(folder / _BOARD, json.dumps(self._document(), indent=2).encode() + b"\n")
        if Backup.read(folder) != self:
            raise InputError(
                f"the backup in {folder} differs from what was written",
                "Use another disk: --out FOLDER",
            )

    def _document(self) -> dict[str, Any]:
        return {
            "format": _FORMAT,
            "made": self.made or datetime.now().astimezone().isoformat(timespec="seconds"),
            "unique_id": self.unique_id,
            "build_id": self.build_id,
            "next_trial": self.next_trial,
            "params": self.params,
            "signed": self.signed,
            "records": [name for name in _RECORDS if getattr(self, name) is not None],
        }

    @classmethod
    def read(cls, folder: Path) -> Backup:
        """The backup in ``folder``. Raises InputError when it is none, or incomplete."""
        try:
            document = json.loads((folder / _BOARD).read_text(encoding="utf-8"))
            if document["format"] != _FORMAT:
                raise ValueError(f"its format is {document['format']!r}")
            records = {
                name: (folder / f"{name}.bin").read_bytes()
                for name in document["records"]
                if name in _RECORDS
            }
            return cls(
                unique_id=str(document["unique_id"]),
                build_id=str(document["build_id"]),
                params={str(name): float(v) for name, v in document["params"].items()},
                next_trial=int(document["next_trial"]),
                signed=bool(document.get("signed", False)),
                made=str(document["made"]),
                **records,
            )
        except OSError as error:
            why = f"cannot read {error.filename or folder} ({reason(error)})"
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            why = f"{folder / _BOARD} is damaged ({error})"
        raise InputError(
            f"{folder} is no backup of a board: {why}",
            "Give the folder that tailbeat flash made; it holds board.json.",
        )


def new_folder(root: Path, unique_id: str, now: datetime | None = None) -> Path:
    """Makes ``root/DATE_TIME_ID``, ID being the beginning of the unique id; never an old one."""
    stamp = (now or datetime.now()).strftime("%Y-%m-%d_%H%M%S")
    for number in range(1, 100):
        suffix = "" if number == 1 else f"_{number}"
        folder = root / f"{stamp}_{unique_id[:8]}{suffix}"
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        return folder
    raise InputError(f"{root} holds 99 backups of this second", "Use another folder: --out FOLDER")
