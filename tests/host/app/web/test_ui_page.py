"""What the page shows, without a browser: charts and words are functions of a snapshot."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tailbeat.app.web import page, view
from tailbeat.app.web.view import LOG_LINES, PageState, after, logged
from tailbeat.core.trial_checks import HeadingDrift
from tailbeat.experiment.trial_rows import TrialRow
from tailbeat.link.messages import BeatEvent
from tailbeat.session.events import StepProgress, TrialStarted

NOW = PageState(
    phase="idle",
    connection="serial:/dev/ttyUSB0",
    board="fish",
    state="IDLE",
    battery_v=7.9,
    battery_low_v=6.6,
    imu_well=True,
    iteration=3,
    next_trial=4,
    reference_m_s=(0.01, 0.05, 0.07, 0.05),
    speed_m_s=(0.0, 0.04, None, None),
    amplitude_rad=(0.1, 0.3, None, None),
    amplitude_max_rad=0.5,
)


def row(trial: int, error_m_s: float, decision: str = "keep", **other: object) -> TrialRow:
    made = TrialRow(
        trial=trial, iteration=trial, end="complete", decision=decision, reason="", repeat_of=0,
        max_abs_error_m_s=error_m_s, rms_error_m_s=error_m_s / 2, measured_beats=4,
        saturated_beats=0, distance_m=0.2, contraction=math.nan, learned=True, rolled_back=False,
        straight=None, battery_start_v=8.0, battery_end_v=7.9, input="law", file="0001.ulg",
        time="",
    )  # fmt: skip
    return replace(made, **other)  # type: ignore[arg-type]


def test_what_was_not_measured_is_a_gap() -> None:
    reference, measured = page.speed_chart(NOW)["series"]
    assert reference["data"] == [10.0, 50.0, 70.0, 50.0]
    assert measured["data"] == [0.0, 40.0, None, None]


def test_a_speed_beyond_the_reference_stays_in_the_picture() -> None:
    fast = replace(NOW, speed_m_s=(0.0, 0.2, None, None))
    assert page.speed_chart(fast)["yAxis"]["max"] >= 200


def test_amplitudes_in_degrees_under_their_limit() -> None:
    options = page.amplitude_chart(NOW)
    (bars,) = options["series"]
    assert bars["data"] == [5.73, 17.19, None, None]
    assert bars["markLine"]["data"][0]["yAxis"] == pytest.approx(math.degrees(0.5), abs=1e-3)
    assert options["yAxis"]["max"] > math.degrees(0.5)


def test_the_error_axis_holds_every_error_and_the_error_bound() -> None:
    rows = (row(1, 0.073), row(2, 0.0433), row(3, 0.0121, "discard"), row(4, math.nan))
    options = page.error_chart(replace(NOW, rows=rows, error_bound_m_s=0.0107))
    kept, dropped = options["series"]
    assert kept["data"] == [[1, 73.0], [2, 43.3]]
    assert dropped["data"] == [[3, 12.1]]
    axis = options["yAxis"]
    assert axis["type"] == "log"
    assert axis["min"] < 10.7 < 73.0 < axis["max"]
    assert all(math.log2(axis[end]).is_integer() for end in ("min", "max"))
    assert kept["markLine"]["data"][0]["yAxis"] == pytest.approx(10.7)
    without = page.error_chart(replace(NOW, rows=rows, error_bound_m_s=math.nan))
    assert "markLine" not in without["series"][0]


def test_lines_differ_in_grey() -> None:
    """By dashes or marks, not only by colour."""
    reference, measured = page.speed_chart(NOW)["series"]
    assert reference["lineStyle"]["type"] != measured["lineStyle"].get("type", "solid")
    assert reference["symbol"] != measured["symbol"]


@pytest.mark.parametrize(
    ("volts", "look"),
    [(7.9, "well"), (6.8, "low"), (6.0, "low"), (0.0, "unknown"), (None, "unknown")],
)
def test_a_low_battery_is_seen(volts: float | None, look: str) -> None:
    text, found = view.battery(replace(NOW, battery_v=volts))
    assert found == look
    assert ("LOW" in text) == (look == "low")


def test_silence_is_said_and_greyed() -> None:
    assert view.link(NOW, 0.4) == ("link 0.4 s", "well")
    assert not view.is_stale(NOW, 0.4)
    assert view.link(NOW, 12.3) == ("silent for 12 s", "low")
    assert view.is_stale(NOW, 12.3)
    assert view.is_stale(replace(NOW, phase="connecting"), 0.1)
    assert view.is_stale(NOW, None)


def test_nothing_is_well_that_is_not_heard_of() -> None:
    assert [look for _, look in view.chips(NOW, 0.4)] == ["well"] * 3
    for now, silent_s in ((NOW, 12.3), (replace(NOW, phase="connecting"), 0.1)):
        link, *of_board = view.chips(now, silent_s)
        assert link[1] == "low"
        assert of_board == [("battery 7.9 V", "unknown"), ("motion sensor ok", "unknown")]


def test_start_says_what_it_will_do() -> None:
    text = view.next_line(replace(NOW, travel="it will come about 1.96 m of 2.64 m"))
    assert text == "START: trial 4, iteration 3; it will come about 1.96 m of 2.64 m"
    assert "waits" in view.next_line(replace(NOW, pending=3))
    assert "no reference" in view.next_line(replace(NOW, reference_m_s=()))


def test_rows_in_words() -> None:
    bent = HeadingDrift(0.1, math.radians(-21), 0.2, "imu")
    assert view.straight(row(1, 0.01, straight=bent)) == "crooked, -21°"
    assert view.straight(row(1, 0.01)) == ""
    cut = row(1, 0.01, "discard", reason="a wave", end="aborted:ABORT_COMMAND")
    assert view.row_line(cut) == "discarded: a wave; aborted: abort_command"
    assert view.row_line(row(1, 0.01, "")) == "not decided"


def test_steps_keep_their_places() -> None:
    now = NOW
    for name, ok in (("rest", None), ("pose", None), ("rest", True), ("still", None)):
        now = after(now, StepProgress(name, name, ok, None), "12:00:00")
    assert [(step.step, step.ok) for step in now.steps] == [
        ("rest", True), ("pose", None), ("still", None),
    ]  # fmt: skip
    assert now.phase == "preflight"


def test_a_new_trial_wipes_the_old_one() -> None:
    now = after(NOW, TrialStarted(4, 3), "12:00:00")
    assert (now.phase, set(now.speed_m_s), set(now.amplitude_rad)) == ("swimming", {None}, {None})
    beat = BeatEvent(4, 1, 0.2, 0.05, 0.03, 0.001, 9, False, False)
    now = after(now, beat, "12:00:01")
    assert now.speed_m_s == (None, 0.03, None, None)
    late = replace(beat, beat=9)
    assert after(now, late, "12:00:01").speed_m_s == now.speed_m_s
    assert view.live_line(now) == "30.0 mm/s, reference 50.0; tail ±11°"


def test_the_log_forgets_its_oldest_lines() -> None:
    now = NOW
    for number in range(LOG_LINES + 5):
        now = logged(now, f"line {number}", "12:00:00")
    assert len(now.log) == LOG_LINES
    assert now.log[0].endswith("line 5")
    assert now.logged == LOG_LINES + 5
