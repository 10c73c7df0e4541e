"""The parameter protocol against the firmware's own server."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, Refused
from tailbeat.core.law import Averaging, Law
from tailbeat.link.params import known_parameters
from tailbeat.link.presets import preset


def test_list_has_all_with_their_limits(fish: Fish) -> None:
    found = fish.params.list()
    assert list(found) == list(known_parameters())
    assert all(p.low <= p.value <= p.high for p in found.values())
    assert found["ILC_GAIN"].value == 4.0
    assert found["ILC_GAIN"].unit == "rad s/m"


@pytest.mark.parametrize("seed", range(4))
def test_list_asks_again_for_what_was_lost(fish: Fish, spoil, seed: int) -> None:
    spoil(fish, seed, lose=0.3, damage=0.1)
    assert list(fish.params.list()) == list(known_parameters())


@given(st.floats(0.0010000000474974513, 50.0, width=32))
@settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_values_come_back_bit_for_bit(fish: Fish, value: float) -> None:
    assert fish.params.set("ILC_GAIN", value).value == value
    assert fish.params.get("ILC_GAIN").value == value


def test_a_double_is_rounded_once(fish: Fish) -> None:
    single = struct.unpack("<f", struct.pack("<f", 0.1))[0]
    assert fish.params.set("ILC_KD", 0.1).value == single


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ILC_LEAD", 99),
        ("ILC_LEAD", 0.25),
        ("ILC_Q_LEN", 1.5),
        ("ILC_GAIN", float("nan")),
        ("ILC_GAIN", 1e39),
    ],
)
def test_bad_values_do_not_reach_the_board(fish: Fish, name: str, value: float) -> None:
    with pytest.raises(InputError):
        fish.params.set(name, value)


def test_the_thesis_preset_is_the_law_of_8_16(fish: Fish) -> None:
    assert fish.params.get("ILC_LEAD").value == 1
    fish.params.set("ILC_DECR_RATE", 0.5)
    changed = fish.params.apply(preset("thesis"))
    params = fish.params.values()
    assert Law.from_params(params) == Law(amplitude_max_rad=float(np.float32(math.pi / 4)))
    assert Averaging.from_params(params) == Averaging()
    assert changed["ILC_LEAD"][0] == 1 and changed["ILC_LEAD"][1].value == 0
    with pytest.raises(InputError, match="no preset 'thesi'") as caught:
        preset("thesi")
    assert caught.value.remedy == "Did you mean thesis? Use thesis."


@pytest.mark.parametrize("name", ["NO_SUCH", "", "A_NAME_FAR_TOO_LONG"])
def test_unknown_names_are_refused(fish: Fish, name: str) -> None:
    with pytest.raises(Refused) as refused:
        fish.params.get(name)
    assert refused.value.name == "BAD_PARAM"
    with pytest.raises(Refused):
        fish.params.set(name, 1.0)


def test_no_change_while_armed(ready: Fish) -> None:
    ready.arm()
    with pytest.raises(Refused) as refused:
        ready.params.set("ILC_GAIN", 5.0)
    assert refused.value.name == "WRONG_STATE"
    assert ready.params.get("ILC_GAIN").value == 4.0


def test_save_load_and_reset(fish: Fish) -> None:
    assert fish.sim is not None
    fish.params.set("ILC_GAIN", 7.5)
    fish.params.save()
    fish.params.set("ILC_GAIN", 9.0)
    fish.params.load()
    assert fish.params.get("ILC_GAIN").value == 7.5
    fish.sim.world.power_cycle()
    fish.link.run(1.0)
    assert fish.params.get("ILC_GAIN").value == 7.5
    fish.params.reset()
    assert fish.params.get("ILC_GAIN").value == 4.0


def test_the_lead_comes_in_half_beats(fish: Fish) -> None:
    assert fish.params.set("ILC_LEAD", 1.5).value == 1.5
    with pytest.raises(InputError) as caught:
        fish.params.set("ILC_LEAD", 1.3)
    assert "multiple of 0.5" in caught.value.remedy
    with pytest.raises(InputError) as caught:
        fish.params.set("ILC_END_EXT", 0.5)
    assert "whole number" in caught.value.remedy
