"""The compiled laws in either precision: firmware/ilc and the slow plants, bound with cffi."""

from __future__ import annotations

from functools import cache
from typing import Literal

from tailbeat.core.native import HERE, Native, load_library

Precision = Literal["double", "float"]

_BITS = {"double": 64, "float": 32}


@cache
def load(precision: Precision = "double") -> Native:
    """The library whose ``number_t`` is ``precision``.

    Raises:
        NativeLibraryError: when it is not there or was built for another machine.
    """
    bits = _BITS[precision]
    return load_library(HERE / f"thesis{bits}.cdef", HERE / f"libtailbeat_thesis{bits}.so")
