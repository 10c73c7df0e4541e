"""Boards with older firmware, which have the old names of parameters, and old names typed."""

from __future__ import annotations

from typing import Any

import pytest

from tailbeat.app.cli import run
from tailbeat.board.fish import Fish
from tailbeat.core.errors import Refused
from tailbeat.core.param_names import renamed
from tailbeat.link import _dialect as mavlink
from tailbeat.link.mavlink import text_of
from tailbeat.link.params import Parameters, known_parameters

BY_PRESENT = {new: old for old, new in renamed().items()}


class OlderFirmware:
    """Stands between the host and a simulated board, and has the old names only."""

    def __init__(self, fish: Fish, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked: list[str] = []
        self._send, self._push = fish.link.send, fish.link.framer.push
        monkeypatch.setattr(fish.link, "send", self.send)
        monkeypatch.setattr(fish.link.framer, "push", self.push)

    def send(self, message: Any) -> None:
        if message.get_type() in ("PARAM_SET", "PARAM_REQUEST_READ"):
            name = text_of(message.param_id)
            self.asked.append(name)
            message = self._with_name(message, renamed().get(name, self._unknown(name)))
        self._send(message)

    def push(self, data: bytes) -> list[Any]:
        messages = self._push(data)
        for message in messages:
            if message.get_type() == "PARAM_VALUE":
                name = text_of(message.param_id)
                message.param_id = BY_PRESENT.get(name, name)
            elif message.get_type() == "PARAM_ERROR":
                message.param_id = self._unknown(text_of(message.param_id))
        return messages

    @staticmethod
    def _unknown(name: str) -> str:
        """A present name, which older firmware lacks, as one that no firmware has; or back."""
        return name[::-1] if name in BY_PRESENT or name[::-1] in BY_PRESENT else name

    @staticmethod
    def _with_name(message: Any, name: str) -> Any:
        values = {field: getattr(message, field) for field in message.fieldnames}
        return type(message)(**values | {"param_id": name.encode()})


@pytest.fixture
def older(fish: Fish, monkeypatch: pytest.MonkeyPatch) -> OlderFirmware:
    return OlderFirmware(fish, monkeypatch)


def test_its_parameters_have_the_present_names(fish: Fish, older: OlderFirmware) -> None:
    assert list(fish.params.list()) == list(known_parameters())
    assert fish.params.list()["COAST_S"].text == known_parameters()["COAST_S"].text


def test_it_is_asked_by_the_name_that_it_reported(fish: Fish, older: OlderFirmware) -> None:
    fish.params.list()
    older.asked.clear()
    held = fish.params.set("ILC_DECR_RATE", 0.5)
    assert (held.name, held.value) == ("ILC_DECR_RATE", 0.5)
    assert fish.params.get("ILC_DECR_RATE").value == 0.5
    assert older.asked == ["LAW_FADE", "LAW_FADE"]


def test_a_name_that_it_does_not_have_is_asked_for_once(fish: Fish, older: OlderFirmware) -> None:
    params = Parameters(fish.link)
    assert params.get("ILC_GAIN").value == 4.0
    assert params.set("ILC_GAIN", 5.0).value == 5.0
    assert older.asked == ["ILC_GAIN", "LAW_GAIN", "LAW_GAIN"]


def test_an_old_name_is_the_present_parameter(fish: Fish) -> None:
    assert fish.params.set("LAW_GAIN", 5.0).name == "ILC_GAIN"
    assert fish.params.get("LAW_GAIN").value == 5.0
    with pytest.raises(Refused, match=r"no parameter 'LAW_GIAN'. Did you mean ILC_GAIN\?"):
        fish.params.get("LAW_GIAN")


def test_the_board_names_the_new_one(fish: Fish) -> None:
    texts: list[str] = []
    fish.link.subscribe(
        lambda m: texts.append(text_of(m.text)) if m.get_type() == "STATUSTEXT" else None
    )
    fish.link.send(
        mavlink.MAVLink_param_set_message(1, 1, b"LAW_BEYOND", 1.0, mavlink.MAV_PARAM_TYPE_REAL32)
    )
    fish.link.run(1.0)
    assert texts == ["LAW_BEYOND is now ILC_EXTRAP"]
    assert fish.params.get("ILC_EXTRAP").value == 0.0


def test_an_old_name_that_is_typed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["params", "get", "law_lead", "--connect", "sim:tank?seed=1"]) == 0
    told = capsys.readouterr()
    assert told.out == "ILC_LEAD = 1 beats\n"
    assert told.err.splitlines()[-1] == "tailbeat: LAW_LEAD is now ILC_LEAD"
    assert run(["params", "get", "ilc_lead", "--connect", "sim:tank?seed=1"]) == 0
    assert "is now" not in capsys.readouterr().err
