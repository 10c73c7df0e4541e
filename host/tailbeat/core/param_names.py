"""Parameters that had another name before (firmware/params/renamed.def)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, TypeVar

from tailbeat.core.native import c_text, lib

Value = TypeVar("Value")


@cache
def renamed() -> dict[str, str]:
    """Old name to present name."""
    rows = [lib.param_renamed(i) for i in range(int(lib.PARAM_RENAMED_COUNT))]
    return {c_text(row.old_name): c_text(lib.param_info(row.param).name) for row in rows}


def current_name(name: str) -> str:
    """The present name of the parameter that is or was called ``name``."""
    return renamed().get(name, name)


def old_names(name: str) -> list[str]:
    """The names that older firmware has for ``name``."""
    return [old for old, new in renamed().items() if new == name]


def with_current_names(params: Mapping[str, Value]) -> dict[str, Value]:
    """``params`` of a file by their present names; other keys stay."""
    return {current_name(name): value for name, value in params.items()}


def of_document(document: dict[str, Any]) -> dict[str, Any]:
    """``document`` of a file with its ``params``, if it has any, by their present names."""
    params = document.get("params")
    if not isinstance(params, dict):
        return document
    return document | {"params": with_current_names(params)}
