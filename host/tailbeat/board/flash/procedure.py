"""The whole procedure: save, erase, write, start, compare the build, put back.

Everything that can be checked is checked before anything is erased. From the erase on, every
failure says how to get the board back and where its content lies.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from tailbeat.board.fish import Fish
from tailbeat.board.flash import ports, programs
from tailbeat.board.flash.backup import (
    Backup,
    BackupPlaces,
    OnStep,
    back_up,
    key_warning,
    require_quiet,
)
from tailbeat.board.flash.ports import BoardPort, Enumerate
from tailbeat.board.flash.programs import BOSSAC, OPENOCD, Image, Run, require_program, run_program
from tailbeat.board.snapshot import restore
from tailbeat.core.errors import ConnectError, LinkLostError, NoBoardError, TailbeatError, reason
from tailbeat.link.messages import BoardInfo
from tailbeat.link.serial import PortKind
from tailbeat.link.transport import Hearing

_ERASED_S = 1.0  # ERASE and RESET pulses of the ATmega16U2 take 0.75 s
_RETURN_S = 10.0  # for a USB device to leave and come back under another id
_POLL_S = 0.1
_SETTLE_S = 0.5  # for the system to give a new port its rights
_BOOT_BIT_S = 0.5  # for the chip to keep the boot bit: bossac ends as soon as it has asked for it
_HEAR_TRIES = 4  # of 3 s each, see transport.find.LISTEN_S; opening the port resets the board
_HEAR_PAUSE_S = 1.0
_INFO_TRIES = 3
_BY_HAND_S = 120.0  # for somebody to find the buttons
_BY_HAND_POLL_S = 1.0
# What a board that runs another program, or none, lets hear. Firmware of tailbeat sends a line at
# every reset, also when it hangs ("hung"); damaged frames are those of a board.
_NOT_TAILBEAT = ("silence", "noise", "text", "garbage", "stranger")

_BY_HAND = "Hold the board's ERASE button for at least 1 s, release it, and press RESET."
_LOSE_ALL = "If its firmware hangs, add --no-keep: then all that is stored on it is lost."
_NO_TAILBEAT = "the board runs another program than tailbeat, or none: nothing to save"
_RECOVER = (
    "Hold the board's ERASE button for at least 1 s, release it, press RESET, and run the same"
    " command again."
)


class FlashError(TailbeatError):
    """Flashing failed after the board had been erased, or may have been."""


@dataclass(frozen=True)
class FlashPlan:
    """What to flash, and how. ``connect``: where to talk to the board when not by the port it is
    flashed by. ``keep`` False: erase whatever the board holds without asking it."""

    image: Path
    port: str | None = None
    tool: str = BOSSAC
    keep: bool = True
    places: BackupPlaces = field(default_factory=BackupPlaces)
    connect: str | None = None
    adapter: str = programs.ADAPTER


@dataclass(frozen=True)
class Surroundings:
    """The world outside: USB ports, programs, time, the way to a board."""

    enumerate_ports: Enumerate = ports.system_ports
    require_free: Callable[[str], None] = ports.require_free
    touch: Callable[[BoardPort], None] = ports.touch
    restart: Callable[[BoardPort], bytes] = ports.restart
    require_program: Callable[[str, str], None] = require_program
    run: Run = run_program
    connect: Callable[[str], Fish] = Fish.connect
    sleep: Callable[[float], None] = time.sleep
    now_s: Callable[[], float] = time.monotonic


@dataclass
class FlashReport:
    """How it went. ``verified``: the board itself said that it runs ``build_id``."""

    image: Path
    size_bytes: int
    build_id: str
    tool: str
    port: str | None
    verified: bool = False
    backup: Path | None = None
    trials_pulled: list[Path] = field(default_factory=list)
    restored: list[str] = field(default_factory=list)
    not_restored: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def flash(
    plan: FlashPlan,
    on_step: OnStep = lambda fraction, text: None,
    around: Surroundings | None = None,
    tell: Callable[[str], None] = lambda line: None,
    confirm: Callable[[str], bool] = lambda question: False,
) -> FlashReport:
    """Flashes as planned. ``tell``: what a person should know or do before the erase. ``confirm``:
    a question whose answer no leads to another way, not to an end. Raises TailbeatError while
    nothing has been changed, then FlashError."""
    return _Flashing(plan, on_step, around or Surroundings(), tell, confirm).run()


@dataclass
class _Flashing:
    """One run of the procedure; the arguments are those of ``flash``."""

    plan: FlashPlan
    on_step: OnStep
    around: Surroundings
    tell: Callable[[str], None]
    confirm: Callable[[str], bool]

    def __post_init__(self) -> None:
        plan = self.plan
        self._image = Image.load(plan.image)
        self._elf = self._image.elf() if plan.tool == OPENOCD else None
        self.around.require_program(plan.tool, programs.PACKAGES[plan.tool])
        self._port = self._find_port()
        self._kept: Backup | None = None
        device = self._port.device if self._port else None
        size, build_id = self._image.size_bytes, self._image.build_id
        self._report = FlashReport(plan.image, size, build_id, plan.tool, device)

    def run(self) -> FlashReport:
        """All of it, in order."""
        self._keep()
        if self._port is not None:  # again: pulling trials may have taken minutes
            self.around.require_free(self._port.device)
        erase = self._way_to_erase()
        with self._failures_after_erase():
            self._write(erase)
        self._check_and_restore()
        return self._report

    def _find_port(self) -> BoardPort | None:
        """None: OpenOCD needs no port, and the board is talked to elsewhere or not at all."""
        if self.plan.tool == OPENOCD and not self.plan.port:
            found = ports.board_ports(self.around.enumerate_ports)
            if self.plan.connect or len(found) != 1:
                return None
        port = ports.find_port(self.plan.port, self.around.enumerate_ports)
        self.around.require_free(port.device)
        return port

    def _talk_address(self) -> str | None:
        """Where the firmware can be spoken to. It does not serve the chip's own USB."""
        if self.plan.connect:
            return self.plan.connect
        if self._port is not None and self._port.talks:
            return self._port.device
        found = ports.board_ports(self.around.enumerate_ports)
        beside = [port.device for port in found if port.kind is PortKind.PROGRAMMING]
        return beside[0] if len(beside) == 1 else None

    def _keep(self) -> None:
        if not self.plan.keep:
            self._report.notes.append("nothing was saved from the board (--no-keep)")
        elif self._port is not None and self._port.kind is PortKind.SAM_BA:
            self._report.notes.append("the board was in its boot loader: there was nobody to ask")
        else:
            self._keep_from(self._talk_address())

    def _keep_from(self, address: str | None) -> None:
        if address is None and self._port is not None:  # tailbeat does not serve the native port
            self._report.notes.append(f"{self._port.device}: {_NO_TAILBEAT}")
            return
        if address is None:
            raise ConnectError(
                "the board cannot be talked to, so what it holds cannot be saved",
                "Plug in its programming port, or name the port with --connect. Or add --no-keep:"
                " then all that is stored on it is lost.",
            )
        self.on_step(0.0, "waiting for the board")
        try:
            fish = self.around.connect(address)
        except (ConnectError, LinkLostError) as error:
            self._accept_silence(address, error)
            return
        with fish:
            wipes = self.plan.tool == BOSSAC
            require_quiet(fish, wipes)
            if wipes and (warning := key_warning(fish)):
                self.tell(warning)
            self._kept = back_up(
                fish, self.plan.places, lambda at, text: self.on_step(0.1 + 0.4 * at, text)
            )
        self._report.backup = self._kept.folder
        self._report.trials_pulled = self._kept.trials
        if self._port is not None and self.plan.tool == BOSSAC:
            self._require_same_board(self._port, address, self._kept.snapshot.unique_id)

    def _require_same_board(self, port: BoardPort, address: str, saved_id: str) -> None:
        """With several boards about, another than the one on ``port`` may have been saved."""
        if not port.talks or port.device == address:
            return
        try:
            with self.around.connect(port.device) as fish:
                unique_id = fish.info().unique_id
        except (ConnectError, LinkLostError) as error:
            unique_id = f"silent: {error.message}"
        if unique_id != saved_id:
            raise ConnectError(
                f"the board on {port.device} ({unique_id}) is not the one on {address} ({saved_id})"
                " that was saved",
                "Leave --connect out to save what is on the port, or plug in the other board.",
            )

    def _accept_silence(self, address: str, error: TailbeatError) -> None:
        """Only a board that has nothing to lose may be silent: an erased one, whose boot loader
        answers, or one whose reset, by the opening of the port, starts no tailbeat."""
        port = self._port if self.plan.tool == BOSSAC else None
        if port is not None and programs.loader_answers(self.around.run, port):
            self._report.notes.append("the board was in its boot loader: there was nothing to save")
            return
        never_ran = isinstance(error, NoBoardError) and error.heard in _NOT_TAILBEAT
        if port is not None and never_ran and not self.plan.connect:
            if port.kind is PortKind.OTHER:  # its opening may reset nothing
                raise ConnectError(
                    f"no tailbeat board answers on {address}",
                    f"If it has never run tailbeat: {_BY_HAND} Then run the same command again.",
                )
            self._require_no_start_of_tailbeat(port)
            self._report.notes.append(f"{address}: {_NO_TAILBEAT}")
            return
        raise ConnectError(
            f"the board on {address} does not answer, so what it holds cannot be saved"
            f" ({error.message})",
            f"{error.remedy} {_LOSE_ALL}",
        ) from error

    def _require_no_start_of_tailbeat(self, port: BoardPort) -> None:
        """A second look, at a reset that is certain. Raises ConnectError."""
        hearing = Hearing(port.device)
        hearing.add(self.around.restart(port), 0.0)
        if hearing.kind not in _NOT_TAILBEAT:
            message, _ = hearing.words()
            raise ConnectError(f"{message}, so what it holds cannot be saved", _LOSE_ALL)

    def _way_to_erase(self) -> Callable[[BoardPort], BoardPort]:
        """How the board gets into its boot loader; asks before a port of another make is
        touched."""
        port = self._port
        if port is None or self._elf is not None or port.kind is PortKind.SAM_BA:
            return lambda loader: loader
        if port.kind is not PortKind.OTHER:
            return self._erase
        if not port.may_be_touched:
            return self._erase_by_hand
        vendor, product = port.ids or (0, 0)
        touch = self.confirm(
            f"{port.device} has the USB ids {vendor:04x}:{product:04x}, which are not a Due's."
            " Opening it at 1200 baud erases a board with an ATmega16U2; another device may do"
            " something else. Open it at 1200 baud?"
        )
        return self._erase if touch else self._erase_by_hand

    def _erase_by_hand(self, port: BoardPort) -> BoardPort:
        """Waits until somebody has pressed the buttons, unless that is done already."""
        deadline = self.around.now_s() + _BY_HAND_S
        waits = False
        while not programs.loader_answers(self.around.run, port):
            if not waits:
                self.tell(
                    f"{port.device} cannot erase the board. {_BY_HAND}"
                    f" Waiting {_BY_HAND_S:g} s for the boot loader."
                )
            waits = True
            if self.around.now_s() >= deadline:
                raise ConnectError(
                    f"the boot loader did not answer on {port.device} within {_BY_HAND_S:g} s"
                )
            self.around.sleep(_BY_HAND_POLL_S)
        return port

    def _write(self, erase: Callable[[BoardPort], BoardPort]) -> None:
        if self._elf is not None:
            self.on_step(0.5, "writing over SWD")
            programs.write_by_openocd(self.around.run, self._elf, self.plan.adapter)
            return
        assert self._port is not None
        self.on_step(0.5, "erasing")
        loader = erase(self._port)
        self.on_step(0.55, "writing and verifying")
        programs.write_by_bossac(self.around.run, loader, self._image)
        self.on_step(0.85, "starting")
        self.around.sleep(_BOOT_BIT_S)
        programs.start_by_bossac(self.around.run, loader)

    def _erase(self, port: BoardPort) -> BoardPort:
        """The touch; then the port on which the boot loader waits."""
        before = ports.board_ports(self.around.enumerate_ports)
        self.around.touch(port)
        self.around.sleep(_ERASED_S)
        if port.kind is PortKind.OTHER:
            return port

        def back(found: BoardPort) -> bool:
            if port.kind is PortKind.PROGRAMMING:
                return found == port
            return found.kind is PortKind.SAM_BA and found not in before

        deadline = self.around.now_s() + _RETURN_S
        while True:
            for found in ports.board_ports(self.around.enumerate_ports):
                if back(found):
                    self.around.sleep(_SETTLE_S)
                    return found
            if self.around.now_s() >= deadline:
                raise ConnectError(
                    f"the board's boot loader did not appear on USB within {_RETURN_S:g} s"
                )
            self.around.sleep(_POLL_S)

    def _check_and_restore(self) -> None:
        address = self._talk_address()
        if address is None:
            self._report.notes.append(
                "the board was not asked which build it runs; it must say"
                f" {self._image.build_id}: tailbeat info"
            )
            return
        self.on_step(0.9, "waiting for the new firmware")
        with self._failures_after_erase():
            fish = self._hear(address)
        with fish:
            with self._failures_after_erase():
                self._require_flashed_board(fish.info(), address)
                self._compare_build(fish, address)
            self._report.verified = True
            if self._kept is not None:
                self.on_step(0.95, "restoring")
                self._restore(fish, self._kept)

    def _hear(self, address: str) -> Fish:
        last: TailbeatError | None = None
        for attempt in range(_HEAR_TRIES):
            if attempt:
                self.around.sleep(_HEAR_PAUSE_S)
            try:
                return self.around.connect(address)
            except (ConnectError, LinkLostError) as error:
                last = error
        raise ConnectError(
            "the image was written, but the board does not answer"
            f" on {address} ({last.message if last else 'silence'})"
        )

    def _require_flashed_board(self, info: BoardInfo, address: str) -> None:
        """With several boards about, the one that answers may be another."""
        if self._kept is not None and info.unique_id != self._kept.snapshot.unique_id:
            raise TailbeatError(
                f"the board on {address} is not the one that was saved: its id is"
                f" {info.unique_id}, not {self._kept.snapshot.unique_id}"
            )
        if self.plan.tool == BOSSAC and info.status.reference_crc is not None:
            raise TailbeatError(
                f"the board on {address} still has its reference: another one was erased"
            )

    def _compare_build(self, fish: Fish, address: str) -> None:
        build_id = ""
        for _ in range(_INFO_TRIES):  # the line of text that carries the id may get lost
            build_id = fish.info().build_id
            if self._image.is_build(build_id):
                return
        raise TailbeatError(
            f"the board on {address} says it runs {build_id},"
            f" but the image is {self._image.build_id}"
        )

    def _restore(self, fish: Fish, kept: Backup) -> None:
        try:
            result = restore(fish, kept.snapshot)
        except (TailbeatError, OSError, KeyboardInterrupt) as error:
            raise FlashError(
                f"the board runs {self._image.build_id}, but has not all of its content back"
                f" ({_words(error)})",
                _back_by(kept),
            ) from error
        self._report.restored = result.back
        self._report.not_restored = result.missing

    @contextmanager
    def _failures_after_erase(self) -> Iterator[None]:
        try:
            yield
        except (TailbeatError, OSError, KeyboardInterrupt) as error:
            remedy = _RECOVER
            if self.plan.tool == OPENOCD:
                remedy = f"Check the SWD probe and its wires. A board that is dead: {_RECOVER}"
            if self._kept is not None:
                remedy += f" {_back_by(self._kept)}"
            raise FlashError(_words(error), remedy) from error


def _back_by(kept: Backup) -> str:
    return f"What the board held goes back with: tailbeat board flash --restore {kept.folder}"


def _words(error: BaseException) -> str:
    if isinstance(error, TailbeatError):
        return error.message
    if isinstance(error, OSError):
        return f"the system refused ({reason(error)})"
    return "stopped half way"
