"""Runs the C unit tests of a build folder, with limits that a busy machine does not change.

Usage: run.py BUILD_FOLDER [NAME ...]. A program may use CPU_LIMIT_S of CPU time. GUARD_S of wall
time end only a program that hangs. Before a program is ended, its stack is printed: by the address
sanitizer here, from the emulator's memory in QEMU. CTest knows the programs; it does not run them.
"""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

CPU_LIMIT_S = 120.0
GUARD_S = 20 * CPU_LIMIT_S
LOOK_S = 0.05
LOOK_MAX_S = 1.0
DUMP_S = 60.0  # for a stack to be printed
STACK_WORDS = 256
LONGEST_SHOWN = 5
EMULATOR = "qemu-system-arm"
ADDR2LINE = "arm-none-eabi-addr2line"
COSTS = "cpu_times.json"


@dataclass(frozen=True)
class Program:
    """One test as CTest knows it."""

    name: str
    command: list[str]


@dataclass(frozen=True)
class Outcome:
    """How it ended. ``trouble``: None when it passed."""

    name: str
    cpu_s: float
    wall_s: float
    trouble: str | None
    output: str


def programs(build: Path) -> list[Program]:
    """All tests of the build folder."""
    listing = subprocess.run(
        ["ctest", "--test-dir", str(build), "--show-only=json-v1"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return [Program(t["name"], t.get("command", [])) for t in json.loads(listing.stdout)["tests"]]


def cpu_s(pid: int) -> float:
    """CPU time of a running process and of those it waited for; 0 when it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


class Emulated:
    """The monitor of an emulator that runs one program."""

    def __init__(self, program: Program, folder: str) -> None:
        self.elf = program.command[-1]
        self.path = f"{folder}/{program.name}.monitor"

    def options(self) -> list[str]:
        """For the emulator's command line."""
        return ["-monitor", f"unix:{self.path},server=on,wait=off"]

    def _answers(self, commands: list[str]) -> str:
        with socket.socket(socket.AF_UNIX) as monitor:
            monitor.settimeout(DUMP_S)
            monitor.connect(self.path)
            text = ""
            for command in ["", *commands]:
                if command:
                    monitor.sendall(f"{command}\n".encode())
                end = text.count("(qemu) ") + 1
                while text.count("(qemu) ") < end:
                    received = monitor.recv(65536)
                    if not received:
                        return text
                    text += received.decode(errors="replace")
        return text

    def stack(self) -> str:
        """Program counter, link register, and whatever on the stack lies in a function."""
        registers = self._answers(["stop", "info registers"])
        found = {name: int(value, 16) for name, value in re.findall(r"(R\d+)=(\w+)", registers)}
        words = self._answers([f"xp /{STACK_WORDS}xw {found['R13']:#x}"])
        addresses = [found["R15"], found["R14"]]
        for line in re.findall(r"^[0-9a-f]+: (0x.*)$", words, re.MULTILINE):
            addresses += [int(word, 16) for word in line.split() if int(word, 16) & 1]
        named = subprocess.run(
            [ADDR2LINE, "-fspe", self.elf, *(f"{(a & ~1) - 2 * (a & 1):#x}" for a in addresses)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        lines = [line for line in named.stdout.splitlines() if not line.startswith("??")]
        return "\n".join(lines)


def is_over(process: subprocess.Popen[bytes]) -> bool:
    """Whether it has ended; what it used can still be asked for."""
    return os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def end(process: subprocess.Popen[bytes], emulated: Emulated | None) -> str:
    """Prints the stack of a program that takes too long, and ends it."""
    text = ""
    try:
        if emulated is not None:
            text = f"stack (newest first, may hold old calls):\n{emulated.stack()}"
        else:
            os.kill(process.pid, signal.SIGABRT)
            begin_s = time.monotonic()
            while not is_over(process) and time.monotonic() - begin_s < DUMP_S:
                time.sleep(LOOK_S)
    except (OSError, KeyError) as error:
        text = f"its stack cannot be read: {error}"
    os.killpg(process.pid, signal.SIGKILL)
    return text


def watch(process: subprocess.Popen[bytes], emulated: Emulated | None) -> tuple[str, str]:
    """Waits for the end. (what was wrong or "", stack)"""
    begin_s, look_s = time.monotonic(), LOOK_S
    while True:
        if is_over(process):
            return "", ""
        if cpu_s(process.pid) > CPU_LIMIT_S:
            return f"used more than {CPU_LIMIT_S:.0f} s of CPU time", end(process, emulated)
        if time.monotonic() - begin_s > GUARD_S:
            return f"hangs: not ready after {GUARD_S:.0f} s", end(process, emulated)
        time.sleep(look_s)
        look_s = min(LOOK_MAX_S, 1.2 * look_s)


def run(program: Program, folder: str) -> Outcome:
    """Runs one program to its end."""
    if not program.command:
        return Outcome(program.name, 0.0, 0.0, "not built", "")
    command, emulated = program.command, None
    if Path(command[0]).name == EMULATOR:
        emulated = Emulated(program, folder)
        command = [command[0], *emulated.options(), *command[1:]]
    options = ":".join(filter(None, (os.environ.get("ASAN_OPTIONS"), "handle_abort=1")))
    begin_s = time.monotonic()
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
            start_new_session=True, env={**os.environ, "ASAN_OPTIONS": options},
        )  # fmt: skip
        most = round(2 * CPU_LIMIT_S)  # for its children, which are not seen from here
        resource.prlimit(process.pid, resource.RLIMIT_CPU, (most, most))
        trouble, stack = watch(process, emulated)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        wall_s = time.monotonic() - begin_s
        output.seek(0)
        text = output.read().decode(errors="replace") + stack
    if not trouble and process.returncode != 0:
        trouble = f"exit status {process.returncode}"
    spent_s = usage.ru_utime + usage.ru_stime
    return Outcome(program.name, spent_s, wall_s, trouble or None, text)


def show(outcome: Outcome) -> None:
    """A line for a program that passed; all it said for one that did not."""
    if outcome.trouble is None:
        return
    print(f"--- {outcome.name} FAILED: {outcome.trouble}\n{outcome.output}", flush=True)


def summary(outcomes: list[Outcome]) -> None:
    """The longest programs, then the sum, then what failed."""
    longest = sorted(outcomes, key=lambda o: -o.cpu_s)[:LONGEST_SHOWN]
    total_s = sum(o.cpu_s for o in outcomes)
    print(f"{len(outcomes)} programs, {total_s:.1f} s of CPU time, the longest: ", end="")
    print(", ".join(f"{o.name} {o.cpu_s:.1f} s" for o in longest))
    if failed := [o.name for o in outcomes if o.trouble is not None]:
        print(f"FAILED: {len(failed)} of {len(outcomes)}: {', '.join(failed)}")


def cost_of(build: Path) -> dict[str, float]:
    """CPU times of the last run, so that the long ones start first."""
    try:
        return {str(name): float(s) for name, s in json.loads((build / COSTS).read_text()).items()}
    except (OSError, ValueError):
        return {}


def add_costs(build: Path, outcomes: list[Outcome]) -> None:
    """For the sum of all tests (tools/run_all.py), where it asks for them."""
    if path := os.environ.get("TEST_COSTS"):
        with Path(path).open("a") as file:
            file.writelines(f"{one.cpu_s:.3f} {build.name} {one.name}\n" for one in outcomes)


def main(arguments: list[str]) -> int:
    """Runs all programs, or those named; two at a time on two cores."""
    build, names = Path(arguments[0]), set(arguments[1:])
    known = programs(build)
    if unknown := names - {program.name for program in known}:
        print(f"no such test: {', '.join(sorted(unknown))}", file=sys.stderr)
        return 2
    chosen = [program for program in known if not names or program.name in names]
    costs = cost_of(build)
    chosen.sort(key=lambda program: -costs.get(program.name, CPU_LIMIT_S))
    outcomes = []
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(os.cpu_count()) as pool:
        for outcome in pool.map(partial(run, folder=folder), chosen):
            show(outcome)
            outcomes.append(outcome)
    costs |= {outcome.name: round(outcome.cpu_s, 3) for outcome in outcomes}
    (build / COSTS).write_text(json.dumps(costs))
    add_costs(build, outcomes)
    summary(outcomes)
    return 1 if any(outcome.trouble for outcome in outcomes) else 0


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1:]))
