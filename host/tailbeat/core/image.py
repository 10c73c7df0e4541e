"""Where the flash image is: in the clone that runs this program, or in the installed package."""

from __future__ import annotations

from pathlib import Path

from tailbeat.core.errors import InputError
from tailbeat.core.extras import checkout

PACKAGED = Path(__file__).parent.parent / "firmware" / "tailbeat.bin"
_BUILT = Path("build") / "firmware"


def image_remedy() -> str:
    """What to do about a missing or a wrong image: a command that works where this is installed."""
    if (root := checkout()) is not None:
        return f"Build it in {root}: make firmware"
    if PACKAGED.is_file():
        return "Leave IMAGE out: the installed package contains one."
    return "Reinstall tailbeat from a wheel: wheels contain the image."


def default_image(ending: str = ".bin") -> Path:
    """The image to take when none is named.

    Parameters
    ----------
    ending : ".bin" or ".elf"; only a clone has the .elf.

    Raises
    ------
    InputError
        When there is none.
    """
    root = checkout()
    path = root / _BUILT / f"tailbeat{ending}" if root is not None else PACKAGED
    if not path.is_file():
        raise InputError(f"there is no flash image {path}", image_remedy())
    return path
