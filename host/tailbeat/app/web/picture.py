"""The camera's last picture, for the page. Any thread may ask."""

from __future__ import annotations

from typing import Any

from tailbeat.core.extras import lazy
from tailbeat.sensors.camera.source.picture import TimedImage

cv2: Any = lazy("cv2")
_WIDTH_PX = 640


class LastPicture:
    """Takes every picture of the camera and keeps the last one."""

    def __init__(self) -> None:
        self._last: TimedImage | None = None

    def take(self, picture: TimedImage) -> None:
        """The next one; costs nothing."""
        self._last = picture

    def jpeg(self) -> bytes | None:
        """At most 640 pixels wide; None = there was none yet."""
        if (last := self._last) is None:
            return None
        image = last.image
        height, width = image.shape[:2]
        if width > _WIDTH_PX:
            size = _WIDTH_PX, max(1, round(height * _WIDTH_PX / width))
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        done, data = cv2.imencode(".jpg", image)
        return bytes(data) if done else None
