"""Small requests while many ask for the page: by the order of events, not by a clock."""

from __future__ import annotations

import asyncio
from typing import Any

from tailbeat.app.web.access import Guarded, Rules
from tailbeat.app.web.server import WAITING_MAX, Turns

MANY = 150
FILE = "/raw/0001.ulg"
OWN = [(b"host", b"127.0.0.1:8080"), (b"origin", b"http://127.0.0.1:8080")]


class House:
    """The door, and behind it pages that are made in one go, as NiceGUI makes them. ``events``:
    what happened, in order. ``shut``: none gets ready as long as it is clear."""

    def __init__(self, ready: bool = True) -> None:
        self.events: list[str] = []
        self.at_once = self.most = 0
        self.shut = asyncio.Event()
        self.ready = ready
        self.taken = asyncio.Event()
        self.taken.set()
        self.door = Guarded(Turns(self.serve), Rules(None, 8080))

    async def serve(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["path"] == FILE:
            self.events.append("file")
            await send({"type": "http.response.start", "status": 200, "headers": []})
            await send({"type": "http.response.body", "body": b""})
        else:
            await self.make(scope, receive, send)

    async def make(self, scope: Any, receive: Any, send: Any) -> None:
        self.at_once += 1
        self.most = max(self.most, self.at_once)
        if not self.ready:
            await self.shut.wait()
        self.events.append("page")
        self.at_once -= 1
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await self.taken.wait()
        await send({"type": "http.response.body", "body": b""})

    async def ask(self, path: str, method: str = "GET") -> tuple[int, dict[bytes, bytes]]:
        sent: list[Any] = []

        async def receive() -> Any:
            return {"type": "http.disconnect"}

        async def send(message: Any) -> None:
            sent.append(message)

        scope = {"type": "http", "scheme": "http", "method": method, "path": path, "headers": OWN}
        await self.door(scope, receive, send)
        return sent[0]["status"], dict(sent[0]["headers"])


def test_a_file_overtakes_the_pages_that_wait() -> None:
    async def day() -> tuple[House, list[int]]:
        house = House()
        pages = [asyncio.create_task(house.ask("/")) for _ in range(MANY)]
        stop = asyncio.create_task(house.ask(FILE))
        status = [(await stop)[0]]
        return house, status + [(await page)[0] for page in pages]

    house, (stopped, *pages) = asyncio.run(day())
    assert stopped == 200
    assert house.events[0] == "file"  # though it came last
    assert pages.count(200) == house.events.count("page") == WAITING_MAX + 1
    assert pages.count(503) == MANY - WAITING_MAX - 1


def test_a_connection_is_answered_between_two_pages() -> None:
    """One that is only now taken in: it needs the loop to look at its sockets several times."""

    async def day() -> int:
        house = House()
        server = await asyncio.start_server(lambda r, w: _serve(house, r, w), "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        pages = [asyncio.create_task(house.ask("/")) for _ in range(WAITING_MAX)]
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"stop\n")
        assert await reader.readline() == b"200\n"
        before = house.events.index("file")
        await asyncio.gather(*pages)
        writer.close()
        server.close()
        return before

    assert asyncio.run(day()) <= 2


async def _serve(house: House, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    await reader.readline()
    status, _ = await house.ask(FILE)
    writer.write(f"{status}\n".encode())
    writer.close()


def test_a_file_is_answered_while_no_page_gets_ready() -> None:
    async def day() -> None:
        house = House(ready=False)
        pages = [asyncio.create_task(house.ask("/")) for _ in range(MANY)]
        assert (await house.ask(FILE))[0] == 200
        assert house.events == ["file"]
        house.shut.set()
        await asyncio.gather(*pages)
        assert house.most == 1

    asyncio.run(day())


def test_who_came_too_late_is_told_when_to_come_again() -> None:
    async def day() -> tuple[int, dict[bytes, bytes]]:
        house = House(ready=False)
        pages = [asyncio.create_task(house.ask("/")) for _ in range(WAITING_MAX + 1)]
        for _ in range(20):
            await asyncio.sleep(0)
        late = await house.ask("/")
        house.shut.set()
        await asyncio.gather(*pages)
        assert (await house.ask("/"))[0] == 200
        return late

    status, headers = asyncio.run(day())
    assert status == 503
    assert int(headers[b"retry-after"]) > 0
    assert headers[b"x-frame-options"] == b"DENY"


def test_a_browser_that_takes_nothing_in_holds_up_nobody() -> None:
    async def day() -> None:
        house = House()
        house.taken.clear()
        pages = [asyncio.create_task(house.ask("/")) for _ in range(3)]
        for _ in range(100):
            await asyncio.sleep(0)
        assert house.events == ["page"] * 3
        house.taken.set()
        await asyncio.gather(*pages)

    asyncio.run(day())


def test_a_page_that_fails_gives_its_turn_on() -> None:
    async def fail(scope: Any, receive: Any, send: Any) -> None:
        raise ValueError("no page")

    async def day() -> list[Any]:
        house = House()
        house.door = Guarded(Turns(fail), Rules(None, 8080))
        asked = [house.ask("/") for _ in range(3)]
        return await asyncio.gather(*asked, return_exceptions=True)

    assert [str(error) for error in asyncio.run(day())] == ["no page"] * 3
