"""Cameras by OpenCV: time stamps, what is asked of them, what goes wrong; with a fake driver."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2")

from tailbeat.core.errors import InputError  # noqa: E402
from tailbeat.sensors.camera.source import device  # noqa: E402
from tailbeat.sensors.camera.source import device as capture  # noqa: E402
from tailbeat.sensors.camera.source.device import Device  # noqa: E402

BOOT_S = 5000.0  # the fake clock's, when the camera is opened
PERIOD_S = 0.04
MJPG = cv2.VideoWriter.fourcc(*"MJPG")


@dataclass
class Driver:
    """A camera's driver. Picture n is taken at BOOT_S + n * PERIOD_S and arrives ``delay_s``
    later. It waits for ``asked``: pictures come one by one, when a test wants them."""

    stamp_s: Callable[[int, float], float] = lambda _, taken_s: taken_s
    delay_s: float = 0.03
    pictures: int = 1000  # then it fails, as one that is unplugged
    opens: bool = True
    blocks_at: int | None = None
    holes: frozenset[int] = frozenset()  # damaged JPEGs
    fails: frozenset[int] = frozenset()  # of all grabs
    size: Callable[[dict[int, float]], tuple[int, int]] = lambda _: (640, 480)
    silent: Callable[[dict[int, float]], bool] = lambda _: False
    fps: float = 25.0
    asked: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(1000))
    opened: list[tuple[Any, int]] = field(default_factory=list)
    settings: list[dict[int, float]] = field(default_factory=list)
    released: int = 0
    now_s: float = BOOT_S
    blocked: threading.Event = field(default_factory=threading.Event)


class FakeCapture:
    """cv2.VideoCapture on a Driver."""

    def __init__(self, driver: Driver, where: Any, backend: int) -> None:
        self.driver = driver
        self.set_: dict[int, float] = {}
        self.grabs = self.taken = -1
        driver.opened.append((where, backend))
        driver.settings.append(self.set_)

    def isOpened(self) -> bool:  # noqa: N802
        return self.driver.opens

    def set(self, what: int, value: float) -> bool:
        self.set_[what] = value
        return True

    def grab(self) -> bool:
        driver = self.driver
        self.grabs += 1
        if self.grabs in driver.fails:
            return False
        if self.taken + 1 >= driver.pictures or driver.silent(self.set_):
            return False
        if self.taken + 1 == driver.blocks_at:
            driver.blocked.wait(20)
            return False
        if not driver.asked.acquire(timeout=600):
            return False
        self.taken += 1
        driver.now_s = BOOT_S + self.taken * PERIOD_S + driver.delay_s
        return True

    def retrieve(self) -> tuple[bool, Any]:
        if self.taken in self.driver.holes:
            return False, None
        width, height = self.driver.size(self.set_)
        return True, np.full((height, width, 3), self.taken % 250, np.uint8)

    def get(self, what: int) -> float:
        if what == cv2.CAP_PROP_FPS:
            return self.driver.fps
        assert what == cv2.CAP_PROP_POS_MSEC
        return 1e3 * self.driver.stamp_s(self.taken, BOOT_S + self.taken * PERIOD_S)

    def release(self) -> None:
        self.driver.released += 1


@pytest.fixture
def plug(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Callable[..., Driver]]:
    """Connects a camera 0; returns its driver."""
    made: list[Driver] = []

    def plugged(**how: Any) -> Driver:
        driver = Driver(**how)
        made.append(driver)
        monkeypatch.setattr(cv2, "VideoCapture", lambda *at: FakeCapture(driver, *at))
        monkeypatch.setattr(capture, "monotonic", lambda: driver.now_s)
        return driver

    node = tmp_path / "video0"
    node.touch()
    monkeypatch.setattr(device, "camera_node", lambda _: node)
    yield plugged
    for driver in made:
        driver.blocked.set()
        driver.asked.release(100)


def read(camera: Device, count: int) -> list[tuple[int, float, int]]:
    """(index, time, grey value) of the next pictures."""
    found = []
    for _ in range(count):
        picture = camera.read()
        assert picture is not None
        assert picture.image.shape == (480, 640)
        found.append((picture.index, picture.t_s, int(picture.image[0, 0])))
    return found


def paced(driver: Driver, camera: Device, count: int) -> list[tuple[int, float, int]]:
    """Reads picture by picture, each before the next is taken."""
    found = []
    for _ in range(count):
        driver.asked.release()
        found += read(camera, 1)
    return found


def test_stamps_of_the_driver(plug: Callable[..., Driver]) -> None:
    driver = plug(delay_s=0.07)
    camera = Device("0", latency_s=9.0)
    assert camera.stamps == "driver"
    assert (camera.name, camera.clock, camera.fps) == ("camera 0", "host", 25.0)
    assert camera.size_px == (640, 480)
    found = read(camera, 10)
    assert [t_s for _, t_s, _ in found] == [
        pytest.approx(BOOT_S + i * PERIOD_S, abs=1e-6) for i, _, _ in found
    ]
    assert [grey for _, _, grey in found] == [i for i, _, _ in found]
    camera.close()
    camera.close()
    assert camera.ended
    assert camera.read() is None
    assert driver.released == 1


@pytest.mark.parametrize(
    "stamp_s",
    [
        lambda n, _: 0.0,
        lambda n, _: n * PERIOD_S,  # since its own start
        lambda n, taken_s: taken_s + 0.05,  # from the future
        lambda n, taken_s: taken_s - 1.5,
        lambda n, taken_s: 1.7e9 + taken_s,  # by the calendar
        lambda n, taken_s: taken_s if n else 0.0,  # OpenCV says 0 for the first of some
        lambda n, taken_s: -1e-3,
    ],
)
def test_stamps_of_arrival(
    plug: Callable[..., Driver], stamp_s: Callable[[int, float], float]
) -> None:
    driver = plug(stamp_s=stamp_s, asked=threading.Semaphore(3))
    camera = Device("0", latency_s=0.02)
    assert camera.stamps == "arrival"
    found = read(camera, 3) + paced(driver, camera, 4)
    for index, t_s, grey in found:
        assert t_s == pytest.approx(BOOT_S + index * PERIOD_S + 0.03 - 0.02, abs=1e-6)
        assert grey == index
    driver.asked.release()  # it ends between two pictures
    camera.close()


def test_stamps_that_go_astray(plug: Callable[..., Driver]) -> None:
    """A driver whose clock jumps, or stands still: those pictures are left out, not misdated."""
    bad = {5: 0.0, 6: BOOT_S + 99, 8: BOOT_S + 7 * PERIOD_S}
    driver = plug(stamp_s=lambda n, taken_s: bad.get(n, taken_s), asked=threading.Semaphore(3))
    camera = Device("0")
    found = read(camera, 3)
    driver.asked.release(9)
    found += read(camera, 6)
    assert [index for index, _, _ in found] == [0, 1, 2, 3, 4, 7, 9, 10, 11]
    assert all(t_s == pytest.approx(BOOT_S + i * PERIOD_S) for i, t_s, _ in found)
    driver.asked.release()  # it ends between two pictures
    camera.close()


def test_damaged_pictures_are_counted(plug: Callable[..., Driver]) -> None:
    plug(holes=frozenset({1, 4}), pictures=8)
    camera = Device("0")
    assert [index for index, _, _ in read(camera, 4)] == [0, 2, 3, 5]
    camera.close()


def test_pictures_nobody_reads_are_dropped(plug: Callable[..., Driver]) -> None:
    """The camera goes on; what is given afterwards is the newest, and the index shows the hole."""
    driver = plug(asked=threading.Semaphore(3), pictures=103)
    camera = Device("0")
    read(camera, 3)
    driver.asked.release(100)
    camera._capture._thread.join(600)
    found = read(camera, 16)
    assert [index for index, _, _ in found] == list(range(87, 103))
    assert all(t_s == pytest.approx(BOOT_S + i * PERIOD_S) for i, t_s, _ in found)
    camera.close()


def test_what_is_asked_for(plug: Callable[..., Driver]) -> None:
    driver = plug(size=lambda settings: (1280, 720), fps=60.0)
    camera = Device("0", (1280, 720))
    assert camera.size_px == (1280, 720)
    assert camera.fps == 60
    assert driver.settings == [
        {
            cv2.CAP_PROP_FOURCC: MJPG,
            cv2.CAP_PROP_FRAME_WIDTH: 1280,
            cv2.CAP_PROP_FRAME_HEIGHT: 720,
        }
    ]
    assert driver.opened == [(0, cv2.CAP_V4L2)]
    camera.close()


def test_nothing_is_asked_for(plug: Callable[..., Driver]) -> None:
    driver = plug(fps=0.0)
    camera = Device("/dev/v4l/by-id/usb-cam")
    assert driver.settings == [{}]
    assert driver.opened == [("/dev/v4l/by-id/usb-cam", cv2.CAP_V4L2)]
    assert camera.fps == 25.0
    camera.close()


@pytest.mark.parametrize("wrong", ["silent", "small"])
def test_without_motion_jpeg(plug: Callable[..., Driver], wrong: str) -> None:
    """Asked for it, this camera gives nothing, or pictures of another size."""

    def is_jpeg(settings: dict[int, float]) -> bool:
        return cv2.CAP_PROP_FOURCC in settings

    driver = plug(
        silent=lambda settings: wrong == "silent" and is_jpeg(settings),
        size=lambda settings: (640, 480) if is_jpeg(settings) else (1280, 720),
    )
    camera = Device("0", (1280, 720))
    assert camera.size_px == (1280, 720)
    assert [is_jpeg(settings) for settings in driver.settings] == [True, False]
    assert driver.released == 1  # the first, before the second was opened
    camera.close()


def test_another_size(plug: Callable[..., Driver]) -> None:
    driver = plug()
    with pytest.raises(InputError, match="camera 0 gives pictures of 640 x 480, not 1280 x 720"):
        Device("0", (1280, 720))
    assert driver.released == 2


def test_not_opened(plug: Callable[..., Driver]) -> None:
    plug(opens=False)
    with pytest.raises(InputError, match="camera 0 cannot be opened: another program uses it"):
        Device("0")


def test_no_pictures(plug: Callable[..., Driver]) -> None:
    plug(pictures=0)
    with pytest.raises(InputError, match="camera 0 gives no pictures"):
        Device("0")


def test_a_driver_that_never_returns(
    plug: Callable[..., Driver], monkeypatch: pytest.MonkeyPatch
) -> None:
    plug(blocks_at=5)
    camera = Device("0")
    read(camera, 5)
    monkeypatch.setattr(device, "_PICTURE_S", 0.02)
    monkeypatch.setattr(capture, "_END_S", 0.02)
    with pytest.raises(InputError, match="camera 0 gives no more pictures"):
        camera.read()
    assert camera.ended
    assert camera.read() is None
    plug(blocks_at=0)
    with pytest.raises(InputError, match="camera 0 gives no pictures"):
        Device("0")


def test_unplugged(plug: Callable[..., Driver], tmp_path: Path) -> None:
    """What came before is given; a single failure is none."""
    plug(pictures=6, fails=frozenset({4}))
    camera = Device("0")
    (tmp_path / "video0").unlink()
    assert [index for index, _, _ in read(camera, 6)] == list(range(6))
    assert not camera.ended
    with pytest.raises(InputError, match="camera 0 was unplugged"):
        camera.read()
    assert camera.ended
    assert camera.read() is None


def test_stops_in_the_first_pictures(plug: Callable[..., Driver]) -> None:
    driver = plug(pictures=2)
    with pytest.raises(InputError, match="camera 0 gives no more pictures"):
        Device("0")
    assert driver.released == 1


linux_only = pytest.mark.skipif(not os.sys.platform.startswith("linux"), reason="cameras as files")


@linux_only
def test_not_there() -> None:
    with pytest.raises(InputError, match=r"there is no camera 77 \(/dev/video77\)") as caught:
        Device("77")
    assert "Plug it in" in caught.value.remedy
    with pytest.raises(InputError, match="there is no camera /dev/none"):
        Device("/dev/none")


@linux_only
def test_not_allowed(plug: Callable[..., Driver], monkeypatch: pytest.MonkeyPatch) -> None:
    driver = plug()
    monkeypatch.setattr(device.os, "access", lambda *_: False)
    with pytest.raises(InputError, match="you may not use camera 0") as caught:
        Device("0")
    assert "usermod -aG video" in caught.value.remedy
    assert driver.opened == []


@linux_only
def test_opencv_keeps_quiet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """The real one, on a file that is no camera."""
    node = tmp_path / "video0"
    node.touch()
    with pytest.raises(InputError, match="cannot be opened"):
        Device(str(node))
    assert capfd.readouterr() == ("", "")
