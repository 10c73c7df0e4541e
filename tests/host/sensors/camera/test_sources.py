"""The table of picture sources."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tailbeat.core.errors import InputError
from tailbeat.sensors.camera.source import open as sources
from tailbeat.sensors.camera.source.open import (
    SOURCES,
    SourceOptions,
    SourceType,
    live_source,
    open_source,
)
from tailbeat.sensors.camera.source.picture import PictureSource, TimedImage

pytest.importorskip("cv2")
pytest.importorskip("av")


class Blank(PictureSource):
    """Ten blank pictures a second, for ever."""

    clock, fps, size_px = "host", 10.0, (8, 6)

    def __init__(self, name: str) -> None:
        self.name = name
        self._given = 0

    def read(self) -> TimedImage:
        self._given += 1
        return TimedImage(self._given - 1, self._given / 10, np.zeros((6, 8), np.uint8))

    def close(self) -> None:
        self.ended = True


def test_a_new_source_is_one_entry(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = SourceType(lambda text: text.startswith("blank:"), lambda text, _: Blank(text), 2.0)
    monkeypatch.setitem(SOURCES, "blank", entry)
    assert live_source("blank:1") is entry
    source = open_source("blank:1")
    pictures = list(iter(source.read, None))
    assert (source.name, source.pictures, source.ended) == ("blank:1", None, True)
    assert len(pictures) == 20  # two seconds, as its entry says
    assert len(list(iter(open_source("blank:2", seconds=0.5).read, None))) == 5


@pytest.mark.parametrize("text", ["0", "17", "/dev/video0", "/dev/v4l/by-id/usb-cam"])
def test_devices(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(sources, "Device", lambda *at: asked.append(at) or Blank("camera"))
    assert live_source(text) is SOURCES["device"]
    options = SourceOptions((640, 480), 0.02)
    assert len(list(iter(open_source(text, options).read, None))) == 600  # a minute
    assert asked == [(text, (640, 480), 0.02)]


def test_a_file_of_the_name_of_a_device_is_a_film(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("0").write_bytes(b"")
    assert live_source("0") is SOURCES["film"]
    with pytest.raises(InputError, match="0 is empty"):
        open_source("0")


def test_what_looks_like_nothing() -> None:
    assert live_source("camera1") is SOURCES["device"]
    for text in ("camera1", "rendered"):
        with pytest.raises(InputError, match=f"there is no film {text}"):
            open_source(text)


def test_only_a_simulated_fish_is_drawn() -> None:
    kind = live_source("rendered")
    assert kind.simulated
    with pytest.raises(InputError, match="only a simulated fish can be drawn"):
        kind.open("rendered", SourceOptions())
