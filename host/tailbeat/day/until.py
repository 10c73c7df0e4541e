"""When a series of swims ends."""

from __future__ import annotations

from dataclasses import dataclass

from tailbeat.errors import InputError

CONVERGED, BATTERY = "converged", "battery"
_SWIMS_MAX = 999


@dataclass(frozen=True)
class Until:
    """When a series ends: after ``swims`` swims that were kept, when the verdict says that there is
    nothing more to gain (``converged``), always when the battery is too low to swim on."""

    swims: int | None = 1
    converged: bool = False

    @classmethod
    def parse(cls, text: str) -> Until:
        """``converged``, ``battery`` or a number. Raises InputError."""
        word = text.strip().lower()
        if word == CONVERGED:
            return cls(None, converged=True)
        if word == BATTERY:
            return cls(None)
        if word.isascii() and word.isdigit() and 1 <= int(word) <= _SWIMS_MAX:
            return cls(int(word))
        raise InputError(
            f"'{text}' says no end of a series.",
            f"Say {CONVERGED}, {BATTERY} or a number of swims (1 to {_SWIMS_MAX}).",
        )
