"""Text to print: what comes from outside (a board, a file, somebody's note) made safe; speeds.

Control characters can make a terminal delete or replace what it shows, and characters that change
the direction of writing deceive the reader. All are shown as escapes, like ``\\x1b``.
"""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Iterable

_UNSAFE = ("Cc", "Cf", "Cs", "Zl", "Zp")  # controls, formats, surrogates, line separators


class Hex(bytes):
    """Bytes that a document holds as hexadecimal digits, as ``core.decode`` reads them."""


def printable(text: str) -> str:
    """One line of text, with every unsafe character as its escape; line ends and tabs, too."""
    return text if text.isprintable() else "".join(map(_shown, text))


def printable_lines(text: str) -> str:
    """As ``printable``, but line feeds stay."""
    return "\n".join(map(printable, text.split("\n")))


def mm(value_m_s: float | None, unknown: str = "-") -> str:
    """A speed in mm/s."""
    if value_m_s is None or not math.isfinite(value_m_s):
        return unknown
    return f"{value_m_s * 1e3:.1f}"


def amplitude_rows(amplitude_rad: Iterable[float]) -> str:
    """A CSV of the amplitudes of the beats, in full precision."""
    rows = (f"{beat},{float(value)!r}" for beat, value in enumerate(amplitude_rad))
    return "\n".join(["beat,amplitude_rad", *rows])


def _shown(sign: str) -> str:
    if unicodedata.category(sign) not in _UNSAFE:
        return sign
    return sign.encode("unicode_escape").decode("ascii")
