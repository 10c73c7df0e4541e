"""Named sets of parameters."""

from __future__ import annotations

from collections.abc import Mapping

from tailbeat.core.errors import InputError, did_you_mean
from tailbeat.core.law import Law

_LAW = Law()
THESIS: Mapping[str, float] = {
    "AMP_MAX_RAD": _LAW.amplitude_max_rad,
    "DU_MAX_RAD": _LAW.step_max_rad,
    **_LAW.params(),
    "ROLLBACK_RATIO": 0.0,
}
"""The learning law of (8.16) and its amplitude limit, as in the simulations of chapter 8: no limit
of the change per trial, no rollback."""

PRESETS: Mapping[str, Mapping[str, float]] = {"thesis": THESIS}


def preset(name: str) -> Mapping[str, float]:
    """The values of a preset, by parameter name. Raises InputError."""
    try:
        return PRESETS[name]
    except KeyError:
        raise InputError(
            f"there is no preset '{name}'.",
            f"{did_you_mean(name, PRESETS)}Use {' or '.join(sorted(PRESETS))}.",
        ) from None
