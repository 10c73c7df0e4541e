"""The image sam3x8e_conformance.elf on the emulated chip (tools/vboard)."""

from __future__ import annotations

import math
from pathlib import Path

from conformance.boards import TICKS_PER_US, Battery, Pulse, Unmeasured
from vboard.board import Board as Chip
from vboard.core.clock import TICKS_PER_S
from vboard.core.memory import FLASH_START
from vboard.periph.pins import PinTrace
from vboard.wires.serial_line import SerialLine

UART, BAUD = "UART", 115200
SERVO_PIN, SERVO_CHANNEL = 21, 4  # of port C
LED_PIN = 27  # of port B
BATTERY_CHANNEL, BATTERY_DIVIDER = 7, 3
LOOK_TICKS = TICKS_PER_S // 500
TICKS_PER_PULSE_TICK = TICKS_PER_S // 1_000_000 // TICKS_PER_US


class EmulatedBoard(Unmeasured):
    """``fault``: number of a planted fault, with the image that has them. ``page_us``: time that a
    page of the flash takes."""

    def __init__(self, image: Path, fault: int = 0, page_us: float | None = None) -> None:
        super().__init__(battery=Battery(8.2, 9.9))
        self.name = "emulated board"
        self.chip = Chip(image)
        if fault:
            at = self.chip.symbol("planted_fault_number") - FLASH_START
            self.chip.flash.set(0, at, fault.to_bytes(4, "little"))
        self._page_us = page_us
        self._line = SerialLine(self.chip.clock, BAUD, UART)
        self._servo = PinTrace(self.chip.clock, SERVO_PIN, SERVO_CHANNEL)
        self._pulses_until = 0
        self._light, self._light_changes = False, 0
        self.chip.wire(self._connect)

    def _connect(self) -> None:
        assert self.battery is not None
        periph = self.chip.periph
        self.chip.chip.divide_traps = False  # each division would cost 20 us
        periph[UART].connect(self._line)
        periph["ADC"].volts[BATTERY_CHANNEL] = self.battery.volts / BATTERY_DIVIDER
        self._servo.connect(periph["PIOC"], periph["PWM"])
        periph["PIOB"].on_change.append(self._look_at_light)
        if self._page_us is not None:
            periph["EEFC1"].timing.erase_write_us = self._page_us

    def _look_at_light(self) -> None:
        light = self.chip.periph["PIOB"].drives_high(LED_PIN)
        self._light_changes += light != self._light
        self._light = light

    def now_s(self) -> float:
        """Simulated time."""
        return self.chip.now_s

    def write(self, data: bytes) -> None:
        """Bytes for the console, at the speed of the line."""
        self._line.send(data)

    def read(self, most_s: float) -> bytes:
        """Bytes of the console; simulated time passes."""
        end = self.chip.clock.now + math.ceil(most_s * TICKS_PER_S)
        while not (data := self._line.take()) and self.chip.clock.now < end:
            now = self.chip.clock.now
            look = self._line.message_due() or now + LOOK_TICKS
            self.chip.run_until(min(end, max(look, now + 1)))
        return data

    def pulses(self, servo: int) -> list[Pulse] | None:
        """By the level of the pin."""
        if servo != 0:
            return None
        seen = [p for p in self._servo.pulses() if p.start >= self._pulses_until]
        self._pulses_until = self.chip.clock.now
        return [Pulse(p.start / TICKS_PER_S, p.ticks / TICKS_PER_PULSE_TICK) for p in seen]

    def light_changes(self) -> int | None:
        """Of the LED's pin."""
        return self._light_changes

    def power_cycle(self) -> bool:
        """Off and on at once."""
        self.chip.power_cut()
        self.chip.power_on()
        return True

    def close(self) -> None:
        """Nothing is open."""
