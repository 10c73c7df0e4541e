"""The camera of one trial: its speeds go to the board, its frames to the guard, its positions into
the raw files.

Only the log tells when the trial began. So the positions wait, in board time, beside the log that
is being pulled; a program that ends in between loses none.
"""

from __future__ import annotations

import contextlib
import csv
import io
import math
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from tailbeat.board.fish import Fish
from tailbeat.core.errors import ConnectError, LinkLostError
from tailbeat.core.files import MAKE_ROOM, write_whole
from tailbeat.core.speed_source import Camera, CameraGone, Frame, TrackReset, Unseen
from tailbeat.core.trial_file import Trial
from tailbeat.experiment.folder import Experiment
from tailbeat.link import _dialect as mavlink
from tailbeat.link.mavlink import Message
from tailbeat.link.messages import BeatEvent
from tailbeat.link.sockets import TcpTransport
from tailbeat.link.timesync import BoardClock
from tailbeat.sensors.camera.render.source import RemoteCamera, SimulatedCamera
from tailbeat.sensors.camera.tracking.live import BeatFit, SpeedSample
from tailbeat.sensors.camera.tracking.tracker import RepeatFilter, is_computed
from tailbeat.session.events import OnEvent, TrialWarning
from tailbeat.sim.board import SimulatedBoard

if TYPE_CHECKING:
    from collections.abc import Sequence


HEADER = ("t_s", "x_m", "y_m", "heading_rad")
_BEFORE_S = 30.0  # frames so long before a trial's start may still belong to it
_AFTER_S = 120.0


@dataclass(frozen=True)
class PositionStore:
    """Where the positions of one trial wait."""

    path: Path

    def put(self, frames: Sequence[Frame], camera: Camera, clock: BoardClock) -> None:
        """Keeps them, in board time. Raises InputError (disk full)."""
        if not frames:
            return
        rows = [replace(frame, t_s=board_time_s(frame, camera, clock)) for frame in frames]
        self.path.parent.mkdir(exist_ok=True)
        write_whole(self.path, as_csv(rows, 0.0), MAKE_ROOM)

    def take(self, trial: Trial) -> list[Frame]:
        """Those of this very trial, time from its start; none when they are of another one that had
        the same number (a board whose storage was made anew)."""
        start_s = trial.start_us * 1e-6
        end_s = start_s + trial.executed_beats * trial.beat_s
        frames = [replace(frame, t_s=frame.t_s - start_s) for frame in self._read()]
        if not frames or frames[-1].t_s < 0 or frames[-1].t_s > end_s - start_s + _AFTER_S:
            return []
        return [frame for frame in frames if frame.t_s > -_BEFORE_S]

    def _read(self) -> list[Frame]:
        with contextlib.suppress(OSError, ValueError, TypeError):
            header, *rows = csv.reader(io.StringIO(self.path.read_text(encoding="utf-8")))
            return [
                Frame(*(float(cell) for cell in row)) for row in rows if tuple(header) == HEADER
            ]
        return []


def board_time_s(frame: Frame, camera: Camera | None, clock: BoardClock) -> float:
    """When a frame was taken, by the board's clock."""
    return frame.t_s if camera is not None and camera.clock == "board" else clock.board_s(frame.t_s)


def position_store(experiment: Experiment, trial: int) -> PositionStore:
    """That of one trial of an experiment."""
    return PositionStore(experiment.folder / ".pulling" / f"{trial:04d}_positions.csv")


def as_csv(frames: Sequence[Frame], start_s: float) -> str:
    """``t_s,x_m,y_m,heading_rad``, time from ``start_s``."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(HEADER)
    for frame in frames:
        row = (frame.t_s - start_s, frame.x_m, frame.y_m, frame.heading_rad)
        writer.writerow([f"{value:.6f}" for value in row])
    return out.getvalue()


_BLIND_S = 1.0  # of board time without a picture, after which somebody should look
_STAMP_MAX_S = 1e6  # of board time: eleven days
_STAMP_AHEAD_S = 10.0  # more than the clocks of a hurried simulation differ by
_SURE_RAD = 0.3  # a fish sets out at 0.2
# A board takes a run of zeros for a tracker that stands still (firmware/speed/doubt.h); a fish that
# was not yet set going, before a camera without noise, is none.
_AT_REST_M_S = 1e-9
_NO_COVARIANCE = (math.nan,) * 8


class TrialCamera:
    """Once the trial has begun nothing of the camera's or the guard's raises here, only a broken
    link: a tail that beats needs its loop.

    A camera that is gone is told as a warning; the trial goes on without it if ``dispensable``
    (another source gives the speeds) and the guard agrees. Anything else that is raised (two fish,
    a camera that was moved) aborts, and is kept in ``failure`` for when the board has stopped.
    ``consult(what)`` asks the guard, with every Frame, and with Unseen when there is none;
    ``abort()`` wants the tail to stop. A picture that stands still shows no fish.
    ``direction_rad``: of the trial in the tank's frame; speeds are those along it.
    """

    def __init__(
        self,
        fish: Fish,
        camera: Camera,
        window_s: float,
        dispensable: bool,
        emit: OnEvent,
        consult: Callable[[object], None],
        abort: Callable[[], None],
        direction_rad: float = 0.0,
    ) -> None:
        self.fit = BeatFit(window_s, camera.fps)
        self.along = (math.cos(direction_rad), math.sin(direction_rad))
        self.failure: Exception | None = None
        self._fish, self._camera, self._dispensable = fish, camera, dispensable
        self._emit, self._consult, self._abort = emit, consult, abort
        self._repeats = RepeatFilter(camera)
        self._by_board = camera.clock == "board"
        self._gone = self._blind = self._frozen = False
        self.seen_at_s = 0.0

    def begin(self) -> None:
        """As look_afresh, while nothing swims yet: raises what the camera raises."""
        self._camera.frames()
        self._camera.frames()  # an error comes after the frames before it
        self.look_afresh()

    def look_afresh(self) -> None:
        """Forgets what was: until now the fish may have been carried or adrift."""
        self._frames()
        self.fit.reset()
        self._repeats.forget()
        self.seen_at_s = self._fish.link.transport.now_s()
        with self._kept():
            self._consult(TrackReset())

    def hear(self, beat: BeatEvent) -> None:
        """An executed beat."""
        if abs(beat.amplitude_rad) >= _SURE_RAD:
            self._repeats.must_move()

    def sees(self, board: SimulatedBoard) -> bool:
        """Whether it is the simulated camera of ``board``, which tells positions."""
        return type(self._camera) is SimulatedCamera and self._camera.board is board

    @property
    def plain(self) -> bool:
        """There is nothing to be said about it: it is there, and was not long without a picture."""
        return not (self._gone or self._blind)

    def look(self, frame: Frame) -> None:
        """Shows the guard one frame."""
        with self._kept():
            self._consult(frame)

    def send_speeds(self, swimming: bool) -> None:
        """What came since the last call. ``swimming``: the tail beats, or is about to."""
        try:
            self._send(swimming)
        except LinkLostError:
            raise
        except Exception as error:
            self._fail(error)

    def _send(self, swimming: bool) -> None:
        came = self._came()
        frames = self._repeats.new([frame for frame in came if self._fits(frame.t_s)])
        if not self._gone:
            self._watch(bool(came), swimming)
        if not (frames or self._gone) and swimming:
            self._consult(Unseen(self._now_s()))
        for frame in frames:
            self._take(frame)

    def _take(self, frame: Frame) -> None:
        self._consult(frame)
        sample = self.fit.add(frame.t_s, self._way_m(frame))
        if sample is not None and sample.speed_m_s == 0 and is_computed(self._camera):
            sample = replace(sample, speed_m_s=_AT_REST_M_S)
        if sample is not None and (board_s := self._board_s(sample.t_s)) > 0:
            self._fish.link.send(vision_message(board_s, sample))

    def _way_m(self, frame: Frame) -> float:
        """Along the trial. A camera that tells no y is right for a trial along x."""
        across = self.along[1]
        return frame.x_m * self.along[0] + frame.y_m * across if across else frame.x_m

    def _fits(self, t_s: float) -> bool:
        """Whether a frame can be of this time; one from the future would hide those to come."""
        if not math.isfinite(t_s):
            return False
        ahead_s = (t_s - self._now_s()) * (1.0 if self._by_board else self._fish.clock.rate)
        return 0 <= self._board_s(t_s) <= _STAMP_MAX_S and ahead_s <= _STAMP_AHEAD_S

    def _board_s(self, t_s: float) -> float:
        return t_s if self._by_board else self._fish.clock.board_s(t_s)

    def _now_s(self) -> float:
        """By the camera's clock."""
        return self._fish.clock.now_s() if self._by_board else self._fish.transport.now_s()

    @contextmanager
    def _kept(self) -> Iterator[None]:
        """What is raised inside ends the trial, and comes out after it."""
        try:
            yield
        except LinkLostError:
            raise
        except Exception as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        self._gone, self.failure = True, error
        self._abort()
        self._emit(TrialWarning(f"{error}"))

    def _frames(self) -> list[Frame]:
        try:
            return self._came()
        except LinkLostError:
            raise
        except Exception as error:
            self._fail(error)
            return []

    def _came(self) -> list[Frame]:
        if self._gone:
            return []
        try:
            return self._camera.frames()
        except CameraGone as gone:
            self._gone = True
            self._mourn(gone)
        return []

    def _mourn(self, gone: CameraGone) -> None:
        self._emit(TrialWarning(f"{gone} The trial has no camera any more."))
        self._consult(gone)
        if not self._dispensable:
            self._abort()

    def _watch(self, seen: bool, swimming: bool) -> None:
        """Says once when the fish is out of sight while the tail beats."""
        now_s = self._fish.transport.now_s()
        if seen or not swimming:
            self.seen_at_s = now_s
        blind = (now_s - self.seen_at_s) * self._fish.clock.rate > _BLIND_S
        if blind and not self._blind:
            words = getattr(self._camera, "blind_words", "the camera sends no pictures")
            self._emit(TrialWarning(f"{words}; beats go unmeasured"))
        self._blind = blind
        if self._repeats.frozen and swimming and not self._frozen:
            self._frozen = True
            text = "the camera's picture stands still; beats go unmeasured"
            self._emit(TrialWarning(text))


def vision_message(board_s: float, sample: SpeedSample) -> Message:
    """VISION_SPEED_ESTIMATE for a mean speed along x around ``board_s``."""
    covariance = (sample.sigma_m_s**2, *_NO_COVARIANCE)
    return mavlink.MAVLink_vision_speed_estimate_message(
        round(board_s * 1e6), sample.speed_m_s, math.nan, math.nan, covariance, 0
    )


@contextmanager
def camera_of(fish: Fish, camera: Camera | None) -> Iterator[Camera | None]:
    """``camera``, which stays open, or else that of a simulated board."""
    own = default_camera(fish) if camera is None else None
    with closing(own) if own is not None else nullcontext(camera) as used:
        yield used


def default_camera(fish: Fish) -> Camera | None:
    """The camera of a simulated board; None for a real one."""
    if (board := fish.sim) is not None:
        return SimulatedCamera(board) if board.config["camera_fps"] > 0 else None
    if isinstance(fish.transport, TcpTransport) and fish.kind() != "fish":
        try:
            return RemoteCamera(fish.transport.host, fish.transport.port + 1)
        except ConnectError:
            return None
    return None
