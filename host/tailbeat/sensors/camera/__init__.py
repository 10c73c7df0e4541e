"""The overhead camera. Its libraries, of the extra ``camera``, are loaded when first used.

Their first use raises InputError with the way to install them when they are missing.
"""

from __future__ import annotations

from typing import Any

from tailbeat.core.extras import LazyModule, need


def require_cv2() -> Any:
    """The module cv2, at once. Raises InputError with the way to install it."""
    return need("cv2", "camera", "Working with images needs OpenCV")


def require_av() -> Any:
    """The module av, at once. Raises InputError with the way to install it."""
    return need("av", "camera", "Reading films needs PyAV")


cv2: Any = LazyModule("cv2", require_cv2)
av: Any = LazyModule("av", require_av)
