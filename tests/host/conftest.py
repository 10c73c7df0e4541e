"""What several of the host tests need: a simulated board, and a bad radio in front of one."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from tailbeat import records
from tailbeat.fish import Fish
from tailbeat.transport import Transport


class BadRadio:
    """A transport that loses, damages and repeats whole writes and reads, from a seed."""

    def __init__(
        self,
        inner: Transport,
        seed: int,
        lose: float = 0.0,
        damage: float = 0.0,
        twice: float = 0.0,
    ) -> None:
        self.inner = inner
        self.name = f"bad {inner.name}"
        self.lose, self.damage, self.twice = lose, damage, twice
        self.sent: list[bytes] = []
        self.on_write: Callable[[bytes], bool] | None = None
        self._random = random.Random(seed)

    def _spoil(self, data: bytes) -> bytes:
        draw = self._random.random()
        if not data or draw < self.lose:
            return b""
        if draw < self.lose + self.damage:
            at = self._random.randrange(len(data))
            return data[:at] + bytes([data[at] ^ 0x41]) + data[at + 1 :]
        return data * 2 if draw < self.lose + self.damage + self.twice else data

    def read(self) -> bytes:
        data = self.inner.read()
        pieces = (data[i : i + 120] for i in range(0, len(data), 120))
        return b"".join(self._spoil(piece) for piece in pieces)

    def write(self, data: bytes) -> None:
        self.sent.append(data)
        if self.on_write is None or self.on_write(data):
            self.inner.write(self._spoil(data))

    def wait(self, timeout_s: float) -> None:
        self.inner.wait(timeout_s)

    def now_s(self) -> float:
        return self.inner.now_s()

    def reopen(self) -> None:
        self.inner.reopen()

    def close(self) -> None:
        self.inner.close()


@pytest.fixture(autouse=True)
def _same_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """A transfer begins at a random sequence number; here every run begins at the same."""
    monkeypatch.setattr("tailbeat.ftp.secrets.randbelow", lambda _: 4711)


@pytest.fixture
def fish() -> Iterator[Fish]:
    with Fish.connect("sim:tank?seed=1") as connected:
        yield connected


@pytest.fixture
def spoil() -> Callable[..., BadRadio]:
    """Puts a bad radio between a connected fish and its board."""

    def put(fish: Fish, seed: int = 1, **odds: float) -> BadRadio:
        radio = BadRadio(fish.transport, seed, **odds)
        fish.link.transport = radio
        return radio

    return put


@pytest.fixture
def reference() -> bytes:
    """Eight beats at up to 0.07 m/s."""
    return records.encode_reference(1.0, 0.07 * np.sin(np.linspace(0.2, 2.9, 8)))


@pytest.fixture
def ready(fish: Fish, reference: bytes) -> Fish:
    """A fish with a reference and a lead that suits the tank."""
    fish.params.set("LAW_LEAD", 1)
    fish.upload_reference(reference)
    return fish
