"""What the board reports, as JSON datagrams, for a program that draws them while the fish swims.

One datagram for each message: ``{"timestamp": 12.34, "beat": {...}}``, the values those of
``board watch``. PlotJuggler's UDP server reads it as it is.
"""

from __future__ import annotations

import contextlib
import json
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from tailbeat.core.errors import InputError
from tailbeat.core.files import plain
from tailbeat.link.mavlink import Link, Message
from tailbeat.link.messages import WATCHED

_SCHEME = "udp://"
_PORT_MAX = 65535
_TEXT = "STATUSTEXT"  # there is nothing to draw in it


@dataclass(frozen=True)
class StreamAddress:
    """Where the datagrams go."""

    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> StreamAddress:
        """``udp://HOST:PORT``. Raises InputError."""
        host, _, port = text.removeprefix(_SCHEME).rpartition(":")
        is_number = port.isascii() and port.isdigit() and len(port) <= len(str(_PORT_MAX))
        if not text.startswith(_SCHEME) or not host or not is_number or int(port) > _PORT_MAX:
            raise InputError(
                f"'{text}' is no address to stream to.", "Write it like udp://127.0.0.1:9870."
            )
        try:
            found = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_DGRAM)
        except (OSError, UnicodeError) as error:
            raise InputError(
                f"there is no computer {host} to stream to.", "Give its name or its IP address."
            ) from error
        return cls(str(found[0][4][0]), int(port))


@contextlib.contextmanager
def streaming(link: Link, to: StreamAddress | None) -> Iterator[None]:
    """Sends every message of the board but its texts as long as this lasts; None: to nobody. What
    nobody takes is lost, and stops nothing."""
    if to is None:
        yield
        return
    family = socket.AF_INET6 if ":" in to.host else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as out:
        out.setblocking(False)
        stop = link.subscribe(_sender(lambda data: out.sendto(data, (to.host, to.port))))
        try:
            yield
        finally:
            stop()


def _sender(send: Callable[[bytes], object]) -> Callable[[Message], None]:
    """Board time is that of the last message that had one: a beat and a step have none. Before the
    first of those nothing is sent."""
    time_s: float | None = None

    def hear(message: Message) -> None:
        nonlocal time_s
        kind = message.get_type()
        if kind not in WATCHED or kind == _TEXT:
            return
        values = WATCHED[kind](message)
        name = values.pop("event")
        time_s = values.pop("time_s", time_s)
        if time_s is None:
            return
        values = {key: value for key, value in plain(values).items() if value is not None}
        document = {"timestamp": round(time_s, 6), name: values}
        with contextlib.suppress(OSError):
            send(json.dumps(document).encode())

    return hear
