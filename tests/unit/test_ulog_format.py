"""The trial file as an independent ULog reader sees it.

Needs the bytes that the unit test test_trial_log writes when TRIAL_LOG_OUT names a file:
    TRIAL_LOG_OUT=trial.ulg test_trial_log && TRIAL_LOG_OUT=trial.ulg pytest test_ulog_format.py
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from pyulog import ULog

LOG = os.environ.get("TRIAL_LOG_OUT", "")
pytestmark = pytest.mark.skipif(
    not (LOG and Path(LOG).is_file()),
    reason="needs TRIAL_LOG_OUT to name a file written by the unit test test_trial_log",
)

TOPICS = {
    "slot": (
        "uint64_t timestamp",
        "float speed_m_s",
        "uint16_t index",
        "uint16_t sigma_10um_s",
        "int16_t gain_10um_s",
        "int16_t way_um",
        "int16_t turn_100urad",
        "uint8_t samples",
        "uint8_t at_ms",
    ),
    "rest": ("uint64_t timestamp", "float begin_s", "float still_s", "float tilt_sigma_rad"),
    "beat": (
        "uint64_t timestamp",
        "float amplitude_rad",
        "float applied_rad",
        "float reference_m_s",
        "float speed_m_s",
        "float sigma_m_s",
        "uint16_t beat",
        "uint16_t samples",
    ),
    "battery": ("uint64_t timestamp", "float voltage_v"),
    "trial_end": ("uint64_t timestamp", "uint16_t end", "uint16_t executed"),
}
INFORMATION = {
    "sys_name": "tailbeat",
    "ver_sw": "1.0.0-12-gabcdef0",
    "board": "simulated",
    "unique_id": b"mocked-board-00\0".hex(),
    "trial": 42,
    "iteration": 3,
    "beats": 40,
    "reference_crc": 0xCAFEF00D,
    "beat_s": 1.0,
    "start_us": 10_000_000,
    "input": "uploaded",
}


@pytest.fixture(scope="module")
def log() -> ULog:
    return ULog(LOG)


def test_is_whole(log: ULog) -> None:
    assert not log.file_corruption
    assert log.start_timestamp == 10_000_000
    assert Path(LOG).stat().st_size <= 20_480


def test_information(log: ULog) -> None:
    assert log.msg_info_dict == INFORMATION


def test_parameters(log: ULog) -> None:
    assert log.initial_parameters["ILC_GAIN"] == 4.0
    assert all(len(name) <= 16 for name in log.initial_parameters)


@pytest.mark.parametrize("topic", TOPICS)
def test_topic_fields(log: ULog, topic: str) -> None:
    dataset = log.get_dataset(topic)
    assert tuple(f"{f.type_str} {f.field_name}" for f in dataset.field_data) == TOPICS[topic]


def test_last_record_of_a_beat_is_the_uploaded_one(log: ULog) -> None:
    beats = log.get_dataset("beat").data
    last = {int(k): float(v) for k, v in zip(beats["beat"], beats["speed_m_s"], strict=True)}
    assert np.isnan(beats["speed_m_s"][:40]).all()
    assert np.allclose([last[k] for k in range(40)], [0.001 * k for k in range(40)])


def test_text(log: ULog) -> None:
    assert [(m.log_level_str(), m.message) for m in log.logged_messages] == [("INFO", "settled")]
