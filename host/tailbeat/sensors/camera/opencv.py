"""OpenCV and PyAV, of the extra ``camera``: what needs them asks here."""

from __future__ import annotations

from typing import Any

from tailbeat.core.extras import need


def need_cv2() -> Any:
    """The module cv2. Raises InputError with the way to install it."""
    return need("cv2", "camera", "Working with images needs OpenCV")


def need_av() -> Any:
    """The module av. Raises InputError with the way to install it."""
    return need("av", "camera", "Reading films needs PyAV")
