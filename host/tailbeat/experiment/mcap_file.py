"""A whole experiment as one MCAP file: all trials, and the films that lie in its folder.

MCAP (https://mcap.dev) is the file format of Foxglove; ROS 2 reads it, too. Messages are JSON with
a JSON schema. Log times are wall-clock times (``wall_clock``).
"""

from __future__ import annotations

import heapq
import json
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from tailbeat.core import ulog
from tailbeat.core.csv import read_rows
from tailbeat.core.errors import InputError, reason
from tailbeat.core.extras import need
from tailbeat.core.files import canonical, plain, replacing
from tailbeat.core.trial_file import Trial
from tailbeat.experiment.analysis import Analysis, round_to
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.mcap_film import SCHEMAS, ExperimentFilm, films_of, pictures
from tailbeat.experiment.trial_rows import TrialRow
from tailbeat.experiment.units import units_of
from tailbeat.experiment.wall_clock import TrialStart, starts_of
from tailbeat.link.params import known_parameters

MCAP_NEEDS = "Writing MCAP files needs the package mcap"
_LIBRARY = "tailbeat"
_INFO, _WARNING, _ERROR = 2, 3, 4
_LOG = "foxglove.Log"
_TIMED = ("trial", "iteration", "t_s")
Values = dict[str, Any]


@dataclass(frozen=True)
class _Swum:
    """A trial and what its messages need. ``raw``: the folder with its files."""

    trial: Trial
    row: TrialRow
    start: TrialStart
    raw: Path


@dataclass(frozen=True)
class Topic:
    """Messages of one kind.

    Attributes
    ----------
    name, schema : str
        Name of the topic and of its schema.
    fields : dict of str to str
        JSON type of each field; the unit is the last part of the name.
    rows : callable
        The messages of one trial, each with its time in s from the begin of the trial.
    """

    name: str
    schema: str
    fields: dict[str, str]
    rows: Callable[[_Swum], Iterator[tuple[float, Values]]]


@dataclass(order=True)
class _Message:
    """Sorted by time, then by topic."""

    utc_ns: int
    topic: str
    values: Values = field(compare=False)


def write_mcap(experiment: Experiment, analysis: Analysis, path: Path) -> None:
    """Write all trials and films of an experiment, the same bytes each time.

    Parameters
    ----------
    experiment : Experiment
        The experiment.
    analysis : Analysis
        Of the same experiment.
    path : Path
        The file. Films are copied picture by picture: memory does not grow with them.

    Raises
    ------
    InputError
        The package mcap is missing, or PyAV while there is a film, or the disk is full.
    """
    writer = need("mcap.writer", "export", MCAP_NEEDS)
    starts = starts_of(experiment, analysis)
    films = films_of(experiment, analysis, starts)
    try:
        with replacing(path) as file:
            out = writer.Writer(file)
            out.start(profile="", library=_LIBRARY)
            _add_metadata(out, analysis, starts, films)
            _add_attachments(out, analysis, starts)
            channels = _channels(out, films)
            sequence = dict.fromkeys(channels, 0)
            sources = [_trial_messages(experiment, analysis, starts), *map(_film_messages, films)]
            for message in heapq.merge(*sources):
                out.add_message(
                    channel_id=channels[message.topic],
                    log_time=message.utc_ns,
                    publish_time=message.utc_ns,
                    data=_json(message.values),
                    sequence=sequence[message.topic],
                )
                sequence[message.topic] += 1
            out.finish()
    except OSError as error:
        raise InputError(
            f"cannot write {path} ({reason(error)}).",
            "Make room on this computer, or choose another folder.",
        ) from error


def _json(values: Values) -> bytes:
    """Floats have nine digits; what is unknown is left out."""
    known = {
        key: round_to(value) if isinstance(value, float) else value
        for key, value in plain(values).items()
        if value is not None
    }
    return json.dumps(known, separators=(",", ":"), allow_nan=False).encode("ascii")


def _stamp(utc_ns: int) -> dict[str, int]:
    sec, nsec = divmod(utc_ns, 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


def _trial_messages(
    experiment: Experiment, analysis: Analysis, starts: list[TrialStart]
) -> Iterator[_Message]:
    """One trial after the other."""
    for trial, row, start in zip(analysis.trials, analysis.rows, starts, strict=True):
        one = _Swum(trial, row, start, experiment.raw)
        messages = [
            _Message(start.utc_ns + round(t_s * 1e9), topic.name, _timed(topic, one, t_s, values))
            for topic in TOPICS
            for t_s, values in topic.rows(one)
        ]
        yield from sorted(messages)


def _timed(topic: Topic, one: _Swum, t_s: float, values: Values) -> Values:
    if topic.schema == _LOG:
        return {"timestamp": _stamp(one.start.utc_ns + round(t_s * 1e9)), **values}
    said = {"trial": one.trial.number, "iteration": one.trial.iteration, "t_s": round(t_s, 6)}
    return said | values


def _film_messages(film: ExperimentFilm) -> Iterator[_Message]:
    for t_ns, data in pictures(film):
        utc_ns = film.begin_ns + t_ns
        values = {"timestamp": _stamp(utc_ns), "frame_id": film.path.name, **data}
        yield _Message(utc_ns, film.topic, values)


def _beats(one: _Swum) -> Iterator[tuple[float, Values]]:
    table = one.trial.beats.table()
    for beat, row in enumerate(zip(*table.values(), strict=True)):
        yield (beat + 0.5) * one.trial.beat_s, {"beat": beat, **dict(zip(table, row, strict=True))}


def _slots(*names: str) -> Callable[[_Swum], Iterator[tuple[float, Values]]]:
    def rows(one: _Swum) -> Iterator[tuple[float, Values]]:
        table = one.trial.slots.table()
        for row in zip(table["t_s"], *(table[name] for name in names), strict=True):
            if row[1] == row[1]:  # NaN: unknown in this slot
                yield float(row[0]), dict(zip(names, row[1:], strict=True))

    return rows


def _positions(one: _Swum) -> Iterator[tuple[float, Values]]:
    """What a camera saw while the fish swam, if there was one."""
    path = one.raw / f"{Path(one.row.file).stem}_positions.csv"
    if path.is_file():
        for _, cells in read_rows(path, ("t_s", *_POSITION)):
            t_s, *place = map(float, cells)
            yield t_s, dict(zip(_POSITION, place, strict=True))


def _battery(one: _Swum) -> Iterator[tuple[float, Values]]:
    for t_s, voltage_v in one.trial.battery_v:
        yield t_s, {"voltage_v": round(voltage_v, 6)}


def _parameters(one: _Swum) -> Iterator[tuple[float, Values]]:
    yield 0.0, dict(one.trial.params)


def _log(one: _Swum) -> Iterator[tuple[float, Values]]:
    """What the board wrote, and begin, end and decision."""
    trial, row = one.trial, one.row
    made = f", input: {trial.input}" if trial.input else ""
    yield 0.0, _line(f"trial {trial.number} begins, iteration {trial.iteration}{made}", _INFO)
    for record in ulog.records((one.raw / row.file).read_bytes()):
        if record.kind == b"L":
            (time_us,) = struct.unpack_from("<Q", record.body, 1)
            text = record.body[9:].decode("utf-8", "replace")
            yield (time_us - trial.start_us) * 1e-6, _line(text, _INFO)
    level = _ERROR if trial.end.startswith("fault") else _WARNING
    level = _INFO if trial.end == "complete" else level
    end_s = trial.executed_beats * trial.beat_s
    decision = f", decision: {row.decision}" if row.decision else ""
    reason = f" ({row.reason})" if row.reason else ""
    yield end_s, _line(f"trial {trial.number} ends: {trial.end}{decision}{reason}", level)


def _line(text: str, level: int) -> Values:
    return {"level": level, "message": text, "name": "tailbeat", "file": "", "line": 0}


_BEAT = {
    "beat": "integer",
    "amplitude_rad": "number",
    "applied_rad": "number",
    "reference_m_s": "number",
    "speed_m_s": "number",
    "sigma_m_s": "number",
    "error_m_s": "number",
    "samples": "integer",
}
_SPEED = {"v_m_s": "number", "sigma_m_s": "number", "samples": "integer"}
_POSITION = {"x_m": "number", "y_m": "number", "heading_rad": "number"}
_IMU = {"gain_m_s": "number", "turn_rad": "number"}
TOPICS = (
    Topic("/trial/beats", "tailbeat.Beat", _BEAT, _beats),
    Topic("/trial/speed", "tailbeat.Speed", _SPEED, _slots(*_SPEED)),
    Topic("/trial/position", "tailbeat.Position", _POSITION, _positions),
    Topic("/trial/imu", "tailbeat.ImuSlot", _IMU, _slots(*_IMU)),
    Topic("/trial/battery", "tailbeat.Battery", {"voltage_v": "number"}, _battery),
    Topic("/trial/parameters", "tailbeat.Parameters", {}, _parameters),
    Topic("/trial/log", _LOG, {}, _log),
)


def _channels(out: Any, films: list[ExperimentFilm]) -> dict[str, int]:
    """Id of the channel of each topic."""
    schemas: dict[str, int] = {}
    channels = {}
    kinds = [(one.name, one.schema, _schema(one), _units(one)) for one in TOPICS]
    kinds += [(film.topic, film.schema, SCHEMAS[film.schema], {}) for film in films]
    for name, title, schema, units in kinds:
        if title not in schemas:
            schemas[title] = out.register_schema(title, "jsonschema", canonical(schema))
        channels[name] = out.register_channel(name, "json", schemas[title], units)
    return channels


def _fields(topic: Topic) -> dict[str, str]:
    if topic.schema == "tailbeat.Parameters":
        return dict.fromkeys(known_parameters(), "number")
    return topic.fields


def _units(topic: Topic) -> dict[str, str]:
    """``unit_FIELD`` to unit, for the channel's metadata."""
    known = known_parameters()
    units = {name: one.unit for name, one in known.items() if one.unit and name in _fields(topic)}
    units |= units_of((*_TIMED, *topic.fields)) if topic.schema != _LOG else {}
    return {f"unit_{name}": unit for name, unit in sorted(units.items())}


def _schema(topic: Topic) -> Values:
    """A JSON schema; the description of a field is its unit."""
    if topic.schema == _LOG:
        return SCHEMAS[_LOG]
    kinds = {"trial": "integer", "iteration": "integer", "t_s": "number", **_fields(topic)}
    units = {key.removeprefix("unit_"): unit for key, unit in _units(topic).items()}
    properties = {
        name: {"type": kind} | ({"description": units[name]} if name in units else {})
        for name, kind in kinds.items()
    }
    return {"title": topic.schema, "type": "object", "properties": properties}


def _add_metadata(
    out: Any, analysis: Analysis, starts: list[TrialStart], films: list[ExperimentFilm]
) -> None:
    names = ("name", "fish", "law", "board", "unique_id", "reference_name", "simulated")
    about = {name: getattr(analysis, name) for name in names}
    about |= {"reference_crc": f"{analysis.reference_crc:08x}"} | {
        f"condition_{key}": value for key, value in analysis.conditions.items()
    }
    out.add_metadata("experiment", _texts(about))
    for row, start in zip(analysis.rows, starts, strict=True):
        told = {
            **{key: getattr(row, key) for key in ("trial", "iteration", "file", "end", "decision")},
            "reason": row.reason,
            "max_abs_error_m_s": f"{row.max_abs_error_m_s:.9g}",
            "begin_utc": datetime.fromtimestamp(start.utc_ns / 1e9, UTC).isoformat(),
            "time_source": start.source,
            "time_shift_s": f"{start.shift_s:.3f}",
        }
        out.add_metadata(f"trial {Path(row.file).stem}", _texts(told))
    for film in films:
        told = {"topic": film.topic, "trial": film.trial, "time_source": film.source}
        out.add_metadata(f"film {film.path.name}", _texts(told))


def _texts(values: Values) -> dict[str, str]:
    return {key: str(value) for key, value in sorted(values.items())}


def _add_attachments(out: Any, analysis: Analysis, starts: list[TrialStart]) -> None:
    """The reference as 'reference upload' reads it, and the last trial's parameters."""
    known = known_parameters()
    parameters = {
        name: {
            "value": value,
            "default": known[name].default if name in known else None,
            "unit": known[name].unit if name in known else "",
        }
        for name, value in analysis.trials[-1].params.items()
    }
    files = {
        "reference.csv": ("text/csv", analysis.reference.csv_text().encode()),
        "parameters.json": ("application/json", canonical(parameters)),
    }
    for name, (kind, content) in files.items():
        out.add_attachment(
            create_time=0, log_time=starts[0].utc_ns, name=name, media_type=kind, data=content
        )
