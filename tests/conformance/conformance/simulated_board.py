"""The simulated board, as the program simulated_conformance (boards/simulated.c)."""

from __future__ import annotations

import math
import subprocess
from pathlib import Path
from typing import IO

from conformance.boards import Battery, Pulse, Unmeasured

TAIL = 0
PROGRAM_ENDED = "the board's program ended"

ABSENT = {
    "watchdog": "the board has no watchdog: a loop that hangs is a program that hangs",
    "crash": "the board keeps no crash record: a failed assertion ends the program",
}


class SimulatedBoard(Unmeasured):
    """``fault``: number of a planted fault, with the program that has them."""

    def __init__(self, program: Path, fault: int = 0) -> None:
        super().__init__(ABSENT, Battery(8.2, 9.9))
        self.name = "simulated board"
        self._process = subprocess.Popen(
            [program, str(fault)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._time_us = 0
        self._run(0)

    def _pipes(self) -> tuple[IO[str], IO[str]]:
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None and stdout is not None
        return stdin, stdout

    def _tell(self, line: str) -> None:
        stdin, _ = self._pipes()
        stdin.write(line + "\n")
        stdin.flush()

    def _ask(self, line: str) -> list[str]:
        self._tell(line)
        answer = self._pipes()[1].readline()
        if not answer:
            raise OSError(PROGRAM_ENDED)
        return answer.split()

    def _run(self, duration_us: int) -> bytes:
        time_us, *data = self._ask(f"run {duration_us}")
        self._time_us = int(time_us)
        return bytes.fromhex("".join(data))

    def now_s(self) -> float:
        """Simulated time."""
        return self._time_us * 1e-6

    def write(self, data: bytes) -> None:
        """Bytes for the console."""
        self._tell(f"write {data.hex()}")

    def read(self, most_s: float) -> bytes:
        """Bytes of the console; simulated time passes."""
        return self._run(math.ceil(most_s * 1e6))

    def pulses(self, servo: int) -> list[Pulse] | None:
        """The fish has one servo."""
        if servo != TAIL:
            return None
        pairs = (word.split(":") for word in self._ask("pulses"))
        return [Pulse(int(time_us) * 1e-6, int(ticks)) for time_us, ticks in pairs]

    def light_changes(self) -> int | None:
        """Of the LED."""
        return int(self._ask("light")[0])

    def power_cycle(self) -> bool:
        """Off and on at once."""
        self._tell("power")
        return True

    def close(self) -> None:
        """Ends the program. Raises OSError when it failed."""
        self._pipes()[0].close()
        self._pipes()[1].close()
        if self._process.wait() != 0:
            raise OSError(f"{PROGRAM_ENDED} with code {self._process.returncode}")
