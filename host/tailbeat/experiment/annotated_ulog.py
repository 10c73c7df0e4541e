"""A trial's log with what only the host knows: units, default parameters, wall-clock time.

The files in ``raw/`` stay as the board wrote them. The copy holds the same records and more:
``unit_TOPIC_FIELD`` for each field with a unit, the default of each parameter, ``start_utc_us`` and
``time_ref_utc`` (offset of the local time, s), the topic ``clock`` (``time_utc_usec``) and the
topic ``slot_si``: the slots in SI units, NaN where nothing is known. In ``slot`` the speed of a
slot without samples is NaN.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

from tailbeat.core import ulog
from tailbeat.core.param_names import current_name
from tailbeat.core.trial_file import Trial
from tailbeat.core.ulog import Record
from tailbeat.experiment.units import units_of
from tailbeat.experiment.wall_clock import TrialStart
from tailbeat.link.params import known_parameters

SLOT_SI, CLOCK = "slot_si", "clock"
_IDS = {SLOT_SI: 100, CLOCK: 101}  # the board's begin with 0
_SLOT_SI = {
    "timestamp": "uint64_t",
    "t_s": "float",
    "v_m_s": "float",
    "sigma_m_s": "float",
    "gain_m_s": "float",
    "turn_rad": "float",
    "samples": "float",
}
_CLOCK = {"timestamp": "uint64_t", "time_utc_usec": "uint64_t"}
_NAN = struct.pack("<f", math.nan)


@dataclass
class _Definitions:
    """What a board's definitions say."""

    topics: dict[str, dict[str, str]] = field(default_factory=dict)
    ids: dict[str, int] = field(default_factory=dict)
    parameters: list[str] = field(default_factory=list)


def annotate(log: bytes, trial: Trial, start: TrialStart) -> bytes:
    """Add to a log what only the host knows.

    Parameters
    ----------
    log : bytes
        The ULog as the board wrote it.
    trial : Trial
        The same, as it was read.
    start : TrialStart
        When the trial began; if no host's clock says it, no time is added.

    Returns
    -------
    bytes
        A ULog. ``read_trial`` reads the same trial from it.
    """
    held = list(ulog.records(log))
    first = next((at for at, one in enumerate(held) if one.kind == b"A"), len(held))
    board = _definitions(held)
    added = [*_formats(), *_units(board), *_defaults(board), *_time(trial, start)]
    subscribed = [ulog.subscription(number, topic) for topic, number in _IDS.items()]
    more = [*_slots_si(trial), *(_clock(trial, start) if start.known else ())]
    whole = [*held[:first], *added, *subscribed, *_with_nan(held[first:], board), *more]
    return log[: ulog.HEADER_BYTES] + b"".join(one.content() for one in whole)


def _definitions(held: list[Record]) -> _Definitions:
    """Formats, subscriptions and parameters."""
    board = _Definitions()
    for one in held:
        if one.kind == b"F":
            topic, fields = ulog.fields_of(one.body)
            board.topics[topic] = fields
        elif one.kind == b"A":
            board.ids[one.body[3:].decode("ascii", "replace")] = int.from_bytes(
                one.body[1:3], "little"
            )
        elif one.kind == b"P":
            key = one.body[1 : 1 + one.body[0]].decode("ascii", "replace")
            board.parameters.append(key.partition(" ")[2])
    return board


def _formats() -> list[Record]:
    return [ulog.topic_format(SLOT_SI, _SLOT_SI), ulog.topic_format(CLOCK, _CLOCK)]


def _units(board: _Definitions) -> Iterator[Record]:
    """One information record for each field that has a unit, and for each parameter that has."""
    for topic, fields in {**board.topics, SLOT_SI: _SLOT_SI}.items():
        for name, unit in units_of(fields).items():
            yield ulog.info_text(f"unit_{topic}_{name}", unit)
    known = known_parameters()
    for name in board.parameters:
        if (now := known.get(current_name(name))) is not None and now.unit:
            yield ulog.info_text(f"unit_{name}", now.unit)


def _defaults(board: _Definitions) -> Iterator[Record]:
    known = known_parameters()
    for name in board.parameters:
        if (now := known.get(current_name(name))) is not None:
            yield ulog.default_parameter(name, now.default)


def _time(trial: Trial, start: TrialStart) -> list[Record]:
    if not start.known:
        return []
    return [
        ulog.info("uint64_t start_utc_us", struct.pack("<Q", start.host_ns // 1000)),
        ulog.info("int32_t time_ref_utc", struct.pack("<i", start.zone_s)),
    ]


def _clock(trial: Trial, start: TrialStart) -> list[Record]:
    """Board time and UTC at the begin of the first beat and at the end of the last."""
    beats_us = round(trial.executed_beats * trial.beat_s * 1e6)
    return [
        ulog.data(
            _IDS[CLOCK],
            struct.pack("<QQ", trial.start_us + since_us, start.host_ns // 1000 + since_us),
        )
        for since_us in (0, beats_us)
    ]


def _slots_si(trial: Trial) -> Iterator[Record]:
    """The slots in SI units; NaN where nothing is known."""
    table = trial.slots.table()
    names = list(_SLOT_SI)[1:]
    for row in zip(*(table[name] for name in names), strict=True):
        time_us = trial.start_us + round(float(row[0]) * 1e6)
        yield ulog.data(_IDS[SLOT_SI], struct.pack("<Q6f", time_us, *map(float, row)))


def _with_nan(held: list[Record], board: _Definitions) -> Iterator[Record]:
    """The records; of slots without samples the speed is NaN instead of 0."""
    fields, number = board.topics.get("slot", {}), board.ids.get("slot")
    speed, samples = (ulog.offset_of(fields, name) for name in ("speed_m_s", "samples"))
    if speed is None or samples is None:
        yield from held
        return
    for one in held:
        is_slot = one.kind == b"D" and int.from_bytes(one.body[:2], "little") == number
        if not is_slot or len(one.body) <= samples or one.body[samples]:
            yield one
        else:
            yield Record(b"D", one.body[:speed] + _NAN + one.body[speed + len(_NAN) :])
