"""Units of columns and fields: they are the last part of the name."""

from __future__ import annotations

from collections.abc import Iterable

_UNITS = {
    "_10um_s": "10 um/s",
    "_100urad": "100 urad",
    "_1_m": "1/m",
    "_m_s": "m/s",
    "_rad": "rad",
    "_deg": "deg",
    "_um": "um",
    "_us": "us",
    "_ms": "ms",
    "_hz": "Hz",
    "_mv": "mV",
    "_v": "V",
    "_m": "m",
    "_s": "s",
}
_NAMED = {"timestamp": "us"}  # of ULog


def unit_of(name: str) -> str:
    """The unit of a column.

    Parameters
    ----------
    name : str
        For example ``speed_m_s``.

    Returns
    -------
    str
        For example ``m/s``; empty: a number without unit, or text.
    """
    endings = (unit for ending, unit in _UNITS.items() if name.endswith(ending))
    return _NAMED.get(name) or next(endings, "")


def units_of(names: Iterable[str]) -> dict[str, str]:
    """The units of those columns that have one, by name."""
    return {name: unit for name in names if (unit := unit_of(name))}
