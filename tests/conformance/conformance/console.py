"""Lines of the suite on a board's console: commands out, answers in."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from conformance.boards import Board

ANSWER_S = 10.0
GREETING_S, GREETINGS = 0.5, 20
STRAY = ord("#")  # what no answer holds


class NoAnswer(Exception):
    """The board did not say what it should."""


class Restarted(NoAnswer):
    """The board restarted though nobody asked for it."""


@dataclass(frozen=True)
class About:
    """What the board says when it starts."""

    reset: str
    unique_id: str
    exact: bool
    servos: int


def parse_about(line: str) -> About | None:
    """None for other lines. Raises NoAnswer when another version of the suite runs."""
    words = line.split()
    if len(words) != 10 or words[0] != "conformance":
        return None
    if words[1] != "1":
        raise NoAnswer(f"the board runs version {words[1]} of the suite, the runner is for 1")
    return About(words[3], words[5], words[7] == "1", int(words[9]))


class Console:
    """``stray``: bytes so far that a refused write must not have sent."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._waiting = b""
        self.stray = 0

    def send(self, command: str) -> None:
        """A command line."""
        self._board.write(command.encode() + b"\n")

    def raw(self, data: bytes) -> None:
        """Bytes as they are."""
        self._board.write(data)

    def bytes(self, length: int, most_s: float = ANSWER_S) -> bytes:
        """Exactly so many, or those that come in time."""
        end = self._board.now_s() + most_s
        while len(self._waiting) < length and (left := end - self._board.now_s()) > 0:
            self._waiting += self._board.read(left)
        data, self._waiting = self._waiting[:length], self._waiting[length:]
        return data

    def line(self, most_s: float = ANSWER_S) -> str | None:
        """The next line; None when none comes in time."""
        end = self._board.now_s() + most_s
        while b"\n" not in self._waiting:
            left = end - self._board.now_s()
            if left <= 0:
                return None
            self._waiting += self._board.read(left)
        line, _, self._waiting = self._waiting.partition(b"\n")
        self.stray += line.count(STRAY)
        return line.decode("ascii", "replace").strip("\r\n\0#")

    def pause(self, duration_s: float) -> None:
        """Time passes; what comes meanwhile waits."""
        end = self._board.now_s() + duration_s
        while (left := end - self._board.now_s()) > 0:
            self._waiting += self._board.read(left)

    def started(self, most_s: float = ANSWER_S) -> About:
        """Waits for the line of a start. Raises NoAnswer."""
        end = self._board.now_s() + most_s
        while (left := end - self._board.now_s()) > 0:
            line = self.line(left)
            about = parse_about(line) if line is not None else None
            if about is not None:
                return about
        raise NoAnswer(f"the board did not start within {most_s:.0f} s")

    def greet(self) -> About:
        """Finds the suite on the board. Raises NoAnswer."""
        for _ in range(GREETINGS):
            self.send("about")
            try:
                about = self.started(GREETING_S)
            except NoAnswer:
                continue
            self.pause(GREETING_S)
            self._waiting = b""
            return about
        raise NoAnswer("no answer; is the conformance image on the board, and this its console?")

    def answers(self, command: str, most_s: float = ANSWER_S) -> Iterator[list[str]]:
        """Words of each line up to "done". Raises NoAnswer, Restarted."""
        self.send(command)
        while True:
            line = self.line(most_s)
            if line is None:
                raise NoAnswer(f"no answer to {command!r} within {most_s:.0f} s")
            if (about := parse_about(line)) is not None:
                raise Restarted(f"the board restarted, cause {about.reset}")
            words = line.split()
            if words[:1] == ["error"]:
                raise NoAnswer(f"the board refused {command!r}: {line}")
            if words[:1] == ["done"]:
                return
            if words:
                yield words

    def ask(self, command: str) -> list[str]:
        """Words of a single line. Raises NoAnswer."""
        self.send(command)
        line = self.line()
        if line is None:
            raise NoAnswer(f"no answer to {command!r}")
        return line.split()
