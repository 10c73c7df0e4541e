"""Under which addresses other computers see this one."""

from __future__ import annotations

import contextlib
import ipaddress
import socket
import struct

_SIOCGIFADDR = 0x8915
_ANY = ("0.0.0.0", "::")


def reached_at(host: str) -> list[str]:
    """The hosts to put into an address for a server that listens on ``host``; at least one."""
    if host not in _ANY:
        return [f"[{host}]" if ":" in host else host]
    found = dict.fromkeys([*_of_interfaces(), *_of_name()])
    usual = [one for one in found if not ipaddress.ip_address(one).is_loopback]
    return usual or ["127.0.0.1"]


def _of_interfaces() -> list[str]:
    """Linux tells the address of every interface; nothing is sent."""
    try:
        from fcntl import ioctl
    except ImportError:
        return []
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        for _, name in socket.if_nameindex():
            with contextlib.suppress(OSError):  # an interface without an address
                request = struct.pack("256s", name.encode()[:15])
                answer = ioctl(asked.fileno(), _SIOCGIFADDR, request)
                found.append(socket.inet_ntoa(answer[20:24]))
    return found


def _of_name() -> list[str]:
    with contextlib.suppress(OSError):
        entries = socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)
        return [str(entry[4][0]) for entry in entries]
    return []
