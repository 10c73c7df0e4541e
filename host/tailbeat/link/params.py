"""The board's parameters over the MAVLink parameter protocol; presets are named sets of values."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache, partial
from itertools import islice

from tailbeat.core.errors import InputError, Refused, TransferError, did_you_mean
from tailbeat.core.faults import BAD_PARAM, LAW_FEEDBACK, LAW_SIGN, WRONG_STATE, refusal
from tailbeat.core.native import c_text, lib
from tailbeat.core.param_names import current_name, old_names, renamed
from tailbeat.link import _dialect as mavlink
from tailbeat.link.mavlink import BOARD_COMPONENT, BOARD_SYSTEM, Link, Message, text_of

_NAME_BYTES = 16
_LIST_SILENCE_S = 0.5
_BARREN_ROUNDS_MAX = 16
_COUNT_MAX = 1024
_REPEATS_MAX = 4
_ASK_MAX = 16  # at once: their answers fit into what the board's sender holds
_DENIED = mavlink.MAV_PARAM_ERROR_PERMISSION_DENIED
_FAULTS = {_DENIED: WRONG_STATE}
_LOAD, _SAVE, _RESET = 0.0, 1.0, 2.0


@dataclass(frozen=True)
class Parameter:
    """One parameter as the board holds it. Limits are inclusive; NaN when the tool has none."""

    name: str
    value: float
    default: float
    low: float
    high: float
    unit: str
    text: str


@dataclass(frozen=True)
class _KnownParameter:
    default: float
    low: float
    high: float
    step: float  # values are multiples of it; 0 = any
    unit: str
    text: str


_IMU_LINE = ("IMU_BAUD", "IMU_RATE_HZ")
_IMU_LINE_REMEDY = (
    "IMU_BAUD is a rate the VN-100 has and at least 640 x IMU_RATE_HZ, 800 / IMU_RATE_HZ is whole."
    " For 400 Hz set IMU_BAUD 460800 first; on the way back IMU_RATE_HZ first."
)

# Values that are in range, and that the board refuses all the same.
_NO_LAW_FOR_A_FISH = {3.0: LAW_FEEDBACK, 4.0: LAW_FEEDBACK, 5.0: LAW_SIGN}

_UNKNOWN = _KnownParameter(math.nan, math.nan, math.nan, 0.0, "", "")


class Parameters:
    """Reads and changes parameters. A change takes effect at once; save() makes it last.

    Old and present names are accepted; what comes back has the present name. A board with older
    firmware is asked by the name that it reports.
    """

    def __init__(self, link: Link) -> None:
        self._link = link
        self._reported: dict[str, str] = {}  # by present name, where the board's name is an old one

    def list(self) -> dict[str, Parameter]:
        """All parameters, in the board's order."""
        found: dict[int, Message] = {}
        count: int | None = None
        message = mavlink.MAVLink_param_request_list_message(BOARD_SYSTEM, BOARD_COMPONENT)
        self._link.flush()
        barren = 0
        while barren < _BARREN_ROUNDS_MAX:
            had = len(found)
            if count is None:
                self._link.send(message)
            else:
                self._ask_for(i for i in range(count) if i not in found)
            count = self._collect(found, count)
            if count is not None and len(found) >= count:
                return {p.name: p for p in (self._parameter(found[i]) for i in sorted(found))}
            barren = 0 if len(found) > had else barren + 1
        raise self._link.lost(barren, barren * _LIST_SILENCE_S)

    def values(self, *names: str) -> dict[str, float]:
        """Values by name, of these or of all."""
        if not names:
            return {name: one.value for name, one in self.list().items()}
        return {name: self.get(name).value for name in names}

    def get(self, name: str) -> Parameter:
        """One parameter. Raises Refused when the board has none of that name."""
        return self._about(name, _read_request)

    def set(self, name: str, value: float) -> Parameter:
        """Changes one parameter; what the board then holds, equal to ``value`` as float32."""
        name = current_name(name)
        _check_range(name, value, known_parameters().get(name))
        try:
            held = self._about(name, partial(_set_request, value=value), _bits(value))
        except Refused as refused:
            if refused.number == BAD_PARAM and name in _IMU_LINE:
                raise InputError(
                    f"{name} = {value:g} does not go with the rest", _IMU_LINE_REMEDY
                ) from refused
            if refused.number == BAD_PARAM and name == "ILC_KIND" and value in _NO_LAW_FOR_A_FISH:
                raise refusal(_NO_LAW_FOR_A_FISH[value]) from refused
            raise
        if _bits(held.value) != _bits(value):
            raise refusal(WRONG_STATE)  # its word on why was lost; the range was right
        return held

    def apply(self, values: Mapping[str, float]) -> dict[str, tuple[float, Parameter]]:
        """Sets each parameter; its value before and what the board holds now."""
        return {
            name: (self.get(name).value, self.set(name, value)) for name, value in values.items()
        }

    def save(self) -> None:
        """Writes the present values to the board's storage."""
        self._storage(_SAVE)

    def load(self) -> None:
        """Brings the stored values back."""
        self._storage(_LOAD)

    def reset(self) -> None:
        """Sets every parameter to its default; what is stored stays until save()."""
        self._storage(_RESET)

    def _storage(self, what: float) -> None:
        self._link.command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, what)

    def _ask_for(self, indices: Iterable[int]) -> None:
        for index in islice(indices, _ASK_MAX):
            self._link.send(
                mavlink.MAVLink_param_request_read_message(
                    BOARD_SYSTEM, BOARD_COMPONENT, b"", index
                )
            )

    def _collect(self, found: dict[int, Message], count: int | None) -> int | None:
        silence_s, received = self._link.patient(_LIST_SILENCE_S), 0
        while count is None or len(found) < count:
            message = self._link.recv("PARAM_VALUE", silence_s)
            if message is None:
                break
            count = message.param_count
            if count > _COUNT_MAX:
                raise TransferError(
                    f"the board claims to have {count} parameters; no firmware has more than "
                    f"{_COUNT_MAX}",
                    "Check that the address is a tailbeat board's, and its firmware: tailbeat info",
                )
            if message.param_index < message.param_count:
                found[message.param_index] = message
            received += 1
            if received > _REPEATS_MAX * count:
                break  # it repeats itself; what is missing is asked for
        return count

    def _about(
        self, name: str, request: Callable[[str], Message], wanted: bytes | None = None
    ) -> Parameter:
        """The answer about ``name``, by the first of its names that the board has."""
        present = current_name(name)
        names = [self._reported.get(present, present), present, *old_names(present)]
        for asked in dict.fromkeys(names):
            answer = self._exchange(request(asked), asked, wanted)
            if answer is not None:
                return self._parameter(answer)
        raise _no_such(name)

    def _parameter(self, message: Message) -> Parameter:
        reported = text_of(message.param_id)
        name = current_name(reported)
        if name != reported:
            self._reported[name] = reported
        known = known_parameters().get(name, _UNKNOWN)
        return Parameter(
            name,
            float(message.param_value),
            known.default,
            known.low,
            known.high,
            known.unit,
            known.text,
        )

    def _exchange(self, message: Message, name: str, wanted: bytes | None = None) -> Message | None:
        """The answer about ``name``; None when the board has no such parameter. A value that is not
        ``wanted`` may be the late answer to something earlier, so that it counts only when the
        board says it again."""
        others = 0

        def fits(answer: Message) -> bool:
            nonlocal others
            if text_of(answer.param_id) != name:
                return False
            if wanted is None or answer.get_type() != "PARAM_VALUE":
                return True
            as_wanted = _bits(answer.param_value) == wanted
            others += not as_wanted
            return as_wanted or others > 2

        self._link.begin()
        for patience_s in self._link.attempts():
            self._link.send(message)
            answer = self._link.recv(("PARAM_VALUE", "PARAM_ERROR"), patience_s, fits)
            if answer is None:
                continue
            if answer.get_type() == "PARAM_ERROR":
                if answer.error == _DENIED and self._link.once_more():
                    continue
                if answer.error == mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST:
                    return None
                raise refusal(_FAULTS.get(answer.error, BAD_PARAM))
            return answer
        raise AssertionError("attempts always raises at its end")


@cache
def known_parameters() -> dict[str, _KnownParameter]:
    """The table this tool was built with (params/params.def)."""
    steps = {lib.PARAM_REAL: 0.0, lib.PARAM_HALF: 0.5, lib.PARAM_WHOLE: 1.0}
    table: dict[str, _KnownParameter] = {}
    for index in range(int(lib.PARAM_COUNT)):
        info = lib.param_info(index)
        table[c_text(info.name)] = _KnownParameter(
            float(info.fallback),
            float(info.low),
            float(info.high),
            steps[info.kind],
            c_text(lib.param_unit(index)),
            c_text(lib.param_text(index)),
        )
    return table


def _read_request(name: str) -> Message:
    return mavlink.MAVLink_param_request_read_message(
        BOARD_SYSTEM, BOARD_COMPONENT, _encode(name), -1
    )


def _set_request(name: str, value: float) -> Message:
    return mavlink.MAVLink_param_set_message(
        BOARD_SYSTEM, BOARD_COMPONENT, _encode(name), value, mavlink.MAV_PARAM_TYPE_REAL32
    )


def _encode(name: str) -> bytes:
    encoded = name.encode("ascii", "replace")
    if not 1 <= len(encoded) <= _NAME_BYTES:
        raise _no_such(name)
    return encoded


def _no_such(name: str) -> Refused:
    told = refusal(BAD_PARAM)
    alike = get_close_matches(name.upper(), [*known_parameters(), *renamed()], n=2)
    guess = did_you_mean(name.upper(), dict.fromkeys(map(current_name, alike)))
    remedy = f"{guess}Print all names: tailbeat params list"
    return Refused(told.number, told.name, f"the board has no parameter '{name}'", remedy)


def _bits(value: float) -> bytes:
    return struct.pack("<f", value)


def _check_range(name: str, value: float, known: _KnownParameter | None) -> None:
    if not math.isfinite(value) or abs(value) > 3.4e38:
        raise InputError(f"{value} is no value for {name}", "Give a finite number.")
    if known is None:
        return
    rounded = struct.unpack("<f", _bits(value))[0]
    if not known.low <= rounded <= known.high:
        raise InputError(
            f"{name} cannot be {value:g}",
            f"Give a value from {known.low:g} to {known.high:g} {known.unit}".rstrip() + ".",
        )
    if known.step and rounded / known.step != round(rounded / known.step):
        wanted = "a whole number" if known.step == 1 else f"a multiple of {known.step:g}"
        raise InputError(f"{name} cannot be {value:g}", f"Give {wanted}.")
