"""Puts connections that the gate has let in into the web server's event loop."""

from __future__ import annotations

import asyncio
import socket
from typing import TYPE_CHECKING, Any

from uvicorn.protocols.http.h11_impl import H11Protocol

if TYPE_CHECKING:
    import uvicorn


class _Begun(H11Protocol):
    """One whose first bytes were read already."""

    def __init__(self, begun: bytes, **given: Any) -> None:
        super().__init__(**given)
        self._begun = begun

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.data_received(self._begun)


class Entrance:
    """Of a server that has started in ``loop``."""

    def __init__(self, server: uvicorn.Server, loop: asyncio.AbstractEventLoop) -> None:
        self._server = server
        self._loop = loop
        self._tasks: set[asyncio.Task[None]] = set()

    def take(self, connection: socket.socket, begun: bytes) -> None:
        """From any thread. Raises RuntimeError when the loop has ended."""
        self._loop.call_soon_threadsafe(self._begin, connection, begun)

    def _begin(self, connection: socket.socket, begun: bytes) -> None:
        task = self._loop.create_task(self._connect(connection, begun))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _connect(self, connection: socket.socket, begun: bytes) -> None:
        def protocol() -> _Begun:
            return _Begun(
                begun,
                config=self._server.config,
                server_state=self._server.server_state,
                app_state=self._server.lifespan.state,
                _loop=self._loop,
            )

        try:
            await self._loop.connect_accepted_socket(protocol, connection)
        except OSError:
            connection.close()
