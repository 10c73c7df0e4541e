"""The one interface every link to a board has."""

from __future__ import annotations

from typing import Protocol


class Transport(Protocol):
    """A byte stream to a board, and the clock that its waits are measured with.

    For a real link the clock is the machine's monotonic one. For a board in this process it is the
    simulated time, and waiting is what makes that time pass.
    """

    name: str

    def read(self) -> bytes:
        """What has arrived; never blocks. Raises LinkLostError when the other end is gone."""

    def write(self, data: bytes) -> None:
        """Queues bytes for sending; never blocks. Raises LinkLostError as read does."""

    def wait(self, timeout_s: float) -> None:
        """Returns after ``timeout_s``, or earlier when there may be bytes to read."""

    def now_s(self) -> float:
        """The clock. Monotonic, any origin."""

    def reopen(self) -> None:
        """Tries once to establish the link again. Raises ConnectError."""

    def close(self) -> None:
        """Gives the link up; may be called twice."""
