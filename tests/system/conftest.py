"""A simulated fish as a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import pytest

START = "from tailbeat.app.cli import main; main()"


@contextmanager
def running(speed: float) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """(address, process) of a simulator ``speed`` times as fast as the clock; gone at the end."""
    command = [sys.executable, "-c", START, "sim", "--json", "--listen", "tcp:127.0.0.1:0"]
    command += ["--speed", f"{speed:g}"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            yield json.loads(server.stdout.readline())["listen"], server
        finally:
            server.kill()


@pytest.fixture(scope="session")
def simulator() -> Callable[[float], AbstractContextManager[tuple[str, subprocess.Popen[str]]]]:
    """``with simulator(speed) as (address, process)``."""
    return running
