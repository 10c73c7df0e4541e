"""The camera of a live trial, from the options of a command, and its report."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import typer

from tailbeat.app.cli._lazy import opt
from tailbeat.app.cli._terminal import warn
from tailbeat.board.connect import tcp_address
from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.records import decode_reference
from tailbeat.core.speed_source import Camera
from tailbeat.core.trial_file import read_trial
from tailbeat.experiment.library import identified_if_readable, library_of
from tailbeat.sensors.camera.calibration.file import Calibration, load_calibration
from tailbeat.sensors.camera.marker.detector import KINDS, MARKERS, Marker, MarkerKind
from tailbeat.sensors.camera.render.source import RemoteCamera
from tailbeat.sensors.camera.source.film import Recorder
from tailbeat.sensors.camera.source.open import SourceOptions, live_source
from tailbeat.sensors.camera.sync import sync_by_led
from tailbeat.sensors.camera.tracking.live import OnPicture, VideoCamera
from tailbeat.sensors.camera.tracking.track import Track
from tailbeat.sensors.camera.tracking.tracker import Tracker
from tailbeat.session.events import Event, TrialRecorded, TrialStarted
from tailbeat.session.guards import Guard, WallGuard
from tailbeat.session.trial_camera import default_camera

LATE_MAX_S = 0.03
MARKERS_METAVAR = "|".join(KINDS)


@dataclass(frozen=True)
class MarkerOptions:
    """What every command that looks through a camera asks for."""

    calibration: Calibration | None = opt(
        "What 'camera calibrate' wrote.", "TANK.json", by=load_calibration
    )
    marker: MarkerKind = opt("What is on the fish.", MARKERS_METAVAR, default="aruco")
    marker_id: int | None = opt("Number of the fish's marker; default: any one.", min=0)
    marker_side: float | None = opt("Side of its black square, to check it.", "M")
    latency: float = opt("How late a picture of a device arrives.", "S", default=0.0)

    def on_fish(self) -> Marker:
        """The marker. Raises typer.BadParameter."""
        if self.marker_side is not None and not 0.001 <= self.marker_side <= 1.0:
            raise typer.BadParameter("--marker-side is in metres, like 0.06")
        numbered = self.marker_id is not None or self.marker_side is not None
        if MARKERS[self.marker].family is None and numbered:
            raise typer.BadParameter(f"a {self.marker} has neither --marker-id nor --marker-side")
        return Marker(self.marker, self.marker_id, self.marker_side)


@dataclass(frozen=True)
class CameraOptions(MarkerOptions):
    """Of commands that run trials."""

    camera: str | None = opt(
        "A camera (0, /dev/video0), a stream of positions, or the simulated fish drawn.",
        "DEVICE|tcp:HOST:PORT|rendered",
    )

    @property
    def positions(self) -> bool:
        """Whether it gives positions instead of pictures: a stream, or a simulated board's."""
        return self.camera is None or self.camera.startswith("tcp:")

    def wall_m(self) -> float | None:
        """How far from a wall a fish is stopped; None = where it can just still stop."""
        return None

    def check(self, video: Path | None = None) -> None:
        """What is known before there is a fish. Raises typer.BadParameter, InputError."""
        self.on_fish()
        if self.camera is not None and self.positions:
            tcp_address(self.camera)
        if video is not None and self.positions:
            raise InputError(
                "--video films what a camera sees, and here there are only positions",
                "Give the camera itself: --camera DEVICE",
            )
        if video is not None and video.exists():
            raise InputError(f"{video} is there already", "Give --video another name.")
        simulated = self.positions or live_source(str(self.camera)).simulated
        if self.calibration is None and not simulated:
            raise InputError(
                "a camera needs a calibration",
                "Give --calibration TANK.json; make one: tailbeat camera calibrate",
            )


@dataclass(frozen=True)
class TankCameraOptions(CameraOptions):
    """Of commands that also stop a fish before it meets a wall."""

    wall: float | None = opt(
        "Stop a fish of 0.08 m/s at this distance from a wall, slower ones later; 0 = never."
        " Default: where it can just still stop, by its drag.",
        "M",
        min=0.0,
        max=2.0,
    )

    def wall_m(self) -> float | None:
        """As given."""
        return self.wall


@dataclass(frozen=True)
class LiveCamera:
    """An open camera and what goes with it. ``camera`` None = left to run_trial."""

    camera: Camera | None
    guard: Guard | None
    video: VideoCamera | None  # the same camera when it is one that takes pictures
    recorder: Recorder | None = None

    def follow(self, event: Event) -> None:
        """Films while a trial runs."""
        if self.recorder is not None and isinstance(event, TrialStarted | TrialRecorded):
            self.recorder.wanted = isinstance(event, TrialStarted)


@contextmanager
def live_camera(
    fish: Fish,
    options: CameraOptions,
    video: Path | None = None,
    on_picture: OnPicture | None = None,
) -> Iterator[LiveCamera]:
    """The camera for the length of a trial; ``video``: its film, instead of which ``on_picture``
    may see every picture. Raises InputError, ConnectError."""
    options.check(video)
    known, wall_m = options.calibration, options.wall_m()
    if options.positions:
        place = options.camera and tcp_address(options.camera)
        with closing(RemoteCamera(*place)) if place else nullcontext() as positions:
            yield LiveCamera(positions, _guard(fish, known, wall_m), None)
        return
    with ExitStack() as stack:
        kind = live_source(str(options.camera))
        size_px = known.size_px if known is not None else None
        opening = SourceOptions(
            size_px, options.latency, lambda: default_camera(fish), options.on_fish()
        )
        source = kind.open(str(options.camera), opening)
        stack.callback(source.close)
        calibration = known or source.calibration
        assert calibration is not None  # check() let only sources with their own pass
        calibration.check_size(source.size_px, source.name)
        recorder = None
        if video is not None:
            recorder = Recorder(video, source.size_px, source.fps)
            stack.callback(recorder.close)
            if known is None:
                calibration.save(video.with_suffix(".tank.json"))
        tracker = Tracker(options.on_fish(), calibration, source.name, patch=True)
        camera = VideoCamera(source, tracker, not kind.simulated, recorder or on_picture)
        stack.callback(camera.close)
        yield LiveCamera(camera, _guard(fish, calibration, wall_m), camera, recorder)


def _guard(fish: Fish, calibration: Calibration | None, wall_m: float | None) -> Guard | None:
    walls = calibration is not None and calibration.area_m is not None
    if wall_m and not walls:
        raise InputError(
            "--wall needs to know where the walls are",
            "Give a --calibration with the tank's area; make one: tailbeat camera calibrate",
        )
    if calibration is None or not walls:
        return None
    record = fish.reference_record()
    beat_s = decode_reference(record).beat_s if record else 1.0
    return WallGuard(calibration, wall_m, beat_s=beat_s, kappa_per_m=_kappa_per_m(fish))


def _kappa_per_m(fish: Fish) -> float:
    """The fish's drag: as identified, else as the board has it."""
    if (identified := identified_if_readable(library_of(fish))) is not None:
        return identified.model.kappa_per_m
    return fish.params.get("MDL_KAPPA").value


def camera_report(
    fish: Fish, camera: VideoCamera, trial: int, latency_s: float
) -> tuple[dict[str, float], str]:
    """How a trial's camera did, and in one line: pictures that should have come, those with the
    fish, those nobody had time for; if the LED's code was seen, also how much the stamps are late
    (``late_s``, ``late_sigma_s``). Warns of stamps that do not belong to their beats."""
    track = camera.track()
    pictures, seen, dropped = len(track.t_s), int(track.seen().sum()), camera.dropped
    report: dict[str, float] = {"pictures": pictures, "seen": seen, "dropped": dropped}
    text = f"camera: {pictures} pictures, the fish seen in {seen}"
    text += f", {dropped} dropped" if dropped else ""
    with suppress(TailbeatError):  # no LED to be seen, or a trial's file that cannot be had
        late_s, sigma_s = _lateness(fish, camera, track, trial)
        report |= {"late_s": late_s, "late_sigma_s": sigma_s}
        text += f"; stamps late by {late_s * 1e3:.0f} +- {sigma_s * 1e3:.0f} ms"
        if abs(late_s) > LATE_MAX_S:
            warn(
                f"the pictures' stamps are {abs(late_s) * 1e3:.0f} ms"
                f" {'late' if late_s > 0 else 'early'} by the fish's LED;"
                f" next time give --latency {latency_s + late_s:.3f}"
            )
    return report, text


def _lateness(fish: Fish, camera: VideoCamera, seen: Track, trial: int) -> tuple[float, float]:
    """Mean and standard deviation. Raises TailbeatError."""
    found = sync_by_led(seen, None)
    if found.trial != trial % 256:
        raise InputError(f"the LED shows trial {found.trial}.")
    with TemporaryDirectory() as folder:
        begun_s = read_trial(fish.pull_trial(trial, Path(folder))).start_us * 1e-6
    by_board = camera.clock == "board"
    start_s = found.start_s if by_board else fish.clock.board_s(found.start_s)
    return start_s - begun_s, found.sigma_s
