"""Pictures to positions while the fish swims: threads, their end, and what goes wrong in them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from queue import Queue
from typing import Any

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core.errors import InputError
from tailbeat.core.speed_source import CameraGone, Frame, Unseen
from tailbeat.link.messages import BeatEvent, BoardStatus
from tailbeat.sensors.camera.calibration.file import Calibration
from tailbeat.sensors.camera.source.picture import TimedImage
from tailbeat.sensors.camera.tracking.live import VideoCamera
from tailbeat.sensors.camera.tracking.track import LOST, SEEN
from tailbeat.sensors.camera.tracking.tracker import RepeatFilter, TrackedImage
from tailbeat.session import trial as trialrun
from tailbeat.session.events import Event, TrialEnded, TrialStarted, TrialStopped, TrialWarning
from tailbeat.session.guards import WallGuard
from tailbeat.session.outcome import StopKind, StopReason
from tailbeat.session.trial import run_trial
from tailbeat.session.trial_camera import default_camera

GRACE_S = 600.0  # after which a thread hangs; nothing waits so long otherwise
IMAGE = np.zeros((4, 6), dtype=np.uint8)


def picture(index: int) -> TimedImage:
    return TimedImage(index, index / 25, IMAGE)


class Device:
    """Gives what a test puts into ``coming``: pictures, errors to raise, None = the end."""

    def __init__(self, clock: Any = "host") -> None:
        self.name, self.clock, self.fps, self.size_px = "a device", clock, 25.0, (6, 4)
        self.coming: Queue[TimedImage | Exception | None] = Queue()
        self.ended = False
        self.closed = threading.Event()

    def put(self, *what: TimedImage | Exception | None) -> None:
        for each in what:
            self.coming.put(each)

    def read(self) -> TimedImage | None:
        what = self.coming.get(timeout=GRACE_S)
        if isinstance(what, Exception):
            raise what
        self.ended = what is None
        return what

    def close(self) -> None:
        self.closed.set()
        self.coming.put(None)


class Eyes:
    """A tracker that sees the fish in every picture but those in ``hidden``, once it may ``go``."""

    def __init__(self, go: bool = True, hidden: tuple[int, ...] = ()) -> None:
        self.looking: Queue[int] = Queue()
        self.go = threading.Event()
        self.hidden = hidden
        self.trouble: dict[int, Exception] = {}
        if go:
            self.go.set()

    def look(self, picture: TimedImage) -> TrackedImage:
        self.looking.put(picture.index)
        assert self.go.wait(GRACE_S)
        if picture.index in self.trouble:
            raise self.trouble[picture.index]
        frame = None if picture.index in self.hidden else Frame(picture.t_s, picture.index * 1e-3)
        return TrackedImage(picture.index, picture.t_s, frame, None, None)

    def wait_for(self, index: int) -> None:
        """Until that picture is being looked at; all before it are done then."""
        while self.looking.get(timeout=GRACE_S) != index:
            pass


Open = Callable[..., VideoCamera]


@pytest.fixture
def opened() -> Iterator[Open]:
    cameras: list[VideoCamera] = []

    def camera(device: Device, eyes: Eyes, **others: Any) -> VideoCamera:
        cameras.append(VideoCamera(device, eyes, **others))  # type: ignore[arg-type]
        return cameras[-1]

    yield camera
    for each in cameras:
        each._source.put(None)
        each.close()
    assert not threads()


def threads() -> list[threading.Thread]:
    return [t for t in threading.enumerate() if t.name.startswith("camera-")]


def ended(name: str) -> None:
    """Waits for the end of a thread."""
    for thread in threads():
        if thread.name == name:
            thread.join(GRACE_S)
            assert not thread.is_alive()


def indices(frames: list[Frame]) -> list[int]:
    return [round(frame.x_m * 1e3) for frame in frames]


def test_frames_come_in_order_and_once(opened: Open) -> None:
    device, eyes = Device(), Eyes(hidden=(1,))
    camera = opened(device, eyes)
    assert (camera.clock, camera.fps) == ("host", 25.0)
    device.put(*map(picture, range(5)))
    eyes.wait_for(4)
    first = indices(camera.frames())
    assert first[:3] == [0, 2, 3]
    device.put(picture(5), picture(6), None)
    ended("camera-look")
    assert first + indices(camera.frames()) == [0, 2, 3, 4, 5, 6]
    assert camera.dropped == 0


def test_a_slow_tracker_drops_the_oldest_and_never_lags(opened: Open) -> None:
    device, eyes = Device(), Eyes(go=False)
    recorded: Queue[int] = Queue()
    camera = opened(device, eyes, on_picture=lambda p: recorded.put(p.index))
    device.put(picture(0))
    eyes.wait_for(0)
    device.put(*map(picture, range(1, 42)), None)
    ended("camera-read")
    assert [recorded.get(timeout=GRACE_S) for _ in range(42)] == list(range(42))
    eyes.go.set()
    ended("camera-look")
    kept = indices(camera.frames())
    assert kept[0] == 0
    assert kept[1:] == list(range(30, 42))  # half a second of 25
    assert camera.dropped == 29


def test_the_end_does_not_wait_for_pictures_to_be_looked_at(opened: Open) -> None:
    device, eyes = Device(), Eyes()
    camera = opened(device, eyes)
    device.put(*map(picture, range(3)))
    eyes.wait_for(2)
    closing = threading.Thread(target=camera.close)
    closing.start()
    device.put(picture(3))  # a device that blocks comes back with its next picture
    closing.join(GRACE_S)
    assert device.closed.is_set() and not threads()
    camera.close()
    assert isinstance(camera.frames(), list)  # and nothing is raised of what closing broke


@pytest.mark.parametrize("trouble", [InputError("no device", "Plug it."), None])
def test_a_device_that_is_gone_is_told_once_after_its_last_frames(
    opened: Open, trouble: Exception | None
) -> None:
    device, eyes = Device(), Eyes()
    camera = opened(device, eyes)
    device.put(picture(0), picture(1), trouble)
    assert device.closed.wait(GRACE_S)
    ended("camera-look")
    assert indices(camera.frames()) == [0, 1]
    with pytest.raises(CameraGone, match="no device" if trouble else "a device gives no pictures"):
        camera.frames()
    assert camera.frames() == camera.frames() == []


def test_what_the_tracker_raises_comes_out_once_and_the_film_goes_on(opened: Open) -> None:
    device, eyes = Device(), Eyes()
    recorded: Queue[int] = Queue()
    eyes.trouble[1] = InputError("two fish", "Take one out.")
    camera = opened(device, eyes, on_picture=lambda p: recorded.put(p.index))
    device.put(picture(0), picture(1))
    ended("camera-look")
    assert indices(camera.frames()) == [0]
    with pytest.raises(InputError, match="two fish") as raised:
        camera.frames()
    assert not isinstance(raised.value, CameraGone)
    device.put(picture(2))
    assert [recorded.get(timeout=GRACE_S) for _ in range(3)] == [0, 1, 2]
    assert camera.frames() == []


def test_the_first_trouble_counts(opened: Open) -> None:
    device, eyes = Device(), Eyes()
    eyes.trouble[0] = RuntimeError("a bug")
    camera = opened(device, eyes)
    device.put(picture(0))
    ended("camera-look")
    device.put(InputError("no device"))
    ended("camera-read")
    with pytest.raises(RuntimeError, match="a bug"):
        camera.frames()
    assert camera.frames() == []


def test_a_film_is_no_camera() -> None:
    with pytest.raises(InputError, match="is a film"):
        VideoCamera(Device(clock="video"), Eyes())  # type: ignore[arg-type]


class InStep(Device):
    """A device in virtual time: what is not there yet does not come by waiting."""

    def read(self) -> TimedImage | None:
        if self.coming.empty():
            return None
        what = self.coming.get_nowait()
        if isinstance(what, Exception):
            raise what
        return what


def test_in_virtual_time_there_are_no_threads(opened: Open) -> None:
    device, eyes = InStep("board"), Eyes(hidden=(2,))
    camera = opened(device, eyes, threaded=False)
    assert not threads() and camera.frames() == []
    device.put(*map(picture, range(4)))
    assert indices(camera.frames()) == [0, 1, 3]
    device.put(picture(4), InputError("pulled out"))
    assert indices(camera.frames()) == [4]
    with pytest.raises(CameraGone, match="pulled out"):
        camera.frames()
    assert camera.frames() == []
    camera.close()
    assert device.closed.is_set()


def test_the_track_so_far(opened: Open) -> None:
    device = InStep()
    camera = opened(device, Eyes(hidden=tuple(range(10, 20))), threaded=False)
    device.put(*map(picture, range(30)))
    camera.frames()
    track = camera.track()
    assert track.name == "a device" and track.fps == pytest.approx(25)
    assert (track.state == SEEN).sum() == 20 and (track.state == LOST).sum() == 10
    np.testing.assert_allclose(track.x_m[track.seen()] * 1e3, [*range(10), *range(20, 30)])


class Trouble:
    """The simulated fish's camera until a moment of the trial, when ``error`` is raised once."""

    def __init__(self, fish: Fish, after_s: float, error: Exception) -> None:
        camera = default_camera(fish)
        assert camera is not None and fish.sim is not None
        self._camera, self._sim, self._left = camera, fish.sim, [error]
        self._until_s = fish.sim.time_s + after_s
        self.clock, self.fps, self.close = camera.clock, camera.fps, camera.close

    def frames(self) -> list[Frame]:
        frames = self._camera.frames()
        if self._sim.time_s < self._until_s:
            return frames
        if self._left:
            raise self._left.pop()
        return []


UPLOAD, VISION = 1, 0


def swim(
    fish: Fish, error: Exception, source: int, guard: Any = None
) -> tuple[list[str], Callable[[], Any]]:
    fish.params.set("SPD_SOURCE", source)
    warnings: list[str] = []

    def follow(event: Event) -> None:
        if isinstance(event, TrialWarning):
            warnings.append(event.text)

    return warnings, lambda: run_trial(fish, Trouble(fish, 4.0, error), follow, guard)


def area(back_m: float, front_m: float) -> Calibration:
    corners = [(-back_m, -0.9), (front_m, -0.9), (front_m, 0.9), (-back_m, 0.9)]
    return Calibration(
        (1280, 720), np.eye(3), np.zeros(5), np.eye(3), area_m=np.array(corners, dtype=np.float64)
    )


def test_a_camera_gone_in_mid_swim_ends_a_swim_that_lives_by_it(ready: Fish) -> None:
    warnings, run = swim(ready, CameraGone("unplugged", "Plug it in."), VISION)
    outcome = run()
    assert outcome.end == "aborted:ABORT_COMMAND" and 0 < outcome.executed_beats < 8
    assert warnings == ["unplugged. Plug it in. The trial has no camera any more."]
    assert outcome.beats[0].speed_m_s is not None


def test_a_camera_gone_does_not_end_a_swim_that_needs_none(ready: Fish) -> None:
    warnings, run = swim(ready, CameraGone("unplugged"), UPLOAD)
    assert run().end == "complete"
    assert len(warnings) == 1


def test_a_guard_without_its_camera_stops_the_fish(ready: Fish) -> None:
    guard = WallGuard(area(0.5, 2.5))
    _, run = swim(ready, CameraGone("unplugged"), UPLOAD, guard)
    assert run().end == "aborted:ABORT_COMMAND"


def test_two_fish_stop_the_tail_first_and_are_told_then(ready: Fish) -> None:
    warnings, run = swim(ready, InputError("two fish", "Take one out."), UPLOAD)
    with pytest.raises(InputError, match="two fish"):
        run()
    assert warnings == ["two fish. Take one out."]
    assert ready.sim is not None and not ready.sim.world.truth().swimming
    status = ready.status()
    assert status.state == "ABORTED" and status.trial == 1 and 0 < status.beat < 8
    assert [trial.number for trial in ready.trials()] == [1]


def test_before_the_start_trouble_is_raised_at_once(ready: Fish) -> None:
    for error in (CameraGone("unplugged"), InputError("moved")):
        with pytest.raises(type(error)):
            run_trial(ready, Trouble(ready, 0.0, error))
        assert ready.status().next_trial == 1


class Spoilt:
    """The simulated fish's camera; ``spoil`` sees its frames, and the seconds since it was made."""

    def __init__(self, fish: Fish, spoil: Callable[[float, list[Frame]], list[Frame]]) -> None:
        camera = default_camera(fish)
        assert camera is not None and fish.sim is not None
        self._camera, self._sim, self._spoil = camera, fish.sim, spoil
        self._begin_s = fish.sim.time_s
        self.clock, self.fps, self.close = camera.clock, camera.fps, camera.close

    def frames(self) -> list[Frame]:
        return self._spoil(self._sim.time_s - self._begin_s, self._camera.frames())


def stopped(fish: Fish) -> bool:
    """By a command, not by the board's own rules for a host that went away."""
    assert fish.sim is not None
    status = fish.status()
    fish.sim.run(1.0)  # the tail comes to its middle
    return status.fault.name == "ABORT_COMMAND" and not fish.sim.world.truth().swimming


@pytest.mark.parametrize("kind", [Frame, BeatEvent, Unseen])
def test_a_guard_that_breaks_stops_the_tail(ready: Fish, kind: type) -> None:
    def guard(what: object) -> StopReason | None:
        assert ready.sim is not None
        if isinstance(what, kind) and ready.sim.world.truth().swimming:
            raise RuntimeError("a bug in the guard")
        return None

    with pytest.raises(RuntimeError, match="a bug in the guard"):
        run_trial(ready, guard=guard)
    assert stopped(ready)


@pytest.mark.parametrize("event", [TrialStarted, BeatEvent, TrialWarning])
def test_a_listener_that_breaks_stops_the_tail(ready: Fish, event: type) -> None:
    def follow(told: Event) -> None:
        if isinstance(told, event):
            raise BrokenPipeError("nobody reads")

    with pytest.raises(BrokenPipeError):
        run_trial(ready, Trouble(ready, 4.0, InputError("two fish")), follow)
    assert stopped(ready)


def test_what_breaks_before_the_start_or_after_the_end_stops_nothing(
    ready: Fish, monkeypatch: pytest.MonkeyPatch
) -> None:
    def follow(told: Event) -> None:
        if isinstance(told, TrialEnded):
            raise BrokenPipeError("nobody reads")

    def abort(wall: bool = False) -> None:
        raise AssertionError("said without need")

    monkeypatch.setattr(ready, "abort", abort)
    with pytest.raises(InputError, match="moved"):
        run_trial(ready, Trouble(ready, 0.0, InputError("moved")))
    with pytest.raises(BrokenPipeError):
        run_trial(ready, on_event=follow)
    status = ready.status()
    assert (status.state, status.pending_trial) == ("IDLE", 1)


@pytest.mark.parametrize("absurd_s", [1e30, -1e30, 1e7, -1.0, float("inf"), float("nan"), 3600.0])
def test_absurd_stamps_are_dropped(ready: Fish, absurd_s: float) -> None:
    def spoil(now_s: float, frames: list[Frame]) -> list[Frame]:
        wrong = [Frame(absurd_s + (k and 1e-3), 0.1, 0.0, 0.0) for k in range(2)]
        return frames + wrong if 2.0 < now_s < 3.0 else frames

    outcome = run_trial(ready, Spoilt(ready, spoil))
    assert outcome.end == "complete"
    assert all(beat.speed_m_s is not None for beat in outcome.beats[1:])


def test_a_stream_of_absurd_stamps_ends_nothing(ready: Fish) -> None:
    def spoil(_: float, frames: list[Frame]) -> list[Frame]:
        return [Frame(f.t_s * 1e12, f.x_m, f.y_m, f.heading_rad) for f in frames]

    assert run_trial(ready, Spoilt(ready, spoil)).end == "complete"


def test_after_the_swim_the_guard_is_not_asked(ready: Fish) -> None:
    told: list[Event] = []
    swimming: list[bool] = []

    def guard(what: object) -> StopReason | None:
        assert ready.sim is not None
        swimming.append(ready.sim.world.truth().swimming)
        return (
            StopReason(StopKind.CALLER, "too late")
            if True in swimming and not swimming[-1]
            else None
        )

    assert run_trial(ready, on_event=told.append, guard=guard).end == "complete"
    assert True in swimming and not [event for event in told if isinstance(event, TrialStopped)]


def test_a_lost_word_of_the_end_does_not_have_the_guard_asked(
    ready: Fish, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last beat says it, too."""
    told: list[Event] = []
    lost: list[BoardStatus] = []
    take = trialrun._take_status

    def lose(run: trialrun._Run, status: BoardStatus) -> None:
        if status.state == "SETTLING" and len(lost) < 4:
            lost.append(status)
        else:
            take(run, status)

    def guard(_: object) -> StopReason | None:
        last = [event for event in told if isinstance(event, BeatEvent) and event.beat == 7]
        return StopReason(StopKind.CALLER, "too late") if last else None

    monkeypatch.setattr(trialrun, "_take_status", lose)
    assert run_trial(ready, on_event=told.append, guard=guard).end == "complete"
    assert lost and not [event for event in told if isinstance(event, TrialStopped)]


@pytest.mark.parametrize("beat_s", [1.0, 4.0])
def test_a_fish_out_of_sight_is_stopped_in_time(ready: Fish, beat_s: float) -> None:
    """The guard learns of time between beats, however long they are."""
    assert ready.sim is not None
    ready.params.set("TANK_LEN_M", 0)
    ready.params.set("SPD_SOURCE", UPLOAD)
    beats = round(40 / beat_s)
    ready.upload_reference(records.encode_reference(beat_s, np.full(beats, 0.07)))
    ready.upload_amplitudes(np.full(beats, 0.55, dtype=np.float32))
    guard = WallGuard(area(0.5, 1.5), beat_s=beat_s)
    camera = Spoilt(ready, lambda now_s, frames: frames if now_s < 12 else [])
    assert run_trial(ready, camera, guard=guard).end == "aborted:WALL"
    assert 0.05 < ready.sim.world.truth().x_m < 1.5 - 0.2


def freeze(fish: Fish, after_s: float) -> Spoilt:
    """From then on the driver repeats the last picture with fresh stamps."""
    last: list[Frame] = []

    def spoil(now_s: float, frames: list[Frame]) -> list[Frame]:
        if now_s < after_s or not last:
            last[:] = frames[-1:] or last
            return frames
        old = last[0]
        return [Frame(f.t_s, old.x_m, old.y_m, old.heading_rad) for f in frames]

    return Spoilt(fish, spoil)


def test_a_picture_that_stands_still_shows_no_fish(ready: Fish) -> None:
    warnings: list[str] = []

    def follow(event: Event) -> None:
        if isinstance(event, TrialWarning):
            warnings.append(event.text)

    outcome = run_trial(ready, freeze(ready, 5.0), follow)
    assert outcome.end == "complete"
    assert warnings == ["the camera's picture stands still; beats go unmeasured"]
    measured = [beat.speed_m_s is not None for beat in outcome.beats]
    assert any(measured[:4]) and not any(measured[5:])


def test_a_picture_that_stands_still_from_the_start_is_told(ready: Fish) -> None:
    """Once the tail beats so that every fish moves."""
    ready.params.set("DU_MAX_RAD", 0)
    ready.upload_amplitudes(np.full(8, 0.5, dtype=np.float32))
    warnings: list[str] = []

    def follow(event: Event) -> None:
        if isinstance(event, TrialWarning):
            warnings.append(event.text)

    run_trial(ready, freeze(ready, 0.0), follow)
    assert warnings == ["the camera's picture stands still; beats go unmeasured"]


def test_a_guard_is_not_fooled_by_a_picture_that_stands_still(ready: Fish) -> None:
    assert ready.sim is not None
    ready.params.set("TANK_LEN_M", 0)
    ready.upload_reference(records.encode_reference(1.0, np.full(32, 0.07)))
    ready.upload_amplitudes(np.full(32, 0.55, dtype=np.float32))
    camera = freeze(ready, 9.0)
    assert run_trial(ready, camera, guard=WallGuard(area(0.5, 1.5))).end == "aborted:WALL"
    assert ready.sim.world.truth().x_m + 0.2 < 1.5


def test_a_fish_at_rest_before_a_camera_without_noise_is_no_frozen_picture() -> None:
    """Its first beats are too weak, or none."""
    still = {"camera_noise_m": 0.0, "start_sigma_m_s": 0.0, "flow_sigma_m_s": 0.0}
    with Fish.connect("sim:tank", seed=1, **still) as fish:
        fish.params.set("DU_MAX_RAD", 0)
        fish.upload_reference(records.encode_reference(1.0, np.full(8, 0.03)))
        fish.upload_amplitudes(np.array([0, 0, 0, 0, 0.1, 0.4, 0.4, 0.4], dtype=np.float32))
        events: list[Event] = []
        outcome = run_trial(fish, on_event=events.append, guard=WallGuard(area(0.5, 2.5)))
        assert outcome.end == "complete"
        assert not [event for event in events if isinstance(event, TrialWarning | TrialStopped)]
        assert all(beat.speed_m_s is not None for beat in outcome.beats[1:])


def positions(*x_m: float, begin_s: float = 0.0) -> list[Frame]:
    return [Frame(begin_s + k / 25, x) for k, x in enumerate(x_m)]


def test_a_coarse_camera_loses_nothing() -> None:
    """Positions in steps that last less than a second come late, but come."""
    repeats = RepeatFilter()
    frames = positions(*(0.01 * (k // 20) for k in range(200)))
    believed = [frame for each in frames for frame in repeats.new([each])]
    assert believed == frames[:181] and not repeats.frozen


def test_a_picture_that_moves_again_is_believed_again() -> None:
    repeats = RepeatFilter()
    moving = positions(*(0.01 * k for k in range(50)))
    still = positions(*[0.49] * 50, begin_s=2.0)
    again = positions(*(0.6 + 0.01 * k for k in range(50)), begin_s=4.0)
    assert repeats.new(moving) == moving
    assert repeats.new(still) == [] and repeats.frozen
    assert repeats.new(again) == again and not repeats.frozen
