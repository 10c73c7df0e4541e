"""Peripheral DMA: a buffer and the next one for each direction."""

from __future__ import annotations

from vboard.core.bus import BusViolation, Peripheral, Reg, Soc

RXTEN, RXTDIS, TXTEN, TXTDIS = 0x1, 0x2, 0x100, 0x200

PDC_REGISTERS = (
    Reg("RPR", 0x100),
    Reg("RCR", 0x104),
    Reg("TPR", 0x108),
    Reg("TCR", 0x10C),
    Reg("RNPR", 0x110),
    Reg("RNCR", 0x114),
    Reg("TNPR", 0x118),
    Reg("TNCR", 0x11C),
    Reg("PTCR", 0x120, "w"),
    Reg("PTSR", 0x124, "r"),
)


class PdcChannel:
    """One direction. ``ended``: the counter has reached 0 since it or the next one was written."""

    def __init__(self, soc: Soc, name: str) -> None:
        self.soc, self.name = soc, name
        self.reset()

    def reset(self) -> None:
        """Off and empty. Both flags are up then: nothing is left to transfer."""
        self.pointer = self.counter = self.next_pointer = self.next_counter = 0
        self.enabled = False
        self.ended = True

    @property
    def remaining(self) -> int:
        """Bytes it will still move without the processor; 0 while off."""
        return self.counter + self.next_counter if self.enabled else 0

    @property
    def empty(self) -> bool:
        """RXBUFF or TXBUFE: both counters 0."""
        return self.counter == 0 and self.next_counter == 0

    def put(self, data: bytes) -> int:
        """Stores received bytes; returns how many had room."""
        done = 0
        while done < len(data) and self.enabled and self.counter:
            part = data[done : done + self.counter]
            self.soc.write_memory(self.pointer, part)
            self._advance(len(part))
            done += len(part)
        return done

    def get(self, count: int) -> bytes:
        """Fetches up to ``count`` bytes to send."""
        out = b""
        while len(out) < count and self.enabled and self.counter:
            part = self.soc.read_memory(self.pointer, min(count - len(out), self.counter))
            self._advance(len(part))
            out += part
        return out

    def set_pointer(self, value: int) -> None:
        """RPR or TPR; not under a running transfer."""
        self._still("the pointer")
        self.pointer = value

    def set_counter(self, value: int) -> None:
        """RCR or TCR; not under a running transfer."""
        self._still("the counter")
        self.counter = _sixteen(self.name, value)
        self._written()

    def set_next_pointer(self, value: int) -> None:
        """RNPR or TNPR; not while the next buffer waits to be loaded."""
        if self.enabled and self.next_counter:
            raise BusViolation(f"{self.name}: next pointer changed while the next buffer waits")
        self.next_pointer = value

    def set_next_counter(self, value: int) -> None:
        """RNCR or TNCR. Loaded at once when the present buffer is through."""
        self.next_counter = _sixteen(self.name, value)
        self._written()

    def _written(self) -> None:
        self.ended = False
        if self.counter == 0 and self.next_counter:
            self._load_next()
        if self.counter == 0:
            self.ended = True

    def _load_next(self) -> None:
        self.pointer, self.counter = self.next_pointer, self.next_counter
        self.next_counter = 0

    def _advance(self, count: int) -> None:
        self.pointer += count
        self.counter -= count
        if self.counter == 0:
            self.ended = True
            if self.next_counter:
                self._load_next()

    def _still(self, what: str) -> None:
        if self.enabled and self.counter:
            raise BusViolation(f"{self.name}: {what} changed while a transfer is under way")


class PdcPort(Peripheral):
    """A peripheral with both directions. Subclasses bring state up to the present in sync()."""

    rx: PdcChannel
    tx: PdcChannel

    def sync(self) -> None:
        """Brings the transfers up to the present."""

    def replan(self) -> None:
        """Starts what can start now and sets interrupt and next event."""

    def read_rpr(self) -> int:
        """Next byte of the receive buffer."""
        self.sync()
        return self.rx.pointer

    def read_rcr(self) -> int:
        """Room left in the receive buffer."""
        self.sync()
        return self.rx.counter

    def read_rnpr(self) -> int:
        """Next receive buffer."""
        self.sync()
        return self.rx.next_pointer

    def read_rncr(self) -> int:
        """Size of the next receive buffer."""
        self.sync()
        return self.rx.next_counter

    def read_tpr(self) -> int:
        """Next byte to send."""
        self.sync()
        return self.tx.pointer

    def read_tcr(self) -> int:
        """Bytes left to send."""
        self.sync()
        return self.tx.counter

    def read_tnpr(self) -> int:
        """Next buffer to send."""
        self.sync()
        return self.tx.next_pointer

    def read_tncr(self) -> int:
        """Size of the next buffer to send."""
        self.sync()
        return self.tx.next_counter

    def read_ptsr(self) -> int:
        """RXTEN and TXTEN."""
        return (RXTEN if self.rx.enabled else 0) | (TXTEN if self.tx.enabled else 0)

    def write_rpr(self, value: int) -> None:
        """Receive buffer."""
        self.sync()
        self.rx.set_pointer(value)

    def write_rcr(self, value: int) -> None:
        """Size of the receive buffer."""
        self.sync()
        self.rx.set_counter(value)
        self.replan()

    def write_rnpr(self, value: int) -> None:
        """Next receive buffer."""
        self.sync()
        self.rx.set_next_pointer(value)

    def write_rncr(self, value: int) -> None:
        """Size of the next receive buffer."""
        self.sync()
        self.rx.set_next_counter(value)
        self.replan()

    def write_tpr(self, value: int) -> None:
        """Buffer to send."""
        self.sync()
        self.tx.set_pointer(value)

    def write_tcr(self, value: int) -> None:
        """Bytes to send."""
        self.sync()
        self.tx.set_counter(value)
        self.replan()

    def write_tnpr(self, value: int) -> None:
        """Next buffer to send."""
        self.sync()
        self.tx.set_next_pointer(value)

    def write_tncr(self, value: int) -> None:
        """Bytes of the next buffer to send."""
        self.sync()
        self.tx.set_next_counter(value)
        self.replan()

    def write_ptcr(self, value: int) -> None:
        """Transfers on and off; off wins."""
        self.sync()
        for channel, on, off in ((self.rx, RXTEN, RXTDIS), (self.tx, TXTEN, TXTDIS)):
            if value & off:
                channel.enabled = False
            elif value & on:
                channel.enabled = True
        self.replan()


def _sixteen(name: str, value: int) -> int:
    if value > 0xFFFF:
        raise BusViolation(f"{name}: a counter of {value} does not fit in 16 bits")
    return value
