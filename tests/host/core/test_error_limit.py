"""A trial that the board stops by itself because a beat's speed was too far off (ERR_MAX_M_S): what
a session with such trials looks like, and why the beat that did it has to be learned from."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tailbeat.app.cli import run
from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core.arrays import F32
from tailbeat.core.trial_checks import never_corrected, never_measured, not_reached, spans
from tailbeat.core.trial_file import read_trial
from tailbeat.link.messages import BeatEvent, TrialOutcome
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport

BEATS = 12
LIMIT_M_S = 0.02
TRIALS_MAX = 16
VISION, IMU, MODEL = 0, 2, 3
SETTLED_BEATS = 2  # swum until the speed of a beat is settled: SPD_LATE_S + SPD_GAP_S
PARAMS = {
    "AMP_MAX_RAD": 0.785, "DU_MAX_RAD": 0, "ILC_GAIN": 2, "ILC_LEAD": 0, "ERR_MAX_M_S": LIMIT_M_S,
}  # fmt: skip

Floats = F32
Run = Callable[..., tuple[int, str, str]]


def wanted() -> Floats:
    """Two slow beats, then more than a gain of 2 reaches at once."""
    return np.array([0.01, 0.01, *[0.06] * (BEATS - 2)], dtype=np.float32)


def prepare(fish: Fish, **others: float) -> None:
    for name, value in {**PARAMS, **others}.items():
        fish.params.set(name, value)
    fish.upload_reference(records.encode_reference(1.0, wanted()))


def swim(fish: Fish) -> TrialOutcome:
    outcome = run_trial(fish)
    if outcome.end != "complete":
        fish.clear()
    return outcome


def guilty(fish: Fish, number: int, folder: Path) -> tuple[int, Floats]:
    """The first beat that was too far off, and all speeds."""
    speed = read_trial(fish.pull_trial(number, folder)).beats.speed_m_s
    return int(np.argmax(np.abs(wanted() - speed) > LIMIT_M_S)), speed


def series(folder: Path, masked: bool, **others: float) -> list[tuple[str, int]]:
    """Trials until one is whole, TRIALS_MAX at most: how each ended, and its guilty beat.
    ``masked``: the law does not see the guilty beat, nor those after it."""
    found = []
    with Fish.connect("sim:thesis", seed=1) as fish:
        prepare(fish, **others)
        while len(found) < TRIALS_MAX and ("complete", -1) not in found:
            outcome = swim(fish)
            if outcome.end == "complete":
                found.append(("complete", -1))
                break
            beat, speed = guilty(fish, outcome.number, folder)
            assert beat < outcome.executed_beats
            if masked:
                known = np.where(np.arange(BEATS) < beat, speed, np.nan)
                fish.upload_speeds(outcome.number, known, np.full(BEATS, 1e-3))
            report = fish.learn(outcome.number)
            assert report.measured_beats == (beat if masked else outcome.executed_beats)
            found.append((outcome.end, beat))
    return found


def test_the_guilty_beat_is_learned_from_and_the_series_gets_through(tmp_path: Path) -> None:
    found = series(tmp_path, masked=False)
    print(found)
    assert found[0] == ("aborted:ERROR_LIMIT", 2)
    beats = [beat for _, beat in found[:-1]]
    assert found[-1] == ("complete", -1) and beats == sorted(beats) and beats[-1] > 4


def test_without_it_every_trial_ends_at_the_same_beat(tmp_path: Path) -> None:
    assert series(tmp_path, masked=True) == [("aborted:ERROR_LIMIT", 2)] * TRIALS_MAX


def test_holding_the_last_corrected_beat_gets_there_sooner(tmp_path: Path) -> None:
    kept, held = (len(series(tmp_path, False, ILC_EXTRAP=policy)) for policy in (0, 1))
    print(f"keep: {kept} trials, hold: {held}")
    assert held < kept


def test_two_more_beats_are_swum_and_all_of_them_count(tmp_path: Path) -> None:
    with Fish.connect("sim:thesis", seed=2) as fish:
        prepare(fish)
        outcome = swim(fish)
        assert outcome.end == "aborted:ERROR_LIMIT"
        beat, speed = guilty(fish, outcome.number, tmp_path)
        assert outcome.executed_beats == beat + 1 + SETTLED_BEATS
        assert np.array_equal(np.isfinite(speed), np.arange(BEATS) < outcome.executed_beats)
        fish.learn()
        visits = fish.visits()
        assert visits is not None
        assert visits.tolist() == [int(k < outcome.executed_beats) for k in range(BEATS)]


@pytest.mark.parametrize(("source", "stops"), [(IMU, False), (MODEL, True)])
def test_only_speeds_that_are_known_in_the_swim_stop_it(source: int, stops: bool) -> None:
    with Fish.connect("sim:tank", seed=1) as fish:
        assert fish.imu_verdict().state == "streaming"
        prepare(fish, SPD_SOURCE=source, REST_MIN_S=3, ERR_MAX_M_S=0.001)
        outcome = run_trial(fish)
        assert outcome.end == ("aborted:ERROR_LIMIT" if stops else "complete")


def test_power_lost_in_mid_swim_teaches_nothing_and_costs_nothing(tmp_path: Path) -> None:
    with Fish.connect("sim:thesis", seed=1) as fish:
        prepare(fish, ERR_MAX_M_S=0)
        swim(fish)
        fish.learn()
        held, visits = fish.amplitudes(), fish.visits()
        board = fish.sim
        assert isinstance(board, SimBoard)
        todo = ["cut"]

        def cut(event: dict) -> None:
            if isinstance(event, BeatEvent) and event.beat == 7 and todo:
                todo.clear()
                board.world.power_cycle()

        outcome = run_trial(fish, on_event=cut)
        assert outcome.end == "aborted:REBOOT"
        status = fish.status()
        assert (status.pending_trial, status.next_trial) == (None, outcome.number + 1)
        again, counted = fish.amplitudes(), fish.visits()
        assert again.values.tobytes() == held.values.tobytes()
        assert visits is not None and counted is not None
        assert counted.tolist() == visits.tolist()
        trial = read_trial(fish.pull_trial(outcome.number, tmp_path))
        assert trial.end == "unfinished"
        assert len(trial.slots.table()) > 0


@pytest.fixture
def board(monkeypatch: pytest.MonkeyPatch) -> SimBoard:
    """A board that every command connects to."""
    made = SimBoard("thesis", seed=1)
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: SimTransport(made))
    with Fish(SimTransport(made)) as fish:
        prepare(fish)
    return made


@pytest.fixture
def tailbeat(capsys: pytest.CaptureFixture[str], board: SimBoard) -> Run:
    """Runs a command: (exit code, stdout, stderr)."""
    assert board is not None

    def command(*words: str) -> tuple[int, str, str]:
        code = run([*words, "--connect", "x"])
        return code, *capsys.readouterr()

    return command


def test_a_session_by_the_command_line(
    tailbeat: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "book"))
    code, out, _ = tailbeat("info")
    assert code == 0 and "never been corrected" not in out
    code, out, err = tailbeat("trial", "run")
    assert code == 1
    assert out.startswith("trial 1, iteration 1: aborted:ERROR_LIMIT, 5 beats, max|e| ")
    assert "the speed error of a beat was too large" in err
    code, out, _ = tailbeat("info")
    assert "Clear it, then learn from the trial: the beat that was too far off counts." in out
    assert tailbeat("board", "clear")[0] == 0
    code, out, _ = tailbeat("trial", "show")
    assert code == 0 and "not executed: beats 5-11" in out.splitlines()
    code, out, _ = tailbeat("learn")
    line = "beats 5-11 have never been corrected: ILC_EXTRAP decides what the last ones do"
    assert code == 0 and out.splitlines()[1] == line
    code, out, _ = tailbeat("info")
    assert out.splitlines()[-1] == f"learned    {line}"
    document = json.loads(tailbeat("info", "--json")[1])
    assert document["visits"] == [1] * 5 + [0] * 7
    code, out, _ = tailbeat("experiment", "progress")
    assert "beats 5-11 have never been measured: no trial teaches anything there" in out
    assert (
        json.loads(tailbeat("experiment", "progress", "--json")[1])["visits"] == [1] * 5 + [0] * 7
    )
    assert tailbeat("trial", "run")[0] == 1
    assert tailbeat("board", "clear")[0] == 0
    learned = json.loads(tailbeat("learn", "--json")[1])
    assert learned["visits"][:5] == [2] * 5
    assert learned["visits"][-1] == 0


def test_what_is_said_of_visits() -> None:
    assert spans([5]) == "beat 5"
    assert spans([0, 5, 6, 7, 9]) == "beats 0, 5-7, 9"
    assert never_corrected(None) == ""
    assert never_corrected(np.zeros(5)) == never_corrected(np.ones(5)) == ""
    assert never_corrected([]) == ""
    assert never_corrected([1, 0, 2]) == "beat 1 has never been corrected"
    assert never_corrected([1, 0, 2, 0, 0]).startswith("beats 1, 3-4 have never been corrected: ")
    assert never_measured([3, 255]) == ""
    assert never_measured([1, 0]).startswith("beat 1 has never been measured")
    assert not_reached(3, [True, True, True]) == ""
    assert not_reached(2, [True, False, False]) == "not executed: beat 2; without a speed: beat 1"
