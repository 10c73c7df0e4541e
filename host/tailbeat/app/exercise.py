"""A trial of a simulated fish with its film: something to try ``tailbeat camera track`` on, whose
truth is known."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal
from urllib.parse import urlencode

import numpy as np

from tailbeat.board.fish import Fish
from tailbeat.core import speed_source
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError, TailbeatError, reason
from tailbeat.core.files import replacing_text
from tailbeat.core.reference import Reference
from tailbeat.core.speed_source import Frame, source_number
from tailbeat.core.trial_file import read_trial
from tailbeat.link.messages import BeatEvent, TrialOutcome
from tailbeat.sensors.camera.render.painter import Painter
from tailbeat.sensors.camera.render.scene import Scene
from tailbeat.sensors.camera.render.source import drawn_pose_of, picture_index
from tailbeat.sensors.camera.source.film import FilmWriter
from tailbeat.session.events import Event, OnEvent
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimulatedBoard
from tailbeat.sim.world import CameraFrame

Progress = Callable[[float, str], None]

TRUTH_COLUMNS = ("t_s", "x_m", "y_m", "heading_rad", "tail_rad", "led", "speed_m_s")
_FORMATS = (".mp4", ".mkv")
_TRUTH, _TANK, _LOG = ".truth.csv", ".tank.json", ".ulg"
_AMPLITUDE_MAX_RAD = math.pi / 4
_SWIM_SHARE = 0.1  # of the work; the rest is drawing
_AFTER_S = 2.0  # of film after the last beat


@dataclass(frozen=True)
class ExerciseOptions:
    """``before_s``: of film before the trial. ``overrides``: fields of the simulator's
    configuration, SI."""

    reference: Reference
    scene: Scene
    plant: str = "tank"
    seed: int = 1
    before_s: float = 2.0
    overrides: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Exercise:
    """What was written, and what is true. ``swim_begin_s``: in the film's time."""

    film: Path
    truth: Path
    calibration: Path
    trial_file: Path
    trial: int
    pictures: int
    lost: int
    fps: float
    swim_begin_s: float
    beat_s: float
    true_speed_m_s: F64  # mean of each beat


@dataclass(frozen=True)
class _Filmed:
    frames: list[CameraFrame]
    speed: tuple[F64, F64]  # times and speeds
    trial: int
    begin_s: float
    true_speed_m_s: F64


def make_exercise(
    film: Path, options: ExerciseOptions, progress: Progress = lambda done, text: None
) -> Exercise:
    """Runs a trial along ``options.reference``, about as fast as it says, and writes ``film``, its
    .truth.csv, its .tank.json (the calibration) and the trial's file, its .ulg, beside it: all of
    them or none. The trial waits for uploaded speeds.

    Raises InputError for names and values that make no sense, and when there is such a .ulg already
    that is not an earlier exercise's.
    """
    _check_name(film)
    with _part_beside(film) as name:
        folder = Path(name)
        written = folder / film.name
        trial, fps = _run(options, written.with_suffix(_LOG), progress)
        _draw(written, trial, options.scene, fps, progress)
        _write_truth(written.with_suffix(_TRUTH), trial)
        options.scene.calibration().save(written.with_suffix(_TANK))
        for path in sorted(folder.iterdir()):
            path.replace(film.parent / path.name)
    shot = 1 + picture_index(trial.frames[-1], fps) - picture_index(trial.frames[0], fps)
    pictures = len(trial.frames)
    return Exercise(
        film=film,
        truth=film.with_suffix(_TRUTH),
        calibration=film.with_suffix(_TANK),
        trial_file=film.with_suffix(_LOG),
        trial=trial.trial,
        pictures=pictures,
        lost=shot - pictures,
        fps=fps,
        swim_begin_s=trial.begin_s - trial.frames[0].time_s,
        beat_s=options.reference.beat_s,
        true_speed_m_s=trial.true_speed_m_s,
    )


class _Watcher:
    """The board's own camera, whose frames are kept, and how fast the fish really was."""

    clock: Literal["host", "board"] = "host"

    def __init__(self, board: SimulatedBoard) -> None:
        board.watched = True
        board.camera_frames()
        self._board = board
        self.fps = float(board.config["camera_fps"])
        self.kept: list[CameraFrame] = []
        self._speed: dict[float, float] = {}

    def frames(self) -> list[Frame]:
        """Frames since the last call."""
        truth = self._board.world.truth()
        self._speed[truth.time_s] = truth.v_m_s
        new = self._board.camera_frames()
        self.kept += new
        return [Frame(f.time_s, f.x_m, f.y_m, f.heading_rad) for f in new]

    def close(self) -> None:
        """Nothing to give up."""

    def speed(self) -> tuple[F64, F64]:
        """Times and speeds."""
        return np.array(list(self._speed)), np.array(list(self._speed.values()))


def _run(options: ExerciseOptions, log_file: Path, progress: Progress) -> tuple[_Filmed, float]:
    url = f"sim?{urlencode({'plant': options.plant, 'seed': options.seed})}"
    camera = {"camera_exposure_s": options.scene.exposure_s, **options.overrides}
    with Fish.connect(url, **camera) as fish:
        board = fish.sim
        assert board is not None
        _prepare(fish, board, options.reference)
        number = fish.status().next_trial
        watcher = _Watcher(board)
        fish.imu_verdict()  # without its turns film and log cannot be paired
        _watch(fish, watcher, options.before_s)
        _complete(run_trial(fish, watcher, _follower(options.reference.beats, progress)))
        _watch(fish, watcher, _AFTER_S)
        log = read_trial(fish.pull_trial(number, log_file.parent).replace(log_file))
        begin_s = log.start_us * 1e-6 + board.time_s - board.board_time_s
        true = board.world.true_beats()[: options.reference.beats]
        kept = _cut(watcher.kept, begin_s, options)
        return _Filmed(kept, watcher.speed(), number, begin_s, true), watcher.fps


def _follower(beats: int, progress: Progress) -> OnEvent:
    reached = 0

    def follow(event: Event) -> None:
        nonlocal reached
        if isinstance(event, BeatEvent) and event.beat >= reached:  # each is reported twice
            reached = event.beat + 1
            progress(_SWIM_SHARE * reached / beats, f"swimming, beat {reached} of {beats}")

    return follow


def _prepare(fish: Fish, board: SimulatedBoard, reference: Reference) -> None:
    """The amplitude of each beat that gives about its speed, by the plant's steady line."""
    fish.params.set("AMP_MAX_RAD", _AMPLITUDE_MAX_RAD)
    fish.params.set(speed_source.PARAMETER, source_number("upload"))
    fish.upload_reference(reference)
    line = board.config["slope_m_s_rad"], board.config["dead_zone_rad"]
    speed = reference.speed_m_s.astype(np.float64)
    amplitude = np.where(speed > 0, speed / line[0] + line[1], 0.0)
    fish.upload_amplitudes(np.minimum(amplitude, _AMPLITUDE_MAX_RAD).astype(np.float32))


def _watch(fish: Fish, watcher: _Watcher, duration_s: float) -> None:
    end_s = fish.transport.now_s() + duration_s
    while fish.transport.now_s() < end_s:
        fish.link.idle(end_s - fish.transport.now_s())
        fish.link.flush()
        watcher.frames()


def _complete(outcome: TrialOutcome) -> None:
    if outcome.interrupted:
        raise KeyboardInterrupt
    if outcome.end != "complete":
        raise TailbeatError(
            f"the simulated trial ended with {outcome.end} after {outcome.executed_beats} beats",
            "Give another --reference.",
        )


def _cut(frames: list[CameraFrame], begin_s: float, options: ExerciseOptions) -> list[CameraFrame]:
    first_s = begin_s - options.before_s
    last_s = begin_s + options.reference.duration_s + _AFTER_S
    kept = [frame for frame in frames if first_s <= frame.time_s <= last_s]
    if not kept:
        raise InputError("the camera lost every picture.", "Give a smaller --lost.")
    return kept


def _draw(path: Path, trial: _Filmed, scene: Scene, fps: float, progress: Progress) -> None:
    painter = Painter(scene)
    count = len(trial.frames)
    with FilmWriter(path, scene.size_px, fps) as writer:
        before: CameraFrame | None = None
        for done, frame in enumerate(trial.frames, 1):
            image = painter.paint(drawn_pose_of(frame, before), picture_index(frame, fps))
            writer.add(image, frame.time_s)
            before = frame
            part = _SWIM_SHARE + (1 - _SWIM_SHARE) * done / count
            progress(part, f"drawing, picture {done} of {count}")


def _write_truth(path: Path, trial: _Filmed) -> None:
    """As drawn, the camera's noise included; the speed is the fish's own."""
    first_s = trial.frames[0].time_s
    with replacing_text(path) as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(TRUTH_COLUMNS)
        for frame in trial.frames:
            speed = float(np.interp(frame.time_s, *trial.speed))
            place = frame.x_m, frame.y_m, frame.heading_rad, frame.tail_rad, frame.led, speed
            out.writerow([f"{frame.time_s - first_s:.6f}", *(f"{value:.6f}" for value in place)])


def _check_name(film: Path) -> None:
    if film.suffix.lower() not in _FORMATS:
        raise InputError(f"cannot write a film as {film.name}.", "Name it .mp4 or .mkv.")
    if not film.parent.is_dir():
        raise InputError(f"there is no folder {film.parent}.", "Make it, or write elsewhere.")
    # The log's name is no different from a real trial's.
    there = film.with_suffix(_LOG)
    if there.exists() and not film.with_suffix(_TRUTH).exists():
        raise InputError(
            f"{there} is there already and may be a real trial's.", "Give the film another name."
        )


def _part_beside(film: Path) -> TemporaryDirectory[str]:
    try:
        return TemporaryDirectory(prefix=".rendering-", dir=film.parent)
    except OSError as error:
        raise InputError(
            f"cannot write to {film.parent} ({reason(error)}).", "Choose another place."
        ) from error
