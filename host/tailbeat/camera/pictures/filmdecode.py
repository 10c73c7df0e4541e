"""The whole pictures of a video file, and where damage begins."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tailbeat.camera.extra import need_av
from tailbeat.errors import InputError

_GIVE_A_FILM = "Give a film: .mp4, .mkv, .mov or .avi."
_SHORT_PERIODS = 1.5


class DamagedError(Exception):
    """No more pictures can be believed."""


def open_film(path: Path) -> tuple[Any, Any]:
    """(container, its video stream) by PyAV. Raises InputError when it is none."""
    av = need_av()
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
    if stream is None or _is_still(container):
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


def _is_still(container: Any) -> bool:
    """libav takes single photos and plain text for films as well."""
    name = container.format.name
    return name in ("tty", "image2", "gif") or name.endswith("_pipe")


def whole_frames(container: Any, stream: Any) -> Iterator[Any]:
    """Frames in order of display. Raises DamagedError behind the last that is whole, also when the
    file ends earlier than its header says. The few frames that the decoder holds back to put them
    in order when it meets damage are not given: some of them may be later than what is lost. At the
    begin of a film that was cut out of another it leaves out what cannot be whole by itself."""
    errors = need_av().error.FFmpegError
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
    """End of the last picture by the header, in the stream's own time; None = not told, or told
    better by the index (MP4)."""
    if "matroska" in container.format.name:
        text = stream.metadata.get("DURATION", "")
        try:
            hours, minutes, seconds = text.split(":")
            return int(hours) * 3600 + int(minutes) * 60 + float(seconds)
        except ValueError:
            alone = len(container.streams) == 1 and container.duration
            return container.duration / need_av().time_base if alone else None
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
