"""sim fish, board, demo, law, selftest."""

from __future__ import annotations

import signal
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

from tailbeat.app.cli._lazy import arg, opt
from tailbeat.app.cli._terminal import (
    Output,
    assignments,
    echo,
    lines_of,
    print_line,
    progress_bar,
    table,
)
from tailbeat.app.demo import DemoOptions, DemoResult, run_demo
from tailbeat.app.demo_laws import TwoLaws, run_both
from tailbeat.board.connect import is_simulated
from tailbeat.core import law as laws
from tailbeat.core.csv import read_column
from tailbeat.core.printable import amplitude_rows, mm
from tailbeat.core.selftest import run_selftest
from tailbeat.sim.board import PLANTS, SimBoard, SimulatedBoard
from tailbeat.sim.emulated import EmulatedBoard
from tailbeat.sim.server import Addresses, SimServer, parse_listen

PLANT_NAMES = "|".join(PLANTS)
Set = Annotated[
    list[str] | None, opt("A value of the simulator, SI; repeatable.", "KEY=VALUE", name="--set")
]


@dataclass(frozen=True)
class ServeOptions:
    """The simulated world, and where it is served."""

    plant: str = opt("Model of the fish and the water.", PLANT_NAMES, default="tank")
    seed: int | None = opt(
        "Same seed, same board, same run, bit for bit; default: disturbances of 1, and a"
        " board of its own.",
        min=0,
    )
    listen: str = opt("Port 0 = any free one.", "tcp:HOST:PORT", default="tcp:127.0.0.1:5760")
    pty: bool = opt("Serve the USB serial port on a pty too.")
    speed: float = opt("Simulated seconds per second.", default=1.0)
    settings: Set = None

    def values(self) -> dict[str, float]:
        """Of the simulator."""
        seed = {} if self.seed is None else {"seed": self.seed}
        return seed | assignments(self.settings or [])

    def serve(self, board: SimulatedBoard, what: str) -> None:
        """Until Ctrl-C."""

        def slow(pace: float) -> None:
            words = f"falls behind: {pace:.2g} x real time instead of {self.speed:g}"
            hint = f"For a steady pace: --speed {0.8 * pace:.1g}"
            echo(f"{words}, as fast as it can. {hint}", err=True)

        stopped: list[int] = []
        for number in (signal.SIGINT, signal.SIGTERM):  # even if a shell's & has it ignore them
            signal.signal(number, lambda got, _: stopped.append(got))
        with closing(SimServer(board, self.listen, self.pty, self.speed, slow)) as server:
            at = server.addresses
            print_line(asdict(at), _serve_text(f"{what} ({board.plant})", self.speed, at))
            server.serve(lambda: bool(stopped))


def demo(
    plant: str | None = opt("Model of the fish and the water; default: tank.", PLANT_NAMES),
    gain: float = opt("Learning gain, rad s/m.", default=4.0),
    lead: float | None = opt("Beats, in halves; default 0 (thesis) or 1 (tank).", min=0),
    trials: int = opt("Runs of each law.", min=1, default=8),
    seed: int | None = opt("Same seed, same run, bit for bit; default: 1.", min=0),
    out: Path | None = opt("Folder to write; default: below experiments/."),
    law: Literal["both", "p", "model"] = opt(
        "p alone on any board; model: both, its trials first in --json.",
        "both|p|model",
        default="both",
    ),
    settings: Set = None,
    connect: str | None = opt("Learn on this board instead; vboard = flash image.", "URL"),
) -> Output:
    """Show a simulated fish that learns the thesis's profile: by a P law, and as start leads.

    The P law with gain 4 is the thesis's (8.16); the lead, 0 there, makes up for the tank's delay.

    Example: tailbeat sim demo --plant tank --seed 3
    """
    options = DemoOptions(
        plant, gain, lead, trials, seed, out, connect, assignments(settings or [])
    )
    with progress_bar("demo") as show:
        if law == "p" or not is_simulated(connect or "sim"):  # a real fish is no demo of start
            result = run_demo(options, show)
            return Output(result.as_dict(), lambda: _demo_text(result))
        both = run_both(options, show)
    return Output(both.as_dict(law), lambda: _both_text(both))


def _both_text(both: TwoLaws) -> str:
    rows = [
        [
            one.name,
            one.measuring_runs or "-",
            len(one.analysis.rows),
            mm(one.best.max_abs_error_m_s),
            one.run_of(one.best),
        ]
        for one in both.runs
    ]
    first, bound = both.p_law, both.p_law.floor_m_s
    seed = "" if first.seed is None else f", seed {first.seed}"
    return lines_of(
        f"one fish (plant {first.plant}{seed}), twice from unknown; errors in mm/s, over beats",
        table(["law", "identification", "trials", "best max|e|", "in trial"], rows, left=(0,)),
        bound is not None
        and f"error bound {mm(bound)} mm/s: no input can do better on this fish without noise",
        "host and board agree bit for bit",
        f"figure {both.figure}",
        *(f"report {report}" for report in both.reports),
    )


def _demo_text(result: DemoResult) -> str:
    rows = [
        [
            row.iteration,
            row.trial or "-",
            mm(row.max_abs_error_m_s),
            mm(row.rms_error_m_s),
            mm(row.true_max_abs_error_m_s),
            row.saturated_beats,
            "baseline (u = 0)" if row.trial == 0 else row.end,
        ]
        for row in result.trials
    ]
    header = ["iteration", "trial", "max|e|", "RMS", "true max|e|", "saturated", "end"]
    first, last = result.trials[0], result.trials[-1]
    down = 1 - last.max_abs_error_m_s / first.max_abs_error_m_s
    seed = "" if result.seed is None else f", seed {result.seed}"
    bound = (
        f"error bound {mm(result.floor_m_s)} mm/s: no input can do better on this plant without "
        f"noise (the L2-optimal input leaves {mm(result.floor_lsq_m_s)})"
    )
    return lines_of(
        f"plant {result.plant}, gain {result.gain:g} rad s/m, lead {result.lead:g}{seed}"
        "; errors in mm/s, over beats",
        table(header, rows, left=(6,)),
        f"max|e| down {down * 100:.0f} % in {last.iteration} iterations; "
        "host and board agree bit for bit",
        result.floor_m_s is not None and bound,
        f"report {result.report}",
    )


def fish(serve: ServeOptions) -> None:
    """Serve a simulated fish to other programs, until Ctrl-C.

    Its camera, its USB serial port and its fault-injection port are the next three ports. The last
    one takes lines like "push -0.05"; send "help" for the others. 'tailbeat sim' is short for it.

    Example: tailbeat sim fish --plant tank --speed 10 --set kappa_per_m=5
    """
    serve.serve(SimBoard(serve.plant, **serve.values()), "simulated fish")


def board(
    serve: ServeOptions,
    image: Path | None = arg(
        "The flash image, .elf; default: build/firmware/tailbeat.elf.", "IMAGE"
    ),
) -> None:
    """Serve the flash image on an emulated board, with a simulated fish, until Ctrl-C.

    Example: tailbeat sim board build/firmware/tailbeat.elf --pty
    """
    board = EmulatedBoard(image, serve.plant, **serve.values())
    serve.serve(board, "emulated board, simulated fish")


def _serve_text(what: str, speed: float, at: Addresses) -> str:
    pace = "" if speed == 1 else f" at {speed:g} x real time"
    line = f"{what}{pace} on {at.listen}: tailbeat info --connect {at.listen}"
    serial = at.console + (f" and {at.pty}" if at.pty else "")
    host, port = parse_listen(at.world)
    faults = f"fault-injection port {at.world}: echo help | nc {host} {port}"
    return f"{line}\ncamera {at.camera}\nUSB serial {serial}\n{faults}"


def selftest(
    source: Path | None = opt("Folder of a clone; default: the tests of the package."),
) -> Output:
    """Run the firmware's unit tests on this computer.

    Example: tailbeat sim selftest
    """
    with progress_bar("unit tests") as show:
        report = run_selftest(source, on_suite=show)
    bad = [test for test in report.tests if not test.ok]
    failed = [f"FAILED {test.suite}: {test.name} {test.message}".rstrip() for test in bad]
    summary = f"{report.passed} tests passed" + (f", {report.failed} failed" if failed else "")
    return Output(report.as_dict(), "\n".join([*failed, summary]), status=int(bool(failed)))


def law(
    config: Path = opt("LAW.json: fields of the law."),
    amplitudes: Path = opt("CSV beat,amplitude_rad.", name="--input"),
    errors: Path = opt("CSV beat,error_m_s; empty = none.", name="--error"),
) -> Output:
    """Apply the learning law once, with the code of the board.

    Example: tailbeat sim law --config law.json --input u.csv --error e.csv
    """
    old = read_column(amplitudes, "amplitude_rad")
    error = read_column(errors, "error_m_s", gaps=True)
    chosen = laws.load(config)
    following, report = laws.update(
        chosen, old, [0.0 if e != e else e for e in error], [e == e for e in error]
    )
    document = {
        "law": chosen,
        "amplitude_rad": following,
        "applied_rad": laws.saturate(chosen, following),
        "report": report,
    }
    return Output(document, amplitude_rows(following))
