"""What several of the host tests need: a simulated board, and a bad radio in front of one."""

from __future__ import annotations

import copy
import functools
import pickle
import secrets
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest
import typer.main

from tailbeat.app.cli._terminal import json_asked
from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.learning import belief, error_bound, fit
from tailbeat.link.impaired import Corrupt, Drop, Duplicate, Fault, ImpairedLine
from tailbeat.link.transport import Transport

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in a shell's background job
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A process runs one command, the tests a thousand: to build them all takes 0.2 s each time.
typer.main.get_command = functools.cache(typer.main.get_command)


def _once(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, computed once for the same arguments: many tests have the same fish."""
    known: dict[bytes, Any] = {}

    @functools.wraps(function)
    def remembered(*arguments: Any, **named: Any) -> Any:
        try:
            key = pickle.dumps((arguments, named))
        except (TypeError, AttributeError, ValueError):  # a simulated plant
            return function(*arguments, **named)
        if key not in known:
            known[key] = function(*arguments, **named)
        return copy.deepcopy(known[key])

    return remembered


error_bound.minimax = _once(error_bound.minimax)  # type: ignore[attr-defined]
belief.fit_robust = fit.fit_robust = _once(fit.fit_robust)  # type: ignore[attr-defined]

FRAME_BYTES = 60  # of a usual one, for odds given per frame


class BadRadio(ImpairedLine):
    """A line that loses, damages and repeats frames both ways, and shows what was sent."""

    def __init__(
        self,
        inner: Transport,
        seed: int,
        lose: float = 0.0,
        damage: float = 0.0,
        twice: float = 0.0,
    ) -> None:
        def faults() -> list[Fault]:
            return [Drop(lose), Corrupt(damage / FRAME_BYTES), Duplicate(twice)]

        super().__init__(inner, faults(), faults(), seed)
        self.sent: list[bytes] = []
        self.on_write: Callable[[bytes], bool] | None = None

    def write(self, data: bytes) -> None:
        self.sent.append(data)
        if self.on_write is None or self.on_write(data):
            super().write(data)


@pytest.fixture(autouse=True)
def _no_json_asked() -> Iterator[None]:
    """A command that Typer's runner calls sets this for the process, which ends with it."""
    yield
    json_asked.set(False)


@pytest.fixture(autouse=True)
def _same_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """A transfer begins at a random sequence number; here every run begins at the same."""
    monkeypatch.setattr("tailbeat.link.ftp.client._first_number", lambda: 4711)


@pytest.fixture(autouse=True)
def keys_folder(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """No test sees, or touches, the keys of whoever runs it."""
    folder = tmp_path_factory.getbasetemp() / "keys" / secrets.token_hex(4)
    monkeypatch.setenv("TAILBEAT_KEYS", str(folder))
    return folder


@pytest.fixture(autouse=True)
def library_folder(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """Nor their trial libraries."""
    folder = tmp_path_factory.getbasetemp() / "data" / secrets.token_hex(4)
    monkeypatch.delenv("TAILBEAT_LOGBOOK", raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(folder))
    return folder / "tailbeat" / "fish"


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
    fish.params.set("ILC_LEAD", 1)
    fish.upload_reference(reference)
    return fish


@pytest.fixture(autouse=True)
def _unpainted(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made, but not painted, but for the tests that are about pictures: else painting
    them is a tenth of all."""
    if request.node.get_closest_marker("painted") is None:
        monkeypatch.setattr("matplotlib.figure.Figure.savefig", _nothing_painted)


def _nothing_painted(_: object, out: IO[bytes] | str | Path, **__: object) -> None:
    if isinstance(out, (str, Path)):
        Path(out).write_bytes(b"unpainted")
    else:
        out.write(b"unpainted")
