"""From a connect URL, or from nothing, to an open transport."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl

from tailbeat.core.errors import (
    ConnectError,
    InputError,
    NoBoardError,
    TailbeatError,
    did_you_mean,
)
from tailbeat.core.extras import lazy
from tailbeat.link import _dialect as mavlink
from tailbeat.link.frames import Framer
from tailbeat.link.keystore import KeyStore
from tailbeat.link.mavlink import BOARD_COMPONENT, BOARD_SYSTEM, Message
from tailbeat.link.serial import SerialTransport, likely_ports
from tailbeat.link.sockets import TcpTransport, UdpTransport
from tailbeat.link.transport import Hearing, Transport
from tailbeat.sim.board import CONSOLE, RADIO, SimBoard, SimTransport
from tailbeat.sim.config import DEFAULT_SEED

# Most connections need neither.
if TYPE_CHECKING:
    from tailbeat.link import impaired
    from tailbeat.sim import emulated
else:
    impaired, emulated = lazy("tailbeat.link.impaired"), lazy("tailbeat.sim.emulated")

DEFAULT_HOST, DEFAULT_PORT = "127.0.0.1", 5760
_HELLO_S = 0.4
LISTEN_S = 3.0  # a board that was reset by opening its port is up again by then
GRAMMAR = (
    "a serial path, tcp:HOST:PORT, udp:PORT, udp:HOST:PORT, sim, sim:tank, sim:reactive,"
    " sim:thesis, vboard or vboard:IMAGE (the last six with ?plant=tank&seed=1&kappa=5&port=console"
    "&line=drop=0.2,delay=hc05…)"
)
_HEARTBEAT_S = 1.0
_SCHEMES = ("tcp", "udp", "sim", "vboard")
_PORTS = {"radio": RADIO, "console": CONSOLE}  # of a board in this process
_WORDS = ("plant", "port", "line")
DEFAULT_PLANT = "tank"
_PORT_MAX, _PORT_DIGITS = 65535, 5


def open_transport(url: str | None = None, /, **sim_overrides: float) -> Transport:
    """The transport ``url`` means; None finds the fish. Raises ConnectError, InputError."""
    if url is None:
        return find_board()
    if is_simulated(url):
        return _open_simulated(url, sim_overrides)
    if sim_overrides:
        raise InputError(
            "simulator values given for a board that is none", "Connect to sim or vboard."
        )
    scheme, _, rest = url.partition(":")
    if scheme == "tcp":
        return TcpTransport(*tcp_address(url))
    if scheme == "udp":
        host, _, port = rest.rpartition(":")
        return UdpTransport(host or None, _port(port, url))
    if url.startswith(("/", "./", "../", "~")) or url.upper().startswith("COM"):
        return SerialTransport(url)
    meant = did_you_mean(scheme, _SCHEMES)
    raise InputError(f"cannot make sense of the address {url}", f"{meant}It is {GRAMMAR}.")


def find_board(listen_s: float = LISTEN_S) -> Transport:
    """The first fish that is heard: on serial ports, then on the simulator's usual TCP port."""
    tried: list[str] = []
    remedies: list[str] = []
    garbled: Hearing | None = None
    for name, opener in _candidates():
        try:
            transport = opener()
        except ConnectError as error:
            simulator = name.startswith("tcp:")
            tried.append(f"no simulator at {name}" if simulator else f"{name} ({error.message})")
            if not simulator:
                remedies.append(error.remedy)
            continue
        hearing = Hearing(transport.name)
        try:
            heard = hear_board(transport, listen_s, hearing)
        except ConnectError as error:  # another program has it
            transport.close()
            tried.append(f"{name} ({error.message})")
            remedies.append(error.remedy)
            continue
        except TailbeatError:
            heard = None
        if heard is not None:
            return transport
        transport.close()
        tried.append(f"{name} ({hearing.short()})")
        if hearing.kind == "garbage":
            garbled = garbled or hearing
    if garbled is not None:
        raise ConnectError(*garbled.words())
    if len(tried) == 1:
        tried.insert(0, "no serial port looks like a Bluetooth link or has a Due's USB ids")
    remedies.append(
        "Switch the fish on, pair its Bluetooth module, or name its port with --connect."
        " Without a fish: tailbeat sim"
    )
    raise ConnectError(f"no fish found: {', '.join(tried)}", " ".join(dict.fromkeys(remedies)))


def require_board(transport: Transport, timeout_s: float = LISTEN_S) -> Message:
    """The same as hear_board; raises ConnectError, which says what was heard instead of a board."""
    hearing = Hearing(transport.name)
    heartbeat = hear_board(transport, timeout_s, hearing)
    if heartbeat is None:
        raise NoBoardError(hearing.kind, *hearing.words())
    return heartbeat


def hear_board(
    transport: Transport, timeout_s: float = LISTEN_S, hearing: Hearing | None = None
) -> Message | None:
    """The first heartbeat of a tailbeat board; None when there is none in time, then ``hearing``
    has what was heard instead.

    Asks for one instead of waiting for the next; behind UDP nobody speaks before being spoken to.
    Whoever has keys waits for a second before: a board with a key counts such unsigned questions.
    """
    if hearing is None:
        hearing = Hearing(transport.name)
    mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    framer = Framer(mav)
    hello = mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
    )
    ask = mavlink.MAVLink_command_long_message(
        BOARD_SYSTEM, BOARD_COMPONENT, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 0, 0, 0, 0, 0, 0, 0
    )
    begin_s = transport.now_s()
    deadline = begin_s + timeout_s
    next_hello_s = begin_s
    ask_s = begin_s + (_HEARTBEAT_S if KeyStore() else 0.0)
    while (now := transport.now_s()) < deadline:
        if now >= next_hello_s:
            transport.write(hello.pack(mav) + (ask.pack(mav) if now >= ask_s else b""))
            next_hello_s = now + _HELLO_S
        data = transport.read()
        hearing.add(data, now)
        for message in framer.push(data):
            if is_board(message):
                return message
            if message.get_type() == "HEARTBEAT":
                hearing.strangers += 1
        transport.wait(min(deadline, next_hello_s) - now)
    return None


# Earlier firmware was a submarine, for which other programs have names of modes.
_BOARD_TYPES = (mavlink.MAV_TYPE_GENERIC, mavlink.MAV_TYPE_SUBMARINE)


def is_board(message: Message) -> bool:
    """Whether this is a heartbeat of a fish."""
    return bool(
        message.get_type() == "HEARTBEAT"
        and message.get_srcSystem() == BOARD_SYSTEM
        and message.get_srcComponent() == BOARD_COMPONENT
        and message.type in _BOARD_TYPES
        and message.autopilot == mavlink.MAV_AUTOPILOT_GENERIC
    )


def _candidates() -> Iterator[tuple[str, Callable[[], Transport]]]:
    for path in likely_ports():
        yield path, lambda path=path: SerialTransport(path)  # type: ignore[misc]
    yield (
        f"tcp:{DEFAULT_HOST}:{DEFAULT_PORT}",
        lambda: TcpTransport(DEFAULT_HOST, DEFAULT_PORT, connect_timeout_s=0.5),
    )


def is_simulated(url: str) -> bool:
    """Whether ``url`` means a board in this process, with a simulated fish."""
    return _kind(url) in ("sim", "vboard")


def _kind(url: str) -> str:
    return url.partition("?")[0].partition(":")[0]


def _open_simulated(url: str, overrides: dict[str, float]) -> Transport:
    head, _, query = url.partition("?")
    kind, _, what = head.partition(":")
    words, values = _settings(query)
    values |= overrides
    port = _PORTS.get(words.get("port", "radio"))
    if port is None:
        raise InputError(f"a board has no port {words['port']}", f"It is {' or '.join(_PORTS)}.")
    if kind == "vboard":
        image = Path(what) if what else None
        board = emulated.EmulatedBoard(image, words.get("plant", DEFAULT_PLANT), **values)
        return _behind(words, SimTransport(board, port), values)
    plant = words.get("plant", what or DEFAULT_PLANT)
    if what and what != plant:
        raise InputError(f"{url} names two plants", f"The address is {GRAMMAR}.")
    return _behind(words, SimTransport(SimBoard(plant, **values), port), values)


def _behind(words: dict[str, str], transport: Transport, values: dict[str, float]) -> Transport:
    """``transport`` behind the bad line that the address asks for, if it does."""
    if "line" not in words:
        return transport
    up, down = impaired.faults_of(words["line"])
    return impaired.ImpairedLine(transport, up, down, int(values.get("seed", DEFAULT_SEED)))


def _settings(query: str) -> tuple[dict[str, str], dict[str, float]]:
    """What stands behind the ? of an address: words and numbers. Raises InputError."""
    words: dict[str, str] = {}
    values: dict[str, float] = {}
    for name, text in parse_qsl(query, keep_blank_values=True):
        if words.get(name, text) != text:
            what = f"{name} is given as {words[name]} and as {text}"
            raise InputError(what, "Say it once.")
        words[name] = text
        try:
            values[name] = int(text) if text.isdecimal() else float(text)
        except ValueError:
            if name not in _WORDS:
                what = f"{name}={text} is not a number"
                raise InputError(what, f"The address is {GRAMMAR}.") from None
    for name in _WORDS:
        values.pop(name, None)
    return words, values


def tcp_address(url: str) -> tuple[str, int]:
    """``tcp:HOST:PORT`` to (host, port). Raises InputError."""
    scheme, _, rest = url.partition(":")
    if scheme != "tcp":
        raise InputError(f"{url} is no TCP address", "Write it like tcp:127.0.0.1:5761.")
    host, _, port = rest.rpartition(":")
    return host.strip("[]") or DEFAULT_HOST, _port(port, url)


def _port(text: str, url: str) -> int:
    if not (text.isascii() and text.isdigit()):
        raise InputError(f"{url} has no port number", f"The address is {GRAMMAR}.")
    if len(text) > _PORT_DIGITS or not 0 < int(text) <= _PORT_MAX:
        raise InputError(
            f"the port {text} of {url} is out of range", f"Give a port from 1 to {_PORT_MAX}."
        )
    return int(text)
