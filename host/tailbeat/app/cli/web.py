"""session web."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from threading import Event, Thread
from typing import Annotated

import typer

from tailbeat.app.cli._camera import CAMERA, CameraOptions, LiveOptions, live_camera
from tailbeat.app.cli._options import EXPERIMENTS, Connect, Json, Root
from tailbeat.app.cli._terminal import echo, json_line
from tailbeat.app.web.server import listen, serve
from tailbeat.app.web.worker import OpenCamera, Worker, simulated_camera
from tailbeat.board.connect import open_transport
from tailbeat.board.fish import Fish
from tailbeat.core.frames import Camera
from tailbeat.session.guards import Guard
from tailbeat.sim.board import in_process
from tailbeat.sim.server import SimServer


def web(
    connect: Connect = None,
    host: Annotated[
        str,
        typer.Option(
            "--host",
            metavar="ADDRESS",
            help="Where to listen; 0.0.0.0 = also for a phone in the same network, with a token.",
        ),
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option("--port", min=0, max=65535, help="0 = any that is free.")
    ] = 8080,
    open_: Annotated[
        bool, typer.Option("--open/--no-open", help="Show the page in a browser at once.")
    ] = True,
    root: Root = EXPERIMENTS,
    camera: CameraOptions = CAMERA,
    speed: Annotated[
        float, typer.Option("--speed", help="With --connect sim: simulated seconds per second.")
    ] = 1.0,
    json: Json = False,
) -> None:
    """Run the session on a web page: start, stop, decide, look.

    This computer serves the page. Ctrl-C ends it and stops the tail.

    Example: tailbeat session web --connect sim --speed 5
    """
    options = camera.live()
    place = listen(host, port)
    with contextlib.closing(place.listener), _board(connect, speed) as make:
        if json:
            json_line({"urls": place.urls, "port": place.port})
        else:
            echo("\n".join(f"the page: {url}" for url in place.urls) + "\n(Ctrl-C ends it)")
            sys.stdout.flush()
        serve(Worker(make, root, _eyes(options)), place, open_ and not json)


@contextlib.contextmanager
def _board(url: str | None, speed: float) -> Iterator[Callable[[], Fish]]:
    """How to connect. A board that would live in this process gets a time of its own: otherwise its
    swims would be over before anybody could look."""
    if url is None or url.partition(":")[0] not in ("sim", "vboard"):
        yield lambda: Fish.connect(url)
        return

    transport = in_process(open_transport(url))
    assert transport is not None
    server = SimServer(transport.board, "tcp:127.0.0.1:0", speed=speed)
    ended = Event()
    thread = Thread(target=server.serve, args=(ended.is_set,), name="board", daemon=True)
    thread.start()
    try:
        yield lambda: Fish.connect(server.addresses.listen)
    finally:
        ended.set()
        thread.join()
        server.close()


def _eyes(options: LiveOptions) -> OpenCamera:
    """The camera of ``trial run``, opened for each series; that of a simulated board by itself."""

    @contextlib.contextmanager
    def open_eyes(fish: Fish) -> Iterator[tuple[Camera | None, Guard | None]]:
        with live_camera(fish, options) as live:
            if live.camera is not None:
                yield live.camera, live.guard
                return
            with simulated_camera(fish) as (camera, _):
                yield camera, live.guard

    return open_eyes
