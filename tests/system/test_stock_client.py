"""A stranger's MAVLink program: plain pymavlink with the common dialect, and its own mavftp."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.session.trial import run_trial


@pytest.fixture
def address(simulator) -> Iterator[str]:
    with simulator(50) as (listen, _):
        yield listen


CLIENT = """
import json, sys, time
from pathlib import Path
from pymavlink import mavutil
from pymavlink.mavftp import MAVFTP

address, remote, local = sys.argv[1:]
link = mavutil.mavlink_connection(address, dialect="common", source_system=254)
heartbeat = link.wait_heartbeat(timeout=600)
link.target_system, link.target_component = 1, 1
link.mav.heartbeat_send(6, 8, 0, 0, 4)
link.mav.param_request_list_send(1, 1)
params = {}
deadline = time.monotonic() + 600
while time.monotonic() < deadline:
    message = link.recv_match(type="PARAM_VALUE", blocking=True, timeout=1)
    if message is None:
        continue
    params[message.param_id] = message.param_value
    if len(params) == message.param_count:
        break
ftp = MAVFTP(link, target_system=1, target_component=1)
listed = ftp.cmd_list(["/trials"])
ftp.cmd_get([remote, local])
got = ftp.process_ftp_reply("OpenFileRO", timeout=600)
print(json.dumps({
    "type": heartbeat.type, "autopilot": heartbeat.autopilot, "params": params,
    "list_error": int(listed.error_code), "get_error": int(got.error_code),
    "entries": [[e.name, e.size_b] for e in ftp.list_result],
}))
"""


def swim_one(address: str) -> bytes:
    with Fish.connect(address) as fish:
        fish.upload_reference(records.encode_reference(1.0, [0.05] * 20))
        assert run_trial(fish).end == "complete"
        fish.learn()
        return fish.ftp.read("/trials/0001.ulg")


def test_a_stock_client_reads_parameters_and_pulls_a_trial(address: str, tmp_path: Path) -> None:
    expected = swim_one(address)
    local = tmp_path / "pulled.ulg"
    done = subprocess.run(
        [sys.executable, "-c", CLIENT, address, "/trials/0001.ulg", str(local)],
        env={**os.environ, "MAVLINK20": "1"},
        capture_output=True,
        text=True,
        timeout=1200,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    assert (told["type"], told["autopilot"]) == (0, 0)
    with Fish.connect(address) as fish:
        ours = fish.params.values()
    assert told["params"] == ours
    assert (told["list_error"], told["get_error"]) == (0, 0)
    assert ["0001.ulg", len(expected)] in told["entries"]
    assert local.read_bytes() == expected
