"""trim."""

from __future__ import annotations


def trim() -> None:
    """To be written.

    Example: tailbeat trim
    """
    raise NotImplementedError
