"""Which class models what: the reference in Python, or others that do the same faster."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from vboard.periph.pwm import Pwm
from vboard.periph.tc import TcChannel
from vboard.periph.usart import Uart, Usart
from vboard.periph.wdt import Wdt


@dataclass(frozen=True)
class Models:
    """The peripherals of which there is more than one model."""

    uart: type[Uart] = Uart
    usart: type[Usart] = Usart
    timer: type[TcChannel] = TcChannel
    pwm: type[Pwm] = Pwm
    watchdog: type[Wdt] = Wdt


REFERENCE = Models()

_native = ContextVar("native", default=True)


@contextmanager
def reference_models() -> Iterator[None]:
    """Boards and benches that are made meanwhile, and do not say, have the reference models."""
    before = _native.set(False)
    try:
        yield
    finally:
        _native.reset(before)


def native_unless(native: bool | None) -> bool:
    """``native``, or what holds for those that do not say."""
    return _native.get() if native is None else native
