"""Who stands at a simulated tank: somebody with a script, and a camera over a fish that lies still,
drifts, is carried, or cannot be seen."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from tailbeat.board.fish import Fish
from tailbeat.core.speed_source import CameraGone, Frame
from tailbeat.session.events import Event, Notice, StepProgress
from tailbeat.session.outcome import Decision, RecordedTrial

Way = Callable[[float], tuple[float, float, float]]
"""x_m, y_m, heading_rad at a time since the camera was made."""


def lies(x_m: float = 0.0, y_m: float = 0.0, heading_deg: float = 0.0) -> Way:
    """A fish that stays where it is."""
    return lambda _: (x_m, y_m, math.radians(heading_deg))


def drifts(x_m_s: float, y_m_s: float = 0.0) -> Way:
    """One that the water carries."""
    return lambda t_s: (x_m_s * t_s, y_m_s * t_s, 0.0)


@dataclass
class Script:
    """Does what was agreed. ``aborts``: whether to stop, by what was told."""

    aborts: Callable[[list[Event]], bool] = lambda _: False
    told: list[Event] = field(default_factory=list)
    asked: int = 0
    on_tell: Callable[[Event], None] | None = None

    def tell(self, event: Event) -> None:
        """Notes it."""
        self.told.append(event)
        if self.on_tell is not None:
            self.on_tell(event)

    def wants_abort(self) -> bool:
        """By the script."""
        self.asked += 1
        return self.aborts(self.told)

    def decide(self, recorded: RecordedTrial) -> Decision:
        """Never asked by the preflight checks."""
        raise AssertionError(recorded)

    def confirm(self, question: str) -> bool:
        """Never asked by the preflight checks."""
        raise AssertionError(question)

    def number(self, question: str, value: float) -> float | None:
        return value

    def texts(self, step: str) -> list[str]:
        """What was told of a step."""
        return [e.text for e in self.told if isinstance(e, StepProgress) and e.step == step]

    def passed(self) -> list[str]:
        """Steps that were made, in order."""
        return [e.step for e in self.told if isinstance(e, StepProgress) and e.ok]

    def refused(self) -> list[str]:
        """Steps that were not."""
        return [e.step for e in self.told if isinstance(e, StepProgress) and e.ok is False]

    def notices(self) -> str:
        """All of them."""
        return "\n".join(e.text for e in self.told if isinstance(e, Notice))


class Overhead:
    """A camera of 25 pictures a second by the clock of the fish's transport, 80 ms late, with 1 mm
    of noise. ``seen``: whether it sees the fish at that time; ``gone_s``: when it dies."""

    def __init__(
        self,
        fish: Fish,
        way: Way,
        seed: int = 1,
        noise_m: float = 0.001,
        lost: float = 0.0,
        seen: Callable[[float], bool] = lambda _: True,
        gone_s: float = math.inf,
        clock: Literal["host", "board"] = "host",
    ) -> None:
        self.way, self.seen, self.gone_s = way, seen, gone_s
        self.clock, self.fps = clock, 25.0
        self._fish, self._noise_m, self._lost = fish, noise_m, lost
        self._rng = np.random.default_rng(seed)
        self._begin_s = fish.transport.now_s()
        self._taken = 0

    @property
    def age_s(self) -> float:
        """Since it was made."""
        return self._fish.transport.now_s() - self._begin_s

    def frames(self) -> list[Frame]:
        """Those since the last call."""
        if self.age_s > self.gone_s:
            self.gone_s = math.inf
            raise CameraGone("the camera was unplugged", "Plug it in again.")
        found = []
        while (since_s := self._taken / self.fps) <= self.age_s - 0.08:
            self._taken += 1
            x_m, y_m, heading_rad = self.way(since_s)
            noise = self._rng.normal(0.0, self._noise_m, 2)
            turn = self._rng.normal(0.0, 10 * self._noise_m)
            t_s = since_s + (1234.5 if self.clock == "board" else self._begin_s)
            if self._rng.random() >= self._lost and self.seen(since_s):
                found.append(Frame(t_s, x_m + noise[0], y_m + noise[1], heading_rad + turn))
        return found

    def close(self) -> None:
        """Nothing to give up."""
