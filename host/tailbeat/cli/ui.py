"""ui."""

from __future__ import annotations


def ui() -> None:
    """To be written.

    Example: tailbeat ui
    """
    raise NotImplementedError
