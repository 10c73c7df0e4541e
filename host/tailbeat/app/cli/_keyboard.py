"""One key at a time from the terminal, without Enter; the terminal is put back as it was in every
case."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from tailbeat.core.errors import TailbeatError

_CTRL_C = "\x03"
_SPECIAL = ("\0", "\xe0")  # Windows
_ESCAPE = b"\x1b"
_ARROW_S = 0.05  # the rest of its sequence follows at once, also over a network


class TerminalGone(TailbeatError):
    """Whoever was there to answer is not any more."""

    def __init__(self) -> None:
        super().__init__(
            "the terminal is gone, and nothing was decided",
            "The trial waits on the board; run the same command again.",
        )


class Keys(Protocol):
    """What a person types."""

    def pressed(self) -> bool:
        """Whether any key was pressed since the last question; never waits."""

    def forget(self) -> None:
        """What was typed before a question is no answer to it."""

    def key(self, timeout_s: float) -> str | None:
        """The next key, in small letters; None when none comes in time, or one that is no letter
        (an arrow). Raises TerminalGone."""

    def line(self) -> str:
        """What is typed up to Enter, seen as it is typed."""


if sys.platform == "win32":
    import msvcrt
    import time

    class _Console:
        """The console of Windows."""

        def pressed(self) -> bool:
            return bool(msvcrt.kbhit())

        def forget(self) -> None:
            while msvcrt.kbhit():
                msvcrt.getwch()

        def key(self, timeout_s: float) -> str | None:
            end_s = time.monotonic() + timeout_s
            while not msvcrt.kbhit():
                if time.monotonic() >= end_s:
                    return None
                time.sleep(0.02)
            key = msvcrt.getwch().lower()
            if key in _SPECIAL:  # of two characters, the second often a letter
                msvcrt.getwch()
                return None
            if key == _CTRL_C:
                raise KeyboardInterrupt
            return key

        def line(self) -> str:
            return input()

    @contextmanager
    def terminal_keys() -> Iterator[Keys | None]:
        """The keys of the terminal for the length of a block; None when there is none."""
        yield _Console() if sys.stdin.isatty() else None

else:
    import os
    import select
    import termios
    import tty

    class _Terminal:
        """A POSIX terminal, read around Python's own buffer."""

        def __init__(self, descriptor: int) -> None:
            self._descriptor = descriptor
            self._usual = termios.tcgetattr(descriptor)
            self._gone = False

        def single(self) -> None:
            """Keys come at once and are not shown; Ctrl-C stays what it is."""
            tty.setcbreak(self._descriptor, termios.TCSADRAIN)

        def restore(self) -> None:
            """As it was found. What was typed and not read is forgotten: a key that should stop
            the tail must not become a command of the shell."""
            try:
                termios.tcsetattr(self._descriptor, termios.TCSAFLUSH, self._usual)
            except termios.error:
                self._gone = True

        def pressed(self) -> bool:
            return not self._gone and self._ready(0.0)

        def forget(self) -> None:
            try:
                termios.tcflush(self._descriptor, termios.TCIFLUSH)
            except termios.error:
                self._gone = True

        def key(self, timeout_s: float) -> str | None:
            if not self._gone and not self._ready(timeout_s):
                return None
            piece = self._read()
            if piece == _ESCAPE and self._ready(_ARROW_S):
                piece += self._read()
            if piece.startswith(_ESCAPE) and len(piece) > 1:
                return None
            return piece.decode(errors="replace")[:1].lower()

        def line(self) -> str:
            self.restore()
            try:
                return self._read().decode(errors="replace").strip()
            finally:
                self.single()

        def _ready(self, timeout_s: float) -> bool:
            return bool(select.select([self._descriptor], [], [], timeout_s)[0])

        def _read(self) -> bytes:
            try:
                piece = b"" if self._gone else os.read(self._descriptor, 1024)
            except OSError:
                piece = b""
            if not piece:
                self._gone = True
                raise TerminalGone
            return piece

    @contextmanager
    def terminal_keys() -> Iterator[Keys | None]:
        """The keys of the terminal for the length of a block; None when there is none."""
        if not sys.stdin.isatty():
            yield None
            return
        terminal = _Terminal(sys.stdin.fileno())
        try:
            terminal.single()
            yield terminal
        finally:
            terminal.restore()
