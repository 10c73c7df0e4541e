"""Making a calibration, from pictures of known truth; and what is refused."""

from __future__ import annotations

import json
import math
import re
import shutil
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2 as opencv
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray
from typer.testing import CliRunner

from tailbeat.app.cli.app import app
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.sensors.camera.calibration.calibrate import (
    Calibrated,
    Height,
    Ruler,
    calibrate,
    check_scale,
    ruler_in,
)
from tailbeat.sensors.camera.calibration.file import load_calibration
from tailbeat.sensors.camera.calibration.intrinsics import View, Viewer, find_intrinsics
from tailbeat.sensors.camera.calibration.points import TankPoint, read_points, rectangle
from tailbeat.sensors.camera.marker.sheets import (
    PAPERS_MM,
    Sheet,
    anchors_sheet,
    board_sheet,
    figure,
    fish_sheet,
    ruler_sheet,
    write_sheet,
)
from tailbeat.sensors.camera.marker.tags import board, find_markers
from tailbeat.sensors.camera.source.open import read_all, read_grey

cv2: Any = opencv
Floats = F64
Image = NDArray[np.uint8]

SIZE = (1280, 720)
MATRIX = np.array([[1010.0, 0, 632.0], [0, 1005.0, 371.0], [0, 0, 1]])
LENS = np.array([-0.12, 0.03, 5e-4, -5e-4, 0.0])
CAMERA = np.array([1.5, 0.0, -2.6])  # over the tank: z is down
ANGLES = (0.02, -0.03, 0.01)
TANK = [(0.0, -0.75), (1.5, -0.7), (3.0, -0.75), (3.0, 0.75), (1.5, 0.78), (0.0, 0.75)]
AREA = rectangle([0.0, -0.8, 3.0, 0.8])


@dataclass(frozen=True)
class Truth:
    """A camera; what it sees is computed by OpenCV's forward model, which to_tank does not use."""

    matrix: Floats
    lens: Floats

    @property
    def turned(self) -> Floats:
        turn: Floats = cv2.Rodrigues(np.array(ANGLES))[0]
        return turn

    def pixels(self, places_m: Any, up_m: float = 0.0) -> Floats:
        """Of places x, y in the plane ``up_m`` above the tank's points."""
        places = np.asarray(places_m, dtype=float).reshape(-1, 2)
        solid = np.column_stack([places, np.full(len(places), -up_m)])
        shift = -self.turned @ CAMERA
        found: Floats = cv2.projectPoints(solid, np.array(ANGLES), shift, self.matrix, self.lens)[0]
        return found.reshape(-1, 2)

    def rays(self) -> Floats:
        """Of every pixel, (height, width, 2)."""
        u, v = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
        points = np.stack([u, v], -1).reshape(-1, 1, 2).astype(float)
        stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 20, 1e-4)
        found: Floats = cv2.undistortPoints(points, self.matrix, self.lens, None, None, None, stop)
        return found.reshape(SIZE[1], SIZE[0], 2)


TRUE = Truth(MATRIX, LENS)
RAYS = TRUE.rays()
NOISE = np.random.default_rng(1).normal(20, 2, SIZE[::-1]).clip(0, 40)
BARE: Image = (200 * 0.8 + NOISE).astype(np.uint8)


def picture(art: Image, per_unit: float, turned: Floats, shift: Floats) -> Image:
    """Of flat ``art`` (``per_unit`` pixels each unit, origin at its middle), turned and shifted
    into the camera's frame; a little blurred and noisy."""
    half = np.array(art.shape[1::-1]) / 2 / per_unit
    rim = np.concatenate([np.linspace(-1, 1, 9)[:, None] * half, [[-1, 1], [1, -1]] * half])
    rim = np.concatenate([rim, rim * (1, -1), half * [[1, 0], [-1, 0], [0, 1], [0, -1]]])
    solid = np.column_stack([rim, np.zeros(len(rim))]) @ turned.T + shift
    pixels = cv2.projectPoints(solid, np.zeros(3), np.zeros(3), MATRIX, LENS)[0].reshape(-1, 2)
    left, top = np.clip(pixels.min(axis=0) - 20, 0, SIZE).astype(int)
    right, bottom = np.clip(pixels.max(axis=0) + 20, 0, SIZE).astype(int)
    plane = np.linalg.inv(np.column_stack([turned[:, 0], turned[:, 1], shift]))
    hit = RAYS[top:bottom, left:right] @ plane[:, :2].T + plane[:, 2]
    at = hit[..., :2] / hit[..., 2:] * per_unit + (np.array(art.shape[1::-1]) - 1) / 2
    drawn = cv2.remap(art, at.astype(np.float32), None, cv2.INTER_LINEAR, borderValue=200)
    shot = BARE.copy()
    noise = NOISE[top:bottom, left:right]
    shot[top:bottom, left:right] = cv2.GaussianBlur(drawn, (0, 0), 0.6) * 0.8 + noise
    return shot


def board_pose(index: int, tilt: float) -> tuple[Floats, Floats]:
    """Turn (rotation vector) and middle of the board in one of nine parts of the picture."""
    rng = np.random.default_rng(100 + index)
    angles = rng.uniform(-1, 1, 3) * (tilt, tilt, 1.0)
    far = rng.uniform(11, 13)
    u = (index % 3 - 1) * 0.27 * SIZE[0] + SIZE[0] / 2
    v = (index // 3 % 3 - 1) * 0.20 * SIZE[1] + SIZE[1] / 2
    return angles, np.linalg.inv(MATRIX) @ (u, v, 1.0) * far


@cache
def board_picture(index: int, tilt: float = 0.45) -> Image:
    """The board in one of nine parts of the picture, tilted."""
    art = board().generateImage((6 * 50 + 50, 8 * 50 + 50), marginSize=25)
    angles, shift = board_pose(index, tilt)
    return picture(art, 50.0, cv2.Rodrigues(angles)[0], shift)


def tank_picture(markers: dict[int, tuple[float, float]]) -> Image:
    """The tank from above with ArUco markers of 120 mm."""
    per_m = 500.0
    art = np.full((1000, 1900), 150, np.uint8)
    words = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    for number, (x, y) in markers.items():
        u, v = ((np.array([x, y]) - (1.5, 0)) * per_m + (949.5, 499.5)).round(1)
        u, v = int(u + 0.5), int(v + 0.5)  # 60 px: its middle is half a pixel before
        art[v - 45 : v + 45, u - 45 : u + 45] = 255
        art[v - 30 : v + 30, u - 30 : u + 30] = cv2.aruco.generateImageMarker(words, number, 60)
    middle = TRUE.turned @ (np.array([1.5, 0.0, 0.0]) - CAMERA)
    return picture(art, per_m, TRUE.turned, middle)


MARKERS = dict(zip(range(40, 46), TANK, strict=True))
NO_TANK: Image = np.zeros((SIZE[1], SIZE[0]), np.uint8)


@pytest.fixture(autouse=True)
def _look_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same pictures of the board serve many tests."""

    def view(self: Viewer, name: str, grey: Image) -> View | str:
        key = (name, zlib.crc32(np.ascontiguousarray(grey)))
        if key not in LOOKED:
            LOOKED[key] = LOOK(self, name, grey)
        return LOOKED[key]

    def markers(image: Image, name: str) -> dict[int, tuple[float, float]]:
        key = zlib.crc32(np.ascontiguousarray(image))
        if key not in MARKERS_SEEN:
            MARKERS_SEEN[key] = find_markers(image, name)
        return MARKERS_SEEN[key]

    monkeypatch.setattr(Viewer, "view", view)
    monkeypatch.setattr("tailbeat.sensors.camera.calibration.calibrate.find_markers", markers)


LOOK, LOOKED = Viewer.view, dict[tuple[str, int], View | str]()
MARKERS_SEEN = dict[int, dict[int, tuple[float, float]]]()


def seen_as(view: View) -> tuple[str, Image]:
    """A picture in which the board is seen like that, without one to be looked through."""
    LOOKED[view.name, zlib.crc32(NO_TANK)] = view
    return view.name, NO_TANK


def board_view(index: int, tilt: float = 0.45, each: int = 1) -> View:
    """What ``board_picture`` shows (of ``each`` so many corners one), by OpenCV's forward model."""
    angles, shift = board_pose(index, tilt)
    plan = board().getChessboardCorners().astype(float)[::each]
    centred = plan - (3.0, 4.0, 0.0)
    pixels = cv2.projectPoints(centred, angles, shift, MATRIX, LENS)[0]
    rng = np.random.default_rng(index)
    pixels = (pixels + rng.normal(0, 0.05, pixels.shape)).astype(np.float32)
    return View(f"v{index}.png", plan.reshape(-1, 1, 3).astype(np.float32), pixels, 0.8)


def left_of(view: View, u_px: float) -> View:
    there = view.corners_px[:, 0, 0] < u_px
    return View(view.name, view.board_points[there], view.corners_px[there], view.blur_px)


@pytest.fixture(scope="module")
def boards() -> list[tuple[str, Image]]:
    return [(f"b{i}.png", board_picture(i)) for i in range(9)]


def points_by_hand(pixels: Floats, places: Any = TANK) -> list[TankPoint]:
    return [
        TankPoint(f"P{i}", (float(x), float(y)), (float(u), float(v)))
        for i, ((u, v), (x, y)) in enumerate(zip(pixels, places, strict=True))
    ]


def by_hand(pixels: Floats, places: Any = TANK, **more: Any) -> Calibrated:
    return calibrate(points_by_hand(pixels, places), ("tank.png", NO_TANK), **more)


def grid() -> Floats:
    x, y = np.meshgrid(np.linspace(0, 3, 16), np.linspace(-0.8, 0.8, 9))
    return np.column_stack([x.ravel(), y.ravel()])


def worst_mm(made: Calibrated, up_m: float = 0.0) -> float:
    there = made.calibration.to_tank(TRUE.pixels(grid(), up_m))
    return float(np.linalg.norm(there - grid(), axis=1).max() * 1e3)


def refused(words: str) -> Any:
    return pytest.raises(InputError, match=words)


# The whole way


@pytest.fixture(scope="module")
def made(boards: list[tuple[str, Image]]) -> Calibrated:
    points = [TankPoint(f"marker {i}", place, None, i) for i, place in MARKERS.items()]
    ruler_picture = tank_picture(MARKERS | {30: (0.9, 0.1), 31: (2.1, -0.3)})
    ruler = ruler_in(ruler_picture, "ruler.png", math.hypot(1.2, 0.4))
    return calibrate(
        points, ("tank.png", tank_picture(MARKERS)), boards, area_m=AREA, rulers=[ruler]
    )


def test_the_camera_is_found(made: Calibrated) -> None:
    found = made.intrinsics
    assert found is not None and len(found.used) == 9 and not found.dropped
    focal = found.camera_matrix[[0, 1], [0, 1]] / MATRIX[[0, 1], [0, 1]]
    assert np.abs(focal - 1).max() < 0.005
    assert np.abs(focal - 1).max() < 4 * found.focal_sigma
    assert found.rms_px < 0.4
    assert found.unseen == ()


def test_the_tank_is_right_within_a_millimetre(made: Calibrated) -> None:
    assert worst_mm(made) < 1.0
    assert made.plane.rms_m < 1e-3
    assert made.plane.predicted_m is not None and made.plane.predicted_m < 3e-3
    assert made.camera is not None
    assert made.camera.height_m == pytest.approx(2.6, rel=0.005)
    assert made.camera.foot_m == pytest.approx([1.5, 0.0], abs=0.02)


def test_what_goes_into_the_file(made: Calibrated, tmp_path: Path) -> None:
    found = made.calibration
    assert set(found.anchors) == set(range(40, 46))
    for number, place in found.anchors.items():
        assert np.hypot(*(TRUE.pixels(MARKERS[number])[0] - place)) < 0.2
    assert found.scale_error is not None and abs(found.scale_error) < 0.002
    assert abs(found.scale_error) < 4 * made.rulers[0].sigma
    assert made.mm_per_px == pytest.approx(2600 / 1010, rel=0.02)
    assert found.plane == "the marker swims in the plane of the points"
    assert made.notes == ()
    found.save(tmp_path / "tank.json")
    again = load_calibration(tmp_path / "tank.json")
    np.testing.assert_array_equal(
        again.to_tank(found.to_pixels(AREA)), found.to_tank(found.to_pixels(AREA))
    )


# The pictures of the board


def test_blurred_and_useless_pictures_are_dropped_by_name(boards: list[tuple[str, Image]]) -> None:
    shaken = cv2.filter2D(boards[4][1], -1, np.full((1, 9), 1 / 9, np.float32))
    corner = boards[0][1].copy()
    corner[:, 250:] = 200
    more = [("shaken.png", shaken), ("empty.png", NO_TANK), ("part.png", corner)]
    found = find_intrinsics([*boards, *more])
    assert set(found.dropped) == {"shaken.png", "empty.png", "part.png"}
    assert re.fullmatch(r"blurred \(\d\.\d px\)", found.dropped["shaken.png"])
    assert found.dropped["empty.png"] == "the board was not found"
    assert re.search("corners", found.dropped["part.png"])
    with refused(
        r"7 pictures of the board are of use, 8 are needed \(empty.png: the board was not"
    ):
        find_intrinsics([*boards[:7], *more[1:]])


def test_pictures_of_different_sizes(boards: list[tuple[str, Image]]) -> None:
    odd = ("odd.png", np.ascontiguousarray(boards[0][1].T))
    with refused(r"differ in size: odd.png has 720x1280, others 1280x720. Use pictures of one"):
        find_intrinsics([*boards[:2], odd])
    with refused("no pictures of the board"):
        find_intrinsics([])


def test_a_board_never_tilted_tells_no_focal_length() -> None:
    flat = [seen_as(board_view(i, tilt=0.0, each=3)) for i in range(8)]
    with refused(
        r"focal length cannot be determined .* held the same way .* \(0 are tilted\). Tilt"
    ):
        find_intrinsics(flat)


def test_a_zoom_between_the_pictures_is_refused() -> None:
    def zoomed(view: View) -> View:
        corners = view.corners_px * np.array([1.5, 1.15], np.float32) - np.array(
            [320, 54], np.float32
        )
        inside = ((corners[:, 0] > 0) & (corners[:, 0] < SIZE)).all(axis=1)
        return View(f"z{view.name}", view.board_points[inside], corners[inside], view.blur_px)

    views = [board_view(i, each=3) for i in range(9)]
    with refused(r"fit a camera only to \d+\.\d\d px \(at most 1\)"):
        find_intrinsics([seen_as(view) for view in [*views[:4], *map(zoomed, views[3:])]])


def test_parts_of_the_picture_without_the_board_are_named() -> None:
    indices = [i for i in range(14) if i % 3 < 2]
    left = [seen_as(left_of(board_view(i), 820)) for i in indices]
    made = by_hand(TRUE.pixels(TANK), board=left, area_m=AREA)
    assert made.intrinsics is not None
    assert {"upper right", "middle right", "lower right"} == set(made.intrinsics.unseen)
    assert any("was never in the upper right, " in note for note in made.notes)


# The tank's points


def test_points_without_a_board() -> None:
    straight = Truth(MATRIX, np.zeros(5))
    made = by_hand(straight.pixels(TANK), area_m=AREA)
    there = made.calibration.to_tank(straight.pixels(grid()))
    assert np.abs(there - grid()).max() < 1e-6
    assert made.calibration.rms_px is None
    assert any("taken to be free of distortion" in note for note in made.notes)
    assert any("scale was not checked" in note for note in made.notes)


def test_noise_of_the_points_is_told() -> None:
    """With n points each coordinate's residuals have 2 n - 8 of 2 n degrees of freedom."""
    straight = Truth(MATRIX, np.zeros(5))
    places = [(x, y) for x in np.linspace(0, 3, 6) for y in (-0.7, 0.0, 0.7)]
    rng = np.random.default_rng(5)
    measured = np.array(places) + rng.normal(0, 0.003, (18, 2))
    made = by_hand(straight.pixels(places), measured, area_m=AREA)
    expected = 0.003 * math.sqrt(2 * (36 - 8) / 36)
    assert made.plane.rms_m == pytest.approx(expected, rel=0.25)
    assert made.plane.predicted_m is not None and made.plane.predicted_m > made.plane.rms_m


def test_four_points_always_fit_and_that_is_said() -> None:
    four = [TANK[i] for i in (0, 2, 3, 5)]
    made = by_hand(TRUE.pixels(four), four)
    assert made.plane.rms_m < 1e-6 and made.plane.predicted_m is None
    assert any("four points always fit" in note for note in made.notes)
    area = made.calibration.area_m
    assert area is not None and len(area) == 4


def test_a_mistyped_point_among_six_is_left_out_by_name() -> None:
    straight = Truth(MATRIX, np.zeros(5))
    wrong = [*TANK[:3], (3.0, 0.57), *TANK[4:]]
    made = by_hand(straight.pixels(TANK), wrong)
    assert list(made.plane.left_out) == [3]
    assert made.plane.left_out[3] == pytest.approx(0.18, abs=1e-6)
    assert any(
        "P3 (3, 0.57 m) is 180 mm off the others and was left out" in note for note in made.notes
    )
    assert np.abs(made.calibration.to_tank(straight.pixels(grid())) - grid()).max() < 1e-6


def test_a_mistyped_point_among_five_is_refused() -> None:
    straight = Truth(MATRIX, np.zeros(5))
    five = [(0.0, -0.75), (3.0, -0.75), (3.0, 0.75), (0.0, 0.75), (1.5, 0.1)]
    wrong = [*five[:4], (1.5, 0.28)]
    with refused(
        r"points do not fit each other: \d+ mm off \(RMS\), worst P\d, \d+ mm. Check what"
    ):
        by_hand(straight.pixels(five), wrong)


ROUND = [(0.2, 0.0), (0.0, 0.2), (0.05, 0.0), (0.0, 0.05), (-0.1, 0.0), (0.0, -0.5)]


@pytest.mark.parametrize("off_m", ROUND)
def test_with_a_known_camera_the_wrong_point_is_the_one_left_out(
    true_camera: list[tuple[str, Image]], off_m: tuple[float, float]
) -> None:
    """Each of the six in turn, measured within 2 mm and found within 0.2 pixels."""
    rng = np.random.default_rng(7)
    for wrong in range(6):
        places = np.array(TANK) + rng.normal(0, 0.002, (6, 2))
        places[wrong] += off_m
        pixels = TRUE.pixels(TANK) + rng.normal(0, 0.2, (6, 2))
        made = by_hand(pixels, places, board=true_camera, rulers=stick(), area_m=AREA)
        assert list(made.plane.left_out) == [wrong]
        assert made.camera is not None and made.camera.rms_m < 0.006


def test_true_points_are_never_left_out(true_camera: list[tuple[str, Image]]) -> None:
    rng = np.random.default_rng(8)
    for _ in range(20):
        places = np.array(TANK) + rng.normal(0, 0.002, (6, 2))
        pixels = TRUE.pixels(TANK) + rng.normal(0, 0.2, (6, 2))
        made = by_hand(pixels, places, board=true_camera, area_m=AREA)
        assert not made.plane.left_out


def test_without_the_camera_a_point_that_may_be_another_is_not_left_out() -> None:
    """Five points leave a homography so free that two of the six could each be the wrong one."""
    straight = Truth(MATRIX, np.zeros(5))
    rng = np.random.default_rng(9)
    told = 0
    for k in range(36):
        wrong = k % 6
        places = np.array(TANK) + rng.normal(0, 0.002, (6, 2))
        places[wrong] += 0.2 * np.array([math.cos(k), math.sin(k)])
        try:
            made = by_hand(straight.pixels(TANK), places)
        except InputError as error:
            if "The wrong one is unknown" in str(error):
                told += 1
                assert re.search(r"unknown: P\d or P\d", str(error)) and f"P{wrong}" in str(error)
                assert "--board" in str(error)
            else:
                assert "do not fit each other" in str(error)
        else:
            assert list(made.plane.left_out) in ([wrong], [])
            assert made.plane.left_out or any("predicted" in note for note in made.notes)
    assert told > 3


def test_two_wrong_points_among_twelve_are_left_out(true_camera: list[tuple[str, Image]]) -> None:
    places = [(x, y) for x in (0.1, 1.0, 2.0, 2.9) for y in (-0.7, 0.0, 0.7)]
    typed = np.array(places)
    typed[[2, 7]] += [[0.1, 0.0], [0.0, -0.3]]
    for pictures in ([], true_camera):
        pixels = Truth(MATRIX, LENS if pictures else np.zeros(5)).pixels(places)
        assert set(by_hand(pixels, typed, board=pictures).plane.left_out) == {2, 7}


def test_a_wrong_point_among_five_is_not_blamed_on_the_camera(
    true_camera: list[tuple[str, Image]],
) -> None:
    five = [*FOUR, (1.4, 0.1)]
    typed = [*FOUR[:3], (0.0, 0.85), (1.4, 0.1)]
    with refused(
        "with the camera's intrinsics .* 29 mm off, .* P3 is wrong .without it the others"
    ):
        by_hand(TRUE.pixels(five), typed, board=true_camera)


@pytest.mark.parametrize("known", [False, True])
def test_centimetres(true_camera: list[tuple[str, Image]], known: bool) -> None:
    truth = TRUE if known else Truth(MATRIX, np.zeros(5))
    with refused(
        r"by the tank's points \(--points\) a pixel would be 2\d\d mm.*metres, not centimetres\?"
    ):
        by_hand(truth.pixels(TANK), np.array(TANK) * 100, board=true_camera if known else [])
    if known:
        with refused(r"the camera about 2\d m above them"):
            by_hand(truth.pixels(TANK), np.array(TANK) * 10, board=true_camera)


def test_a_lens_that_bends_lines_without_a_board_is_named() -> None:
    """What is foretold is told where no ruler is; a ruler's refusal names the pictures."""
    made = by_hand(TRUE.pixels(TANK), area_m=AREA)
    (note,) = [note for note in made.notes if "predicted" in note]
    assert re.search(
        r"only within \d\d mm \(good: below 10\): the lens bends lines \(--board", note
    )
    near = Ruler("r.png", TRUE.pixels([(0.0, -0.75), (0.0, 0.75)]), 1.45)
    with refused(r"r.png: the ruler of .*free of distortion: give pictures of the board \(--board"):
        by_hand(TRUE.pixels(TANK), rulers=[near])


FOUR = [TANK[i] for i in (0, 2, 3, 5)]


@pytest.mark.parametrize(
    ("places", "words"),
    [
        ([(0, 0), (1, 0), (2, 0), (3, 0)], "too many of them lie on one line or in one place"),
        ([(0, 0), (1, 0), (2, 0), (1, 0.7)], "too many of them lie on one line"),
        ([(0, 0), (0.001, 0), (0, 0.001), (3, 0.7)], "on one line or in one place"),
    ],
)
def test_points_that_tell_no_plane(places: list[tuple[float, float]], words: str) -> None:
    with refused(words):
        by_hand(TRUE.pixels(places), places)


@pytest.mark.parametrize(
    "places",
    [[(y, x) for x, y in FOUR], [(x, -y) for x, y in FOUR], [FOUR[i] for i in (1, 0, 2, 3)]],
)
def test_mirrored_and_swapped_points(places: list[tuple[float, float]]) -> None:
    with refused(r"mirrored. x and y are swapped, y is counted to the left, or two points"):
        by_hand(TRUE.pixels(FOUR), places)


def test_points_outside_the_picture() -> None:
    pixels = TRUE.pixels(FOUR)
    pixels[2] = (1300, 500)
    with refused(r"point at P2 is not in tank.png \(1280x720\). u counts to the right"):
        by_hand(pixels, FOUR)


TABLES = {
    "": "is no table of points. Its first line is u_px,v_px,x_m,y_m or id,x_m,y_m",
    "x,y\n1,2\n": "is no table of points",
    "id,x_m,y_m\n40,0,0\n41,1,0\n42,1,1\n": "has 3 points, 4 are needed",
    "id,x_m,y_m\n40,0,0\n41,one,0\n": "row 3, column x_m: 'one' is no finite number",
    "id,x_m,y_m\n40,0\n": "row 2, column y_m: '' is no finite number",
    "id,x_m,y_m\n40,0,nan\n": "row 2, column y_m: 'nan' is no finite number",
    "id,x_m,y_m\n40,0,2400\n": "row 2: 0, 2400 is not in a tank. x_m and y_m are metres",
    "id,x_m,y_m\n50,0,0\n": "50 is no marker's id",
    "id,x_m,y_m\n4.5,0,0\n": "4.5 is no marker's id",
    "id,x_m,y_m\n40,0,0\n40,1,0\n41,1,1\n42,0,1": "has marker 40 at 1, 0 m twice",
    "id,x_m,y_m\n40,0,0\n41,0,0\n42,1,1\n43,0,1": "has marker 41 at 0, 0 m twice",
    "\xff": "cannot read",
    "id;x_m;y_m\n40;0,0;-0,75\n": "has semicolons between its columns. Save it with commas",
}


@pytest.mark.parametrize("text", TABLES)
def test_tables_that_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "points.csv"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError) as caught:
        read_points(path)
    assert TABLES[text] in str(caught.value) and path.name in str(caught.value)
    with refused(r"cannot read .*none.csv \(No such file"):
        read_points(tmp_path / "none.csv")


def test_a_table_as_a_spreadsheet_writes_it(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_bytes(
        b"\xef\xbb\xbfu_px, v_px, x_m, y_m\r\n1,2,0,0\r\n\r\n3,4,1,0\r\n5,6,1,1\r\n7,8,0,1\r\n"
    )
    points = read_points(path)
    assert [p.pixel for p in points] == [(1, 2), (3, 4), (5, 6), (7, 8)]
    assert [p.place_m for p in points] == [(0, 0), (1, 0), (1, 1), (0, 1)]


def test_markers_that_are_not_seen() -> None:
    points = [TankPoint(f"marker {i}", place, None, i) for i, place in MARKERS.items()]
    shown = {i: MARKERS[i] for i in (40, 42, 43, 45)}
    picture_of_four = tank_picture(shown)
    made = calibrate(points, ("tank.png", picture_of_four))
    assert set(made.calibration.anchors) == set(shown)
    assert any("2 of the tank's markers were not seen" in note for note in made.notes)
    with refused(r"tank.png shows 0 of the 6 markers \(not: 40, 41, .*\), 4 are needed. Larger"):
        calibrate(points, ("tank.png", NO_TANK))
    with refused("tank.png shows marker 43 twice. Each id once"):
        twice = picture_of_four.copy()
        twice[300:430, 560:700] = twice[545:675, 1110:1250]
        calibrate(points, ("tank.png", twice))


# The height of the marker's plane

EXACT_BOARD = "the true camera, in place of one found from pictures"


@pytest.fixture
def true_camera(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[tuple[str, Image]]]:
    """Pictures of the board that tell the true camera."""
    from tailbeat.sensors.camera.calibration.intrinsics import Intrinsics

    found = Intrinsics(SIZE, MATRIX, LENS, 0.1, ("b.png",), {}, (), 1.0, 1e-3)
    monkeypatch.setattr(
        "tailbeat.sensors.camera.calibration.calibrate.find_intrinsics", lambda board, look: found
    )
    yield [("b.png", NO_TANK)]


@pytest.mark.parametrize("up_m", [0.3, 0.05, -0.3])
def test_a_marker_above_or_below_the_points(
    true_camera: list[tuple[str, Image]], up_m: float
) -> None:
    made = by_hand(TRUE.pixels(TANK), board=true_camera, height=Height(up_m), area_m=AREA)
    assert worst_mm(made, up_m) < 0.01
    where = "above" if up_m > 0 else "below"
    assert f"the marker's plane is {abs(up_m) * 1e3:.0f} mm {where} the points" in (
        made.calibration.plane
    )
    assert "camera 2.60 m above the points" in made.calibration.plane


def refracted(place: Floats, depth_m: float, surface_up_m: float = 0.0) -> Floats:
    """Where on the water's surface a place under it is seen through, by Fermat: light takes the
    quickest way."""
    from scipy.optimize import minimize_scalar

    foot, height = CAMERA[:2], -CAMERA[2] - surface_up_m
    reach = float(np.linalg.norm(place - foot))

    def time(s: float) -> float:
        return math.hypot(s, height) + 1.33 * math.hypot(reach - s, depth_m)

    best = minimize_scalar(time, bounds=(0, reach), method="bounded", options={"xatol": 1e-10})
    through: Floats = foot + (place - foot) * best.x / max(reach, 1e-12)
    return through


@pytest.mark.parametrize("surface_up_m", [0.0, -0.2])
def test_a_marker_under_water(
    true_camera: list[tuple[str, Image]], surface_up_m: float, tmp_path: Path
) -> None:
    """As right at the farthest corner as below the camera, and the way back, and from the file."""
    height = Height(surface_up_m, 0.25)
    made = by_hand(TRUE.pixels(TANK), board=true_camera, height=height, area_m=AREA)
    made.calibration.save(tmp_path / "tank.json")
    found = load_calibration(tmp_path / "tank.json")
    for place in ((0.0, -0.8), (1.7, 0.1), (3.0, 0.8), (0.0, 0.0)):
        through = refracted(np.array(place), 0.25, surface_up_m)
        pixel = TRUE.pixels(through, surface_up_m)
        there = found.to_tank(pixel)
        assert np.linalg.norm(there - place) < 1e-4
        np.testing.assert_allclose(found.to_pixels(there), pixel, atol=1e-3)
    flat = replace(found, refraction=None).to_tank(
        TRUE.pixels(refracted(np.array((0.0, -0.8)), 0.25, surface_up_m), surface_up_m)
    )
    assert np.linalg.norm(flat - (0.0, -0.8)) > 3e-3  # what it would be without
    assert "250 mm under water" in found.plane
    assert ("200 mm below the points" in found.plane) == (surface_up_m < 0)


def test_a_marker_deeper_than_the_camera_is_high(
    true_camera: list[tuple[str, Image]],
) -> None:
    with refused("a marker 3 m under water cannot be seen right by a camera 2.6"):
        by_hand(TRUE.pixels(TANK), board=true_camera, height=Height(0.0, 3.0), area_m=AREA)


def test_heights_that_cannot_be(true_camera: list[tuple[str, Image]]) -> None:
    pixels = TRUE.pixels(TANK)
    for height, option in ((Height(0.3), "--raise"), (Height(0.0, 0.2), "--depth")):
        with refused(f"{option} needs the camera's focal length.*Give pictures of the board"):
            by_hand(pixels, height=height)
    with refused(r"camera is 2.60 m above the points: a plane 2.70 m above them cannot be"):
        by_hand(pixels, board=true_camera, height=Height(2.7))
    with refused("a depth is not negative"):
        by_hand(pixels, board=true_camera, height=Height(0.0, -0.2))


def test_intrinsics_of_another_camera(true_camera: list[tuple[str, Image]]) -> None:
    """Points of a zoomed camera cannot be seen so by one whose focal length is known."""
    zoomed = Truth(np.diag([1.3, 1.1, 1.0]) @ MATRIX, LENS)
    with refused("pictures of the board are of another camera, zoom or setting, or points"):
        by_hand(
            zoomed.pixels(np.array(TANK) * 0.6 + (0.6, 0)),
            np.array(TANK) * 0.6 + (0.6, 0),
            board=true_camera,
        )


def test_a_picture_of_the_tank_in_another_size(true_camera: list[tuple[str, Image]]) -> None:
    points = points_by_hand(TRUE.pixels(TANK))
    small: Image = np.zeros((540, 960), np.uint8)
    with refused("tank.png has 960x540, the pictures of the board have 1280x720"):
        calibrate(points, ("tank.png", small), true_camera)


# The area


def test_areas() -> None:
    np.testing.assert_array_equal(rectangle([3.0, 1.8]), [[0, 0], [3, 0], [3, 1.8], [0, 1.8]])
    for wrong, words in (
        ([3.0], "is no area"),
        ([3.0, math.nan], "is no area"),
        ([1.0, 0.0, 0.0, 1.0], "area is empty"),
        ([3.0, -1.8], "area is empty"),
    ):
        with refused(words):
            rectangle(wrong)
    with refused(r"area \(--area\) lies beside the tank's points"):
        by_hand(TRUE.pixels(TANK), area_m=rectangle([5.0, 0.0, 8.0, 1.8]))
    for numbers, words in (
        ([300.0, 180.0], r"area \(--area\) is \S+ times as large as what the picture shows"),
        ([-1.0, -2.0, 0.0, 0.0], r"area \(--area\) lies beside the tank's points"),
        ([-3.0, -2.0, 6.0, 2.0], r"area \(--area\) is [4-6]\.\d+ times as large"),
    ):
        with refused(words):
            by_hand(TRUE.pixels(TANK), area_m=rectangle(numbers))
    for numbers in ([0.0, -0.75, 3.0, 0.75], [0.2, -0.6, 2.8, 0.6], [-0.5, -1.0, 3.5, 1.0]):
        by_hand(TRUE.pixels(TANK), area_m=rectangle(numbers))
    made = by_hand(TRUE.pixels(TANK))
    assert any("area is the hull" in note for note in made.notes)
    area = made.calibration.area_m
    assert area is not None and {tuple(corner) for corner in area} == set(TANK) - {TANK[1]}


# The ruler: a wrong calibration is caught

STICK = np.array([[0.7, -0.4], [2.1, 0.5]])
STICK_M = float(np.hypot(1.4, 0.9))


def stick(up_m: float = 0.0, truth: Truth = TRUE) -> list[Ruler]:
    return [Ruler("ruler.png", truth.pixels(STICK, up_m), STICK_M)]


def test_a_right_scale(true_camera: list[tuple[str, Image]]) -> None:
    made = by_hand(TRUE.pixels(TANK), board=true_camera, rulers=stick(), area_m=AREA)
    (check,) = made.rulers
    assert abs(check.scale_error) < 1e-6
    mm_px = 2600 / 1010
    assert check.sigma == pytest.approx(0.2 * math.sqrt(2) * mm_px / 1e3 / STICK_M, rel=0.15)
    assert made.calibration.scale_error == check.scale_error


@pytest.mark.parametrize(
    ("what", "error"),
    [("5 % in the points", "[+]5.0 %"), ("rim", "-1[0-9].[0-9] %"), ("zoom", "[+]10.[0-9] %")],
)
def test_a_wrong_scale_is_refused(
    true_camera: list[tuple[str, Image]], what: str, error: str
) -> None:
    """Points mistyped; points on the rim while the marker is 0.3 m lower; another zoom."""
    places = np.array(TANK) * (1.05 if what.startswith("5 %") else 1.0)
    rulers = stick(up_m=-0.3 if what == "rim" else 0.0)
    if what == "zoom":
        rulers = stick(truth=Truth(np.diag([1.1, 1.1, 1.0]) @ MATRIX, LENS))
        rulers = [Ruler(r.name, r.ends_px - (63, 37), r.true_m) for r in rulers]
    with refused(
        rf"ruler.png: the ruler of \S+ m measures \S+ m, {error} \(sigma 0.0 %, at most 1 %\). "
        "Is the ruler at the marker's height"
    ):
        by_hand(TRUE.pixels(TANK), places, board=true_camera, rulers=rulers)


def test_the_rim_is_right_once_its_height_is_told(true_camera: list[tuple[str, Image]]) -> None:
    made = by_hand(
        TRUE.pixels(TANK), board=true_camera, height=Height(-0.3), rulers=stick(-0.3), area_m=AREA
    )
    assert abs(made.rulers[0].scale_error) < 1e-6


def test_rulers_that_cannot_tell() -> None:
    found = by_hand(TRUE.pixels(TANK)).calibration
    short = TRUE.pixels([[1.5, 0.0], [1.6, 0.0]])
    with refused(r"too short in the picture to check by: 0.1 m within 0.8 %. Use one as long"):
        check_scale(found, [Ruler("r", short, 0.1)])
    with refused("a ruler of 0 m cannot be"):
        check_scale(found, [Ruler("r", TRUE.pixels(STICK), 0.0)])
    with refused("the ruler's ends are not in the picture of 1280x720"):
        check_scale(found, [Ruler("r", np.array([[0.0, 0.0], [1400.0, 0.0]]), 1.0)])
    with refused("r.png has pictures of 640x360, the calibration is for 1280x720: another camera"):
        check_scale(found, [Ruler("r.png", TRUE.pixels(STICK), 1.0, (640, 360))])
    with refused("stick.png does not show the ruler's marker 31. Lay the ruler flat"):
        ruler_in(tank_picture({30: (1.0, 0.0)}), "stick.png", 1.0)
    with refused("the ruler's markers 30 and 31"):
        ruler_in(NO_TANK, "stick.png", 1.0)


def test_a_camera_moved_before_the_ruler_was_laid(made: Calibrated) -> None:
    moved = {i: (u + 20, v) for i, (u, v) in made.calibration.anchors.items()}
    ruler = Ruler("later.png", TRUE.pixels(STICK), STICK_M, SIZE, moved)
    with refused("in later.png anchor 4. is . cm from its place at calibration"):
        check_scale(made.calibration, [ruler])


# The sheets


def rendered(sheet: Sheet, dpi: int = 100) -> tuple[Image, float]:
    """The page as a picture, and its pixels per millimetre."""
    page = figure(sheet)
    page.set_dpi(dpi)
    canvas = FigureCanvasAgg(page)
    canvas.draw()
    image = np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., 0])
    width, height = PAPERS_MM[sheet.paper]
    assert image.shape[1] == pytest.approx(width / 25.4 * dpi, abs=1)
    assert image.shape[0] == pytest.approx(height / 25.4 * dpi, abs=1)
    return image, dpi / 25.4


def sides_mm(image: Image, per_mm: float, family: int) -> dict[int, float]:
    settings = cv2.aruco.DetectorParameters()
    settings.minMarkerDistanceRate = 0.02
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(family), settings)
    corners, ids, _ = detector.detectMarkers(image)
    found = {}
    for four, number in zip(corners, np.ravel(ids), strict=True):
        box = four.reshape(4, 2)
        found[int(number)] = float(
            np.linalg.norm(np.roll(box, -1, 0) - box, axis=1).mean() / per_mm
        )
        assert box[0, 0] < box[1, 0] and box[0, 1] < box[3, 1]  # upright
    return found


@pytest.mark.parametrize("paper", ["a4", "a3", "letter"])
def test_the_printed_board_is_the_one_that_is_looked_for(paper: Any) -> None:
    image, per_mm = rendered(board_sheet(paper), 60)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board()).detectBoard(image)
    assert sorted(np.ravel(ids)) == list(range(35))
    square = float(re.search(r"squares of (\d+) mm", board_sheet(paper).text)[1])  # type: ignore[index]
    plan = np.array([[i % 5, i // 5] for i in np.ravel(ids)], dtype=float)
    at = corners.reshape(-1, 2) / per_mm
    assert np.abs(at - at[0] - (plan - plan[0]) * square).max() < 0.12


def test_printed_markers_are_found_and_of_the_right_size() -> None:
    image, per_mm = rendered(fish_sheet("aruco", 7, 60.0))
    assert sides_mm(image, per_mm, cv2.aruco.DICT_4X4_50) == {7: pytest.approx(60.0, abs=0.15)}
    image, per_mm = rendered(anchors_sheet(70.0))
    four = dict.fromkeys((40, 41, 42, 43), pytest.approx(70.0, abs=0.15))
    assert sides_mm(image, per_mm, cv2.aruco.DICT_4X4_50) == four
    image, per_mm = rendered(anchors_sheet(120.0, number=44))
    assert sides_mm(image, per_mm, cv2.aruco.DICT_4X4_50) == {44: pytest.approx(120.0, abs=0.15)}
    image, per_mm = rendered(ruler_sheet(50.0, "letter"))
    both = dict.fromkeys((30, 31), pytest.approx(50.0, abs=0.15))
    assert sides_mm(image, per_mm, cv2.aruco.DICT_4X4_50) == both
    assert not find_markers(rendered(board_sheet(), 60)[0], "board")


def test_the_printed_apriltag_by_another_library() -> None:
    library = pytest.importorskip("pupil_apriltags")
    image, per_mm = rendered(fish_sheet("apriltag", 5, 50.0))
    assert sides_mm(image, per_mm, cv2.aruco.DICT_APRILTAG_36H11) == {
        5: pytest.approx(50.0, abs=0.15)
    }
    (tag,) = library.Detector(families="tag36h11").detect(image)
    assert tag.tag_id == 5 and tag.hamming == 0
    edges = np.linalg.norm(np.roll(tag.corners, -1, 0) - tag.corners, axis=1)
    assert edges.mean() / per_mm == pytest.approx(50.0, abs=0.2)


@pytest.mark.painted
def test_pages_have_their_true_size(tmp_path: Path) -> None:
    for paper, (width, height) in PAPERS_MM.items():
        path = tmp_path / f"{paper}.pdf"
        write_sheet(ruler_sheet(paper=paper), path)
        box = re.search(rb"/MediaBox \[ ?0 0 (\S+) (\S+) ?\]", path.read_bytes())
        assert box is not None
        assert float(box[1]) / 72 * 25.4 == pytest.approx(width, abs=0.01)
        assert float(box[2]) / 72 * 25.4 == pytest.approx(height, abs=0.01)
    assert len(list(tmp_path.iterdir())) == 3


def test_sheets_that_cannot_be(tmp_path: Path) -> None:
    for number in (-1, 30, 40, 50):
        with refused(
            rf"cannot have aruco id {number}. Take one of 0 to 29 \(30 and up are the ruler's and "
            r"the tank's\)\."
        ):
            fish_sheet("aruco", number)
    with refused(r"cannot have apriltag id 587. Take one of 0 to 586\."):
        fish_sheet("apriltag", 587)
    for number in (39, 50):
        with refused(f"marker of the tank cannot have id {number}. Take one of 40 to 49"):
            anchors_sheet(number=number)
    with refused("a side of 9 mm is too small. At least 10 mm"):
        fish_sheet("aruco", 7, 9.0)
    with refused("a side of 100 mm is too large for a4 paper. At most 71 mm"):
        anchors_sheet(100.0)
    with refused("too small"):
        ruler_sheet(math.nan)
    with refused("neither .pdf nor .png"):
        write_sheet(ruler_sheet(), tmp_path / "ruler.doc")
    with refused(r"cannot write .*No such file"):
        write_sheet(ruler_sheet(), tmp_path / "none" / "ruler.pdf")


# Pictures from files


def test_a_film_gives_its_sharpest_pictures(tmp_path: Path) -> None:
    from tailbeat.sensors.camera.source.film import FilmWriter

    path = tmp_path / "board.mkv"
    sharp = board_picture(0)[::2, ::2]
    soft = cv2.GaussianBlur(sharp, (0, 0), 3.0)
    with FilmWriter(path, (640, 360), 25.0) as film:
        for i in range(62):  # parts of three: at most thirty parts
            film.add(sharp if i % 3 == 1 else soft, i / 25)
    got = list(read_all([path]))
    assert [name for name, _ in got] == [f"{path} at {i / 25:.1f} s" for i in range(1, 62, 3)]
    assert read_grey(path).shape == (360, 640)


def test_pictures_of_files_and_folders(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "b.png"), NO_TANK)
    cv2.imwrite(str(tmp_path / "ä.jpg"), NO_TANK)
    (tmp_path / "notes.txt").write_text("no picture")
    names = [Path(name).name for name, _ in read_all([tmp_path])]
    assert names == ["b.png", "ä.jpg"]
    assert read_grey(tmp_path / "ä.jpg").shape == (720, 1280)
    for name, words in (
        ("notes.txt", "notes.txt is no picture. Give a PNG or JPEG file, or a film"),
        ("none.png", "none.png cannot be read: No such file"),
        (".", "cannot be read"),
    ):
        with refused(words):
            read_grey(tmp_path / name)
    (tmp_path / "b.png").write_bytes((tmp_path / "b.png").read_bytes()[:50])
    with refused("is no picture"):
        read_grey(tmp_path / "b.png")
    (tmp_path / "empty").mkdir()
    with refused("empty holds no pictures"):
        list(read_all([tmp_path / "empty"]))


# The commands


def run(*words: Any) -> Any:
    return CliRunner().invoke(app, ["camera", *(str(word) for word in words)])


@pytest.fixture(scope="module")
def shots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("shots")
    rows = [f"{i},{x},{y}" for i, (x, y) in MARKERS.items()]
    (folder / "points.csv").write_text("\n".join(["id,x_m,y_m", *rows]))
    cv2.imwrite(str(folder / "tank.png"), tank_picture(MARKERS))
    cv2.imwrite(str(folder / "ruler.png"), tank_picture(MARKERS | ENDS))
    cv2.imwrite(str(folder / "b.png"), NO_TANK)
    return folder


ENDS = {30: (0.9, 0.1), 31: (2.1, -0.3)}


@pytest.fixture
def files(
    shots: Path,
    tmp_path: Path,
    true_camera: list[tuple[str, Image]],
    monkeypatch: pytest.MonkeyPatch,
) -> Path:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(shots, tmp_path, dirs_exist_ok=True)
    return tmp_path


LENGTH = math.hypot(1.2, 0.4)
GIVEN = ("--points", "points.csv", "--picture", "tank.png", "--board", "b.png")
RULER = ("--ruler", "ruler.png", "--ruler-length", LENGTH)


def test_the_command(files: Path) -> None:
    result = run(
        "calibrate", *GIVEN, *RULER, "--area", "0,-0.8,3,0.8", "--camera", "ours", "--json"
    )
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert abs(told["scale_error"]) < 0.002 and told["plane_rms_m"] < 1e-3
    assert told["mm_per_px"] == pytest.approx(2.57, rel=0.02)
    assert told["camera_height_m"] == pytest.approx(2.6, rel=0.005)
    assert told["rulers"][0]["sigma"] < 0.001 and told["notes"] == []
    found = load_calibration(files / "tank.json")
    assert found.camera == "ours" and re.match(r"20\d\d-\d\d-\d\dT", found.made_at)
    assert found.scale_error == told["scale_error"]
    text = run("calibrate", *GIVEN, *RULER, "--area", "0,-0.8,3,0.8", "--out", "again.json").stdout
    assert "ruler      1.26491 m measures 1.26" in text and "written    again.json" in text
    assert "1280x720; 1 pictures of the board, 0.10 px RMS" in text
    again = load_calibration(files / "again.json")
    np.testing.assert_array_equal(again.tank_from_image, found.tank_from_image)


def test_check_writes_nothing(files: Path) -> None:
    run("calibrate", *GIVEN)
    before = {path: path.read_bytes() for path in files.iterdir()}
    told = json.loads(run("calibrate", "--check", "tank.json", *RULER, "--json").stdout)
    assert abs(told["rulers"][0]["scale_error"]) < 0.002
    u1, v1, u2, v2 = TRUE.pixels([[0.9, 0.1], [2.1, -0.3]]).ravel()
    by_points = ("--ruler-points", f"{u1},{v1},{u2},{v2}", "--ruler-length", LENGTH)
    result = run("calibrate", "--check", "tank.json", *by_points)
    assert result.stdout.startswith("ruler      1.26491 m measures 1.26"), result.output
    wrong = run("calibrate", "--check", "tank.json", *by_points[:2], "--ruler-length", 1.2)
    assert isinstance(wrong.exception, InputError)
    assert "measures 1.26" in str(wrong.exception) and "+5.4 %" in str(wrong.exception)
    assert {path: path.read_bytes() for path in files.iterdir()} == before


def test_a_refused_calibration_leaves_the_old_file(files: Path) -> None:
    run("calibrate", *GIVEN)
    before = (files / "tank.json").read_bytes()
    result = run("calibrate", *GIVEN, "--ruler", "ruler.png", "--ruler-length", 1.2)
    assert isinstance(result.exception, InputError) and "+5.4 %" in str(result.exception)
    result = run("calibrate", *GIVEN, *RULER, "--raise", "0.3")
    assert isinstance(result.exception, InputError)
    assert (files / "tank.json").read_bytes() == before
    assert not list(files.glob("*.part"))


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "give --points CSV and --picture FILE"),
        (("--check", "tank.json"), "what to check it by?"),
        (("--check", "tank.json", "--points", "points.csv", *RULER), "goes with --ruler only"),
        ((*GIVEN, "--ruler", "ruler.png"), "how long is the ruler?"),
        ((*GIVEN, "--area", "big"), "are no numbers"),
        ((*GIVEN, "--ruler-points", "1,2,3", "--ruler-length", "1"), "four numbers"),
    ],
)
def test_words_that_do_not_go_together(files: Path, words: tuple[Any, ...], told: str) -> None:
    result = run("calibrate", *words)
    assert result.exit_code == 2
    assert told in " ".join(re.sub(r"[│╭╰─╮╯]", " ", result.stderr).split())
    assert not (files / "tank.json").exists()


@pytest.mark.painted
def test_print(files: Path) -> None:
    told = json.loads(run("print", "marker", "--id", 9, "--side", 40, "--json").stdout)
    assert told["file"] == "marker.pdf" and "id 9, black square 40 mm" in told["text"]
    assert (files / "marker.pdf").read_bytes().startswith(b"%PDF")
    result = run("print", "ruler", "--paper", "letter", "--out", "ends.png")
    assert result.stdout.startswith("ends.png: Ends of the ruler.")
    assert read_grey(files / "ends.png").shape == (3300, 2550)
    assert isinstance(run("print", "marker", "--id", 41).exception, InputError)
    assert run("print", "anchors", "--id", 44, "--out", "44.pdf").exit_code == 0


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("foo",), "'foo' is not one of 'board', 'marker', 'anchors', 'ruler'"),
        (("board", "--side", "30"), "--side does not apply to the sheet 'board'"),
        (("anchors", "--kind", "aruco"), "--kind does not apply to the sheet 'anchors'"),
        (("ruler", "--id", "7"), "--id does not apply to the sheet 'ruler'"),
    ],
)
def test_print_options_that_do_not_apply(files: Path, words: tuple[str, ...], told: str) -> None:
    result = run("print", *words)
    assert result.exit_code == 2
    assert told in " ".join(re.sub(r"[│╭╰─╮╯]", " ", result.stderr).split())
    assert not list(files.glob("*.pdf"))
