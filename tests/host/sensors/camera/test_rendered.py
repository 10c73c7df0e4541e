"""The simulated tank as its camera sees it: where things are drawn, and what may disturb them."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.app.exercise import Exercise, ExerciseOptions, make_exercise
from tailbeat.core import reference
from tailbeat.core.errors import InputError
from tailbeat.core.trial_file import read_trial
from tailbeat.sensors.camera.calibration.file import Calibration, load_calibration
from tailbeat.sensors.camera.marker.detector import Marker
from tailbeat.sensors.camera.render.painter import DrawnPose, Painter
from tailbeat.sensors.camera.render.scene import Optics, Scene
from tailbeat.sensors.camera.render.source import RenderedDevice, SimulatedCamera
from tailbeat.sensors.camera.render.sprites import Body, Canvas, stamp
from tailbeat.sensors.camera.source.film import Film
from tailbeat.sensors.camera.source.picture import Image
from tailbeat.sensors.camera.sync import sync, sync_by_yaw
from tailbeat.sensors.camera.tracking.track import track
from tailbeat.sim.board import SimBoard
from tailbeat.sim.world import CameraFrame

cv2 = pytest.importorskip("cv2")

SEED = 5
CLEAN = Scene(pixel_noise=0, ripples=0)
CLOSE = replace(CLEAN, tank_m=(1.2, 0.7), height_m=1.0)  # the marker has 54 pixels
SMALL = replace(CLEAN, size_px=(640, 360))
HERE = DrawnPose(time_s=3.0, x_m=0.8, y_m=0.1, heading_rad=0.15, tail_rad=0.0, led=0.0)


@pytest.fixture(scope="module")
def clean() -> Painter:
    return Painter(CLEAN)


@pytest.fixture(scope="module")
def small() -> Painter:
    return Painter(SMALL)


def random_places(count: int) -> list[DrawnPose]:
    chances = np.random.default_rng(SEED)
    low, high = (0.0, -0.3, -0.7, -math.pi, -0.8), (40.0, 2.3, 0.7, math.pi, 0.8)
    drawn = chances.uniform(low, high, (count, 5))
    return [DrawnPose(*map(float, row), led=0.0) for row in drawn]


def detected(image: Image, dictionary: int = cv2.aruco.DICT_4X4_50) -> list[tuple[int, Any]]:
    """OpenCV's own: ids with corners (4, 2), clockwise from the print's top left."""
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    settings.cornerRefinementWinSize = 3
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(dictionary), settings)
    corners, ids, _ = detector.detectMarkers(image)
    numbers = [] if ids is None else ids.ravel().tolist()
    return [(number, c[0].astype(float)) for number, c in zip(numbers, corners, strict=True)]


def fish_in(image: Image, number: int = 7) -> list[Any]:
    return [corners for found, corners in detected(image) if found == number]


def around(scene: Scene, truth: DrawnPose, ahead_m: float, aside_m: float = 0.0) -> tuple[int, int]:
    """The pixel (v, u) so far from the marker, in the fish's own directions."""
    c, s = math.cos(truth.heading_rad), math.sin(truth.heading_rad)
    place = truth.x_m + c * ahead_m - s * aside_m, truth.y_m + s * ahead_m + c * aside_m
    u, v = np.rint(scene.calibration().to_pixels(np.array([place])))[0].astype(int)
    return v, u


def test_a_dot_is_drawn_where_the_calibration_says() -> None:
    optics, calibration = Optics(CLEAN), CLEAN.calibration()
    canvas = Canvas((-0.02, 0.02), 0.02, 1500)
    turns = np.linspace(0, 2 * np.pi, 60)
    canvas.fill(0.02 * np.c_[np.cos(turns), np.sin(turns)], 255)
    dot = canvas.sprite()
    v, u = np.mgrid[:720, :1280]
    for truth in random_places(40):
        place = truth.x_m, truth.y_m
        image = np.zeros((720, 1280), np.uint8)
        stamp(image, dot, [optics.near(place, truth.heading_rad, 0.04)], CLEAN.blur_px)
        light = image / image.sum(dtype=float)
        centroid = (u * light).sum(), (v * light).sum()
        assert centroid == pytest.approx(calibration.to_pixels(np.array([place]))[0], abs=0.05)


def test_opencv_finds_the_marker_where_it_is(clean: Painter) -> None:
    calibration = CLEAN.calibration()
    errors, turns, sides = [], [], []
    for index, truth in enumerate(random_places(40)):
        (corners,) = fish_in(clean.paint(truth, index))
        errors.append(
            corners.mean(axis=0) - calibration.to_pixels(np.array([[truth.x_m, truth.y_m]]))[0]
        )
        tank = calibration.to_tank(corners)
        along = tank[:2].mean(axis=0) - tank[2:].mean(axis=0)  # from the print's bottom to its top
        turns.append(np.arctan2(along[1], along[0]) - truth.heading_rad)
        sides.append(np.linalg.norm(np.diff(tank, axis=0), axis=1).mean())
    assert np.abs(np.mean(errors, axis=0)).max() < 0.1
    assert np.std(errors, axis=0).max() < 0.3  # that of OpenCV's corners, 3.5 pixels per square
    assert np.abs((np.array(turns) + np.pi) % (2 * np.pi) - np.pi).max() < 0.06
    assert np.mean(sides) == pytest.approx(CLEAN.marker_side_m, rel=0.03)


def test_a_closer_camera_leaves_opencv_no_error_to_hide_in() -> None:
    painter, calibration = Painter(CLOSE), CLOSE.calibration()
    errors = []
    for truth in random_places(12):
        near = replace(truth, x_m=0.1 + 0.3 * truth.x_m / 2.3, y_m=0.25 * truth.y_m)
        (corners,) = fish_in(painter.paint(near, 0))
        true = calibration.to_pixels(np.array([[near.x_m, near.y_m]]))[0]
        errors.append(corners.mean(axis=0) - true)
    assert np.abs(errors).max() < 0.15
    assert np.abs(np.mean(errors, axis=0)).max() < 0.05


def test_an_april_tag_is_one() -> None:
    image = Painter(replace(CLOSE, marker="apriltag")).paint(replace(HERE, x_m=0.1), 0)
    assert [number for number, _ in detected(image, cv2.aruco.DICT_APRILTAG_36h11)] == [7]


def test_distortion_within_the_marker_is_nearly_a_homography() -> None:
    optics = Optics(CLEAN)
    side_m = CLEAN.marker_side_m
    line = np.linspace(-side_m / 2, side_m / 2, 13)
    patch = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    worst_px = 0.0
    for x in np.linspace(-0.45, 2.45, 9):
        for y in np.linspace(-0.85, 0.85, 5):
            near = cv2.perspectiveTransform(patch[None], optics.near((x, y), 0.0, side_m))[0]
            worst_px = max(worst_px, np.abs(near - optics.pixels(np.add(patch, (x, y)))).max())
    assert worst_px < 0.02


def test_the_calibration_knows_walls_and_anchors(clean: Painter) -> None:
    calibration = CLEAN.calibration()
    area = calibration.area_m
    assert area is not None
    assert np.ptp(area, axis=0) == pytest.approx(CLEAN.tank_m)
    assert (area.min(axis=0)[0], calibration.scale_error) == (-0.5, 0.0)
    walls = calibration.to_pixels(area)
    assert (walls > 0).all() and (walls < CLEAN.size_px).all()
    seen = {number: c.mean(axis=0) for number, c in detected(clean.paint(HERE, 0))}
    assert sorted(seen) == [7, 40, 41, 42, 43]
    for number, place in calibration.anchors.items():
        assert seen[number] == pytest.approx(place, abs=0.5)
    assert "simulated" in calibration.plane


def test_the_same_picture_comes_again_whatever_was_drawn_before() -> None:
    scene = Scene(size_px=(640, 360), glare=0.4, hidden=0.5, fish=2)
    painter = Painter(scene)
    first = [painter.paint(replace(HERE, time_s=k / 25), k) for k in range(4)]
    again = [painter.paint(replace(HERE, time_s=k / 25), k) for k in (3, 2, 1, 0)]
    other = [Painter(scene).paint(replace(HERE, time_s=k / 25), k) for k in range(4)]
    assert [i.tobytes() for i in first] == [i.tobytes() for i in reversed(again)]
    assert [i.tobytes() for i in first] == [i.tobytes() for i in other]
    assert (painter.paint(HERE, 0) != painter.paint(HERE, 1)).any()
    assert (Painter(replace(scene, seed=2)).paint(HERE, 0) != painter.paint(HERE, 0)).any()


def test_noise_is_as_strong_as_it_is_said_to_be_and_new_in_each_picture(small: Painter) -> None:
    painter, plain = Painter(replace(SMALL, pixel_noise=3.0)), small.paint(HERE, 0).astype(float)
    one, other = (painter.paint(HERE, index) - plain for index in (4, 5))
    assert one.std() == pytest.approx(3.0, rel=0.03)
    assert abs(one.mean()) < 0.03
    assert abs(np.mean(one * other)) < 0.02 * one.var()


def test_the_led_is_seen_and_as_long_as_it_is_lit(clean: Painter) -> None:
    place = around(CLEAN, HERE, Body(CLEAN.marker_side_m).led_m)
    grey = [int(clean.paint(replace(HERE, led=led), 0)[place]) for led in (0.0, 0.5, 1.0)]
    assert grey[0] < 90 and grey[2] > 200
    assert grey[1] == pytest.approx((grey[0] + grey[2]) / 2, abs=3)
    blind = Painter(replace(CLEAN, led=False))
    assert (blind.paint(HERE, 0) == blind.paint(replace(HERE, led=1.0), 0)).all()


def test_the_tail_wags_to_the_right_side(clean: Painter) -> None:
    straight, right, left = (clean.paint(replace(HERE, tail_rad=a), 0) for a in (0.0, 0.5, -0.5))
    tip_m = 0.08  # from the hinge
    behind_m = Body(CLEAN.marker_side_m).hinge_m - tip_m * math.cos(0.5)
    for image, side in ((right, 1), (left, -1)):
        there = around(CLEAN, HERE, behind_m, side * tip_m * math.sin(0.5))
        across = around(CLEAN, HERE, behind_m, -side * tip_m * math.sin(0.5))
        assert int(image[there]) - int(straight[there]) > 25
        assert abs(int(image[across]) - int(straight[across])) < 3


def test_a_hidden_marker_is_not_found(clean: Painter) -> None:
    covered = Painter(replace(CLEAN, hidden=1.0))
    bare = clean.paint(HERE, 0)
    sides = set()
    assert fish_in(bare)
    for index in range(12):
        image = covered.paint(HERE, index)
        assert not fish_in(image)
        v, u = np.nonzero(image != bare)
        fish_v, fish_u = around(CLEAN, HERE, 0.0)
        sides.add(
            (np.sign(round((v.mean() - fish_v) / 3)), np.sign(round((u.mean() - fish_u) / 3)))
        )
    assert len(sides) > 2


def test_as_many_are_hidden_as_asked_for(small: Painter) -> None:
    part = Painter(replace(SMALL, hidden=0.3))
    plain = small.paint(HERE, 0)
    hidden = sum((part.paint(HERE, index) != plain).any() for index in range(200))
    assert 40 <= hidden <= 80


def test_glare_wanders_and_grows() -> None:
    def spot(glare: float, t_s: float) -> tuple[float, float, int]:
        image = Painter(replace(SMALL, glare=glare)).paint(replace(HERE, time_s=t_s), 0)
        v, u = np.nonzero(image == 255)
        return float(u.mean()), float(v.mean()), len(u)

    now, later, large = spot(0.5, 0.0), spot(0.5, 5.0), spot(1.0, 0.0)
    assert math.dist(now[:2], later[:2]) > 30
    assert large[2] > 3 * now[2] > 300
    assert not (Painter(SMALL).paint(HERE, 0) == 255).any()


def test_waves_move_on_the_water_only() -> None:
    scene = replace(SMALL, ripples=1.0)
    painter = Painter(scene)
    calm = Painter(SMALL).paint(HERE, 0)
    one, soon, late = (
        painter.paint(replace(HERE, time_s=t), 0).astype(int) for t in (3.0, 3.04, 9.0)
    )
    water = np.zeros(calm.shape, np.uint8)
    walls = scene.calibration().to_pixels(np.array(scene.walls_m(0.02)))
    cv2.fillConvexPoly(water, np.rint(walls).astype(np.int32), 1)
    assert (one[water == 0] == calm[water == 0]).all()
    assert 3 < (one - calm)[water == 1].mean() < 30
    assert np.abs(soon - one).mean() < 0.25 * np.abs(late - one).mean()


def test_a_second_fish_carries_the_same_marker() -> None:
    found = fish_in(Painter(replace(CLEAN, fish=2)).paint(HERE, 0))
    assert len(found) == 2
    places = [CLEAN.calibration().to_tank(c.mean(axis=0)[None])[0] for c in found]
    assert abs(places[0][1] - places[1][1]) > 0.3


def test_a_long_exposure_blurs_along_the_way_and_shifts_nothing() -> None:
    scene = replace(CLEAN, exposure_s=0.04)
    painter, calibration = Painter(scene), scene.calibration()
    truth = replace(HERE, heading_rad=0.0)
    moving = painter.paint(replace(truth, speed_m_s=0.3), 0)  # 4 pixels
    still = painter.paint(truth, 0)
    v, u = around(scene, truth, 0.0)
    steepest = [
        [int(np.abs(np.diff(image[v - 9 : v + 10, u - 25 : u + 25].astype(int), axis=axis)).max())
         for axis in (1, 0)]
        for image in (moving, still)
    ]  # fmt: skip
    assert steepest[0][0] < 0.6 * steepest[1][0]
    assert steepest[0][1] > 0.8 * steepest[1][1]
    (corners,) = fish_in(moving)
    true = calibration.to_pixels(np.array([[truth.x_m, truth.y_m]]))[0]
    assert corners.mean(axis=0) == pytest.approx(true, abs=0.3)
    turning = painter.paint(replace(truth, turn_rad_s=8.0), 0)
    assert (turning != still).any()


def test_a_simulated_board_is_a_device() -> None:
    board = SimBoard("tank", 3, camera_fps=25, camera_noise_m=0.002)
    device = RenderedDevice(SimulatedCamera(board), CLEAN)
    twin = SimBoard("tank", 3, camera_fps=25, camera_noise_m=0.002)
    assert (device.clock, device.fps, device.size_px) == ("host", 25.0, (1280, 720))
    assert board.watched and device.read() is None
    for each in (board, twin):
        each.run(0.6)
    now_s = board.time_s
    pictures = []
    while (picture := device.read()) is not None:
        pictures.append(picture)
    frames = twin.camera_frames()
    assert board.time_s == now_s and not device.ended
    assert [p.t_s for p in pictures] == [f.time_s for f in frames]
    assert [p.index for p in pictures] == list(range(len(frames))) and len(frames) > 10
    calibration = CLEAN.calibration()
    for picture, frame in zip(pictures, frames, strict=True):
        place = calibration.to_tank(fish_in(picture.image)[0].mean(axis=0)[None])[0]
        assert place == pytest.approx((frame.x_m, frame.y_m), abs=1e-3)
    device.close()
    device.close()
    assert not board.watched


def test_pictures_that_get_lost_are_counted() -> None:
    board = SimBoard("tank", 3, camera_fps=50, camera_lost=0.4)
    device = RenderedDevice(SimulatedCamera(board), SMALL)
    board.run(2.0)
    found = list(iter(device.read, None))
    indices = [picture.index for picture in found]
    assert 40 < len(found) < 80 and indices[-1] > 90
    assert indices == sorted(set(indices))
    assert [p.t_s for p in found] == pytest.approx([(i + 0.33) / 50 for i in indices], abs=1e-5)


def test_without_a_scene_the_exposure_is_the_boards() -> None:
    from tailbeat.sensors.camera.render.source import scene_of

    board = SimBoard("tank", 1, camera_exposure_s=0.004)
    assert scene_of(SimulatedCamera(board)) == Scene(exposure_s=0.004)


SWIM = ExerciseOptions(
    reference.trapezoid(0.06, 1, 2),
    replace(SMALL, pixel_noise=1.0),
    seed=4,
    before_s=1.0,
    overrides={"camera_lost": 0.1, "camera_noise_m": 0.0},
)


@pytest.fixture(scope="module")
def exercise(tmp_path_factory: pytest.TempPathFactory) -> Exercise:
    seen: list[float] = []
    folder = tmp_path_factory.mktemp("film")
    made = make_exercise(folder / "swim.mp4", SWIM, lambda done, _: seen.append(done))
    assert seen == sorted(seen) and seen[-1] == pytest.approx(1.0)
    return made


def truth_rows(path: Path) -> list[dict[str, float]]:
    with path.open(newline="") as file:
        return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]


def test_an_exercise_is_whole(exercise: Exercise) -> None:
    names = sorted(path.name for path in exercise.film.parent.iterdir())
    assert names == ["swim.mp4", "swim.tank.json", "swim.truth.csv", "swim.ulg"]
    trial = read_trial(exercise.trial_file)
    assert (trial.number, trial.end, trial.executed_beats, trial.problems) == (1, "complete", 4, [])
    assert np.isfinite(trial.slots.table()["turn_rad"][:40]).all()  # to pair film and trial by
    assert load_calibration(exercise.calibration).size_px == (640, 360)
    assert exercise.swim_begin_s == pytest.approx(1.0, abs=0.1)
    shot = exercise.pictures + exercise.lost
    assert shot == pytest.approx(25 * (1 + 4 + 2), abs=3) and 4 < exercise.lost < 40


def test_its_truth_is_that_of_the_film(exercise: Exercise) -> None:
    rows = truth_rows(exercise.truth)
    film = Film(exercise.film)
    painter = Painter(SWIM.scene)
    times = []
    for count, picture in enumerate(iter(film.read, None)):
        times.append(picture.t_s)
        row = rows[count]
        names = ("x_m", "y_m", "heading_rad", "tail_rad", "led")
        here = DrawnPose(picture.t_s, *(row[name] for name in names))
        difference = painter.paint(here, 0).astype(float) - picture.image
        assert np.abs(difference).mean() < 3
        v, u = around(SWIM.scene, here, 0.0)
        assert np.abs(difference[v - 8 : v + 9, u - 12 : u + 13]).mean() < 6
    assert times == pytest.approx([row["t_s"] for row in rows], abs=1e-4)


def test_its_true_speeds_agree_with_its_places(exercise: Exercise) -> None:
    rows = truth_rows(exercise.truth)
    t, x, speed = (np.array([row[name] for row in rows]) for name in ("t_s", "x_m", "speed_m_s"))
    edges = exercise.swim_begin_s + exercise.beat_s * np.arange(5)
    by_place = np.diff(np.interp(edges, t, x)) / exercise.beat_s
    assert by_place == pytest.approx(exercise.true_speed_m_s, abs=1e-4)
    assert exercise.true_speed_m_s.max() > 0.03
    for k, true in enumerate(exercise.true_speed_m_s):
        within = np.linspace(edges[k], edges[k + 1], 200)
        assert np.interp(within, t, speed).mean() == pytest.approx(true, abs=2e-3)
    lit = np.array([row["led"] for row in rows])[(t > edges[0]) & (t < edges[-1])]
    assert (lit > 0.9).any() and (lit < 0.1).any()


def test_an_exercise_that_is_broken_off_leaves_nothing(tmp_path: Path) -> None:
    def stop(done: float, text: str) -> None:
        if done > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_exercise(tmp_path / "swim.mp4", SWIM, stop)
    assert list(tmp_path.iterdir()) == []


def test_an_exercise_on_a_full_disk_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: Calibration, path: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Calibration, "save", full)
    with pytest.raises(OSError, match="No space"):
        make_exercise(tmp_path / "swim.mp4", SWIM)
    assert list(tmp_path.iterdir()) == []


def test_a_real_trials_log_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "swim.ulg").write_bytes(b"a real one")
    with pytest.raises(InputError, match="real trial"):
        make_exercise(tmp_path / "swim.mp4", SWIM)
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"a real one"]


@pytest.mark.soak
def test_a_fish_without_a_marker_is_paired_with_its_trial(tmp_path: Path) -> None:
    """Its film begins with seconds in which it hardly moves."""
    swim = replace(
        SWIM,
        reference=reference.trapezoid(0.05, 3, 4),
        scene=Scene(size_px=(960, 540), marker="blob"),
        seed=1,
        overrides={},
    )
    made = make_exercise(tmp_path / "swim.mp4", swim)
    calibration = load_calibration(made.calibration)
    found = track(Film(made.film), Marker("blob"), calibration, patch=True)
    headings = [row["heading_rad"] for row in truth_rows(made.truth)]
    assert np.abs(found.heading_rad - headings).max() < 0.05
    trial = read_trial(made.trial_file)
    begin = sync(found, trial)
    assert (begin.how, begin.trial) == ("led", 1)
    assert begin.start_s == pytest.approx(made.swim_begin_s, abs=0.01)
    by_yaw = sync_by_yaw(found, trial)
    assert by_yaw.start_s == pytest.approx(made.swim_begin_s, abs=0.02)


@pytest.mark.parametrize(
    ("name", "words"), [("none/swim.mp4", "there is no folder"), ("file/swim.mp4", "no folder")]
)
def test_a_film_without_its_folder_is_refused_before_the_swim(
    tmp_path: Path, name: str, words: str
) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=words) as caught:
        make_exercise(tmp_path / name, SWIM, lambda done, text: pytest.fail(text))
    assert str((tmp_path / name).parent) in str(caught.value)
    assert "rendering" not in str(caught.value)


def test_a_folder_that_may_not_be_written_to_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forbidden(*words: object, **more: object) -> str:
        raise PermissionError(13, "Permission denied", ".rendering-xyz")

    monkeypatch.setattr("tempfile.mkdtemp", forbidden)
    with pytest.raises(InputError, match=r"cannot write to .*Permission denied") as caught:
        make_exercise(tmp_path / "swim.mp4", SWIM)
    assert str(tmp_path) in str(caught.value)
    assert "rendering" not in str(caught.value)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["swim.avi"], "cannot write a film as swim.avi"),
        (["swim.mp4", "--marker", "dot"], "Invalid value for '--marker': 'dot' is not one of"),
        (["swim.mp4", "--size", "big"], "'big' is no size"),
        (
            ["swim.mp4", "--size", "10x10"],
            "no film is drawn of 10x10 pixels. Give a --size from",
        ),
        (["swim.mp4", "--reference", "fast"], "there is no reference 'fast'"),
    ],
)
def test_senseless_words_are_told_in_one_line(
    words: list[str],
    line: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from tailbeat.app.cli import run

    monkeypatch.chdir(tmp_path)
    assert run(["camera", "render", *words]) == (2 if "--marker" in words else 1)
    assert capsys.readouterr().err.startswith(f"tailbeat: {line}")
    assert list(tmp_path.iterdir()) == []


class Stream:
    """A simulator that runs on while one draws: a moment has come in at each look."""

    name, clock, fps, exposure_s = "tcp:here:1", "board", 25.0, 0.01

    def __init__(self) -> None:
        self.taken = 0
        self.closed = False

    def moments(self) -> list[CameraFrame]:
        come = 1 if self.taken else 50
        self.taken += come
        at = range(self.taken - come, self.taken)
        return [CameraFrame(0.04 * k, 0.001 * k, 0.0, 0.0) for k in at]

    def close(self) -> None:
        self.closed = True


def test_a_simulator_that_runs_on_is_drawn_as_far_as_there_is_time() -> None:
    stream = Stream()
    device = RenderedDevice(stream, SMALL)
    assert device.clock == "board"
    pictures = [device.read() for _ in range(6)]
    assert [picture is None for picture in pictures] == [False, True] * 3
    assert pictures[0] is not None and pictures[0].t_s > 1.7  # of two seconds that had piled up
    device.close()
    assert stream.closed
