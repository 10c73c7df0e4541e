"""The fish: everything an operator does with a board, as methods."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from tailbeat.board.connect import open_transport, require_board
from tailbeat.board.memory import BoardMemory
from tailbeat.core.errors import Refused
from tailbeat.core.extras import lazy
from tailbeat.core.faults import IMU_STARTING, NO_TRIAL, WRONG_STATE, refusal
from tailbeat.core.lazy_arrays import F64, np
from tailbeat.core.records import decode_reference
from tailbeat.link import _dialect as mavlink
from tailbeat.link import messages
from tailbeat.link.mavlink import Link, Message
from tailbeat.link.messages import (
    WATCHED,
    BoardInfo,
    Event,
    ImuFrame,
    ImuInfo,
    LearnReport,
    imu_frames,
)
from tailbeat.link.params import Parameters
from tailbeat.link.timesync import BoardClock
from tailbeat.link.transport import Transport
from tailbeat.sim.board import SimulatedBoard, in_process

if TYPE_CHECKING:
    from tailbeat.core import reference
    from tailbeat.core import speed_source as sources
else:  # of few methods
    reference = lazy("tailbeat.core.reference")
    sources = lazy("tailbeat.core.speed_source")


@cache
def rest() -> reference.Reference:
    """A board cannot lose its reference again. After an identification on one that had none a beat
    at rest stands for none: no run's input may be executed again."""
    return reference.Reference(1.0, np.zeros(1, np.float32), "rest")


REST_CRC = 0xECBE1397  # of that


def board_reference(fish: Fish) -> reference.Reference | None:
    """None when it has none, or one that is zero throughout."""
    record = fish.reference_record()
    if record is None:
        return None
    held = decode_reference(record)
    if not np.any(held.speed_m_s):
        return None
    return reference.Reference(held.beat_s, held.speed_m_s, f"{held.crc:08x}")


LEARN_TIMEOUT_S = 2.0  # a learning step ends with a flash write
_IMU_VERDICT_S = 6.0  # of board time, after which it knows
_IMU_LOOK_S = 0.25
_STOPPED = ("ABORTED", "FAULT")


class Fish(BoardMemory):
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
    library_root : Path or None
        Folder of the trial libraries, if not the usual one.
    """

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        super().__init__(Link(transport))
        self.clock = BoardClock(self.link)
        self.params = Parameters(self.link)
        self.library_root: Path | None = None

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

    def imu_calibrate(self, rows: F64) -> None:
        """Write a calibration into the IMU's own flash and restart it; IDLE only.

        Parameters
        ----------
        rows : ndarray
            Shape (6, 3): the matrix that the accelerometers' values are multiplied with, then the
            gyroscopes', in the sensor's own axes.

        Raises
        ------
        Refused
            The board is not idle, the IMU does not stream, or an element is beyond 2.
        """
        for number, row in enumerate(rows):
            self.link.command(mavlink.TAILBEAT_CMD_IMU_ROW, number, *map(float, row))
        self.imu_save()

    def speed_source(self) -> sources.SpeedSource:
        """Where the board takes the speed of a beat from."""
        return sources.source_info(round(self.params.get(sources.PARAMETER).value))

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

    def watch(self) -> Iterator[Event]:
        """Everything the board reports, as it comes, for ever."""
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


def _unique_id(version: Message) -> str:
    return bytes(version.uid2)[:16].hex()
