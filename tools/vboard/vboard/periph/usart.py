"""UART and USART with their PDC: 8N1, asynchronous, nothing else.

Bytes are moved when somebody looks: at a register, at the wire, or at the time of the next
interrupt. What a byte-by-byte model would show is the same; only memory that the PDC fills lags
behind until then.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from vboard.core.bus import BusViolation, Reg, Soc
from vboard.core.clock import TICKS_PER_S, Event
from vboard.periph.pdc import PDC_REGISTERS, PdcChannel, PdcPort
from vboard.periph.protect import WriteProtected, only_bits
from vboard.wires.serial_line import (
    BAUD_TOLERANCE,
    BITS_PER_BYTE,
    GARBLED,
    Piece,
    SerialLine,
)

RXRDY, TXRDY, ENDRX, ENDTX = 1 << 0, 1 << 1, 1 << 3, 1 << 4
OVRE, FRAME, PARE, TIMEOUT = 1 << 5, 1 << 6, 1 << 7, 1 << 8
TXEMPTY, TXBUFE, RXBUFF = 1 << 9, 1 << 11, 1 << 12

RSTRX, RSTTX, RXEN, RXDIS, TXEN, TXDIS = 0x4, 0x8, 0x10, 0x20, 0x40, 0x80
RSTSTA, STTTO, RETTO = 0x100, 0x800, 0x8000

MODE_8N1 = 0x8C0  # USART: CHRL 8 bit, PAR none, one stop bit, MCK
MODE_OVER = 1 << 19
MODE_UART = 0x800  # UART: PAR none


class SerialPort(PdcPort):
    """What UART and USART share. ``connect`` it to a wire; ``txd_given`` tells whether the pin is
    handed over to it."""

    flags: ClassVar[int]
    commands: ClassVar[int]

    def __init__(self, soc: Soc, name: str, base: int, pid: int) -> None:
        self.line: SerialLine | None = None
        self.txd_given: Callable[[], bool] | None = None
        self.rx = PdcChannel(soc, f"{name} receive PDC")
        self.tx = PdcChannel(soc, f"{name} transmit PDC")
        self._event: Event | None = None
        self._shifter: int | None = None
        super().__init__(soc, name, base, pid)

    def connect(self, line: SerialLine) -> None:
        """Solders the wire to the port."""
        self.line = line
        line.connect(self)

    def reset(self) -> None:
        """All off; a byte being sent is lost."""
        if self.values:
            self.sync()
        if self.line is not None and self._shifter is not None:
            self.line.lost.in_flight_at_reset += 1
        super().reset()
        self.rx.reset()
        self.tx.reset()
        self.soc.clock.cancel(self._event)
        self._event = None
        self._receiver = self._transmitter = False
        self._sticky = 0  # RXRDY, OVRE, FRAME, TIMEOUT
        self._mask = 0
        self._holding = 0  # RHR
        self._shifter = None  # the byte on the wire
        self._shift_end = 0
        self._waiting: int | None = None  # THR
        self._bit_ticks = 0
        self._rtor_bits = 0
        self._silent_since: int | None = None
        self._counting = False
        self.soc.set_irq(self._line_number(), False)

    def power_off(self) -> None:
        """What is on the wire is lost."""
        self.reset()

    # The time.

    def _bit_cycles(self) -> int:
        raise NotImplementedError

    def _mode_known(self) -> bool:
        raise NotImplementedError

    def _char_ticks(self) -> int:
        if self._bit_ticks == 0:
            raise BusViolation(f"{self.name} used without a baud rate (BRGR)")
        return self._bit_ticks * BITS_PER_BYTE

    def retime(self) -> None:
        """The master clock or the divider changed."""
        self.sync()
        self._bit_ticks = self._bit_cycles() * self.soc.mck_ticks()

    def sending(self) -> bool:
        """Whether a byte is on the wire."""
        self.sync()
        return self._shifter is not None

    # The wire looks at the port.

    def sync(self) -> None:
        """Receives and sends what time allows up to now."""
        now = self.soc.clock.now
        if self.line is not None:
            for piece in self.line.fetch(now):
                self._take(piece)
        if self._timeout_armed() and now >= self._deadline():
            self._sticky |= TIMEOUT
            self._counting = False
        self._send_until(now)

    def replan(self) -> None:
        """Starts what can start, drives the interrupt, plans the next event."""
        self.sync()
        self._feed()
        self._update()

    def next_sent(self) -> int | None:
        """When the byte on the wire has left it."""
        self.sync()
        return self._shift_end if self._shifter is not None else None

    def all_sent(self) -> int | None:
        """When everything known is sent."""
        self.sync()
        if self._shifter is None:
            return None
        left = (self._waiting is not None) + self.tx.remaining
        return self._shift_end + left * self._char_ticks()

    # Receiving.

    def _take(self, piece: Piece) -> None:
        line = self.line
        assert line is not None
        if not self._receiver:
            line.lost.receiver_off += len(piece.data)
            return
        if self._timeout_armed() and piece.first > self._deadline():
            self._sticky |= TIMEOUT
            self._counting = False
        if not self._sticky & TIMEOUT:
            self._counting, self._silent_since = True, piece.last
        data = piece.data
        if piece.framing or not self._samples(piece.baud):
            self._sticky |= FRAME
            line.lost.garbled_to_chip += len(data)
            if not piece.framing:
                data = bytes(byte ^ GARBLED for byte in data)
        self._store(data, line)

    def _store(self, data: bytes, line: SerialLine) -> None:
        rest = data[self.rx.put(data) :] if not self._sticky & RXRDY else data
        if not rest:
            return
        lost = len(rest) - (0 if self._sticky & RXRDY else 1)
        if lost:
            self._sticky |= OVRE
            line.lost.overrun += lost
        self._sticky |= RXRDY
        self._holding = rest[-1]

    def _samples(self, baud: int) -> bool:
        if self._bit_ticks == 0:
            return False
        return abs(TICKS_PER_S / (self._bit_ticks * baud) - 1) <= BAUD_TOLERANCE

    def _timeout_armed(self) -> bool:
        counting = self._counting and self._receiver and not self._sticky & TIMEOUT
        return counting and self._rtor_bits * self._bit_ticks > 0

    def _deadline(self) -> int:
        assert self._silent_since is not None
        return self._silent_since + self._rtor_bits * self._bit_ticks

    # Sending.

    def _send_until(self, now: int) -> None:
        if self._shifter is None or self._shift_end > now:
            return
        char = self._char_ticks()
        ready = [self._shifter] + ([self._waiting] if self._waiting is not None else [])
        done = 1 + (now - self._shift_end) // char
        ready += self.tx.get(max(done + 2 - len(ready), 0)) if self._transmitter else b""
        gone = min(done, len(ready))
        if self.line is not None:
            self.line.deliver(self._shift_end, char, bytes(ready[:gone]))
        self._shift_end += gone * char
        rest = ready[gone:]
        self._shifter = rest[0] if rest else None
        self._waiting = rest[1] if len(rest) > 1 else None

    def _feed(self) -> None:
        """Moves into the port what waits at its door: held byte to the PDC, PDC to THR."""
        if self._sticky & RXRDY and self.rx.put(bytes([self._holding])):
            self._sticky &= ~RXRDY
        while self._transmitter and self._waiting is None and self.tx.remaining:
            self._accept(self.tx.get(1)[0])

    def _accept(self, byte: int) -> None:
        if self.txd_given is not None and not self.txd_given():
            raise BusViolation(f"{self.name} sends, but its pin is not given to it (PIO_PDR)")
        if self._shifter is None:
            self._shift_end = self.soc.clock.now + self._char_ticks()
            self._shifter = byte
        else:
            self._waiting = byte

    # Flags, interrupt, events.

    def _status(self) -> int:
        flags = self._sticky
        flags |= ENDRX if self.rx.ended else 0
        flags |= ENDTX if self.tx.ended else 0
        flags |= RXBUFF if self.rx.empty else 0
        flags |= TXBUFE if self.tx.empty else 0
        if self._transmitter:
            flags |= TXRDY if self._waiting is None else 0
            flags |= TXEMPTY if self._shifter is None else 0
        return flags

    def _update(self) -> None:
        self.soc.set_irq(self._line_number(), bool(self._status() & self._mask))
        times = [*self._receive_events(), *self._send_events()]
        due = min((time for time in times if time is not None), default=None)
        if self._event is not None and not self._event.cancelled and self._event.due == due:
            return
        self.soc.clock.cancel(self._event)
        self._event = None if due is None else self.soc.clock.at(due, self._happen)

    def _happen(self) -> None:
        self._event = None
        self.replan()

    def _receive_events(self) -> list[int | None]:
        line = self.line
        if line is None or not self._receiver:
            return []
        wanted = self._mask & ~self._status()
        room = self.rx.remaining
        times: list[int | None] = []
        if wanted & ENDRX and room:
            times.append(line.arrival(self.rx.counter - 1))
        if wanted & RXBUFF and room:
            times.append(line.arrival(room - 1))
        if wanted & RXRDY:
            times.append(line.arrival(room))
        if wanted & OVRE:
            times.append(line.arrival(room + (not self._sticky & RXRDY)))
        if wanted & FRAME and self._bit_ticks:
            times.append(line.bad_arrival(TICKS_PER_S / self._bit_ticks))
        if wanted & TIMEOUT and self._rtor_bits * self._bit_ticks:
            since = self._silent_since if self._counting else None
            times.append(line.silence(since, self._rtor_bits * self._bit_ticks))
        return times

    def _send_events(self) -> list[int | None]:
        if self._shifter is None:
            return []
        wanted = self._mask & ~self._status()
        char, end = self._char_ticks(), self._shift_end
        left = self.tx.remaining if self._transmitter else 0
        times: list[int | None] = []
        if wanted & ENDTX and left:
            times.append(end + (self.tx.counter - 1) * char)
        if wanted & TXBUFE and left:
            times.append(end + (left - 1) * char)
        if wanted & TXRDY:
            times.append(end + left * char)
        if wanted & TXEMPTY:
            times.append(end + (left + (self._waiting is not None)) * char)
        return times

    def _line_number(self) -> int:
        assert self.pid is not None
        return self.pid

    # Registers.

    def write_cr(self, value: int) -> None:
        """Commands; resets first, off wins over on."""
        only_bits(f"{self.name} CR", value, self.commands)
        self.sync()
        if value & RSTRX:
            self._receiver = False
            self._sticky &= ~RXRDY
        if value & RSTTX:
            self._transmitter, self._shifter, self._waiting = False, None, None
        if value & (RXEN | TXEN):
            self._check_mode()
        if value & (RXEN | RXDIS):
            self._enable_receiver(not value & RXDIS)
        if value & (TXEN | TXDIS):
            self._transmitter = not value & TXDIS
        if value & RSTSTA:
            self._sticky &= ~(OVRE | FRAME | PARE)
        self._command_timeout(value)
        self.replan()

    def _enable_receiver(self, on: bool) -> None:
        """Silence counts from the switching on."""
        if on and not self._receiver and self._counting:
            self._silent_since = self.soc.clock.now
        self._receiver = on

    def _command_timeout(self, value: int) -> None:
        """STTTO: wait for a byte, flag down. RETTO: count from now."""
        if value & STTTO:
            self._sticky &= ~TIMEOUT
            self._counting, self._silent_since = False, None
        if value & RETTO:
            self._counting, self._silent_since = True, self.soc.clock.now

    def _check_mode(self) -> None:
        if not self._mode_known():
            raise BusViolation(f"{self.name} MR 0x{self.values['MR']:08x} is not 8N1 from MCK")

    def write_mr(self, value: int) -> None:
        """Mode; not while a byte is on its way."""
        self._idle("MR")
        self.values["MR"] = value
        self.retime()

    def write_brgr(self, value: int) -> None:
        """Baud rate; not while a byte is being sent."""
        self._idle("BRGR")
        self.values["BRGR"] = value
        self.retime()
        self.replan()

    def _idle(self, register: str) -> None:
        if self.sending():
            raise BusViolation(f"{self.name} {register} written while a byte is being sent")

    def write_ier(self, value: int) -> None:
        """Interrupts on."""
        only_bits(f"{self.name} IER", value, self.flags)
        self._mask |= value
        self.replan()

    def write_idr(self, value: int) -> None:
        """Interrupts off."""
        self._mask &= ~value
        self.replan()

    def read_imr(self) -> int:
        """Interrupts that are on."""
        return self._mask

    def read_csr(self) -> int:
        """Flags now."""
        self.sync()
        return self._status()

    def read_rhr(self) -> int:
        """The held byte; clears RXRDY."""
        self.sync()
        self._sticky &= ~RXRDY
        self.replan()
        return self._holding

    def write_thr(self, value: int) -> None:
        """A byte to send; only with TXRDY."""
        self.sync()
        if not self._transmitter:
            raise BusViolation(f"{self.name} THR written with the transmitter off")
        if self._waiting is not None:
            raise BusViolation(f"{self.name} THR written without TXRDY: a byte is lost")
        self._accept(value & 0xFF)
        self.replan()


class Uart(SerialPort):
    """The console port: 16 clocks per bit, whole divider, no time-out."""

    size = 0x128
    flags = RXRDY | TXRDY | ENDRX | ENDTX | OVRE | FRAME | PARE | TXEMPTY | TXBUFE | RXBUFF
    commands = RSTRX | RSTTX | RXEN | RXDIS | TXEN | TXDIS | RSTSTA
    registers = (
        Reg("CR", 0x00, "w"),
        Reg("MR", 0x04),
        Reg("IER", 0x08, "w"),
        Reg("IDR", 0x0C, "w"),
        Reg("IMR", 0x10, "r"),
        Reg("SR", 0x14, "r"),
        Reg("RHR", 0x18, "r"),
        Reg("THR", 0x1C, "w"),
        Reg("BRGR", 0x20),
        *PDC_REGISTERS,
    )

    def read_sr(self) -> int:
        """Flags now."""
        return self.read_csr()

    def write_brgr(self, value: int) -> None:
        """CD only."""
        only_bits("UART BRGR", value, 0xFFFF)
        super().write_brgr(value)

    def _bit_cycles(self) -> int:
        return 16 * self.values["BRGR"]

    def _mode_known(self) -> bool:
        return self.values["MR"] == MODE_UART


class Usart(SerialPort, WriteProtected):
    """A USART: fractional divider, 8 or 16 clocks per bit, receiver time-out."""

    size = 0x128
    wp_key = 0x555341
    protected = frozenset({"MR", "BRGR", "RTOR"})
    flags = Uart.flags | TIMEOUT
    commands = Uart.commands | STTTO | RETTO
    registers = (
        Reg("CR", 0x00, "w"),
        Reg("MR", 0x04),
        Reg("IER", 0x08, "w"),
        Reg("IDR", 0x0C, "w"),
        Reg("IMR", 0x10, "r"),
        Reg("CSR", 0x14, "r"),
        Reg("RHR", 0x18, "r"),
        Reg("THR", 0x1C, "w"),
        Reg("BRGR", 0x20),
        Reg("RTOR", 0x24),
        Reg("WPMR", 0xE4),
        *PDC_REGISTERS,
    )

    def write_brgr(self, value: int) -> None:
        """CD and FP."""
        only_bits(f"{self.name} BRGR", value, 0x7FFFF)
        super().write_brgr(value)

    def write_rtor(self, value: int) -> None:
        """Time-out in bit times, counting from now; 0 = none."""
        only_bits(f"{self.name} RTOR", value, 0x1FFFF)
        if 0 < value <= BITS_PER_BYTE:
            raise BusViolation(f"{self.name} RTOR {value} is shorter than one byte")
        self.sync()
        self.values["RTOR"] = self._rtor_bits = value
        if value == 0:
            self._sticky &= ~TIMEOUT
        self._counting, self._silent_since = value > 0, self.soc.clock.now
        self.replan()

    def _bit_cycles(self) -> int:
        brgr = self.values["BRGR"]
        over = 1 if self.values["MR"] & MODE_OVER else 2
        return over * (8 * (brgr & 0xFFFF) + (brgr >> 16)) if brgr & 0xFFFF else 0

    def _mode_known(self) -> bool:
        return self.values["MR"] & ~MODE_OVER == MODE_8N1
