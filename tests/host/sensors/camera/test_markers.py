"""Markers against pictures of known truth, against OpenCV's own corners and a second library.

Conventions of half pixels, as measured here: OpenCV and this package count pixel centres as whole
numbers, pupil-apriltags pixel edges, so its places are 0.5 higher in u and in v.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
import pytest

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.sensors.camera.marker.detector import Marker, detector_for
from tailbeat.sensors.camera.marker.tags import Detection, SearchWindow
from tailbeat.sensors.camera.source.picture import Image

Floats = F64

DICTIONARY = {"aruco": cv2.aruco.DICT_4X4_50, "apriltag": cv2.aruco.DICT_APRILTAG_36h11}
CELLS = {"aruco": 6, "apriltag": 8}
FINER = 6  # each pixel is the mean of that many squared
CELL_PX = 24  # of the marker before it is put into the picture
SIZE_PX = (112, 104)
SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
KINDS = ("aruco", "apriltag")


def homography(start: Floats, end: Floats) -> Floats:
    """From four points to four points, in double precision."""
    rows, values = [], []
    for (x, y), (u, v) in zip(start, end, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
        values += [u, v]
    return np.append(np.linalg.solve(np.array(rows), np.array(values)), 1.0).reshape(3, 3)


def mapped(matrix: Floats, x: float, y: float) -> Floats:
    point = matrix @ np.array([x, y, 1.0])
    return point[:2] / point[2]


def drawn(kind: str, number: int, corners: Floats, rng: np.random.Generator) -> Image:
    """The marker in a white margin on grey, blurred (0.6 px), with noise (2 of 255)."""
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARY[kind])
    side = CELLS[kind] * CELL_PX
    card = np.full((side + 2 * CELL_PX,) * 2, 95.0, np.float32)  # over the grey around it
    inner = slice(CELL_PX, CELL_PX + side)
    black_and_white = cv2.aruco.generateImageMarker(dictionary, number, side) / 255.0
    card[inner, inner] = -80 + 175 * black_and_white
    there = (SQUARE + 1) / 2 * side + CELL_PX - 0.5
    finer = np.array([[FINER, 0, FINER / 2 - 0.5], [0, FINER, FINER / 2 - 0.5], [0, 0, 1.0]])
    matrix = finer @ homography(there, corners)
    width, height = SIZE_PX
    fine = (width * FINER, height * FINER)
    picture = 120 + cv2.warpPerspective(card, matrix, fine, flags=cv2.INTER_LINEAR)
    picture = picture.reshape(height, FINER, width, FINER).mean(axis=(1, 3))
    picture = cv2.GaussianBlur(picture, (0, 0), 0.6) + rng.normal(0, 2, picture.shape)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def askew(rng: np.random.Generator, side_px: float) -> Floats:
    """Corners of a square seen from somewhere above, turned any way."""
    angle = rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    corners = SQUARE @ turn * side_px / 2
    corners = corners / (1 + corners @ rng.uniform(-0.06, 0.06, 2) / side_px)[:, None]
    return corners + np.array(SIZE_PX) / 2 + rng.uniform(-3, 3, 2)


def say(*words: object) -> None:
    """For whoever looks at a failure, or runs with -rP."""
    sys.stdout.write(" ".join(map(str, words)) + "\n")


def root_mean_square(off: list[Floats]) -> float:
    return float(np.sqrt((np.array(off) ** 2).sum(axis=-1).mean()))


def pictures(kind: str, side_px: float, count: int, seed: int) -> list[tuple[Floats, Image]]:
    say(f"{kind}, {side_px} px, seed {seed}")
    rng = np.random.default_rng(seed)
    truths = [askew(rng, side_px) for _ in range(count)]
    return [(corners, drawn(kind, 7, corners, rng)) for corners in truths]


def seen(kind: str, image: Image, window: SearchWindow | None = None) -> Detection:
    (detection,) = detector_for(Marker(kind)).find(image, window)  # type: ignore[arg-type]
    return detection


@pytest.mark.parametrize(
    ("side_px", "centre_rms", "corner_rms"), [(18, 0.05, 0.12), (40, 0.03, 0.04)]
)
@pytest.mark.parametrize("kind", KINDS)
def test_corners_centre_and_front_edge_are_where_they_were_drawn(
    kind: str, side_px: float, centre_rms: float, corner_rms: float
) -> None:
    centres, fronts, corners, sides = [], [], [], []
    for truth, image in pictures(kind, side_px, 24, seed=11):
        detection = seen(kind, image)
        matrix = homography(SQUARE, truth)
        centres.append(detection.centre_px - mapped(matrix, 0, 0))
        fronts.append(detection.front_px - mapped(matrix, 0, -1))
        assert detection.corners_px is not None
        corners.append(detection.corners_px - truth)
        sides.append(
            detection.side_px / np.linalg.norm(np.roll(truth, -1, 0) - truth, axis=1).mean()
        )
    rms = {"centre": root_mean_square(centres), "front": root_mean_square(fronts)}
    rms["corner"] = root_mean_square(corners)
    say({name: f"{value:.3f} px" for name, value in rms.items()}, np.mean(centres, axis=0))
    assert rms["centre"] < centre_rms
    assert rms["front"] < corner_rms
    assert rms["corner"] < corner_rms
    assert np.abs(centres).max() < 0.1
    assert np.abs(np.mean(centres, axis=0)).max() < 0.02
    assert np.mean(sides) == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize("kind", KINDS)
def test_corners_are_better_than_what_opencv_would_refine(kind: str) -> None:
    ours, theirs = [], {"NONE": [], "SUBPIX": [], "CONTOUR": [], "APRILTAG": []}
    for truth, image in pictures(kind, 26, 20, seed=5):
        middle = mapped(homography(SQUARE, truth), 0, 0)
        ours.append(seen(kind, image).centre_px - middle)
        for name, centres in theirs.items():
            found = opencv_corners(kind, image, getattr(cv2.aruco, f"CORNER_REFINE_{name}"))
            if found is not None:
                centres.append(mapped(homography(SQUARE, found), 0, 0) - middle)
    rms = {name: root_mean_square(off) for name, off in theirs.items()}
    mine = root_mean_square(ours)
    say(kind, f"ours {mine:.3f} px,", {name: f"{value:.3f} px" for name, value in rms.items()})
    assert mine < 0.5 * min(rms.values())


def opencv_corners(kind: str, image: Image, refinement: int) -> Floats | None:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = refinement
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARY[kind])
    found, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(image)
    if not found:
        return None
    return np.asarray(found[list(ids.ravel()).index(7)][0], dtype=float)


@pytest.mark.parametrize("kind", KINDS)
def test_opencv_in_the_whole_picture_agrees_with_the_window(kind: str) -> None:
    rng = np.random.default_rng(3)
    wide = np.full((480, 640), 120, np.uint8)
    corners = askew(rng, 48)
    left, top = 301, 199
    wide[top : top + SIZE_PX[1], left : left + SIZE_PX[0]] = drawn(kind, 7, corners, rng)
    window = SearchWindow(left + 3, top + 2, left + SIZE_PX[0] - 5, top + SIZE_PX[1])
    whole, part = seen(kind, wide), seen(kind, wide, window)
    assert part.centre_px == pytest.approx(whole.centre_px, abs=0.01)
    assert part.corners_px == pytest.approx(whole.corners_px, abs=0.02)
    theirs = opencv_corners(kind, wide, cv2.aruco.CORNER_REFINE_SUBPIX)
    assert theirs is not None
    assert np.abs(theirs - part.corners_px).max() < 1.0  # front left first, clockwise, as OpenCV
    away = SearchWindow(0, 0, 200, 200)
    assert detector_for(Marker(kind)).find(wide, away) == []  # type: ignore[arg-type]


@pytest.fixture
def detect() -> Iterator[Callable[..., list[Any]]]:
    """The second library's own detector."""
    library = pytest.importorskip(
        "pupil_apriltags", reason="pupil-apriltags is built for Python before 3.14 only"
    )
    detector = library.Detector(families="tag36h11", nthreads=1, quad_decimate=1.0)
    yield detector.detect
    # Its destructor frees the family first and then once more with the detector.
    detector.tag_detector_ptr = None


@pytest.mark.parametrize("side_px", [26, 48])
def test_a_second_library_finds_the_same_centres(
    side_px: float, detect: Callable[..., list[Any]]
) -> None:
    apart, theirs_off = [], []
    for truth, image in pictures("apriltag", side_px, 20, seed=21):
        (theirs,) = detect(image)
        assert theirs.tag_id == 7
        apart.append(theirs.center - 0.5 - seen("apriltag", image).centre_px)
        theirs_off.append(theirs.center - 0.5 - mapped(homography(SQUARE, truth), 0, 0))
    say(f"apart {root_mean_square(apart):.3f} px, theirs off by {root_mean_square(theirs_off):.3f}")
    assert np.abs(np.mean(theirs_off, axis=0)).max() < 0.02  # the half pixel is a half
    assert np.linalg.norm(np.median(apart, axis=0)) < 0.02
    assert root_mean_square(apart) < 0.1


FOCAL_PX, TAG_M, DEPTH_M = 900.0, 0.06, 1.1
CAMERA = np.array([[FOCAL_PX, 0, 56], [0, FOCAL_PX, 52], [0, 0, 1.0]])


def projected(turn: Floats, shift: Floats) -> Floats:
    """The pictures of a tag's corners, front left first, and of its centre."""
    points = np.vstack([SQUARE, np.zeros(2)]) * TAG_M / 2
    seen_from_camera = np.column_stack([points, np.zeros(5)]) @ turn.T + shift.ravel()
    pixels = seen_from_camera @ CAMERA.T
    return np.asarray(pixels[:, :2] / pixels[:, 2:])


def test_a_second_library_finds_the_same_pose(detect: Callable[..., list[Any]]) -> None:
    """A tag in space before a pinhole camera: its pose by OpenCV from our corners, by the other
    library from its own, and the true one, all projected again."""
    rng = np.random.default_rng(33)
    upside = np.diag([1.0, -1.0, -1.0])  # OpenCV wants y up for IPPE_SQUARE
    apart, ours_off = [], []
    for _ in range(15):
        tilt, heading = rng.uniform(-0.4, 0.4, 2), rng.uniform(-np.pi, np.pi)
        turn = cv2.Rodrigues(np.append(tilt, 0.0))[0] @ cv2.Rodrigues(np.array([0, 0, heading]))[0]
        truth = projected(turn, np.append(rng.uniform(-0.004, 0.004, 2), DEPTH_M))
        image = drawn("apriltag", 7, truth[:4], rng)
        corners = seen("apriltag", image).corners_px
        up = np.column_stack([SQUARE * [1, -1], np.zeros(4)]) * TAG_M / 2
        _, by_us, shift = cv2.solvePnP(up, corners, CAMERA, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
        ours = projected(cv2.Rodrigues(by_us)[0] @ upside, shift)
        (found,) = detect(
            image,
            estimate_tag_pose=True,
            camera_params=(FOCAL_PX, FOCAL_PX, CAMERA[0, 2] + 0.5, CAMERA[1, 2] + 0.5),
            tag_size=TAG_M,
        )
        # Its tag stands on its head against OpenCV's.
        theirs = projected(found.pose_R @ np.diag([-1.0, -1.0, 1.0]), found.pose_t)
        apart.append(theirs - ours)
        ours_off.append(ours - truth)
    for name, off in (("apart", apart), ("ours from the truth", ours_off)):
        away = np.linalg.norm(off, axis=2)
        say(name, f"corners {away[:, :4].max():.3f} px at most, centre {away[:, 4].max():.3f}")
    assert np.linalg.norm(apart, axis=2)[:, 4].max() < 0.1
    assert root_mean_square([each[:4] for each in apart]) < 0.1
    assert np.linalg.norm(ours_off, axis=2).max() < 0.1


def test_quality_falls_with_size_contrast_and_sharpness() -> None:
    (_, sharp), (_, small) = pictures("aruco", 40, 1, 1)[0], pictures("aruco", 17, 1, 1)[0]
    pale = np.asarray(120 + (sharp.astype(float) - 120) * 0.25, np.uint8)
    good = seen("aruco", sharp).quality
    assert 0.9 < good <= 1
    assert 0 < seen("aruco", small).quality < 0.7
    assert 0 < seen("aruco", pale).quality < 0.7


def test_only_the_wanted_marker_is_the_fish() -> None:
    rng = np.random.default_rng(2)
    fish, anchor = drawn("aruco", 7, askew(rng, 40), rng), drawn("aruco", 41, askew(rng, 40), rng)
    both = np.hstack([fish, anchor])
    assert len(detector_for(Marker()).find(both)) == 1
    assert len(detector_for(Marker(id=7)).find(both)) == 1
    other = detector_for(Marker(id=3))
    assert other.find(both) == []
    assert other.other_ids == {7, 41}  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("marker", "words"),
    [
        (Marker("aruco", 40), "no marker 40.*0 to 39.*the tank's"),
        (Marker("aruco", -1), "no marker -1"),
        (Marker("apriltag", 587), "no marker 587.*0 to 586"),
        (Marker("aruco", 1, 0.0), "0 mm wide makes no sense"),
        (Marker("aruco", 1, 60.0), "60000 mm wide makes no sense"),
    ],
)
def test_markers_that_do_not_exist(marker: Marker, words: str) -> None:
    with pytest.raises(InputError, match=words):
        detector_for(marker)


def test_every_id_that_can_be_the_fishs() -> None:
    for marker in (Marker("aruco", 39), Marker("apriltag", 586), Marker("apriltag", 45)):
        detector_for(marker)
