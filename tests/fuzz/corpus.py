"""The fuzz targets' corpora: one pack a target in tests/fuzz/corpus, each input after its length.

python tests/fuzz/corpus.py unpack link build/fuzz/corpus/link     into a folder, one file an input
python tests/fuzz/corpus.py pack link build/fuzz/corpus/link       that folder into the pack
python tests/fuzz/corpus.py add link crash-1234                    one more input, as a reproducer
python tests/fuzz/corpus.py seeds build/fuzz/corpus                inputs from sessions with the sim
"""

from __future__ import annotations

import hashlib
import struct
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from tailbeat.session.trial import run_trial

PACKS = Path(__file__).parent / "corpus"
PACK_BYTES_MAX = 100_000
INPUT_BYTES_MAX = 0xFFFF
LINK_RAW, LINK_PASSES = 0, 14  # steps of fuzz_link.c: raw bytes on the radio, passes
IMU_RAW = 8 * 31  # of fuzz_imu.c: 32 raw bytes
IMU_PASSES = 6


def unpacked(pack: Path) -> list[bytes]:
    """The inputs of a pack."""
    if not pack.exists():
        return []
    data, at, inputs = pack.read_bytes(), 0, []
    while at < len(data):
        (size,) = struct.unpack_from("<H", data, at)
        inputs.append(data[at + 2 : at + 2 + size])
        at += 2 + size
    return inputs


def write_pack(pack: Path, inputs: list[bytes]) -> None:
    """Shortest first, as many as fit."""
    out = bytearray()
    for one in sorted(set(inputs), key=lambda one: (len(one), one)):
        if len(one) <= INPUT_BYTES_MAX and len(out) + 2 + len(one) <= PACK_BYTES_MAX:
            out += struct.pack("<H", len(one)) + one
    pack.write_bytes(out)


def put(folder: Path, inputs: list[bytes]) -> None:
    """One file each, named by its content."""
    folder.mkdir(parents=True, exist_ok=True)
    for one in inputs:
        (folder / hashlib.sha1(one).hexdigest()).write_bytes(one)


class Listener:
    """A transport that keeps what the host writes."""

    def __init__(self, inner: object) -> None:
        self.inner = inner
        self.written: list[bytes] = []

    def write(self, data: bytes) -> None:
        self.written.append(data)
        self.inner.write(data)  # type: ignore[attr-defined]

    def __getattr__(self, name: str) -> object:
        return getattr(self.inner, name)


def session_bytes() -> list[bytes]:
    """What a host says in connecting, uploading a reference, swimming, learning."""
    from tailbeat.board.fish import Fish
    from tailbeat.core import reference

    with Fish.connect("sim:tank", seed=3) as fish:
        listener = Listener(fish.transport)
        fish.link.transport = listener  # type: ignore[assignment]
        fish.upload_reference(reference.trapezoid(0.06, 1, 1))
        run_trial(fish)
        fish.params.set("ILC_LEAD", 1)
        fish.learn()
        return listener.written


def link_seeds() -> list[bytes]:
    """The session in pieces, a pass after each message."""
    steps = [
        bytes([LINK_RAW, len(data)]) + data + bytes([LINK_PASSES])
        for data in session_bytes()
        if len(data) < 256
    ]
    return [
        bytes([base]) + b"".join(steps[i : i + 12]) for base in (0, 1) for i in range(0, 96, 12)
    ]


def record_seeds() -> list[bytes]:
    """Each kind that the tool can make."""
    from tailbeat.core import records
    from tailbeat.core.records import Amplitudes

    speeds = [0.01, float("nan"), 0.03]
    status = SimpleNamespace(
        last_learned_trial=9, worse_streak=1, best_iteration=4, best_max_abs_error_m_s=0.01
    )
    held = Amplitudes(5, 3, 77, np.float32([0.1, -0.2, 0.9]))
    best = Amplitudes(4, 3, 77, np.float32([0.3, 0.4, 0.5]))
    made = {
        0: records.encode_reference(1.0, [0.01, 0.02, 0.03]),
        5: records.encode_speeds(3, speeds, 0.001),
        6: records.encode_amplitudes(77, [0.1, -0.2, 0.3]),
    }
    learned = [
        records.encode_learned(status, held, best, visits)
        for visits in (None, np.array([0, 4, 255], dtype=np.uint8))
    ]
    return [bytes([kind, 0]) + record for kind, record in made.items()] + [
        bytes([1, 0]) + record for record in learned
    ]


def imu_seeds() -> list[bytes]:
    """Lines as a sensor sends them, in pieces of 32 bytes with time between."""
    lines = b"".join(
        [
            b"$VNYPR,+010.071,+000.278,-002.026*60\r\n",
            b"$VNRRG,01,VN-100T-CR*31\r\n",
            b"$VNERR,03*72\r\n",
        ]
    )
    pieces = [lines[i : i + 32] for i in range(0, len(lines), 32)]
    return [b"\0" + b"".join(bytes([IMU_RAW]) + p + bytes([IMU_PASSES]) for p in pieces)]


def packed_seeds() -> list[bytes]:
    """The stored log of a short trial, as it is and as messages to be packed."""
    from tailbeat.board.fish import Fish
    from tailbeat.core import reference

    with Fish.connect("sim:tank", seed=3) as fish:
        fish.upload_reference(reference.trapezoid(0.06, 1, 1))
        run_trial(fish)
        stored, ulog = (fish.ftp.read(f"/trials/0001.{kind}") for kind in ("ulz", "ulg"))
    messages, at = [ulog[:16]], 16
    while at < len(ulog):
        end = at + 3 + int.from_bytes(ulog[at : at + 2], "little")
        messages.append(ulog[at:end])
        at = end
    steps = [bytes([len(one) - 1]) + one for one in messages]
    return [b"\0" + stored[8:2000]] + [
        b"\1" + b"".join(steps[i : i + 20]) for i in range(0, len(steps), 20)
    ]


def main(arguments: list[str]) -> int:
    what, *rest = arguments
    if what == "unpack":
        put(Path(rest[1]), unpacked(PACKS / f"{rest[0]}.pack"))
    elif what == "pack":
        files = [one for one in Path(rest[1]).iterdir() if one.is_file()]
        write_pack(PACKS / f"{rest[0]}.pack", [one.read_bytes() for one in files])
    elif what == "add":
        pack = PACKS / f"{rest[0]}.pack"
        write_pack(pack, [*unpacked(pack), Path(rest[1]).read_bytes()])
    elif what == "seeds":
        made = {"link": link_seeds(), "records": record_seeds(), "imu": imu_seeds()}
        made["packed"] = packed_seeds()
        for target, inputs in made.items():
            put(Path(rest[0]) / target, inputs)
    else:
        sys.stderr.write(__doc__ or "")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
