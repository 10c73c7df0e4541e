"""What the fields of a VN-100's messages are called here. Units stand at the end of the names.

Orders are those of the wire. VN-100 user manual UM001, "Binary Output Message Configuration" and
"ASCII Measurement Messages"; the Common group's Imu field as recordings have it.
"""

from __future__ import annotations

from dataclasses import dataclass
from struct import Struct

GROUP_NAMES = {0: "common", 1: "time", 2: "imu", 4: "attitude"}


@dataclass(frozen=True)
class Field:
    """One field of a binary group: how its bytes are read and what its values are called."""

    layout: Struct
    names: tuple[str, ...]


def _axes(what: str, unit: str, axes: str = "xyz") -> tuple[str, ...]:
    return tuple(f"{what}_{axis}_{unit}" for axis in axes)


def _ned(what: str, unit: str) -> tuple[str, ...]:
    return tuple(f"{what}_{axis}_{unit}" for axis in ("north", "east", "down"))


def _floats(*names: str) -> Field:
    return Field(Struct(f"<{len(names)}f"), names)


def _whole(kind: str, name: str) -> Field:
    return Field(Struct("<" + kind), (name,))


YPR = ("yaw_deg", "pitch_deg", "roll_deg")
QUATERNION = ("quat_x", "quat_y", "quat_z", "quat_w")
MAG = _axes("mag", "gauss")
ACCEL = _axes("accel", "m_s2")
RATE = _axes("rate", "rad_s")
LINEAR_ACCEL = _axes("linear_accel", "m_s2")
LINEAR_ACCEL_NED = _ned("linear_accel", "m_s2")
UNCOMP_MAG = _axes("uncomp_mag", "gauss")
UNCOMP_ACCEL = _axes("uncomp_accel", "m_s2")
UNCOMP_RATE = _axes("uncomp_rate", "rad_s")
DELTA_THETA = ("delta_time_s", *_axes("delta_theta", "deg"))
DELTA_VEL = _axes("delta_vel", "m_s")
HEAVE = ("heave_m", "heave_rate_m_s", "delayed_heave_m")
# Row and column of the matrix that turns north-east-down into the body frame, column by column.
DCM = tuple(f"dcm_{row}{column}" for column in "123" for row in "123")

_TIME_UTC = Field(
    Struct("<b5BH"),
    ("utc_year", "utc_month", "utc_day", "utc_hour", "utc_min", "utc_s", "utc_ms"),
)

# (group, bit) of the header's field words.
BINARY: dict[tuple[int, int], Field] = {
    (0, 0): _whole("Q", "time_startup_ns"),
    (0, 1): _whole("Q", "time_gps_ns"),
    (0, 2): _whole("Q", "time_sync_in_ns"),
    (0, 3): _floats(*YPR),
    (0, 4): _floats(*QUATERNION),
    (0, 5): _floats(*RATE),
    (0, 6): Field(Struct("<3d"), ("latitude_deg", "longitude_deg", "altitude_m")),
    (0, 7): _floats(*_ned("vel", "m_s")),
    (0, 8): _floats(*ACCEL),
    (0, 9): _floats(*UNCOMP_ACCEL, *UNCOMP_RATE),
    (0, 10): _floats(*MAG, "temp_c", "pres_kpa"),
    (0, 11): _floats(*DELTA_THETA, *DELTA_VEL),
    (0, 12): _whole("H", "vpe_status"),
    (0, 13): _whole("I", "sync_in_count"),
    (0, 14): _whole("Q", "time_gps_pps_ns"),
    (1, 0): _whole("Q", "time_startup_ns"),
    (1, 1): _whole("Q", "time_gps_ns"),
    (1, 2): _whole("Q", "gps_tow_ns"),
    (1, 3): _whole("H", "gps_week"),
    (1, 4): _whole("Q", "time_sync_in_ns"),
    (1, 5): _whole("Q", "time_gps_pps_ns"),
    (1, 6): _TIME_UTC,
    (1, 7): _whole("I", "sync_in_count"),
    (1, 8): _whole("I", "sync_out_count"),
    (1, 9): _whole("B", "time_status"),
    (2, 0): _whole("H", "imu_status"),
    (2, 1): _floats(*UNCOMP_MAG),
    (2, 2): _floats(*UNCOMP_ACCEL),
    (2, 3): _floats(*UNCOMP_RATE),
    (2, 4): _floats("temp_c"),
    (2, 5): _floats("pres_kpa"),
    (2, 6): _floats(*DELTA_THETA),
    (2, 7): _floats(*DELTA_VEL),
    (2, 8): _floats(*MAG),
    (2, 9): _floats(*ACCEL),
    (2, 10): _floats(*RATE),
    (2, 11): _whole("H", "sens_sat"),
    (4, 0): _whole("H", "vpe_status"),
    (4, 1): _floats(*YPR),
    (4, 2): _floats(*QUATERNION),
    (4, 3): _floats(*DCM),
    (4, 4): _floats(*_ned("mag", "gauss")),
    (4, 5): _floats(*_ned("accel", "m_s2")),
    (4, 6): _floats(*LINEAR_ACCEL),
    (4, 7): _floats(*LINEAR_ACCEL_NED),
    (4, 8): _floats("yaw_sigma_deg", "pitch_sigma_deg", "roll_sigma_deg"),
    (4, 12): _floats(*HEAVE),
    (4, 13): _floats("attitude_sigma_deg"),
}

ASCII: dict[str, tuple[str, ...]] = {
    "VNYPR": YPR,
    "VNQTN": QUATERNION,
    "VNQMR": (*QUATERNION, *MAG, *ACCEL, *RATE),
    "VNMAG": MAG,
    "VNACC": ACCEL,
    "VNGYR": RATE,
    "VNMAR": (*MAG, *ACCEL, *RATE),
    "VNYMR": (*YPR, *MAG, *ACCEL, *RATE),
    "VNYBA": (*YPR, *LINEAR_ACCEL, *RATE),
    "VNYIA": (*YPR, *LINEAR_ACCEL_NED, *RATE),
    "VNIMU": (*UNCOMP_MAG, *UNCOMP_ACCEL, *UNCOMP_RATE, "temp_c", "pres_kpa"),
    "VNDTV": (*DELTA_THETA, *DELTA_VEL),
    "VNHVE": HEAVE,
}

# $VNERR
ERRORS = {
    1: "hard fault",
    2: "input buffer overflow",
    3: "wrong check",
    4: "unknown command",
    5: "too few values",
    6: "too many values",
    7: "a value out of range",
    8: "unknown register",
    9: "not allowed",
    10: "restarted by its watchdog",
    11: "output buffer overflow",
    12: "the baud rate is too low for all it is to send",
    255: "more errors than it could report",
}


def error_words(code: int) -> str:
    """What the sensor complains of."""
    return ERRORS.get(code, f"error {code}")
