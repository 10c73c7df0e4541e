"""What the page shows, without a browser: charts and words are functions of a snapshot."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tailbeat.app.web import charts, state, view
from tailbeat.app.web.state import LOG_LINES, PageState, TrialCurve, after, logged
from tailbeat.core.trial_checks import HeadingDrift
from tailbeat.experiment.trial_rows import TrialRow
from tailbeat.link.messages import BeatEvent
from tailbeat.session.events import (
    LinkLost,
    LinkRestored,
    StepBegun,
    StepEnded,
    StepProgress,
    TrialEnded,
    TrialStarted,
)
from tailbeat.session.outcome import Travel

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
    reference, measured = charts.speed_chart(NOW)["series"]
    assert reference["data"] == [10.0, 50.0, 70.0, 50.0]
    assert measured["data"] == [0.0, 40.0, None, None]


def test_a_speed_beyond_the_reference_stays_in_the_picture() -> None:
    fast = replace(NOW, speed_m_s=(0.0, 0.2, None, None))
    assert charts.speed_chart(fast)["yAxis"]["max"] >= 200


def test_amplitudes_in_degrees_under_their_limit() -> None:
    options = charts.amplitude_chart(NOW)
    (bars,) = options["series"]
    assert bars["data"] == [5.73, 17.19, None, None]
    assert bars["markLine"]["data"][0]["yAxis"] == pytest.approx(math.degrees(0.5), abs=1e-3)
    assert options["yAxis"]["max"] > math.degrees(0.5)


def test_the_error_axis_holds_every_error_and_the_error_bound() -> None:
    rows = (row(1, 0.073), row(2, 0.0433), row(3, 0.0121, "discard"), row(4, math.nan))
    options = charts.error_chart(replace(NOW, rows=rows, error_bound_m_s=0.0107))
    kept, dropped = options["series"]
    assert kept["data"] == [[1, 73.0], [2, 43.3]]
    assert dropped["data"] == [[3, 12.1]]
    axis = options["yAxis"]
    assert axis["type"] == "log"
    assert axis["min"] < 10.7 < 73.0 < axis["max"]
    assert all(math.log2(axis[end]).is_integer() for end in ("min", "max"))
    assert kept["markLine"]["data"][0]["yAxis"] == pytest.approx(10.7)
    without = charts.error_chart(replace(NOW, rows=rows, error_bound_m_s=math.nan))
    assert without["series"][0]["markLine"] == {"data": []}


def test_lines_differ_in_grey() -> None:
    """By dashes or marks, not only by colour."""
    reference, measured = charts.speed_chart(NOW)["series"]
    assert reference["lineStyle"]["type"] != measured["lineStyle"].get("type", "solid")
    assert reference["symbol"] != measured["symbol"]


def curve(trial: int, **other: object) -> TrialCurve:
    made = TrialCurve(
        trial, trial, NOW.reference_m_s, (0.0, 0.04, 0.06, None), (0.1, 0.5, 0.5, 0.2),
        (False, True, True, False),
    )  # fmt: skip
    return replace(made, **other)  # type: ignore[arg-type]


def test_earlier_trials_lie_under_the_present_one() -> None:
    """Those along the same reference, and not the trial itself."""
    other = curve(2, reference_m_s=(0.02,) * 4)
    now = replace(NOW, trial=3, curves=(curve(1), other, curve(3)))
    assert [one["name"] for one in charts.speed_chart(now)["series"]] == [
        "reference", "trial 1", "measured",
    ]  # fmt: skip


def test_the_error_of_each_beat_with_what_spoils_it() -> None:
    now = replace(
        NOW, trial=3, speed_m_s=curve(3).speed_m_s, curves=(curve(3),), error_bound_m_s=0.012
    )
    options = charts.beat_error_chart(now)
    bars, limit, missing = options["series"]
    assert bars["data"] == [10.0, 10.0, 10.0, None]
    assert (limit["data"], missing["data"]) == ([[1, 10.0], [2, 10.0]], [[3, 0]])
    assert [line["yAxis"] for line in bars["markLine"]["data"]] == [12.0, -12.0]
    assert options["yAxis"]["max"] >= 12.0 and options["yAxis"]["min"] <= -12.0
    cut = curve(3, amplitude_rad=(0.1, 0.5, None, None))
    options = charts.beat_error_chart(replace(now, curves=(cut,)))
    assert [one["name"] for one in options["series"]] == ["error", "at the limit"], "not executed"
    under_way = replace(NOW, phase="swimming", speed_m_s=(None,) * 4)
    options = charts.beat_error_chart(under_way)
    assert len(options["series"]) == 1, "what comes is not missing"
    assert (options["yAxis"]["min"], options["yAxis"]["max"]) == (-10, 10), "before the first one"


def test_the_tank_holds_walls_path_and_clearance() -> None:
    walls = ((-0.1, -0.5), (3.0, -0.5), (3.0, 0.5), (-0.1, 0.5))
    start = 0.2, 0.0, math.radians(10)
    track = (0.2, 0.0), (0.9, 0.05)
    now = replace(NOW, track=track, walls=walls, start_pose=start, room_m=2.6)
    options = charts.tank_chart(now)
    wall, path, begun, fish = options["series"]
    assert [one["name"] for one in options["series"]] == ["wall", "path", "start", "fish"]
    assert wall["data"] == [list(one) for one in (*walls, walls[0])]
    assert path["markLine"]["data"] == [{"xAxis": 2.8}]
    assert (begun["data"], begun["symbolRotate"]) == ([[0.2, 0.0]], -100.0)
    assert fish["data"] == [[0.9, 0.05]]
    assert options["xAxis"]["min"] <= -0.1 and options["xAxis"]["max"] >= 3.0
    assert options["yAxis"]["inverse"] and options["yAxis"]["max"] >= 0.5
    assert charts.tank_chart(NOW)["series"][0]["data"] == []


def test_without_a_calibration_the_tank_has_two_end_walls() -> None:
    """Of a fish of 36 cm: its tail at the wall behind it, its marker 16 cm ahead of that."""
    ends = state.end_walls_m(3.0, 0.36)
    assert ends == pytest.approx((-0.16, 2.84))
    assert state.end_walls_m(0.0, 0.36) is None
    now = replace(NOW, end_walls_m=ends, start_pose=(0.5, 0.1, 0.0), room_m=2.64)
    behind, ahead, path, _ = charts.tank_chart(now)["series"]
    assert [x for x, _ in behind["data"]] == [0.34] * 2
    assert [x for x, _ in ahead["data"]] == [3.34] * 2
    nose_m = path["markLine"]["data"][0]["xAxis"] + 0.2
    assert nose_m == pytest.approx(3.34), "the clearance ends where the nose is at the wall"


def test_charts_in_words() -> None:
    now = replace(NOW, trial=3, curves=(curve(3),), error_bound_m_s=0.0107, room_m=2.64)
    now = replace(now, rows=(row(1, 0.073), row(2, 0.0433), row(3, 0.0121, "discard")))
    assert charts.speed_text(now) == (
        "reference 10.0 to 70.0 mm/s over 4 beats; measured 0.0 to 40.0 mm/s in 2 beats, the last"
        " 40.0"
    )
    assert charts.beat_error_text(now) == (
        "largest 10.0 mm/s at beat 1; 2 beats measured; 2 beats at the amplitude limit; error bound"
        " 10.7 mm/s"
    )
    assert charts.speed_chart(now)["xAxis"]["data"] == [0, 1, 2, 3], "as in words and in files"
    assert charts.amplitude_text(now) == "6 to 17 degrees over 2 beats; limit 29 degrees"
    assert charts.error_text(now) == (
        "iteration 1 73.0, iteration 2 43.3 mm/s; error bound 10.7 mm/s"
    )
    seen = replace(now, track=((0.0, 0.0), (0.9, -0.05)), end_walls_m=(-0.16, 2.84))
    assert charts.tank_text(seen) == (
        "tank 3.00 m long; fish 0.90 m ahead of its start, 0.05 m to the left;"
        " tank clearance 2.64 m"
    )
    assert charts.compare_text(None, curve(3)).startswith("trial 3: measured")


def test_what_is_said_does_not_change_with_each_beat() -> None:
    swims = replace(NOW, phase="swimming", beat=1)
    assert view.announcement(swims) == view.announcement(replace(swims, beat=2)) == "Trial running"
    ready = after(replace(NOW, phase="working"), StepEnded("health", True, "well"), "12:00:00")
    assert view.announcement(ready) == "Working. health: well"


def test_the_path_forgets_what_hardly_differs() -> None:
    now = state.by_place(NOW, (0.0, 0.0), 0.3)
    assert state.by_place(now, (0.001, 0.001)) is now
    assert state.by_place(now, (0.01, 0.0)).track == ((0.0, 0.0), (0.01, 0.0))
    assert now.start_pose == (0.0, 0.0, 0.3)
    begun = after(state.by_place(now, (0.01, 0.0)), TrialStarted(4, 3), "12:00:00")
    assert (begun.track, begun.start_pose) == ((), (0.0, 0.0, 0.3))


def test_the_path_holds_a_whole_trial() -> None:
    """2.6 m with a sway of 2 cm a beat, 25 pictures a second at 80 mm/s."""
    now = NOW
    for k in range(round(2.6 / 0.0032)):
        now = state.by_place(now, (k * 0.0032, 0.01 * math.sin(k * math.tau / 25)))
    assert now.track[0] == (0.0, 0.0) and now.track[-1][0] > 2.58


def test_two_trials_over_each_other() -> None:
    options = charts.compare_chart(curve(1), curve(3))
    assert [one["name"] for one in options["series"]] == ["reference", "trial 1", "trial 3"]
    first, second = options["series"][1:]
    assert first["symbol"] != second["symbol"] and first["lineStyle"] != second["lineStyle"]
    assert charts.compare_chart(None, None)["series"] == []


def test_steps_of_the_guided_job() -> None:
    now = after(NOW, StepBegun(1, 5, "health", "is it well?", "seconds"), "12:00:00")
    assert [(one.name, one.done) for one in now.guide] == [("health", None)]
    now = after(now, StepEnded("health", True, "well"), "12:00:01")
    now = after(now, StepBegun(2, 5, "commission", "get to know it", "6 min"), "12:00:02")
    now = after(now, StepEnded("tank", False, "no room"), "12:00:03")
    assert [(one.name, one.done) for one in now.guide] == [
        ("health", True), ("commission", None), ("tank", False),
    ]  # fmt: skip
    begun = StepBegun(3, 5, "reference", "the speed to learn", "seconds", "y or n")
    now = after(now, begun, "12:00:04")
    assert now.log[-1].endswith("3/5 reference: the speed to learn (seconds)")
    assert [one.done for one in now.guide] == [True, True, False, None]


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
        assert of_board == [("battery 7.9 V", "unknown"), ("IMU ok", "unknown")]


def test_start_says_what_it_will_do() -> None:
    travel = view.travel_line(Travel(1.96, 2.1, 2.64, "the identified fish"))
    text = view.next_line(replace(NOW, travel=travel))
    assert text == (
        "START: trial 4, iteration 3; travel distance 1.96 m, at worst 2.10 m;"
        " tank clearance 2.64 m"
    )
    assert "TOO SHORT" in view.travel_line(Travel(2.7, 2.9, 2.64, "the identified fish"))
    assert "not decided" in view.next_line(replace(NOW, pending=3))
    assert "no reference" in view.next_line(replace(NOW, reference_m_s=()))


def test_rows_in_words() -> None:
    bent = HeadingDrift(0.1, math.radians(-21), 0.2, "imu")
    assert view.heading_drift(bent) == "heading drift -21°"
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
    ended = after(now, TrialEnded(4, "complete"), "12:01:00")
    assert ended.steps == (), "no ticks of it when the next checks begin"


def test_a_new_trial_wipes_the_old_one() -> None:
    now = after(NOW, TrialStarted(4, 3), "12:00:00")
    assert (now.phase, set(now.speed_m_s), set(now.amplitude_rad)) == ("swimming", {None}, {None})
    beat = BeatEvent(4, 1, 0.2, 0.05, 0.03, 0.001, 9, False, False)
    now = after(now, beat, "12:00:01")
    assert now.speed_m_s == (None, 0.03, None, None)
    late = replace(beat, beat=9)
    assert after(now, late, "12:00:01").speed_m_s == now.speed_m_s
    assert view.live_line(now) == "30.0 mm/s, reference 50.0; tail ±11°"


def test_a_run_has_its_speed_alone() -> None:
    """It swims along no reference of the fish's, and may go beyond the limit."""
    now = after(NOW, TrialStarted(4, 3, "measuring run 1"), "12:00:00")
    for beat in (0, 5):
        event = BeatEvent(4, beat, 0.2 * beat, 0.02, 0.03, 0.001, 9, False, False)
        now = after(now, event, f"12:00:0{beat}")
    assert view.phase_line(replace(now, beat=5)) == "Measuring run 1: 5 beats done"
    assert view.live_line(now) == "30.0 mm/s; tail ±57°"
    reference, measured = charts.speed_chart(now)["series"]
    assert reference["data"] == [] and measured["data"] == [30.0, *[None] * 4, 30.0]
    assert charts.amplitude_chart(now)["yAxis"]["max"] > 57
    assert charts.beat_error_chart(now)["series"][0]["data"] == []
    assert charts.beat_error_text(now) == "nothing measured yet"
    assert charts.speed_text(now).startswith("measuring run 1, without a reference; measured 30.0")
    trial = after(replace(NOW, run="measuring run 1"), TrialStarted(5, 3), "12:00:06")
    assert view.phase_line(replace(trial, beat=1)) == "Trial running: 1 of 4 beats done"


def test_the_log_forgets_its_oldest_lines() -> None:
    now = NOW
    for number in range(LOG_LINES + 5):
        now = logged(now, f"line {number}", "12:00:00")
    assert len(now.log) == LOG_LINES
    assert now.log[0].endswith("line 5")
    assert now.logged == LOG_LINES + 5


def test_a_broken_link_is_said_where_abort_is() -> None:
    cut = after(replace(NOW, phase="swimming"), LinkLost(), "12:00:00")
    assert "ABORT does not reach the fish" in cut.problem and cut.phase == "swimming"
    assert after(cut, LinkRestored("RUNNING"), "12:00:05").problem == ""


def test_a_full_stop_after_a_value_stays() -> None:
    words = state.on_the_page("raise it: tailbeat params set AMP_MAX_RAD 0.67. Otherwise slow down")
    assert words == "raise it: 'Parameters' on this page. Otherwise slow down"
