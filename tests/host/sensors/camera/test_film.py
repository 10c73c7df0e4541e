"""Video files: every picture with its own time stamp, and what is wrong with a file in one line."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

av = pytest.importorskip("av")
cv2 = pytest.importorskip("cv2")

from tailbeat.core.errors import InputError  # noqa: E402
from tailbeat.core.extras import LazyModule  # noqa: E402
from tailbeat.sensors.camera import require_av  # noqa: E402
from tailbeat.sensors.camera.source import film as filmfile  # noqa: E402
from tailbeat.sensors.camera.source.film import Film, FilmWriter  # noqa: E402
from tailbeat.sensors.camera.source.picture import Image, TimedImage  # noqa: E402

SIZE = (96, 64)
COUNT = 40
TICK = Fraction(1, 90000)
VFR_S = [0.04 * i + 0.007 * (i % 3) for i in range(COUNT)]
B_FRAMES = {"bf": "3", "x264-params": "b-adapt=0:scenecut=0"}
CFR_S = [0.04 * i for i in range(COUNT)]


def painted(index: int, size: tuple[int, int] = SIZE) -> Image:
    """A picture that says which it is: its brightness is 40 + 4 index; and noise, so that files
    have something to hold."""
    noise = np.random.default_rng(index).integers(-4, 5, (size[1], size[0]))
    return (noise + 40 + 4 * index).astype(np.uint8)


def which(image: Image) -> int:
    return round((float(np.mean(image)) - 40) / 4)


def encoded(
    path: Path,
    times_s: Sequence[float],
    codec: str = "libx264",
    pix: str = "yuv420p",
    tick: Fraction = TICK,
    options: dict[str, str] | None = None,
    container: dict[str, str] | None = None,
    sizes: Callable[[int], tuple[int, int]] = lambda _: SIZE,
) -> Path:
    """A film not made by FilmWriter; with B-frames where the codec has them."""
    with av.open(str(path), "w", container_options=container or {}) as out:
        stream = out.add_stream(codec, rate=25, options=options or {})
        stream.thread_count = 1  # the same film on every machine
        stream.width, stream.height = sizes(0)
        stream.pix_fmt = pix
        stream.codec_context.time_base = tick
        stream.codec_context.color_range = 2 if pix.startswith("yuvj") else 0
        for index, t_s in enumerate(times_s):
            frame = av.VideoFrame.from_ndarray(painted(index, sizes(index)), format="gray")
            if pix.startswith("yuvj"):
                frame = full_range(frame, pix)
            frame.pts, frame.time_base = round(t_s / tick), tick
            out.mux(stream.encode(frame))
        out.mux(stream.encode(None))
    return path


def full_range(frame: Any, pix: str) -> Any:
    frame.color_range = 2
    return frame.reformat(format=pix, src_color_range=2, dst_color_range=2)


def written(path: Path, times_s: Sequence[float], size: tuple[int, int] = SIZE) -> Path:
    with FilmWriter(path, size, 25) as film:
        for index, t_s in enumerate(times_s):
            film.add(painted(index, size), t_s)
    return path


def pictures(film: Film) -> tuple[list[TimedImage], InputError | None]:
    """All it gives, and what ended it."""
    found = []
    try:
        while (picture := film.read()) is not None:
            found.append(picture)
    except InputError as error:
        return found, error
    return found, None


def seen(path: Path) -> list[TimedImage]:
    found, error = pictures(Film(path))
    assert error is None, error
    return found


def one_line(error: InputError, *words: str) -> None:
    text = str(error)
    assert "\n" not in text
    assert error.remedy
    assert all(word in text for word in words), text


@pytest.mark.parametrize("times_s", [CFR_S, VFR_S], ids=["even", "uneven"])
@pytest.mark.parametrize(("suffix", "within_s"), [(".mp4", 1e-5), (".mkv", 6e-4)])
def test_stamps_come_back(
    tmp_path: Path, times_s: list[float], suffix: str, within_s: float
) -> None:
    started_s = 12345.678  # a device's clock; a film counts from its first picture
    path = written(tmp_path / f"a{suffix}", [t + started_s for t in times_s])
    film = Film(path)
    assert (film.name, film.clock, film.size_px) == (path.name, "video", SIZE)
    found, error = pictures(film)
    assert error is None
    assert film.ended
    assert film.read() is None
    assert [p.index for p in found] == list(range(COUNT))
    assert [which(p.image) for p in found] == list(range(COUNT))
    assert np.allclose([p.t_s for p in found], times_s, atol=within_s, rtol=0)
    assert film.pictures is not None
    assert abs(film.pictures - COUNT) <= 2
    film.close()


def test_a_stranger_reads_the_same_stamps(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mp4", VFR_S)
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    stamps = []
    while capture.grab():
        stamps.append(capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3)
    capture.release()
    assert np.allclose(stamps, VFR_S, atol=1e-4, rtol=0)
    with av.open(str(path)) as film:
        packets = sorted(float(p.pts * p.time_base) for p in film.demux(video=0) if p.size)
    assert np.allclose(packets, VFR_S, atol=1e-5, rtol=0)


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("b.mp4", {"options": B_FRAMES}),
        ("fragments.mp4", {"container": {"movflags": "frag_keyframe+empty_moov"}}),
        ("b.mov", {"options": B_FRAMES}),
        ("a.ts", {}),
        ("photos.mkv", {"codec": "mjpeg", "pix": "yuvj420p", "tick": Fraction(1, 1000)}),
        ("deep.mkv", {"codec": "ffv1", "pix": "gray16le", "tick": Fraction(1, 1000)}),
    ],
)
def test_films_of_others(tmp_path: Path, name: str, settings: dict[str, Any]) -> None:
    """Reordered pictures, first stamps that are not 0, other containers and pixels."""
    found = seen(encoded(tmp_path / name, VFR_S, **settings))
    assert np.allclose([p.t_s for p in found], VFR_S, atol=6e-4, rtol=0)
    assert [which(p.image) for p in found] == list(range(COUNT))


def test_reordered_pictures_are_in_the_test(tmp_path: Path) -> None:
    path = encoded(tmp_path / "b.mp4", VFR_S, options=B_FRAMES)
    with av.open(str(path)) as film:
        stamps = [packet.pts for packet in film.demux(video=0) if packet.size]
    assert stamps != sorted(stamps)


@pytest.mark.parametrize(
    ("codec", "pix", "low", "high"),
    [
        ("libx264", "yuv420p", 16, 235),
        ("libx264", "yuvj420p", 0, 255),
        ("mjpeg", "yuvj422p", 0, 255),
        ("ffv1", "gray", 0, 255),
        ("ffv1", "yuv420p10le", 16, 235),
    ],
)
def test_brightness(tmp_path: Path, codec: str, pix: str, low: int, high: int) -> None:
    """Black and white come out as 0 and 255 whatever range the file uses, as libav's own
    conversion to grey says too."""
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as out:
        stream = out.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = 256, 32, pix
        ramp = np.tile(np.arange(256, dtype=np.uint8), (32, 1))
        frame = av.VideoFrame.from_ndarray(ramp, format="gray")
        if pix.startswith("yuvj"):
            stream.codec_context.color_range = 2
            frame = full_range(frame, pix)
        out.mux(stream.encode(frame))
        out.mux(stream.encode(None))
    with av.open(str(path)) as film:
        frame = next(film.decode(video=0))
        own = frame.to_ndarray(format="gray")
        if "10" not in pix:
            plane = np.frombuffer(frame.planes[0], np.uint8)[:256]
            assert abs(int(plane.min()) - low) <= 2
            assert abs(int(plane.max()) - high) <= 2
    (picture,) = seen(path)
    assert picture.image.shape == (32, 256)
    assert np.abs(picture.image.astype(int) - own).max() <= 1
    assert np.abs(picture.image.astype(int) - np.arange(256)).max() <= 5
    assert picture.image.flags.writeable


def test_colour(tmp_path: Path) -> None:
    image = np.zeros((64, 96, 3), np.uint8)
    image[:, 48:] = (30, 60, 200)
    path = tmp_path / "a.mp4"
    with FilmWriter(path, (96, 64), 25) as film:
        film.add(image, 0.0)
    with av.open(str(path)) as written:
        picture = next(written.decode(video=0)).to_ndarray(format="bgr24")
    assert picture.shape == (64, 96, 3)
    assert np.abs(picture[10, 80].astype(int) - (30, 60, 200)).max() <= 4
    grey = Film(path).read()
    assert grey is not None
    luma = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    assert np.abs(grey.image[10:50, 60:90].astype(int) - luma[10:50, 60:90]).max() <= 2


@pytest.mark.parametrize("size", [(95, 64), (96, 63), (95, 63), (1, 1)])
def test_odd_sizes_keep_their_size(tmp_path: Path, size: tuple[int, int]) -> None:
    path = written(tmp_path / "a.mp4", CFR_S[:5], size)
    film = Film(path)
    assert film.size_px == size
    found, error = pictures(film)
    assert error is None
    assert [p.image.shape for p in found] == [(size[1], size[0])] * 5


@pytest.mark.parametrize("pix", ["yuv420p", "yuvj420p"])
def test_pictures_are_the_holders(tmp_path: Path, pix: str) -> None:
    """Scribbling on one changes no other, nor what the decoder predicts from."""
    path = encoded(tmp_path / "a.mp4", CFR_S, pix=pix, options=B_FRAMES)
    film = Film(path)
    kept = []
    while (picture := film.read()) is not None:
        kept.append(picture.image.copy())
        picture.image[:] = 0
    assert [which(image) for image in kept] == list(range(COUNT))


@pytest.mark.parametrize(
    "times_s", [(0.0, 0.04, 0.04), (0.0, 0.04, 0.02), (1.0, float("nan")), (0.0, 1e-6)]
)
def test_writer_wants_rising_times(tmp_path: Path, times_s: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match=r"a\.mp4: a picture at"):
        written(tmp_path / "a.mp4", times_s)
    assert list(tmp_path.iterdir()) == []


def test_matroska_tells_milliseconds_apart(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a\.mkv: a picture at"):
        written(tmp_path / "a.mkv", (0.0, 3e-4))


def test_writer_leaves_all_or_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    path.write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt), FilmWriter(path, SIZE, 25) as film:
        film.add(painted(0), 0.0)
        raise KeyboardInterrupt
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]
    film = FilmWriter(path, SIZE, 25)
    film.add(painted(0), 0.0)
    assert path.read_bytes() == b"old"
    film.close()
    film.close()
    assert [which(p.image) for p in seen(path)] == [0]
    with FilmWriter(tmp_path / "none.mp4", SIZE, 25):
        pass
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]


def test_writer_refuses(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot write a film as a\.gif"):
        FilmWriter(tmp_path / "a.gif", SIZE, 25)
    with pytest.raises(InputError, match=r"cannot write .*No such file or directory"):
        FilmWriter(tmp_path / "no" / "a.mp4", SIZE, 25)
    with (
        pytest.raises(InputError, match="a picture of 64 x 96 in a film of 96 x 64"),
        FilmWriter(tmp_path / "a.mp4", SIZE, 25) as film,
    ):
        film.add(painted(0, (64, 96)), 0.0)
    assert list(tmp_path.iterdir()) == []


def test_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("no /dev/full here")
    path = tmp_path / "a.mp4"
    part = tmp_path / "part"
    part.symlink_to(full)
    monkeypatch.setattr(filmfile, "temporary_beside", lambda _: part)
    with pytest.raises(InputError, match=r"cannot write .*a\.mp4 \(No space left"):
        written(path, CFR_S)
    assert list(tmp_path.iterdir()) == []


def sound(path: Path) -> Path:
    with av.open(str(path), "w") as out:
        stream = out.add_stream("aac", rate=44100)
        frame = av.AudioFrame(format="fltp", layout="mono", samples=1024)
        frame.planes[0].update(bytes(4 * 1024))
        frame.sample_rate = 44100
        out.mux(stream.encode(frame))
        out.mux(stream.encode(None))
    return path


def text(path: Path) -> Path:
    path.write_text("t_s,x_m\n0,0\n" * 300)
    return path


def photo(path: Path) -> Path:
    cv2.imwrite(str(path), painted(3))
    return path


def unfinished(path: Path) -> Path:
    data = encoded(path, CFR_S).read_bytes()
    path.write_bytes(data[: data.index(b"moov")])
    return path


def touched(path: Path) -> Path:
    path.touch()
    return path


@pytest.mark.parametrize(
    ("name", "make", "words"),
    [
        ("a.mp4", lambda path: path, "there is no film"),
        ("a.mp4", lambda path: path.mkdir() or path, "is a folder, no film"),
        ("a.mp4", touched, "is empty"),
        ("a.mp4", text, "is no video"),
        ("a.txt", text, "holds no video"),
        ("a.png", photo, "holds no video"),
        ("a.mp4", sound, "holds sound only"),
        ("a.mp4", unfinished, "has no index: the recording was not finished"),
    ],
)
def test_what_is_no_film(
    tmp_path: Path, name: str, make: Callable[[Path], Path], words: str
) -> None:
    with pytest.raises(InputError) as caught:
        Film(make(tmp_path / name))
    one_line(caught.value, words, name)


def test_no_stamps(tmp_path: Path) -> None:
    found, error = pictures(Film(encoded(tmp_path / "a.h264", CFR_S)))
    assert found == []
    assert error is not None
    one_line(error, "a.h264 has no time stamp at picture 0", ".mp4")


def test_stamps_that_do_not_rise(tmp_path: Path) -> None:
    """AVI has no room for the order of B-frames."""
    path = encoded(tmp_path / "a.avi", CFR_S, options=B_FRAMES, tick=Fraction(1, 25))
    film = Film(path)
    found, error = pictures(film)
    assert error is not None
    one_line(error, f"a.avi goes back in time at picture {len(found)}")
    assert film.ended
    assert film.read() is None


def cut(path: Path, bytes_kept: int) -> Path:
    part = path.with_name("cut_" + path.name)
    with path.open("rb") as whole:
        part.write_bytes(whole.read(bytes_kept))
    return part


FORMATS: list[tuple[str, dict[str, Any]]] = [
    ("a.mp4", {"container": {"movflags": "faststart"}}),
    ("end.mp4", {}),
    ("fragments.mp4", {"container": {"movflags": "frag_keyframe+empty_moov"}}),
    ("a.mkv", {"tick": Fraction(1, 1000)}),
    ("a.ts", {}),
    (
        "a.avi",
        {"codec": "mjpeg", "pix": "yuvj420p", "tick": Fraction(1, 25), "options": {"qmin": "20"}},
    ),
]


@pytest.mark.parametrize(("name", "settings"), FORMATS, ids=[name for name, _ in FORMATS])
def test_cut_films(tmp_path: Path, name: str, settings: dict[str, Any]) -> None:
    """Cut anywhere: what comes is of the whole film, with its stamps; then one line. A format that
    tells its length never passes for whole, but for its last picture."""
    path = encoded(tmp_path / name, CFR_S if name == "a.avi" else VFR_S, **settings)
    whole = {which(p.image): p.t_s for p in seen(path)}
    bytes_ = path.stat().st_size
    assert bytes_ < 50_000
    tells = name not in ("fragments.mp4", "a.ts")
    some = 0
    for kept in [*range(0, bytes_, bytes_ // 70), *range(bytes_ - 12, bytes_)]:
        try:
            found, error = pictures(Film(cut(path, kept)))
        except InputError as refused:
            one_line(refused)
            continue
        assert [p.index for p in found] == list(range(len(found)))
        first_s = whole[which(found[0].image)] if found else 0.0
        for picture in found:
            assert picture.t_s == pytest.approx(whole[which(picture.image)] - first_s, abs=1e-9)
        if error is not None:
            one_line(error, "cut_" + name)
            some += len(found) > 0
            if found:
                stamp = f"after picture {len(found) - 1} ({found[-1].t_s:.1f} s)"
                one_line(error, "is damaged", stamp, "Copy it")
        elif tells:
            assert len(found) >= COUNT - 1
    assert some >= 10 or name in ("end.mp4", "a.ts")


def test_all_before_a_cut(tmp_path: Path) -> None:
    """No picture is missing in between, and none before but a few that the decoder holds back."""
    settings: dict[str, Any] = {"options": B_FRAMES, "container": {"movflags": "faststart"}}
    path = encoded(tmp_path / "a.mp4", VFR_S, **settings)
    with av.open(str(path)) as film:
        ends = sorted(packet.pos + packet.size for packet in film.demux(video=0) if packet.size)
    for count in (8, 15, 21, COUNT - 1):
        for more in (1, ends[count] - ends[count - 1] - 1):
            found, error = pictures(Film(cut(path, ends[count - 1] + more)))
            assert error is not None
            assert count - 5 <= len(found) <= count
            assert [which(p.image) for p in found] == list(range(len(found)))


def test_flipped_bits(tmp_path: Path) -> None:
    """One bit of a film's pictures is wrong: no picture is given that shows something else, as a
    decoder gives that hides the damage, nor with another's stamp. (Some flips leave a film that is
    as good as the old, or without one picture.)"""
    path = encoded(tmp_path / "a.mp4", VFR_S, options={"g": "10"})
    whole = {p.t_s: p.image.astype(int) for p in seen(path)}
    data = path.read_bytes()
    begin, end = data.index(b"mdat") + 900, data.index(b"moov") - 4
    rng = np.random.default_rng(7)
    refused = 0
    for place in rng.integers(begin, end, 60):
        spoilt = bytearray(data)
        spoilt[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(spoilt)
        found, error = pictures(Film(path))
        refused += error is not None
        for picture in found:
            good = whole[picture.t_s]
            assert np.abs(picture.image.astype(int) - good).max() <= 30
        assert error is not None or len(found) >= COUNT - 1
    assert refused > 20


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv"])
def test_scratched_films(tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]) -> None:
    """A hundred bytes in the middle are gone: what comes before is good, nothing comes after, and
    libav says nothing of its own."""
    settings: dict[str, Any] = {"options": {"g": "10"}}
    path = encoded(tmp_path / name, VFR_S, **settings)
    whole = [(which(p.image), p.t_s) for p in seen(path)]
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 100] = bytes(100)
    path.write_bytes(data)
    found, error = pictures(Film(path))
    assert error is not None
    one_line(error, f"is damaged after picture {len(found) - 1}")
    assert 5 <= len(found) < COUNT - 5
    stamps = dict(whole)
    assert all(p.t_s == pytest.approx(stamps[which(p.image)], abs=1e-9) for p in found)
    assert capfd.readouterr() == ("", "")


def test_a_beginning_in_mid_stream(tmp_path: Path) -> None:
    """Films cut out of others begin with pictures that need one before: they are skipped."""
    path = encoded(tmp_path / "a.ts", CFR_S, options={"g": "10", "bf": "0"})
    data = path.read_bytes()
    begin = len(data) // 188 // 3 * 188
    part = tmp_path / "part.ts"
    part.write_bytes(data[: 3 * 188] + data[begin:])
    found, error = pictures(Film(part))
    assert error is None
    numbers = [which(p.image) for p in found]
    assert 5 < len(numbers) < COUNT
    assert numbers == list(range(numbers[0], COUNT))
    assert np.allclose([p.t_s for p in found], [0.04 * i for i in range(len(found))], atol=1e-4)


def test_without_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "a.mp4", CFR_S[:3])
    monkeypatch.setitem(__import__("sys").modules, "av", None)
    monkeypatch.setattr("tailbeat.sensors.camera.source.film.av", LazyModule("av", require_av))
    with pytest.raises(InputError, match=r"needs PyAV.*tools/bootstrap camera"):
        Film(path)


def test_names_with_odd_letters(tmp_path: Path) -> None:
    folder = tmp_path / "ein Ordner: ü%d"
    folder.mkdir()
    path = written(folder / "swim #1 %03d.mp4", CFR_S[:3])
    assert len(seen(path)) == 3
    shutil.rmtree(folder)
