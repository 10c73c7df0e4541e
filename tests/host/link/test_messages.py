"""What messages become for people and programs."""

from __future__ import annotations

import math

from tailbeat.link import _dialect as mavlink
from tailbeat.link.messages import WATCHED


def test_live_values_that_are_not_known_are_none() -> None:
    names = mavlink.MAVLink_tailbeat_live_message.fieldnames
    kinds = mavlink.MAVLink_tailbeat_live_message.fieldtypes
    values = [0.25 if kind == "float" else 7 for kind in kinds]
    known = WATCHED["TAILBEAT_LIVE"](mavlink.MAVLink_tailbeat_live_message(*values))
    assert known["event"] == "live" and known["time_s"] == 0.007
    assert known["speed_m_s"] == 0.25 and known["beat"] == 7
    values[names.index("speed_m_s")] = math.nan
    unknown = WATCHED["TAILBEAT_LIVE"](mavlink.MAVLink_tailbeat_live_message(*values))
    assert unknown == known | {"speed_m_s": None}
