"""A simulated tank for tests through the command line: things happen to the fish in mid-swim, and
somebody at the laptop types. Virtual time."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest

from tailbeat.app.cli import run
from tailbeat.board.fish import Fish
from tailbeat.sim.board import CONSOLE, SimTransport, SimulatedBoard


@dataclass
class Happening:
    """Something that is done to the fish in the middle of beat ``beat`` of trial ``trial``."""

    trial: int
    beat: int
    act: Callable[[], None]


@dataclass
class Tank(SimTransport):
    """The way to the board, on which things happen to the fish."""

    board: SimulatedBoard
    happenings: list[Happening] = field(default_factory=list)
    began_s: float = math.nan

    def __post_init__(self) -> None:
        super().__init__(self.board)

    def wait(self, timeout_s: float) -> None:
        super().wait(timeout_s)
        truth = self.board.world.truth()
        if not truth.swimming:
            self.began_s = math.nan
            return
        if math.isnan(self.began_s):
            self.began_s = truth.time_s
        for happening in list(self.happenings):
            due_s = self.began_s + happening.beat + 0.5
            if truth.swims == happening.trial and truth.time_s >= due_s:
                self.happenings.remove(happening)
                happening.act()


@dataclass
class Day:
    """Somebody at the laptop: types commands, reads JSON."""

    board: SimulatedBoard
    tank: Tank
    capsys: pytest.CaptureFixture[str]

    def types(self, *words: object, status: int = 0, connected: bool = True) -> Any:
        line = [str(word) for word in words] + ["--json"]
        line += ["--connect", "the board"] if connected else []
        got = run(line)
        out, err = self.capsys.readouterr()
        assert status is None or got == status, f"tailbeat {' '.join(line)}: {got}\n{err}\n{out}"
        return json.loads(out) if out else err

    def trials(self) -> int:
        return self.board.world.truth().swims

    def abort_by_console(self) -> None:
        """A second person at the wired console."""
        Fish(SimTransport(self.board, CONSOLE)).abort()

    def happens(self, beat: int, act: Callable[[], None]) -> None:
        """In the middle of that beat of the next trial."""
        self.tank.happenings.append(Happening(self.trials() + 1, beat, act))
