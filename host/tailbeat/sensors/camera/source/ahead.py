"""A film's next pictures are decoded by a second thread while one is looked at."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tailbeat.sensors.camera.source.picture import PictureSource, TimedImage

AHEAD = 4  # pictures; a full-HD one takes 2 MB

Read = Callable[[], TimedImage | None]


@contextmanager
def read_ahead(source: PictureSource) -> Iterator[Read]:
    """Gives a ``read`` as that of ``source``: the same pictures, errors and end. Only a film is
    read by a thread; a device's pictures are due when they are asked for. Until this ends, nobody
    else reads or closes the source."""
    if source.clock != "video":
        yield source.read
        return
    reader = _FilmReader(source)
    try:
        yield reader.read
    finally:
        reader.stop()


class _FilmReader:
    def __init__(self, source: PictureSource) -> None:
        self._source = source
        self._found: queue.Queue[TimedImage | BaseException | None] = queue.Queue(AHEAD)
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="film", daemon=True)
        self._thread.start()

    def read(self) -> TimedImage | None:
        """What the source gave next; once it has ended or failed that comes again."""
        found = self._found.get()
        if isinstance(found, TimedImage):
            return found
        self._found.put(found)
        if found is None:
            return None
        raise found

    def stop(self) -> None:
        """Until the thread no longer touches the source."""
        self._stopped.set()
        while self._thread.is_alive():
            self._drain()  # it may wait for room
            self._thread.join(0.01)

    def _drain(self) -> None:
        while not self._found.empty():
            self._found.get_nowait()

    def _run(self) -> None:
        picture: TimedImage | BaseException | None
        while not self._stopped.is_set():
            try:
                picture = self._source.read()
            except BaseException as error:  # whoever reads gets it
                picture = error
            self._found.put(picture)
            if not isinstance(picture, TimedImage):
                return
