"""What was so when the fish swam: water temperature and whatever else may matter later."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

from tailbeat.core.errors import InputError
from tailbeat.experiment.folder import Experiment

WATER_TEMPERATURE = "water_temperature_degc"
WORDS = ("operator", "configuration")
_KEY = re.compile(r"[a-z][a-z0-9_]*\Z")
_TEMPERATURE_DEGC = (0.0, 45.0)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\Z")

Conditions = dict[str, str | float]


def parse_conditions(pairs: Sequence[str], water_degc: float | None = None) -> Conditions:
    """``["salinity_psu=0.3", "wall=glass"]`` to values: numbers where they are numbers. Raises
    InputError."""
    found: Conditions = {}
    for pair in pairs:
        key, equals, text = (part.strip() for part in pair.partition("="))
        if not equals or not text or not _KEY.match(key):
            raise InputError(
                f"'{pair}' is no condition.",
                "Write it like water_depth_m=0.35: small letters, the unit in the name, a value.",
            )
        if key in found:
            raise InputError(f"{key} is given twice.", "Give it once.")
        found[key] = float(text) if _NUMBER.match(text) else text
    if water_degc is not None and found.setdefault(WATER_TEMPERATURE, water_degc) != water_degc:
        raise InputError(f"{WATER_TEMPERATURE} is given twice.", "Give it once.")
    _check_temperature(found.get(WATER_TEMPERATURE))
    return found


def _check_temperature(value: str | float | None) -> None:
    low, high = _TEMPERATURE_DEGC
    if value is None or (
        isinstance(value, float) and math.isfinite(value) and low <= value <= high
    ):
        return
    raise InputError(
        f"water of {value} degrees Celsius is not believed.",
        f"Give {low:g} to {high:g} degrees Celsius.",
    )


def set_conditions(
    experiment: Experiment, conditions: Conditions, words: dict[str, str] | None = None
) -> None:
    """What turns out later. The settings hold what is so now, the journal what was so when; it is
    written first. Raises InputError."""
    words = words or {}
    more: dict[str, Any] = dict(words)
    if not conditions and not words:
        raise InputError("nothing to set.", "Give --condition KEY=VALUE or --water-temp C.")
    settings = experiment.settings()
    held = settings.get("conditions", {})
    before = {key: held.get(key) for key in conditions}
    before |= {key: settings.get(key) for key in words}
    experiment.journal.add("set", conditions=conditions, before=before, **more)
    experiment.write_settings({"conditions": {**held, **conditions}, **words})
