"""After a power cut: what must be true of the flash, and of the board that boots from it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from littlefs import LittleFS

from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core.trial_file import parse_trial
from tailbeat.session.trial import run_trial
from tailbeat.sim.emulated import EmulatedBoard
from vboard.core.clock import TICKS_PER_S
from vboard.flashlog import FlashLog

from .session import SEED, Session, View, greet

BLOCK_BYTES, BLOCKS = 2048, 128
SYNC_S = 5.0  # a trial's file is synced this often
BATTERY_S = 1.0  # and has the battery's voltage this often, as it comes
SYNC_TAKES_S = 0.3
FRAME_S = 0.02  # a trial's file begins when its first pulse is computed, a frame ahead of it
NO_END = ["the file has no end record: the trial was not closed"]
RECORDS = {"/params.bin", "/reference.bin", "/learned.bin", "/pending.bin", "/counter.bin"}


@dataclass(frozen=True)
class Recovered:
    """A board that booted from what a cut left. ``log``: what its boot did to the flash."""

    board: EmulatedBoard
    log: FlashLog
    fish: Fish

    @property
    def booted(self) -> int:
        """Tick of the clock now."""
        return self.board.board.clock.now

    def switch_off(self) -> None:
        """Gives back what the processor takes on this computer."""
        self.board.board.power_cut()


def recover(image: Path, bank: bytes) -> Recovered:
    """Power on."""
    board = EmulatedBoard(image, seed=SEED)
    board.flash = bank
    log = FlashLog(board.board)
    return Recovered(board, log, greet(board))


def read_files(bank: bytes) -> dict[str, bytes]:
    """All files in the bank, by path, through littlefs's own code. Raises LittleFSError."""
    fs = LittleFS(block_size=BLOCK_BYTES, block_count=BLOCKS, mount=False)
    fs.context.buffer[:] = bank
    fs.mount()
    found = {}
    for folder, _, names in fs.walk("/"):
        for name in names:
            path = f"{folder.rstrip('/')}/{name}"
            with fs.open(path, "rb") as file:
                found[path] = file.read()
    return found


def expect(what: str, got: object, wanted: object) -> None:
    """An assertion that says what it is about."""
    assert got == wanted, f"{what} is {got}, not {wanted}"


def check_mountable(session: Session, tick: int, bank: bytes) -> None:
    """What the cut left mounts as it is, once the filesystem has been made."""
    made = [write.end for write in session.log.writes if write.end <= session.steps[0].end]
    if tick >= max(made):
        check_records(read_files(bank))


def check_records(files: dict[str, bytes]) -> None:
    """What bears the name of a record is a whole one."""
    for path, data in files.items():
        if path in RECORDS:
            crc = records.crc32(data[12:], records.crc32(data[:8]))
            assert crc == records.record_crc(data), f"{path} is garbage"


def check_files(files: dict[str, bytes]) -> None:
    """After a boot there are whole records and no leftovers."""
    check_records(files)
    for path in set(files) - RECORDS:
        assert path.startswith(("/trials/", "/in/")), f"{path} should not be"
        assert not path.endswith(".new"), f"{path} is left over"


def check_board(fish: Fish) -> None:
    """It is well, and says so."""
    status, health = fish.status(), fish.health()
    expect("state", status.state, "IDLE")
    expect("fault", status.fault.name, "NONE")
    expect("count of failed writes", health["store_failures"], 0)
    expect("reset cause", health["reset_cause"], "power")
    expect("crash record", fish.crash_record(), None)


def check_view(session: Session, tick: int, seen: View) -> int:
    """What the board knows is what it knew before or after the step, and once the step was
    acknowledged, after it; the number of that view in the step."""
    step = session.step_at(tick)
    recorded = [trial for trial, pulse in session.first_pulse.items() if pulse <= tick]
    assert seen.next_trial > max(recorded, default=0), f"would swim trial {seen.next_trial} again"
    views = step.views_at(tick)
    best = min(views, key=lambda view: len(seen.differs_in(view)))
    assert seen in views, f"neither old nor new: {seen.differs_in(best)}"
    return step.views.index(seen)


def check_trial_files(session: Session, tick: int, seen: View, files: dict[str, bytes]) -> None:
    """A trial's file is whole once the trial is stored, until then a readable beginning of it."""
    for trial, whole in session.trial_files.items():
        stored = files.get(f"/trials/{trial:04d}.ulg")
        data = None if stored is None else records.unpack_log(stored)
        since_s = (tick - session.first_pulse[trial]) / TICKS_PER_S
        if trial in (seen.pending_trial, seen.last_learned_trial) or trial + 1 < seen.next_trial:
            assert data == whole, f"the file of trial {trial} is not whole"
        elif data is not None:
            assert since_s > -FRAME_S, f"trial {trial} has a file before it began"
            assert whole.startswith(data), f"the file of trial {trial} is not a beginning"
            check_synced(data, trial, since_s)
        else:
            assert since_s < SYNC_TAKES_S, f"no file of trial {trial}"


def check_synced(data: bytes, trial: int, since_s: float) -> None:
    """A file after a cut ``since_s`` after its trial began: readable, as far as it was synced."""
    log = parse_trial(data)
    expect("trial", log.number, trial)
    assert log.problems in ([], NO_END), f"the file of trial {trial}: {log.problems}"
    synced_s = math.floor((since_s - SYNC_TAKES_S) / SYNC_S) * SYNC_S
    known_s = log.battery_v[-1][0] if log.battery_v else 0.0
    assert known_s >= synced_s - BATTERY_S, f"trial {trial} is known up to {known_s:.1f} s only"


def go_on(fish: Fish, seen: View, trial: bool) -> None:
    """The board is as good as before: it stores, arms and, with ``trial``, swims and learns."""
    fish.params.set("ILC_GAIN", 2.0)
    fish.params.save()
    if seen.pending_trial is not None:
        fish.learn(seen.pending_trial)
    if seen.reference_crc is not None:
        fish.arm()
        if trial:
            outcome = run_trial(fish)
            expect("next trial", (outcome.number, outcome.end), (seen.next_trial, "complete"))
            fish.learn(outcome.number)
    expect("count of failed writes", fish.health()["store_failures"], 0)
