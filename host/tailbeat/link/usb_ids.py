"""USB ids of the ports by which a board is reached."""

from __future__ import annotations

from enum import Enum


class PortKind(Enum):
    """What is at the other end of a port."""

    PROGRAMMING = "programming port"  # an ATmega16U2 beside the chip; it stays when the chip resets
    NATIVE = "native port"  # the chip's own USB, served by an Arduino sketch
    SAM_BA = "boot loader"  # the chip's own USB, served by the boot loader in its ROM
    OTHER = "other port"  # named by the user: a clone, a custom board


# Arduino sold the Due under both vendor ids.
_DUE_VENDORS = (0x2341, 0x2A03)
_DUE_PRODUCTS = {0x003D: PortKind.PROGRAMMING, 0x003E: PortKind.NATIVE}
USB_IDS = {
    (vendor, product): kind for vendor in _DUE_VENDORS for product, kind in _DUE_PRODUCTS.items()
} | {(0x03EB, 0x6124): PortKind.SAM_BA}

# Makers of USB serial converters (CH340, FTDI, CP210x, PL2303): none of theirs is an ATmega16U2.
_CONVERTER_VENDORS = (0x1A86, 0x0403, 0x10C4, 0x067B)


def kind_of(vendor: int | None, product: int | None) -> PortKind | None:
    """What a port with these ids is; None for a port of another make."""
    if vendor is None or product is None:
        return None
    return USB_IDS.get((vendor, product))


def may_be_16u2(vendor: int | None) -> bool:
    """Whether an ATmega16U2 with other ids than the Due's may be at the other end."""
    return vendor is not None and vendor not in _CONVERTER_VENDORS


def ids_text() -> str:
    """All ids of boards, for messages."""
    return ", ".join(f"{vendor:04x}:{product:04x}" for vendor, product in USB_IDS)
