"""How much of the run that was asked for is done. Whoever computes tells it; nobody need listen."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

Show = Callable[[float], None]  # part of the work done, 0 to 1

_listener: ContextVar[Show | None] = ContextVar("listener", default=None)


@contextmanager
def heard(show: Show) -> Iterator[None]:
    """``show`` gets what is told within."""
    token = _listener.set(show)
    try:
        yield
    finally:
        _listener.reset(token)


def tell(done: int, of: int) -> None:
    """Trials that are done. Costs nothing that counts beside a trial."""
    show = _listener.get()
    if show is not None:
        show(done / of)
