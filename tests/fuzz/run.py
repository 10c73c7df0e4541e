"""Runs the fuzz targets, two at a time, and says what they did.

FUZZ_SECONDS for each (600); FUZZ_TARGETS names some of them; FUZZ_GROW=1 puts what was found into
tests/fuzz/corpus. Ends with 1 when something crashed, hung or took too much memory: the input is
kept in build/fuzz/found, and the line that runs it again is printed.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import corpus

ROOT = Path(__file__).parents[2]
BUILD = ROOT / "build/fuzz"
FOUND = BUILD / "found"
TARGETS = ("imu", "link", "ftp", "records", "mount")
LONGEST = {"records": 6300, "imu": 3000, "link": 1500, "ftp": 800, "mount": 600}
HANG_S = 25
MEMORY_MB = 1024


@dataclass(frozen=True)
class Outcome:
    """What one target did."""

    target: str
    executions: int
    coverage: int
    inputs: int
    crashes: list[Path]
    log: str


def last_number(log: str, pattern: str) -> int:
    found = re.findall(pattern, log)
    return int(found[-1]) if found else 0


def run(target: str, seconds: int) -> Outcome:
    """Grows a working copy of the corpus; the first crash ends the target's run."""
    folder = BUILD / "corpus" / target
    corpus.put(folder, corpus.unpacked(corpus.PACKS / f"{target}.pack"))
    before = set(FOUND.glob(f"{target}-*"))
    command = [
        str(BUILD / f"tests/fuzz_{target}"),
        f"-max_total_time={seconds}",
        f"-max_len={LONGEST[target]}",
        f"-timeout={HANG_S}",
        f"-rss_limit_mb={MEMORY_MB}",
        f"-artifact_prefix={FOUND}/{target}-",
        "-print_final_stats=1",
        str(folder),
    ]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    log = done.stderr
    crashes = sorted(set(FOUND.glob(f"{target}-*")) - before)
    if done.returncode != 0 and not crashes:
        crashes = [FOUND / f"{target}-log"]
    if crashes:
        (FOUND / f"{target}-log").write_text(log)
    executions = last_number(log, r"number_of_executed_units:\s*(\d+)")
    executions = executions or last_number(log, r"(?m)^#(\d+)\s")
    inputs = len(list(folder.iterdir()))
    return Outcome(target, executions, last_number(log, r"cov: (\d+)"), inputs, crashes, log)


def keep_grown(target: str) -> None:
    """The fewest inputs with all that is covered, into the pack."""
    small = BUILD / "small" / target
    small.mkdir(parents=True, exist_ok=True)
    for old in small.iterdir():
        old.unlink()
    binary = str(BUILD / f"tests/fuzz_{target}")
    folders = [str(small), str(BUILD / "corpus" / target)]
    subprocess.run([binary, "-merge=1", *folders], capture_output=True, check=True)
    corpus.write_pack(
        corpus.PACKS / f"{target}.pack", [one.read_bytes() for one in small.iterdir()]
    )


def report(outcome: Outcome, seconds: int) -> None:
    rate = outcome.executions / max(seconds, 1)
    print(
        f"{outcome.target:8} {outcome.executions:9} executions ({rate:.0f}/s), "
        f"{outcome.coverage} edges covered, {outcome.inputs} inputs, "
        f"{len(outcome.crashes)} crashes",
        flush=True,
    )
    for crash in outcome.crashes:
        print(f"  again: build/fuzz/tests/fuzz_{outcome.target} {crash}")


def main() -> int:
    seconds = int(os.environ.get("FUZZ_SECONDS", "600"))
    targets = os.environ.get("FUZZ_TARGETS", " ".join(TARGETS)).split()
    FOUND.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(2) as pool:
        outcomes = []
        for outcome in pool.map(lambda target: run(target, seconds), targets):
            report(outcome, seconds)
            outcomes.append(outcome)
    if os.environ.get("FUZZ_GROW"):
        for target in targets:
            keep_grown(target)
    return 1 if any(outcome.crashes for outcome in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
