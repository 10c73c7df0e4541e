"""What --stream sends: one JSON datagram for each message of the board, with board time."""

from __future__ import annotations

import json
import socket
from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import pytest

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError
from tailbeat.core.reference import from_text
from tailbeat.link.stream import StreamAddress, streaming
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport

SHORT = "trapezoid:0.06,2,4"  # 8 beats


@pytest.fixture
def ear() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        found.bind(("127.0.0.1", 0))
        found.setblocking(False)
        yield found


def address_of(ear: socket.socket) -> StreamAddress:
    return StreamAddress.parse(f"udp://127.0.0.1:{ear.getsockname()[1]}")


def heard(ear: socket.socket) -> list[dict[str, Any]]:
    found = []
    while True:
        try:
            found.append(json.loads(ear.recv(65536)))
        except BlockingIOError:
            return found


def test_a_trial_as_numbers_over_board_time(ear: socket.socket) -> None:
    with Fish(SimTransport(SimBoard("tank", seed=3))) as fish:
        fish.upload_reference(from_text(SHORT).record())
        with streaming(fish.link, address_of(ear)):
            outcome = run_trial(fish)
        documents = heard(ear)
        fish.status()
        assert heard(ear) == [], "nothing is sent any more"
    by_name = defaultdict(list)
    for document in documents:
        time_s = document.pop("timestamp")
        ((name, values),) = document.items()
        by_name[name].append((time_s, values))
    assert {"status", "live", "beat"} <= set(by_name) <= {
        "status", "live", "beat", "health", "learned"
    }  # fmt: skip
    times_s = [time_s for time_s, _ in by_name["live"]]
    assert len(times_s) > 40 and times_s == sorted(times_s)
    assert {values["beat"] for _, values in by_name["beat"]} == {one.beat for one in outcome.beats}
    assert all(None not in values.values() for rows in by_name.values() for _, values in rows)


def test_with_nobody_there_all_goes_on() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as gone:
        gone.bind(("127.0.0.1", 0))
        nobody = address_of(gone)
    with Fish(SimTransport(SimBoard("tank", seed=3))) as fish:
        with streaming(fish.link, nobody):
            fish.link.run(5.0)
        assert fish.status().state == "IDLE"


@pytest.mark.parametrize(
    "text", ["127.0.0.1:9870", "udp:127.0.0.1:9870", "udp://:9870", "udp://a:99999", "udp://a:x"]
)
def test_what_is_no_address(text: str) -> None:
    with pytest.raises(InputError, match="no address to stream to"):
        StreamAddress.parse(text)


def test_a_computer_nobody_knows() -> None:
    with pytest.raises(InputError, match="no computer"):
        StreamAddress.parse("udp://no-such-computer.invalid:9870")
