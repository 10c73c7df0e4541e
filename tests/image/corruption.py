"""RAM of the emulated board goes bad: what the servo pin does then, and what it may do.

The judge knows the limits of a pulse, and until when pulses may come at all; nothing else.
"""

from __future__ import annotations

import json
import os
import random
import struct
import sys
import traceback
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from enum import Enum
from functools import cache
from pathlib import Path

from elftools.dwarf.die import DIE
from elftools.elf.elffile import ELFFile

from tailbeat.board.connect import hear_board
from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.link import _dialect as mavlink
from tailbeat.sim.board import SimTransport
from tailbeat.sim.emulated import EmulatedBoard, EmulationError
from vboard.core.clock import TICKS_PER_US
from vboard.core.memory import RAM_SIZE, RAM_START
from vboard.periph.flash import BANK_BYTES, FLASH_BASE
from vboard.periph.pins import PinTrace, Pulse

SHORTEST_US, LONGEST_US = 900, 2100  # SERVO_MIN_US and SERVO_MAX_US as stored: the defaults
BEATS, COAST_S, FRAME_S = 2, 0.5, 0.02
LATE_S = 4 * FRAME_S  # a tick that dies in the coast: its last pulse is repeated until a restart
PULL_UP_US = 50  # at a reset the pin is high until the first instructions have run
GUARDED_BYTES = 32
BOOT, IDLE, RUNNING, SETTLING, LEARNING, FAULT = 0, 1, 3, 4, 5, 7  # state_t
BATTERY_CHANNEL = 7
FREE_FLASH = BANK_BYTES - 16384  # the image does not reach so far

# push {r0-r2}; ldr r0, =table; then str value, [address] for each pair of it up to an address of
# 0; pop {r0-r2}; back to where the processor was
STORES = bytes.fromhex("07b40548016819b142680a600830f9e707bcdff808f000bf")


ALLOW_ALL = bytes.fromhex("88887047")  # ldrh r0, [r1, #4]; bx lr: request->pulse_ticks


class Way(Enum):
    """How the words are chosen and written."""

    ANYWHERE = "anywhere"  # all RAM but the guarded memory, as from outside
    TICK = "tick"  # what the tick works on and the guarded memory, by the processor's own stores


class Lack(Enum):
    """What is taken away, to see whether the runs would miss it."""

    NOTHING = "nothing"
    REGION = "the MPU's region"
    MONITOR = "the monitor"  # each pulse that is wanted goes out


@dataclass(frozen=True)
class Case:
    """One run. ``wait_s``: from the snapshot to the writes. ``until_s``: pulses may come so long
    after the snapshot. ``lacks``: what the board does without."""

    seed: int
    state: str
    way: Way
    wait_s: float
    until_s: float
    run_s: float
    lacks: Lack = Lack.NOTHING


@dataclass
class Outcome:
    """What came of it. ``wrong``: what the judge objects to."""

    seed: int
    state: str
    end: str = "ran on"
    pulses: int = 0
    wrong: list[str] = field(default_factory=list)


def judge(pulses: list[Pulse], since: int, until: int, reset: bool) -> list[str]:
    """What is wrong with the pulses from the tick ``since`` on. None may begin after ``until``, or
    after a frame without one; a crash may cut the last one short."""
    wrong: list[str] = []
    seen = [p for p in pulses if p.start + p.ticks > since]
    if reset:
        seen = [p for p in seen if p.ticks > PULL_UP_US * TICKS_PER_US]
    for n, pulse in enumerate(seen):
        width_us = pulse.ticks / TICKS_PER_US
        cut = reset and n == len(seen) - 1
        if width_us > LONGEST_US or (width_us < SHORTEST_US and not cut):
            wrong.append(f"a pulse of {width_us:.1f} us")
        if pulse.start > until:
            wrong.append(f"a pulse {(pulse.start - until) / TICKS_PER_US / 1e6:.2f} s late")
        gap = pulse.start - seen[n - 1].start if n else 0
        if gap > 1.5 * FRAME_S * 1e6 * TICKS_PER_US:
            wrong.append(f"a pulse {gap / TICKS_PER_US / 1e6:.2f} s after the one before")
    return wrong


class Patient:
    """A board whose RAM is going to be written, and a scope on its servo pin."""

    def __init__(self, board: EmulatedBoard) -> None:
        self.emulated, self.board = board, board.board
        self.trace = PinTrace(self.board.clock, 21, 4)
        self.board.wire(
            lambda: self.trace.connect(self.board.periph["PIOC"], self.board.periph["PWM"])
        )
        self.guarded = self.board.symbol("__guarded")
        app, image = self.board.symbol("app"), board.image
        at, self.control_bytes = member(image, "control_t")
        self.control = app + at
        self.supervisor = app + member(image, "supervisor_t")[0]

    def state(self) -> int:
        """supervisor.state of the firmware."""
        return self.board.read(self.supervisor, 1)[0]

    def leaves(self, state: int, limit_s: float) -> bool:
        """Runs until the firmware is in another state; False if it does not get there."""
        end = self.board.now_s + limit_s
        while self.state() == state and self.board.now_s < end:
            self.emulated.run(0.002)
        return self.state() != state

    def words(self, way: Way, chance: random.Random) -> list[tuple[int, int]]:
        """Addresses and the values that are written there."""
        out = []
        for _ in range(int(2 ** chance.uniform(0, 12)) if way is Way.ANYWHERE else 24):
            address = self._address(way, chance)
            old = self.board.word(address)
            other = self.board.word(RAM_START + 4 * chance.randrange(RAM_SIZE // 4))
            value = chance.choice(
                [
                    chance.getrandbits(32),
                    old ^ 1 << chance.randrange(32),
                    chance.randrange(4),
                    other,
                ]
            )
            out.append((address, value))
        return out

    def _address(self, way: Way, chance: random.Random) -> int:
        if way is Way.TICK:
            place = 4 * chance.randrange((self.control_bytes + GUARDED_BYTES) // 4)
            inside = place < self.control_bytes
            return self.control + place if inside else self.guarded + place - self.control_bytes
        while True:
            address = RAM_START + 4 * chance.randrange(RAM_SIZE // 4)
            if not self.guarded <= address < self.guarded + GUARDED_BYTES:
                return address

    def store(self, words: Iterable[tuple[int, int]]) -> None:
        """Lets the main loop, which sleeps, write them itself."""
        chip = self.board.chip
        self.board.run_until(self.board.clock.now + 10**9, lambda: chip.asleep)
        at = FLASH_BASE + FREE_FLASH
        table = at + 256
        code = STORES + struct.pack("<2I", table, self.board.cpu.pc | 1)
        self.board.flash.set(0, FREE_FLASH, code)
        pairs = b"".join(struct.pack("<2I", *pair) for pair in words)
        self.board.flash.set(0, FREE_FLASH + 256, pairs + bytes(8))
        chip.divert(at)

    def take_away(self, lack: Lack) -> None:
        """Of the chip, or of the image."""
        if lack is Lack.REGION:
            mpu = self.board.chip.mpu
            allows, start = mpu.allows, self.guarded
            mpu.allows = lambda address, write, privileged: (  # type: ignore[method-assign]
                start <= address < start + GUARDED_BYTES or allows(address, write, privileged)
            )
            mpu.apply()
        elif lack is Lack.MONITOR:
            at = self.board.symbol("monitor_tick_isr") & ~1
            self.board.flash.set(0, at - FLASH_BASE, ALLOW_ALL)


def run(patient: Patient, case: Case) -> Outcome:
    """From the snapshot on; the board is spoilt afterwards."""
    board, clock = patient.board, patient.board.clock
    chance = random.Random(case.seed)
    outcome = Outcome(case.seed, case.state)
    begun = clock.now
    patient.take_away(case.lacks)
    board.run_for(case.wait_s)
    since, resets = clock.now, board.periph["RSTC"].cause
    board.periph["RSTC"].cause = -1
    try:
        words = patient.words(case.way, chance)
        if case.way is Way.TICK:
            patient.store(words)
        else:
            for address, value in words:
                board.chip.write_memory(address, value.to_bytes(4, "little"))
        patient.emulated.run(case.run_s)
    except EmulationError as error:
        outcome.end = str(error.__cause__).split("(pc")[0]
    reset = board.periph["RSTC"].cause != -1
    board.periph["RSTC"].cause = resets
    pulses = patient.trace.pulses()
    if reset:
        outcome.end = "restarted"
    outcome.pulses = sum(p.start > since for p in pulses)
    until = begun + round(case.until_s * 1e6) * TICKS_PER_US
    ended = reset or outcome.end != "ran on"
    outcome.wrong = judge(pulses, since, until, ended)
    return outcome


def forked(patient: Patient, case: Case) -> Outcome:
    """run() in a process of its own: the board goes on here as if nothing had been."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(reading)
            with os.fdopen(writing, "w") as pipe:
                json.dump(asdict(run(patient, case)), pipe)
            os._exit(0)
        except BaseException:  # whatever it is, this process must not go on
            traceback.print_exc(file=sys.__stderr__)
            os._exit(1)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        text = pipe.read()
    _, status = os.waitpid(child, 0)
    assert status == 0 and text, f"seed {case.seed}: the run failed"
    return Outcome(**json.loads(text))


@cache
def member(image: Path, wanted: str) -> tuple[int, int]:
    """Of the first member of this type in the variable ``app``: where it lies, and its bytes."""
    with image.open("rb") as file:
        for unit in ELFFile(file).get_dwarf_info().iter_CUs():
            if not unit.get_top_DIE().attributes["DW_AT_name"].value.endswith(b"sam3x8e/main.c"):
                continue
            for entry in unit.iter_DIEs():
                if entry.tag == "DW_TAG_variable" and _name(entry) == "app":
                    found = _find(entry.get_DIE_from_attribute("DW_AT_type"), wanted.encode())
                    assert found is not None, f"app has no {wanted}"
                    return found
    raise AssertionError("the image has no variable app")


def _name(entry: DIE) -> str:
    attribute = entry.attributes.get("DW_AT_name")
    return attribute.value.decode() if attribute else ""


def _find(kind: DIE, wanted: bytes) -> tuple[int, int] | None:
    named = _name(kind).encode() == wanted
    while kind.tag == "DW_TAG_typedef":
        kind = kind.get_DIE_from_attribute("DW_AT_type")
    if named:
        return 0, kind.attributes["DW_AT_byte_size"].value
    if kind.tag != "DW_TAG_structure_type":
        return None
    for part in kind.iter_children():
        if part.tag == "DW_TAG_member":
            found = _find(part.get_DIE_from_attribute("DW_AT_type"), wanted)
            if found is not None:
                return part.attributes["DW_AT_data_member_location"].value + found[0], found[1]
    return None


class Day:
    """A board that goes through all states; in each of them runs begin.

    ``plan(state)``: the seeds of the runs of a state, each with its way; ``outcomes``: what came.
    """

    def __init__(self, image: Path, plan: Callable[[str], list[tuple[int, Way, Lack]]]) -> None:
        self.plan, self.outcomes = plan, list[Outcome]()
        self.board = EmulatedBoard(image)
        self.patient = Patient(self.board)

    def spoil(self, state: str, spread_s: float, until_s: float, run_s: float = 0.7) -> None:
        """All runs of a state: RAM is written up to ``spread_s`` from now on, pulses may come until
        ``until_s`` from now on."""
        for seed, way, lacks in self.plan(state):
            wait_s = random.Random(seed).uniform(0, spread_s)
            case = Case(seed, state, way, wait_s, until_s, max(run_s, until_s + 0.3), lacks)
            self.outcomes.append(forked(self.patient, case))

    def _boot(self) -> None:
        board = self.patient.board
        while self.patient.state() != BOOT or board.now_s < 0.004:  # RAM is anything before
            board.run_for(0.0005)
        self.spoil("BOOT", 0.02, 0)

    def _swim(self, fish: Fish) -> None:
        fish.link.command(
            mavlink.TAILBEAT_CMD_TRIAL_START, float(fish.status().next_trial), fish.clock.now_s()
        )
        assert self.patient.state() == RUNNING

    def go(self) -> list[Outcome]:
        """Boot to fault and back, with a trial swum to its end and one that is cut."""
        self._boot()
        transport = SimTransport(self.board)
        assert hear_board(transport) is not None
        with Fish(transport) as fish:
            fish.clock.sync()
            fish.params.set("SPD_SOURCE", 1)
            fish.upload_reference(records.encode_reference(1.0, [0.04] * BEATS))
            self._trial(fish)
            self._cut_trial(fish)
            self._fail(fish)
        return self.outcomes

    def _trial(self, fish: Fish) -> None:
        fish.arm()
        self.spoil("ARMED", 0.1, 0)
        self._swim(fish)
        whole_s = BEATS + COAST_S + FRAME_S + LATE_S
        self.spoil("RUNNING", BEATS, whole_s)
        assert self.patient.leaves(RUNNING, whole_s)
        self.spoil("SETTLING, coast", COAST_S, COAST_S + LATE_S)
        self.board.run(COAST_S + 0.1)
        self.spoil("SETTLING", 0.1, 0)
        assert self.patient.leaves(SETTLING, 10)
        self.spoil("IDLE", 0.1, 0)
        self._learn(fish)

    def _learn(self, fish: Fish) -> None:
        trial = fish.status().next_trial - 1
        fish.upload_speeds(trial, [0.03] * BEATS, [0.001] * BEATS)
        values = [float(trial)] + 6 * [0.0]
        fish.link.send(
            mavlink.MAVLink_command_long_message(1, 1, mavlink.TAILBEAT_CMD_LEARN, 0, *values)
        )
        while self.patient.state() == IDLE:
            self.board.board.run_for(0.0005)
        assert self.patient.state() == LEARNING
        self.spoil("LEARNING", 0.01, 0)
        assert self.patient.leaves(LEARNING, 5)

    def _cut_trial(self, fish: Fish) -> None:
        fish.arm()
        self._swim(fish)
        self.board.run(1.2)
        fish.abort()
        self.spoil("ABORTED, coast", COAST_S, COAST_S + LATE_S)
        self.board.run(COAST_S + 0.1)
        self.spoil("ABORTED", 0.1, 0)

    def _fail(self, fish: Fish) -> None:
        """The battery is gone in the middle of a trial."""
        fish.clear()
        fish.discard()
        fish.arm()
        self._swim(fish)
        self.board.run(0.3)
        self.board.board.periph["ADC"].volts[BATTERY_CHANNEL] = lambda: 1.0
        assert self.patient.leaves(RUNNING, BEATS)
        assert self.patient.state() == FAULT
        self.spoil("FAULT, coast", COAST_S, COAST_S + LATE_S)
        self.board.run(COAST_S + 0.1)
        self.spoil("FAULT", 0.1, 0)
