"""How far AMP_MAX_RAD may rise: as far as the reference needs, a run has shown that the fish stands
it, the servo turns and the tank has room.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError
from tailbeat.core.reference import Reference
from tailbeat.core.trial_checks import HeadingDrift
from tailbeat.experiment.library import identified_if_readable, library_of
from tailbeat.learning.identification import Identified
from tailbeat.learning.planner import plan
from tailbeat.learning.saturation import (
    GRAIN_RAD,
    down_to_grain,
    hold_rad,
    needed_rad,
    servo_rad,
    up_to_grain,
)
from tailbeat.session.events import Operator
from tailbeat.session.outcome import Travel
from tailbeat.session.travel import travel_of

AMP_MAX = "AMP_MAX_RAD"


@dataclass(frozen=True)
class LimitIncrease:
    """A limit that may be raised. ``reason``: why that far and no farther, with its figures."""

    name: str
    was: float
    to: float
    reason: str

    @property
    def text(self) -> str:
        """``AMP_MAX_RAD (the largest amplitude) from 0.50 to 0.60 rad: ...``."""
        rise = f"from {self.was:.2f} to {self.to:.2f} rad"
        return f"{self.name} (the largest amplitude of the tail) {rise}: {self.reason}"

    def is_typed_by(self, operator: Operator) -> bool:
        """Whether the operator allows it, by its number."""
        typed = operator.number(f"{self.text}. To allow it, type", self.to)
        return typed is not None and math.isclose(typed, self.to, abs_tol=1e-4)


def limit_offer(
    params: Mapping[str, float],
    reference: Reference,
    identified: Identified | None,
    straight: HeadingDrift | None,
    rolled_back: bool = False,
) -> LimitIncrease | str:
    """The limit that may be offered, or why there is none: enough for the reference with a margin,
    not identified, not straight, rolled back, no run went so far, no room in the tank, the servo's
    range."""
    now = params[AMP_MAX]
    stays = f"{AMP_MAX} stays {now:.2f}"
    if identified is None:
        return (
            f"{stays}: the amplitude that the reference needs is not known yet:"
            " tailbeat session commission"
        )
    need = needed_rad(identified, reference)
    if need <= now + GRAIN_RAD / 2:
        return f"{stays}: enough, the reference needs {need:.2f} with what learning adds"
    if (why := _not_now(straight, rolled_back)) is not None:
        return f"{stays}: {why}"
    shown = tried_rad(identified)
    to = min(up_to_grain(need), down_to_grain(servo_rad(params)), down_to_grain(shown))
    if to < now + GRAIN_RAD / 2:
        return f"{stays}: {_held_words(params, shown, need)}"
    travel = _travel(params, reference, identified, to)
    if not travel.fits:
        return f"{stays}: the tank clearance is used up, the trial would come {travel.text()}"
    return LimitIncrease(AMP_MAX, now, to, _reason(reference, identified, need, travel))


def require_tried(fish: Fish, limit_rad: float) -> None:
    """Raises InputError for a limit that is larger than the board's and than any run of the fish
    that was executed without a fault."""
    if limit_rad <= fish.params.get(AMP_MAX).value:
        return
    identified = identified_if_readable(library_of(fish))
    allowed = 0.0 if identified is None else tried_rad(identified)
    if limit_rad > allowed + GRAIN_RAD / 2:
        why = f"no trial of it went beyond {allowed:.2f} rad" if allowed else "it was not measured"
        raise InputError(
            f"{AMP_MAX} may not become {limit_rad:.2f} for this fish: {why}.",
            "Measure the fish: tailbeat session commission",
        )


def tried_rad(identified: Identified) -> float:
    """The largest amplitude of the runs by which the fish is known; 0 without any."""
    tops = (float(trial.amplitude_rad.max()) for trial in identified.trials)
    return round(max(tops, default=0.0), 4)  # the board's are float32


def allowed_rad(identified: Identified, params: Mapping[str, float]) -> float:
    """As far as AMP_MAX_RAD may be raised: by the servo, and by what a run went to if there was
    one."""
    return min(servo_rad(params), tried_rad(identified) or math.inf)


def _not_now(straight: HeadingDrift | None, rolled_back: bool) -> str | None:
    if rolled_back:
        return (
            "the board has just rolled back to its best input, so a larger limit is not safe now."
            " Run trials until it learns again"
        )
    if straight is None:
        return (
            "no trial with this centre of the tail tells its heading error, which takes an IMU or a"
            " camera. If you see that it swims straight, raise the limit yourself: tailbeat params"
            " set"
        )
    if straight.crooked:
        off = abs(math.degrees(straight.worst_yaw_rad))
        return f"it does not swim straight ({off:.0f} degrees off): tailbeat session trim"
    return None


def _held_words(params: Mapping[str, float], shown: float, need: float) -> str:
    servo = servo_rad(params)
    if shown < down_to_grain(servo):
        return (
            f"no trial of the fish went beyond {shown:.2f} rad, and the reference needs {need:.2f}:"
            " tailbeat session commission"
        )
    low, high = params["SERVO_MIN_US"], params["SERVO_MAX_US"]
    return (
        f"the servo turns {servo:.2f} rad to the shorter side ({low:.0f} to {high:.0f} us around "
        f"{params['SERVO_CENTRE_US']:.0f}). The reference needs {need:.2f}; use a slower one"
    )


def _travel(
    params: Mapping[str, float], reference: Reference, identified: Identified, to: float
) -> Travel:
    """Of what the law tends to with that limit: the best input of the model."""

    best = plan(identified.model, reference.speed_m_s, reference.beat_s, to)
    allowed = dict(params) | {AMP_MAX: to}
    return travel_of(best.amplitude_rad, allowed, reference.beat_s, identified)


def _reason(reference: Reference, identified: Identified, need: float, travel: Travel) -> str:
    top = float(np.max(reference.speed_m_s)) * 1e3
    words = f"the reference needs {need:.2f}, {hold_rad(identified, reference):.2f} for its"
    tried = f"a trial went to {tried_rad(identified):.2f} without a fault"
    return f"{words} {top:.0f} mm/s; {tried}; the fish travels {travel.text()}"
