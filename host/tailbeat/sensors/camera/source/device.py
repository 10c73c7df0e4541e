"""Cameras on this computer, by OpenCV, each in a thread of its own: a driver may block forever."""

from __future__ import annotations

import atexit
import os
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from tailbeat.core.errors import InputError
from tailbeat.core.platform.ports import camera_node
from tailbeat.sensors.camera import cv2
from tailbeat.sensors.camera.source.picture import Image, PictureSource, TimedImage, size_of

_KEPT = 16  # pictures nobody has asked for yet; older ones go
_FAILURES_MAX = 3
_END_S = 2.0


@dataclass(frozen=True, slots=True)
class Shot:
    """A picture as it came. ``index`` counts all the camera gave, ``driver_s`` is whatever it says
    of the time, ``arrived_s`` in the clock of time.monotonic(). ``image`` is grey."""

    index: int
    driver_s: float
    arrived_s: float
    image: Image


class Capture:
    """Reads the camera that ``opened`` opens (a cv2.VideoCapture), as fast as it gives pictures.

    ``opened`` runs in the thread, too. A driver that never returns keeps the thread, and itself,
    until the program ends; nobody waits for it beyond the times given.
    """

    def __init__(self, opened: Callable[[], Any]) -> None:
        self.fps = 0.0  # as the camera says, once there is a picture; 0 = it does not
        self._opened = opened
        self._is_open = False
        self._shots: deque[Shot] = deque(maxlen=_KEPT)
        self._news = threading.Condition()
        self._stop = False
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()
        # A thread that is inside OpenCV when Python goes takes the process down with an abort.
        atexit.register(self.close)

    def is_open(self, within_s: float) -> bool:
        """Whether the driver has opened it by then."""
        with self._news:
            self._news.wait_for(lambda: self._is_open or self._ended, within_s)
            return self._is_open

    def next(self, within_s: float) -> Shot | None:
        """The oldest picture not taken yet; None = none came in time, or none will."""
        with self._news:
            self._news.wait_for(lambda: self._shots or self._ended, within_s)
            return self._shots.popleft() if self._shots else None

    def close(self) -> None:
        """Gives the camera up, after 2 s even if its driver does not return."""
        atexit.unregister(self.close)
        self._stop = True
        self._thread.join(_END_S)

    def _run(self) -> None:
        try:
            capture = self._opened()
            try:
                self._read(capture)
            finally:
                capture.release()
        finally:
            with self._news:
                self._ended = True
                self._news.notify_all()

    def _read(self, capture: Any) -> None:
        with self._news:
            self._is_open = bool(capture.isOpened())
            self._news.notify_all()
        index = failures = 0
        while self._is_open and not self._stop and failures < _FAILURES_MAX:
            if not capture.grab():
                failures += 1
                continue
            arrived_s = monotonic()
            failures = 0
            driver_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
            there, image = capture.retrieve()
            if there and image is not None and image.size:  # not so for a damaged JPEG
                grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
                self.fps = capture.get(cv2.CAP_PROP_FPS) if index == 0 else self.fps
                self._put(Shot(index, driver_s, arrived_s, np.asarray(grey, np.uint8)))
            index += 1

    def _put(self, shot: Shot) -> None:
        with self._news:
            self._shots.append(shot)
            self._news.notify_all()


_PICTURE_S = 2.0
_OPEN_S = 10.0  # drivers outside Linux take seconds
_PROBED = 3
_DRIVER_AGE_MAX_S = 1.0
_FPS_USUAL = 25.0
_NO_PICTURES = "Close other programs that may use it; plug it in directly, without a hub."


class Device(PictureSource):
    """A camera, ``address`` = its number or path (0, /dev/video0).

    Time stamps: the driver's where it gives any in the clock of time.monotonic() (V4L2 does),
    otherwise the moment of arrival; ``stamps`` says which: the driver's if those of the first three
    pictures lie within the second before their arrival. ``latency_s`` is taken off arrivals.
    Pictures are grey. When they are not read in time the oldest are dropped; ``index`` counts them.

    With ``size_px`` Motion JPEG is asked for first, since most cameras give large
    pictures at full rate only so; if no picture comes of it, what the driver prefers.
    Raises InputError when it cannot be opened, gives pictures of another size, or is unplugged
    (read).
    """

    clock = "host"

    def __init__(
        self,
        address: str,
        size_px: tuple[int, int] | None = None,
        latency_s: float = 0.0,
    ) -> None:
        self.name = f"camera {address}"
        self._address = address
        self._latency_s = latency_s
        self._last_s = -float("inf")
        self._capture, first = _started(address, size_px)
        self._ahead = deque([first])
        try:
            while len(self._ahead) < _PROBED:
                self._ahead.append(self._next())
        except BaseException:
            self.close()
            raise
        self.size_px = size_of(first.image)
        self.stamps = "driver" if all(map(_is_recent, self._ahead)) else "arrival"
        reported = self._capture.fps
        self.fps = reported if 1 <= reported <= 1000 else _FPS_USUAL

    def read(self) -> TimedImage | None:
        """Waits for the next picture, 2 s at most; None = closed."""
        while not self.ended:
            shot = self._ahead.popleft() if self._ahead else self._next()
            t_s = self._stamp(shot)
            if t_s is not None:
                self._last_s = t_s
                return TimedImage(shot.index, t_s, shot.image)
        return None

    def close(self) -> None:
        """Gives it up; may be called twice."""
        self.ended = True
        self._capture.close()

    def _stamp(self, shot: Shot) -> float | None:
        """None = not to be used: the time stamp makes no sense."""
        by_driver = self.stamps == "driver"
        t_s = shot.driver_s if by_driver else shot.arrived_s - self._latency_s
        sensible = t_s > self._last_s and (not by_driver or _is_recent(shot))
        return t_s if sensible else None

    def _next(self) -> Shot:
        shot = self._capture.next(_PICTURE_S)
        if shot is None:
            self.close()
            node = camera_node(self._address)
            if node is not None and not node.exists():
                raise InputError(f"{self.name} was unplugged.", "Plug it in and begin again.")
            raise InputError(f"{self.name} gives no more pictures.", _NO_PICTURES)
        return shot


def _is_recent(shot: Shot) -> bool:
    return 0.0 <= shot.arrived_s - shot.driver_s <= _DRIVER_AGE_MAX_S


def _started(address: str, size_px: tuple[int, int] | None) -> tuple[Capture, Shot]:
    """The camera and its first picture. Raises InputError."""
    _check_node(address)
    other_size = ""
    for jpeg in (True, False) if size_px else (False,):
        capture = Capture(partial(_opened, address, size_px, jpeg))
        try:
            if not capture.is_open(_OPEN_S):
                raise InputError(
                    f"camera {address} cannot be opened: another program uses it, or it is none.",
                    "Close other programs. Many cameras have two numbers: try the other one.",
                )
            first = capture.next(_PICTURE_S)
        except BaseException:
            capture.close()
            raise
        if first is not None and size_px in (None, size_of(first.image)):
            return capture, first
        if first is not None:
            other_size = "{} x {}".format(*size_of(first.image))
        capture.close()
    if size_px and other_size:
        raise InputError(
            f"camera {address} gives pictures of {other_size}, not {size_px[0]} x {size_px[1]}.",
            "Ask for a size it has; v4l2-ctl --list-formats-ext shows them.",
        )
    raise InputError(f"camera {address} gives no pictures.", _NO_PICTURES)


def _opened(address: str, size_px: tuple[int, int] | None, jpeg: bool) -> Any:
    log = cv2.utils.logging
    log.setLogLevel(log.LOG_LEVEL_SILENT)  # it has its own words for what we say in one line
    where = int(address) if address.isdecimal() else address
    capture = cv2.VideoCapture(where, cv2.CAP_V4L2 if camera_node(address) else cv2.CAP_ANY)
    if jpeg:
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
    if size_px:
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, size_px[0])
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size_px[1])
    return capture


def _check_node(address: str) -> None:
    node = camera_node(address)
    if node is None:
        return
    if not node.exists():
        there = ", ".join(str(path) for path in sorted(Path("/dev").glob("video*"))) or "none"
        raise InputError(
            f"there is no camera {address} ({node}).", f"Plug it in; there are: {there}."
        )
    if not os.access(node, os.R_OK | os.W_OK):
        raise InputError(
            f"you may not use camera {address} ({node}).",
            "Join the group video: sudo usermod -aG video $USER, then log in again.",
        )
