"""NiceGUI is an extra: what needs it asks here."""

from __future__ import annotations

from importlib import import_module

from tailbeat.errors import InputError


def need_nicegui() -> None:
    """Raises InputError with the way to install it."""
    try:
        import_module("nicegui")
    except ImportError as error:
        raise InputError(
            "the page needs NiceGUI", "Install it: pip install 'tailbeat[ui]'"
        ) from error
