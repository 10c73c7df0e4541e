"""Whole trials on the simulated board, good days and bad ones."""

from __future__ import annotations

from itertools import count, islice
from pathlib import Path

import numpy as np
import pytest
from littlefs import LittleFS, UserContext

from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core.errors import ConnectError, LinkLostError, Refused, TailbeatError, TransferError
from tailbeat.core.speed_source import Frame
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.link import _dialect as mavlink
from tailbeat.link.messages import BeatEvent
from tailbeat.session.events import (
    Event,
    LinkLost,
    LinkRestored,
    TrialEnded,
    TrialStarted,
    TrialStopped,
    TrialWarning,
)
from tailbeat.session.outcome import StopKind, StopReason
from tailbeat.session.trial import run_trial
from tailbeat.session.trial_camera import default_camera

ENOUGH = StopReason(StopKind.CALLER, "enough")
TOO_CLOSE = StopReason(StopKind.DISTANCE, "too close to the wall")


def test_who_it_is(fish: Fish) -> None:
    info = fish.info()
    assert (info.board, info.simulated, info.version) == ("simulated", True, "0.1.0")
    assert info.build_id
    assert len(info.unique_id) == 32
    assert info.status.state == "IDLE"
    assert fish.health()["reset_cause"] == "power"


def test_reference_goes_up_once(ready: Fish, reference: bytes, spoil) -> None:
    radio = spoil(ready)
    assert ready.upload_reference(reference) == records.record_crc(reference)
    assert not [frame for frame in radio.sent if frame[7] == 110]  # no file transfer
    assert ready.reference_record() == reference


def test_no_reference(fish: Fish) -> None:
    assert fish.reference_record() is None
    with pytest.raises(Refused):
        fish.upload_amplitudes([0.1])


def test_learning_makes_it_better(ready: Fish, tmp_path: Path) -> None:
    ready.params.set("DU_MAX_RAD", 0)
    errors = []
    for number in (1, 2, 3):
        outcome = run_trial(ready)
        assert (outcome.number, outcome.iteration, outcome.end) == (number, number, "complete")
        assert outcome.executed_beats == 8
        assert [b.beat for b in outcome.beats] == list(range(8))
        assert all(b.speed_m_s is not None for b in outcome.beats)
        assert ready.status().pending_trial == number
        report = ready.learn()
        assert (report.trial, report.iteration) == (number, number)
        assert ready.learn(number) == report  # a repeated command does nothing
        errors.append(report.rms_error_m_s)
    assert errors[2] < errors[1] < errors[0]
    assert [t.number for t in ready.trials()] == [1, 2, 3]
    path = ready.pull_trial(2, tmp_path)
    assert path.name == "0002.ulg"
    assert path.read_bytes() == ready.ftp.read("/trials/0002.ulg")


def test_the_board_measures_what_is_true(ready: Fish) -> None:
    assert ready.sim is not None
    outcome = run_trial(ready)
    measured = [b.speed_m_s for b in outcome.beats]
    np.testing.assert_allclose(measured, ready.sim.world.true_beats(), atol=4e-3)


def test_same_seed_same_trial(reference: bytes) -> None:
    def trial() -> list[BeatEvent]:
        with Fish.connect("sim:tank", seed=5) as fish:
            fish.upload_reference(reference)
            return run_trial(fish).beats

    assert trial() == trial()


def test_learn_and_discard_need_a_pending_trial(ready: Fish) -> None:
    with pytest.raises(Refused) as refused:
        ready.learn()
    assert refused.value.name == "NO_TRIAL"
    run_trial(ready)
    with pytest.raises(Refused) as refused:
        ready.arm()
    assert refused.value.name == "TRIAL_PENDING"
    ready.discard()
    assert ready.status().pending_trial is None
    with pytest.raises(Refused) as refused:
        ready.restore_best()
    assert refused.value.name == "NO_BEST"


def test_amplitudes_both_ways(fish: Fish) -> None:
    beats = 70  # three pieces
    fish.params.set("TANK_LEN_M", 0)
    fish.upload_reference(records.encode_reference(1.0, [0.01] * beats))
    wanted = np.linspace(0.01, 0.4, beats).astype(np.float32)
    fish.upload_amplitudes(wanted)
    got = fish.amplitudes()
    assert got.beats == beats
    assert got.reference_crc == fish.status().reference_crc
    np.testing.assert_array_equal(got.values, wanted)


def test_speeds_may_come_after_the_swim(ready: Fish) -> None:
    assert ready.sim is not None
    ready.params.set("SPD_SOURCE", 1)
    ready.sim.world.set_camera(False)
    outcome = run_trial(ready)
    with pytest.raises(Refused) as refused:
        ready.learn()
    assert refused.value.name == "NOTHING_MEASURED"
    ready.upload_speeds(outcome.number, np.full(8, 0.01), np.full(8, 0.001))
    assert ready.learn().measured_beats == 8


def test_learning_from_a_stopped_board_says_what_comes_first(ready: Fish) -> None:
    def guard(what: object) -> StopReason | None:
        return ENOUGH if isinstance(what, BeatEvent) and what.beat == 2 else None

    run_trial(ready, guard=guard)
    with pytest.raises(Refused, match="stopped") as refused:
        ready.learn()
    assert refused.value.remedy == "tailbeat board clear, then learn."
    ready.clear()
    assert ready.learn().measured_beats >= 3


def test_a_guard_aborts(ready: Fish) -> None:
    events = []
    seen: list[object] = []

    def guard(what: Frame | BeatEvent) -> StopReason | None:
        seen.append(what)
        return TOO_CLOSE if isinstance(what, BeatEvent) and what.beat == 2 else None

    outcome = run_trial(ready, on_event=events.append, guard=guard)
    assert outcome.end == "aborted:ABORT_COMMAND"
    assert not outcome.interrupted
    assert 3 <= outcome.executed_beats < 8
    assert TrialStopped(TOO_CLOSE) in events
    assert any(isinstance(s, Frame) for s in seen)
    ready.clear()
    assert ready.status().state == "IDLE"
    assert ready.learn().measured_beats >= 3


def test_ctrl_c_stops_the_tail(ready: Fish) -> None:
    assert ready.sim is not None

    def press(event: Event) -> None:
        if isinstance(event, BeatEvent) and event.beat == 1 and event.provisional:
            raise KeyboardInterrupt

    outcome = run_trial(ready, on_event=press)
    assert outcome.interrupted
    assert outcome.end == "aborted:ABORT_COMMAND"
    assert not ready.sim.world.truth().swimming
    assert ready.status().state == "ABORTED"


def test_a_short_hole_in_the_radio_changes_nothing(ready: Fish) -> None:
    assert ready.sim is not None
    board, todo = ready.sim, ["off"]

    def follow(event: Event) -> None:
        if isinstance(event, BeatEvent) and event.beat == 1 and todo:
            todo.clear()
            board.world.set_radio(False)
            board.run(1.5)
            board.world.set_radio(True)

    outcome = run_trial(ready, on_event=follow)
    assert outcome.end == "complete"


def test_a_long_hole_ends_the_trial_and_is_told(ready: Fish) -> None:
    assert ready.sim is not None
    ready.upload_reference(records.encode_reference(1.0, [0.03] * 20))
    board, events, todo = ready.sim, [], ["off"]

    def follow(event: Event) -> None:
        events.append(type(event))
        if isinstance(event, BeatEvent) and event.beat == 1 and todo:
            todo.clear()
            board.world.set_radio(False)
        if isinstance(event, LinkLost):
            board.run(8.0)
            board.world.set_radio(True)

    outcome = run_trial(ready, on_event=follow)
    assert outcome.end == "aborted:LINK_LOST"
    assert events.index(LinkLost) < events.index(LinkRestored) < events.index(TrialEnded)


def test_a_link_that_stays_away_is_an_error_in_bounded_time(ready: Fish) -> None:
    assert ready.sim is not None
    board = ready.sim

    def follow(event: Event) -> None:
        if isinstance(event, BeatEvent):
            board.world.set_radio(False)

    begin = ready.transport.now_s()
    with pytest.raises(LinkLostError) as lost:
        run_trial(ready, on_event=follow, reconnect_s=20.0)
    assert ready.transport.now_s() - begin < 60.0
    assert "\n" not in str(lost.value)
    assert not board.world.truth().swimming


def test_power_lost_in_the_middle(ready: Fish) -> None:
    assert ready.sim is not None
    board, todo = ready.sim, ["cut"]

    def follow(event: Event) -> None:
        if isinstance(event, BeatEvent) and event.beat == 3 and todo:
            todo.clear()
            board.world.power_cycle()

    outcome = run_trial(ready, on_event=follow)
    assert outcome.end == "aborted:REBOOT"
    assert ready.status().next_trial == 2


def test_a_trial_without_camera_warns(ready: Fish, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tailbeat.session.trial_camera.SimulatedCamera", lambda _: None)
    events: list[Event] = []
    outcome = run_trial(ready, on_event=events.append)
    assert isinstance(events[0], TrialWarning)
    assert all(b.speed_m_s is None for b in outcome.beats)


def test_a_camera_that_dies_in_the_middle_is_told_once(ready: Fish) -> None:
    events: list[Event] = []

    def follow(event: Event) -> None:
        events.append(event)
        if isinstance(event, BeatEvent) and event.beat == 2:
            ready.sim.world.set_camera(False)

    outcome = run_trial(ready, on_event=follow)
    warnings = [e.text for e in events if isinstance(e, TrialWarning)]
    assert warnings == ["the camera sends no pictures; beats go unmeasured"]
    assert outcome.end == "complete"
    assert outcome.beats[1].speed_m_s is not None
    assert outcome.beats[-1].speed_m_s is None


@pytest.mark.parametrize("seed", range(1, 4))
def test_a_trial_over_a_bad_radio(ready: Fish, spoil, seed: int, tmp_path: Path) -> None:
    radio = spoil(ready, seed, lose=0.1, damage=0.02, twice=0.05)
    outcome = run_trial(ready)
    assert outcome.end == "complete"
    assert ready.learn().measured_beats >= 7
    pulled = ready.pull_trial(outcome.number, tmp_path).read_bytes()
    ready.link.transport = radio.inner
    assert pulled == ready.ftp.read(f"/trials/{outcome.number:04d}.ulg")


def test_arming_twice_and_disarming(ready: Fish) -> None:
    ready.arm()
    ready.arm()
    assert ready.status().state == "ARMED"
    ready.disarm()
    assert ready.status().state == "IDLE"
    assert ready.amplitudes().iteration == 1
    ready.abort()


def test_watch(fish: Fish) -> None:
    events = list(islice(fish.watch(), 20))
    assert {"status", "live"} <= {e["event"] for e in events}
    assert all("time_boot_ms" not in e for e in events)


def test_no_board_behind_the_address() -> None:
    with pytest.raises(ConnectError) as missing:
        Fish.connect("sim:tank", boot_s=1000.0)
    assert "no tailbeat board" in str(missing.value)


def test_an_abort_the_link_swallowed_is_said_again(
    ready: Fish, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = []
    abort = ready.abort

    def first_one_lost(wall: bool = False) -> None:
        said.append("abort")
        if len(said) == 1:
            raise LinkLostError("the link broke")
        abort()

    monkeypatch.setattr(ready, "abort", first_one_lost)
    outcome = run_trial(ready, guard=lambda what: ENOUGH if isinstance(what, BeatEvent) else None)
    assert outcome.end == "aborted:ABORT_COMMAND"
    assert len(said) == 2


def test_ctrl_c_before_the_start_is_acknowledged_stops_the_tail(
    ready: Fish, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert ready.sim is not None
    send = ready.link.send

    def press(message: mavlink.MAVLink_message) -> None:
        send(message)
        if getattr(message, "command", 0) == mavlink.TAILBEAT_CMD_TRIAL_START:
            raise KeyboardInterrupt

    monkeypatch.setattr(ready.link, "send", press)
    with pytest.raises(KeyboardInterrupt):
        run_trial(ready)
    assert not ready.sim.world.truth().swimming
    assert ready.status().state == "ABORTED"


def test_a_second_ctrl_c_ends_the_waiting(ready: Fish, monkeypatch: pytest.MonkeyPatch) -> None:
    def press(event: Event) -> None:
        if isinstance(event, TrialStarted | LinkLost):
            raise KeyboardInterrupt

    def lost(wall: bool = False) -> None:
        raise LinkLostError("the link broke")

    monkeypatch.setattr(ready, "abort", lost)
    monkeypatch.setattr(ready.clock, "keep", lambda: press(TrialStarted(1, 1)))
    with pytest.raises(KeyboardInterrupt):
        run_trial(ready, on_event=lambda e: press(e) if isinstance(e, LinkLost) else None)


def test_a_trial_that_never_ends_is_given_up(ready: Fish, monkeypatch: pytest.MonkeyPatch) -> None:
    assert ready.sim is not None
    monkeypatch.setattr("tailbeat.session.trial._is_over", lambda run: False)
    begin = ready.transport.now_s()
    with pytest.raises(TailbeatError, match="makes no progress"):
        run_trial(ready)
    assert ready.transport.now_s() - begin < 120.0


def test_a_link_that_breaks_again_while_coming_back_gets_its_time(
    ready: Fish, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert ready.sim is not None
    board, sync, state = ready.sim, ready.clock.sync, {"cut": False, "failed": False}

    def follow(event: Event) -> None:
        if isinstance(event, BeatEvent) and not state["cut"]:
            state["cut"] = True
            board.world.set_radio(False)
        if isinstance(event, LinkLost):
            board.world.set_radio(True)

    def sync_once_lost() -> None:
        if state["cut"] and not state["failed"]:
            state["failed"] = True
            raise LinkLostError("again")
        sync()

    monkeypatch.setattr(ready.clock, "sync", sync_once_lost)
    assert run_trial(ready, on_event=follow).end == "complete"
    assert state["failed"]


def test_amplitudes_that_never_hold_still(ready: Fish, monkeypatch: pytest.MonkeyPatch) -> None:
    piece = ready._piece
    iterations = count()

    def changing(first: int, best: bool) -> object:
        message = piece(0, best)
        message.count, message.iteration = 1, next(iterations)
        return message

    monkeypatch.setattr(ready, "_piece", changing)
    with pytest.raises(TransferError, match="change while they are read"):
        ready.amplitudes()


def test_a_simulator_without_camera(reference: bytes) -> None:
    with Fish.connect("sim:tank?camera_fps=0") as fish:
        assert default_camera(fish) is None


def recorded(fish: Fish, folder: Path) -> Trial:
    return read_trial(fish.pull_trial(run_trial(fish).number, folder))


def test_a_trial_tells_what_made_its_amplitudes(fish: Fish, tmp_path: Path) -> None:
    fish.upload_reference(records.encode_reference(1.0, np.full(3, 0.04)))
    assert recorded(fish, tmp_path).input == "first"
    fish.learn()
    assert recorded(fish, tmp_path).input == "law"
    fish.discard()
    fish.upload_amplitudes(np.full(3, 0.3))
    assert recorded(fish, tmp_path).input == "uploaded"
    fish.learn()
    fish.restore_best()
    assert recorded(fish, tmp_path).input == "restored"


def test_amplitudes_tell_what_made_them(fish: Fish) -> None:
    fish.upload_reference(records.encode_reference(1.0, np.full(3, 0.04)))
    fish.upload_amplitudes(np.full(3, 0.3))
    assert fish.amplitudes().input == mavlink.TAILBEAT_INPUT_UPLOADED
    fish.learn(run_trial(fish).number)
    assert fish.amplitudes().input == mavlink.TAILBEAT_INPUT_LAW
    fish.restore_best()
    assert fish.amplitudes(best=True).input == mavlink.TAILBEAT_INPUT_RESTORED


def test_what_was_learned_on_a_board_that_counts_no_visits(
    fish: Fish, monkeypatch: pytest.MonkeyPatch
) -> None:
    fish.upload_reference(records.encode_reference(1.0, np.full(3, 0.04)))
    fish.learn(run_trial(fish).number)
    counted = fish.learned_record()
    assert counted is not None and counted[-3:] == b"\1\1\1"
    with monkeypatch.context() as older:
        older.setattr("tailbeat.board.memory._VISITS", 99)  # a set that this board does not know
        assert fish.visits() is None
        record = fish.learned_record()
        assert fish.amplitudes().input is None  # and it does not tell what made its input
    flat = records.without_peaks(counted)
    assert record is not None and record[12:] == flat[12:-3]
    fish.upload_learned(record)
    again = fish.learned_record()
    assert again is not None and again[12:] == record[12:] + bytes(3)
    fish.upload_learned(counted)
    assert fish.learned_record() == counted


def test_the_learned_record_is_what_the_board_stores(fish: Fish) -> None:
    assert fish.learned_record() is None
    fish.upload_reference(records.encode_reference(1.0, np.full(3, 0.04)))
    fish.learn(run_trial(fish).number)
    sim = fish.sim
    assert sim is not None
    disk = UserContext(buffsize=len(sim.flash))
    disk.buffer[:] = sim.flash
    stored = LittleFS(context=disk, block_size=2048, block_count=128)
    with stored.open("/learned.bin", "rb") as file:
        kept = file.read()
    assert fish.learned_record() == kept
    assert kept[-3:] == b"\1\1\1"  # each beat was corrected once
