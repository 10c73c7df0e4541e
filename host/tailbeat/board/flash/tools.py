"""Other programs, run for a bounded time."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tailbeat.core.errors import InputError

_ENDED_BY_TIMEOUT = -1


@dataclass(frozen=True)
class Outcome:
    """How a program ended, and all it said."""

    status: int
    output: str

    @property
    def ok(self) -> bool:
        """Whether it reports success."""
        return self.status == 0

    @property
    def last_words(self) -> str:
        """The last line it printed: usually the reason."""
        lines = [line.strip() for line in re.split(r"[\r\n]+", self.output) if line.strip()]
        return lines[-1] if lines else f"exit status {self.status}"


Run = Callable[[Sequence[str], float], Outcome]


def run_program(command: Sequence[str], timeout_s: float) -> Outcome:
    """Runs ``command`` to its end; after ``timeout_s`` it is killed."""
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired as late:
        said = (late.stdout or b"").decode(errors="replace")
        return Outcome(_ENDED_BY_TIMEOUT, f"{said}\nit did not end within {timeout_s:g} s")
    return Outcome(done.returncode, done.stdout.decode(errors="replace"))


def require_program(name: str, package: str) -> None:
    """Raises InputError when ``name`` is not installed."""
    if shutil.which(name) is None:
        raise InputError(f"the program {name} is missing", f"Install it: apt-get install {package}")
