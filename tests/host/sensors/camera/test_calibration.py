"""From pixels to metres and back, and what is no calibration."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.sensors.camera.calibration.file import Calibration, check_sense, load_calibration

Floats = F64

SIZE = (1280, 720)
HEIGHT_M = 2.6


def rotation(tilt: float, pan: float, turn: float) -> Floats:
    """From the tank's frame (x forward, y right, z down) to the camera's."""
    cx, sx, cy, sy = math.cos(tilt), math.sin(tilt), math.cos(pan), math.sin(pan)
    cz, sz = math.cos(turn), math.sin(turn)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    product: Floats = about_x @ about_y @ about_z
    return product


def seen(points_m: Floats, matrix: Floats, lens: Floats, turned: Floats, at: Floats) -> Floats:
    """Pixels of places in the plane z = 0, by the formulas of the lens model."""
    solid = np.column_stack([points_m, np.zeros(len(points_m))])
    x, y, z = turned @ (solid - at).T
    x, y = x / z, y / z
    k1, k2, p1, p2, k3 = lens
    s = x * x + y * y
    radial = 1 + k1 * s + k2 * s**2 + k3 * s**3
    bent = (
        x * radial + 2 * p1 * x * y + p2 * (s + 2 * x * x),
        y * radial + p1 * (s + 2 * y * y) + 2 * p2 * x * y,
    )
    pixels: Floats = np.column_stack(bent) * matrix[[0, 1], [0, 1]] + matrix[:2, 2]
    return pixels


def camera(
    lens: tuple[float, ...] = (-0.12, 0.03, 5e-4, -5e-4, 0.0),
    focal: float = 1000.0,
    angles: tuple[float, float, float] = (0.03, 0.02, 0.01),
    **more: Any,
) -> tuple[Calibration, Callable[[Floats], Floats]]:
    """A true calibration and, by other formulas, what the camera sees."""
    matrix = np.array([[focal, 0, 640.0], [0, focal * 1.003, 355.0], [0, 0, 1]])
    turned, at = rotation(*angles), np.array([1.5, 0.0, -HEIGHT_M])
    image_from_tank = matrix @ np.column_stack([turned[:, 0], turned[:, 1], -turned @ at])
    found = Calibration(SIZE, matrix, np.array(lens), np.linalg.inv(image_from_tank), **more)
    return found, lambda points: seen(points, matrix, np.array(lens), turned, at)


def everywhere() -> Floats:
    u, v = np.meshgrid(np.linspace(-0.5, 1279.5, 33), np.linspace(-0.5, 719.5, 19))
    return np.column_stack([u.ravel(), v.ravel()])


def test_pixels_become_the_metres_they_show() -> None:
    found, look = camera()
    x, y = np.meshgrid(np.linspace(0, 3, 31), np.linspace(-0.9, 0.9, 19))
    places = np.column_stack([x.ravel(), y.ravel()])
    assert np.abs(found.to_tank(look(places)) - places).max() < 1e-8
    assert np.abs(found.to_pixels(places) - look(places)).max() < 1e-6
    assert found.to_tank(np.empty((0, 2))).shape == (0, 2)
    assert found.to_pixels(np.empty((0, 2))).shape == (0, 2)


SMALL = st.floats(-2e-3, 2e-3)
ANGLE = st.floats(-0.3, 0.3)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.floats(-0.4, 0.4), st.floats(-0.1, 0.2), SMALL, SMALL, st.floats(-0.05, 0.05),
    st.floats(700, 2500), st.tuples(ANGLE, ANGLE, st.floats(-3, 3)),
)  # fmt: skip
def test_there_and_back_in_all_of_the_picture(
    k1: float, k2: float, p1: float, p2: float, k3: float, focal: float, angles: Any
) -> None:
    """Whatever is not refused is exact; it folds over nowhere, so places keep their order."""
    found, look = camera((k1, k2, p1, p2, k3), focal, angles)
    try:
        check_sense(found, "it")
    except InputError as error:
        assert "folds over" in error.message or "horizon" in error.message
        return
    places = found.to_tank(everywhere())
    assert np.abs(found.to_pixels(places) - everywhere()).max() < 1e-3
    assert np.abs(look(places) - everywhere()).max() < 1e-3


def test_strong_distortion_is_exact_in_the_corners() -> None:
    found, look = camera((-0.3, 0.0, 1e-3, 1e-3, 0.0), 1300.0)
    check_sense(found, "it")
    assert np.abs(look(found.to_tank(everywhere())) - everywhere()).max() < 1e-3


def test_a_lens_that_folds_over_in_the_picture_is_refused() -> None:
    """At a focal length of 1000 px the model's turning point, 703 px from the axis, is inside."""
    found, _ = camera((-0.3, 0.0, 0.0, 0.0, 0.0), 1000.0)
    with pytest.raises(InputError, match="lens folds over before the picture's corners"):
        check_sense(found, "it")


def test_the_determinant_tells_where_the_model_folds() -> None:
    lens = camera((-0.3, 0.05, 3e-3, -2e-3, 0.01), 900.0)[0].lens
    at = np.array([[640.0, 355.0], [100.0, 40.0], [1200.0, 90.0], [900.0, 600.0]])
    right, below = np.array([0.01, 0.0]), np.array([0.0, 0.01])
    across = lens.distorted(at + right) - lens.distorted(at - right)
    down = lens.distorted(at + below) - lens.distorted(at - below)
    expected = (across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]) / 0.02**2
    np.testing.assert_allclose(lens.determinant(at), expected, atol=1e-6)
    folding = camera((-0.3, 0.0, 0.0, 0.0, 0.0), 900.0)[0].lens
    beyond = np.array([[640 + 900 * 1.06, 355.0], [640 + 900 * 1.05, 355.0]])
    assert folding.determinant(beyond)[0] == -1
    assert 0 < folding.determinant(beyond)[1] < 0.01


def test_what_the_camera_cannot_see_lies_outside_the_picture() -> None:
    found, _ = camera((-0.3, 0.0, 0.0, 0.0, 0.0), 1300.0, (0.3, 0.0, 0.0))
    check_sense(found, "it")
    angle = np.linspace(0, 2 * np.pi, 60)
    for radius_m in (4.0, 8.0, 12.0, 1e3, 1e9):
        ring = np.column_stack([1.5 + radius_m * np.cos(angle), radius_m * np.sin(angle)])
        ring = np.concatenate([ring, [[1.5, -HEIGHT_M / math.tan(0.3)]]])  # on the horizon
        u, v = found.to_pixels(ring).T
        assert np.isfinite([u, v]).all()
        assert not ((u > -0.5) & (u < 1279.5) & (v > -0.5) & (v < 719.5)).any(), radius_m


FULL: dict[str, Any] = {
    "area_m": np.array([[-0.5, -0.9], [2.5, -0.9], [2.5, 0.9], [-0.5, 0.9]]),
    "anchors": {40: (100.0, 90.5), 41: (1180.25, 95.0), 43: (90.0, 640.0)},
    "scale_error": -0.0021,
    "rms_px": 0.21,
    "plane_rms_m": 0.0013,
    "plane": "the marker swims in the plane of the points",
    "camera": "Günters Kamera",
    "made_at": "2026-05-04T10:00:00+02:00",
}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "tank.json"
    camera(**FULL)[0].save(path)
    return path


def test_a_file_holds_all_of_it(file: Path) -> None:
    was, got = camera(**FULL)[0], load_calibration(file)
    for name in (field.name for field in fields(got)):
        value = getattr(got, name)
        np.testing.assert_array_equal(value, getattr(was, name), err_msg=name)
    assert got.anchors == was.anchors
    assert [path.name for path in file.parent.iterdir()] == ["tank.json"]
    bare = camera()[0]
    bare.save(file)
    assert load_calibration(file).area_m is None and load_calibration(file).rms_px is None


def test_unknown_keys_are_ignored(file: Path) -> None:
    raw = json.loads(file.read_text())
    file.write_text(json.dumps(raw | {"weather": ["rain", None]}))
    assert load_calibration(file).anchors == FULL["anchors"]


def mirrored(raw: dict[str, Any]) -> None:
    raw["tank_from_image"] = [raw["tank_from_image"][i] for i in (1, 0, 2)]


def singular(raw: dict[str, Any]) -> None:
    raw["tank_from_image"][1] = [2 * value for value in raw["tank_from_image"][0]]


def star(raw: dict[str, Any]) -> None:
    turns = np.arange(5) * 4 * np.pi / 5
    raw["area_m"] = np.column_stack([np.cos(turns), np.sin(turns)]).tolist()


def put(name: str, value: Any) -> Callable[[dict[str, Any]], None]:
    return lambda raw: raw.update({name: value})


K = [[1000, 0, 640], [0, 1000, 355], [0, 0, 1]]
NAN, INF = float("nan"), float("inf")
WRONG: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "other format": (put("format", "tank"), "is no calibration of a camera"),
    "newer": (put("version", 2), "has version 2, this tailbeat reads 1"),
    "no matrix": (lambda raw: raw.pop("camera_matrix"), ": no camera_matrix"),
    "nan": (
        put("camera_matrix", [[NAN, 0, 640], *K[1:]]),
        "camera_matrix should be 3 x 3 numbers, finite",
    ),
    "infinite": (put("distortion", [INF, 0, 0, 0, 0]), "distortion should be 5 numbers, finite"),
    "text": (
        put("distortion", ["1", "0", "0", "0", "0"]),
        "distortion: expected a list of numbers",
    ),
    "truth": (put("distortion", [True] * 5), "distortion: expected a list of numbers"),
    "huge": (put("distortion", [10**400, 0, 0, 0, 0]), "distortion: expected a list of numbers"),
    "ragged": (
        put("camera_matrix", [[1, 0], [0, 1, 2], [0]]),
        "camera_matrix: expected a list of numbers",
    ),
    "two sizes": (put("size_px", [1280, 720, 3]), "size_px: expected a list of length 2"),
    "tiny": (put("size_px", [1, 0]), "pictures of 1x0 pixels cannot be"),
    "giant": (put("size_px", [10**9, 720]), "cannot be"),
    "skew": (put("camera_matrix", [[1000, 3, 640], *K[1:]]), "matrix is no pinhole's"),
    "backwards": (put("camera_matrix", [[-1000, 0, 640], *K[1:]]), "matrix is no pinhole's"),
    "other size": (put("size_px", [320, 240]), "the lens's axis lies outside the picture"),
    "denormal": (put("distortion", [5e-324, 0, 0, 0, 1e300]), "no lens distorts like that"),
    "long focus": (put("camera_matrix", [[1e300, 0, 640], *K[1:]]), "matrix is no pinhole's"),
    "overflow": (put("tank_from_image", [[1e308, 0, 0], [0, 1e308, 0], [0, 0, 1]]), "singular"),
    "far": (put("area_m", [[0, 0], [1e300, 0], [1, 1e300]]), "not in a tank"),
    "fold": (put("distortion", [-0.4, 0, 0, 0, 0]), "folds over before the picture's corners"),
    "singular": (singular, "the homography is singular"),
    "nothing": (put("tank_from_image", np.zeros((3, 3)).tolist()), "the homography is singular"),
    "mirror": (mirrored, "mirrored. x and y are swapped, or y is counted to the left"),
    "horizon": (put("tank_from_image", [[0.003, 0, 0], [0, 0.003, 0], [0, -0.01, 1]]), "horizon"),
    "millimetres": (put("tank_from_image", [[2.7, 0, 0], [0, 2.7, 0], [0, 0, 1]]), "2.7e+03 mm"),
    "edge-on": (put("tank_from_image", [[0.1, 0, 0], [0, 0.001, 0], [0, 0, 1]]), "no sense"),
    "two corners": (put("area_m", [[0, 0], [1, 1]]), "at least three corners"),
    "no corners": (put("area_m", []), "at least three corners"),
    "area": (put("area_m", 7), "area_m: expected a list of numbers"),
    "bent": (put("area_m", [[0, 0], [3, 0], [1, 1], [0, 3]]), "is not convex"),
    "crossed": (put("area_m", [[0, 0], [3, 0], [0, 2], [3, 2]]), "is not convex"),
    "star": (star, "is not convex"),
    "line": (put("area_m", [[0, 0], [1, 0], [2, 0]]), "is not convex"),
    "twice": (put("area_m", [[0, 0], [1, 0], [1, 0], [0, 1]]), "is not convex"),
    "anchors": (put("anchors", [1, 2]), "anchors: expected a table of keys and values"),
    "anchor's name": (put("anchors", {"x": [1, 2]}), "anchors: expected a whole number"),
    "anchor's place": (put("anchors", {"40": [1]}), "anchors: expected a list of length 2"),
    "rms": (put("rms_px", "good"), "rms_px: expected a number"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_cannot_be_is_refused(file: Path, what: str) -> None:
    change, words = WRONG[what]
    raw = json.loads(file.read_text())
    change(raw)
    file.write_text(json.dumps(raw))
    with pytest.raises(InputError) as caught:
        load_calibration(file)
    assert words in caught.value.message
    assert str(file) in caught.value.message
    assert caught.value.remedy
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "data", [b"", b"\xff\xfe\x00", b"[1, 2]", b"7", b"{", b"[" * 100_000, b'{"a":' * 5000]
)
def test_other_files_are_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "other.json"
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"other.json.*Make one: tailbeat"):
        load_calibration(path)


def test_a_film_is_not_read_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "film.mp4"
    with path.open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(InputError, match="is too long"):
        load_calibration(path)


def test_missing_files_and_folders(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot read .*none.json \(No such file"):
        load_calibration(tmp_path / "none.json")
    with pytest.raises(InputError, match=r"cannot read .*\(Is a directory"):
        load_calibration(tmp_path)


def test_damaged_bytes_never_do_worse_than_refuse(file: Path) -> None:
    data = file.read_bytes()
    rng = np.random.default_rng(7)
    loaded = 0
    for _ in range(150):
        spoilt = bytearray(data)
        for _ in range(rng.integers(1, 4)):
            spoilt[rng.integers(len(spoilt))] = rng.choice(list(b"0123456789-.e ,}"))
        file.write_bytes(bytes(spoilt[: rng.integers(len(data) // 2, 8 * len(data))]))
        try:
            check_sense(load_calibration(file), "it")
            loaded += 1
        except InputError:
            pass
    assert 10 < loaded < 140


def test_nothing_half_written(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = file.read_bytes()
    good = camera(**FULL)[0]
    with pytest.raises(InputError, match="scale_error should be a number, finite"):
        replace(good, scale_error=NAN).save(file)
    with pytest.raises(InputError, match="tank_from_image should be"):
        replace(good, tank_from_image=np.full((3, 3), NAN)).save(file)
    with pytest.raises(InputError, match=r"cannot write .*No such file"):
        good.save(file.parent / "none" / "tank.json")
    unwritable = replace(good, camera=object())  # type: ignore[arg-type]
    with pytest.raises(TypeError):
        unwritable.save(file)

    def full(self: Path, target: Path) -> Path:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(InputError, match=r"cannot write .*No space left on device"):
        replace(good, camera="other").save(file)
    assert file.read_bytes() == before
    assert [path.name for path in file.parent.iterdir()] == ["tank.json"]


def test_pictures_of_another_size() -> None:
    found = camera()[0]
    found.check_size((1280, 720), "swim.mp4")
    with pytest.raises(
        InputError, match=r"swim.mp4 has pictures of 1920x1080, the calibration is for 1280x720: an"
    ):
        found.check_size((1920, 1080), "swim.mp4")


def test_anchors_tell_a_camera_that_was_moved() -> None:
    found, look = camera()
    corners = np.array([[0.0, -0.8], [3.0, -0.8], [3.0, 0.8], [0.0, 0.8]])
    there = dict(zip(range(40, 44), map(tuple, look(corners)), strict=True))
    found = replace(found, anchors=there)
    assert found.check_anchors({}, "x") is None
    assert found.check_anchors({40: there[40], 7: (3.0, 3.0)}, "x") is None
    worst = found.check_anchors(there | {7: (3.0, 3.0)}, "swim.mp4")
    assert worst is not None and worst < 1e-9
    u, v = there[42]
    near = found.check_anchors(there | {42: (u + 5, v)}, "swim.mp4")
    assert near is not None and 0.010 < near < 0.017
    with pytest.raises(
        InputError, match=r"in swim.mp4 anchor 42 is \d cm from its place at calibration"
    ):
        found.check_anchors(there | {42: (u + 12, v)}, "swim.mp4")
    with pytest.raises(InputError, match="anchor"):
        found.check_anchors({i: (u * 0.9, v * 0.9) for i, (u, v) in there.items()}, "zoomed.mp4")
    with pytest.raises(InputError, match="anchor"):
        found.check_anchors({40: (NAN, 1.0), 41: there[41]}, "nan.mp4")
