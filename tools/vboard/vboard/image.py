"""The image that is flashed: bytes and, from an ELF file, names."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from functools import lru_cache
from io import BytesIO
from pathlib import Path

from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection

from vboard.core.memory import FLASH_SIZE, FLASH_START

SHORTEST = 8  # stack pointer and reset vector


class ImageError(Exception):
    """The file is no image for this chip."""


@dataclass
class Image:
    """What goes to flash at FLASH_START, and the addresses of symbols."""

    flash: bytes
    symbols: dict[str, int] = field(default_factory=dict)
    functions: list[tuple[int, str]] = field(default_factory=list)

    def where(self, address: int) -> str:
        """The function and the way into it, as far as known: "main+0x12"."""
        place = bisect_right(self.functions, (address, chr(0x10FFFF))) - 1
        if place < 0:
            return f"0x{address:08x}"
        start, name = self.functions[place]
        return f"0x{address:08x} in {name}+0x{address - start:x}"


def load(path: Path) -> Image:
    """Reads .elf or a raw .bin that starts at FLASH_START; the same object while the file stays as
    it is. Raises ImageError."""
    return _decoded(path, path.read_bytes())


@lru_cache(maxsize=4)  # the names of a large image take longer than to boot it
def _decoded(path: Path, data: bytes) -> Image:
    if not data.startswith(b"\x7fELF"):
        return Image(_fitting(path, data))
    elf = ELFFile(BytesIO(data))
    if elf["e_machine"] != "EM_ARM":
        raise ImageError(f"{path}: an ELF file for {elf['e_machine']}, not for Arm")
    image = Image(_fitting(path, _flash_of(path, elf)))
    _read_symbols(elf, image)
    return image


def _flash_of(path: Path, elf: ELFFile) -> bytes:
    flash = bytearray()
    for segment in elf.iter_segments("PT_LOAD"):
        content = segment.data()
        if not content:
            continue
        offset = segment["p_paddr"] - FLASH_START
        if offset < 0:
            raise ImageError(f"{path}: a segment at 0x{segment['p_paddr']:08x} is outside flash")
        flash.extend(b"\xff" * (offset + len(content) - len(flash)))
        flash[offset : offset + len(content)] = content
    return bytes(flash)


def _fitting(path: Path, flash: bytes) -> bytes:
    if len(flash) < SHORTEST:
        raise ImageError(f"{path}: {len(flash)} bytes are no image, not even its first two words")
    if len(flash) > FLASH_SIZE:
        raise ImageError(f"{path}: {len(flash)} bytes do not fit into {FLASH_SIZE} of flash")
    return flash


def _read_symbols(elf: ELFFile, image: Image) -> None:
    for section in elf.iter_sections():
        if not isinstance(section, SymbolTableSection):
            continue
        for symbol in section.iter_symbols():
            kind, address = symbol["st_info"]["type"], symbol["st_value"]
            if kind == "STT_FUNC":
                image.functions.append((address & ~1, symbol.name))
            if symbol.name and kind in ("STT_FUNC", "STT_OBJECT", "STT_NOTYPE"):
                image.symbols.setdefault(symbol.name, address)
    image.functions.sort()
