"""Video files: read with the time stamp of every picture up to any damage, and written."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any, Self

import numpy as np

from tailbeat.core.errors import InputError, reason
from tailbeat.core.files import temporary_beside
from tailbeat.sensors.camera import av, cv2
from tailbeat.sensors.camera.source.picture import Image, PictureSource, TimedImage

_GIVE_A_FILM = "Give a film: .mp4, .mkv, .mov or .avi."
_SHORT_PERIODS = 1.5


class DamagedError(Exception):
    """No more pictures can be believed."""


def open_film(path: Path) -> tuple[Any, Any]:
    """(container, its video stream) by PyAV. Raises InputError when it is none."""
    if path.is_dir():
        raise InputError(f"{path} is a folder, no film.", _GIVE_A_FILM)
    if not path.is_file():
        raise InputError(f"there is no film {path}.", "Check the name.")
    try:
        # A play list may name places in the net; films do not.
        container = av.open(str(path), "r", options={"protocol_whitelist": "file"})
    except PermissionError as error:
        raise InputError(f"{path} may not be read.", "Check whose it is: ls -l.") from error
    except (av.error.FFmpegError, ValueError) as error:
        raise _no_film(path) from error
    stream = _video(container)
    name = container.format.name  # libav takes single photos and plain text for films as well
    if stream is None or name in ("tty", "image2", "gif") or name.endswith("_pipe"):
        sound = bool(container.streams.audio) and not container.streams.video
        container.close()
        raise InputError(
            f"{path.name} holds {'sound only' if sound else 'no video'}.", _GIVE_A_FILM
        )
    # Several threads lose track of which pictures are damaged (of 150 single flipped bits 7 more
    # went unnoticed), and a tracker on the same core has no use for them.
    stream.thread_count = 1
    return container, stream


def _no_film(path: Path) -> InputError:
    with path.open("rb") as file:
        begin = file.read(8)
    if not begin:
        return InputError(f"{path.name} is empty.", "Copy it from the camera again.")
    if begin[4:] == b"ftyp":
        return InputError(
            f"{path.name} has no index: the recording was not finished, or only part was copied.",
            "Copy it from the camera again.",
        )
    return InputError(f"{path.name} is no video.", _GIVE_A_FILM)


def _video(container: Any) -> Any:
    """The first stream of moving pictures that can be decoded; None = there is none."""
    for stream in container.streams.video:
        cover = stream.disposition & type(stream.disposition).attached_pic
        if not cover and stream.codec_context is not None and stream.codec_context.width > 0:
            return stream
    return None


def whole_frames(container: Any, stream: Any) -> Iterator[Any]:
    """Frames in order of display. Raises DamagedError behind the last that is whole, also when the
    file ends earlier than its header says. The few frames that the decoder holds back to put them
    in order when it meets damage are not given: some of them may be later than what is lost. At the
    begin of a film that was cut out of another it leaves out what cannot be whole by itself."""
    errors = av.error.FFmpegError
    packets = container.demux(stream)
    last, damaged = None, False
    while not damaged:
        try:
            packet = next(packets, None)
            if packet is None:
                break
            damaged = packet.is_corrupt
            frames = [] if damaged else stream.decode(packet)
        except errors:
            frames, damaged = [], True
        for frame in frames:
            if frame.is_corrupt:
                raise DamagedError
            last = frame
            yield frame
    if damaged or (last is not None and _is_short(container, stream, last)):
        raise DamagedError


def declared_end_s(container: Any, stream: Any) -> float | None:
    """End of the last picture by the header, in the stream's own time; None = not known, or known
    better from the index (MP4)."""
    if "matroska" in container.format.name:
        text = stream.metadata.get("DURATION", "")
        try:
            hours, minutes, seconds = text.split(":")
            return int(hours) * 3600 + int(minutes) * 60 + float(seconds)
        except ValueError:
            alone = len(container.streams) == 1 and container.duration
            return container.duration / av.time_base if alone else None
    if container.format.name == "avi" and stream.duration:
        return float(stream.duration * stream.time_base)
    return None


def _is_short(container: Any, stream: Any, last: Any) -> bool:
    if any(entry.pos + entry.size > container.size for entry in stream.index_entries):
        return True
    end_s = declared_end_s(container, stream)
    if end_s is None or last.pts is None:
        return False
    period_s = float(1 / (stream.average_rate or stream.guessed_rate or 25))
    ticks = last.pts + (last.duration or 0)
    return end_s - float(ticks * stream.time_base) > _SHORT_PERIODS * period_s


_CONTAINERS = {".mp4": ("mp4", Fraction(1, 90000)), ".mkv": ("matroska", Fraction(1, 1000))}
# Formats whose first plane is the brightness in bytes: eight times cheaper than a conversion.
_BRIGHT_FIRST = frozenset(
    {"gray", "nv12", "nv21"}
    | {f"yuv{j}{chroma}p" for j in ("", "j") for chroma in ("420", "422", "444", "440", "411")}
)
_FULL_RANGE = 2  # AVCOL_RANGE_JPEG; all else is 16..235, as players take it
_STRETCH = np.clip(np.rint((np.arange(256) - 16) * 255 / 219), 0, 255).astype(np.uint8)
_AGAIN = "Copy it from the camera again."
_NO_TIMES = "Record as .mp4 or .mkv: bare streams and some .avi hold no times."


class Film(PictureSource):
    """A video file, read with PyAV as grey pictures.

    Time stamps are the file's own, from its first picture; a file with a variable frame rate is as
    good as any. Pictures come in the order they were taken and as the sensor saw them: what the
    file says about turning them for display is ignored, because a phone that looks down guesses.
    Brightness is stretched to 0..255 where the file uses 16..235.

    Raises InputError: not there, no video in it, unreadable from here on (what came before is
    good), shorter than its header says, time stamps that do not rise or are missing.
    """

    clock = "video"

    def __init__(self, path: Path) -> None:
        self._container, self._stream = open_film(path)
        self._frames = whole_frames(self._container, self._stream)
        self._given = 0
        self._first_pts = 0
        self._last_pts: int | None = None
        context = self._stream.codec_context
        self.name = path.name
        self.size_px = (context.width, context.height)
        self.fps = float(self._stream.average_rate or self._stream.guessed_rate or 25)
        end_s = declared_end_s(self._container, self._stream)
        by_time = round(end_s * self.fps) if end_s else None
        self.pictures = self._stream.frames or by_time  # by its header, about

    def read(self) -> TimedImage | None:
        """The next picture; None at the end."""
        if self.ended:
            return None
        try:
            frame = next(self._frames, None)
        except DamagedError:
            raise self._damaged() from None
        if frame is None:
            if not self._given:
                raise self._refused("holds no picture", _AGAIN)
            self.close()
            return None
        self._check(frame)
        t_s = self._since_first_s(frame.pts)
        self._last_pts = frame.pts
        self._given += 1
        return TimedImage(self._given - 1, t_s, self._pixels(frame))

    def close(self) -> None:
        """Closes the file; may be called twice."""
        self.ended = True
        self._container.close()

    def _check(self, frame: Any) -> None:
        at = f"at picture {self._given}"
        if (frame.width, frame.height) != self.size_px:
            what = f"changes its size to {frame.width} x {frame.height} {at}"
            raise self._refused(what, "Give films of one size each.")
        if frame.pts is None:
            raise self._refused(f"has no time stamp {at}", _NO_TIMES)
        if self._last_pts is None:
            self._first_pts = frame.pts
        elif frame.pts <= self._last_pts:
            raise self._refused(f"goes back in time {at}: its time stamps do not rise", _NO_TIMES)

    def _since_first_s(self, pts: int) -> float:
        return float((pts - self._first_pts) * self._stream.time_base)

    def _pixels(self, frame: Any) -> Image:
        name = frame.format.name
        if name not in _BRIGHT_FIRST:
            return np.asarray(frame.to_ndarray(format="gray"), np.uint8)
        plane = frame.planes[0]
        rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
        bright = rows[: plane.height, : plane.width]
        full = name == "gray" or name.startswith("yuvj") or frame.color_range == _FULL_RANGE
        return bright.copy() if full else np.asarray(cv2.LUT(bright, _STRETCH), np.uint8)

    def _damaged(self) -> InputError:
        if self._last_pts is None:
            return self._refused("is damaged before its first picture", _AGAIN)
        t_s = self._since_first_s(self._last_pts)
        cut = f"ffmpeg -i {self.name} -t {t_s:.1f} -c copy cut_{self.name}"
        return self._refused(
            f"is damaged after picture {self._given - 1} ({t_s:.1f} s)",
            f"Copy it from the camera again, or keep what comes before: {cut}",
        )

    def _refused(self, what: str, remedy: str) -> InputError:
        self.close()
        return InputError(f"{self.name} {what}.", remedy)


class FilmWriter:
    """Writes pictures with their time stamps into ``path``, H.264: .mp4 (to 1/90000 s) or .mkv (to
    1/1000 s). The file has another name until close(); an error leaves nothing half-written:
    use it as a context manager. Without a picture there is no file."""

    def __init__(self, path: Path, size_px: tuple[int, int], fps: float) -> None:
        if path.suffix.lower() not in _CONTAINERS:
            raise InputError(f"cannot write a film as {path.name}.", "Name it .mp4 or .mkv.")
        container, self._tick = _CONTAINERS[path.suffix.lower()]
        self._path = path
        self._part = temporary_beside(path)
        self._size_px = size_px
        self._first_s: float | None = None
        self._last_s = 0.0
        self._ticks = -1
        self._container: Any = None
        try:
            self._container = av.open(str(self._part), "w", format=container)
            self._stream = self._encoder(size_px, fps)
            self._container.start_encoding()
        except OSError as error:
            self.discard()
            raise self._unwritable(error) from error

    def _encoder(self, size_px: tuple[int, int], fps: float) -> Any:
        # ultrafast: 15 ms to write and 6 to read at 1280x720 with noise; veryfast 40 and 14.
        stream = self._container.add_stream(
            "libx264",
            rate=Fraction(fps).limit_denominator(1001),
            options={"preset": "ultrafast", "crf": "18"},
        )
        stream.width, stream.height = size_px
        # 4:2:0 has even sizes only; a film of another size than the camera's suits no calibration.
        stream.pix_fmt = "yuv444p" if size_px[0] % 2 or size_px[1] % 2 else "yuv420p"
        stream.codec_context.time_base = self._tick
        return stream

    def add(self, image: Image, t_s: float) -> None:
        """The next picture, grey or BGR; times rise, by what the file tells apart (InputError)."""
        height, width = image.shape[:2]
        if (width, height) != self._size_px:
            size = "{} x {}".format(*self._size_px)
            raise InputError(
                f"{self._path.name}: a picture of {width} x {height} in a film of {size}.",
                "Write films of one size each.",
            )
        first_s = t_s if self._first_s is None else self._first_s
        ticks = round((t_s - first_s) / self._tick) if np.isfinite(t_s) else self._ticks
        if ticks <= self._ticks:
            raise InputError(
                f"{self._path.name}: a picture at {t_s:.6f} s after one at {self._last_s:.6f} s.",
                "Add pictures in order of time.",
            )
        frame = av.VideoFrame.from_ndarray(
            np.ascontiguousarray(image), format="gray" if image.ndim == 2 else "bgr24"
        )
        frame.pts, frame.time_base = ticks, self._tick
        self._write(frame)
        self._first_s, self._last_s, self._ticks = first_s, t_s, ticks

    def _write(self, frame: Any) -> None:
        try:
            for packet in self._stream.encode(frame):
                self._container.mux(packet)
        except OSError as error:
            raise self._unwritable(error) from error

    def _unwritable(self, error: Exception) -> InputError:
        return InputError(f"cannot write {self._path} ({reason(error)}).", "Choose another place.")

    def close(self) -> None:
        """Finishes the file and gives it its name; may be called twice."""
        if self._container is None:
            return
        try:
            if self._first_s is not None:
                self._write(None)
                self._container.close()
                self._part.replace(self._path)
        except OSError as error:
            raise self._unwritable(error) from error
        finally:
            self.discard()

    def discard(self) -> None:
        """Drops what was written."""
        container, self._container = self._container, None
        if container is not None:
            with contextlib.suppress(OSError):  # a full disk is full for its end, too
                container.close()
            self._part.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()


class Recorder:
    """Call it with every picture (live.OnPicture). A film that cannot be written costs the film,
    not the trial: what went wrong is raised by close(). Without ``wanted`` close() leaves no film:
    set it once there is something on it."""

    wanted = False

    def __init__(self, path: Path, size_px: tuple[int, int], fps: float) -> None:
        """Raises InputError when there can be no film at ``path``."""
        self._writer = FilmWriter(path, size_px, fps)
        self._error: Exception | None = None

    def __call__(self, picture: TimedImage) -> None:
        """The next picture."""
        if self._error is not None:
            return
        try:
            self._writer.add(picture.image, picture.t_s)
        except Exception as error:
            self._error = error
            self._writer.discard()

    def close(self) -> None:
        """Finishes the film, if it is wanted. Raises what went wrong."""
        if self._error is not None:
            raise self._error
        if self.wanted:
            self._writer.close()
        else:
            self._writer.discard()
