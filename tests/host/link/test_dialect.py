"""The dialect's ids against every dialect that pymavlink ships, and its frames against pymavlink's.

The tool itself does without pymavlink (test_light_install.py); it is needed to generate the module.
"""

from __future__ import annotations

import random
import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from pymavlink.dialects.v20 import common

from tailbeat.link import _dialect as mavlink
from tailbeat.link.frames import decode

ROOT = Path(__file__).resolve().parents[3]
OURS = ROOT / "wire" / "tailbeat.xml"
_LIST = (ROOT / "wire" / "generate.py").read_text().partition("KNOWN = ")[2].partition(")")[0]
KNOWN = set(re.findall(r"\"(\w+)\"", _LIST))


# MAVLink's own messages that the dialect repeats: id, name and CRC extra, as mavlink.io has them.
BORROWED = {397: ("COMPONENT_METADATA", 182), 435: ("AVAILABLE_MODES", 134)}
READERS = mavlink.MAVLink.decode, decode  # the generated one, and ours, which packs, too


def shipped_dialects() -> list[Path]:
    spec = find_spec("pymavlink")
    assert spec is not None and spec.origin is not None
    return sorted((Path(spec.origin).parent / "dialects" / "v20").glob("*.xml"))


def messages(path: Path) -> dict[int, str]:
    nodes = ElementTree.parse(path).iter("message")
    return {int(node.attrib["id"]): node.attrib["name"] for node in nodes}


def own_messages() -> dict[int, str]:
    return {number: name for number, name in messages(OURS).items() if number not in BORROWED}


def commands(path: Path) -> dict[int, str]:
    enums = ElementTree.parse(path).iter("enum")
    return {
        int(entry.attrib["value"], 0): entry.attrib["name"]
        for enum in enums
        if enum.attrib["name"] == "MAV_CMD"
        for entry in enum.iter("entry")
    }


def enums(path: Path) -> set[str]:
    return {node.attrib["name"] for node in ElementTree.parse(path).iter("enum")} - {"MAV_CMD"}


def test_there_is_something_to_compare() -> None:
    assert len(own_messages()) >= 4
    assert len(commands(OURS)) >= 5
    assert {path.stem for path in shipped_dialects()} >= {"common", "ardupilotmega", "ASLUAV"}
    assert sum(len(messages(path)) for path in shipped_dialects()) > 300
    assert sum(len(commands(path)) for path in shipped_dialects()) > 200


@pytest.mark.parametrize("path", shipped_dialects(), ids=lambda path: path.stem)
def test_no_collision(path: Path) -> None:
    assert not own_messages().keys() & messages(path).keys()
    assert not set(own_messages().values()) & set(messages(path).values())
    for number, (name, _) in BORROWED.items():
        assert messages(path).get(number, name) == name
    assert not commands(OURS).keys() & commands(path).keys()
    assert not set(commands(OURS).values()) & set(commands(path).values())
    assert not enums(OURS) & enums(path)


@pytest.mark.parametrize("number", BORROWED)
def test_borrowed_messages_are_those_of_mavlink(number: int) -> None:
    """Other programs check the frame with the CRC extra, which depends on all names and types."""
    assert (mavlink.mavlink_map[number].msgname, mavlink.mavlink_map[number].crc_extra) == (
        BORROWED[number]
    )


def test_message_ids_need_mavlink_2() -> None:
    """Ids above 255 cannot be mistaken for another dialect's in MAVLink 1."""
    assert min(messages(OURS)) > 255


def test_names_say_whose_they_are() -> None:
    for name in (*own_messages().values(), *commands(OURS).values(), *enums(OURS)):
        assert name.startswith("TAILBEAT_"), name


@pytest.mark.parametrize("number", sorted(messages(OURS)))
def test_installed_module_is_of_this_dialect(number: int) -> None:
    """The installed package knows each message with the fields of the XML, none missing."""
    node = next(
        node for node in ElementTree.parse(OURS).iter("message") if int(node.attrib["id"]) == number
    )
    generated = mavlink.mavlink_map[number]
    assert set(generated.fieldnames) == {field.attrib["name"] for field in node.iter("field")}


def test_generated_module_speaks_mavlink_2() -> None:
    assert mavlink.WIRE_PROTOCOL_VERSION == "2.0"
    assert mavlink.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL == 110


def test_states_and_files_match_the_firmware() -> None:
    """Enums that the XML repeats from C headers carry the same numbers."""
    headers = {
        "STATE": ("supervisor/supervisor.h", r"\bSTATE_(\w+) = (\d+)"),
        "FILE": ("store/vault.h", r"\bVAULT_UPLOAD_(\w+) = (\d+)"),
    }
    for kind, (path, entry) in headers.items():
        found = dict(re.findall(entry, (ROOT / "firmware" / path).read_text()))
        entries = mavlink.enums[f"TAILBEAT_{kind}"].values()
        in_xml = {
            e.name.removeprefix(f"TAILBEAT_{kind}_") for e in entries if "ENUM_END" not in e.name
        }
        assert found.keys() == in_xml
        for name, number in found.items():
            assert getattr(mavlink, f"TAILBEAT_{kind}_{name}") == int(number)


def random_value(kind: str, length: int, rng: random.Random) -> Any:
    """Of a field: any value of its type, of an array each."""
    if kind == "char":
        return bytes(rng.randrange(1, 128) for _ in range(rng.randint(0, max(1, length))))
    if kind in ("float", "double"):
        values: list[Any] = [
            rng.choice((0.0, -1.5, rng.uniform(-1e6, 1e6))) for _ in range(length or 1)
        ]
    else:
        bits = int(re.sub(r"\D", "", kind))
        low = 0 if kind.startswith("u") else -(1 << (bits - 1))
        values = [rng.choice((0, low + rng.getrandbits(bits))) for _ in range(length or 1)]
    return values if length else values[0]


def frames(dialect: Any, values: dict[int, list[Any]], key: bytes | None) -> list[bytes]:
    """One frame of each message, with growing sequence numbers."""
    mav = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    if key is not None:
        mav.signing.secret_key, mav.signing.sign_outgoing = key, True
        mav.signing.timestamp = 123_456_789
    packed = []
    for number, fields in values.items():
        packed.append(dialect.mavlink_map[number](*fields).pack(mav))
        mav.seq = (mav.seq + 1) & 0xFF
    return packed


@pytest.mark.parametrize("key", [None, bytes(range(32))], ids=["unsigned", "signed"])
def test_frames_are_those_of_pymavlink(key: bytes | None) -> None:
    """Byte for byte, for every message of the common dialect that the tool knows; and pymavlink
    reads ours."""
    rng = random.Random(19)
    numbers = sorted(common.mavlink_map.keys() & mavlink.mavlink_map.keys())
    assert {common.mavlink_map[number].msgname.lower() for number in numbers} == KNOWN - {
        name.lower() for name, _ in BORROWED.values()
    }
    values = {}
    for number in numbers:
        kind = common.mavlink_map[number]
        lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
        values[number] = [
            random_value(type_name, lengths[name], rng)
            for name, type_name in zip(kind.fieldnames, kind.fieldtypes, strict=True)
        ]
    ours = frames(mavlink, values, key)
    assert ours == frames(common, values, key)
    reader = common.MAVLink(None)
    if key is not None:
        reader.signing.secret_key = key
    for number, frame in zip(numbers, ours, strict=True):
        message = reader.decode(bytearray(frame))
        again, quickly = (read(mavlink.MAVLink(None), bytearray(frame)) for read in READERS)
        assert message.get_msgId() == number
        assert repr(message.to_dict()) == repr(again.to_dict())
        assert quickly.get_header().pack() == again.get_header().pack()
        both = [{**vars(one), "_header": None} for one in (quickly, again)]
        assert repr(both[0]) == repr(both[1])
