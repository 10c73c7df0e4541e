"""The peripherals of the chip."""

from __future__ import annotations

from functools import partial

from vboard.core.bus import BusViolation, Peripheral, Soc
from vboard.periph.adc import Adc
from vboard.periph.eefc import Eefc
from vboard.periph.flash import Flash
from vboard.periph.models import REFERENCE, Models
from vboard.periph.pins import PWML_PINS, TXD_PINS
from vboard.periph.pio import Pio
from vboard.periph.pmc import Pmc
from vboard.periph.pwm import Pwm
from vboard.periph.rstc import Rstc
from vboard.periph.small import ChipId, Gpbr, Matrix
from vboard.periph.supply import Rail, SlowClock, Supc
from vboard.periph.tc import TcChannel
from vboard.periph.usart import SerialPort

PORTS = {
    "UART": (0x400E0800, 8),
    "USART0": (0x40098000, 17),
    "USART1": (0x4009C000, 18),
    "USART2": (0x400A0000, 19),
    "USART3": (0x400A4000, 20),
}
PIOS = {
    "PIOA": (0x400E0E00, 11, 0x3FFFFFFF),
    "PIOB": (0x400E1000, 12, 0xFFFFFFFF),
    "PIOC": (0x400E1200, 13, 0x7FFFFFFF),
    "PIOD": (0x400E1400, 14, 0x000007FF),
}
TIMERS = {"TC0_0": (0x40080000, 27), "TC0_1": (0x40080040, 28), "TC0_2": (0x40080080, 29)}


def build(
    soc: Soc,
    *,
    flash: Flash,
    crystal: bool,
    unique_id: bytes,
    seed: int,
    slow: SlowClock | None = None,
    rail: Rail | None = None,
    models: Models = REFERENCE,
) -> dict[str, Peripheral]:
    """All peripherals as they are right after power-on, wired among each other.

    Built anew at each power-on; what outlives the power is in ``flash``. ``slow`` and ``rail`` are
    for boards with a slow clock of their own or a supply that dips. ``models`` must go with the
    soc.
    """
    if len(unique_id) != 16:
        raise ValueError("the unique id has 16 bytes")
    slow, rail = slow or SlowClock(), rail or Rail()
    eefcs = [
        Eefc(soc, f"EEFC{bank}", base, bank, flash, rail, unique_id=unique_id, seed=seed)
        for bank, base in enumerate((0x400E0A00, 0x400E0C00))
    ]
    pmc = Pmc(soc, "PMC", 0x400E0600, slow, crystal=crystal)
    ports = _ports(soc, models)
    pios = {name: Pio(soc, name, base, pid, pins) for name, (base, pid, pins) in PIOS.items()}
    timers = [models.timer(soc, n, base, pid, slow) for n, (base, pid) in TIMERS.items()]
    pwm = models.pwm(soc, "PWM", 0x40094000, 36)
    others: list[Peripheral] = [
        Adc(soc, "ADC", 0x400C0000, 37),
        Matrix(soc, "MATRIX", 0x400E0400),
        ChipId(soc, "CHIPID", 0x400E0940),
        Rstc(soc, "RSTC", 0x400E1A00),
        Supc(soc, "SUPC", 0x400E1A10, slow, rail),
        models.watchdog(soc, "WDT", 0x400E1A50, slow),
        Gpbr(soc, "GPBR", 0x400E1A90),
    ]
    _wire_pins(pios, ports, pwm)
    _wire_clock(pmc, eefcs, ports, timers, pwm)
    everything: list[Peripheral] = [pmc, *eefcs, *ports, *pios.values(), *timers, pwm, *others]
    return {peripheral.name: peripheral for peripheral in everything}


def _ports(soc: Soc, models: Models) -> list[SerialPort]:
    kinds: dict[str, type[SerialPort]] = {"UART": models.uart}
    return [
        kinds.get(name, models.usart)(soc, name, base, pid) for name, (base, pid) in PORTS.items()
    ]


def _wire_pins(pios: dict[str, Pio], ports: list[SerialPort], pwm: Pwm) -> None:
    for port in ports:
        pio_name, bit, owner = TXD_PINS[port.name]
        pio = pios[pio_name]
        pio.function_level[(bit, owner)] = _idle_high
        port.txd_given = partial(_owned, pio, bit, owner)
    for channel, (pio_name, bit, owner) in PWML_PINS.items():
        pios[pio_name].function_level[(bit, owner)] = partial(_pwm_level, pwm, channel)


def _wire_clock(
    pmc: Pmc, eefcs: list[Eefc], ports: list[SerialPort], timers: list[TcChannel], pwm: Pwm
) -> None:
    pmc.wait_states = lambda: min(eefc.wait_states for eefc in eefcs)
    for eefc in eefcs:
        eefc.speed_check = lambda waits: pmc.check_flash(pmc.mck_hz, waits)
    pmc.before_mck.append(pwm.refuse_if_running)
    for port in ports:
        pmc.before_mck.append(partial(_refuse_if_sending, port))
        pmc.on_mck.append(port.retime)
    pmc.on_mck.append(pwm.retime)
    for timer in timers:
        pmc.on_mck.append(timer.retime)


def _idle_high() -> bool:
    return True


def _owned(pio: Pio, bit: int, owner: str) -> bool:
    return pio.owner(bit) == owner


def _pwm_level(pwm: Pwm, channel: int) -> bool:
    return pwm.waveform(channel)[0]


def _refuse_if_sending(port: SerialPort) -> None:
    if port.sending():
        raise BusViolation(f"the master clock changed while {port.name} sends")
