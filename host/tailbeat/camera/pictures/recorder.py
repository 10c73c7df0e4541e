"""Films what a live camera sees."""

from __future__ import annotations

from pathlib import Path

from tailbeat.camera.pictures.film import FilmWriter
from tailbeat.camera.pictures.picture import Picture


class Recorder:
    """Call it with every picture (live.OnPicture). A film that cannot be written costs the film,
    not the swim: what went wrong is raised by close(). Without ``wanted`` close() leaves no film:
    set it once there is something on it."""

    wanted = False

    def __init__(self, path: Path, size_px: tuple[int, int], fps: float) -> None:
        """Raises InputError when there can be no film at ``path``."""
        self._writer = FilmWriter(path, size_px, fps)
        self._error: Exception | None = None
        self._pictures = 0

    def __call__(self, picture: Picture) -> None:
        """The next picture."""
        if self._error is not None:
            return
        try:
            self._writer.add(picture.image, picture.t_s)
            self._pictures += 1
        except Exception as error:
            self._error = error
            self._writer.discard()

    def close(self) -> None:
        """Finishes the film, if it is wanted and has a picture. Raises what went wrong."""
        if self._error is not None:
            raise self._error
        if self.wanted and self._pictures:
            self._writer.close()
        else:
            self._writer.discard()
