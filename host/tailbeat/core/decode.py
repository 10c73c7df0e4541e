"""Decodes the JSON and TOML files of users, strictly: typed values in, one InputError out.

A document is described by a dataclass or by a ``Table``; both may be nested, in lists, tuples and
dicts, too. Types are not converted: "4" is no number. The error names the file, the place in it and
what belongs there, for example ``tank.json: points[2].x_m: expected a number, got a text``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin

import msgspec

from tailbeat.core.errors import InputError, did_you_mean, reason
from tailbeat.core.extras import lazy
from tailbeat.core.lazy_arrays import np
from tailbeat.core.printable import Hex

tomllib: Any = lazy("tomllib")

T = TypeVar("T")
Prepare = Callable[[Any], Any]
"""Changes a document before it is converted: keys of older files to those of now."""

BYTES_MAX = 16 << 20  # no file of a user is as long
_WORDS = {
    "int": "a whole number",
    "float": "a number",
    "str": "a text",
    "bool": "true or false",
    "object": "a table of keys and values",
    "array": "a list",
    "null": "nothing (null)",
}
_AT = re.compile(r"(?s)(.*?)(?: - at (?:`key` in )?`\$\.?(.*)`)?$")


class StrictTable(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """A table of keys and values, of which no others are known."""


class Whole(int):
    """A whole number, which a document may also write as 3.0."""


def read(
    path: Path, kind: type[T], remedy: str, *, prepare: Prepare | None = None, what: str = ""
) -> T:
    """The file as ``kind``; TOML when its name ends so, else JSON. ``what``: what the user knows
    the file as, in place of its path. Raises InputError with ``remedy``."""
    where = what or str(path)
    try:
        with path.open("rb") as file:
            content = file.read(BYTES_MAX + 1)
    except OSError as error:
        raise InputError(f"cannot read {where} ({reason(error)})", remedy) from error
    if len(content) > BYTES_MAX:
        raise InputError(f"{where} is too long: it has more than {BYTES_MAX >> 20} MiB", remedy)
    return decode(content, kind, where, remedy, prepare=prepare, toml=path.suffix == ".toml")


def decode(
    content: bytes | str,
    kind: type[T],
    where: str,
    remedy: str,
    *,
    prepare: Prepare | None = None,
    toml: bool = False,
) -> T:
    """The document as ``kind``. ``where`` begins the message. Raises InputError with ``remedy``."""
    try:
        text = content.decode("utf-8") if isinstance(content, bytes) else content
        document = tomllib.loads(text) if toml else json.loads(text)
    except UnicodeDecodeError as error:
        raise InputError(f"{where}: this is no text in UTF-8", remedy) from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: no {'TOML' if toml else 'JSON'} ({error})", remedy) from error
    return convert(document, kind, where, remedy, prepare=prepare)


def convert(
    document: Any, kind: type[T], where: str, remedy: str, *, prepare: Prepare | None = None
) -> T:
    """As ``decode``, of plain values."""
    try:
        if prepare is not None:
            document = prepare(document)
        return msgspec.convert(document, kind, dec_hook=_custom, str_keys=True)
    except msgspec.ValidationError as error:
        problem, place = _explained(str(error))
        known = _known_keys(kind, place) if "unknown key" in problem else []
        at = f"{where}: {place}" if place else where
        guess = did_you_mean(problem.removeprefix("unknown key "), known)
        hint = f"{guess}Known are {', '.join(known)}." if known else remedy
        raise InputError(f"{at}: {problem}", hint) from error
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
        raise InputError(f"{where}: {_of_python(error)}", remedy) from error


def _custom(kind: Any, value: Any) -> Any:
    """The types that JSON does not know."""
    if kind is Hex:
        if not isinstance(value, str):
            raise ValueError("expected hexadecimal digits")
        return Hex.fromhex(value)
    if kind is Whole:
        if isinstance(value, bool) or not isinstance(value, int | float) or value != int(value):
            raise ValueError("expected a whole number")
        return Whole(value)
    if kind is Path:
        return Path(value)
    if getattr(get_origin(kind), "__name__", "") == "ndarray":
        (dtype,) = get_args(get_args(kind)[1])
        return _array(value, dtype)
    raise NotImplementedError(f"no rule to decode {kind}")


def _array(value: Any, dtype: type[Any]) -> Any:
    """Numbers in a list or in lists of one length; null is NaN."""
    try:
        raw = np.array(value, dtype=object)
        numbers = all(v is None or type(v) in (int, float) for v in raw.flat)
        if not isinstance(value, list) or not numbers:
            raise ValueError
        return raw.astype(dtype)
    except (ValueError, TypeError, OverflowError):
        raise ValueError("expected a list of numbers") from None


def _explained(message: str) -> tuple[str, str]:
    """(problem, place) of a message of msgspec."""
    match = _AT.match(message)
    assert match is not None
    problem, place = match[1], (match[2] or "").replace("[...]", "")
    if found := re.fullmatch(r"Object (missing required|contains unknown) field `(.*)`", problem):
        return (f"unknown key {found[2]}" if "unknown" in found[1] else f"no {found[2]}"), place
    problem = re.sub(r"`([^`]*)`", lambda types: _in_words(types[1]), problem)
    problem = problem.replace("Expected", "expected")
    return problem.replace("Invalid enum value", "unknown value"), place


def _in_words(types: str) -> str:
    return " or ".join(_WORDS.get(name, name) for name in types.split(" | "))


def _of_python(error: Exception) -> str:
    return f"no {error.args[0]}" if isinstance(error, KeyError) and error.args else str(error)


def _known_keys(kind: Any, place: str) -> list[str]:
    """The keys of the table at ``place`` (``laws[2].gain``) in a document of this kind."""
    info: Any = msgspec.inspect.type_info(kind)
    for step in re.findall(r"\w+|\[", place.replace("]", "")):
        if step == "[":
            info = getattr(info, "item_type", getattr(info, "value_type", info))
        elif not step.isdigit():
            info = next((f.type for f in getattr(info, "fields", ()) if f.name == step), info)
        tables = (t for t in getattr(info, "types", ()) if hasattr(t, "fields"))
        info = next(tables, info)
    return [field.encode_name for field in getattr(info, "fields", ())]
