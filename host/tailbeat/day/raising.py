"""How far AMP_MAX_RAD may rise, and why no farther. Pure rules."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tailbeat.saturation import (
    GRAIN_RAD,
    down_to_grain,
    hold_rad,
    needed_rad,
    servo_rad,
    up_to_grain,
)
from tailbeat.travel import travel_of

if TYPE_CHECKING:
    from tailbeat.model.identified import Identified
    from tailbeat.reference import Reference
    from tailbeat.straight import Straightness
    from tailbeat.travel import Travel

AMP_MAX = "AMP_MAX_RAD"
RAISE_MAX_RAD = 0.1


@dataclass(frozen=True)
class Raise:
    """A limit that may be raised. ``reason``: why that far and no farther, with its figures."""

    name: str
    was: float
    to: float
    reason: str

    @property
    def text(self) -> str:
        """``AMP_MAX_RAD from 0.50 to 0.60: ...``."""
        return f"{self.name} from {self.was:.2f} to {self.to:.2f}: {self.reason}"


def next_raise(
    params: Mapping[str, float],
    reference: Reference,
    identified: Identified | None,
    straight: Straightness | None,
    rolled_back: bool = False,
) -> Raise | str:
    """The next step for AMP_MAX_RAD (at most RAISE_MAX_RAD at once), or why there is none: enough
    for the reference with a margin, not identified, not straight, rolled back, no room in the tank,
    the servo's range. DU_MAX_RAD stays: it slows the way to an amplitude, and forbids none."""
    now = params[AMP_MAX]
    stays = f"{AMP_MAX} stays {now:.2f}"
    if identified is None:
        return f"{stays}: nobody knows yet what amplitude the reference needs: tailbeat identify"
    need = needed_rad(identified, reference)
    if need <= now + GRAIN_RAD / 2:
        return f"{stays}: enough, the reference needs {need:.2f} with what learning adds"
    if (why := _not_now(straight, rolled_back)) is not None:
        return f"{stays}: {why}"
    servo = servo_rad(params)
    to = min(now + RAISE_MAX_RAD, up_to_grain(need), down_to_grain(servo))
    if to < now + GRAIN_RAD / 2:
        return f"{stays}: {_servo_words(params, servo, need)}"
    travel = _travel(params, reference, identified, to)
    if not travel.fits:
        return f"{stays}: no room for more, the swim would come {travel.text()}"
    return Raise(AMP_MAX, now, to, _reason(params, reference, identified, need, to, travel))


def _not_now(straight: Straightness | None, rolled_back: bool) -> str | None:
    if rolled_back:
        return (
            "the board has just rolled back to its best input, and what went wrong would have more"
            " room; swim until it learns again"
        )
    if straight is None:
        return (
            "nothing tells whether it swims straight (an IMU or a camera would); if you see that it"
            " does, raise it yourself: tailbeat params set"
        )
    if straight.crooked:
        off = abs(math.degrees(straight.worst_yaw_rad))
        return f"it does not swim straight ({off:.0f} degrees off): tailbeat trim"
    return None


def _servo_words(params: Mapping[str, float], servo: float, need: float) -> str:
    low, high = params["SERVO_MIN_US"], params["SERVO_MAX_US"]
    return (
        f"the servo turns {servo:.2f} rad to the shorter side ({low:.0f} to {high:.0f} us around "
        f"{params['SERVO_CENTRE_US']:.0f}), and the reference needs {need:.2f}; use a slower one"
    )


def _travel(
    params: Mapping[str, float], reference: Reference, identified: Identified, to: float
) -> Travel:
    """Of what the law tends to with that limit: the best input of the model."""
    from tailbeat.model.planner import plan

    best = plan(identified.model, reference.speed_m_s, reference.beat_s, to)
    allowed = dict(params) | {AMP_MAX: to}
    return travel_of(best.amplitude_rad, allowed, reference.beat_s, identified)


def _reason(
    params: Mapping[str, float],
    reference: Reference,
    identified: Identified,
    need: float,
    to: float,
    travel: Travel,
) -> str:
    top = float(np.max(reference.speed_m_s)) * 1e3
    words = (
        f"{hold_rad(identified, reference):.2f} rad hold the {top:.0f} mm/s of the reference, and "
        f"it needs {need:.2f} with what learning adds"
    )
    if to < need - GRAIN_RAD / 2:
        at_once = to >= params[AMP_MAX] + RAISE_MAX_RAD - GRAIN_RAD / 2
        limit = f"at most {RAISE_MAX_RAD:g} at once" if at_once else "the servo turns no farther"
        words += f"; {limit}"
    step = params.get("DU_MAX_RAD", 0.0)
    if step > 0:
        words += f"; DU_MAX_RAD stays {step:.2f} per trial"
    return f"{words}; way {travel.text()}"
