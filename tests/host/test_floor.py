"""The floor against values from an independent implementation of the plants."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tailbeat import reference
from tailbeat.errors import InputError
from tailbeat.floor import floor, plant_beats, plant_config


@pytest.mark.parametrize(
    ("kappa", "minimax_mm", "lsq_mm"),
    [(2.5, 23.2, 25.6), (5, 15.9, 17.2), (10, 10.4, 11.3), (20, 6.67, 7.1)],
)
def test_tank(kappa: float, minimax_mm: float, lsq_mm: float) -> None:
    config = plant_config("tank", {"kappa_per_m": kappa})
    found = floor(config, reference.thesis(), math.pi / 4)
    assert found.minimax_m_s * 1e3 == pytest.approx(minimax_mm, rel=0.01)
    assert found.lsq_max_abs_m_s * 1e3 == pytest.approx(lsq_mm, rel=0.01)
    assert found.where_s == 39.5


def test_thesis() -> None:
    found = floor(plant_config("thesis", {}), reference.thesis(), math.pi / 4)
    assert found.minimax_m_s * 1e3 == pytest.approx(0.83, rel=0.02)
    assert found.lsq_max_abs_m_s * 1e3 == pytest.approx(0.88, rel=0.02)


def test_the_input_reaches_the_floor_and_stays_in_bounds() -> None:
    config = plant_config("tank", {})
    wanted = reference.thesis()
    found = floor(config, wanted, 0.6)
    reached = plant_beats(config, found.minimax_input.astype(np.float64), 1.0)
    assert np.abs(wanted.speed_m_s - reached).max() == pytest.approx(found.minimax_m_s, rel=1e-3)
    assert found.minimax_input.min() >= 0
    assert found.minimax_input.max() <= np.float32(0.6)


def test_values_that_make_no_sense_are_refused() -> None:
    with pytest.raises(InputError):
        plant_config("tank", {"colour": 1})
    config = plant_config("tank", {"kappa_per_m": -1})
    with pytest.raises(InputError):
        floor(config, reference.thesis(), 0.7)
