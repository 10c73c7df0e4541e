"""ABORT of the page while idle connections want all descriptors of
'tailbeat session web'. Loopback only."""

from __future__ import annotations

import http.client
import json
import os
import resource
import socket
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import urlsplit

import pytest

START = "from tailbeat.app.cli import main; main()"
NOBODY = "tcp:127.0.0.1:1"
DESCRIPTORS = 1024
IDLE = 1500
ABORTS = 20
PATIENCE_S = 600.0
HALF = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n"


def _few_descriptors() -> None:
    resource.setrlimit(resource.RLIMIT_NOFILE, (DESCRIPTORS, DESCRIPTORS))


def _request(port: int, path: str, method: str, headers: dict[str, str]) -> tuple[int, str, float]:
    """Status, cookie, seconds."""
    begin_s = time.monotonic()
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    try:
        connection.request(method, path, headers=headers)
        answer = connection.getresponse()
        answer.read()
        cookie = (answer.getheader("set-cookie") or "").partition(";")[0]
        return answer.status, cookie, time.monotonic() - begin_s
    finally:
        connection.close()


def _websocket(port: int, own: dict[str, str]) -> socket.socket:
    """What an open page holds."""
    lines = [
        "GET /_nicegui_ws/socket.io/?EIO=4&transport=websocket HTTP/1.1",
        f"Host: 127.0.0.1:{port}",
        *(f"{name}: {value}" for name, value in own.items()),
        "Upgrade: websocket",
        "Connection: Upgrade",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version: 13",
    ]
    held = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
    held.sendall("\r\n".join([*lines, "", ""]).encode())
    assert held.recv(4096).startswith(b"HTTP/1.1 101")
    return held


def _is_open(held: socket.socket) -> bool:
    held.setblocking(False)
    try:
        while held.recv(4096):
            pass
    except BlockingIOError:
        return True
    return False


def test_abort_gets_through_idle_connections(tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < IDLE + 200:
        pytest.skip(f"this computer lets a program open {hard} files only")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, IDLE + 200), hard))
    command = [sys.executable, "-c", START, "ui", "--connect", NOBODY, "--port", "0", "--json"]
    command += ["--root", str(tmp_path), "--host", "0.0.0.0", "--no-open"]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=_few_descriptors,
        env=os.environ | {"TAILBEAT_LOGBOOK": str(tmp_path), "TAILBEAT_KEYS": str(tmp_path)},
    )
    idle: list[socket.socket] = []
    try:
        assert process.stdout is not None
        url = urlsplit(json.loads(process.stdout.readline())["urls"][0])
        assert url.port is not None
        cookie = _request(url.port, f"/?{url.query}", "GET", {})[1]
        own = {"Cookie": cookie, "Origin": f"http://127.0.0.1:{url.port}"}
        page = _websocket(url.port, own)
        for _ in range(IDLE):
            idle.append(socket.create_connection(("127.0.0.1", url.port), PATIENCE_S))
            idle[-1].sendall(HALF)
        answers = [_request(url.port, "/abort", "POST", own) for _ in range(ABORTS)]
        held = len(list(Path(f"/proc/{process.pid}/fd").iterdir()))
        print(f"slowest ABORT {max(s for *_, s in answers):.3f} s, {held} descriptors in use")
        assert [status for status, *_ in answers] == [200] * ABORTS
        assert _is_open(page)  # who had the page open still has it
        assert _request(url.port, "/abort", "POST", {})[0] == 403
        assert _request(url.port, "/", "GET", own)[0] == 200  # and a new one can be opened
        assert held < DESCRIPTORS / 2  # the rest is for the logs and the link
    finally:
        process.kill()
        process.wait(PATIENCE_S)
        for one in idle:
            one.close()
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
