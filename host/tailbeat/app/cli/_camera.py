"""The camera of a live trial, from the options of a command, and its report."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import typer

from tailbeat.app.cli._lazy import opt
from tailbeat.board.connect import tcp_address
from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.frames import Camera
from tailbeat.core.records import decode_reference
from tailbeat.core.trial_file import read_trial
from tailbeat.experiment.library import logbook_of
from tailbeat.sensors.camera.calibration.file import Calibration, load_calibration
from tailbeat.sensors.camera.marker.detector import KINDS, MARKERS, Marker
from tailbeat.sensors.camera.render.source import (
    RemoteCamera,
    RenderedDevice,
    SimulatedCamera,
    scene_of,
)
from tailbeat.sensors.camera.source.device import Device
from tailbeat.sensors.camera.source.film import Recorder
from tailbeat.sensors.camera.source.picture import PictureSource
from tailbeat.sensors.camera.sync.sync import sync_by_led
from tailbeat.sensors.camera.tracking.live import VideoCamera
from tailbeat.sensors.camera.tracking.track import Track
from tailbeat.sensors.camera.tracking.tracker import Tracker
from tailbeat.session.events import Event, TrialRecorded, TrialStarted
from tailbeat.session.guards import Guard, WallGuard
from tailbeat.session.trial_camera import default_camera

RENDERED = "rendered"
LATE_MAX_S = 0.03


@dataclass(frozen=True)
class MarkerOptions:
    """What every command that looks through a camera asks for."""

    calibration: Path | None = opt("What 'camera calibrate' wrote.", "TANK.json")
    marker: str = opt("What is on the fish.", "|".join(KINDS), default="aruco")
    marker_id: int | None = opt("Number of the fish's marker; default: any one.", min=0)
    marker_side: float | None = opt("Side of its black square, to check it.", "M")
    latency: float = opt("How late a picture of a device arrives.", "S", default=0.0)

    def on_fish(self) -> Marker:
        """The marker. Raises typer.BadParameter."""
        known = next((kind for kind in KINDS if kind == self.marker), None)
        if known is None:
            raise typer.BadParameter(f"--marker is {', '.join(KINDS[:-1])} or {KINDS[-1]}")
        if self.marker_side is not None and not 0.001 <= self.marker_side <= 1.0:
            raise typer.BadParameter("--marker-side is in metres, like 0.06")
        if MARKERS[known].family is None and (
            self.marker_id is not None or self.marker_side is not None
        ):
            raise typer.BadParameter(f"a {known} has neither --marker-id nor --marker-side")
        return Marker(known, self.marker_id, self.marker_side)


@dataclass(frozen=True)
class CameraOptions(MarkerOptions):
    """Of commands that run trials."""

    camera: str | None = opt(
        "A camera (0, /dev/video0), a stream of positions, or the simulated fish drawn.",
        "DEVICE|tcp:HOST:PORT|rendered",
    )

    def live(self, video: Path | None = None) -> LiveOptions:
        """What they say of the camera. Raises typer.BadParameter."""
        return LiveOptions(self.camera, self.on_fish(), self.calibration, self.latency, video)


@dataclass(frozen=True)
class TankCameraOptions(CameraOptions):
    """Of commands that also stop a fish before it meets a wall."""

    wall: float | None = opt(
        "Stop a fish of 0.08 m/s so far from a wall, slower ones later; 0 = never;"
        " default: where it can just still stop, by its drag.",
        "M",
        min=0.0,
        max=2.0,
    )

    def live(self, video: Path | None = None) -> LiveOptions:
        """With the wall's distance."""
        return replace(super().live(video), wall_m=self.wall)


@dataclass(frozen=True)
class LiveOptions:
    """Which camera, and what goes with it. ``address``: tcp:HOST:PORT (positions), RENDERED, or a
    device; None = that of a simulated board, if it is one. ``wall_m`` None = the usual zone where
    there are walls in the calibration."""

    address: str | None
    marker: Marker
    calibration: Path | None
    latency_s: float
    video: Path | None = None
    wall_m: float | None = None

    def check(self) -> LiveOptions:
        """Itself; what can be told before there is a fish. Raises InputError."""
        if self.calibration is not None:
            load_calibration(self.calibration)
        positions = self.address is None or self.address.startswith("tcp:")
        if self.address is not None and positions:
            tcp_address(self.address)
        if self.video is not None:
            _require_film(self.video, positions)
        if self.calibration is None and not positions and self.address != RENDERED:
            raise InputError(
                "a camera needs a calibration",
                "Give --calibration TANK.json; make one: tailbeat camera calibrate",
            )
        return self


def _require_film(film: Path, positions: bool) -> None:
    if positions:
        raise InputError(
            "--video films what a camera sees, and here there are only positions",
            "Give the camera itself: --camera DEVICE",
        )
    if film.exists():
        raise InputError(f"{film} is there already", "Give --video another name.")


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
def live_camera(fish: Fish, options: LiveOptions) -> Iterator[LiveCamera]:
    """The camera for the length of a swim. Raises InputError, ConnectError."""
    options.check()
    file = options.calibration
    known = None if file is None else load_calibration(file)
    if options.address is None or options.address.startswith("tcp:"):
        place = options.address and tcp_address(options.address)
        with closing(RemoteCamera(*place)) if place else nullcontext() as positions:
            yield LiveCamera(positions, _guard(fish, known, options.wall_m), None)
        return
    with ExitStack() as stack:
        source, calibration = _source(fish, options, known)
        stack.callback(source.close)
        calibration.check_size(source.size_px, source.name)
        recorder = None
        if options.video is not None:
            recorder = Recorder(options.video, source.size_px, source.fps)
            stack.callback(recorder.close)
            if known is None:
                calibration.save(options.video.with_suffix(".tank.json"))
        tracker = Tracker(options.marker, calibration, source.name, glow=True)
        camera = VideoCamera(source, tracker, options.address != RENDERED, recorder)
        stack.callback(camera.close)
        yield LiveCamera(camera, _guard(fish, calibration, options.wall_m), camera, recorder)


def _source(
    fish: Fish, options: LiveOptions, known: Calibration | None
) -> tuple[PictureSource, Calibration]:
    """A device, or the simulated fish as a camera would see it, with the true calibration unless
    another is given."""
    if known is not None and options.address != RENDERED:
        device = Device(str(options.address), known.size_px, latency_s=options.latency_s)
        return device, known
    seen = default_camera(fish)
    if not isinstance(seen, SimulatedCamera | RemoteCamera):
        raise InputError("only a simulated fish can be drawn", "Start one: tailbeat sim")
    marker, usual = options.marker, scene_of(seen)
    scene = replace(
        usual,
        marker=marker.kind,
        marker_id=usual.marker_id if marker.id is None else marker.id,
        marker_side_m=usual.marker_side_m if marker.side_m is None else marker.side_m,
    )
    return RenderedDevice(seen, scene), known or scene.calibration()


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
    book = logbook_of(fish)
    with suppress(InputError):
        if book is not None and (identified := book.identified()) is not None:
            return identified.model.kappa_per_m
    return fish.params.get("MDL_KAPPA").value


def camera_report(fish: Fish, camera: VideoCamera, trial: int) -> dict[str, float]:
    """How a swim's camera did: pictures that should have come, those with the fish, those nobody
    had time for; if the LED's code was seen, also how much the stamps are late (``late_s``,
    ``late_sigma_s``)."""
    seen = camera.track()
    report: dict[str, float] = {
        "pictures": len(seen.t_s),
        "seen": int(seen.seen().sum()),
        "dropped": camera.dropped,
    }
    with suppress(TailbeatError):  # no LED to be seen, or a trial's file that cannot be had
        report |= _lateness(fish, camera, seen, trial)
    return report


def _lateness(fish: Fish, camera: VideoCamera, seen: Track, trial: int) -> dict[str, float]:
    found = sync_by_led(seen, None)
    if found.trial != trial % 256:
        return {}
    with TemporaryDirectory() as folder:
        begun_s = read_trial(fish.pull_trial(trial, Path(folder))).start_us * 1e-6
    by_board = camera.clock == "board"
    start_s = found.start_s if by_board else fish.clock.board_s(found.start_s)
    return {"late_s": start_s - begun_s, "late_sigma_s": found.sigma_s}


def camera_text(report: dict[str, float]) -> str:
    """The report in one line."""
    line = f"camera: {report['pictures']:.0f} pictures, the fish seen in {report['seen']:.0f}"
    line += f", {report['dropped']:.0f} dropped" if report["dropped"] else ""
    if "late_s" in report:
        line += f"; stamps late by {report['late_s'] * 1e3:.0f} +- "
        line += f"{report['late_sigma_s'] * 1e3:.0f} ms"
    return line


def lateness_warning(report: dict[str, float], latency_s: float) -> str | None:
    """What to do about stamps that are too late or too early to belong to their beats."""
    late_s = report.get("late_s", 0.0)
    if abs(late_s) <= LATE_MAX_S:
        return None
    side = "late" if late_s > 0 else "early"
    return (
        f"the pictures' stamps are {abs(late_s) * 1e3:.0f} ms {side} by the fish's LED;"
        f" next time give --latency {latency_s + late_s:.3f}"
    )
