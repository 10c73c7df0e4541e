"""The tracker before a drawn tank, and before a detector that says what it is told."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from tailbeat.core.errors import InputError
from tailbeat.sensors.camera.calibration.file import Calibration
from tailbeat.sensors.camera.marker.blob import BlobDetector
from tailbeat.sensors.camera.marker.detector import Marker
from tailbeat.sensors.camera.marker.tags import Detection, SearchWindow
from tailbeat.sensors.camera.render.painter import DrawnPose, Painter
from tailbeat.sensors.camera.render.scene import Scene
from tailbeat.sensors.camera.source.picture import Image, TimedImage
from tailbeat.sensors.camera.tracking.tracker import (
    PATCH_CELL_M,
    PATCH_HALF_WIDTH_M,
    PATCH_LEFT_M,
    PATCH_RIGHT_M,
    PATCH_SHAPE,
    TrackedImage,
    Tracker,
    patch_around,
)

FPS = 25.0
ARUCO = Marker("aruco", None, 0.06)


@cache
def painter(scene: Scene) -> Painter:
    return Painter(scene)


def recorded(t_s: float) -> DrawnPose:
    """Rests half a second, then swims at 0.1 m/s, heading and tail wagging once a second."""
    trials = t_s >= 0.5
    wag = math.sin(2 * math.pi * (t_s - 0.5)) if trials else 0.0
    x_m = 0.1 * (t_s - 0.5) if trials else 0.0
    return DrawnPose(t_s, x_m, 0.05, 0.1 * wag, 0.5 * wag, 0.0, 0.1 * trials)


def film(
    scene: Scene, times: Iterable[float], where: Callable[[float], DrawnPose] = recorded
) -> list[tuple[DrawnPose, TimedImage]]:
    draw = painter(scene).paint
    return [(where(t), TimedImage(k, t, draw(where(t), k))) for k, t in enumerate(times)]


def even(count: int, fps: float = FPS) -> list[float]:
    return [k / fps for k in range(count)]


def follow(tracker: Tracker, pictures: list[tuple[DrawnPose, TimedImage]]) -> list[TrackedImage]:
    return [tracker.look(picture) for _, picture in pictures]


@pytest.mark.parametrize("kind", ["aruco", "apriltag"])
def test_follows_the_fish_to_a_fraction_of_a_millimetre(kind: str) -> None:
    scene = Scene(marker=kind)  # type: ignore[arg-type]
    pictures = film(scene, even(40))
    tracker = Tracker(Marker(kind, 7, 0.06), scene.calibration(), "a film")  # type: ignore[arg-type]
    off = []
    for (truth, picture), place in zip(pictures, follow(tracker, pictures), strict=True):
        assert place.frame is not None
        assert place.detection is not None
        assert (
            (place.index, place.t_s) == (picture.index, picture.t_s) == (place.index, truth.time_s)
        )
        frame = place.frame
        off.append(
            (frame.x_m - truth.x_m, frame.y_m - truth.y_m, frame.heading_rad - truth.heading_rad)
        )
    rms = np.sqrt(np.mean(np.square(off), axis=0))
    sys.stdout.write(f"{kind}: RMS {1000 * rms[0]:.2f}, {1000 * rms[1]:.2f} mm, {rms[2]:.4f} rad\n")
    assert rms[0] < 3e-4
    assert rms[1] < 3e-4
    assert rms[2] < 5e-3


def test_time_stamps_that_are_not_even() -> None:
    scene = Scene()
    times = [0.0, 0.04, 0.13, 0.16, 0.41, 0.43, 0.8, 0.84, 0.88, 1.3]
    tracker = Tracker(ARUCO, scene.calibration(), "a film")
    for truth, picture in film(scene, times):
        frame = tracker.look(picture).frame
        assert frame is not None
        assert frame.x_m == pytest.approx(truth.x_m, abs=1e-3)


def test_two_fish_are_refused_with_both_places() -> None:
    scene = Scene(fish=2)
    tracker = Tracker(ARUCO, scene.calibration(), "lab.mp4")
    with pytest.raises(
        InputError, match=r"two fish in lab.mp4: at \(-?0.00, 0.05\) m and \("
    ) as told:
        follow(tracker, film(scene, even(4)))
    assert "--marker-id" in str(told.value)


def test_a_second_fish_that_comes_later_is_noticed_within_a_second_or_so() -> None:
    alone, both = Scene(), Scene(fish=2)
    tracker = Tracker(ARUCO, alone.calibration(), "lab.mp4")
    times = even(40)
    follow(tracker, film(alone, times[:8]))
    late = film(both, times[8:])
    with pytest.raises(InputError, match="two fish"):
        follow(tracker, [(t, replace(p, index=p.index + 8)) for t, p in late])


def test_another_fishs_marker_is_not_followed() -> None:
    scene = Scene()
    tracker = Tracker(Marker("aruco", 3), scene.calibration(), "a film")
    assert all(place.frame is None for place in follow(tracker, film(scene, even(2))))
    assert 7 in tracker.other_ids


@pytest.mark.parametrize(
    ("side_m", "wrong"), [(0.06, False), (0.0575, False), (0.0645, True), (0.05, True)]
)
def test_a_marker_of_another_size_says_that_the_scale_is_wrong(side_m: float, wrong: bool) -> None:
    scene = Scene()
    tracker = Tracker(Marker("aruco", 7, side_m), scene.calibration(), "a film")
    pictures = film(scene, even(30, fps=20))
    if not wrong:
        assert tracker.measured_side_m is None
        follow(tracker, pictures)
        assert tracker.measured_side_m == pytest.approx(0.06, rel=0.01)
        return
    said = f"expected: {side_m * 1000:.1f} mm"
    words = rf"marker is (59|60)\.\d mm wide, {said}.*--marker-side.*height"
    follow(tracker, pictures[:20])
    with pytest.raises(InputError, match=words):
        follow(tracker, pictures[20:])


def test_pictures_of_another_size() -> None:
    tracker = Tracker(ARUCO, Scene().calibration(), "a film")
    with pytest.raises(InputError, match=r"640x480.*1280x720"):
        tracker.look(TimedImage(0, 0.0, np.zeros((480, 640), np.uint8)))


@pytest.mark.parametrize("kind", ["aruco", "apriltag"])
def test_anchors_elsewhere_mean_another_camera(kind: str) -> None:
    scene = Scene(marker=kind)  # type: ignore[arg-type]
    right = scene.calibration()
    assert len(right.anchors) >= 2
    marker = Marker(kind)  # type: ignore[arg-type]
    pictures = film(scene, even(12))
    assert all(place.frame for place in follow(Tracker(marker, right, "a film"), pictures))
    moved = replace(right, anchors={i: (u + 15, v - 4) for i, (u, v) in right.anchors.items()})
    with pytest.raises(
        InputError, match=r"in a film anchor 4. is . cm from its place at calibration"
    ):
        follow(Tracker(marker, moved, "a film"), pictures)


def test_the_led_stays_in_its_cell_while_the_fish_turns() -> None:
    """A bright dot on the fish, 19.5 cm behind its marker and 3.5 cm to the right of it."""
    scene = Scene()
    calibration = scene.calibration()
    behind_m, right_m = -0.195, 0.035
    row = math.floor((right_m + PATCH_HALF_WIDTH_M) / PATCH_CELL_M)
    column = math.floor((behind_m - PATCH_LEFT_M) / PATCH_CELL_M)
    for k, heading in enumerate(np.linspace(-math.pi, math.pi, 9)):
        truth = DrawnPose(0.0, 0.9 + 0.1 * k, 0.1 * (k - 4), float(heading), 0.0, 0.0)
        image = painter(scene).paint(truth, k)
        tracker = Tracker(ARUCO, calibration, "a film", patch=True)
        dark = tracker.look(TimedImage(0, 0.0, image)).patch
        ahead = np.array([math.cos(heading), math.sin(heading)])
        aside = np.array([-ahead[1], ahead[0]])
        dot = np.array([truth.x_m, truth.y_m]) + behind_m * ahead + right_m * aside
        (u, v) = np.rint(calibration.to_pixels(dot[None])[0]).astype(int)
        lit_image = image.copy()
        lit_image[v, u] = 255
        lit = tracker.look(TimedImage(1, 0.04, lit_image)).patch
        assert dark is not None
        assert lit is not None
        assert dark.shape == PATCH_SHAPE
        gain = lit.astype(int) - dark
        assert np.unravel_index(np.argmax(gain), PATCH_SHAPE) == (row, column)
        assert gain[row, column] > 40


def test_no_patch_unless_asked_for() -> None:
    scene = Scene()
    ((_, picture),) = film(scene, [0.0])
    assert Tracker(ARUCO, scene.calibration(), "a film").look(picture).patch is None


# From here on the detector says what it is told; the camera looks straight down, 4 mm a pixel.

PX_PER_M = 250.0


def straight_down() -> Calibration:
    matrix = np.array([[1 / PX_PER_M, 0, 0], [0, 1 / PX_PER_M, 0], [0, 0, 1.0]])
    return Calibration((800, 600), np.eye(3) * [1000, 1000, 1], np.zeros(5), matrix)


class Told:
    """Sees markers at the given places (m), where the window lets it."""

    def __init__(self) -> None:
        self.places: list[tuple[float, float]] = []
        self.windows: list[SearchWindow | None] = []

    def find(self, grey: Image, window: SearchWindow | None = None) -> list[Detection]:
        self.windows.append(window)
        pixels = [(x * PX_PER_M, y * PX_PER_M) for x, y in self.places]
        seen = [
            (u, v)
            for u, v in pixels
            if window is None
            or (window.left <= u < window.right and window.top <= v < window.bottom)
        ]
        return [Detection((u, v), (u + 7.5, v), 15.0, 1.0) for u, v in seen]


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> Told:
    detector = Told()
    monkeypatch.setattr(
        "tailbeat.sensors.camera.tracking.tracker.detector_for",
        lambda marker, calibration: detector,
    )
    return detector


NOTHING = np.zeros((600, 800), np.uint8)


def seen_at(tracker: Tracker, told: Told, t_s: float, *places: tuple[float, float]) -> float | None:
    told.places = list(places)
    frame = tracker.look(TimedImage(round(t_s * FPS), t_s, NOTHING)).frame
    return None if frame is None else frame.x_m


def test_looks_where_the_fish_should_be_and_everywhere_once_a_second(told: Told) -> None:
    tracker = Tracker(Marker(), straight_down(), "a film")
    times = even(60)
    for t in times:
        assert seen_at(tracker, told, t, (1 + 0.3 * t, 1)) == pytest.approx(1 + 0.3 * t)
    whole = [t for t, window in zip(times, told.windows, strict=True) if window is None]
    assert whole == [0.0, 1.0, 2.0]
    widest = max(w.right - w.left for w in told.windows if w is not None)
    assert widest < 80


def test_a_fish_that_was_lost_is_found_again_anywhere(told: Told) -> None:
    tracker = Tracker(Marker(), straight_down(), "a film")
    for t in even(10):
        seen_at(tracker, told, t, (1.0, 1.0))
    for t in even(25)[10:]:
        assert seen_at(tracker, told, t) is None
    assert seen_at(tracker, told, 1.0, (2.5, 0.4)) == pytest.approx(2.5)  # 0.64 s later
    assert seen_at(tracker, told, 1.04, (2.5, 0.4)) == pytest.approx(2.5)
    assert told.windows[-1] is not None


def test_a_fish_that_was_covered_for_a_moment_is_found_where_it_must_be(told: Told) -> None:
    tracker = Tracker(Marker(), straight_down(), "a film")
    for t in even(10):
        seen_at(tracker, told, t, (1 + 0.5 * t, 1.0))
    searches = len(told.windows)
    for t in even(13)[10:]:
        assert seen_at(tracker, told, t) is None
    assert seen_at(tracker, told, 0.52, (1.26, 1.0)) == pytest.approx(1.26)
    assert None not in told.windows[searches:]


def test_a_jump_is_not_believed_before_the_third_picture(told: Told) -> None:
    tracker = Tracker(Marker(), straight_down(), "a film")
    seen_at(tracker, told, 0.0, (1.0, 1.0))
    seen_at(tracker, told, 0.04, (1.0, 1.0))
    told_x = [seen_at(tracker, told, 0.04 * k, (1.5, 1.0)) for k in range(2, 12)]
    # For 0.2 s it is looked for nearby only; then it is seen afar, and believed the third time.
    assert told_x == [None] * 7 + [pytest.approx(1.5)] * 3


def test_one_picture_elsewhere_changes_nothing(told: Told) -> None:
    tracker = Tracker(Marker(), straight_down(), "a film")
    for k in range(25):
        assert seen_at(tracker, told, 0.04 * k, (1.0, 1.0)) == pytest.approx(1.0)
    assert seen_at(tracker, told, 1.0, (1.5, 1.0)) is None  # a search of the whole picture
    for k in range(26, 40):
        assert seen_at(tracker, told, 0.04 * k, (1.0, 1.0)) == pytest.approx(1.0)


def test_places_that_jump_about_are_never_believed(told: Told) -> None:
    tracker = Tracker(Marker(), straight_down(), "a film")
    seen_at(tracker, told, 0.0, (1.0, 1.0))
    for k in range(6, 12):
        assert seen_at(tracker, told, 0.04 * k, (1.5 + 0.4 * (k % 2), 1.0)) is None


def test_a_second_fish_in_two_pictures_only_is_none(told: Told) -> None:
    tracker = Tracker(Marker(), straight_down(), "a film")
    fish, other = (1.0, 1.0), (2.0, 2.0)
    assert seen_at(tracker, told, 0.0, fish, other) is not None
    assert seen_at(tracker, told, 0.04, fish, other) is not None
    assert seen_at(tracker, told, 0.08, fish) is not None
    assert told.windows == [None] * 3  # looked until sure
    seen_at(tracker, told, 0.12, fish)
    assert told.windows[-1] is not None


def test_the_heading_turns_clockwise_as_seen_from_above(told: Told) -> None:
    calibration = straight_down()
    tracker = Tracker(Marker(), calibration, "a film")
    told.places = [(1.0, 1.0)]
    down = Detection((250.0, 250.0), (250.0, 257.5), 15.0, 1.0)
    told.find = lambda grey, window=None: [down]  # type: ignore[method-assign]
    frame = tracker.look(TimedImage(0, 0.0, NOTHING)).frame
    assert frame is not None
    assert frame.heading_rad == pytest.approx(math.pi / 2)


# A fish without a marker.


def test_a_blob_is_seen_from_the_first_picture_on_and_swims_ahead() -> None:
    scene = Scene(marker="blob")
    pictures = film(scene, even(60))
    tracker = Tracker(Marker("blob"), scene.calibration(), "a film")
    places = follow(tracker, pictures)
    off = []
    for (truth, _), place in zip(pictures, places, strict=True):
        assert place.frame is not None
        assert abs(place.frame.heading_rad) < 0.3
        assert place.detection is not None
        assert 0 < place.detection.quality <= 0.5
        off.append((place.frame.x_m - truth.x_m, place.frame.y_m - truth.y_m))
    rms = np.std(off, axis=0)
    sys.stdout.write(f"blob: {1000 * rms[0]:.2f} mm along, {1000 * rms[1]:.2f} mm across\n")
    assert rms[0] < 4e-3
    assert rms[1] < 8e-3


def test_a_small_blobs_head_is_where_its_tail_is_not_and_its_heading_the_bodys() -> None:
    """Lies still at first, so that only its shape tells; 22 pixels wide, its tail wags by 0.4 rad
    against a body that turns by 0.1."""

    def wags(t_s: float) -> DrawnPose:
        wag = math.sin(2 * math.pi * t_s)
        return DrawnPose(t_s, 0.0, 0.05, 0.1 * wag, -0.4 * wag, 0.0)

    scene = Scene(marker="blob", size_px=(960, 540))
    tracker = Tracker(Marker("blob"), scene.calibration(), "a film")
    pictures = film(scene, even(25), wags)
    headings = []
    for place in follow(tracker, pictures):
        assert place.frame is not None
        headings.append(place.frame.heading_rad)
    true = np.array([truth.heading_rad for truth, _ in pictures])
    scale = float(true @ headings / (true @ true))
    rms = float(np.std(np.array(headings) - scale * true))
    sys.stdout.write(f"small blob: {scale:.3f} of the turns, RMS {rms:.4f} rad besides\n")
    assert scale == pytest.approx(1.0, abs=0.15)
    assert rms < 0.006


def test_a_blobs_patch_is_also_that_of_a_fish_the_other_way_round() -> None:
    scene = Scene(marker="blob")
    image = painter(scene).paint(replace(recorded(0.0), x_m=0.3, heading_rad=0.4), 0)
    tracker = Tracker(Marker("blob"), scene.calibration(), "a film", patch=True)
    place = tracker.look(TimedImage(0, 0.0, image))
    turned = place.turned()
    assert place.frame is not None and turned.frame is not None
    assert turned.frame.heading_rad - place.frame.heading_rad == pytest.approx(math.pi)
    assert place.patch is not None and turned.patch is not None
    assert (turned.patch == patch_around(image, turned.frame, scene.calibration())).all()
    # Both patches hold the water up to 15 cm around; there one is the other upside down.
    shared = round(2 * PATCH_RIGHT_M / PATCH_CELL_M)
    there, again = (
        turned.patch[:, -shared:].astype(int),
        place.patch[::-1, -shared:][:, ::-1],
    )
    assert np.abs(there - again).mean() < 5 < np.abs(there - place.patch[:, -shared:]).mean()
    assert turned.turned().patch is place.patch


def body(image: Image, u: float, v: float, ahead: int = 1) -> None:
    """A fish 80 pixels long: thick in front, thin behind."""
    cv2.ellipse(image, (round(u), round(v)), (26, 12), 0, 0, 360, (200,), -1, cv2.LINE_AA)
    tail = (round(u - ahead * 52), round(v))
    cv2.line(image, (round(u), round(v)), tail, (200,), 5, cv2.LINE_AA)


def test_a_blob_that_cannot_be_told_at_first_is_found_once_it_has_moved() -> None:
    """A stone of a fish's shape lies in the water: only what moves is the fish."""
    detector = BlobDetector(24.0)
    for k in range(140):
        image = np.full((480, 640), 90, np.uint8)
        body(image, 500, 100)
        body(image, 150 + max(0, k - 10) * 2, 300)
        found = detector.find(image)
        if k < 10:
            assert found == []
        if k > 60:
            (fish,) = found
            assert fish.centre_px[0] == pytest.approx(150 + (k - 10) * 2, abs=4)
            assert fish.centre_px[1] == pytest.approx(300, abs=2)
            assert fish.front_px[0] > fish.centre_px[0]


def test_two_blobs_that_move_are_two_fish() -> None:
    detector = BlobDetector(24.0)
    for k in range(80):
        image = np.full((480, 640), 90, np.uint8)
        body(image, 150 + 3 * k, 300)
        body(image, 150 + 3 * k, 100)
        found = detector.find(image)
    assert len(found) == 2


def test_a_blob_that_swims_tail_first_is_turned_around() -> None:
    detector = BlobDetector(24.0)
    for k in range(60):
        image = np.full((480, 640), 90, np.uint8)
        body(image, 400 - 3 * k, 300)
        (fish,) = detector.find(image)
        assert fish.turns == (fish.front_px[0] < fish.centre_px[0])
    assert fish.turns == 1
