"""The table of speed sources as the host reads it from the firmware."""

from __future__ import annotations

import pytest

from tailbeat.core.speed_source import PARAMETER, source_info, source_number, speed_source


def test_params_choose_the_source() -> None:
    assert speed_source({PARAMETER: 2.0}).name == "imu"
    assert speed_source({}).name == "vision"


def test_traits() -> None:
    vision, upload, imu, model = map(source_info, range(4))
    assert vision.sampled and vision.live and not vision.needs_imu
    assert upload.uploaded and not (upload.sampled or upload.needs_imu or upload.live)
    assert imu.needs_imu and imu.needs_rests and not imu.live
    assert model.modelled and model.needs_imu and model.live and not model.needs_rests


def test_a_source_of_newer_firmware_needs_nothing() -> None:
    unknown = source_info(9)
    assert unknown.name == "source 9"
    assert not (unknown.needs_imu or unknown.needs_rests or unknown.sampled)


def test_names_are_found_again() -> None:
    assert [source_number(source_info(number).name) for number in range(4)] == [0, 1, 2, 3]
    with pytest.raises(StopIteration):
        source_number("sonar")
