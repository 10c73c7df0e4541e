"""One short swim with a larger amplitude, before the limit rises to it for good.

The model was fitted below the old limit. Beyond it the servo may be too slow, the tail may touch
something, the fish may roll or turn; a swim shows it while the old limit still holds on the board.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tailbeat.day.raising import AMP_MAX
from tailbeat.day.ritual import countdown, prepare
from tailbeat.day.shift import slope_of
from tailbeat.errors import TailbeatError
from tailbeat.guards import BY_HAND, RoomGuard, together, when
from tailbeat.logbook import RUN, logbook_of
from tailbeat.model.lent import lent, safe_folder
from tailbeat.straight import Straightness, straightness
from tailbeat.travel import travel_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tailbeat.camera.base import Camera
    from tailbeat.day.person import Person
    from tailbeat.day.ritual import Wanted
    from tailbeat.fish import Fish, Guard
    from tailbeat.model.identified import Identified
    from tailbeat.results import TrialOutcome
    from tailbeat.trial_log import Trial

Array = NDArray[np.float64]

AS_TOLD = 0.15  # of the speed the model tells: beyond it the model is not this fish up there
_RAMP_BEATS, _CRUISE_BEATS, _CRUISE_LEAST, _COAST_BEATS = 4, 10, 4, 4
_MARGIN_M = 0.15  # of the tank, left free, as identify does


@dataclass(frozen=True)
class Proof:
    """``why_not``: what speaks against the amplitude; empty = nothing. ``words``: what was seen."""

    words: str
    why_not: str
    straight: Straightness | None


def prove(
    fish: Fish,
    amplitude_rad: float,
    identified: Identified,
    person: Person,
    camera: Camera | None = None,
    guard: Guard | None = None,
    wanted: Wanted | None = None,
) -> Proof:
    """Swims up to ``amplitude_rad``; the board has its limit and all it had learned back
    afterwards, also when it fails. ``wanted``: of the ritual before it; None = none. Raises
    TailbeatError when the swim ends early."""
    book = logbook_of(fish)

    def note(text: str) -> None:
        person.tell({"event": "notice", "text": text})

    def keep(path: Path) -> None:
        if book is not None:
            book.keep(path, RUN)

    with lent(fish, safe_folder(book), note, "session first", (AMP_MAX,)) as board:
        allowed = board.params | {AMP_MAX: amplitude_rad}
        amplitude = profile(amplitude_rad, identified, allowed)
        if amplitude is None:
            return Proof("", "the tank is too short even for the shortest swim with it", None)
        predicted = identified.model.beats(amplitude, 1.0)
        replace(board, params=allowed).prepare(
            "first session", amplitude, predicted, {AMP_MAX: amplitude_rad}
        )
        if wanted is not None:
            prepare(fish, wanted, camera, person)
            countdown(fish, wanted, person)
        watch = together(
            guard, RoomGuard.of_params(allowed, 1.0, None, predicted),
            when(person.wants_abort, BY_HAND),
        )  # fmt: skip
        trial = board.swim(camera, person.tell, watch, lambda o: _judge(fish, o), keep)
    return judged(trial, identified)


def profile(
    amplitude_rad: float, identified: Identified, params: Mapping[str, float]
) -> Array | None:
    """Up in four steps, as long at the amplitude as fits, then a coast; None = nothing fits."""
    foot = min(identified.model.dead_zone_rad, amplitude_rad)
    steps = np.arange(1, _RAMP_BEATS + 1) / (_RAMP_BEATS + 1)
    ramp = foot + (amplitude_rad - foot) * steps
    for beats in range(_CRUISE_BEATS, _CRUISE_LEAST - 1, -1):
        swim = np.concatenate([ramp, np.full(beats, amplitude_rad), np.zeros(_COAST_BEATS)])
        travel = travel_of(swim, params, 1.0, identified)
        if travel.worst_m <= travel.room_m - _MARGIN_M:
            return swim
    return None


def judged(trial: Trial, identified: Identified) -> Proof:
    """What the swim says of the amplitude."""
    straight = straightness(trial)
    part = slope_of(trial, identified.model)
    words = f"proved by a swim: {part:.2f} of the speed foretold"
    if straight is not None:
        words += f", {straight.text()}"
    if straight is not None and straight.crooked:
        return Proof(words, straight.text(), straight)
    if np.isnan(part):
        return Proof(words, "its swim has no speeds", straight)
    if abs(part - 1) > AS_TOLD:
        how = "slower" if part < 1 else "faster"
        why = f"it swam {abs(part - 1):.0%} {how} than foretold: look at servo and tail, identify"
        return Proof(words, why, straight)
    return Proof(words, "", straight)


def _judge(fish: Fish, outcome: TrialOutcome) -> None:
    if outcome.end == "complete":
        return
    raise TailbeatError(
        f"the swim that was to prove it ended with {outcome.end} after "
        f"{outcome.executed_beats} beats; the limit stays.",
        "Put it right, then: tailbeat session first",
    )
