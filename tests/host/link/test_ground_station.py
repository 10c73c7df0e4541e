"""A ground station connects: QGroundControl's requests in its order and with its time-outs
(data/qgc_connect.jsonl, by its InitialConnectStateMachine, StandardModes, FTPManager and
PlanManager; releases differ in two steps, here are both), against the simulated board on a line of
115 200 baud, in virtual time."""

from __future__ import annotations

import json
import lzma
import struct
from pathlib import Path
from typing import Any

import pytest

from tailbeat.link import _dialect as mavlink
from tailbeat.link.impaired import ImpairedLine, hc05
from tailbeat.link.params import known_parameters
from tailbeat.sim.board import SimBoard, SimTransport

STEPS = [
    json.loads(line)
    for line in (Path(__file__).parents[1] / "data" / "qgc_connect.jsonl").read_text().splitlines()
]
LINE_BYTES_PER_S = 11520.0
WITHIN_S = 3.0
OPEN_RO, BURST, RESET, ACK, NAK, EOF = 4, 15, 2, 128, 129, 6
BLOCK_BYTES = 239


class Station:
    """Plain MAVLink, apart from the product's own link."""

    def __init__(self, transport: Any) -> None:
        self.transport = transport
        self.mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self.mav.robust_parsing = True
        self.waited_s: list[float] = []
        self._expected = 0  # number of the next FTP reply
        self._held: list[Any] = []

    def send(self, name: str, fields: dict[str, Any]) -> None:
        """With the board as its target; fields that are left out are 0."""
        kind = getattr(mavlink, f"MAVLink_{name.lower()}_message")
        values = dict.fromkeys(kind.fieldnames, 0)
        values |= {name: 1 for name in ("target_system", "target_component") if name in values}
        values |= fields
        self.transport.write(kind(**values).pack(self.mav))

    def messages(self, timeout_s: float) -> Any:
        """What comes, until it is too late."""
        begun_s = self.transport.now_s()
        while (left_s := begun_s + timeout_s - self.transport.now_s()) > 0:
            self._held += self.mav.parse_buffer(self.transport.read()) or []
            while self._held:
                self.waited_s.append(self.transport.now_s() - begun_s)
                yield self._held.pop(0)
            self.transport.wait(left_s)
        pytest.fail(f"nothing came within {timeout_s} s")

    def until(self, wanted: dict[str, Any], timeout_s: float) -> None:
        """Reads on to the message that ends a step."""
        seen: set[int] = set()
        fields = {k: v for k, v in wanted.items() if k not in ("type", "all")}
        for message in self.messages(timeout_s):
            if message.get_type() != wanted["type"]:
                continue
            if any(getattr(message, name) != value for name, value in fields.items()):
                continue
            seen.add(getattr(message, "param_index", 0))
            if "all" not in wanted or len(seen) == getattr(message, wanted["all"]):
                return

    def ftp(self, opcode: int, offset: int = 0, data: bytes = b"", size: int = 0) -> None:
        """One request of session 0."""
        self._expected = (self._expected + 2) & 0xFFFF
        head = struct.pack(
            "<HBBBBBxI", self._expected - 1, 0, opcode, size or len(data), 0, 0, offset
        )
        payload = list((head + data).ljust(251, b"\0"))
        self.send("FILE_TRANSFER_PROTOCOL", {"target_network": 0, "payload": payload})

    def reply(self, timeout_s: float) -> tuple[int, int, bytes, bool]:
        """Number, opcode, data and whether a burst is complete."""
        for message in self.messages(timeout_s):
            if message.get_type() == "FILE_TRANSFER_PROTOCOL":
                payload = bytes(message.payload)
                number = int.from_bytes(payload[:2], "little")
                return number, payload[3], payload[12 : 12 + payload[4]], payload[6] == 1
        raise AssertionError

    def download(self, path: str, timeout_s: float) -> bytes:
        """As QGroundControl's FTPManager does it: bursts until the end is refused, then a reset."""
        self.ftp(OPEN_RO, data=path.encode())
        number, opcode, data, _ = self.reply(timeout_s)
        assert (number, opcode) == (self._expected, ACK), path
        size, content = struct.unpack("<I", data)[0], b""
        self.ftp(BURST, size=BLOCK_BYTES)
        while True:
            number, opcode, data, complete = self.reply(timeout_s)
            assert number == self._expected
            if opcode == NAK:
                break
            content += data
            self._expected = number if complete else number + 1
            if complete:
                self.ftp(BURST, len(content), size=BLOCK_BYTES)
        assert data[0] == EOF and len(content) == size
        self.ftp(RESET)
        assert self.reply(timeout_s)[:2] == (self._expected, ACK)
        return content


def replay(station: Station) -> tuple[float, dict[str, bytes]]:
    """Runs all steps; how long they took, and the files that were downloaded."""
    files: dict[str, bytes] = {}
    station.send("HEARTBEAT", {"type": 6, "autopilot": 8})
    begun_s = station.transport.now_s()
    for step in STEPS:
        if "download" in step:
            files[step["download"]] = station.download(step["download"], step["timeout_s"])
        else:
            station.send(step["send"], step["fields"])
            station.until(step["until"], step["timeout_s"])
    return station.transport.now_s() - begun_s, files


@pytest.fixture
def board() -> SimBoard:
    board = SimBoard("tank", seed=5, link_bytes_per_s=LINE_BYTES_PER_S)
    board.run(5.0)
    return board


def test_the_sequence_completes_without_a_time_out(board: SimBoard) -> None:
    took_s, files = replay(Station(SimTransport(board)))
    print(f"QGroundControl's sequence: {took_s:.2f} s at 115200 baud")
    assert took_s < WITHIN_S
    entry = json.loads(files["general.json"])["metadataTypes"][0]
    assert entry["type"] == 1 and entry["uri"].endswith("/parameter.json.xz")


def test_over_an_hc05_no_step_times_out(board: SimBoard) -> None:
    took_s, _ = replay(Station(ImpairedLine(SimTransport(board), [hc05()], [hc05()], seed=3)))
    print(f"QGroundControl's sequence: {took_s:.2f} s over an HC-05")


def test_every_parameter_is_described(board: SimBoard) -> None:
    _, files = replay(Station(SimTransport(board)))
    described = json.loads(lzma.decompress(files["parameter.json.xz"]))["parameters"]
    known = known_parameters()
    assert [row["name"] for row in described] == list(known)
    for row in described:
        parameter = known[row["name"]]
        assert row["shortDesc"] and row["type"] == "Float"
        assert row.get("units", "") == parameter.unit
        assert (row["min"], row["max"]) == pytest.approx((parameter.low, parameter.high))
        assert row["default"] == pytest.approx(parameter.default)
