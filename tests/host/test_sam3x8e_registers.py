"""The register headers of hal/sam3x8e agree with the vendor's SVD file (tests/atsam3x8e.json).

The headers keep to one form (registers/field.h): structs of uint32_t, masks named
PERIPHERAL_REGISTER_FIELD, values built with FIELD(). This reads that form and compares every base
address, offset, access and field. The core's own registers are not in the SVD; a table of the
ARMv7-M manual stands in for it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import pytest

from register_facts import Peripheral, interrupts, peripherals

HAL = Path(__file__).parents[2] / "hal"
REGISTERS = HAL / "sam3x8e" / "registers"
CORE_REGISTERS = HAL / "cortex_m3" / "registers"

# Struct of the headers -> peripherals of the SVD that it is laid over.
STRUCTS = {
    "adc_registers_t": ("ADC",),
    "efc_registers_t": ("EFC0", "EFC1"),
    "matrix_registers_t": ("MATRIX",),
    "pio_registers_t": ("PIOA", "PIOB", "PIOC", "PIOD"),
    "pmc_registers_t": ("PMC",),
    "pwm_registers_t": ("PWM",),
    "rstc_registers_t": ("RSTC",),
    "supc_registers_t": ("SUPC",),
    "tc_registers_t": ("TC0",),
    "usart_registers_t": ("USART0", "USART1", "UART"),
    "wdt_registers_t": ("WDT",),
}
CORE_STRUCTS = ("nvic_registers_t", "scb_registers_t", "mpu_registers_t")

# The UART is used through the USART's struct. What it calls otherwise or lacks:
UART_NAMES = {"CSR": "SR"}
UART_LACKS = {"RTOR"}
UART_LACKS_FIELDS = {"CR_STTTO", "MR_CHRL", "MR_OVER", "CSR_TIMEOUT", "BRGR_FP"}

# First part of a field's name -> peripheral and what its registers' names begin with in the SVD.
PREFIXES = {
    "ADC": ("ADC", ""),
    "CKGR": ("PMC", "CKGR_"),
    "EFC": ("EFC0", ""),
    "MATRIX": ("MATRIX", "MATRIX_"),
    "PDC": ("USART0", ""),
    "PMC": ("PMC", "PMC_"),
    "PWM": ("PWM", ""),
    "RSTC": ("RSTC", ""),
    "SUPC": ("SUPC", ""),
    "TC": ("TC0", ""),
    "USART": ("USART0", ""),
    "WDT": ("WDT", ""),
}
# The header's name of a register where the SVD has one per channel.
CHANNEL_REGISTERS = {
    "PWM_CMR": "CMR0",
    "TC_CCR": "CCR0",
    "TC_CMR": "CMR0_WAVE_EQ_1",
    "TC_IER": "IER0",
    "ADC_CDR": "CDR",
    "MATRIX_SCFG": "MATRIX_SCFG",
}

# Values that the SVD does not enumerate, with the datasheet's word for them.
NOT_ENUMERATED = {
    "EFC_FCR_FCMD_EWP": 0x03,
    "EFC_FCR_FCMD_CLB": 0x09,
    "EFC_FCR_FCMD_GLB": 0x0A,
    "EFC_FCR_FCMD_STUI": 0x0E,
    "EFC_FCR_FCMD_SPUI": 0x0F,
    "MATRIX_SCFG_DEFMSTR_TYPE_LAST": 1,
    "CKGR_MOR_KEY_PASSWD": 0x37,
    "EFC_FCR_FKEY_PASSWD": 0x5A,
    "RSTC_CR_KEY_PASSWD": 0xA5,
    "RSTC_MR_KEY_PASSWD": 0xA5,
    "WDT_CR_KEY_PASSWD": 0xA5,
}

# ARMv7-M Architecture Reference Manual, tables B3-3, B3-4, B3-8, B3-11 and sections below them.
CORE_ADDRESSES = {
    "NVIC_ISER": 0xE000E100,
    "NVIC_ICER": 0xE000E180,
    "NVIC_ISPR": 0xE000E200,
    "NVIC_ICPR": 0xE000E280,
    "NVIC_IPR": 0xE000E400,
    "SCB_CPUID": 0xE000ED00,
    "SCB_ICSR": 0xE000ED04,
    "SCB_VTOR": 0xE000ED08,
    "SCB_AIRCR": 0xE000ED0C,
    "SCB_SCR": 0xE000ED10,
    "SCB_CCR": 0xE000ED14,
    "SCB_SHPR": 0xE000ED18,
    "SCB_SHCSR": 0xE000ED24,
    "SCB_CFSR": 0xE000ED28,
    "SCB_HFSR": 0xE000ED2C,
    "SCB_DFSR": 0xE000ED30,
    "SCB_MMFAR": 0xE000ED34,
    "SCB_BFAR": 0xE000ED38,
    "SCB_AFSR": 0xE000ED3C,
    "MPU_TYPE": 0xE000ED90,
    "MPU_CTRL": 0xE000ED94,
    "MPU_RNR": 0xE000ED98,
    "MPU_RBAR": 0xE000ED9C,
    "MPU_RASR": 0xE000EDA0,
}
# Lowest bit and width.
CORE_FIELDS = {
    "SCB_ICSR_VECTACTIVE": (0, 9),
    "SCB_AIRCR_SYSRESETREQ": (2, 1),
    "SCB_AIRCR_VECTKEY": (16, 16),
    "SCB_CCR_DIV_0_TRP": (4, 1),
    "SCB_SHCSR_MEMFAULTENA": (16, 1),
    "SCB_SHCSR_BUSFAULTENA": (17, 1),
    "SCB_SHCSR_USGFAULTENA": (18, 1),
    "SCB_CFSR_MMFSR": (0, 8),
    "SCB_CFSR_BFSR": (8, 8),
    "SCB_CFSR_UFSR": (16, 16),
    "SCB_CFSR_MSTKERR": (4, 1),
    "SCB_CFSR_STKERR": (12, 1),
    "MPU_CTRL_ENABLE": (0, 1),
    "MPU_CTRL_PRIVDEFENA": (2, 1),
    "MPU_RBAR_VALID": (4, 1),
    "MPU_RASR_ENABLE": (0, 1),
    "MPU_RASR_SIZE": (1, 5),
    "MPU_RASR_C": (17, 1),
    "MPU_RASR_S": (18, 1),
    "MPU_RASR_AP": (24, 3),
    "MPU_RASR_XN": (28, 1),
}
CORE_VALUES = {
    "SCB_AIRCR_VECTKEY_PASSWD": 0x05FA << 16,
    "MPU_RASR_AP_PRIVILEGED": 1 << 24,
    "MPU_RASR_AP_READ_ONLY": 5 << 24,
}


def number(text: str) -> int:
    return int(text.rstrip("uUlL"), 0)


@pytest.fixture(scope="module")
def svd() -> dict[str, Peripheral]:
    return peripherals()


@pytest.fixture(scope="module")
def svd_interrupts() -> dict[str, int]:
    return interrupts()


@cache
def headers() -> str:
    paths = sorted([*REGISTERS.glob("*.h"), *CORE_REGISTERS.glob("*.h")])
    texts = [path.read_text(encoding="utf-8") for path in paths]
    return re.sub(r"/\*.*?\*/", "", "\n".join(texts), flags=re.DOTALL).replace("\\\n", " ")


@dataclass(frozen=True)
class Member:
    name: str
    offset: int
    read_only: bool
    count: int
    type: str


SIZES = {"uint32_t": 4, "uint8_t": 1}
STRUCT = re.compile(r"typedef struct \{(.*?)\} (\w+);", re.DOTALL)
MEMBER = re.compile(r"^(const )?(\w+) (\w+)(?:\[(\d+)\])?$")


@cache
def structs() -> tuple[dict[str, list[Member]], dict[str, int]]:
    """Members of every struct in the headers at the offsets that the compiler gives them; sizes."""
    sizes = dict(SIZES)
    result = {}
    texts = {name: body for body, name in STRUCT.findall(headers())}
    for name in sorted(texts, key=lambda name: (name in STRUCTS, name)):
        offset, members = 0, []
        for text in filter(None, (line.strip() for line in texts[name].split(";"))):
            match = MEMBER.match(text)
            assert match, f"{name}: cannot read '{text}'"
            const, kind, member, count = match.groups()
            size = sizes[kind] * int(count or 1)
            if not member.startswith("reserved_"):
                members.append(Member(member, offset, bool(const), int(count or 1), kind))
            else:
                assert number(f"0x{member[9:]}") == offset, f"{name}.{member} is at {offset:#x}"
            offset += size
        sizes[name] = offset
        result[name] = members
    return result, sizes


BASE = re.compile(r"#define (\w+) \(\(volatile (\w+) \*\)(0x[0-9A-F]+)u\)")
MASK = re.compile(r"#define ([A-Z0-9_a-z]+) (0x[0-9A-F]{8})u\s")
VALUE = re.compile(r"#define ([A-Z0-9_a-z]+) FIELD\((\w+), (\w+)\)")


def bases() -> dict[str, tuple[str, int]]:
    return {name: (kind, number(at)) for name, kind, at in BASE.findall(headers())}


def masks() -> dict[str, int]:
    return {name: number(value) for name, value in MASK.findall(headers())}


def values() -> dict[str, tuple[str, int]]:
    """Value macros: the field they are of, and the field's content."""
    return {name: (field, number(value)) for name, field, value in VALUE.findall(headers())}


def flattened(name: str) -> list[Member]:
    """Registers of a struct; those of a nested struct are listed with their place, like CMR4."""
    members, sizes = structs()
    found = []
    for member in members[name]:
        if member.type in SIZES:
            found.append(member)
            continue
        for channel in range(member.count):
            suffix = str(channel) if member.count > 1 else ""
            start = member.offset + channel * sizes[member.type]
            found += [
                replace(inner, name=inner.name + suffix, offset=start + inner.offset)
                for inner in members[member.type]
            ]
    return found


def svd_name(peripheral: str, member: str) -> str:
    if peripheral == "UART":
        return UART_NAMES.get(member, member)
    if peripheral == "PMC" and not member.startswith("CKGR_"):
        return f"PMC_{member}"
    if peripheral == "MATRIX":
        return f"MATRIX_{member}"
    return member


def field_parts(macro: str) -> tuple[str, str, str]:
    """Peripheral and register as the SVD names them, and the field."""
    prefix, register, field = macro.split("_", 2)
    peripheral, register_prefix = PREFIXES[prefix]
    name = CHANNEL_REGISTERS.get(f"{prefix}_{register}", register_prefix + register)
    return peripheral, name, field


def is_core(macro: str) -> bool:
    return macro.startswith(("SCB_", "MPU_", "NVIC_"))


def test_every_struct_and_base_is_checked() -> None:
    assert {kind for kind, _ in bases().values()} == {*STRUCTS, *CORE_STRUCTS}
    assert {name for names in STRUCTS.values() for name in names} | {"NVIC", "SCB", "MPU"} == set(
        bases()
    )


def test_base_addresses(svd: dict[str, Peripheral]) -> None:
    expected = {name: svd[name].base for names in STRUCTS.values() for name in names}
    assert {name: at for name, (_, at) in bases().items() if name in expected} == expected


@pytest.mark.parametrize(
    ("struct", "peripheral"),
    [(struct, name) for struct, names in STRUCTS.items() for name in names],
)
def test_registers(svd: dict[str, Peripheral], struct: str, peripheral: str) -> None:
    known = svd[peripheral].registers
    for member in flattened(struct):
        if peripheral == "UART" and member.name in UART_LACKS:
            continue
        register = known[svd_name(peripheral, member.name)]
        assert member.offset == register.offset, member
        assert member.count == register.count, member
        assert register.count == 1 or register.step == 4, member
        assert member.read_only == (register.access == "read-only"), member


def test_fields(svd: dict[str, Peripheral]) -> None:
    checked = 0
    for macro, mask in masks().items():
        if is_core(macro):
            continue
        peripheral, register, field = field_parts(macro)
        assert svd[peripheral].registers[register].fields[field] == mask, macro
        checked += 1
    assert checked > 60


def test_flags_are_the_same_in_the_interrupt_registers(svd: dict[str, Peripheral]) -> None:
    for macro, mask in masks().items():
        if macro.startswith("USART_CSR_"):
            for register in ("IER", "IDR", "IMR"):
                field = macro.removeprefix("USART_CSR_")
                assert svd["USART0"].registers[register].fields[field] == mask, macro


def test_fields_of_the_uart_are_those_of_a_usart(svd: dict[str, Peripheral]) -> None:
    for macro, mask in masks().items():
        if not macro.startswith("USART_"):
            continue
        register, field = macro.removeprefix("USART_").split("_", 1)
        known = svd["UART"].registers.get(UART_NAMES.get(register, register))
        lacking = register in UART_LACKS or f"{register}_{field}" in UART_LACKS_FIELDS
        assert lacking == (known is None or field not in known.fields), macro
        assert lacking or known.fields[field] == mask, macro


def test_values(svd: dict[str, Peripheral]) -> None:
    for macro, (field, content) in values().items():
        assert macro.startswith(f"{field}_"), f"{macro} is no value of {field}"
        mask = masks()[field]
        placed = content * (mask & -mask)
        assert placed & ~mask == 0, f"{macro} does not fit"
        if is_core(field):
            assert placed == CORE_VALUES[macro]
            continue
        if macro in NOT_ENUMERATED:
            assert content == NOT_ENUMERATED[macro]
            continue
        peripheral, register, name = field_parts(field)
        known = {k.upper(): v for k, v in svd[peripheral].registers[register].values[name].items()}
        assert known[macro.removeprefix(f"{field}_")] == placed, macro


def test_per_channel_bits(svd: dict[str, Peripheral]) -> None:
    """The macros that take a channel: PWM_CHID, PWM_OUTPUT_L, ADC_CHANNEL."""
    pwm, adc = svd["PWM"].registers, svd["ADC"].registers
    text = headers()
    assert "PWM_CHID(channel) (1u << (channel))" in text
    assert "PWM_OUTPUT_L(channel) (0x10000u << (channel))" in text
    assert "ADC_CHANNEL(channel) (1u << (channel))" in text
    for channel in range(8):
        for register in ("ENA", "DIS", "SR", "IER1", "IDR1", "IMR1", "ISR1"):
            assert pwm[register].fields[f"CHID{channel}"] == 1 << channel
        for register, stem in (("OOV", "OOV"), ("OSS", "OSS"), ("OSC", "OSC"), ("OSSUPD", "OSSUP")):
            assert pwm[register].fields[f"{stem}L{channel}"] == 0x10000 << channel
        # The SVD calls the bit of channel 6 in OSCUPD by another name: a slip of its author.
        name = "OSCUPDL6" if channel == 6 else f"OSCUPL{channel}"
        assert pwm["OSCUPD"].fields[name] == 0x10000 << channel
    for channel in range(16):
        for register, stem in (("CHER", "CH"), ("CHDR", "CH"), ("CHSR", "CH"), ("ISR", "EOC")):
            assert adc[register].fields[f"{stem}{channel}"] == 1 << channel


def test_peripheral_numbers(svd_interrupts: dict[str, int]) -> None:
    numbers = dict(re.findall(r"#define ID_(\w+) (\d+)u", headers()))
    assert numbers
    for name, value in numbers.items():
        assert int(value) == svd_interrupts[name]
    assert f"PERIPHERAL_COUNT {max(svd_interrupts.values()) + 1}u" in headers()


def test_core_registers() -> None:
    found = {
        f"{name}_{member.name}": at + member.offset
        for name, (kind, at) in bases().items()
        if kind in CORE_STRUCTS
        for member in flattened(kind)
    }
    assert found == CORE_ADDRESSES


def test_core_fields() -> None:
    found = {macro: mask for macro, mask in masks().items() if is_core(macro)}
    assert found == {name: ((1 << width) - 1) << low for name, (low, width) in CORE_FIELDS.items()}
