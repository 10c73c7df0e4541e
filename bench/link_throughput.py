"""How much of the radio's 11 520 bytes/s a pull uses, in virtual time, on good and bad lines.

The file is the log of a trial of 200 beats, read as ULog: the longest there is to say how full the
line is. The time counts from the command to the verified file: CRC, open, data, end. Beside it goes
what the board says anyway, telemetry at TLM_RATE_HZ as it is by default where the row says so, else
off. Then the log of a trial of 40 beats as 'trial pull' fetches it, packed, in seconds.
"""

from __future__ import annotations

import os
import statistics
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from tailbeat.board.fish import Fish
from tailbeat.board.provision import set_key
from tailbeat.core import records, reference
from tailbeat.link.ftp.wire import DATA_BYTES
from tailbeat.link.impaired import Corrupt, Drop, Fault, ImpairedLine, hc05
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import CONSOLE, SimBoard, SimTransport

LINE_BYTES_PER_S = 11520
PATH = "/trials/0001.ulg"
FRAME_BYTES = 266
SIGNATURE_BYTES = 13
CLEAN_MIN, LOST_MIN, MANY_LOST_MIN = 0.89, 0.82, 0.68
TRIAL, TRIAL_BEATS = 1, 40


@dataclass(frozen=True)
class Load:
    """How much is measured."""

    beats: int  # of the trial whose log is pulled
    seeds: int
    pulls: int  # seeds of the pulls of a trial
    goals: bool  # a short log is not long enough for them


FULL = Load(beats=200, seeds=24, pulls=16, goals=True)
TINY = Load(beats=2, seeds=1, pulls=1, goals=False)

Faults = Callable[[], Sequence[Fault]]


@dataclass(frozen=True)
class Case:
    """A line. ``through``: share of full frames that come through; None: says nothing, because
    short ones fare better. ``least``: of the mean, or the bench fails."""

    name: str
    faults: Faults
    through: float | None
    signed: bool = False
    telemetry: bool = False
    least: float = 0.0
    within_s: float | None = (
        None  # most that a trial of 40 beats may take, in the mean; None: no row
    )

    @property
    def limit(self) -> float | None:
        """Share of the line that bytes of the file can have."""
        frame_bytes = FRAME_BYTES + SIGNATURE_BYTES * self.signed
        return None if self.through is None else DATA_BYTES / frame_bytes * self.through


CASES = (
    Case("clean", lambda: (), 1.0, least=CLEAN_MIN, within_s=0.95),
    Case("clean, default telemetry", lambda: (), 1.0, telemetry=True),
    Case("clean, signed", lambda: (), 1.0, signed=True),
    Case("5 % of the frames lost", lambda: (Drop(0.05),), 0.95, least=LOST_MIN, within_s=1.05),
    Case("5 % lost, signed", lambda: (Drop(0.05),), 0.95, signed=True),
    Case("20 % of the frames lost", lambda: (Drop(0.2),), 0.8, least=MANY_LOST_MIN, within_s=1.4),
    Case("one byte in 1000 wrong", lambda: (Corrupt(1e-3),), (1 - 1e-3) ** FRAME_BYTES),
    Case("one byte in 100 wrong", lambda: (Corrupt(1e-2),), None),
    Case("the delay of an HC-05", lambda: (hc05(),), 1.0),
    Case("that, and 5 % lost", lambda: (Drop(0.05), hc05()), 0.95),
)


def flash_with_log(beats: int) -> bytes:
    """The storage of a fish that swam a long trial."""
    with Fish.connect("sim:tank", seed=1) as fish:
        fish.params.set("TANK_LEN_M", 0)
        fish.params.save()
        fish.upload_reference(records.encode_reference(1.0, [0.03] * beats))
        run_trial(fish)
        fish.discard()
        assert fish.sim is not None
        return fish.sim.flash


def flash_with_trial(beats: int) -> bytes:
    """The storage of a fish that swam a trial along a trapezoid."""
    with Fish.connect("sim:tank", seed=1) as fish:
        fish.params.set("TANK_LEN_M", 0)
        fish.params.save()
        fish.upload_reference(reference.trapezoid(0.0791, beats / 4, beats / 2))
        run_trial(fish)
        fish.discard()
        assert fish.sim is not None
        return fish.sim.flash


def board_for(case: Case, flash: bytes) -> SimBoard:
    """A fish with that storage, the parameters and the key that the case wants."""
    board = SimBoard("tank")
    board.flash = flash
    board.world.power_cycle()
    with Fish(SimTransport(board, CONSOLE)) as wired:
        wired.clock.sync()
        if not case.telemetry:
            wired.params.set("TLM_RATE_HZ", 0)
        if case.signed:
            set_key(wired)
    return board


def pull(case: Case, flash: bytes, seed: int) -> float:
    """Bytes of the file per second."""
    line = ImpairedLine(SimTransport(board_for(case, flash)), case.faults(), case.faults(), seed)
    with Fish(line) as fish, tempfile.TemporaryDirectory() as folder:
        fish.link.run(2.0)
        assert (fish.link.signing.key is not None) == case.signed
        begin_s = fish.transport.now_s()
        fish.ftp.pull(PATH, Path(folder) / "file")
        took_s = fish.transport.now_s() - begin_s
        return (Path(folder) / "file").stat().st_size / took_s


def pull_trial(case: Case, flash: bytes, seed: int) -> tuple[float, int, int]:
    """Seconds until the trial's ULog is there, its bytes, and those of the stored log."""
    line = ImpairedLine(SimTransport(board_for(case, flash)), case.faults(), case.faults(), seed)
    with Fish(line) as fish, tempfile.TemporaryDirectory() as folder:
        fish.link.run(2.0)
        totals: list[int] = []
        begin_s = fish.transport.now_s()
        path = fish.pull_trial(TRIAL, Path(folder), lambda _, total: totals.append(total))
        return fish.transport.now_s() - begin_s, path.stat().st_size, totals[-1]


def measure(case: Case, flash: bytes, load: Load) -> bool:
    """Prints the case's row; whether the mean is enough."""
    shares = [pull(case, flash, seed) / LINE_BYTES_PER_S for seed in range(1, load.seeds + 1)]
    mean, worst = statistics.mean(shares), min(shares)
    limit = "n/a" if case.limit is None else f"{case.limit:.3f}"
    short = load.goals and mean < case.least
    verdict = f"  too little: must be {case.least}" if short else ""
    print(f"  {case.name:28} {mean:6.3f} {worst:6.3f} {limit:>6}{verdict}")
    return not short


def measure_pull(case: Case, flash: bytes, load: Load) -> bool:
    """Prints the row of a trial's pull; whether it is quick enough."""
    assert case.within_s is not None and case.limit is not None
    pulls = [pull_trial(case, flash, seed) for seed in range(1, load.pulls + 1)]
    mean_s, worst_s = statistics.mean(p[0] for p in pulls), max(p[0] for p in pulls)
    limit_s = pulls[0][2] / (case.limit * LINE_BYTES_PER_S)
    late = load.goals and mean_s > case.within_s
    verdict = "  too long" if late else ""
    print(
        f"  {case.name:28} {mean_s:6.2f} {worst_s:6.2f} {case.within_s:6.2f} {limit_s:6.2f}"
        f" {mean_s / limit_s:6.2f}{verdict}"
    )
    return not late


def measure_pulls(load: Load) -> bool:
    """Prints all rows of a trial's pull; whether all are quick enough."""
    flash = flash_with_trial(TRIAL_BEATS if load.goals else load.beats)
    _, ulog_bytes, stored_bytes = pull_trial(CASES[0], flash, 1)
    ratio = ulog_bytes / stored_bytes
    print(
        f"seconds to pull a trial's log: {ulog_bytes} bytes of ULog, {stored_bytes} packed", end=""
    )
    print(f" ({ratio:.2f} to 1)")
    print(
        f"  {'line, both ways':28} {'mean':>6} {'worst':>6} {'goal':>6} {'limit':>6} {'ratio':>6}"
    )
    quick = [measure_pull(case, flash, load) for case in CASES if case.within_s is not None]
    return all(quick)


@contextmanager
def repeatable() -> Iterator[None]:
    """Keys in a folder of their own, and the same sequence numbers in every run."""
    with (
        tempfile.TemporaryDirectory() as keys,
        mock.patch.dict(os.environ, TAILBEAT_KEYS=keys),
        mock.patch("tailbeat.link.ftp.client._first_number", lambda: 4711),
    ):
        yield


def measure_all(load: Load) -> bool:
    """Prints all rows; whether the line is used enough."""
    flash = flash_with_log(load.beats)
    print(f"pulling a trial's log, share of {LINE_BYTES_PER_S} bytes/s used for its bytes; beside")
    print("them come a heartbeat once a second and what changes: outside a trial all other")
    print("telemetry rests while a burst runs. TLM_RATE_HZ is 0, or where said its default")
    print(f"  {'line, both ways':28} {'mean':>6} {'worst':>6} {'limit':>6}  ({load.seeds} seeds)")
    enough = [measure(case, flash, load) for case in CASES]
    return all([*enough, measure_pulls(load)])


def main(load: Load = FULL) -> int:
    """Exit status 1 when the line is used too little."""
    with repeatable():
        return 0 if measure_all(load) else 1


if __name__ == "__main__":
    raise SystemExit(main())
