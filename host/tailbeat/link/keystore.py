"""The keys this computer has: one file each, for nobody else to read.

They lie in ``$TAILBEAT_KEYS``, else in ``tailbeat/keys`` of the user's configuration. A file also
holds how far signing time has come with its key, so that the time never goes back, whatever the
computer's clock says.
"""

from __future__ import annotations

import contextlib
import json
import os
from dataclasses import dataclass, field, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tailbeat.core.errors import InputError, reason
from tailbeat.core.extras import lazy
from tailbeat.core.files import locked, plain, replace_file
from tailbeat.core.platform.files import readable_by_others
from tailbeat.core.printable import Hex

if TYPE_CHECKING:
    import hashlib

    from tailbeat.core import decode
else:  # 25 ms that only keys need
    hashlib, decode = lazy("hashlib"), lazy("tailbeat.core.decode")
unix = lazy("platformdirs.unix")

KEY_BYTES = 32
_FORMAT = "tailbeat key 1"
_FOLDER = "TAILBEAT_KEYS"
_OWNER_ONLY = 0o600
_LINK_IDS = 255  # 0 is the board's
_FINGERPRINT_BYTES = 4
_TIME_MAX = (1 << 48) - 1
_SMALL_BYTES = 65536  # no key file is as long


@dataclass(frozen=True)
class StoredKey:
    """A key and what goes with it. Times are ticks of 10 us since 2015.

    ``board``: unique id of the board it was set on. ``link_id``: this computer among those that
    hold the key. ``used``, ``heard``: the newest times this computer signed with, and heard; 0 =
    never.
    """

    key: bytes = field(repr=False)
    board: str
    name: str = ""
    created: str = ""
    link_id: int = 1
    used: int = 0
    heard: int = 0

    @property
    def fingerprint(self) -> str:
        """Names the key without giving it away."""
        digest = hashlib.sha256(b"tailbeat fingerprint" + self.key).digest()
        return digest[:_FINGERPRINT_BYTES].hex()

    @property
    def newest(self) -> int:
        """The newest time known to have been signed with the key."""
        return max(self.used, self.heard)

    @property
    def confirmed(self) -> bool:
        """Whether a board was ever heard to sign with it. One that was not may have been sent and
        never taken."""
        return self.heard > 0

    def public(self) -> dict[str, str]:
        """All that may be shown."""
        return {
            "key": self.fingerprint,
            "board": self.board,
            "name": self.name,
            "created": self.created,
        }

    def matches(self, which: str) -> bool:
        """Whether ``which`` means this key: its name, fingerprint or board, or their beginning."""
        if self.name and which == self.name:
            return True
        return len(which) >= 4 and any(
            text.startswith(which.lower()) for text in (self.fingerprint, self.board)
        )


def new_key(board: str, name: str = "") -> StoredKey:
    """A key nobody can guess. Raises InputError when the name cannot be shown."""
    if not name.isprintable():
        raise InputError("the name of a key has signs that cannot be shown", "Choose another.")
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return StoredKey(os.urandom(KEY_BYTES), board, name, now, _new_link_id())


def encode_key(key: StoredKey) -> bytes:
    """A key as a file, the secret in it."""
    document = {"format": _FORMAT, **plain(key)}
    return json.dumps(document, indent=2).encode() + b"\n"


@dataclass(frozen=True)
class _KeyFile:
    """A key's file."""

    format: Literal["tailbeat key 1"]
    key: Hex
    board: str
    name: str
    created: str
    link_id: int
    used: int
    heard: int


def decode_key(content: bytes, where: str) -> StoredKey:
    """The key in a file. Raises InputError, which does not show the content."""
    remedy = "Take a file that 'tailbeat board key export' wrote."
    try:
        held = decode.decode(content, _KeyFile, where, remedy)
    except InputError:
        raise InputError(f"{where} holds no key", remedy) from None
    board_ok = held.board.isalnum() and held.board.isascii() and len(held.board) <= 64
    words_ok = held.name.isprintable() and held.created.isprintable()
    times_ok = 0 <= held.used <= _TIME_MAX and 0 <= held.heard <= _TIME_MAX
    numbers_ok = 1 <= held.link_id <= _LINK_IDS and times_ok
    if (
        len(held.key) != KEY_BYTES
        or not any(held.key)
        or not (board_ok and words_ok and numbers_ok)
    ):
        raise InputError(f"{where} holds no key", remedy)
    return StoredKey(**{f.name: getattr(held, f.name) for f in fields(StoredKey)})


def _new_link_id(other: int = 0) -> int:
    """Computers with one key sign under different numbers, or their frames would count as replays
    of each other's."""
    number = 1 + os.urandom(1)[0] % _LINK_IDS
    return number if number != other else 1 + number % _LINK_IDS


class KeyStore:
    """The folder of keys. Nothing is created before a key is saved. Raises InputError when a file
    is in its place."""

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder if folder is not None else _default_folder()
        if _is_file(self.folder):
            raise InputError(
                f"{self.folder} is no folder, so no keys can lie in it",
                f"Name a folder in {_FOLDER}, or move the file away.",
            )

    def load(self) -> tuple[list[StoredKey], list[str]]:
        """All keys, oldest first, and one line for each file that is not used and why."""
        keys: list[StoredKey] = []
        problems: list[str] = []
        for path in self._paths():
            try:
                _require_private(path)
                keys.append(decode_key(path.read_bytes()[:_SMALL_BYTES], str(path)))
            except OSError as error:
                problems.append(f"cannot read {path} ({reason(error)})")
            except InputError as error:
                problems.append(str(error))
        return sorted(keys, key=lambda key: key.created), problems

    def usable(self) -> list[StoredKey]:
        """All keys that can be used, oldest first."""
        return self.load()[0]

    def __bool__(self) -> bool:
        """Whether there is any file in it."""
        return bool(self._paths())

    def find(self, which: str | None) -> StoredKey:
        """The one key meant; None = the only one there is. Raises InputError."""
        keys, problems = self.load()
        found = [key for key in keys if which is None or key.matches(which)]
        if len(found) == 1:
            return found[0]
        if not keys:
            why = f" ({problems[0]})" if problems else ""
            raise InputError(
                f"this computer has no key{why}",
                "Set one with 'tailbeat board key set', or bring one with 'tailbeat board key "
                "import'.",
            )
        names = ", ".join(f"{k.fingerprint} of board {k.board[:8]} {k.name}".rstrip() for k in keys)
        what = "there are several keys" if which is None else f"'{which}' names no single key"
        raise InputError(f"{what}: {names}", "Give the fingerprint of one of them.")

    def save(self, key: StoredKey) -> None:
        """Keeps the key; it is on the disk when this returns. Times never go back."""
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            with locked(self.folder):
                self._save(key)
        except OSError as error:
            raise InputError(
                f"cannot keep the key in {self.folder} ({reason(error)})",
                f"Make the folder writable, or name another one in {_FOLDER}.",
            ) from error

    def _save(self, key: StoredKey) -> None:
        path = self._path(key)
        with contextlib.suppress(OSError, InputError):
            old = decode_key(path.read_bytes(), str(path))
            key = replace(key, used=max(key.used, old.used), heard=max(key.heard, old.heard))
        write_private(path, encode_key(key))

    def note(self, key: StoredKey, used: int, heard: int) -> None:
        """Keeps how far time has come with ``key``, unless it was deleted meanwhile."""
        if self._path(key).exists():
            self.save(replace(key, used=used, heard=heard))

    def add(self, key: StoredKey) -> StoredKey:
        """Takes in a key from another computer; under a number of its own, unless it is here
        already."""
        for held in self.usable():
            if held.key == key.key:
                self.save(replace(held, used=key.used, heard=key.heard))
                return held
        own = replace(key, link_id=_new_link_id(key.link_id))
        self.save(own)
        return own

    def delete(self, key: StoredKey) -> None:
        """Deletes the key from this computer."""
        self._path(key).unlink(missing_ok=True)

    def delete_others(self, key: StoredKey) -> None:
        """Deletes all other keys of the same board: it has this one now."""
        if not self._path(key).exists():
            self.save(key)  # another process took it for one that never arrived
        for other in self._others(key):
            self.delete(other)

    def delete_unconfirmed(self, key: StoredKey) -> None:
        """Deletes the keys that the board never signed with: it signs with ``key``. A disk that
        keeps them is no reason to stop."""
        for other in self._others(key):
            if not other.confirmed:
                with contextlib.suppress(OSError):
                    self.delete(other)

    def newest_of(self, board: str) -> StoredKey | None:
        """The key that a board was last heard to sign with."""
        keys = [key for key in self.usable() if key.board == board and key.confirmed]
        return max(keys, key=lambda key: key.heard, default=None)

    def _others(self, key: StoredKey) -> list[StoredKey]:
        return [k for k in self.usable() if k.board == key.board and k.key != key.key]

    def _paths(self) -> list[Path]:
        with contextlib.suppress(OSError):
            return sorted(self.folder.glob("*.json"))
        return []

    def _path(self, key: StoredKey) -> Path:
        return self.folder / f"{key.board[:8]}-{key.fingerprint}.json"


def _default_folder() -> Path:
    if named := os.environ.get(_FOLDER):
        return Path(named).expanduser()
    return Path(unix.Unix("tailbeat").user_config_path, "keys")  # the same place on every system


def _is_file(path: Path) -> bool:
    with contextlib.suppress(OSError):
        return path.exists() and not path.is_dir()
    return False


def _require_private(path: Path) -> None:
    if readable_by_others(path):
        raise InputError(
            f"the key in {path} is not used, because others can read it", f"Run: chmod 600 {path}"
        )


def write_private(path: Path, content: bytes, anew: bool = False) -> None:
    """Writes a file that only its owner can read, whole or not at all. ``anew``: there must be
    none of that name (FileExistsError). Raises OSError."""
    if anew and path.exists():
        raise FileExistsError(17, "it exists already", str(path))
    replace_file(path, content, _OWNER_ONLY)
