"""Serves the page until it is told to end; the tail is stopped first."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import signal
import socket
import sys
import webbrowser
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tailbeat.errors import ConnectError, reason
from tailbeat.ui.access import Access, Rules, is_loopback, new_token
from tailbeat.ui.addresses import reached_at
from tailbeat.ui.gate import Gate
from tailbeat.ui.turns import Turns

if TYPE_CHECKING:
    from types import FrameType

    from tailbeat.ui.conductor import Conductor

_BACKLOG = 1024
_DRAIN_S = 2
_RECONNECT_S = 10.0  # a phone that slept for a moment finds its page as it was


@dataclass(frozen=True)
class Place:
    """Where the page listens. ``urls``: what to type; with the token, if there is one."""

    listener: socket.socket
    token: str | None
    urls: list[str]

    @property
    def port(self) -> int:
        """The number, also when any free one was asked for."""
        return int(self.listener.getsockname()[1])


def listen(host: str, port: int) -> Place:
    """Takes the port. On another address than this computer's own there is a token."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        listener.listen(_BACKLOG)  # from here on who asks waits, and nobody else gets the port
    except (OSError, UnicodeError) as error:
        listener.close()
        taken = isinstance(error, OSError) and error.errno == errno.EADDRINUSE
        raise ConnectError(
            f"the page cannot listen on {host}:{port} ({reason(error)})",
            "Another page may run there already; else choose another port: --port 8081"
            if taken
            else "Give --host an address of this computer, or 0.0.0.0 for all of them.",
        ) from error
    number = listener.getsockname()[1]
    token = None if is_loopback(host) else new_token()
    asked = "" if token is None else f"?token={token}"
    return Place(listener, token, [f"http://{one}:{number}/{asked}" for one in reached_at(host)])


def serve(conductor: Conductor, place: Place, show: bool = False) -> None:
    """Runs until a signal ends it. Blocks; in the main thread only."""
    import uvicorn
    from fastapi import FastAPI
    from nicegui import app, ui

    from tailbeat.ui.handover import Entrance
    from tailbeat.ui.page import build

    build(conductor)
    outer = FastAPI(openapi_url=None)
    ui.run_with(
        outer,
        title="tailbeat",
        favicon="🐟",
        language="en-US",
        tailwind=False,
        reconnect_timeout=_RECONNECT_S,
        show_welcome_message=False,
    )
    if show:
        app.on_startup(lambda: _open(place.urls[0]))
    in_turn = Turns(outer)

    def abort() -> None:
        conductor.ask("abort")

    door = Access(in_turn, place.token, place.port, abort)
    gate = Gate(place.listener, Rules(place.token, place.port), abort)
    config = uvicorn.Config(
        door,
        interface="asgi3",
        loop="asyncio",
        http="h11",  # as the gate, so that both read a header alike
        ws="wsproto",
        log_level="warning",
        server_header=False,
        timeout_graceful_shutdown=_DRAIN_S,
    )

    class TailFirst(uvicorn.Server):
        """Stops the tail before it does anything else, and then ends in good order."""

        def handle_exit(self, sig: int, frame: FrameType | None) -> None:
            conductor.ask("abort")
            self.force_exit: bool = bool(self.should_exit)
            self.should_exit: bool = True

        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            await super().startup(sockets=[])  # the gate takes the connections
            gate.open(Entrance(self, asyncio.get_running_loop()).take)

    server = TailFirst(config)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, server.handle_exit)  # the terminal was closed
    conductor.start()
    try:
        server.run()
    finally:
        gate.close()
        conductor.close()


def _open(url: str) -> None:
    """In a browser with windows; one in the terminal would take it over."""
    windows = sys.platform in ("darwin", "win32")
    if windows or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        with contextlib.suppress(webbrowser.Error):
            webbrowser.open(url)
