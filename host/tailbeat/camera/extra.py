"""OpenCV and PyAV are an extra: what needs them asks here."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from tailbeat.errors import InputError

_REMEDY = "Install it: pip install 'tailbeat[camera]'"


def need_cv2() -> Any:
    """The module cv2. Raises InputError with the way to install it."""
    return _need("cv2", "looking at pictures needs OpenCV")


def need_av() -> Any:
    """The module av. Raises InputError with the way to install it."""
    return _need("av", "reading films needs PyAV")


def _need(name: str, why: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        raise InputError(why, _REMEDY) from error
