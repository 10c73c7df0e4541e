"""Rows of a track: every picture there is, every picture there should have been, and the file."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Set
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import av
import numpy as np
import pytest

from tailbeat.core.errors import InputError
from tailbeat.core.speed_source import Frame
from tailbeat.report.figures.track import draw_track
from tailbeat.sensors.camera.calibration.file import Calibration
from tailbeat.sensors.camera.film_to_speed import Overlay
from tailbeat.sensors.camera.marker.detector import Marker
from tailbeat.sensors.camera.marker.tags import Detection
from tailbeat.sensors.camera.source.ahead import AHEAD
from tailbeat.sensors.camera.source.picture import TimedImage
from tailbeat.sensors.camera.speed import SpeedCurve
from tailbeat.sensors.camera.tracking import track as tracks
from tailbeat.sensors.camera.tracking.track import (
    BRIDGED,
    COLUMNS,
    LOST,
    SEEN,
    STATES,
    Track,
    track,
    track_of,
    write_track,
)
from tailbeat.sensors.camera.tracking.tracker import PATCH_SHAPE, TrackedImage

cv2 = pytest.importorskip("cv2")
pytest.importorskip("av")

EVEN_S = [0.04 * i for i in range(100)]


class Source:
    """Blank pictures at given times; ``fails`` is raised instead of the one with that number."""

    name = "swim.mp4"
    clock: Literal["video", "host", "board"] = "video"
    fps = 25.0
    size_px = (8, 8)
    ended = False

    def __init__(self, times_s: list[float], fails: dict[int, BaseException] | None = None) -> None:
        self.pictures: int | None = len(times_s)
        self._fails = fails or {}
        self._next = iter(enumerate(times_s))

    def read(self) -> TimedImage | None:
        index, t_s = next(self._next, (-1, 0.0))
        if index in self._fails:
            raise self._fails[index]
        return None if index < 0 else TimedImage(index, t_s, np.zeros((8, 8), np.uint8))

    def close(self) -> None:
        pass


def trials(t_s: float) -> Frame:
    """Turns to the right all the time, so that its heading wraps."""
    return Frame(t_s, 0.08 * t_s, 0.01 * t_s, math.remainder(2.5 * t_s, 2 * math.pi))


def place(index: int, t_s: float, seen: bool = True, patch: int | None = None) -> TrackedImage:
    if not seen:
        return TrackedImage(index, t_s, None, None, None)
    patch = None if patch is None else np.full(PATCH_SHAPE, patch, np.uint8)
    return TrackedImage(
        index, t_s, trials(t_s), Detection((1.0, 1.0), (2.0, 1.0), 3.0, 0.75), patch
    )


def places(times_s: list[float], unseen: Set[int] = frozenset()) -> list[TrackedImage]:
    return [place(i, t, i not in unseen) for i, t in enumerate(times_s)]


@pytest.fixture
def fake_tracker(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """A tracker that does not see the fish in the pictures with these numbers."""

    def blind(unseen: set[int], ids: list[int] | None = None) -> None:
        class Fake:
            other_ids = ids or []
            measured_side_m = 0.0599

            def __init__(self, marker: Marker, calibration: Any, name: str, patch: bool) -> None:
                self.patch = 9 if patch else None

            def look(self, picture: TimedImage) -> TrackedImage:
                return place(picture.index, picture.t_s, picture.index not in unseen, self.patch)

        monkeypatch.setattr(tracks, "Tracker", Fake)

    return blind


def right(found: Track) -> None:
    """What is seen is what swam; nothing else is a number but bridges."""
    seen = found.seen()
    t_s = found.t_s[seen]
    assert np.allclose(found.x_m[seen], 0.08 * t_s, atol=1e-12)
    assert np.allclose(found.y_m[seen], 0.01 * t_s, atol=1e-12)
    lost = found.state == LOST
    for column in (found.x_m, found.y_m, found.heading_rad):
        assert np.isnan(column[lost]).all()
        assert np.isfinite(column[~lost]).all()
    assert (found.quality[seen] == 0.75).all()
    assert (found.quality[~seen] == 0).all()
    assert (np.diff(found.t_s) > 0).all()


def test_all_of_a_film(fake_tracker: Callable[..., None]) -> None:
    fake_tracker(set())
    done: list[tuple[int, float]] = []
    shown: list[tuple[int, int]] = []
    found = track(
        Source(EVEN_S),
        Marker(),
        None,  # type: ignore[arg-type]
        progress=lambda *how: done.append(how),
        on_place=lambda picture, where: shown.append((picture.index, where.index)),
    )
    right(found)
    assert found.name == "swim.mp4"
    assert found.patch is None
    assert found.fps == pytest.approx(25)
    assert np.array_equal(found.t_s, EVEN_S)
    assert (found.state == SEEN).all()
    assert np.allclose(found.heading_rad, 2.5 * found.t_s)  # unwrapped
    assert done == [(i + 1, (i + 1) / 100) for i in range(100)]
    assert shown == [(i, i) for i in range(100)]


def test_progress_without_an_end(fake_tracker: Callable[..., None]) -> None:
    fake_tracker(set())
    source = Source(EVEN_S[:3])
    source.pictures = None
    parts: list[float] = []
    track(source, Marker(), None, progress=lambda _, part: parts.append(part))  # type: ignore[arg-type]
    assert len(parts) == 3
    assert all(math.isnan(part) for part in parts)


@pytest.mark.parametrize(("long", "state"), [(1, BRIDGED), (5, BRIDGED), (6, LOST), (20, LOST)])
@pytest.mark.parametrize("how", ["not seen", "not in the film", "both"])
def test_holes(long: int, state: int, how: str) -> None:
    hole = set(range(40, 40 + long))
    gone = {"not seen": set(), "not in the film": hole, "both": set(list(hole)[::2])}[how]
    there = [place(i, t, i not in hole) for i, t in enumerate(EVEN_S) if i not in gone]
    found = track_of(there)
    right(found)
    assert len(found.t_s) == len(EVEN_S)
    assert np.allclose(found.t_s, EVEN_S, atol=1e-12)
    assert set(np.flatnonzero(found.state != SEEN)) == hole
    assert (found.state[sorted(hole)] == state).all()
    if state == BRIDGED:
        t_s = found.t_s[sorted(hole)]
        assert np.allclose(found.x_m[sorted(hole)], 0.08 * t_s)
        assert np.allclose(found.heading_rad[sorted(hole)], 2.5 * t_s)


def test_holes_at_the_ends_are_lost() -> None:
    found = track_of(places(EVEN_S, {0, 1, 98, 99}))
    right(found)
    assert list(np.flatnonzero(found.state == LOST)) == [0, 1, 98, 99]
    assert not (found.state == BRIDGED).any()


@pytest.mark.parametrize("seed", range(5))
def test_lost_pictures_are_rows(seed: int) -> None:
    """A tenth of the pictures never came, stamps jitter by a fifth of a period."""
    rng = np.random.default_rng(seed)
    due = np.arange(400) / 60 + rng.uniform(-0.1, 0.1, 400) / 60
    kept = rng.random(400) > 0.1
    kept[[0, -1]] = True
    found = track_of(places(list(due[kept])))
    right(found)
    assert len(found.t_s) == 400
    assert np.array_equal(found.seen(), kept)
    assert np.abs(found.t_s - due).max() < 0.3 / 60
    assert found.fps == pytest.approx(60, rel=0.05)


def test_uneven_films() -> None:
    """A phone that halves its rate in dim light lacks no pictures, but for a dozen distances after
    the change, whose rows are bridged; a pattern of short and long distances lacks none."""
    slower = [0.033 * i for i in range(60)]
    slower += [slower[-1] + 0.066 * (i + 1) for i in range(60)]
    found = track_of(places(slower))
    right(found)
    extra = found.t_s[found.state == BRIDGED]
    assert len(found.t_s) == 120 + len(extra)
    assert 1 <= len(extra) <= 13
    assert extra.max() < slower[60] + 13 * 0.066
    assert not (found.state == LOST).any()
    pattern = np.cumsum([0.03, 0.04, 0.05] * 40)
    assert (track_of(places(list(pattern))).state == SEEN).all()
    faster = [t - slower[0] for t in sorted(slower[-1] - t for t in slower)]
    assert len(track_of(places(faster)).t_s) == 120


def test_a_pause() -> None:
    """Ten seconds are a hole; an hour is another film, and a broken stamp costs no memory."""
    paused = EVEN_S + [t + 14.0 for t in EVEN_S]
    found = track_of(places(paused))
    right(found)
    assert np.count_nonzero(found.state == LOST) == round((14.0 - EVEN_S[-1]) / 0.04) - 1
    for far_s in (3600.0, 1e12):
        with pytest.raises(InputError, match=r"a pauses for .* s after picture 99"):
            track_of(places([*EVEN_S, EVEN_S[-1] + far_s]), "a")


def test_patch_stays_with_its_picture() -> None:
    there = [place(i, t, i != 3, i) for i, t in enumerate(EVEN_S[:10]) if i != 5]
    found = track_of(there)
    assert found.patch is not None
    assert found.patch.shape == (10, *PATCH_SHAPE)
    assert [int(patch.max()) for patch in found.patch] == [0, 1, 2, 0, 4, 0, 6, 7, 8, 9]


def test_what_came_before_the_head_was_known_is_turned_around() -> None:
    """A blob whose detector takes the other end for the head in picture 30, and again in 60."""
    patch, turned = (np.full(PATCH_SHAPE, n, np.uint8) for n in (7, 8))

    def seen(index: int, t_s: float, turns: int) -> TrackedImage:
        heading = 0.1 * math.sin(t_s) + math.pi * (turns != 1)
        detection = Detection((1.0, 1.0), (2.0, 1.0), 3.0, 0.5, turns=turns)
        frame = Frame(t_s, 0.1 * t_s, 0.0, math.remainder(heading, 2 * math.pi))
        return TrackedImage(index, t_s, frame, detection, patch, turned)

    once = [seen(i, t, int(i >= 30)) for i, t in enumerate(EVEN_S[:60])]
    once[10] = place(10, EVEN_S[10], seen=False)
    found = track_of(once)
    expected = 0.1 * np.sin(EVEN_S[:60])
    assert np.abs(np.sin((found.heading_rad - expected) / 2)).max() < 1e-4
    assert np.ptp(found.heading_rad) < 0.3
    assert found.patch is not None
    assert [int(each.max()) for each in found.patch] == [8] * 10 + [0] + [8] * 19 + [7] * 30
    twice = [seen(i, t, min(i // 30, 2)) for i, t in enumerate(EVEN_S)]
    back = track_of(twice)
    assert np.abs(np.cos(back.heading_rad) + np.cos(0.1 * np.sin(EVEN_S))).max() < 1e-4
    assert back.patch is not None
    assert [int(each.max()) for each in back.patch] == [7] * 30 + [8] * 30 + [7] * 40


def test_few_pictures() -> None:
    nothing = track_of([])
    assert (len(nothing.t_s), nothing.fps) == (0, 0.0)
    one = track_of(places([7.0]))
    assert (list(one.t_s), one.fps) == ([7.0], 0.0)
    assert one.seen().all()


@pytest.mark.parametrize(
    ("marker", "words"),
    [
        (Marker(), ["no aruco marker in any of 100 pictures", "--marker apriltag"]),
        (Marker("apriltag", 7), ["no apriltag marker with id 7", "20 pixels", "--marker aruco or"]),
        (Marker("blob"), ["nothing moves in any of 100 pictures", "--marker aruco"]),
    ],
)
def test_never_a_marker(
    fake_tracker: Callable[..., None], marker: Marker, words: list[str]
) -> None:
    fake_tracker(set(range(100)))
    with pytest.raises(InputError) as caught:
        track(Source(EVEN_S), marker, None)  # type: ignore[arg-type]
    text = str(caught.value)
    assert text.startswith("swim.mp4: ")
    assert "\n" not in text
    assert all(word in text for word in words), text


def test_another_marker(fake_tracker: Callable[..., None]) -> None:
    fake_tracker(set(range(100)), [3, 12, 30, 41])
    with pytest.raises(InputError, match=r"with id 7 .* has the id 3, 12: give that"):
        track(Source(EVEN_S), Marker(id=7), None)  # type: ignore[arg-type]


@pytest.mark.parametrize("marker", [Marker(id=7), Marker()])
def test_the_tanks_markers_are_none_to_ask_for(
    fake_tracker: Callable[..., None], marker: Marker
) -> None:
    fake_tracker(set(range(100)), [30, 31, 40, 43])
    with pytest.raises(InputError, match=r"or try --marker apriltag") as caught:
        track(Source(EVEN_S), marker, None)  # type: ignore[arg-type]
    assert "30" not in str(caught.value) and "has the id" not in str(caught.value)


def test_no_picture(fake_tracker: Callable[..., None]) -> None:
    fake_tracker(set())
    with pytest.raises(InputError, match=r"swim\.mp4 holds no picture"):
        track(Source([]), Marker(), None)  # type: ignore[arg-type]


@pytest.mark.parametrize("error", [InputError("is damaged"), KeyboardInterrupt()])
def test_half_a_film_is_no_track(fake_tracker: Callable[..., None], error: BaseException) -> None:
    fake_tracker(set())
    with pytest.raises(type(error)):
        track(Source(EVEN_S, {50: error}), Marker(), None)  # type: ignore[arg-type]


def test_nothing_is_read_once_the_tracker_gives_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second thread reads ahead, a few pictures and no longer than the first one wants them."""

    class TwoFish:
        def __init__(self, *_: object) -> None:
            pass

        def look(self, picture: TimedImage) -> TrackedImage:
            if picture.index == 10:
                raise InputError("two fish")
            return place(picture.index, picture.t_s)

    monkeypatch.setattr(tracks, "Tracker", TwoFish)
    source, threads = Source(EVEN_S), threading.active_count()
    with pytest.raises(InputError, match="two fish"):
        track(source, Marker(), None)  # type: ignore[arg-type]
    assert threading.active_count() == threads
    left = 0
    while source.read() is not None:
        left += 1
    assert len(EVEN_S) - 11 - AHEAD - 2 <= left <= len(EVEN_S) - 11


def test_file(tmp_path: Path) -> None:
    path = tmp_path / "track.csv"
    hole = set(range(20, 24)) | set(range(50, 60))
    made = track_of(places(EVEN_S, hole), "swim.mp4")
    write_track(made, path)
    assert [p.name for p in tmp_path.iterdir()] == ["track.csv"]
    lines = path.read_text().splitlines()
    assert lines[0] == ",".join(COLUMNS)
    assert lines[1] == "0,0.000000,0.000000,0.000000,0.000000,0.750000,seen"
    assert lines[51] == "50,2.000000,,,,0.000000,lost"
    assert lines[21].endswith(",0.000000,bridged")
    rows = [line.split(",") for line in lines[1:]]
    assert [STATES.index(row[-1]) for row in rows] == made.state.tolist()
    for at, column in enumerate(("t_s", "x_m", "y_m", "heading_rad", "quality"), start=1):
        theirs = [float(row[at] or "nan") for row in rows]
        assert np.allclose(getattr(made, column), theirs, atol=1e-6, equal_nan=True), column


def test_unwritable(tmp_path: Path) -> None:
    made = track_of(places(EVEN_S))
    with pytest.raises(InputError, match=r"cannot write .* \(No such file"):
        write_track(made, tmp_path / "no" / "track.csv")
    folder = tmp_path / "track.csv"
    folder.mkdir()
    with pytest.raises(InputError, match="cannot write"):
        write_track(made, folder)
    assert [p.name for p in tmp_path.iterdir()] == ["track.csv"]


GREY = 90
CORNERS = np.array([[60.0, 40.0], [60.0, 60.0], [40.0, 60.0], [40.0, 40.0]])  # looks to the right


def in_colour(path: Path) -> list[TimedImage]:
    """The film's pictures, BGR."""
    with av.open(str(path)) as film:
        frames = enumerate(film.decode(video=0))
        return [TimedImage(i, float(f.time), f.to_ndarray(format="bgr24")) for i, f in frames]


def drawn(path: Path, seen: list[bool]) -> list[TimedImage]:
    """What an overlay made of pictures in which a marker goes down by 20 pixels each."""
    with Overlay(path, (320, 240), 2) as overlay:
        for index, there in enumerate(seen):
            t_s = 0.5 * index
            image = np.full((240, 320), GREY, np.uint8)
            down = np.array([100.0, 40.0 + 20 * index])
            detection = Detection(
                (50 + down[0], 50 + down[1]), (60 + down[0], 50 + down[1]), 20, 0.5, CORNERS + down
            )
            where = TrackedImage(index, t_s, trials(t_s), detection, None)
            gone = TrackedImage(index, t_s, None, None, None)
            overlay(TimedImage(index, t_s, image), where if there else gone)
            assert (image == GREY).all()  # the picture is its holder's
    return in_colour(path)


def coloured(picture: TimedImage, u: float, v: float, bgr: tuple[int, int, int]) -> bool:
    """Whether about that colour is at most 2 pixels away; films have little of it."""
    around = picture.image[round(v) - 2 : round(v) + 3, round(u) - 2 : round(u) + 3].astype(int)
    return bool((np.abs(around - bgr).max(axis=2) < 90).any())


GREEN, RED, YELLOW = (0, 220, 0), (60, 60, 255), (0, 200, 255)


def test_overlay(tmp_path: Path) -> None:
    found = drawn(tmp_path / "o.mp4", [True] * 4 + [False])
    assert [p.t_s for p in found] == pytest.approx([0, 0.5, 1, 1.5, 2], abs=1e-5)
    fourth, last = found[3], found[4]
    for u, v in ((160, 140), (160, 160), (140, 160), (140, 140)):
        assert coloured(fourth, u, v, GREEN), (u, v)
        assert not coloured(last, u, v, GREEN)
    assert coloured(fourth, 190, 150, RED)  # the arrow, ahead of the marker
    assert not coloured(fourth, 120, 150, RED)
    assert coloured(fourth, 150, 110, YELLOW)  # where it came from
    assert coloured(last, 150, 110, YELLOW)
    assert not coloured(last, 150, 170, YELLOW)
    assert (
        last.image[3:25, :110, 2].astype(int) - last.image[3:25, :110, 1] > 60
    ).any()  # "not seen"
    assert not (fourth.image[3:25, :110, 2].astype(int) - fourth.image[3:25, :110, 1] > 60).any()


def test_overlay_forgets_the_way(tmp_path: Path) -> None:
    last = drawn(tmp_path / "o.mp4", [True] * 8)[-1]
    assert coloured(last, 150, 90 + 20 * 4, YELLOW)
    assert not coloured(last, 150, 90 + 20 * 1, YELLOW)


def test_overlay_of_a_blob(tmp_path: Path) -> None:
    path = tmp_path / "o.mp4"
    blob = Detection((150.0, 120.0), (190.0, 120.0), 30.0, 0.5)
    with Overlay(path, (320, 240), 25) as overlay:
        picture = TimedImage(0, 0.0, np.full((240, 320), GREY, np.uint8))
        overlay(picture, TrackedImage(0, 0.0, trials(0.0), blob, None))
    first = in_colour(path)[0]
    for u, v in ((190, 105), (190, 135), (110, 105), (110, 135)):
        assert coloured(first, u, v, GREEN)


def test_overlay_leaves_nothing_behind(tmp_path: Path, fake_tracker: Callable[..., None]) -> None:
    fake_tracker(set())
    with (
        pytest.raises(InputError, match="is damaged"),
        Overlay(tmp_path / "o.mp4", (8, 8), 25) as overlay,
    ):
        track(
            Source(EVEN_S, {50: InputError("is damaged")}),
            Marker(),
            None,  # type: ignore[arg-type]
            on_place=overlay,
        )
    assert list(tmp_path.iterdir()) == []


def curve_of(found: Track, holes: bool) -> SpeedCurve:
    t_s = np.arange(found.t_s[0] + 0.5, found.t_s[-1] - 0.5, 0.1)
    if holes:
        t_s = t_s[(t_s < 1.4) | (t_s > 2.6)]
    speed = np.full(len(t_s), 0.08)
    return SpeedCurve(t_s, speed, speed / 20, 1.0, 0.4, 0.1, 0.001)


def hues(path: Path, box: tuple[slice, slice]) -> list[int]:
    """Columns of that part of a picture in which there is the colour of lines."""
    image = cv2.imread(str(path)).astype(int)[box]
    blue = (np.abs(image - (0x94, 0x53, 0x0B)).max(axis=2) < 30).any(axis=0)
    return list(np.flatnonzero(blue))


SPEED_PANEL = (slice(750, 1015), slice(110, 1360))


@pytest.mark.painted
def test_picture(tmp_path: Path) -> None:
    """1400 x 1100 pixels; the speed's line is whole, or has a hole where the fish was lost."""
    hole = set(range(40, 60))
    whole, holed = track_of(places(EVEN_S), "a.mp4"), track_of(places(EVEN_S, hole), "b.mp4")
    for found, broken in ((whole, False), (holed, True)):
        path = tmp_path / f"{broken}.png"
        draw_track(found, curve_of(found, broken), path)
        assert cv2.imread(str(path)).shape == (1100, 1400, 3)
        steps = np.diff(hues(path, SPEED_PANEL))
        assert (steps.max() > 200) == broken
    draw_track(whole, None, tmp_path / "short.png")
    assert hues(tmp_path / "short.png", SPEED_PANEL) == []
    assert {p.suffix for p in tmp_path.iterdir()} == {".png"}


@pytest.mark.painted
def test_picture_is_to_scale(tmp_path: Path) -> None:
    """A square basin is a square, and y goes down, as in the camera's pictures."""
    found = track_of(
        [TrackedImage(i, t, Frame(t, t, 0.2 * t), None, None) for i, t in enumerate(EVEN_S)]
    )
    area = np.array([[-1.0, -2.5], [5.0, -2.5], [5.0, 3.5], [-1.0, 3.5]])
    calibration = Calibration((640, 480), np.eye(3), np.zeros(5), np.eye(3), area_m=area)
    path = tmp_path / "a.png"
    draw_track(found, None, path, calibration)
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)[150:640]
    edge = np.abs(grey.astype(int) - round(0.62 * 255)) < 8
    rows, columns = np.flatnonzero(edge.sum(axis=1) > 200), np.flatnonzero(edge.sum(axis=0) > 200)
    assert abs((rows.max() - rows.min()) - (columns.max() - columns.min())) <= 2
    blue = np.argwhere(
        np.abs(cv2.imread(str(path)).astype(int) - (0x94, 0x53, 0x0B)).max(axis=2) < 30
    )
    first, last = blue[np.argmin(blue[:, 1])], blue[np.argmax(blue[:, 1])]
    assert last[0] > first[0]


@pytest.mark.painted
def test_labels_on_a_short_way_do_not_lie_on_each_other(tmp_path: Path) -> None:
    """All dots of a way of some pixels: only the first label is there; over metres all are."""
    area = np.array([[-1.0, -1.0], [8.0, -1.0], [8.0, 1.0], [-1.0, 1.0]])
    calibration = Calibration((640, 480), np.eye(3), np.zeros(5), np.eye(3), area_m=area)
    ink = {}
    for name, speed, count in (("brief", 0.0, 10), ("short", 1e-3, 150), ("long", 1.0, 150)):
        way = [
            TrackedImage(i, i / 25, Frame(i / 25, speed * i / 25), None, None) for i in range(count)
        ]
        path = tmp_path / f"{name}.png"
        draw_track(track_of(way), None, path, calibration)
        dark = cv2.imread(str(path))[330:392, 120:1340].max(axis=2) < 90  # above the way
        ink[name] = np.count_nonzero(dark)
    assert 50 < ink["brief"] == pytest.approx(ink["short"], rel=0.03)
    assert ink["long"] > 2.5 * ink["brief"]


def test_a_direction_of_nothing_has_no_minus(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from matplotlib.figure import Figure

    texts: list[str] = []
    write = Figure.text

    def kept(figure: Figure, x: float, y: float, text: str, **how: Any) -> Any:
        texts.append(text)
        return write(figure, x, y, text, **how)

    monkeypatch.setattr(Figure, "text", kept)
    found = track_of(places(EVEN_S))
    straight = replace(curve_of(found, False), direction_rad=-1e-5)
    draw_track(found, straight, tmp_path / "a.png")
    assert "direction +0.0°" in texts[-1]


def test_no_picture_of_nothing(tmp_path: Path) -> None:
    blind = track_of(places(EVEN_S, set(range(100))), "a.mp4")
    with pytest.raises(InputError, match=r"a\.mp4 shows no fish"):
        draw_track(blind, None, tmp_path / "a.png")
    with pytest.raises(InputError, match="cannot write"):
        draw_track(track_of(places(EVEN_S)), None, tmp_path / "no" / "a.png")
    assert list(tmp_path.iterdir()) == []
