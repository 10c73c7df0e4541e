"""session web."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from functools import partial
from threading import Event, Thread

from tailbeat.app.cli._camera import CameraOptions, live_camera
from tailbeat.app.cli._fish import Connect, Stream
from tailbeat.app.cli._lazy import opt
from tailbeat.app.cli._options import EXPERIMENTS, Root
from tailbeat.app.cli._terminal import json_asked, print_line
from tailbeat.app.web.picture import LastPicture
from tailbeat.app.web.server import listen, serve
from tailbeat.app.web.state import corners
from tailbeat.app.web.worker import Worker, simulated_camera
from tailbeat.board.connect import open_transport
from tailbeat.board.fish import Fish
from tailbeat.core.speed_source import Camera
from tailbeat.session.guards import Guard
from tailbeat.sim.board import in_process
from tailbeat.sim.server import SimServer


def web(
    *,
    connect: Connect = None,
    host: str = opt(
        "Where to listen; 0.0.0.0 = also for a phone in the same network, with a token.",
        "ADDRESS",
        default="127.0.0.1",
    ),
    port: int = opt("0 = any that is free.", min=0, max=65535, default=8080),
    open_: bool = opt("Show the page in a browser at once.", name="--open/--no-open", default=True),
    root: Root = EXPERIMENTS,
    stream: Stream = None,
    camera: CameraOptions,
    speed: float = opt("With --connect sim: simulated seconds per second.", default=1.0),
) -> None:
    """Run the session on a web page: start, stop, decide, look.

    This computer serves the page. Ctrl-C ends it and stops the tail.

    Example: tailbeat session web --connect sim --speed 5
    """
    camera.on_fish()
    place = listen(host, port)
    with contextlib.closing(place.listener), _board(connect, speed) as make:
        urls = "\n".join(f"the page: {url}" for url in place.urls)
        print_line({"urls": place.urls, "port": place.port}, f"{urls}\n(Ctrl-C ends it)")
        picture = None if camera.positions else LastPicture()
        open_camera = partial(_camera, camera, picture)
        known = camera.calibration
        walls = corners(known.area_m) if known is not None else ()
        worker = Worker(make, root, open_camera, stream=stream, picture=picture, walls=walls)
        serve(worker, place, open_ and not json_asked.get())


@contextlib.contextmanager
def _board(url: str | None, speed: float) -> Iterator[Callable[[], Fish]]:
    """How to connect. A board that would live in this process gets a time of its own: otherwise its
    trials would be over before anybody could look."""
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


@contextlib.contextmanager
def _camera(
    options: CameraOptions, picture: LastPicture | None, fish: Fish
) -> Iterator[tuple[Camera | None, Guard | None]]:
    """The camera of ``trial run``, opened for each series; that of a simulated board by itself."""
    on_picture = picture.take if picture is not None else None
    with live_camera(fish, options, on_picture=on_picture) as live:
        if live.camera is not None:
            yield live.camera, live.guard
            return
        with simulated_camera(fish) as (camera, _):
            yield camera, live.guard
