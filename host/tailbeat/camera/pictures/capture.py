"""A camera of OpenCV in a thread of its own: its driver may block for ever, the caller may not."""

from __future__ import annotations

import atexit
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic
from typing import Any

import numpy as np

from tailbeat.camera.extra import need_cv2
from tailbeat.camera.pictures.picture import Image

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
        """The oldest picture not taken yet; None = none came in time, or none will (``ended``)."""
        with self._news:
            self._news.wait_for(lambda: self._shots or self._ended, within_s)
            return self._shots.popleft() if self._shots else None

    @property
    def ended(self) -> bool:
        """Whether the camera is gone, or was never there, and all its pictures are taken."""
        with self._news:
            return self._ended and not self._shots

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
        cv2 = need_cv2()
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
