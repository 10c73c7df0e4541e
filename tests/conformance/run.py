"""Judges whether a board fulfils hal/include/hal: runs the conformance suite that is on it.

The exit code is 0 when no check failed, 1 when one did, 2 when the suite does not answer.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from conformance.boards import Battery, Board
from conformance.checks import GROUPS, run
from conformance.console import NoAnswer
from conformance.results import FAILED, OK, Result

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = ROOT / "build" / "unit" / "conformance" / "simulated_conformance"
IMAGE = ROOT / "build" / "firmware" / "conformance" / "sam3x8e_conformance.elf"


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("board", help="a serial port, 'simulated' or 'emulated'")
    parser.add_argument("--only", choices=GROUPS, action="append", help="only these checks")
    parser.add_argument("--battery-v", type=float, help="voltage of the battery now")
    parser.add_argument("--full-scale-v", type=float, default=9.9, help="of the largest reading")
    parser.add_argument("--program", type=Path, default=PROGRAM, help="of the simulated board")
    parser.add_argument("--image", type=Path, default=IMAGE, help="of the emulated board")
    parser.add_argument("--json", action="store_true", help="results as JSON")
    return parser.parse_args()


def _board(arguments: argparse.Namespace) -> Board:
    if arguments.board == "simulated":
        from conformance.simulated_board import SimulatedBoard

        return SimulatedBoard(arguments.program)
    if arguments.board == "emulated":
        from conformance.emulated_board import EmulatedBoard

        return EmulatedBoard(arguments.image)
    from conformance.serial_board import SerialBoard

    volts = arguments.battery_v
    battery = None if volts is None else Battery(volts, arguments.full_scale_v)
    return SerialBoard(arguments.board, battery)


def _shown(results: Iterator[Result]) -> Iterator[Result]:
    for result in results:
        print(result.row(), flush=True)
        yield result


def _summary(results: list[Result]) -> str:
    counts = dict.fromkeys((OK, FAILED), 0)
    for result in results:
        counts[result.verdict] = counts.get(result.verdict, 0) + 1
    return ", ".join(f"{count} {verdict}" for verdict, count in counts.items())


def main() -> int:
    """The command."""
    arguments = _arguments()
    try:
        with closing(_board(arguments)) as board:
            results = run(board, arguments.only or tuple(GROUPS))
            shown = list(results if arguments.json else _shown(results))
    except (NoAnswer, OSError) as error:
        print(f"{arguments.board}: {error}", file=sys.stderr)
        return 2
    failed = [result for result in shown if result.verdict == FAILED]
    if arguments.json:
        checks = [result.to_json() for result in shown]
        print(json.dumps({"board": board.name, "failed": len(failed), "checks": checks}, indent=1))
    else:
        print(_summary(shown))
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
