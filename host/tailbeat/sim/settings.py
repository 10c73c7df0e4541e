"""Plant, seed and values of a simulator in another process, from its fault-injection port."""

from __future__ import annotations

import json
import socket
from typing import Any

from tailbeat.link.sockets import TcpTransport
from tailbeat.link.transport import Transport

_TIMEOUT_S = 1.0
_LONGEST_BYTES = 20_000
# Places of that port behind the radio's and behind the wired console's (simserver.py).
_BEHIND_RADIO, _BEHIND_CONSOLE = 3, 1


def simulator_settings(transport: Transport) -> dict[str, Any]:
    """``plant``, ``seed`` and ``simulator`` (its values) of the simulator behind ``transport``.

    Empty when the simulator does not say: it is an older one, its ports are not in a row, or
    another program uses the fault-injection port.
    """
    if not isinstance(transport, TcpTransport):
        return {}
    for behind in (_BEHIND_RADIO, _BEHIND_CONSOLE):
        try:
            with socket.create_connection(
                (transport.host, transport.port + behind), _TIMEOUT_S
            ) as s:
                return _parse(_ask(s))
        except ConnectionRefusedError:
            continue
        except (OSError, OverflowError):
            break
    return {}


def _ask(connection: socket.socket) -> bytes:
    """The first line that answers ``config``."""
    connection.sendall(b"config\n")
    answer = b""
    while b"\n" not in answer and len(answer) < _LONGEST_BYTES:
        piece = connection.recv(4096)
        if not piece:
            break
        answer += piece
    return answer.partition(b"\n")[0]


def _parse(line: bytes) -> dict[str, Any]:
    try:
        said = json.loads(line)
    except ValueError:
        return {}
    wanted = {"plant": str, "seed": int, "simulator": dict}
    if not isinstance(said, dict) or not all(isinstance(said.get(k), t) for k, t in wanted.items()):
        return {}
    return {name: said[name] for name in wanted}
