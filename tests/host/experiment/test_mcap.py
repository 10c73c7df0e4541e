"""An experiment as MCAP: a reader opens all of it, with wall-clock times and the films."""

from __future__ import annotations

import base64
import json
import shutil
import threading
import time
import tracemalloc
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from mcap.reader import make_reader

from tailbeat.board.fish import Fish
from tailbeat.core.reference import Reference, from_csv
from tailbeat.core.trial_file import read_trial
from tailbeat.experiment import mcap_film
from tailbeat.experiment.analysis import analyse
from tailbeat.experiment.current import make
from tailbeat.experiment.export import export
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.mcap_file import TOPICS, write_mcap
from tailbeat.experiment.wall_clock import BY_HOST, UNKNOWN, WHEN_STORED, starts_of
from tailbeat.sensors.camera.source.film import FilmWriter
from tailbeat.session.log import SessionLog
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard
from tailbeat.sim.server import SimServer

from ..swum_experiment import BEATS, REFERENCE, swim_experiment

TYPES = {"integer": int, "number": (int, float), "string": str, "object": dict}
PICTURES, FPS, SIZE_PX = 10, 5.0, (64, 48)
Messages = dict[str, list[tuple[int, dict[str, Any]]]]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    return swim_experiment(tmp_path_factory.mktemp("mcap"))


@pytest.fixture
def copy(recorded: Experiment, tmp_path: Path) -> Experiment:
    return Experiment(Path(shutil.copytree(recorded.folder, tmp_path / "copy")))


def read(path: Path) -> Messages:
    """All messages by topic; each fits the schema in the file."""
    found: Messages = defaultdict(list)
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            properties = json.loads(schema.data)["properties"]
            values = json.loads(message.data)
            for name, value in values.items():
                assert isinstance(value, TYPES[properties[name]["type"]]), (channel.topic, name)
            found[channel.topic].append((message.log_time, values))
    return found


def metadata(path: Path) -> dict[str, dict[str, str]]:
    with path.open("rb") as file:
        return {one.name: one.metadata for one in make_reader(file).iter_metadata()}


def test_a_reader_opens_the_whole_experiment(recorded: Experiment, tmp_path: Path) -> None:
    (path,) = export(recorded, ["mcap"], tmp_path)
    found = read(path)
    assert set(found) == {topic.name for topic in TOPICS} - {"/trial/position"}
    beats = [values for _, values in found["/trial/beats"]]
    assert [(one["trial"], one["beat"]) for one in beats] == [
        (trial, beat) for trial in range(1, 7) for beat in range(BEATS)
    ]
    for number in range(1, 7):
        trial = read_trial(recorded.raw / f"{number:04d}.ulg")
        mine = [one["speed_m_s"] for one in beats if one["trial"] == number]
        assert np.array(mine, np.float32).tobytes() == trial.beats.speed_m_s.tobytes()
    imu = read_trial(recorded.raw / "0002.ulg").slots.table()["gain_m_s"]
    mine = [v["gain_m_s"] for _, v in found["/trial/imu"] if v["trial"] == 2]
    assert len(mine) == np.isfinite(imu).sum() > 0
    assert len(found["/trial/parameters"]) == 6
    assert found["/trial/parameters"][0][1]["AMP_MAX_RAD"] == pytest.approx(0.785)
    lines = [values["message"] for _, values in found["/trial/log"]]
    assert "trial 3 ends: complete, decision: discard (bumped the wall)" in lines


def test_positions_of_a_camera(copy: Experiment, tmp_path: Path) -> None:
    rows = "t_s,x_m,y_m,heading_rad\n0.04,0.1,0.01,0.0\n0.08,0.12,0.01,0.1\n"
    copy.add_raw("0002_positions.csv", rows.encode())
    found = read(export(copy, ["mcap"], tmp_path)[0])["/trial/position"]
    assert [(v["trial"], v["t_s"], v["x_m"]) for _, v in found] == [(2, 0.04, 0.1), (2, 0.08, 0.12)]


def test_units_metadata_and_attachments(recorded: Experiment, tmp_path: Path) -> None:
    (path,) = export(recorded, ["mcap"], tmp_path)
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        files = {one.name: one.data for one in reader.iter_attachments()}
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.attachment_count == 2
    units = {one.topic: one.metadata for one in summary.channels.values()}
    assert units["/trial/beats"]["unit_speed_m_s"] == "m/s"
    assert units["/trial/parameters"]["unit_AMP_MAX_RAD"] == "rad"
    (tmp_path / "reference.csv").write_bytes(files["reference.csv"])
    assert from_csv(tmp_path / "reference.csv").crc == REFERENCE.crc
    assert json.loads(files["parameters.json"])["ILC_GAIN"] == {
        "value": 4.0, "default": 4.0, "unit": "rad s/m",
    }  # fmt: skip
    told = metadata(path)
    assert told["experiment"]["condition_water_temperature_degc"] == "21.5"
    assert told["trial 0003"]["decision"] == "discard"
    assert told["trial 0003"]["time_source"] == WHEN_STORED


def test_the_same_bytes_each_time(copy: Experiment, tmp_path: Path) -> None:
    film(copy.folder / "swim1.mp4")
    first = export(copy, ["mcap"], tmp_path / "a")[0].read_bytes()
    assert export(copy, ["mcap"], tmp_path / "b")[0].read_bytes() == first
    moved = Experiment(copy.folder.rename(copy.folder.parent / "moved"))
    assert export(moved, ["mcap"], tmp_path / "c")[0].read_bytes() == first


def test_trials_do_not_overlap(recorded: Experiment) -> None:
    """A simulated board swims much faster than the wall clock."""
    found = analyse(recorded)
    starts = starts_of(recorded, found)
    for before, after in pairwise(starts):
        assert after.utc_ns - before.utc_ns >= BEATS * 1e9
    assert starts[0].shift_s == 0 < starts[1].shift_s
    assert starts[0].source == WHEN_STORED
    assert not any(start.known for start in starts)


def test_without_an_event_log_the_time_is_unknown(copy: Experiment) -> None:
    (copy.folder / "journal.jsonl").unlink()
    starts = starts_of(copy, analyse(copy))
    assert {start.source for start in starts} == {UNKNOWN}
    assert not any(start.known for start in starts)


@pytest.fixture(scope="module")
def timed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Experiment, float]:
    """A trial of a board that runs in real time, logged as a session does it; and when its second
    beat was seen to begin, by this computer's clock."""
    server = SimServer(SimBoard("tank"), "tcp:127.0.0.1:0", False, 1.0)
    stop = threading.Event()
    thread = threading.Thread(target=server.serve, args=(stop.is_set,))
    thread.start()
    try:
        with Fish.connect(server.addresses.listen) as fish:
            return _timed(fish, tmp_path_factory.mktemp("timed"))
    finally:
        stop.set()
        thread.join()
        server.close()


def _timed(fish: Fish, root: Path) -> tuple[Experiment, float]:
    short = Reference(0.5, np.array([0.02, 0.03, 0.02], np.float32), "short")
    fish.params.set("SETTLE_S", 2.0)
    fish.upload_reference(short)
    experiment = make(fish, root, short, "carangi")
    log = SessionLog(experiment)
    reported: list[float] = []

    def hear(message: Any) -> None:
        if message.beat == 1:
            reported.append(time.time())

    fish.link.subscribe(hear, ["TAILBEAT_LIVE"])
    fish.arm()
    log.begun(1, 1, None, 8.0, fish.clock.now_s())
    outcome = run_trial(fish)
    kept = experiment.keep_trial(fish.pull_trial(outcome.number, root))
    experiment.journal.add("swum", trial=1, iteration=1, end=outcome.end, file=kept.name)
    experiment.journal.add("learned", **asdict(fish.learn(1)))
    return experiment, reported[0]


def test_wall_time_within_a_second(timed: tuple[Experiment, float], tmp_path: Path) -> None:
    experiment, reported_s = timed
    (path,) = export(experiment, ["mcap"], tmp_path)
    found = read(path)
    begin_s = found["/trial/log"][0][0] * 1e-9
    assert begin_s + 0.5 == pytest.approx(reported_s, abs=0.5)  # five reports a second
    told = metadata(path)["trial 0001"]
    assert (told["time_source"], told["time_shift_s"]) == (BY_HOST, "0.000")


def test_an_older_event_log_has_whole_seconds(timed: tuple[Experiment, float]) -> None:
    experiment, _ = timed
    path = experiment.folder / "journal.jsonl"
    entries = [json.loads(line) for line in path.read_text().splitlines()]
    exact = starts_of(experiment, analyse(experiment))[0]
    older = [{k: v for k, v in one.items() if k != "utc_s"} for one in entries]
    path.write_text("".join(json.dumps(one) + "\n" for one in older))
    rounded = starts_of(experiment, analyse(experiment))[0]
    path.write_text("".join(json.dumps(one) + "\n" for one in entries))
    assert abs(rounded.utc_ns - exact.utc_ns) <= 0.5e9 + 1e6
    assert exact.known and rounded.known


def image(at: int) -> Any:
    picture = np.full((SIZE_PX[1], SIZE_PX[0], 3), 90, np.uint8)
    picture[10:30, 4 * at : 4 * at + 12] = (20, 200, 240)
    return picture


def film(path: Path) -> Path:
    path.parent.mkdir(exist_ok=True)
    with FilmWriter(path, SIZE_PX, FPS) as writer:
        for at in range(PICTURES):
            writer.add(image(at), at / FPS)
    return path


def film_of(path: Path, codec: str, **options: str) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=int(FPS), options=options)
        stream.width, stream.height = SIZE_PX
        stream.pix_fmt = "yuv420p"
        for at in range(PICTURES):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image(at), format="bgr24")))
        container.mux(stream.encode(None))
    return path


def decoded(messages: list[tuple[int, dict[str, Any]]], kind: str) -> Iterator[Any]:
    """As a viewer does it: each message alone into the decoder."""
    decoder = av.CodecContext.create(kind, "r")
    packets = [av.Packet(base64.b64decode(values["data"])) for _, values in messages]
    for packet in [*packets, None]:
        for frame in decoder.decode(packet):
            yield frame.to_ndarray(format="bgr24")


def test_a_film_is_a_video_topic(copy: Experiment, tmp_path: Path) -> None:
    path = film(copy.folder / "day.mp4")
    summary = {"trial": 2, "sync": {"start_s": 0.4}}
    path.with_suffix("").mkdir()
    (path.with_suffix("") / "summary.json").write_text(json.dumps(summary))
    found = read(export(copy, ["mcap"], tmp_path)[0])
    video = found["/film/day"]
    assert len(video) == PICTURES
    assert {values["format"] for _, values in video} == {"h264"}
    start = starts_of(copy, analyse(copy))[1].utc_ns
    expected = [start - 0.4e9 + at * 1e9 / FPS for at in range(PICTURES)]
    assert [at for at, _ in video] == pytest.approx(expected, abs=1e6)
    pictures = list(decoded(video, "h264"))
    for at, picture in enumerate(pictures):
        assert np.abs(picture.astype(float) - image(at)).mean() < 6
    told = metadata(tmp_path / "experiment.mcap")["film day.mp4"]
    assert told == {"topic": "/film/day", "trial": "2", "time_source": mcap_film.SYNCHRONISED}


def test_memory_does_not_grow_with_a_film(
    copy: Experiment, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    film(copy.folder / "long.mp4")
    noise = np.random.default_rng(1).bytes(500_000)

    def many(_: object) -> Iterator[tuple[int, dict[str, str]]]:
        for at in range(100):
            yield at * 40_000_000, {"format": "h264", "data": base64.b64encode(noise).decode()}

    monkeypatch.setattr("tailbeat.experiment.mcap_file.pictures", many)
    found = analyse(copy)
    tracemalloc.start()
    write_mcap(copy, found, tmp_path / "long.mcap")
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (tmp_path / "long.mcap").stat().st_size > 20e6
    assert peak_bytes < 12e6


@pytest.mark.parametrize(("codec", "options"), [("mpeg4", {}), ("libx264", {"bf": "2"})])
def test_other_films_become_pictures(
    copy: Experiment, tmp_path: Path, codec: str, options: dict[str, str]
) -> None:
    """MPEG-4, and H.264 with B-frames, which Foxglove does not show."""
    (copy.folder / "films").mkdir()
    film_of(copy.folder / "films" / "swim_03.mp4", codec, **options)
    found = read(export(copy, ["mcap"], tmp_path)[0])
    pictures = found["/film/swim_03"]
    assert [values["format"] for _, values in pictures] == ["jpeg"] * PICTURES
    assert pictures[0][0] == starts_of(copy, analyse(copy))[2].utc_ns
    assert all(base64.b64decode(values["data"])[:2] == b"\xff\xd8" for _, values in pictures)
    told = metadata(tmp_path / "experiment.mcap")["film swim_03.mp4"]
    assert told["time_source"] == mcap_film.BY_NAME
