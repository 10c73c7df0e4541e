"""The learning session that power cuts hit, and all that a board may know after a cut within it."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

from tailbeat.board.connect import hear_board
from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimTransport
from tailbeat.sim.emulated import EmulatedBoard
from vboard.flashlog import FlashLog, PageWrite

SEED = 3
BOOT_S = 3.0
REFERENCE_M_S = (0.02, 0.04, 0.05, 0.04, 0.02)
PARAMETERS = {"SETTLE_S": 2.0, "ILC_LEAD": 1.0, "ILC_GAIN": 3.0}
TRIALS = 2
SERVO_CHANNEL = 4


@dataclass(frozen=True)
class View:
    """What a board knows for good, as it tells it over the link."""

    parameters: tuple[tuple[str, float], ...]
    reference_crc: int | None
    iteration: int
    amplitudes: bytes
    best_iteration: int | None
    best: bytes
    best_max_abs_error_m_s: float | None
    last_learned_trial: int | None
    next_trial: int
    pending_trial: int | None

    def differs_in(self, other: View) -> list[str]:
        """Names of the fields that are not the same."""
        return [f.name for f in fields(self) if getattr(self, f.name) != getattr(other, f.name)]


def look(fish: Fish) -> View:
    """Asks the board."""
    status = fish.status()
    return View(
        parameters=tuple((name, p.value) for name, p in fish.params.list().items()),
        reference_crc=status.reference_crc,
        iteration=status.iteration,
        amplitudes=fish.amplitudes().values.tobytes(),
        best_iteration=status.best_iteration,
        best=fish.amplitudes(best=True).values.tobytes() if status.best_iteration else b"",
        best_max_abs_error_m_s=status.best_max_abs_error_m_s,
        last_learned_trial=status.last_learned_trial,
        next_trial=status.next_trial,
        pending_trial=status.pending_trial,
    )


def greet(board: EmulatedBoard) -> Fish:
    """Waits for the board's heartbeat, as a tool would that connects to it."""
    transport = SimTransport(board)
    if hear_board(transport, BOOT_S) is None:
        raise AssertionError("no heartbeat")
    fish = Fish(transport)
    fish.clock.sync()
    return fish


@dataclass
class Step:
    """What the host did from tick ``start`` to ``end``. ``views``: what a board that loses its
    power within it may know when it has it again, oldest first. From ``done`` on the board has said
    that it is so, and only the last one will do."""

    name: str
    start: int
    done: int
    end: int
    views: list[View]

    def views_at(self, tick: int) -> list[View]:
        """What a board may know that loses its power at ``tick``."""
        return self.views if tick < self.done else self.views[-1:]


@dataclass
class Session:
    """A session in progress or, if nobody cut it, at its end."""

    board: EmulatedBoard
    log: FlashLog
    steps: list[Step] = field(default_factory=list)
    first_pulse: dict[int, int] = field(default_factory=dict)  # tick, by trial
    trial_files: dict[int, bytes] = field(default_factory=dict)

    @property
    def end(self) -> int:
        """Tick at which the last step was over."""
        return self.steps[-1].end

    def writes_by_step(self) -> list[list[PageWrite]]:
        """What each step wrote, without the steps that wrote nothing."""
        found = [
            [write for write in self.log.writes if step.start <= write.start < step.end]
            for step in self.steps
        ]
        return [writes for writes in found if writes]

    def step_at(self, tick: int) -> Step:
        """The step under way."""
        return next(step for step in self.steps if tick < step.end)


def begin(image: Path) -> Session:
    """A board with empty flash, switched on."""
    board = EmulatedBoard(image, seed=SEED)
    return Session(board, FlashLog(board.board))


def run(session: Session) -> None:
    """The whole session. Raises whatever ends it early."""
    board = session.board
    before: View | None = None
    start = board.board.clock.now
    for name, done, after in _steps(session):
        end = board.board.clock.now
        session.steps.append(Step(name, start, done, end, _views(before, after)))
        before, start = after, end


def _views(before: View | None, after: View) -> list[View]:
    """All that is stored by one and the same replacing of a file comes at once."""
    if before is None:
        return [after]
    views = [before]
    if after.pending_trial is not None and before.pending_trial is None:
        # The first guess is stored while armed, before the trial is counted, if there is time.
        views.append(replace(after, next_trial=before.next_trial, pending_trial=None))
        views.append(replace(before, next_trial=after.next_trial))
        views.append(replace(after, pending_trial=None))
    return [*views, after]


def _steps(session: Session) -> Iterator[tuple[str, int, View]]:
    clock = session.board.board.clock
    fish = greet(session.board)
    yield "boot", clock.now, look(fish)
    for name, action in _actions(session, fish):
        action()
        yield name, clock.now, look(fish)


def _actions(session: Session, fish: Fish) -> Iterator[tuple[str, Callable[[], object]]]:
    reference = records.encode_reference(1.0, REFERENCE_M_S)
    yield "parameters", lambda: _set_parameters(fish, PARAMETERS)
    yield "reference", lambda: fish.upload_reference(reference)
    for trial in range(1, TRIALS + 1):
        yield f"trial {trial}", lambda trial=trial: _swim(session, fish, trial)
        yield f"pull {trial}", lambda trial=trial: _pull(session, fish, trial)
        yield f"learn {trial}", lambda trial=trial: fish.learn(trial)
        yield (
            f"parameters {trial}",
            lambda trial=trial: _set_parameters(fish, {"ILC_GAIN": 3.0 + trial}),
        )


def _set_parameters(fish: Fish, values: dict[str, float]) -> None:
    for name, value in values.items():
        fish.params.set(name, value)
    fish.params.save()


def _swim(session: Session, fish: Fish, trial: int) -> None:
    def note(channel: int, start: int, period: int, high: int) -> None:
        if channel == SERVO_CHANNEL and high:
            session.first_pulse.setdefault(trial, start)

    heard = session.board.board.periph["PWM"].on_period
    heard.append(note)
    outcome = run_trial(fish)
    heard.remove(note)
    assert (outcome.number, outcome.end) == (trial, "complete")


def _pull(session: Session, fish: Fish, trial: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        session.trial_files[trial] = fish.pull_trial(trial, Path(folder)).read_bytes()
