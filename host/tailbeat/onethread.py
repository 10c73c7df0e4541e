"""One thread of linear algebra, so that numbers do not depend on how many cores a computer has.

The order in which threads add up would be in the last bits; besides, more threads than processes
would fight for the cores.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from typing import Any


class _Limit:
    """The limit is one of the whole process: the last of its threads to leave lifts it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._limits: Any = None

    def enter(self) -> None:
        import scipy.linalg  # noqa: F401  what is loaded later would not be limited
        from threadpoolctl import threadpool_limits

        with self._lock:
            if self._inside == 0:
                _take_control()
                self._limits = threadpool_limits(limits=1)
            self._inside += 1

    def leave(self) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                _take_control()
                self._limits.restore_original_limits()
                _take_control()


def _take_control() -> None:
    """threadpoolctl lets only one thread limit OpenBLAS: the next that does, from now on."""
    from threadpoolctl import OpenBLASController

    OpenBLASController.clear_controlling_thread(force=True)


_limit = _Limit()


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """As long as anybody is inside, BLAS and LAPACK of this process use one thread."""
    _limit.enter()
    try:
        yield
    finally:
        _limit.leave()
