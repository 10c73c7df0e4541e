"""The pins in the firmware, in docs/how-to/wiring.md and on the Due's header are the same."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
HEADER = (ROOT / "hal" / "sam3x8e" / "pins.h").read_text(encoding="utf-8")
GUIDE = (ROOT / "docs" / "how-to" / "wiring.md").read_text(encoding="utf-8")
PARAMETERS = (ROOT / "firmware" / "params" / "params.def").read_text(encoding="utf-8")

PIN = re.compile(
    r'^ +PIN\((?P<name>\w+), (?P<port>[A-D]), (?P<bit>\d+), (?P<peripheral>\w+), "(?P<due>\w+)", '
    r'"(?P<signal>\w+)"\)',
    re.MULTILINE,
)

# Where the Due's headers and the chip's multiplexer put a signal (Arduino's variant.cpp, the
# vendor's pio_sam3x8e.h).
DUE = {
    "PWML4": ("PC21", "B", "D9"),
    "RXD0": ("PA10", "A", "D19"),
    "TXD0": ("PA11", "A", "D18"),
    "RXD1": ("PA12", "A", "D17"),
    "TXD1": ("PA13", "A", "D16"),
    "URXD": ("PA8", "A", "D0"),
    "UTXD": ("PA9", "A", "D1"),
    "AD7": ("PA16", "–", "A0"),
    "PB27": ("PB27", "–", "D13"),
}


class Pin(NamedTuple):
    """One pin, written as the guide writes it."""

    name: str
    pin: str
    peripheral: str
    due: str
    signal: str


def pins_of_header() -> list[Pin]:
    return [
        Pin(
            match["name"],
            f"P{match['port']}{match['bit']}",
            match["peripheral"].replace("NONE", "–"),
            match["due"],
            match["signal"],
        )
        for match in PIN.finditer(HEADER)
    ]


def pins_of_guide() -> list[Pin]:
    lines = GUIDE.split("## Pins", 1)[1].split("\n\n## ", 1)[0].splitlines()
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line[:1] == "|"]
    assert rows[0] == ["name", "pin", "peripheral", "Due", "signal", "goes to"]
    return [Pin(*row[:5]) for row in rows[2:]]


def constant(name: str) -> int:
    found = re.search(rf"^#define {name} (\d+)u$", HEADER, re.MULTILINE)
    assert found is not None, name
    return int(found[1])


def default(name: str) -> float:
    """Of a parameter of the firmware."""
    found = re.search(rf"^PARAM\({name}, +([0-9.]+)f,", PARAMETERS, re.MULTILINE)
    assert found is not None, name
    return float(found[1])


def test_every_pin_of_the_header_is_found() -> None:
    assert len(pins_of_header()) == len(re.findall(r"^ +PIN\(", HEADER, re.MULTILINE)) > 0


def test_guide_and_header_agree() -> None:
    assert pins_of_guide() == pins_of_header()


def test_each_signal_is_where_the_chip_and_the_due_have_it() -> None:
    for pin in pins_of_header():
        assert (pin.pin, pin.peripheral, pin.due) == DUE[pin.signal], pin.name


def test_no_pin_does_two_things() -> None:
    pins = pins_of_header()
    assert len({pin.pin for pin in pins}) == len(pins)
    assert len({pin.due for pin in pins}) == len(pins)


def test_debugger_and_erase_pins_are_left_alone() -> None:
    taken = {pin.pin for pin in pins_of_header()}
    assert not taken & {"PB28", "PB29", "PB30", "PB31", "PC0"}


def test_channels_belong_to_their_signals() -> None:
    signals = {pin.name: pin.signal for pin in pins_of_header()}
    servos = re.findall(r"^ +ROW\(\w+, (\w+), (\d+)\)", HEADER, re.MULTILINE)
    assert [pin for pin, _ in servos] == ["SERVO"]
    assert all(signals[pin] == f"PWML{channel}" for pin, channel in servos)
    assert signals["BATTERY"] == f"AD{constant('BATTERY_ADC_CHANNEL')}"


def test_divider_of_the_guide_is_the_firmwares() -> None:
    upper, lower = (int(ohms) for ohms in re.findall(r"\[ (\d+) kΩ \]", GUIDE))
    divider, full_scale_v = (default(name) for name in ("BATT_DIVIDER", "BATT_ADC_V"))
    assert (upper + lower) / lower == divider
    highest_v = full_scale_v * divider
    assert f"More than {highest_v:.1f} V" in GUIDE
