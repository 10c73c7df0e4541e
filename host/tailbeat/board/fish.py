"""The reference of a connected board, and the one that stands for none.

The fish: everything a person does with a board, as methods.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tailbeat.board import crash
from tailbeat.board.connect import open_transport, require_board
from tailbeat.board.crash import CrashReport
from tailbeat.board.learned import LearnedMemory
from tailbeat.core import records
from tailbeat.core.arrays import F32
from tailbeat.core.errors import Refused
from tailbeat.core.faults import (
    BAD_FILE,
    IMU_STARTING,
    NO_REFERENCE,
    NO_TRIAL,
    WRONG_STATE,
    refusal,
)
from tailbeat.core.records import Amplitudes, decode_reference
from tailbeat.core.reference import Reference
from tailbeat.core.speed_source import PARAMETER as SPEED_SOURCE_PARAMETER
from tailbeat.core.speed_source import SpeedSource, source_info
from tailbeat.link import _dialect as mavlink
from tailbeat.link import messages
from tailbeat.link.ftp.client import FtpClient
from tailbeat.link.ftp.wire import FtpError, Progress
from tailbeat.link.mavlink import Link, Message
from tailbeat.link.messages import (
    WATCHED,
    BoardInfo,
    BoardStatus,
    Event,
    ImuFrame,
    ImuInfo,
    LearnReport,
    TrialFile,
    imu_frames,
)
from tailbeat.link.params import Parameters
from tailbeat.link.timesync import BoardClock
from tailbeat.link.transport import Transport
from tailbeat.sim.board import SimulatedBoard, in_process

# A board cannot lose its reference again. After an identification on one that had none a beat at
# rest stands for none: no run's amplitudes may swim again.
REST = Reference(1.0, np.zeros(1, np.float32), "rest")


def board_reference(fish: Fish) -> Reference | None:
    """None when it has none, or one that is zero throughout."""
    record = fish.reference_record()
    if record is None:
        return None
    held = decode_reference(record)
    if not np.any(held.speed_m_s):
        return None
    return Reference(held.beat_s, held.speed_m_s, f"{held.crc:08x}")


TRIALS = "/trials"
LEARN_TIMEOUT_S = 2.0  # a learning step ends with a flash write
_IMU_VERDICT_S = 6.0  # of board time, after which it knows
_IMU_LOOK_S = 0.25
_FTP_NOT_FOUND = 10
_STOPPED = ("ABORTED", "FAULT")


class Fish:
    """One connected board. Use as a context manager, or close() it.

    Parameters
    ----------
    transport : Transport
        An open way to the board, which it closes; ``Fish.connect`` makes one from an address.

    Attributes
    ----------
    link : Link
        The MAVLink conversation: commands, requests, messages as they come.
    clock : BoardClock
        The board's clock as seen from here.
    params : Parameters
        Its parameters.
    ftp : FtpClient
        Its files.
    """

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self.link = Link(transport)
        self.clock = BoardClock(self.link)
        self.params = Parameters(self.link)
        self.ftp = FtpClient(self.link)
        self._memory = LearnedMemory(self.link)

    @classmethod
    def connect(cls, url: str | None = None, /, **sim_overrides: float) -> Fish:
        """Open the connection and greet the board.

        Parameters
        ----------
        url : str, optional
            Address as for ``--connect``, for example ``sim:tank?seed=1``; default: find the fish.
        **sim_overrides : float
            Values of the simulator, SI units; only with a simulated board.

        Returns
        -------
        Fish
            The connected board.

        Raises
        ------
        ConnectError
            No board answers there.
        InputError
            The address makes no sense.
        """
        transport = open_transport(url, **sim_overrides)
        try:
            if url is not None:
                require_board(transport)
            fish = cls(transport)
            fish.clock.sync()
        except BaseException:
            transport.close()
            raise
        return fish

    def __enter__(self) -> Fish:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends the connection; the board stays as it is."""
        self.link.close()

    @property
    def sim(self) -> SimulatedBoard | None:
        """The board when it lives in this process: the simulator's or an emulated one, either with
        a simulated fish around it."""
        transport = in_process(self.transport)
        return None if transport is None else transport.board

    def info(self) -> BoardInfo:
        """Who the board is and where it stands."""
        m = self.link.request("AUTOPILOT_VERSION")
        kind = messages.BOARD_KINDS.get(m.board_version, "unknown")
        version = m.flight_sw_version
        return BoardInfo(
            build_id=messages.build_id_of(self.link, m),
            version=f"{version >> 24 & 255}.{version >> 16 & 255}.{version >> 8 & 255}",
            board=kind,
            simulated=kind in messages.SIMULATED_FISH,
            unique_id=_unique_id(m),
            connection=self.transport.name,
            status=self.status(),
        )

    def unique_id(self) -> str:
        """The number its chip was made with, in hexadecimal digits."""
        return _unique_id(self.link.request("AUTOPILOT_VERSION"))

    def status(self) -> BoardStatus:
        """Where the board stands now."""
        return BoardStatus.of(self.link.request("TAILBEAT_STATUS"))

    def health(self) -> dict[str, int | str]:
        """Counters of what went wrong since boot."""
        return messages.health_dict(self.link.request("TAILBEAT_HEALTH"))

    def imu_info(self) -> ImuInfo:
        """Which IMU the board has, and why it does not stream if it does not."""
        return ImuInfo.of(self.link.request("TAILBEAT_IMU_INFO"))

    def imu_verdict(self) -> ImuInfo:
        """``imu_info`` once the board knows.

        That is a few seconds after its start, the IMU's, or a change of the IMU's parameters.
        """
        end_s = self.clock.now_s() + _IMU_VERDICT_S
        while (
            info := self.imu_info()
        ).problem.number == IMU_STARTING and self.clock.now_s() < end_s:
            self.link.run(_IMU_LOOK_S / self.clock.rate)
        return info

    def imu_save(self) -> None:
        """Writes the IMU's settings into its own flash and restarts it; IDLE only."""
        self.link.command(mavlink.TAILBEAT_CMD_IMU_SAVE)

    def imu_frames(self, duration_s: float = math.inf) -> Generator[ImuFrame, None, None]:
        """Stream the IMU's raw frames as they come.

        Close the generator, or use it up, to end the stream.

        Parameters
        ----------
        duration_s : float
            Board time, s; default: for ever.

        Yields
        ------
        ImuFrame
            One frame after the other.

        Raises
        ------
        LinkLostError
            The board is silent.
        """
        return imu_frames(self.link, self.clock, duration_s)

    def upload_reference(
        self, reference: bytes | Reference, progress: Progress | None = None
    ) -> int:
        """Make a reference the board's; do nothing when the board has it already.

        Parameters
        ----------
        reference : Reference or bytes
            The reference, or its record (docs/protocol.md).
        progress : callable, optional
            Gets how many bytes of how many are sent.

        Returns
        -------
        int
            The CRC by which the reference is known.

        Raises
        ------
        Refused
            The board does not take it: too fast, too long, a trial is pending, ...
        """
        record = reference if isinstance(reference, bytes) else reference.record()
        crc = records.record_crc(record)
        if self.status().reference_crc != crc:
            self._upload(records.FILE_REFERENCE, record, progress)
        return crc

    def speed_source(self) -> SpeedSource:
        """Where the board takes the speed of a beat from."""
        return source_info(round(self.params.get(SPEED_SOURCE_PARAMETER).value))

    def reference_record(self) -> bytes | None:
        """The board's reference as it is stored, see records.decode_reference."""
        return self._record("/reference.bin")

    def past_record(self, path: str) -> bytes | None:
        """Read a past trial that the board's average includes.

        Parameters
        ----------
        path : str
            As ``records.past_path`` gives it.

        Returns
        -------
        bytes or None
            The record; None: there is none.
        """
        return self._record(path)

    def crash_report(self) -> CrashReport | None:
        """How the firmware last died; None when it never has."""
        record = self.crash_record()
        return None if record is None else crash.decode_crash(record)

    def crash_record(self) -> bytes | None:
        """The same as it is stored."""
        return self._record(crash.PATH)

    def _record(self, path: str) -> bytes | None:
        try:
            return self.ftp.read(path)
        except FtpError as error:
            if error.code == _FTP_NOT_FOUND:
                return None
            raise

    def upload_amplitudes(self, amplitude_rad: ArrayLike) -> None:
        """Make amplitudes computed elsewhere the input of the next trial.

        Parameters
        ----------
        amplitude_rad : array_like, shape (beats,)
            Amplitudes, rad, 0 or more, for the board's reference.

        Raises
        ------
        Refused
            The board has no reference, or does not take them.
        """
        crc = self.status().reference_crc
        if crc is None:
            raise refusal(NO_REFERENCE)
        self._upload(records.FILE_AMPLITUDES, records.encode_amplitudes(crc, amplitude_rad))

    def learned_record(self) -> bytes | None:
        """All that was learned, as upload_learned takes it; None when there is nothing."""
        status = self.status()
        if status.iteration == 0:
            return None
        visits = self.visits()
        best = self.amplitudes(best=True) if status.best_iteration else None
        peaks = None if visits is None or best is None else self.peaks()
        return records.encode_learned(status, self.amplitudes(), best, visits, peaks)

    def upload_learned(self, record: bytes) -> None:
        """Make a record all that the board has learned.

        Parameters
        ----------
        record : bytes
            Of ``learned_record``, for the board's reference.

        Raises
        ------
        Refused
            It is of another reference, or damaged.
        """
        self._upload(records.FILE_LEARNED, record)

    def upload_speeds(self, trial: int, speed_m_s: ArrayLike, sigma_m_s: ArrayLike) -> None:
        """Give the pending trial its speeds.

        Parameters
        ----------
        trial : int
            Its number.
        speed_m_s : array_like, shape (beats,)
            Mean speed of each beat, m/s; NaN = not measured.
        sigma_m_s : array_like
            Their standard deviations, m/s; a scalar or shape (beats,).

        Raises
        ------
        Refused
            Another trial is pending, or none.
        """
        record = records.encode_speeds(trial, speed_m_s, sigma_m_s)
        self._upload(records.FILE_SPEEDS, record)

    def arm(self, blink_s: float = 0.0) -> None:
        """Get ready to execute a trial.

        Parameters
        ----------
        blink_s : float
            The LED blinks for so long, 0 to 60 s, before it is lit for good.

        Raises
        ------
        Refused
            A trial is pending, there is no reference, the battery is low, ...
        """
        self.link.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 0.0, blink_s)

    def disarm(self) -> None:
        """Back to idle; a running trial is aborted."""
        self.link.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)

    def clear(self) -> None:
        """Leaves ABORTED or FAULT."""
        self.link.command(mavlink.TAILBEAT_CMD_CLEAR)

    def abort(self, wall: bool = False) -> None:
        """Stop the tail now.

        Parameters
        ----------
        wall : bool
            Because the fish comes too close to a wall (fault WALL).

        Raises
        ------
        LinkLostError
            The board does not answer.
        """
        reason = mavlink.TAILBEAT_ABORT_WALL if wall else mavlink.TAILBEAT_ABORT_COMMAND
        self.link.command(mavlink.TAILBEAT_CMD_TRIAL_ABORT, float(reason), timeout_s=0.3)

    def learn(self, trial: int | None = None) -> LearnReport:
        """Learn from the pending trial.

        Parameters
        ----------
        trial : int, optional
            Its number, if known; another number is refused.

        Returns
        -------
        LearnReport
            Errors of the trial in m/s, and what the law did with them.

        Raises
        ------
        Refused
            Nothing is pending, or the board is stopped.
        """
        number = trial if trial is not None else self._pending()
        heard: list[Message] = []
        stop = self.link.subscribe(heard.append)
        try:
            self.link.command(mavlink.TAILBEAT_CMD_LEARN, float(number), timeout_s=LEARN_TIMEOUT_S)
        except Refused as refused:
            state = self.status().state if refused.number == WRONG_STATE else ""
            if state not in _STOPPED:
                raise
            meaning, remedy = f"the board is stopped ({state})", "tailbeat board clear, then learn."
            raise Refused(refused.number, refused.name, meaning, remedy) from None
        finally:
            stop()
        for message in heard:
            if message.get_type() == "TAILBEAT_LEARN_REPORT" and message.trial == number:
                return LearnReport.of(message)
        report = self.link.request("TAILBEAT_LEARN_REPORT", where=lambda m: m.trial == number)
        return LearnReport.of(report)

    def discard(self, trial: int | None = None) -> None:
        """Drop the pending trial without learning; its log stays.

        Parameters
        ----------
        trial : int, optional
            Its number, if known; another number is refused.

        Raises
        ------
        Refused
            Nothing is pending.
        """
        number = trial if trial is not None else self._pending()
        try:
            self.link.command(mavlink.TAILBEAT_CMD_DISCARD, float(number))
        except Refused as refused:  # one that came twice finds it dropped already
            if refused.number != NO_TRIAL or (self.link.said == 1 and trial is not None):
                raise

    def restore_best(self) -> None:
        """Makes the best amplitudes so far the next ones."""
        self.link.command(mavlink.TAILBEAT_CMD_RESTORE_BEST)

    def amplitudes(self, best: bool = False) -> Amplitudes:
        """Read the feedforward input of the next trial or of the best so far, bit for bit.

        Parameters
        ----------
        best : bool
            The best input as it was applied, instead of the next one (unsaturated).

        Returns
        -------
        Amplitudes
            ``values`` of float32, shape (beats,), rad.
        """
        return self._memory.amplitudes(best)

    def visits(self) -> NDArray[np.uint8] | None:
        """Read how many trials have corrected each beat.

        Returns
        -------
        ndarray of uint8, shape (beats,), or None
            At most 255; None when the board does not count them.
        """
        return self._memory.visits()

    def peaks(self) -> F32 | None:
        """Read the best trial's largest errors.

        Returns
        -------
        ndarray of float32, shape (beats,), or None
            |e| at their beats, m/s, 0 at all others; negative where it is an earlier best's, at a
            beat that the best did not measure. None: the board does not keep them.
        """
        return self._memory.peaks()

    def trials(self) -> list[TrialFile]:
        """Trial logs on the board, oldest first."""
        found = []
        for entry in self.ftp.list(TRIALS):
            stem, _, kind = entry.name.partition(".")
            if kind == "ulg" and stem.isascii() and stem.isdigit():
                found.append(TrialFile(int(stem), f"{TRIALS}/{entry.name}", entry.size))
        return sorted(found, key=lambda trial: trial.number)

    def pull_trial(self, number: int, folder: Path, progress: Progress | None = None) -> Path:
        """Copy a trial's log; resume what an earlier call began.

        Parameters
        ----------
        number : int
            Of the trial.
        folder : Path
            Where ``NNNN.ulg`` is written.
        progress : callable, optional
            Gets how many bytes of how many have come.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        TransferError
            There is no such trial, or the copy failed.
        """
        name = f"{number:04d}.ulg"
        local = folder / name
        self.ftp.pull(f"{TRIALS}/{name}", local, progress)
        return local

    def watch(self) -> Iterator[Event]:
        """Everything the board tells, as it comes, for ever."""
        kinds = tuple(WATCHED)
        while True:
            message = self.link.recv(kinds, 1.0)
            if message is not None:
                yield WATCHED[message.get_type()](message)

    def kind(self) -> str:
        """Of the board: "fish", "simulated" …, one of messages.BOARD_KINDS."""
        version = self.link.request("AUTOPILOT_VERSION")
        return messages.BOARD_KINDS.get(version.board_version, "unknown")

    def _pending(self) -> int:
        number = self.status().pending_trial
        if number is None:
            raise refusal(NO_TRIAL)
        return number

    def _upload(self, file: int, record: bytes, progress: Progress | None = None) -> None:
        self.ftp.write(records.PATHS[file], record, progress)
        crc = records.crc32(record)
        signed = crc - (1 << 32) if crc & 0x80000000 else crc
        try:
            self.link.command_int(mavlink.TAILBEAT_CMD_COMMIT, float(file), len(record), signed)
        except Refused as refused:
            if refused.number != BAD_FILE or self._is_there(file):
                raise  # one that came twice finds the file gone: it was taken over at the first

    def _is_there(self, file: int) -> bool:
        try:
            self.ftp.crc32(records.PATHS[file])
        except FtpError as error:
            if error.code == _FTP_NOT_FOUND:
                return False
            raise
        return True


def _unique_id(version: Message) -> str:
    return bytes(version.uid2)[:16].hex()
