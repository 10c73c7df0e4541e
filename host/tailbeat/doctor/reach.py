"""The way to the board: the port, and whether a board is heard there."""

from __future__ import annotations

from tailbeat.doctor.finding import OK, PROBLEM, Figures, Finding
from tailbeat.errors import ConnectError, TailbeatError
from tailbeat.transport.base import Transport
from tailbeat.transport.find import LISTEN_S, find_board, hear_board, open_transport
from tailbeat.transport.hearing import Hearing
from tailbeat.transport.inprocess import in_process
from tailbeat.transport.portaccess import CLOSE_IT, holders
from tailbeat.transport.serialport import SerialTransport, is_radio


def reach(url: str | None) -> tuple[list[Finding], Transport | None]:
    """Opens and listens; no transport when that fails."""
    try:
        transport = find_board() if url is None else open_transport(url)
    except ConnectError as error:
        return [Finding("port", PROBLEM, error.message, error.remedy)], None
    port = _port(transport)
    board = Finding("board", OK, "a tailbeat board is heard")
    if url is not None:
        board = _listen(transport)
    if board.status == OK:
        return [port, board], transport
    transport.close()
    return [port, board], None


def by_radio(transport: Transport) -> bool:
    """Whether the way to the board is known to be its radio."""
    return isinstance(transport, SerialTransport) and is_radio(transport.name)


def _port(transport: Transport) -> Finding:
    users = holders(transport.name) if isinstance(transport, SerialTransport) else []
    if users:
        text = f"{transport.name} opens, but it is in use by {', '.join(users)}, too"
        return Finding("port", PROBLEM, text, CLOSE_IT)
    return Finding("port", OK, _what(transport))


def _what(transport: Transport) -> str:
    if in_process(transport) is not None:
        return f"{transport.name}, a board in this process"
    if isinstance(transport, SerialTransport):
        kind = "the radio" if by_radio(transport) else "a serial port"
        return f"{transport.name} opens, {kind}"
    return f"{transport.name} opens"


def _listen(transport: Transport) -> Finding:
    hearing = Hearing(transport.name)
    begin_s = transport.now_s()
    try:
        heard = hear_board(transport, LISTEN_S, hearing) is not None
    except TailbeatError as error:
        return Finding("board", PROBLEM, error.message, error.remedy)
    measured: Figures = {
        "bytes": hearing.count,
        "heard": "board" if heard else hearing.kind,
        "after_s": round(transport.now_s() - begin_s, 3),
    }
    if heard:
        return Finding("board", OK, "a tailbeat board is heard", "", measured)
    return Finding("board", PROBLEM, *hearing.words(), measured)
