"""Every register of the models is the vendor's: name, place, access, value after reset."""

from __future__ import annotations

import pytest

from register_facts import peripherals
from vboard.periph.bench import Bench

pytestmark = pytest.mark.usefixtures("both_models")

ACCESS = {"read-write": "rw", "read-only": "r", "write-only": "w"}
NAMES = {"EEFC0": "EFC0", "EEFC1": "EFC1", "TC0_0": "TC0", "TC0_1": "TC0", "TC0_2": "TC0"}

# Where the vendor's file and the chip differ.
RESET_EXCEPTIONS = {
    "PMC.CKGR_MOR": "the RC oscillator is on (0x8 in the vendor's later file, 0x1 in this one)",
    "SUPC.SR": "0x800 is no flag of this chip",
    "PIO.PSR": "pins belong to the PIO after reset; the file has 0",
    "CHIPID.CIDR": "the file has no values for the identity",
    "USART.CSR": "see UART.SR",
    "UART.SR": "both PDC counters are 0, so all four of their flags are up",
    "RSTC.SR": "NRST is high",
}


@pytest.fixture(scope="module")
def vendor() -> dict[str, dict[str, tuple[int, str, int | None]]]:
    found: dict[str, dict[str, tuple[int, str, int | None]]] = {}
    for name, peripheral in peripherals().items():
        found[name] = {}
        for key, register in peripheral.registers.items():
            for index in range(register.count):
                address = peripheral.base + register.offset + index * register.step
                numbered = key if register.count == 1 else f"{key}{index}"
                found[name][numbered] = (address, ACCESS[register.access], register.reset)
    return found


def declared() -> list[tuple[str, str, int, str]]:
    found = []
    for name, peripheral in Bench().periph.items():
        for reg in peripheral.registers:
            for index in range(reg.count):
                key = reg.name if reg.count == 1 else f"{reg.name}{index}"
                address = peripheral.base + reg.offset + index * reg.stride
                found.append((name, key, address, reg.access))
    return found


def _in_file(name: str, key: str) -> str:
    return key + name[-1] if name.startswith("TC0_") else key


def test_registers_are_those_of_the_vendor(
    vendor: dict[str, dict[str, tuple[int, str, int | None]]],
) -> None:
    registers = declared()
    assert len(registers) > 300
    for name, key, address, access in registers:
        known = vendor[NAMES.get(name, name)][_in_file(name, key)]
        assert (address, access) == known[:2], f"{name}.{key}"


def test_values_after_reset_are_those_of_the_vendor(
    vendor: dict[str, dict[str, tuple[int, str, int | None]]],
) -> None:
    bench = Bench()
    bench.enable(8, *range(11, 15), *range(17, 21), *range(27, 30), 36, 37)
    seen: set[str] = set()
    compared = 0
    for name, key, address, access in declared():
        family = "PIO" if name.startswith("PIO") else "USART" if "USART" in name else name
        short = f"{family}.{key}"
        if short in RESET_EXCEPTIONS:
            seen.add(short)
            continue
        if "r" not in access or key.startswith("PMC_PCSR"):
            continue
        reset = vendor[NAMES.get(name, name)][_in_file(name, key)][2]
        if key == "PDSR":
            reset = bench.periph[name].pins  # type: ignore[attr-defined]
        if reset is not None:
            assert bench.bus.read(address, 4) == reset, f"{name}.{key}"
            compared += 1
    assert compared > 150
    assert seen == set(RESET_EXCEPTIONS)


def test_every_wrong_access_is_told() -> None:
    from vboard.core.bus import BusViolation

    bench = Bench()
    for address, width, told in (
        (0x400E0604 + 0x1000, 4, "where no peripheral"),
        (0x400E0600 + 0x0C, 4, "unknown register"),
        (0x400E0668, 2, "16 bits"),
        (0x40098014, 4, "clock is off"),
    ):
        with pytest.raises(BusViolation, match=told):
            bench.bus.read(address, width)
    with pytest.raises(BusViolation, match="cannot be"):
        bench.write("PMC.PMC_SR", 0)
    with pytest.raises(BusViolation, match="cannot be"):
        bench.read("RSTC.CR")
