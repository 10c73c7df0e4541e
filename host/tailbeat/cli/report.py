"""report."""

from __future__ import annotations


def report() -> None:
    """To be written.

    Example: tailbeat report
    """
    raise NotImplementedError
