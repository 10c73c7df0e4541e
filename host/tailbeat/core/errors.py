"""What can go wrong, in words a person can act on.

Every error says in one line what is wrong and what to do about it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from types import MappingProxyType
from typing import Any


class TailbeatError(Exception):
    """Base of all errors that this package raises on purpose.

    Parameters
    ----------
    message : str
        What is wrong, in one line.
    remedy : str
        What to do about it; empty when there is nothing to do.

    Attributes
    ----------
    document : mapping
        What a command has computed all the same, by the keys of its ``--json``.
    """

    document: Mapping[str, Any] = MappingProxyType({})

    def __init__(self, message: str, remedy: str = "") -> None:
        super().__init__(message, remedy)
        self.message = message
        self.remedy = remedy

    def __str__(self) -> str:
        message = " ".join(self.message.split())
        remedy = " ".join(self.remedy.split())
        if not remedy:
            return message
        return f"{sentence(message)} {remedy}"


class ConnectError(TailbeatError):
    """No board was found, or what was found is not one."""


class NoBoardError(ConnectError):
    """A port is open, but no tailbeat board answers on it. ``heard``: ``Hearing.kind``."""

    def __init__(self, heard: str, message: str, remedy: str) -> None:
        super().__init__(message, remedy)
        self.heard = heard


class LinkLostError(TailbeatError):
    """The board answered before and does not any more."""


class TransferError(TailbeatError):
    """A file could not be moved between host and board."""


class InputError(TailbeatError):
    """Something the caller gave makes no sense."""


class Refused(TailbeatError):
    """The board turned a request down; nothing changed on it."""

    def __init__(self, number: int, name: str, meaning: str, remedy: str) -> None:
        super().__init__(meaning, remedy)
        self.args = (number, name, meaning, remedy)
        self.number = number
        self.name = name
        self.meaning = meaning


def sentence(text: str) -> str:
    """With a full stop, unless it ends in another mark."""
    return text if text.endswith(("?", "!")) else f"{text.rstrip('.')}."


def reason(error: Exception) -> str:
    """Why the system refused, without its numbers and paths."""
    return str(getattr(error, "strerror", None) or error)


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """``Did you mean x or y? ``, to stand before a remedy; empty when nothing is alike."""
    alike = get_close_matches(word, list(known), n=2)
    return f"Did you mean {' or '.join(alike)}? " if alike else ""
