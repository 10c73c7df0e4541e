"""The flash image: what is written, and which build it is."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from pathlib import Path

from tailbeat.core.errors import InputError, reason
from tailbeat.core.extras import BUILD_IMAGE

# Flash bank 0, which alone holds code, and the RAM a stack can lie in.
_CODE = range(0x00080000, 0x000C0000)
_RAM_FIRST, _RAM_END = 0x20000000, 0x20088000

# As in firmware/link/build_id.c.
_BUILD_ID = re.compile(rb"tailbeat build id: ([0-9][\x21-\x7e]{0,48})\0")
# The board says its id in one STATUSTEXT behind "tailbeat ", which cuts a longer one.
_SENT_CHARS = 40


@dataclass(frozen=True)
class Image:
    """The bytes of flash bank 0 from its first on, and the id of the build they are."""

    path: Path
    size_bytes: int
    build_id: str

    @classmethod
    def load(cls, path: Path) -> Image:
        """Reads a .bin and checks that it can boot on the chip. Raises InputError."""
        data = _read(path)
        problem = _not_bootable(data)
        if problem:
            raise InputError(f"{path} is no image for the board: {problem}", BUILD_IMAGE)
        return cls(path, len(data), _build_id(path, data))

    def elf(self) -> Path:
        """The .elf next to the .bin. Raises InputError when it is missing or of another build."""
        path = self.path.with_suffix(".elf")
        if build_id_of(path) != self.build_id:
            raise InputError(f"{path} and {self.path.name} are of different builds", BUILD_IMAGE)
        return path

    def is_build(self, board_id: str) -> bool:
        """Whether a board that says ``board_id`` runs this image."""
        cut = len(board_id) == _SENT_CHARS and self.build_id.startswith(board_id)
        return cut or board_id == self.build_id


def build_id_of(path: Path) -> str:
    """The build that an .elf or .bin says it is of. Raises InputError."""
    return _build_id(path, _read(path))


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read the image {path} ({reason(error)})", BUILD_IMAGE) from error


def _not_bootable(data: bytes) -> str:
    """What is wrong with the first two words, which the chip loads at reset; empty if nothing."""
    if data.startswith(b"\x7fELF"):
        return "it is an ELF file; give the .bin beside it"
    if len(data) < 8:
        return "it is too short"
    if len(data) > len(_CODE):
        return f"its {len(data)} bytes do not fit into the {len(_CODE)} of flash bank 0"
    stack, entry = struct.unpack_from("<II", data)
    if not _RAM_FIRST < stack <= _RAM_END or stack % 4:
        return f"its stack would begin at {stack:#x}, which is not RAM"
    if entry % 2 == 0 or entry not in _CODE[: len(data)]:
        return f"it would start at {entry:#x}, which is not in it"
    return ""


def _build_id(path: Path, data: bytes) -> str:
    found = {match[1] for match in _BUILD_ID.finditer(data)}
    if len(found) != 1:
        raise InputError(f"{path} does not say which build of tailbeat it is", BUILD_IMAGE)
    return found.pop().decode()
