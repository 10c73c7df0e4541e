"""What the battery allows: told before the board refuses, from how it fell so far."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

_LOOK_BACK = 3  # swims the fall is averaged over: one reading scatters by some 20 mV


@dataclass(frozen=True)
class Drain:
    """One swim's voltages: ``start_v`` at rest before it, ``end_v`` at its end, ``least_v`` the
    least while the servo drew its current."""

    start_v: float
    end_v: float
    least_v: float


def too_low(now_v: float, params: Mapping[str, float]) -> str | None:
    """Why the board would refuse to arm, or None."""
    limit_v = params.get("BATT_LOW_V", 0.0)
    if limit_v <= 0 or now_v >= limit_v:
        return None
    return f"the battery has {now_v:.2f} V, and below {limit_v:.2f} V the board does not arm"


def forecast(now_v: float, drains: Sequence[Drain], params: Mapping[str, float]) -> str | None:
    """What will go wrong in the next swim or the one after it, or None. ``drains``: of the swims
    on this battery, oldest first."""
    recent = drains[-_LOOK_BACK:]
    if not recent:
        return None
    sag_v = max(drain.start_v - drain.least_v for drain in recent)
    critical_v = params.get("BATT_CRIT_V", 0.0)
    if critical_v > 0 and now_v - sag_v < critical_v:
        return (
            f"the battery will not last: it has {now_v:.2f} V, a swim takes it {sag_v:.2f} V down,"
            f" and below {critical_v:.2f} V the tail stops; change it before this swim"
        )
    starts = [*(drain.start_v for drain in recent), now_v]
    fall_v = (starts[0] - starts[-1]) / len(recent)
    low_v = params.get("BATT_LOW_V", 0.0)
    if low_v > 0 and fall_v > 0 and now_v - fall_v < low_v:
        return (
            f"the battery has {now_v:.2f} V and falls by {fall_v:.2f} V per swim: below"
            f" {low_v:.2f} V the board will not arm after this one; have a charged one ready"
        )
    return None
