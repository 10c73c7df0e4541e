"""Named sets of parameter values: ``tailbeat params preset NAME``, and what the demo runs with."""

from __future__ import annotations

from collections.abc import Mapping

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError
from tailbeat.core.law import Law
from tailbeat.link.params import Parameter

_LAW = Law()
THESIS: Mapping[str, float] = {
    "AMP_MAX_RAD": _LAW.amplitude_max_rad,
    "DU_MAX_RAD": _LAW.step_max_rad,
    **_LAW.params(),
}
"""The learning law of (8.16) and its amplitude limit, as in the simulations of chapter 8."""

PRESETS: Mapping[str, Mapping[str, float]] = {"thesis": THESIS}


def preset(name: str) -> Mapping[str, float]:
    """The values of a preset, by parameter name. Raises InputError."""
    try:
        return PRESETS[name]
    except KeyError:
        raise InputError(
            f"there is no preset '{name}'.", f"Use {' or '.join(sorted(PRESETS))}."
        ) from None


def apply(fish: Fish, values: Mapping[str, float]) -> dict[str, tuple[float, Parameter]]:
    """Sets each parameter; its value before and what the board holds now."""
    return {
        name: (fish.params.get(name).value, fish.params.set(name, value))
        for name, value in values.items()
    }
