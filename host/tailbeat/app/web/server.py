"""Under which addresses other computers see this one.

Serves the page until it is told to end; the tail is stopped first.

Who asks for a page waits for its turn: making one keeps the only thread of the server busy, and
between two of them ABORT gets through.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ipaddress
import itertools
import signal
import socket
import webbrowser
from collections.abc import Callable, MutableMapping
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import Any

import ifaddr
import uvicorn
from fastapi import FastAPI, HTTPException
from fastapi.responses import FileResponse, Response
from nicegui import app, ui

from tailbeat.app.web.access import (
    App,
    Guarded,
    Receive,
    Reply,
    Rules,
    Scope,
    Send,
    is_loopback,
    new_token,
)
from tailbeat.app.web.gate import Entrance, Gate
from tailbeat.app.web.page import Page
from tailbeat.app.web.worker import Worker
from tailbeat.core.errors import ConnectError, TailbeatError, reason
from tailbeat.core.platform.programs import has_windows, terminal_closed
from tailbeat.core.trial_file import beats_csv, read_trial

_ANY = ("0.0.0.0", "::")


def reached_at(host: str) -> list[str]:
    """The hosts to put into an address for a server that listens on ``host``; at least one."""
    if host not in _ANY:
        return [f"[{host}]" if ":" in host else host]
    found = [ip.ip for adapter in ifaddr.get_adapters() for ip in adapter.ips if ip.is_IPv4]
    usual = [str(one) for one in found if not ipaddress.ip_address(str(one)).is_loopback]
    return list(dict.fromkeys(usual)) or ["127.0.0.1"]


_BACKLOG = 1024
_DRAIN_S = 2
_TICK_S = 0.5
_RECONNECT_S = 10.0  # a phone that slept for a moment finds its page as it was


@dataclass(frozen=True)
class ListenAddress:
    """Where the page listens. ``urls``: what to type; with the token, if there is one."""

    listener: socket.socket
    token: str | None
    urls: list[str]

    @property
    def port(self) -> int:
        """The number, also when any free one was asked for."""
        return int(self.listener.getsockname()[1])


def listen(host: str, port: int) -> ListenAddress:
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
    return ListenAddress(
        listener, token, [f"http://{one}:{number}/{asked}" for one in reached_at(host)]
    )


class _TailFirst(uvicorn.Server):
    """Stops the tail before it does anything else, and then ends in good order."""

    def __init__(self, config: uvicorn.Config, gate: Gate, abort: Callable[[], None]) -> None:
        super().__init__(config)
        self._gate = gate
        self._abort = abort

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self._abort()
        self.force_exit: bool = bool(self.should_exit)
        self.should_exit: bool = True

    async def main_loop(self) -> None:
        """As uvicorn's, which looks ten times a second whether it shall end."""
        turns = itertools.count()
        while not await self.on_tick(next(turns)):
            await asyncio.sleep(_TICK_S)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets=[])  # the gate takes the connections
        self._gate.open(Entrance(self, asyncio.get_running_loop()).take)


def serve(worker: Worker, place: ListenAddress, show: bool = False) -> None:
    """Runs until a signal ends it. Blocks; in the main thread only."""
    build(worker)
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

    def abort() -> None:
        worker.ask("abort")

    rules = Rules(place.token, place.port)
    gate = Gate(place.listener, rules, abort)
    config = uvicorn.Config(
        Guarded(Turns(outer), rules),
        interface="asgi3",
        loop="asyncio",
        http="h11",  # as the gate, so that both read a header alike
        ws="wsproto",
        log_level="warning",
        server_header=False,
        timeout_graceful_shutdown=_DRAIN_S,
    )

    server = _TailFirst(config, gate, abort)
    for number in terminal_closed():
        signal.signal(number, server.handle_exit)
    worker.start()
    try:
        server.run()
    finally:
        gate.close()
        worker.close()


def _open(url: str) -> None:
    """In a browser with windows; one in the terminal would take it over."""
    if has_windows():
        with contextlib.suppress(webbrowser.Error):
            webbrowser.open(url)


def build(worker: Worker) -> None:
    """Registers the page and what goes with it."""
    serve_downloads(worker)

    @ui.page("/", title="tailbeat")
    def page() -> None:
        Page(worker)


def serve_downloads(worker: Worker) -> None:
    """``/raw/NAME``: a log; ``/beats/NAME.csv``: its beats; only those in the trial list.
    ``/report``: the last report; ``/camera.jpg``: the camera's last picture."""

    def file_of(name: str) -> Path:
        path = worker.trials.raw_file(name)
        if path is None or not path.is_file():
            raise HTTPException(404, "there is no such trial")
        return path

    @app.get("/report")
    def report() -> Response:
        if (path := worker.trials.report_page()) is None:
            raise HTTPException(404, "there is no report yet")
        return FileResponse(path, media_type="text/html")

    @app.get("/camera.jpg")
    def camera() -> Response:
        picture = worker.picture.jpeg() if worker.picture is not None else None
        if picture is None:
            raise HTTPException(404, "there is no picture yet")
        return Response(picture, media_type="image/jpeg", headers={"cache-control": "no-store"})

    @app.get("/raw/{name}")
    def raw(name: str) -> Response:
        return FileResponse(file_of(name), media_type="application/octet-stream", filename=name)

    @app.get("/beats/{name}.csv")
    def beats(name: str) -> Response:
        path = file_of(f"{name}.ulg")
        try:
            with TemporaryDirectory() as folder:
                out = Path(folder) / "beats.csv"
                beats_csv(read_trial(path), out)
                text = out.read_text(encoding="utf-8")
        except TailbeatError as error:
            raise HTTPException(422, str(error)) from error
        headers = {"content-disposition": f'attachment; filename="{name}.csv"'}
        return Response(text, media_type="text/csv", headers=headers)


WAITING_MAX = 12  # pages of 0.1 to 0.3 s each: longer than that nobody waits for one
_AGAIN_S = 3
_PASSES = 8  # of the event loop: a connection is taken, read and answered in five
_LIGHT = ("/_nicegui", "/raw/", "/beats/", "/report", "/camera.jpg")  # files, read by other threads
_LATER = Reply(
    HTTPStatus.SERVICE_UNAVAILABLE,
    f'<!doctype html><meta charset="utf-8"><meta http-equiv="refresh" content="{_AGAIN_S}">'
    '<meta name="viewport" content="width=device-width"><title>tailbeat</title>'
    "<p>tailbeat: too many requests at once; the page reloads in a moment.",
    "text/html",
    ((b"retry-after", str(_AGAIN_S).encode()),),
)


@dataclass
class Turns:
    """Before ``app`` (ASGI): one page at a time, and at most WAITING_MAX that wait. More get a 503,
    with which their browser comes again by itself."""

    app: App
    _turn: asyncio.Lock = field(default_factory=asyncio.Lock)
    _waiting: int = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or str(scope["path"]).startswith(_LIGHT):
            await self.app(scope, receive, send)
        elif self._waiting >= WAITING_MAX:
            head = {"status": _LATER.status, "headers": _LATER.all_headers()}
            await send({"type": "http.response.start", **head})
            await send({"type": "http.response.body", "body": _LATER.text.encode()})
        else:
            await self._in_turn(scope, receive, send)

    async def _in_turn(self, scope: Scope, receive: Receive, send: Send) -> None:
        self._waiting += 1
        try:
            await self._turn.acquire()
        finally:
            self._waiting -= 1
        is_made = False

        async def sent(message: MutableMapping[str, Any]) -> None:
            nonlocal is_made
            if not is_made:  # who takes it in slowly holds up nobody
                is_made = True
                self._turn.release()
            await send(message)

        try:
            for _ in range(_PASSES):
                await asyncio.sleep(0)
            await self.app(scope, receive, sent)
        finally:
            if not is_made:
                self._turn.release()
