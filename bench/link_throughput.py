"""How much of the radio's 11 520 bytes/s a pull uses, in virtual time, on good and bad lines.

The file is the log of a trial of 200 beats. The time counts from the command to the verified file:
CRC, open, data, end. Live telemetry is off (TLM_RATE_HZ 0); what else the board says once a second
goes on: heartbeat, status, battery, attitude.
"""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from tailbeat import records
from tailbeat.fish import Fish
from tailbeat.ftpwire import DATA_BYTES
from tailbeat.transport.badline import BadLine, Corrupt, Drop, Fault, hc05
from tailbeat.transport.inprocess import SimTransport
from tailbeat.transport.simulated import SimBoard

LINE_BYTES_PER_S = 11520
SEEDS = 6
BEATS = 200
PATH = "/trials/0001.ulg"
FRAME_BYTES, SIGNATURE_BYTES = 266, 13
ECHO_BYTES = 64

Faults = Callable[[], Sequence[Fault]]
CASES: dict[str, tuple[Faults, float]] = {
    "clean": (lambda: (), 1.0),
    "5 % of the frames lost": (lambda: (Drop(0.05),), 0.95),
    "20 % of the frames lost": (lambda: (Drop(0.2),), 0.8),
    "one byte in 1000 wrong": (lambda: (Corrupt(1e-3),), (1 - 1e-3) ** FRAME_BYTES),
    "one byte in 100 wrong": (lambda: (Corrupt(1e-2),), (1 - 1e-2) ** FRAME_BYTES),
    "the delay of an HC-05": (lambda: (hc05(),), 1.0),
    "that, and 5 % lost": (lambda: (Drop(0.05), hc05()), 0.95),
}


def flash_with_log() -> bytes:
    """The storage of a fish that swam a long trial."""
    with Fish.connect("sim:tank", seed=1) as fish:
        fish.params.set("TANK_LEN_M", 0)
        fish.params.set("TLM_RATE_HZ", 0)
        fish.params.save()
        fish.upload_reference(records.encode_reference(1.0, [0.03] * BEATS))
        fish.run_trial()
        fish.discard()
        assert fish.sim is not None
        return fish.sim.flash


def board_with(flash: bytes, **config: float) -> SimBoard:
    board = SimBoard("tank", **config)
    board.flash = flash
    board.power_cycle()
    return board


def pull(flash: bytes, faults: Faults, seed: int) -> tuple[float, int]:
    """(bytes of the file per second, bytes that the board sent meanwhile beside it)."""
    transport = SimTransport(board_with(flash))
    line = BadLine(transport, faults(), faults(), seed)
    with Fish(line) as fish, tempfile.TemporaryDirectory() as folder:
        fish.link.run(2.0)
        begin_s = fish.transport.now_s()
        fish.ftp.pull(PATH, Path(folder) / "file")
        took_s = fish.transport.now_s() - begin_s
        size = (Path(folder) / "file").stat().st_size
    return size / took_s, size


def main() -> None:
    flash = flash_with_log()
    print(f"pulling a trial's log, share of {LINE_BYTES_PER_S} bytes/s used for its bytes:")
    print(f"  {'line, both ways':28} {'mean':>6} {'worst':>6} {'limit':>6}  ({SEEDS} seeds)")
    full = DATA_BYTES / FRAME_BYTES
    for name, (faults, through) in CASES.items():
        rates = [pull(flash, faults, seed)[0] for seed in range(1, SEEDS + 1)]
        shares = [rate / LINE_BYTES_PER_S for rate in rates]
        mean, worst = statistics.mean(shares), min(shares)
        print(f"  {name:28} {mean:6.3f} {worst:6.3f} {full * through:6.3f}")


if __name__ == "__main__":
    main()
